//! How far an estimate is from the truth.
//!
//! ```text
//! R = exp(θ) R̂, world axes        every other error: true less estimate
//! ```
//!
//! These are the errors whose covariance the estimator keeps.
use crate::plant::Truth;
use control_core::estimate::Estimate;
use control_core::frames::Vec3;
use nalgebra::{Matrix3, Vector3};

/// Errors of one estimate, NED.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Apart {
    /// Turn from the estimated attitude to the true one, as a rotation vector, rad: tilt in x and y, heading in z.
    pub attitude_rad: Vector3<f64>,
    /// m/s.
    pub velocity_m_s: Vector3<f64>,
    /// m.
    pub position_m: Vector3<f64>,
}

pub(super) fn wide<F: Copy>(v: Vec3<F>) -> Vector3<f64> {
    Vector3::new(v.x.into(), v.y.into(), v.z.into())
}

impl Apart {
    /// The errors of `estimate` where the truth is `truth`, at the same time.
    pub fn of(truth: &Truth, estimate: &Estimate) -> Self {
        let rows = estimate.attitude.rows;
        let turn = truth.attitude * Matrix3::from_fn(|i, j| f64::from(rows[i][j])).transpose();
        let twice_sine =
            Vector3::new(turn[(2, 1)] - turn[(1, 2)], turn[(0, 2)] - turn[(2, 0)], turn[(1, 0)] - turn[(0, 1)]);
        let size = twice_sine.norm();
        let angle_rad = libm::atan2(size, turn.trace() - 1.0);
        Self {
            attitude_rad: if size > 0.0 { twice_sine * (angle_rad / size) } else { twice_sine },
            velocity_m_s: truth.velocity_m_s - wide(estimate.velocity_m_s),
            position_m: truth.position_m - wide(estimate.position_m),
        }
    }

    /// Error of the vertical, rad.
    pub fn tilt_rad(&self) -> f64 {
        self.attitude_rad.xy().norm()
    }

    /// Error of the heading, rad.
    pub fn heading_rad(&self) -> f64 {
        self.attitude_rad.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control_core::estimate::{Health, Sigma};
    use control_core::frames::Attitude;
    use nalgebra::Rotation3;

    #[test]
    fn an_error_is_the_turn_that_makes_the_truth_of_the_estimate() {
        for (at, by) in [
            (Vector3::new(0.3, -0.2, 2.0), Vector3::new(0.01, -0.02, 0.03)),
            (Vector3::new(1.0, 0.5, -3.0), Vector3::new(0.0, 0.0, -2.5)),
            (Vector3::zeros(), Vector3::zeros()),
        ] {
            let believed = Rotation3::from_scaled_axis(at);
            let true_one = Rotation3::from_scaled_axis(by) * believed;
            let truth = Truth {
                position_m: Vector3::new(1.0, 2.0, 3.0),
                velocity_m_s: Vector3::zeros(),
                attitude: true_one.into_inner(),
                rate_rad_s: Vector3::zeros(),
                specific_force_m_s2: Vector3::zeros(),
                thrust_n: [0.0; 4],
                impact_m_s: 0.0,
                touching: false,
            };
            let rows = std::array::from_fn(|i| std::array::from_fn(|j| believed[(i, j)] as f32));
            let estimate = Estimate {
                time_us: 0,
                position_m: Vec3::new(1.0, 1.5, 3.0),
                velocity_m_s: Vec3::new(0.5, 0.0, 0.0),
                attitude: Attitude { rows },
                rate_rad_s: Vec3::zero(),
                specific_force_m_s2: Vec3::zero(),
                gyro_bias_rad_s: Vec3::zero(),
                accelerometer_bias_m_s2: Vec3::zero(),
                sigma: Sigma::default(),
                health: Health::default(),
            };
            let apart = Apart::of(&truth, &estimate);
            assert!((apart.attitude_rad - by).norm() < 1e-6, "{:?}", apart.attitude_rad);
            assert_eq!(apart.position_m, Vector3::new(0.0, 0.5, 0.0));
            assert_eq!(apart.velocity_m_s, Vector3::new(-0.5, 0.0, 0.0));
        }
    }
}
