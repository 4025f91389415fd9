//! Elementary functions: the only door to a transcendental.
//!
//! Every function is arithmetic over [`Scalar`], the same in every number format, except the square root (correctly rounded
//! in all but `f32`) and [`sin`] and [`cos`] (`micromath`). Largest error measured by the tests below; instructions a call on
//! the Cortex-M4F by `cargo xtask count`.
//!
//! | function           | domain      | largest error     | instructions | chosen over |
//! |--------------------|-------------|-------------------|--------------|-------------|
//! | [`tanh`]           | all         | 1.4e-3            | 29 | libm, 110; Padé 7/6 to 1e-4 with six more: it only softens a sign |
//! | [`atan2`]          | unit circle | 1.2e-4 rad        | 46 | micromath, 44: its 2.8e-3 rad would be a heading bias |
//! | [`asin_and_cos`]   | ±0.95       | 4e-5 rad, 1.3e-4  | 34 | micromath, 29 without the cosine: off by 0.018 rad; libm, 682 |
//! | [`Scalar::sqrt`]   | ≥ 0         | 6 ulp             | 24 | libm, 54; micromath, 16: 6 % off |
//! | [`cos_half_turn`]  | 0 to π      | 6e-6              | not counted | [`cos`], 1.2e-3: a notch has to meet its rotor |
//! | [`quarter_sin_and_cos`] | ±π/2   | 2.2e-7            | not counted | libm: reduces in f64 what may be any angle, 7 kB of flash |
//! | [`sin`], [`cos`]   | ±1e3 rad    | 1.2e-3            | 33 | libm, 1391; no law calls these, only synthetic motion |
use crate::Scalar;
use core::f32::consts::{FRAC_PI_2, PI};

/// Largest sine [`asin_and_cos`] is accurate for: that of 72 degrees.
pub const SINE_MAX: f32 = 0.95;

/// Evaluates a polynomial, lowest coefficient first.
fn polynomial<S: Scalar, const N: usize>(x: S, coefficients: [f32; N]) -> S {
    coefficients.iter().rev().map(|&c| S::from_f32(c)).reduce(|sum, c| sum * x + c).unwrap_or(S::ZERO)
}

/// Where the approximant of tanh reaches 1.
const TANH_ARGUMENT_MAX: f32 = 3.646_738_5;

/// Hyperbolic tangent, by its Padé approximant 5/4, held at ±1.
///
/// # Source
/// Continued fraction of tanh, truncated at the fifth term.
pub fn tanh<S: Scalar>(x: S) -> S {
    let x = x.clamp_abs(S::from_f32(TANH_ARGUMENT_MAX));
    let y = x * x;
    let numerator = polynomial(y, [1.0, 1.0 / 9.0, 1.0 / 945.0]);
    let denominator = polynomial(y, [1.0, 4.0 / 9.0, 1.0 / 63.0]);
    x * numerator / denominator
}

/// Added to a divisor that is not negative and may be zero: one unit in the last place of Q16.16.
const DIVISOR_MIN: f32 = 1.0 / 65536.0;

/// Angle of the point `(x, y)` near the unit circle, rad in −π..=π; 0 for the origin.
///
/// # Source
/// Minimax rational 1/1 of atan(r)/r in r² for the ratio of the smaller to the larger coordinate, without their division.
pub fn atan2<S: Scalar>(y: S, x: S) -> S {
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ax.lt(ay);
    let (short, long) = (S::select(steep, ax, ay), S::select(steep, ay, ax));
    let (short2, long2) = (short * short, long * long);
    let numerator = short * (long2 * S::from_f32(0.999_180_3) + short2 * S::from_f32(0.191_146_99));
    let denominator = long * (long2 + short2 * S::from_f32(0.515_382_4));
    let octant = numerator / (denominator + S::from_f32(DIVISOR_MIN));
    let quadrant = S::select(steep, S::from_f32(FRAC_PI_2) - octant, octant);
    let half = S::select(x.lt(S::ZERO), S::from_f32(PI) - quadrant, quadrant);
    S::select(y.lt(S::ZERO), -half, half)
}

/// An angle by its sine, and its cosine.
///
/// - `sine`: accurate within ±[`SINE_MAX`]; up to ±1.01 the results lose accuracy, but are monotonic and positive.
/// - Returns the angle in rad and a cosine that is positive.
///
/// # Source
/// Minimax rationals 2/2 in x² of asin(x)/x and of √(1 − x²), fitted on that domain.
pub fn asin_and_cos<S: Scalar>(sine: S) -> (S, S) {
    let y = sine * sine;
    let angle =
        sine * polynomial(y, [1.000_288_7, -1.146_675, 0.237_812_3]) / polynomial(y, [1.0, -1.310_267_8, 0.372_169_96]);
    let cosine =
        polynomial(y, [0.999_872_6, -1.569_200_2, 0.581_355_4]) / polynomial(y, [1.0, -1.072_608_7, 0.185_510_8]);
    (angle, cosine)
}

/// `angle_rad` less the whole turn that brings it nearest zero, for an argument within ±3π.
pub fn wrap_pi<S: Scalar>(angle_rad: S) -> S {
    let (pi, turn) = (S::from_f32(PI), S::from_f32(2.0 * PI));
    let below = S::select(pi.lt(angle_rad), angle_rad - turn, angle_rad);
    S::select(below.lt(-pi), below + turn, below)
}

