//! The numbers the laws are written in.
//!
//! | type  | role                                        |
//! |-------|---------------------------------------------|
//! | `f32` | flies                                       |
//! | `f64` | reference: what rounding costs              |
//! | `Q16` | Q16.16 fixed point, feature `fixed`         |
//!
//! A comparison gives a [`Mask`], a branch is [`Scalar::select`]: both arms are computed, so that a vector of
//! flights can implement the trait. There is no fused multiply-add, on the host or on the board: both round after the
//! product, and so agree to the bit.
use core::fmt::Debug;
use core::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

#[cfg(feature = "fixed")]
pub(crate) mod fixed;

/// The answer of a comparison: `bool`, or one `bool` a lane.
pub trait Mask: Copy + Debug + PartialEq + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self> {
    /// The mask that is `value` in every lane.
    fn splat(value: bool) -> Self;

    /// Whether every lane is set.
    fn all(self) -> bool;
}

impl Mask for bool {
    fn splat(value: bool) -> Self {
        value
    }

    fn all(self) -> bool {
        self
    }
}

/// A real number in one of the formats that fly.
pub trait Scalar:
    Copy + Debug + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// What a comparison gives.
    type Mask: Mask;
    /// A running sum. In fixed point it is wider than `Self`, so that an increment below one unit in the last place is
    /// not lost: a Q16.16 integrator stalls where `e dt` is below half a unit, 4 mm at 500 Hz.
    type Sum: Copy + Debug;

    /// Zero.
    const ZERO: Self;
    /// One.
    const ONE: Self;

    /// The nearest representable value; fixed point saturates.
    fn from_f32(value: f32) -> Self;
    /// The value for logs and metrics.
    fn to_f32(self) -> f32;

    /// `self < other`; false if either is NaN.
    fn lt(self, other: Self) -> Self::Mask;
    /// `yes` where `mask` is set, else `no`. Both are already computed.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Magnitude.
    fn abs(self) -> Self;
    /// Square root of a value that is not negative, correctly rounded.
    fn sqrt(self) -> Self;

    /// A running sum that starts at `self`.
    fn to_sum(self) -> Self::Sum;
    /// What a running sum holds, rounded.
    fn from_sum(sum: Self::Sum) -> Self;
    /// One Euler step, `sum + rate · dt_s`, held within `bounds`.
    fn integrate(sum: Self::Sum, rate: Self, dt_s: Self, bounds: (Self, Self)) -> Self::Sum;

    /// The smaller of two; `other` if `self` is NaN.
    fn min(self, other: Self) -> Self {
        Self::select(self.lt(other), self, other)
    }

    /// The larger of two; `other` if `self` is NaN.
    fn max(self, other: Self) -> Self {
        Self::select(other.lt(self), self, other)
    }

    /// `self` within `-limit..=limit`.
    fn clamp_abs(self, limit: Self) -> Self {
        self.clamp(-limit, limit)
    }

    /// `self` within `low..=high`.
    fn clamp(self, low: Self, high: Self) -> Self {
        Self::select(self.lt(low), low, Self::select(high.lt(self), high, self))
    }
}

macro_rules! float_scalar {
    ($float:ty, $sqrt:path) => {
        impl Scalar for $float {
            type Mask = bool;
            type Sum = Self;

            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[inline]
            fn from_f32(value: f32) -> Self {
                value.into()
            }

            #[inline]
            fn to_f32(self) -> f32 {
                self as f32
            }

            #[inline]
            fn lt(self, other: Self) -> bool {
                self < other
            }

            #[inline]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }

            #[inline]
            fn abs(self) -> Self {
                self.abs()
            }

            #[inline]
            fn sqrt(self) -> Self {
                $sqrt(self)
            }

            /// A branch where the trait would select: to the same bits, and half the instructions while inside.
            #[inline]
            fn clamp_abs(self, limit: Self) -> Self {
                if self.abs() > limit {
                    core::hint::cold_path();
                    limit.copysign(self)
                } else {
                    self
                }
            }

            #[inline]
            fn to_sum(self) -> Self {
                self
            }

            #[inline]
            fn from_sum(sum: Self) -> Self {
                sum
            }

            /// A branch, as in `clamp_abs`. The black box keeps it one: the compiler would turn it into selects again.
            #[inline]
            fn integrate(sum: Self, rate: Self, dt_s: Self, bounds: (Self, Self)) -> Self {
                let next = sum + rate * dt_s;
                if next < bounds.0 || bounds.1 < next {
                    core::hint::cold_path();
                    core::hint::black_box(());
                    Scalar::clamp(next, bounds.0, bounds.1)
                } else {
                    next
                }
            }
        }
    };
}

float_scalar!(f32, crate::math::root);
float_scalar!(f64, libm::sqrt);
