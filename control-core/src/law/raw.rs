//! The paper's adaptation, exactly as printed: eq 15, 19, 20, 23 and Table 2.
//!
//! ```text
//! s_j = ė + λ_j e        k̇_j = ν_j Π_j (ṡ_j + α_j s_j + β_j tanh(s_j / ε_j))        j ∈ {p, i, d}
//! ```
//!
//! Each gain has its own s, so there is no common u* to converge to (docs/control-law.md, erratum to Table 2), and nothing
//! bounds the gains. It is kept to reproduce the paper; it crashes with actuators that saturate. There its integral waits in
//! saturation like that of every law here, which the paper, without saturation, does not speak of.
use super::Regressor;
use crate::Scalar;
use crate::math::tanh;

/// One row of Table 2: the adaptation of one gain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawGains {
    /// Proportional reaching rate α, 1/s.
    pub alpha: f32,
    /// Boundary-layer width ε, in units of s.
    pub eps: f32,
    /// Switching gain β, in units of s per second.
    pub beta: f32,
    /// Adaptation rate ν.
    pub nu: f32,
    /// Slope λ, 1/s.
    pub lambda: f32,
}

const fn row(alpha: f32, beta: f32, nu: f32, lambda: f32) -> RawGains {
    RawGains { alpha, eps: 0.001, beta, nu, lambda }
}

/// Table 2, altitude: rows k_p, k_i, k_d.
pub const TABLE_2_Z: [RawGains; 3] = [row(20.0, 10.0, 3.0, 5.0), row(10.0, 20.0, 4.0, 20.0), row(18.0, 2.0, 0.5, 1.0)];
/// Table 2, x.
pub const TABLE_2_X: [RawGains; 3] = [row(22.0, 12.0, 1.27, 2.1), row(20.0, 2.0, 1.4, 2.0), row(8.0, 1.2, 5.0, 3.0)];
/// Table 2, y.
pub const TABLE_2_Y: [RawGains; 3] = [row(12.0, 6.0, 3.7, 2.0), row(13.0, 3.7, 5.4, 2.5), row(9.0, 2.0, 5.2, 2.0)];
/// Table 2, heading.
pub const TABLE_2_PSI: [RawGains; 3] = [row(7.0, 4.0, 7.0, 1.7), row(8.0, 3.0, 5.0, 2.0), row(11.4, 2.0, 2.0, 1.0)];

/// Adaptation of one gain, in the scalar that flies.
#[derive(Clone, Copy, Debug)]
struct Row<S> {
    alpha: S,
    eps_inverse: S,
    beta: S,
    /// ν over the starting gain.
    nu_ratio: S,
    lambda: S,
}

/// Adaptation of the three gains of an axis.
#[derive(Clone, Debug)]
pub(super) struct Raw<S>([Row<S>; 3]);

/// Not a bound of the law, which has none: where the number format ends.
const RATIO_MAX: f32 = 30_000.0;

impl<S: Scalar> Raw<S> {
    pub(super) fn new(gains: &[RawGains; 3], start: &[f32; 3]) -> Self {
        let s = S::from_f32;
        let row = |i: usize| Row {
            alpha: s(gains[i].alpha),
            eps_inverse: s(1.0 / gains[i].eps),
            beta: s(gains[i].beta),
            nu_ratio: s(gains[i].nu / start[i]),
            lambda: s(gains[i].lambda),
        };
        Self([row(0), row(1), row(2)])
    }

    /// Moves the gain ratios by one tick of eq 23.
    pub(super) fn adapt(&self, ratios: &mut [S::Sum; 3], regressor: &Regressor<S>, dt_s: S) {
        let [e, _, e_rate] = regressor.pi;
        let bounds = (S::from_f32(-RATIO_MAX), S::from_f32(RATIO_MAX));
        for ((ratio, row), pi) in ratios.iter_mut().zip(&self.0).zip(regressor.pi) {
            let s = e_rate + row.lambda * e;
            let s_rate = regressor.error_accel + row.lambda * e_rate;
            let drive = s_rate + row.alpha * s + row.beta * tanh(s * row.eps_inverse);
            *ratio = S::integrate(*ratio, row.nu_ratio * pi * drive, dt_s, bounds);
        }
    }
}
