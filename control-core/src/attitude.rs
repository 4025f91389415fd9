//! Roll and pitch: angle error in, body torque out.
//!
//! ```text
//! τ = k_p e + k_i ∫e − k_d ω + (ω × I ω)
//! ```
//!
//! The derivative acts on the body rate, so a setpoint step does not kick. The gyroscopic coupling of the body is
//! fed forward: without it a spinning machine with a weak rotor tumbles.
use crate::Scalar;
use crate::config::{ConfigError, positive};

/// Fixed gains of one attitude axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeGains {
    /// N m per rad.
    pub kp: f32,
    /// N m per rad s.
    pub ki: f32,
    /// N m per rad/s.
    pub kd: f32,
}

/// Bound of the angle integral, rad s: with the flight gains a seventh of full roll torque.
const INTEGRAL_RAD_S_MAX: f32 = 0.1;

/// One attitude axis, configured.
#[derive(Clone, Debug)]
pub(crate) struct AttitudeLaw<S> {
    kp: S,
    ki: S,
    kd: S,
}

/// What one attitude axis sees in one tick.
#[derive(Clone, Copy)]
pub(crate) struct AttitudeInput<S> {
    pub(crate) error_rad: S,
    pub(crate) rate_rad_s: S,
    /// What the last tick refused of this torque.
    pub(crate) refused_nm: S,
    pub(crate) dt_s: S,
}

impl<S: Scalar> AttitudeLaw<S> {
    /// The law with these gains; `name` leads the field names of errors.
    pub(crate) fn try_new(name: &'static str, gains: &AttitudeGains) -> Result<Self, ConfigError> {
        for (field, value) in [("kp", gains.kp), ("ki", gains.ki), ("kd", gains.kd)] {
            positive(name, field, value)?;
        }
        let s = S::from_f32;
        Ok(Self { kp: s(gains.kp), ki: s(gains.ki), kd: s(gains.kd) })
    }

    /// Torque, N m, without the coupling.
    #[inline(always)]
    pub(crate) fn step(&self, integral: &mut S::Sum, input: &AttitudeInput<S>) -> S {
        let stuck = S::ZERO.lt(input.refused_nm * input.error_rad);
        let rate = S::select(stuck, S::ZERO, input.error_rad);
        let bound = S::from_f32(INTEGRAL_RAD_S_MAX);
        *integral = S::integrate(*integral, rate, input.dt_s, (-bound, bound));
        self.kp * input.error_rad + self.ki * S::from_sum(*integral) - self.kd * input.rate_rad_s
    }
}
