//! Dead reckoning: inertial samples to attitude, velocity and position, the estimator's fast path.
//!
//! ```text
//! α = (ω − b_g) τ                   β = (f − b_a) τ                        what the sample adds, over its own time τ
//! φ = α + α⁻ × α / 12               δ = β + α × β / 2 + (α⁻ × β + β⁻ × α) / 12
//! q ← q ⊗ exp(φ)                    v ← v + R δ + g τ                      p ← p + (v⁻ + v) τ / 2
//! ```
//!
//! The twelfths are the coning and sculling corrections for samples that are means since the last one, in which the rate changes
//! linearly; without them a rotor's vibration about two axes reads as a turn about the third.
//! Position is summed in two parts, so that 1 mm/s is not lost in the last place of 1 km.
//!
//! Source: Savage, Strapdown Inertial Navigation Integration Algorithm Design (1998), parts 1 and 2.
use super::quaternion::Quaternion;
use crate::GRAVITY_M_S2;
use crate::frames::{Attitude, Body, Ned, Vec3};

/// Attitude, velocity, position and biases as they are believed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nominal {
    pub(crate) rotation: Quaternion,
    pub(crate) velocity_m_s: Vec3<Ned>,
    /// Where the last covariance step was, m.
    pub(crate) position_m: Vec3<Ned>,
    /// Way since then, m.
    travelled_m: Vec3<Ned>,
    /// What rounding took off the position, m.
    carry_m: Vec3<Ned>,
    pub(crate) gyro_bias_rad_s: Vec3<Body>,
    pub(crate) accelerometer_bias_m_s2: Vec3<Body>,
    /// α and β of the last sample.
    last: [Vec3<Body>; 2],
}

impl Nominal {
    /// Still at the origin in this attitude.
    pub(crate) fn at_rest(rotation: Quaternion, gyro_bias_rad_s: Vec3<Body>) -> Self {
        Self {
            rotation,
            velocity_m_s: Vec3::zero(),
            position_m: Vec3::zero(),
            travelled_m: Vec3::zero(),
            carry_m: Vec3::zero(),
            gyro_bias_rad_s,
            accelerometer_bias_m_s2: Vec3::zero(),
            last: [Vec3::zero(); 2],
        }
    }

    /// Where it is now, m.
    pub(crate) fn position_now_m(&self) -> Vec3<Ned> {
        self.position_m + self.travelled_m
    }

    /// Adds one sample; returns its gain of velocity by specific force, NED, m/s.
    ///
    /// - `attitude`: of [`Self::rotation`] before the sample.
    pub(crate) fn advance(
        &mut self,
        attitude: &Attitude,
        rate_rad_s: Vec3<Body>,
        specific_force_m_s2: Vec3<Body>,
        dt_s: f32,
    ) -> Vec3<Ned> {
        let (alpha, beta) = (rate_rad_s * dt_s, specific_force_m_s2 * dt_s);
        let [last_alpha, last_beta] = self.last;
        let turned = alpha + last_alpha.cross(alpha) * (1.0 / 12.0);
        let sculled = (last_alpha.cross(beta) + last_beta.cross(alpha)) * (1.0 / 12.0);
        let pushed_m_s = attitude.to_ned(beta + alpha.cross(beta) * 0.5 + sculled);
        let before_m_s = self.velocity_m_s;
        self.velocity_m_s = before_m_s + pushed_m_s;
        self.velocity_m_s.z += GRAVITY_M_S2 * dt_s;
        self.travelled_m = self.travelled_m + (before_m_s + self.velocity_m_s) * (0.5 * dt_s);
        self.rotation = self.rotation.after(Quaternion::exp(turned));
        self.last = [alpha, beta];
        pushed_m_s
    }

    /// Moves the way travelled into the position, and what rounding takes off into the carry.
    pub(crate) fn settle(&mut self) {
        let way_m = self.travelled_m + self.carry_m;
        let there_m = self.position_m + way_m;
        self.carry_m = way_m - (there_m - self.position_m);
        (self.position_m, self.travelled_m) = (there_m, Vec3::zero());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOVER: Vec3<Body> = Vec3::new(0.0, 0.0, -GRAVITY_M_S2);

    #[test]
    fn a_slow_drift_far_from_home_is_not_lost() {
        let mut nominal = Nominal::at_rest(Quaternion::IDENTITY, Vec3::zero());
        nominal.position_m.x = 1000.0;
        nominal.velocity_m_s.x = 0.001;
        for _ in 0..20_000 {
            nominal.advance(&Attitude::level(), Vec3::zero(), HOVER, 0.0005);
            nominal.settle();
        }
        let way_m = nominal.position_now_m().x + nominal.carry_m.x - 1000.0;
        assert!((way_m - 0.01).abs() < 2e-4, "{way_m}");
    }

    #[test]
    fn coning_does_not_read_as_a_turn() {
        // Two axes wobble a quarter of a period apart, as under an unbalanced rotor: the true mean turn about z follows from the closed form
        // of the motion, q(t) = exp(θ (cos Ωt, sin Ωt, 0)), whose body rates are differenced below in f64.
        let (wobble_rad, omega) = (0.01_f64, 2.0 * core::f64::consts::PI * 50.0);
        let rates = |t: f64| {
            let (sin, cos) = (libm::sin(omega * t), libm::cos(omega * t));
            let (s, c) = (libm::sin(wobble_rad), libm::cos(wobble_rad));
            [-omega * s * sin, omega * s * cos, -omega * (1.0 - c)]
        };
        let mut nominal = Nominal::at_rest(Quaternion::exp(Vec3::<Body>::new(0.01, 0.0, 0.0)), Vec3::zero());
        let (dt_s, fine) = (0.002, 20);
        for i in 0..5000_u32 {
            let mut mean = [0.0; 3];
            for j in 0..fine {
                let at = rates((f64::from(i) + (f64::from(j) + 0.5) / f64::from(fine)) * dt_s);
                for (mean, at) in mean.iter_mut().zip(at) {
                    *mean += at / f64::from(fine);
                }
            }
            let [x, y, z] = mean.map(|x| x as f32);
            let attitude = nominal.rotation.attitude();
            nominal.advance(&attitude, Vec3::new(x, y, z), HOVER, dt_s as f32);
        }
        // Ten seconds are 500 periods: it is back where it began. Uncorrected, z would be off by 0.05 rad.
        let off = nominal.rotation.small_angle::<Ned>();
        assert!((off.x - 0.01).abs() < 1e-3 && off.y.abs() < 1e-3 && off.z.abs() < 3e-3, "{off:?}");
    }
}
