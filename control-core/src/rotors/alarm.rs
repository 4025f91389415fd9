//! The detector's two ends: what it takes for ordinary, and what it says when it has found something.
//!
//! In between is `health.rs`. Source: docs/control-law.md, "Watching the rotors".
use crate::Scalar;

/// What the detector takes for ordinary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorConfig {
    /// Loss that is looked for, as a share of the thrust.
    pub loss: f32,
    /// S that is an alarm, nats.
    pub alarm_nats: f32,
    /// White noise of the gyro, a tick, rad/s.
    pub gyro_noise_rad_s: f32,
    /// White noise of the accelerometer, a tick, m/s².
    pub accelerometer_noise_m_s2: f32,
    /// Torque of the weather about each axis, root mean square, N m.
    pub torque_rms_nm: f32,
    /// Vertical force of the weather, root mean square, N.
    pub force_rms_n: f32,
}

impl DetectorConfig {
    /// The sensors and the weather of the shipped scenarios.
    pub const NOMINAL: Self = Self {
        loss: 0.3,
        alarm_nats: 7.0,
        gyro_noise_rad_s: 0.01,
        accelerometer_noise_m_s2: 0.2,
        torque_rms_nm: 0.01,
        force_rms_n: 0.15,
    };
}

/// A loss that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alarm<S = f32> {
    /// The rotor, 0 to 3; `None` if all lost alike.
    pub rotor: Option<usize>,
    /// Whether it pulls more than it is told.
    pub stuck: bool,
    /// How long before the alarm it began, s.
    pub onset_age_s: S,
    /// Share of the thrust that is lost now; of a stuck rotor, what a quarter of the weight exceeds its thrust by, as a share of it.
    pub loss: S,
    /// Probability that it is this one rather than the next likeliest, or none.
    pub confidence: S,
}

impl<S: Scalar> Alarm<S> {
    /// The same in the format of logs.
    pub(super) fn to_f32(self) -> Alarm {
        Alarm {
            rotor: self.rotor,
            stuck: self.stuck,
            onset_age_s: self.onset_age_s.to_f32(),
            loss: self.loss.to_f32(),
            confidence: self.confidence.to_f32(),
        }
    }
}
