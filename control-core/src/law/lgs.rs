//! The robust Lyapunov-gain-scheduled adaptation, the one that flies.
//!
//! ```text
//! w   = ë + λ ė + α s + β tanh(s/ε)                 what eq 22 says of the missing command
//! r   = dz(w, d)                                    below the noise nothing is learnt
//! n²  = 1 + Σ (k0_j Π_j / u_s)²                     a large regressor does not speed it up
//! k̇_j = ν_j Π_j r / n² − σ (k_j − k0_j),   k_j held in [0.4, 3] k0_j
//! κ̇_j = (ν_j / k0_j²) (k0_j Π_j) r / n² − σ (κ_j − 1)      the same for κ_j = k_j / k0_j, as it is computed
//! ```
//!
//! | symbol | code        | unit                            |
//! |--------|-------------|---------------------------------|
//! | α, λ   | `alpha`, `lambda` | 1/s                       |
//! | β      | `beta`      | unit of s per second            |
//! | ε      | `eps`       | unit of s                       |
//! | d      | `dead_zone` | unit of s per second            |
//! | σ      | `leak_1_s`  | 1/s                             |
//! | u_s    | `scale`     | unit of the command             |
//!
//! r is zero while it pushes further into saturation. Near hover the k_i law acts as an extra PID and an integral of
//! tanh, with gain ν_i I²: gravity rides on the integral, so that a loss of thrust is a loss of gain, and k_i learns
//! 1/(1 − loss).
//!
//! Invariants: every gain within its bounds, so every gain positive; n² ≥ 1, so the only divisor is away from zero.
//! What follows from them is in docs/theory.md, "How fast gains move" and after it.
//! Source: docs/control-law.md, "lgs"; it repairs the paper's eq 21 to 23.
use super::{Lesson, Regressor};
use crate::Scalar;
use crate::math::{dead_zone, tanh};

/// Smallest gain over its start: the projection's lower bound.
pub const GAIN_RATIO_MIN: f32 = 0.4;
/// Largest gain over its start: the projection's upper bound.
pub const GAIN_RATIO_MAX: f32 = 3.0;

/// The robust adaptation of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LgsGains {
    /// Adaptation rates (ν_p, ν_i, ν_d).
    pub nu: [f32; 3],
    /// Proportional reaching rate α, 1/s.
    pub alpha: f32,
    /// Switching gain β, in units of s per second.
    pub beta: f32,
    /// Boundary-layer width ε, in units of s.
    pub eps: f32,
    /// Slope λ of s = ė + λ e, 1/s.
    pub lambda: f32,
    /// Half-width d of the dead zone, in units of s per second.
    pub dead_zone: f32,
    /// Leak σ towards the starting gains, 1/s.
    pub leak_1_s: f32,
    /// Command scale u_s of the normalisation.
    pub scale: f32,
}

/// The adaptation in the scalar that flies.
#[derive(Clone, Debug)]
pub(super) struct Lgs<S> {
    /// ν_j / k0_j²: what a term k0_j Π_j teaches its ratio.
    rates: [S; 3],
    /// 1 / u_s².
    scale_inverse_squared: S,
    alpha: S,
    beta: S,
    eps_inverse: S,
    lambda: S,
    dead_zone: S,
    leak_1_s: S,
}

impl<S: Scalar> Lgs<S> {
    pub(super) fn new(gains: &LgsGains, start: &[f32; 3]) -> Self {
        let s = S::from_f32;
        let rate = |i: usize| s(gains.nu[i] / (start[i] * start[i]));
        Self {
            rates: [rate(0), rate(1), rate(2)],
            scale_inverse_squared: s(1.0 / (gains.scale * gains.scale)),
            alpha: s(gains.alpha),
            beta: s(gains.beta),
            eps_inverse: s(1.0 / gains.eps),
            lambda: s(gains.lambda),
            dead_zone: s(gains.dead_zone),
            leak_1_s: s(gains.leak_1_s),
        }
    }

    /// Moves the gain ratios by one lesson, inside their bounds.
    #[inline]
    pub(super) fn adapt(&self, ratios: &mut [S::Sum; 3], regressor: &Regressor<S>, lesson: &Lesson<S>) {
        let drive = self.drive(regressor, lesson.refused);
        let bounds = (S::from_f32(GAIN_RATIO_MIN), S::from_f32(GAIN_RATIO_MAX));
        for ((ratio, term), &rate) in ratios.iter_mut().zip(regressor.terms).zip(&self.rates) {
            let slope = rate * term * drive - self.leak_1_s * (S::from_sum(*ratio) - S::ONE);
            *ratio = S::integrate(*ratio, slope, lesson.dt_s, bounds);
        }
    }

    /// r / n²: the normalised missing command, zero where it must not teach.
    #[inline]
    fn drive(&self, regressor: &Regressor<S>, refused: S) -> S {
        let [_, _, e_rate] = regressor.pi;
        let s = regressor.s;
        let missing =
            regressor.error_accel + self.lambda * e_rate + self.alpha * s + self.beta * tanh(s * self.eps_inverse);
        let residual = dead_zone(missing, self.dead_zone);
        let stuck = S::ZERO.lt(refused * residual);
        let [p, i, d] = regressor.terms;
        let norm = S::ONE + (p * p + i * i + d * d) * self.scale_inverse_squared;
        S::select(stuck, S::ZERO, residual / norm)
    }
}
