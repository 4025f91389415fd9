//! Measurements: what sensors say, each with the time at which it was true.
//!
//! Drivers and sensor models fill these in and nothing else; what of it is believed is for the estimator to decide.
//! Times are of one clock, µs since boot, and 64 bits long: they do not roll over.
use crate::frames::{Attitude, Body, Ned, Vec3};

/// A value with the time at which it was true.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamped<T> {
    /// When, µs since boot. For an inertial sample, the end of the span that it averages.
    pub time_us: u64,
    /// What.
    pub value: T,
}

/// A sample of the inertial unit: means since the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    /// Body rates, rad/s.
    pub rate_rad_s: Vec3<Body>,
    /// Specific force, m/s².
    pub specific_force_m_s2: Vec3<Body>,
}

/// A satellite fix, in the local frame (`geodesy` makes it one).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gnss {
    /// Position from the origin, m.
    pub position_m: Vec3<Ned>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<Ned>,
    /// The receiver's own estimate of its error, horizontal, 1 σ, m.
    pub horizontal_m: f32,
    /// The same, vertical, m.
    pub vertical_m: f32,
    /// The same of velocity, m/s.
    pub speed_m_s: f32,
    /// Whether the receiver has a three-dimensional fix.
    pub fixed: bool,
}

/// Angular rate of the ground's image, gyro not taken off, from an optical-flow sensor that looks along body down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flow {
    /// Apparent rotation about body x and y, rad/s; above still ground it equals the body rates.
    pub rate_rad_s: [f32; 2],
    /// Share of the image that was tracked, 0 to 1.
    pub quality: f32,
}

/// A pose from outside: motion capture, or visual odometry in a known frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vision {
    /// Position, m.
    pub position_m: Vec3<Ned>,
    /// Body to NED.
    pub attitude: Attitude,
    /// Its own estimate of its error in position, 1 σ, m.
    pub position_sigma_m: f32,
    /// The same in attitude, rad.
    pub attitude_sigma_rad: f32,
}

/// Everything that arrived since the last look; absent where nothing did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measurements {
    /// Inertial unit.
    pub imu: Option<Stamped<Imu>>,
    /// A second one, where there are two.
    pub imu_second: Option<Stamped<Imu>>,
    /// Barometer: altitude in the standard atmosphere, above where it was switched on, m.
    pub baro_altitude_m: Option<Stamped<f32>>,
    /// A second one, where there are two.
    pub baro_second_altitude_m: Option<Stamped<f32>>,
    /// Magnetometer, µT.
    pub magnetic_ut: Option<Stamped<Vec3<Body>>>,
    /// Satellite receiver.
    pub gnss: Option<Stamped<Gnss>>,
    /// Distance to the ground along body down, m.
    pub range_m: Option<Stamped<f32>>,
    /// Optical flow.
    pub flow: Option<Stamped<Flow>>,
    /// External vision.
    pub vision: Option<Stamped<Vision>>,
    /// Speed of each rotor, rad/s, in airframe order, from the speed controllers' telemetry.
    pub rotor_rad_s: Option<Stamped<[f32; 4]>>,
    /// Battery voltage, V.
    pub battery_v: Option<Stamped<f32>>,
    /// Current out of the battery, A.
    pub battery_a: Option<Stamped<f32>>,
}
