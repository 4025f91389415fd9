//! Gives the heading up while the machine spins, and only brakes.
//!
//! A rotor too weak for yaw makes the body spin. Chasing the heading then swings full yaw demand round with every
//! turn; braking alone lets it settle, and the error, wrapped at ±π, is small when the heading is taken up again.
//!
//! Trips when yaw is saturated and off by more than 0.35 rad for 0.2 s, or beyond 2.5 rad/s; lets go below 0.3 rad/s.
//! Source: docs/control-law.md, "Guidance, allocation, yaw guard".
use crate::{Mask, Scalar};

const ERROR_RAD_MAX: f32 = 0.35;
const SATURATED_S_MAX: f32 = 0.2;
const SPIN_RAD_S: f32 = 2.5;
const SETTLED_RAD_S: f32 = 0.3;

/// Whether the guard is braking, and how close it is to it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct YawGuard<S: Scalar> {
    braking: S::Mask,
    saturated_s: S,
}

impl<S: Scalar> YawGuard<S> {
    pub(crate) fn new() -> Self {
        Self { braking: S::Mask::splat(false), saturated_s: S::ZERO }
    }

    /// Whether it brakes since the last sample.
    pub(crate) fn is_braking(&self) -> S::Mask {
        self.braking
    }

    /// Takes one sample of heading error, yaw rate and refused yaw torque; returns whether to brake only.
    pub(crate) fn step(&mut self, error_rad: S, rate_rad_s: S, refused_nm: S, dt_s: S) -> S::Mask {
        let s = S::from_f32;
        let (error, rate) = (error_rad.abs(), rate_rad_s.abs());
        let losing = S::ZERO.lt(refused_nm.abs()) & s(ERROR_RAD_MAX).lt(error);
        // Held at the limit, which is all it is compared with.
        let longer = (self.saturated_s + dt_s).min(s(SATURATED_S_MAX));
        self.saturated_s = S::select(losing, longer, S::ZERO);
        let trips = !self.saturated_s.lt(s(SATURATED_S_MAX)) | s(SPIN_RAD_S).lt(rate);
        self.braking = (self.braking | trips) & !rate.lt(s(SETTLED_RAD_S));
        self.braking
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f32 = 0.002;

    fn after(samples: &[(f32, f32, f32)]) -> bool {
        let mut guard = YawGuard::<f32>::new();
        samples.iter().fold(false, |_, &(error, rate, refused)| guard.step(error, rate, refused, DT_S))
    }

    #[test]
    fn trips_and_lets_go_as_stated() {
        let losing = [(0.4, 0.5, 0.01); 101];
        for (why, samples, want) in [
            ("spinning fast trips at once", &[(0.0, 2.6, 0.0)][..], true),
            ("a large error alone does not", &[(3.0, 0.0, 0.0); 500], false),
            ("losing for less than 0.2 s does not", &losing[..99], false),
            ("losing for 0.2 s does", &losing, true),
            ("holds while it still turns", &[(0.0, 2.6, 0.0), (0.0, 0.31, 0.0)], true),
            ("lets go once it has settled", &[(0.0, 2.6, 0.0), (0.0, 0.29, 0.0)], false),
        ] {
            assert_eq!(after(samples), want, "{why}");
        }
    }
}
