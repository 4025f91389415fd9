//! The emulated image in a simulated machine: sensors from the plant, thrust from what the speed controllers hear.
//!
//! Noise is white, of about the part's size. A rotor's thrust grows with the square of what its controller is told.
use crate::card::Card;
use crate::motion::Noise;
use control_core::frames::Vec3;
use flight_link::{Decoder, FRAME_BYTES_MAX, FromBoard, ToBoard, encode};
use nalgebra::Vector3;
use sim_host::actuators::Drive;
use sim_host::emulator::{Answer, Emulator, Mishap, Motion, Telemetry};
use sim_host::ground::Ground;
use sim_host::plant::{Actuation, Plant, RigidPlant, Truth};
use sim_host::vehicle::{AirframeName, Vehicle, VehicleKeys};
use sim_host::wind::Gust;

/// Samples of the inertial unit a second.
pub const SAMPLE_HZ: u32 = 2_000;
/// Samples between two frames of the radio.
const RADIO_EVERY: u32 = 40;
/// Noise of a sample, 1 σ.
const RATE_RAD_S: f64 = 2e-3;
const FORCE_M_S2: f64 = 0.03;
const PRESSURE_PA: f64 = 0.5;
const FIELD_UT: f64 = 0.2;
/// The earth's field, north, east, down, µT.
const EARTH_UT: [f64; 3] = [20.0, 0.0, 43.0];

/// What the pilot's hands do: roll, pitch and yaw −1 to 1, throttle 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hands {
    /// To the right.
    pub roll: f64,
    /// Forward.
    pub pitch: f64,
    /// Up.
    pub throttle: f64,
    /// The arm switch.
    pub arm: bool,
}

/// A pilot who sees the machine and holds it over the pad by hand: arms after 6 s, climbs to 1.5 m, lands at 20 s, disarms at 22.
#[derive(Clone, Copy, Debug, Default)]
pub struct ByHand {
    climb: f64,
}

impl ByHand {
    /// What the hands do.
    pub fn hands(&mut self, t_s: f64, truth: &Truth) -> Hands {
        let wanted_m = (0.6 * (t_s - 6.5)).clamp(0.0, 1.5).min(0.5 * (19.5 - t_s));
        let (error_m, sink_m_s) = (wanted_m - truth.altitude_m(), truth.velocity_m_s.z);
        self.climb = (self.climb + 0.0001 * error_m).clamp(0.0, 0.2);
        let flies = (6.5..20.5).contains(&t_s);
        let lean = |position_m: f64, velocity_m_s: f64| (-0.10 * position_m - 0.15 * velocity_m_s).clamp(-0.4, 0.4);
        let up = 0.42 + self.climb + 0.25 * error_m + 0.15 * sink_m_s;
        Hands {
            roll: lean(truth.position_m.y, truth.velocity_m_s.y),
            pitch: lean(truth.position_m.x, truth.velocity_m_s.x),
            throttle: if flies { up.clamp(0.0, 0.9) } else { 0.0 },
            arm: (6.0..22.0).contains(&t_s),
        }
    }
}

/// Machine and image.
pub struct Aloft {
    emulator: Emulator,
    plant: RigidPlant,
    /// What acts on the machine; the shares of the drives are its faults.
    pub actuation: Actuation,
    vehicle: Vehicle,
    noise: Noise,
    samples: u32,
    decoder: Decoder<FromBoard>,
    /// How fast the rotors turned in the last sample, rad/s.
    pub rotor_rad_s: [f32; 4],
    /// The image's last answer.
    pub answer: Answer,
    /// Whether rotors stop when frames cease; else they go on as they were told.
    pub stops_unheard: bool,
}

impl Aloft {
    /// On the ground, just switched on; the image has booted.
    ///
    /// # Panics
    /// If it does not.
    pub fn on_the_ground() -> Self {
        Self::on_the_ground_after(0)
    }

    /// The same, with an image that takes its clock to have run for so many seconds when it boots.
    ///
    /// # Panics
    /// If it does not boot.
    pub fn on_the_ground_after(uptime_s: u32) -> Self {
        Self::prepared(|emulator| {
            if uptime_s > 0 {
                emulator.begin_after(uptime_s);
            }
        })
    }

    /// The same, with an MPU-6000 in the place of the ICM-42688-P.
    ///
    /// # Panics
    /// If it does not boot.
    pub fn with_mpu6000() -> Self {
        Self::prepared(Emulator::solder_mpu6000)
    }

    /// The same, after something was said to the board before it boots.
    ///
    /// # Panics
    /// If it does not boot.
    pub fn prepared(say: impl FnOnce(&mut Emulator)) -> Self {
        let mut emulator = Emulator::start().expect("emulator and image build");
        say(&mut emulator);
        let keys = VehicleKeys { linear_drag_n_s_m: 0.1, ..VehicleKeys::default() };
        let vehicle = Vehicle::new(AirframeName::Paper, &keys);
        let ground = Ground { altitude_m: Some(0.0) };
        let plant = RigidPlant::standing(&vehicle, ground, ground.standing_m().expect("there is ground"));
        let drive = Drive { command_n: 0.0, lag_s: keys.motor_lag_s, rate_n_s_max: f64::INFINITY, share: 1.0 };
        emulator.move_body(&Motion { force_m_s2: [0.0, 0.0, -9.81], rate_rad_s: [0.0; 3] });
        let answer = emulator.period().expect("the image boots");
        let actuation = Actuation { drives: [drive; 4], gust: Gust::default() };
        Self {
            emulator,
            plant,
            actuation,
            vehicle,
            noise: Noise::new(7),
            samples: 0,
            rotor_rad_s: [0.0; 4],
            decoder: Decoder::new(),
            answer,
            stops_unheard: false,
        }
    }

