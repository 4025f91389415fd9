//! First-order low-pass, and the slope it knows for free.
//!
//! ```text
//! y ← y + a (x − y)        a = ω dt / (1 + ω dt)        ω = 2π f_c        ẏ ≈ ω / (1 + ω dt) · (x − y)
//! ```
//!
//! Backward Euler, so `0 < a < 1` for any positive step: the state never leaves the hull of its inputs.
use crate::Scalar;

/// Coefficients for one step, shared by every filter of the tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LowPass<S> {
    /// Slope per unit of distance to the input, 1/s.
    slope_per_s: S,
    dt_s: S,
}

impl<S: Scalar> LowPass<S> {
    /// A filter of corner `corner_rad_s` for the step `dt_s`, both positive.
    pub(crate) fn new(corner_rad_s: S, dt_s: S) -> Self {
        Self { slope_per_s: corner_rad_s / (S::ONE + corner_rad_s * dt_s), dt_s }
    }

    /// Moves `y` towards `x`; returns the slope of `y`, in units of `y` per second.
    pub(crate) fn step(&self, y: &mut S, x: S) -> S {
        let slope = self.slope_per_s * (x - *y);
        *y = *y + slope * self.dt_s;
        slope
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settles_on_a_constant_and_reports_its_slope() {
        let filter = LowPass::new(157.0_f32, 0.002);
        let mut y = 0.0;
        let first = filter.step(&mut y, 1.0);
        assert!((first * 0.002 - y).abs() < 1e-6, "slope is what moved");
        for _ in 0..100 {
            filter.step(&mut y, 1.0);
        }
        assert!((y - 1.0).abs() < 1e-6);
    }

    #[test]
    fn stays_in_the_hull_of_its_inputs_at_any_step() {
        for dt_s in [1e-6, 0.002, 10.0] {
            let filter = LowPass::new(157.0_f32, dt_s);
            let mut y = 0.0;
            for i in 0..1000 {
                filter.step(&mut y, if i % 3 == 0 { 1.0 } else { -1.0 });
                assert!((-1.0..=1.0).contains(&y), "{dt_s}: {y}");
            }
        }
    }
}
