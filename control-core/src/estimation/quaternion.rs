//! Rotations as unit quaternions: what the estimator integrates.
//!
//! ```text
//! q = (w, x, y, z), body to NED        q ⊗ p: first p, then q        exp(φ) = (cos |φ|/2, φ/|φ| sin |φ|/2)
//! ```
//!
//! The exponential is a series in |φ|², so that no sine is called and small angles lose nothing: 4e-7 rad off at 0.7 rad, below the
//! rounding of `f32` at the 0.07 rad that 35 rad/s turn in a sample of 500 Hz. Invariant: the length stays within 1e-6 of one,
//! because every product is made a unit again.
use crate::Scalar;
use crate::frames::{Attitude, Vec3};

/// A rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Quaternion {
    w: f32,
    x: f32,
    y: f32,
    z: f32,
}

impl Quaternion {
    /// No rotation.
    pub(crate) const IDENTITY: Self = Self { w: 1.0, x: 0.0, y: 0.0, z: 0.0 };

    /// The rotation by the vector `angle_rad`, of at most about 1 rad.
    pub(crate) fn exp<F: Copy>(angle_rad: Vec3<F>) -> Self {
        let half = angle_rad * 0.5;
        let y = half.norm_squared();
        let w = 1.0 - y * (0.5 - y * (1.0 / 24.0 - y * (1.0 / 720.0)));
        let s = 1.0 - y * (1.0 / 6.0 - y * (1.0 / 120.0 - y * (1.0 / 5040.0)));
        Self { w, x: half.x * s, y: half.y * s, z: half.z * s }
    }

    /// First `first`, then this, at unit length.
    pub(crate) fn after(self, first: Self) -> Self {
        let (a, b) = (self, first);
        Self {
            w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        }
        .renormalised()
    }

    /// The rotation back.
    pub(crate) fn inverse(self) -> Self {
        Self { w: self.w, x: -self.x, y: -self.y, z: -self.z }
    }

    /// The rotation `share` of the way to `other`, for rotations less than 1 rad apart: off by 0.016 of the cube of that angle.
    pub(crate) fn towards(self, other: Self, share: f32) -> Self {
        let same = self.w * other.w + self.x * other.x + self.y * other.y + self.z * other.z;
        let far = if same < 0.0 { -share } else { share };
        let near = 1.0 - share;
        Self {
            w: near * self.w + far * other.w,
            x: near * self.x + far * other.x,
            y: near * self.y + far * other.y,
            z: near * self.z + far * other.z,
        }
        .renormalised()
    }

    /// The rotation vector of a small rotation, rad; a sine for a large one.
    pub(crate) fn small_angle<F: Copy>(self) -> Vec3<F> {
        let twice = if self.w < 0.0 { -2.0 } else { 2.0 };
        Vec3::new(twice * self.x, twice * self.y, twice * self.z)
    }

    /// As a matrix.
    pub(crate) fn attitude(self) -> Attitude {
        let Self { w, x, y, z } = self;
        let (x2, y2, z2) = (x + x, y + y, z + z);
        let (xx, yy, zz) = (x * x2, y * y2, z * z2);
        let (xy, xz, yz) = (x * y2, x * z2, y * z2);
        let (wx, wy, wz) = (w * x2, w * y2, w * z2);
        Attitude {
            rows: [
                [1.0 - (yy + zz), xy - wz, xz + wy],
                [xy + wz, 1.0 - (xx + zz), yz - wx],
                [xz - wy, yz + wx, 1.0 - (xx + yy)],
            ],
        }
    }

    /// The rotation of a matrix that is one.
    ///
    /// # Source
    /// Shepperd's method: the largest of the four components by a root, the others by a division.
    pub(crate) fn of(attitude: &Attitude) -> Self {
        let [[a, b, c], [d, e, f], [g, h, i]] = attitude.rows;
        let trace = a + e + i;
        let root = |four_squares: f32| Scalar::sqrt(four_squares.max(1e-6)) * 0.5;
        let largest = trace.max(a).max(e).max(i);
        let q = if largest == trace {
            let w = root(1.0 + trace);
            let k = 0.25 / w;
            Self { w, x: (h - f) * k, y: (c - g) * k, z: (d - b) * k }
        } else if largest == a {
            let x = root(1.0 + a - e - i);
            let k = 0.25 / x;
            Self { w: (h - f) * k, x, y: (b + d) * k, z: (c + g) * k }
        } else if largest == e {
            let y = root(1.0 - a + e - i);
            let k = 0.25 / y;
            Self { w: (c - g) * k, x: (b + d) * k, y, z: (f + h) * k }
        } else {
            let z = root(1.0 - a - e + i);
            let k = 0.25 / z;
            Self { w: (d - b) * k, x: (c + g) * k, y: (f + h) * k, z }
        };
        // Twice: a matrix may be a rotation to a percent only.
        q.renormalised().renormalised()
    }