/// What is left of `x` outside ±`half_width`: continuous, zero inside.
pub fn dead_zone<S: Scalar>(x: S, half_width: S) -> S {
    x - x.clamp_abs(half_width)
}

/// Cosine of an angle in 0..=π.
///
/// # Source
/// 1 − 2 sin² of half the angle, by the minimax polynomial of degree 7 of the sine on 0..=π/2.
pub fn cos_half_turn<S: Scalar>(angle_rad: S) -> S {
    let half = angle_rad * S::from_f32(0.5);
    let sine = half * polynomial(half * half, [0.999_996_6, -0.166_648_24, 0.008_306_27, -0.000_183_627]);
    S::ONE - (sine + sine) * sine
}

/// Sine and cosine of an angle within ±π/2, to the last digits: for constants, not for ticks.
///
/// # Source
/// Taylor's series of half the angle, and the double-angle formulas.
pub fn quarter_sin_and_cos(angle_rad: f32) -> (f32, f32) {
    let half = 0.5 * angle_rad;
    let y = half * half;
    let sine = half * polynomial(y, [1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5_040.0, 1.0 / 362_880.0]);
    let cosine = polynomial(y, [1.0, -0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0]);
    (2.0 * sine * cosine, 1.0 - 2.0 * sine * sine)
}

/// What makes half of a float's exponent a guess of its root, within 3.5 %.
const ROOT_GUESS: u32 = 0x1fbd_1df5;

/// Square root of `x`; zero for what is below it, NaN for what is not finite.
///
/// # Source
/// Heron's method from a guess by the exponent: each step halves the square of the relative error, so that the second leaves 7e-7 of it.
pub(crate) fn root(x: f32) -> f32 {
    let mut root = f32::from_bits((x.to_bits() >> 1) + ROOT_GUESS);
    for _ in 0..2 {
        root = 0.5 * (root + x / root);
    }
    if x > 0.0 { root } else { x * 0.0 }
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
        const QUARTER: f64 = core::f64::consts::FRAC_PI_2;
        let f32_of = |f: fn(f32) -> f32| move |x: f64| f64::from(f(x as f32));
        for (name, error, bound) in [
            ("tanh", worst((-20.0, 20.0), f32_of(tanh), libm::tanh), 1.4e-3),
            ("asin", worst((-0.95, 0.95), f32_of(|x| asin_and_cos(x).0), libm::asin), 4.0e-5),
            ("cosine", worst((-0.95, 0.95), f32_of(|x| asin_and_cos(x).1), |x| libm::sqrt(1.0 - x * x)), 1.3e-4),
            ("cos_half_turn", worst((0.0, core::f64::consts::PI), f32_of(cos_half_turn), libm::cos), 6.0e-6),
            ("quarter sine", worst((-QUARTER, QUARTER), f32_of(|x| quarter_sin_and_cos(x).0), libm::sin), 2.2e-7),
            ("quarter cosine", worst((-QUARTER, QUARTER), f32_of(|x| quarter_sin_and_cos(x).1), libm::cos), 2.2e-7),
            ("sin", worst((-1e3, 1e3), f32_of(sin), libm::sin), 1.2e-3),
            ("cos", worst((-1e3, 1e3), f32_of(cos), libm::cos), 1.2e-3),
        ] {
            assert!(error <= bound, "{name}: {error:e} > {bound:e}");
            assert!(error >= 0.5 * bound, "{name}: documented {bound:e}, measured {error:e}");
        }
    }

    #[test]
    fn a_root_is_within_six_units_in_the_last_place() {
        let mut worst = 0;
        for bits in (f32::MIN_POSITIVE.to_bits()..f32::MAX.to_bits()).step_by(9973) {
            let x = f32::from_bits(bits);
            worst = worst.max(root(x).to_bits().abs_diff(libm::sqrtf(x).to_bits()));
        }
        assert_eq!(worst, 6);
        assert_eq!([0.0, -0.0, -4.0].map(root), [0.0; 3]);
        assert!([f32::INFINITY, f32::NAN].map(root).iter().all(|root| root.is_nan()));
    }

    #[test]
    fn atan2_is_accurate_all_round() {
        let error = worst(
            (-0.999 * core::f64::consts::PI, 0.999 * core::f64::consts::PI),
            |a| f64::from(atan2(libm::sin(a) as f32, libm::cos(a) as f32)),
            |a| a,
        );
        assert!((0.6e-4..=1.2e-4).contains(&error), "{error:e}");
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }

    #[cfg(feature = "fixed")]
    #[test]
    fn fixed_point_is_within_a_few_units_of_f32() {
        use crate::Q16;
        let q = |f: fn(Q16) -> Q16| move |x: f64| f64::from(f(Q16::from_f32(x as f32)).to_f32());
        assert!(worst((-20.0, 20.0), q(tanh), libm::tanh) < 1.6e-3);
        assert!(worst((-0.95, 0.95), q(|x| asin_and_cos(x).0), libm::asin) < 1e-3);
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
