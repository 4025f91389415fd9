//! What the controller is shown of the truth.
//!
//! Either of two ways: [`Sensors`] adds white noise to every channel of it, and what damaged propellers shake; a
//! [`SensorSuite`] (`[sensors]` in a scenario) stands in for parts that flight boards carry, with their data sheets' errors
//! and with faults, and leaves it to an estimator to make something of them.
//!
//! | file        | what                                                      |
//! |-------------|-----------------------------------------------------------|
//! | `suite.rs`  | all sensors of a flight                                   |
//! | `keys.rs`   | the scenario's keys                                       |
//! | `parts.rs`  | the data sheets (docs/sensors.md has the sources)         |
//! | `line.rs`   | rate, latency, time stamps                                |
//! | `chance.rs` | random processes, registers                               |
//! | `broken.rs` | faults                                                    |
//! | `calibration.rs` | what a builder does before a flight               |
//! | `account.rs`| how wrong the readings of a flight were                   |
//! | the others  | one kind of sensor each, its equations at the top         |
use crate::actuators::Vibration;
use crate::fault::sensors::Sensor;
use crate::flight::{Stream, random_of};
use crate::plant::Truth;
use crate::reference::Target;
use crate::wind::Gust;
use control_core::Input;
use control_core::frames::{Attitude, Vec3};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod account;
mod air;
mod broken;
mod calibration;
mod chance;
mod down;
mod field;
mod gnss;
mod imu;
mod keys;
mod line;
mod parts;
mod power;
mod suite;
mod vision;

pub use account::Account;
pub(crate) use air::pressure_pa;
pub use calibration::Calibration;
pub use keys::{BatteryKeys, Each, EarthKeys, RotorSpeedPart, SensorKeys, SkyKeys};
pub use parts::{BaroPart, FlowPart, GnssPart, ImuPart, MagPart, RangePart, VisionPart};
pub use suite::{Carrier, SensorSuite};

/// `[noise]`: standard deviation of the white noise on each channel, one draw a tick.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Noise {
    /// Position, each axis, m.
    pub position_m: f64,
    /// Velocity, each axis, m/s.
    pub velocity_m_s: f64,
    /// Attitude, about each body axis, rad.
    pub attitude_rad: f64,
    /// Body rates, each axis, rad/s.
    pub rate_rad_s: f64,
    /// Specific force, each axis, m/s².
    pub acceleration_m_s2: f64,
}

/// The sensors of one flight.
pub struct Sensors {
    noise: Noise,
    random: Pcg64,
}

impl Sensors {
    /// Sensors with their own random numbers.
    pub fn new(noise: Noise, random: Pcg64) -> Self {
        Self { noise, random }
    }

    /// One draw on three axes. Always drawn, so that a channel's noise does not depend on another's.
    fn draw(&mut self, deviation: f64) -> Vector3<f64> {
        let random = &mut self.random;
        Vector3::from_fn(|_, _| {
            let unit: f64 = StandardNormal.sample(random);
            deviation * unit
        })
    }

    /// What the controller sees of `truth` when told to be at `target`, `dt_s` after the last sample.
    ///
    /// - `vibration`: felt by gyro and accelerometer alone.
    pub fn sample(&mut self, truth: &Truth, vibration: &Vibration, target: &Target, dt_s: f64) -> Input {
        let noise = self.noise;
        let position = truth.position_m + self.draw(noise.position_m);
        let velocity = truth.velocity_m_s + self.draw(noise.velocity_m_s);
        let attitude = truth.attitude * small_rotation(self.draw(noise.attitude_rad));
        let rate = truth.rate_rad_s + self.draw(noise.rate_rad_s) + vibration.rate_rad_s;
        let specific_force =
            truth.specific_force_m_s2 + self.draw(noise.acceleration_m_s2) + vibration.specific_force_m_s2;
        Input {
            dt_s: dt_s as f32,
            position_m: narrow(&position),
            velocity_m_s: narrow(&velocity),
            attitude: Attitude { rows: std::array::from_fn(|i| std::array::from_fn(|j| attitude[(i, j)] as f32)) },
            rate_rad_s: narrow(&rate),
            specific_force_m_s2: narrow(&specific_force),
            setpoint: target.setpoint(),
        }
    }
}

/// All that sensors feel at one tick.
#[derive(Clone, Copy)]
pub struct World<'a> {
    /// Time, s.
    pub t_s: f64,
    /// Where the machine is and how it moves.
    pub truth: &'a Truth,
    /// What damaged propellers shake.
    pub vibration: &'a Vibration,
    /// What each rotor's speed would make in thrust, without a fault, N.
    pub rotor_n: &'a [f64; 4],
    /// The air.
    pub gust: &'a Gust,
    /// Voltage that is left of a healthy battery's, a share.
    pub voltage: f64,
}

/// The random numbers of one sensor, of its first unit or of its second.
fn stream(seed: u64, sensor: Sensor, unit: u8) -> chance::Chance {
    chance::Chance(random_of(seed, Stream::Sensor, 2 * sensor as u8 + unit - 1))
}

fn narrow<F: Copy>(v: &Vector3<f64>) -> Vec3<F> {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

/// Rotation by a small vector: exact for its quaternion, orthogonal to rounding.
fn small_rotation(vector_rad: Vector3<f64>) -> Matrix3<f64> {
    let q = nalgebra::Quaternion::from_parts(1.0, vector_rad * 0.5);
    nalgebra::UnitQuaternion::from_quaternion(q).to_rotation_matrix().into_inner()
}
