//! Vectors that know their frame: body FRD (x forward, y right, z down) and world NED (north, east, down).
use crate::Scalar;
use core::fmt::Debug;
use core::marker::PhantomData;
use core::ops::{Add, Mul, Neg, Sub};

/// Body axes: x forward, y right, z down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body;

/// World axes: north, east, down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ned;

/// A vector tagged with its frame. Mixing frames is a compile error:
///
/// ```compile_fail
/// use control_core::frames::{Body, Ned, Vec3};
/// let _ = Vec3::<Body>::new(0.0, 0.0, 0.0) + Vec3::<Ned>::new(0.0, 0.0, 0.0);
/// ```
///
/// In one frame it adds up:
///
/// ```
/// use control_core::frames::{Body, Vec3};
/// let _ = Vec3::<Body>::new(0.0, 0.0, 0.0) + Vec3::<Body>::new(0.0, 0.0, 0.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vec3<F, S = f32> {
    /// Forward, or north.
    pub x: S,
    /// Right, or east.
    pub y: S,
    /// Down.
    pub z: S,
    frame: PhantomData<F>,
}

impl<F: Copy, S: Scalar> Vec3<F, S> {
    /// The vector with these components.
    pub const fn new(x: S, y: S, z: S) -> Self {
        Self { x, y, z, frame: PhantomData }
    }

    /// The null vector.
    pub const fn zero() -> Self {
        Self::new(S::ZERO, S::ZERO, S::ZERO)
    }

    /// Dot product.
    pub fn dot(self, other: Self) -> S {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Cross product, right-handed.
    pub fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// The vector with `f` of each component, in the same frame.
    pub(crate) fn map<T: Scalar>(self, f: impl Fn(S) -> T) -> Vec3<F, T> {
        Vec3::new(f(self.x), f(self.y), f(self.z))
    }

    /// Square of the length; NaN or infinite if a component is.
    pub(crate) fn norm_squared(self) -> S {
        self.x * self.x + self.y * self.y + self.z * self.z
    }
}

impl<F: Copy, S: Scalar> Add for Vec3<F, S> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y, self.z + other.z)
    }
}

impl<F: Copy, S: Scalar> Sub for Vec3<F, S> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl<F: Copy, S: Scalar> Mul<S> for Vec3<F, S> {
    type Output = Self;

    fn mul(self, factor: S) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }
}

impl<F: Copy, S: Scalar> Neg for Vec3<F, S> {
    type Output = Self;

    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}

/// The rotation that takes body components to NED components, as a matrix.
///
/// Row-major; its third column is the body's down axis seen from the world, so thrust acts along its negative
/// (docs/control-law.md, erratum to eq 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude<S = f32> {
    /// Rows north, east, down; columns forward, right, down.
    pub rows: [[S; 3]; 3],
}

impl<S: Scalar> Attitude<S> {
    /// Level, nose to the north.
    pub const fn level() -> Self {
        let (o, i) = (S::ZERO, S::ONE);
        Self { rows: [[i, o, o], [o, i, o], [o, o, i]] }
    }

    /// The components in NED of a vector given in body axes.
    pub fn to_ned(&self, v: Vec3<Body, S>) -> Vec3<Ned, S> {
        let row = |r: [S; 3]| r[0] * v.x + r[1] * v.y + r[2] * v.z;
        Vec3::new(row(self.rows[0]), row(self.rows[1]), row(self.rows[2]))
    }
}
