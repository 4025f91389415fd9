//! The motors' field, learnt from a machine that is held down while they run up.
//!
//! ```text
//! m = m₀ + k L        three lines with one abscissa: the machine does not move, so m₀ is earth and iron together
//! ```
use super::Refusal;
use super::normal::Normal;
use crate::Scalar;
use crate::frames::{Body, Vec3};

/// What fields are divided by to be of the size of 1, µT.
const UNIT_UT: f32 = 50.0;
/// Samples below which nothing is said, and beyond which none are summed.
const SAMPLES_MIN: u32 = 200;
const SAMPLES_MAX: u32 = 20_000;
/// Share of the load's mean square that is its variance: below, the motors were not run up.
const COVERAGE_MIN: f32 = 0.1;
/// Contradiction of the samples beyond which something is wrong, rms of an axis, µT.
const RESIDUAL_UT_MAX: f32 = 2.0;

/// What was read so far.
#[derive(Clone, Copy, Debug)]
pub struct MotorRun {
    axes: [Normal<2>; 3],
    first_ut: Option<Vec3<Body>>,
}

/// What it says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorsFound {
    /// Field of the motors at full load, µT.
    pub motors_ut: Vec3<Body>,
    /// What the samples contradict each other by, rms of the worst axis, µT.
    pub residual_ut: f32,
}

impl Default for MotorRun {
    fn default() -> Self {
        Self { axes: [Normal::EMPTY; 3], first_ut: None }
    }
}

impl MotorRun {
    /// Adds a sample of the magnetometer, uncorrected, taken while the motors bore `load`.
    pub fn note(&mut self, field_ut: Vec3<Body>, load: f32) {
        let first_ut = *self.first_ut.get_or_insert(field_ut);
        let off = (field_ut - first_ut) * (1.0 / UNIT_UT);
        if !off.norm_squared().is_finite() || !load.is_finite() {
            return;
        }
        for (axis, target) in self.axes.iter_mut().zip([off.x, off.y, off.z]) {
            if axis.samples < SAMPLES_MAX {
                // The constant first: what is left of the load then is its variance.
                axis.note(&[1.0, load], target);
            }
        }
    }

    /// What has been found.
    ///
    /// # Errors
    /// [`Refusal`] says why it would not be kept.
    pub fn solve(&self) -> Result<MotorsFound, Refusal> {
        let [x, y, z] = self.axes.map(|axis| axis.solve());
        let samples = self.axes[0].samples;
        if samples < SAMPLES_MIN {
            return Err(Refusal::TooFew { samples });
        }
        if x.coverage < COVERAGE_MIN {
            return Err(Refusal::TooNarrow { coverage: x.coverage });
        }
        let worst = x.residual_square.max(y.residual_square).max(z.residual_square);
        let residual_ut = Scalar::sqrt(worst) * UNIT_UT;
        if residual_ut.is_nan() || residual_ut > RESIDUAL_UT_MAX {
            return Err(Refusal::TooRough { residual_ut });
        }
        Ok(MotorsFound { motors_ut: Vec3::new(x.x[1], y.x[1], z.x[1]) * UNIT_UT, residual_ut })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(loads: impl Fn(u32) -> f32, samples: u32, moved_ut: f32) -> MotorRun {
        let mut run = MotorRun::default();
        for i in 0..samples {
            let load = loads(i);
            // Noise of 0.3 µT whose mean is nothing.
            let noise = ((i * 7919 % 101) as f32 / 50.0 - 1.0) * 0.5;
            let field = Vec3::new(20.0, 5.0, 43.0) + Vec3::new(3.0, -2.0, 6.0) * load;
            run.note(field + Vec3::new(noise, -noise, noise + moved_ut * (i / 300) as f32), load);
        }
        run
    }

    #[test]
    fn the_field_of_the_motors_is_found_to_a_tenth() {
        let found = run(|i| (i / 100) as f32 * 0.1, 600, 0.0).solve().unwrap();
        let off = found.motors_ut - Vec3::new(3.0, -2.0, 6.0);
        assert!(off.norm_squared() < 0.01, "{found:?}");
        assert!((found.residual_ut - 0.29).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn a_run_that_says_nothing_is_refused() {
        assert_eq!(run(|_| 0.3, 50, 0.0).solve(), Err(Refusal::TooFew { samples: 50 }));
        assert!(matches!(run(|_| 0.3, 600, 0.0).solve(), Err(Refusal::TooNarrow { .. })));
        assert!(matches!(run(|i| (i % 2) as f32 * 0.3, 600, 9.0).solve(), Err(Refusal::TooRough { .. })));
        let mut broken = MotorRun::default();
        for _ in 0..600 {
            broken.note(Vec3::new(f32::NAN, 0.0, 0.0), 0.5);
        }
        assert!(broken.solve().is_err());
    }
}