    /// Whether every component is a number and the length near one.
    pub(crate) fn is_sound(self) -> bool {
        (self.norm_squared() - 1.0).abs() < 1e-3
    }

    fn norm_squared(self) -> f32 {
        self.w * self.w + self.x * self.x + self.y * self.y + self.z * self.z
    }

    /// At unit length, for one that nearly is: a step of Newton's iteration for the inverse root.
    fn renormalised(self) -> Self {
        let k = 1.5 - 0.5 * self.norm_squared();
        Self { w: self.w * k, x: self.x * k, y: self.y * k, z: self.z * k }
    }
}

/// The components in body axes of a vector given in NED.
pub(crate) fn to_body(attitude: &Attitude, v: Vec3<crate::frames::Ned>) -> Vec3<crate::frames::Body> {
    let [a, b, c] = attitude.rows;
    Vec3::new(
        a[0] * v.x + b[0] * v.y + c[0] * v.z,
        a[1] * v.x + b[1] * v.y + c[1] * v.z,
        a[2] * v.x + b[2] * v.y + c[2] * v.z,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Body;

    /// Worst entry of the difference between two matrices.
    fn apart(a: &Attitude, b: &Attitude) -> f32 {
        a.rows.iter().flatten().zip(b.rows.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn the_exponential_turns_about_its_axis_by_its_length() {
        for angle in [1e-4_f32, 0.07, 0.7] {
            let [[cos, minus_sin, _], ..] = Quaternion::exp(Vec3::<Body>::new(0.0, 0.0, angle)).attitude().rows;
            assert!((cos - libm::cosf(angle)).abs() < 5e-7 && (-minus_sin - libm::sinf(angle)).abs() < 5e-7, "{angle}");
        }
    }

    #[test]
    fn a_spin_of_an_hour_keeps_its_length_and_its_angle() {
        // 35 rad/s at 500 Hz: a whole number of turns is 2π/0.07 samples, so one with 90 samples a turn is taken.
        let step = Quaternion::exp(Vec3::<Body>::new(0.0, 0.0, core::f32::consts::TAU / 90.0));
        let mut q = Quaternion::IDENTITY;
        for _ in 0..90 * 20_000 {
            q = q.after(step);
        }
        assert!((q.norm_squared() - 1.0).abs() < 1e-6);
        // What `f32` rounds: 3e-8 rad a sample, always the same way.
        assert!(q.small_angle::<Body>().z.abs() < 0.2, "{q:?}");
    }

    #[test]
    fn a_matrix_and_back_is_the_same_rotation_in_every_quarter() {
        let mut worst = 0.0_f32;
        for i in 0..500_u16 {
            let v = Vec3::<Body>::new(f32::from(i % 7) - 3.0, f32::from(i % 11) - 5.0, f32::from(i % 13) - 6.0) * 0.1;
            let mut q = Quaternion::exp(v);
            for _ in 0..i % 5 {
                q = q.after(q);
            }
            worst = worst.max(apart(&q.attitude(), &Quaternion::of(&q.attitude()).attitude()));
        }
        assert!(worst < 2e-6, "{worst:e}");
    }

    #[test]
    fn half_way_between_two_rotations_is_half_the_angle() {
        let far = Quaternion::exp(Vec3::<Body>::new(0.0, 0.28, 0.0));
        let half = Quaternion::IDENTITY.towards(far, 0.5).small_angle::<Body>();
        assert!((half.y - 0.14).abs() < 5e-4, "{half:?}");
        let quarter = Quaternion::IDENTITY.towards(far, 0.25).small_angle::<Body>();
        assert!((quarter.y - 0.07).abs() < 4e-4, "{quarter:?}");
    }
}
