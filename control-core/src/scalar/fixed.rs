//! Q16.16: what a board without a floating-point unit would fly.
//!
//! Addition saturates; products and quotients round to nearest and saturate : truncation is a
//! bias that integrals and gains would follow. A running sum is Q32.32, which holds the
//! product of two Q16.16 exactly.
use super::Scalar;
use ::fixed::types::{I16F16, I32F32};
use core::ops::{Add, Div, Mul, Neg, Sub};

const FRACTION_BITS: u32 = 16;

/// A Q16.16 number: ±32768 in steps of 2^-16.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Q16(I16F16);

/// Narrows a Q16.16 result held in 64 bits, saturating.
fn saturate(bits: i64) -> Q16 {
    Q16(I16F16::from_bits(bits.clamp(i32::MIN.into(), i32::MAX.into()) as i32))
}

impl Q16 {
    fn bits(self) -> i64 {
        self.0.to_bits().into()
    }
}

impl Add for Q16 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl Sub for Q16 {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl Mul for Q16 {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let half = 1 << (FRACTION_BITS - 1);
        saturate((self.bits() * other.bits() + half) >> FRACTION_BITS)
    }
}

impl Div for Q16 {
    type Output = Self;

    /// Rounds to nearest; by zero, saturates to the sign of the dividend.
    fn div(self, other: Self) -> Self {
        let (dividend, divisor) = (self.bits() << FRACTION_BITS, other.bits());
        if divisor == 0 {
            return saturate(if dividend < 0 { i64::MIN } else { i64::MAX });
        }
        let half = divisor.abs() / 2;
        let rounded = if (dividend < 0) == (divisor < 0) { dividend.abs() + half } else { -(dividend.abs() + half) };
        saturate(rounded / divisor.abs())
    }
}

impl Neg for Q16 {
    type Output = Self;

    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

impl Scalar for Q16 {
    type Mask = bool;
    type Sum = I32F32;

    const ZERO: Self = Self(I16F16::ZERO);
    const ONE: Self = Self(I16F16::ONE);

    fn from_f32(value: f32) -> Self {
        // The crate's conversion panics on NaN, which has no nearest value; zero is what `as` gives.
        Self(if value.is_nan() { I16F16::ZERO } else { I16F16::saturating_from_num(value) })
    }

    fn to_f32(self) -> f32 {
        self.0.to_num()
    }

    fn lt(self, other: Self) -> bool {
        self.0 < other.0
    }

    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }

    fn abs(self) -> Self {
        Self(self.0.saturating_abs())
    }

    fn sqrt(self) -> Self {
        // The root of x · 2^32 is the root of x in units of 2^-16; a negative argument gives zero.
        let radicand = u64::try_from(self.bits() << FRACTION_BITS).unwrap_or(0);
        let floor = radicand.isqrt();
        let above = radicand - floor * floor > floor;
        saturate(i64::try_from(floor + u64::from(above)).unwrap_or(i64::MAX))
    }

    fn to_sum(self) -> I32F32 {
        self.0.into()
    }

    fn from_sum(sum: I32F32) -> Self {
        let half = 1 << (FRACTION_BITS - 1);
        saturate(sum.to_bits().saturating_add(half) >> FRACTION_BITS)
    }

    fn integrate(sum: I32F32, rate: Self, dt_s: Self, bounds: (Self, Self)) -> I32F32 {
        let step = I32F32::from_bits(rate.bits() * dt_s.bits());
        sum.saturating_add(step).clamp(bounds.0.to_sum(), bounds.1.to_sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn q(value: f32) -> Q16 {
        Q16::from_f32(value)
    }

    #[test]
    fn products_and_quotients_round_to_nearest() {
        let ulp = q(1.0 / 65536.0);
        assert_eq!(ulp * q(0.5), ulp, "half a unit rounds up");
        assert_eq!(ulp * q(0.49), Q16::ZERO);
        assert_eq!(q(1.0) / q(3.0), q(1.0 / 3.0));
        assert_eq!(q(-2.0) / q(3.0), q(-2.0 / 3.0));
    }

    #[test]
    fn overflow_saturates_and_never_panics() {
        let (most, least) = (q(1e9), q(-1e9));
        assert_eq!(most + most, most);
        assert_eq!(most * least, least);
        assert_eq!(least / Q16::ZERO, least);
        assert_eq!(-least, most);
        assert_eq!(q(f32::NAN), Q16::ZERO);
        assert_eq!(least.sqrt(), Q16::ZERO);
    }

    #[test]
    fn square_root_is_correctly_rounded() {
        for x in [0.0, 1.0 / 65536.0, 0.1, 0.5, 1.0, 2.0, 3.0, 1000.0, 32767.0] {
            let x = q(x);
            assert_eq!(x.sqrt(), q(libm::sqrt(x.0.to_num()) as f32), "{x:?}");
        }
    }

    #[test]
    fn a_running_sum_keeps_what_is_below_its_resolution() {
        let (rate, dt_s, bounds) = (q(0.001), q(0.002), (q(-1.0), q(1.0)));
        let sum = (0..10_000).fold(Q16::ZERO.to_sum(), |sum, _| Q16::integrate(sum, rate, dt_s, bounds));
        let expected = 10_000.0 * rate.to_f32() * dt_s.to_f32();
        assert!((Q16::from_sum(sum).to_f32() - expected).abs() < 1e-4);
    }
}
