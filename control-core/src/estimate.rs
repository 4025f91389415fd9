//! Estimate: what is believed of the machine's motion, how well, and what of it may be flown on.
use crate::frames::{Attitude, Body, Ned, Vec3};
use crate::restart::Tape;

/// Motion, biases and their uncertainty at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// When, µs since boot.
    pub time_us: u64,
    /// Position, m.
    pub position_m: Vec3<Ned>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<Ned>,
    /// Body to NED.
    pub attitude: Attitude,
    /// Body rates, filtered, bias taken off, rad/s.
    pub rate_rad_s: Vec3<Body>,
    /// Specific force, bias taken off, m/s².
    pub specific_force_m_s2: Vec3<Body>,
    /// Gyro bias, rad/s.
    pub gyro_bias_rad_s: Vec3<Body>,
    /// Accelerometer bias, m/s².
    pub accelerometer_bias_m_s2: Vec3<Body>,
    /// Uncertainty.
    pub sigma: Sigma,
    /// What may be flown on.
    pub health: Health,
}

/// Standard deviations, from the filter's covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sigma {
    /// The larger of roll and pitch, rad.
    pub tilt_rad: f32,
    /// Heading, rad.
    pub heading_rad: f32,
    /// Horizontal velocity, m/s.
    pub horizontal_m_s: f32,
    /// Vertical velocity, m/s.
    pub vertical_m_s: f32,
    /// Horizontal position, m.
    pub horizontal_m: f32,
    /// Altitude, m.
    pub altitude_m: f32,
}

/// What of an estimate may be flown on. Each needs a source that is alive, and the ones above it; altitude does without heading, and the
/// two horizontal ones without altitude.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "six independent facts, each read by name")]
pub struct Health {
    /// Body rates: the inertial unit is alive and believed.
    pub rates: bool,
    /// Roll and pitch.
    pub tilt: bool,
    /// Heading.
    pub heading: bool,
    /// Altitude and climb rate.
    pub altitude: bool,
    /// Horizontal velocity.
    pub velocity: bool,
    /// Horizontal position.
    pub position: bool,
}

impl Estimate {
    /// All that dead reckoning goes on from.
    pub(crate) fn pass(&mut self, tape: &mut Tape) {
        tape.time(&mut self.time_us);
        tape.vector(&mut self.position_m);
        tape.vector(&mut self.velocity_m_s);
        tape.floats(self.attitude.rows.as_flattened_mut());
        tape.vector(&mut self.gyro_bias_rad_s);
        tape.vector(&mut self.accelerometer_bias_m_s2);
        let Sigma { tilt_rad, heading_rad, horizontal_m_s, vertical_m_s, horizontal_m, altitude_m } = &mut self.sigma;
        for sigma in [tilt_rad, heading_rad, horizontal_m_s, vertical_m_s, horizontal_m, altitude_m] {
            tape.float(sigma);
        }
        let Health { rates, tilt, heading, altitude, velocity, position } = &mut self.health;
        tape.bits([rates, tilt, heading, altitude, velocity, position]);
    }
}