    /// The same, with a card in its slot.
    ///
    /// # Panics
    /// If it does not boot.
    pub fn with_card(card: &Card) -> Self {
        Self::prepared(|emulator| emulator.put_card(Some(card.path())))
    }

    /// Does something to the chip that no program should.
    pub fn inflict(&mut self, mishap: Mishap) {
        self.emulator.inflict(mishap);
    }

    /// Lets the station say something.
    ///
    /// # Panics
    /// If it is too long.
    pub fn say(&mut self, record: &ToBoard) {
        self.emulator.send_station(encode(record, &mut [0; FRAME_BYTES_MAX]).expect("it fits"));
    }

    /// What the station has heard since it last asked.
    ///
    /// # Panics
    /// If the image does what the emulator does not model.
    pub fn heard(&mut self) -> Vec<FromBoard> {
        let (_, bytes) = self.emulator.station_heard().expect("the image runs");
        bytes.into_iter().filter_map(|byte| self.decoder.push(byte)).collect()
    }

    /// Sets how the speed controller of a motor, 0 to 3, answers.
    pub fn set_telemetry(&mut self, motor: u8, telemetry: Telemetry) {
        self.emulator.set_telemetry(motor, telemetry);
    }

    /// Whether the buzzer sounds.
    ///
    /// # Panics
    /// If the image does what the emulator does not model.
    pub fn buzzer_sounds(&mut self) -> bool {
        self.emulator.buzzer_sounds().expect("the image runs")
    }

    /// Says something to the board.
    pub fn tell(&mut self, tell: impl FnOnce(&mut Emulator)) {
        tell(&mut self.emulator);
    }

    /// The truth now.
    pub fn truth(&self) -> Truth {
        self.plant.truth(&self.actuation)
    }

    /// Since the first sample, s.
    pub fn time_s(&self) -> f64 {
        f64::from(self.samples) / f64::from(SAMPLE_HZ)
    }

    /// One sample of flight.
    ///
    /// # Panics
    /// If the image does what the emulator does not model.
    pub fn step(&mut self, hands: &Hands) {
        if self.samples.is_multiple_of(RADIO_EVERY) {
            self.emulator.send_channels(channels(hands));
        }
        let truth = self.truth();
        let noisy = |truth: [f64; 3], noise: [f64; 3]| [0, 1, 2].map(|n| (truth[n] + noise[n]) as f32);
        let motion = Motion {
            force_m_s2: noisy(truth.specific_force_m_s2.into(), self.noise.normals(FORCE_M_S2)),
            rate_rad_s: noisy(truth.rate_rad_s.into(), self.noise.normals(RATE_RAD_S)),
        };
        self.emulator.move_body(&motion);
        let [noise_pa, _, _] = self.noise.normals(PRESSURE_PA);
        let pressure_pa = 101_325.0 * (1.0 - truth.altitude_m() * 0.0065 / 288.15).powf(5.255_88);
        self.emulator.set_air((pressure_pa + noise_pa) as f32, 20.0);
        let field_ut =
            noisy((truth.attitude.transpose() * Vector3::from(EARTH_UT)).into(), self.noise.normals(FIELD_UT));
        self.emulator.set_field(Vec3::new(field_ut[0], field_ut[1], field_ut[2]));
        let speed = |thrust_n: f64| (thrust_n.max(0.0) / self.vehicle.thrust_coefficient_n_s2).sqrt() as f32;
        self.rotor_rad_s = self.plant.rotor_n(&self.actuation).map(speed);
        self.emulator.turn_rotors(self.rotor_rad_s);
        let heard = self.answer.understood[0];
        self.answer = self.emulator.period().expect("the image runs");
        let unheard = self.stops_unheard && self.answer.understood[0] == heard;
        for (drive, speed) in self.actuation.drives.iter_mut().zip(self.answer.speeds()) {
            let speed = if unheard { 0.0 } else { speed };
            drive.command_n = speed * speed * self.vehicle.thrust_n_max();
        }
        self.plant.advance(&self.actuation, 1.0 / f64::from(SAMPLE_HZ), 1);
        self.samples += 1;
    }
}

/// The receiver's channels: roll, pitch, throttle, yaw, arm, and the mode switches down.
pub fn channels(hands: &Hands) -> [u16; 16] {
    let ticks = |x: f64| (992.0 + 819.5 * x.clamp(-1.0, 1.0)).round() as u16;
    let mut channels = [ticks(-1.0); 16];
    channels[..5].copy_from_slice(&[
        ticks(hands.roll),
        ticks(hands.pitch),
        ticks(2.0 * hands.throttle - 1.0),
        ticks(0.0),
        ticks(if hands.arm { 1.0 } else { -1.0 }),
    ]);
    channels
}
