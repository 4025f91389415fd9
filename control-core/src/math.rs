//! Elementary functions: the only door to a transcendental.
//!
//! Every function is arithmetic over [`Scalar`], the same in every number format, except the square root (correctly rounded
//! in each) and [`sin`] and [`cos`] (`micromath`). Largest error measured by the tests below; instructions a call on
//! the Cortex-M4F by `cargo xtask count`.
//!
//! | function     | domain       | largest error | chosen over |
//! |--------------|--------------|---------------|-------------|
//! | [`tanh`]     | all          | 1.0e-4        | libm: four times the instructions for accuracy the law cannot use: tanh only softens a sign |
//! | [`atan2`]    | all          | 1.2e-5 rad    | micromath: its 2.8e-3 rad would be a heading bias |
//! | [`asin`]     | ±0.95        | 4.0e-5 rad    | micromath: its 0.018 rad is a tenth of a hover tilt |
//! | square root  | ≥ 0          | correctly rounded | micromath: 6 % off, which is 6 % of the tilt |
//! | [`sin`], [`cos`] | ±1e3 rad | 1.2e-3        | libm: 1250 instructions; no law calls these, only synthetic motion does |
use crate::Scalar;
use core::f32::consts::{FRAC_PI_2, PI};

/// Largest argument [`asin`] is accurate for; larger ones are held there.
pub const ASIN_ARGUMENT_MAX: f32 = 0.95;

/// Evaluates a polynomial, lowest coefficient first.
fn polynomial<S: Scalar, const N: usize>(x: S, coefficients: [f32; N]) -> S {
    coefficients.iter().rev().map(|&c| S::from_f32(c)).reduce(|sum, c| sum * x + c).unwrap_or(S::ZERO)
}

/// Constant term of the approximant of tanh, by which its coefficients are divided.
const UNIT: f32 = 135_135.0;

/// Hyperbolic tangent, by its Padé approximant 7/6 held at ±1.
///
/// Written in `(x/4)²`, so that no coefficient leaves the range of Q16.16.
///
/// # Source
/// Continued fraction of tanh, truncated at the seventh term.
pub fn tanh<S: Scalar>(x: S) -> S {
    // Beyond this argument the approximant would pass 1.
    let limit = S::from_f32(4.97 / 4.0);
    let quarter = (x * S::from_f32(0.25)).clamp(-limit, limit);
    let y = quarter * quarter;
    let numerator = polynomial(y, [4.0, 4.0 * 17_325.0 * 16.0 / UNIT, 4.0 * 378.0 * 256.0 / UNIT, 4.0 * 4096.0 / UNIT]);
    let denominator = polynomial(y, [1.0, 62_370.0 * 16.0 / UNIT, 3150.0 * 256.0 / UNIT, 28.0 * 4096.0 / UNIT]);
    quarter * numerator / denominator
}

/// Angle of the point `(x, y)`, rad in −π..=π; 0 for the origin.
///
/// # Source
/// Abramowitz and Stegun 4.4.47, on the octant where the ratio is at most 1.
pub fn atan2<S: Scalar>(y: S, x: S) -> S {
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ax.lt(ay);
    let (short, long) = (S::select(steep, ax, ay), S::select(steep, ay, ax));
    // Away from zero; for the origin the quotient is then 0.
    let ratio = short / long.max(S::from_f32(f32::EPSILON * 256.0));
    let odd = polynomial(ratio * ratio, [0.999_866, -0.330_299_5, 0.180_141, -0.085_133, 0.020_835_1]);
    let octant = ratio * odd;
    let quadrant = S::select(steep, S::from_f32(FRAC_PI_2) - octant, octant);
    let half = S::select(x.lt(S::ZERO), S::from_f32(PI) - quadrant, quadrant);
    S::select(y.lt(S::ZERO), -half, half)
}

