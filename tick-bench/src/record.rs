//! The tick record: what every tick of a flight saw, and the thrusts the host computed from it.
//!
//! Little-endian: the magic `TICKREC2`, a `u32` count, a `u32` that says who flew (0 `lgs`, 1 `default`), the
//! airframe as 19 `f32` (mass, 3 moments of inertia, place and largest thrust of each rotor, torque per thrust, rotor momentum, least
//! thrust), then for every tick 37 `f32`:
//!
//! | count | what                                                         |
//! |-------|--------------------------------------------------------------|
//! | 1     | time since the last tick, s                                  |
//! | 3, 3  | position and velocity, NED, m and m/s                        |
//! | 9     | attitude, body to NED, row-major                             |
//! | 3, 3  | body rates and specific force, rad/s and m/s²                |
//! | 3 × 3 | setpoint position, velocity and acceleration, NED            |
//! | 2     | setpoint heading and heading rate, rad and rad/s             |
//! | 4     | rotor thrusts computed by the host, N                        |
use control_core::frames::{Attitude, Vec3};
use control_core::{Airframe, Config, Input, Law, Rotor, Setpoint};

/// Where QEMU's loader puts the record: the PSRAM of mps2-an386.
const ADDRESS: usize = 0x2100_0000;
/// Size of that PSRAM.
const BYTES_MAX: usize = 16 << 20;

const MAGIC: [u8; 8] = *b"TICKREC2";
const NUMBERS: usize = 37;
/// Ticks that fit; a larger count is a record that is not there.
const TICKS_MAX: usize = (BYTES_MAX - size_of::<Header>()) / size_of::<Tick>();

#[repr(C)]
struct Header {
    magic: [u8; 8],
    ticks: u32,
    controller: u32,
    airframe: [f32; 19],
}

/// A recorded flight.
pub(crate) struct Record {
    /// What the controller was made from.
    pub(crate) config: Config,
    pub(crate) ticks: &'static [Tick],
}

/// One tick, as it lies in memory.
#[repr(transparent)]
pub(crate) struct Tick([f32; NUMBERS]);

/// The flight in PSRAM; `None` if no record was loaded.
pub(crate) fn flight() -> Option<Record> {
    // SAFETY: the PSRAM is always mapped, aligned, initialised by QEMU and never written; any bits are a header.
    let header = unsafe { &*(ADDRESS as *const Header) };
    let count = usize::try_from(header.ticks).ok()?;
    if header.magic != MAGIC || count > TICKS_MAX {
        return None;
    }
    let airframe = airframe(&header.airframe);
    let mut config = Config::flight(Law::Lgs, airframe);
    match header.controller {
        0 => {}
        1 => config = Config::tolerant(airframe),
        _ => return None,
    }
    let first = (ADDRESS + size_of::<Header>()) as *const Tick;
    // SAFETY: as above; `count` ticks end within the PSRAM, and any bits are an `f32`.
    let ticks = unsafe { core::slice::from_raw_parts(first, count) };
    Some(Record { config, ticks })
}

/// The airframe that was flown.
fn airframe(numbers: &[f32; 19]) -> Airframe {
    let [mass_kg, ix, iy, iz, places @ .., torque_per_thrust_m, rotor_momentum, thrust_n_min] = *numbers;
    let rotor =
        |j: usize| Rotor { forward_m: places[3 * j], right_m: places[3 * j + 1], thrust_n_max: places[3 * j + 2] };
    Airframe {
        mass_kg,
        inertia_kg_m2: [ix, iy, iz],
        rotors: core::array::from_fn(rotor),
        torque_per_thrust_m,
        rotor_momentum,
        thrust_n_min,
    }
}

impl Tick {
    /// What the controller saw, and the thrusts the host made of it.
    pub(crate) fn decode(&self) -> (Input, [f32; 4]) {
        let mut numbers = self.0.iter().copied();
        let mut next = || numbers.next().unwrap_or(f32::NAN);
        // Fields are evaluated in the order they are written, which is that of the record.
        let input = Input {
            dt_s: next(),
            position_m: Vec3::new(next(), next(), next()),
            velocity_m_s: Vec3::new(next(), next(), next()),
            attitude: Attitude { rows: core::array::from_fn(|_| core::array::from_fn(|_| next())) },
            rate_rad_s: Vec3::new(next(), next(), next()),
            specific_force_m_s2: Vec3::new(next(), next(), next()),
            setpoint: Setpoint {
                position_m: Vec3::new(next(), next(), next()),
                velocity_m_s: Vec3::new(next(), next(), next()),
                acceleration_m_s2: Vec3::new(next(), next(), next()),
                yaw_rad: next(),
                yaw_rate_rad_s: next(),
            },
        };
        (input, core::array::from_fn(|_| next()))
    }
}