/// Arc sine, rad; the argument is held within ±[`ASIN_ARGUMENT_MAX`].
///
/// # Source
/// Minimax rational 2/2 of asin(x)/x in x², fitted on that domain.
pub fn asin<S: Scalar>(x: S) -> S {
    let limit = S::from_f32(ASIN_ARGUMENT_MAX);
    let x = x.clamp(-limit, limit);
    let y = x * x;
    let numerator = polynomial(y, [1.000_288_7, -1.146_675, 0.237_812_3]);
    let denominator = polynomial(y, [1.0, -1.310_267_8, 0.372_169_96]);
    x * numerator / denominator
}

/// `angle_rad` less the whole turn that brings it nearest zero, for an argument within ±3π.
pub fn wrap_pi<S: Scalar>(angle_rad: S) -> S {
    let (pi, turn) = (S::from_f32(PI), S::from_f32(2.0 * PI));
    let below = S::select(pi.lt(angle_rad), angle_rad - turn, angle_rad);
    S::select(below.lt(-pi), below + turn, below)
}

/// What is left of `x` outside ±`half_width`: continuous, zero inside.
pub fn dead_zone<S: Scalar>(x: S, half_width: S) -> S {
    x - x.clamp(-half_width, half_width)
}

/// Sine, for synthetic motion on the board; no law calls it.
pub fn sin(angle_rad: f32) -> f32 {
    micromath::F32Ext::sin(angle_rad)
}

/// Cosine, for synthetic motion on the board; no law calls it.
pub fn cos(angle_rad: f32) -> f32 {
    micromath::F32Ext::cos(angle_rad)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest |approximation − reference| over evenly spaced arguments.
    fn worst(range: (f64, f64), approximation: impl Fn(f64) -> f64, reference: fn(f64) -> f64) -> f64 {
        const STEPS: u32 = 100_000;
        (0..=STEPS)
            .map(|i| range.0 + (range.1 - range.0) * f64::from(i) / f64::from(STEPS))
            .map(|x| (approximation(x) - reference(x)).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn documented_errors_hold_in_f32() {
        let f32_of = |f: fn(f32) -> f32| move |x: f64| f64::from(f(x as f32));
        for (name, error, bound) in [
            ("tanh", worst((-20.0, 20.0), f32_of(tanh), libm::tanh), 1.0e-4),
            ("asin", worst((-0.95, 0.95), f32_of(asin), libm::asin), 4.0e-5),
            ("sin", worst((-1e3, 1e3), f32_of(sin), libm::sin), 1.2e-3),
            ("cos", worst((-1e3, 1e3), f32_of(cos), libm::cos), 1.2e-3),
        ] {
            assert!(error <= bound, "{name}: {error:e} > {bound:e}");
            assert!(error >= 0.5 * bound, "{name}: documented {bound:e}, measured {error:e}");
        }
    }

    #[test]
    fn atan2_is_accurate_all_round() {
        let error = worst(
            (-0.999 * core::f64::consts::PI, 0.999 * core::f64::consts::PI),
            |a| f64::from(atan2(3.0 * libm::sin(a) as f32, 3.0 * libm::cos(a) as f32)),
            |a| a,
        );
        assert!((0.6e-5..=1.2e-5).contains(&error), "{error:e}");
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }

    #[cfg(feature = "fixed")]
    #[test]
    fn fixed_point_is_within_a_few_units_of_f32() {
        use crate::Q16;
        let q = |f: fn(Q16) -> Q16| move |x: f64| f64::from(f(Q16::from_f32(x as f32)).to_f32());
        assert!(worst((-20.0, 20.0), q(tanh), libm::tanh) < 2.5e-4);
        assert!(worst((-0.95, 0.95), q(asin), libm::asin) < 5e-4);
    }

    #[test]
    fn tanh_is_bounded_and_survives_infinity() {
        for x in [f32::INFINITY, 1e30, 5.0] {
            assert!((0.999..=1.0).contains(&tanh(x)));
            assert_eq!(tanh(-x), -tanh(x));
        }
    }

    #[test]
    fn wrapping_goes_the_short_way() {
        for (angle, want) in [(3.5, 3.5 - 2.0 * PI), (-3.5, 2.0 * PI - 3.5), (1.0, 1.0), (3.0 * PI, PI)] {
            assert!((wrap_pi::<f32>(angle) - want).abs() < 1e-5, "{angle}");
        }
    }
}
