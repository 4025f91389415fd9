//! Compass and accelerometer, learnt from a machine that is turned through poses by hand.
//!
//! ```text
//! a · W m + a · w + n · m = −1        twelve terms of the compass, three of the accelerometer's offset; a, m measured
//! |a|² = 2 o · a + c                  the accelerometer's offset o: readings at rest lie on a sphere about it
//! ```
//!
//! Gravity and the earth's field keep their angle, however the machine is turned: the product of what the accelerometer reads and the true field is the
//! same in all poses, and W m + w the true field of some length. That is linear in all that is sought, and finds how the sensor is
//! turned against the accelerometer too, which an ellipsoid fitted to the lengths alone leaves open: soft iron that is not symmetric turns the heading by
//! degrees. The offset of the accelerometer adds a term in m, which is n. The length follows from the earth's strength, and the sign
//! from iron that does not mirror.
//!
//! | found       | of                                                |
//! |-------------|---------------------------------------------------|
//! | length      | t = ± 1 / rms of \|W m + w\|                      |
//! | A           | earth · t W                                       |
//! | h           | −W⁻¹ w                                            |
//! | inclination | t (1 + o · w), the sine of it                     |
//!
//! Source: the invariant is that of X. Li and Z. Li, "A new calibration method for tri-axial field sensors in strap-down navigation systems",
//! Measurement Science and Technology 23 (2012).
use super::normal::Normal;
use super::{Compass, Refusal};
use crate::frames::{Body, Vec3};
use crate::{GRAVITY_M_S2, Scalar};

/// What fields are divided by to be of the size of 1, µT.
const UNIT_UT: f32 = 50.0;
/// What a specific force at rest may differ from gravity, m/s².
const STILL_M_S2: f32 = 0.5;
/// Samples below which nothing is said, and beyond which none are summed: more of them than a hand has patience for would only lose digits.
const SAMPLES_MIN: u32 = 300;
const SAMPLES_MAX: u32 = 20_000;
/// Coverage below which the machine was not turned enough: six faces with four headings each have 0.1, one face missing 0.01.
const COVERAGE_MIN: f32 = 0.02;
/// Contradiction of the samples beyond which something is wrong, rms, µT: three times the noise of the parts.
const RESIDUAL_UT_MAX: f32 = 1.0;
/// Sine of an inclination that is too level.
const INCLINATION_MIN: f32 = 0.2;

/// What was read in the poses so far.
#[derive(Clone, Copy, Debug)]
pub struct Poses {
    angle: Normal<15>,
    sphere: Normal<4>,
}

/// What they say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosesFound {
    /// Hard and soft iron; nothing of the motors.
    pub compass: Compass,
    /// What the accelerometer reads too much, m/s².
    pub accelerometer_m_s2: Vec3<Body>,
    /// What the samples contradict each other by, rms, µT.
    pub residual_ut: f32,
    /// Least share of a term that the others do not explain, 0 to 1.
    pub coverage: f32,
    /// Sine of the field's inclination.
    pub inclination: f32,
}

impl Default for Poses {
    fn default() -> Self {
        Self { angle: Normal::EMPTY, sphere: Normal::EMPTY }
    }
}

impl Poses {
    /// Adds a sample of the magnetometer and the specific force at that time; whether the machine was at rest, and it counts.
    pub fn note(&mut self, field_ut: Vec3<Body>, force_m_s2: Vec3<Body>) -> bool {
        let (a, m) = (force_m_s2 * (1.0 / GRAVITY_M_S2), field_ut * (1.0 / UNIT_UT));
        let square = a.norm_squared();
        let still = (Scalar::sqrt(square) - 1.0).abs() < STILL_M_S2 / GRAVITY_M_S2;
        if !still || !m.norm_squared().is_finite() || self.angle.samples >= SAMPLES_MAX {
            return false;
        }
        let rows = [a.x, a.y, a.z].map(|a| [a * m.x, a * m.y, a * m.z]);
        let [[a0, a1, a2], [b0, b1, b2], [c0, c1, c2]] = rows;
        self.angle.note(&[a0, a1, a2, b0, b1, b2, c0, c1, c2, a.x, a.y, a.z, m.x, m.y, m.z], -1.0);
        // Less 1, so that the squares of gravity do not hide those of noise.
        self.sphere.note(&[a.x, a.y, a.z, 1.0], square - 1.0);
        true
    }

    /// What has been found.
    ///
    /// - `earth_ut`: strength of the earth's field here.
    ///
    /// # Errors
    /// [`Refusal`] says why it would not be kept.
    pub fn solve(&self, earth_ut: f32) -> Result<PosesFound, Refusal> {
        if self.angle.samples < SAMPLES_MIN {
            return Err(Refusal::TooFew { samples: self.angle.samples });
        }
        let (angle, sphere) = (self.angle.solve(), self.sphere.solve());
        let coverage = angle.coverage.min(sphere.coverage);
        if coverage < COVERAGE_MIN {
            return Err(Refusal::TooNarrow { coverage });
        }
        let [a0, a1, a2, b0, b1, b2, c0, c1, c2, wx, wy, wz, ..] = angle.x;
        let w = Matrix([[a0, a1, a2], [b0, b1, b2], [c0, c1, c2]]);
        let constant = Vec3::new(wx, wy, wz);
        // A determinant of nothing leaves an inclination of nothing, or an offset that is not a number.
        let inverse = w.inverse();
        let length = w.determinant().signum() / Scalar::sqrt(self.mean_square(&w, constant));
        let [ox, oy, oz, _] = sphere.x;
        let offset = Vec3::new(ox, oy, oz) * 0.5;
        let inclination = length * (1.0 + dot(offset, constant));
        if inclination.is_nan() || inclination.abs() < INCLINATION_MIN {
            return Err(Refusal::TooLevel { inclination });
        }
        let residual_ut = Scalar::sqrt(angle.residual_square) * length.abs() * earth_ut;
        let gain = length * earth_ut / UNIT_UT;
        let found = PosesFound {
            compass: Compass {
                offset_ut: inverse.times(constant) * -UNIT_UT,
                iron: w.0.map(|row| row.map(|element| element * gain)),
                ..Compass::AS_BUILT
            },
            accelerometer_m_s2: offset * GRAVITY_M_S2,
            residual_ut,
            coverage,
            inclination,
        };
        if residual_ut < RESIDUAL_UT_MAX { Ok(found) } else { Err(Refusal::TooRough { residual_ut }) }
    }

    /// Mean of |W m + w|² over all samples.
    fn mean_square(&self, w: &Matrix, constant: Vec3<Body>) -> f32 {
        /// Where the terms of the field stand.
        const FIELD: usize = 12;
        let samples = self.angle.samples as f32;
        let mut sum = samples * constant.norm_squared();
        for (row, offset) in w.0.iter().zip([constant.x, constant.y, constant.z]) {
            for (i, &a) in row.iter().enumerate() {
                // The targets are all −1.
                sum -= 2.0 * offset * a * self.angle.pulled(FIELD + i);
                for (j, &b) in row.iter().enumerate() {
                    sum += a * b * self.angle.product(FIELD + i, FIELD + j);
                }
            }
        }
        sum / samples
    }
}

/// A matrix by rows.
struct Matrix([[f32; 3]; 3]);

impl Matrix {
    fn rows(&self) -> [Vec3<Body>; 3] {
        self.0.map(|[a, b, c]| Vec3::new(a, b, c))
    }

    fn determinant(&self) -> f32 {
        let [x, y, z] = self.rows();
        dot(x, y.cross(z))
    }

    /// By cofactors: the columns are cross products of the rows.
    fn inverse(&self) -> Self {
        let [x, y, z] = self.rows();
        let share = 1.0 / self.determinant();
        let [p, q, r] = [y.cross(z) * share, z.cross(x) * share, x.cross(y) * share];
        Self([[p.x, q.x, r.x], [p.y, q.y, r.y], [p.z, q.z, r.z]])
    }

    fn times(&self, v: Vec3<Body>) -> Vec3<Body> {
        let [x, y, z] = self.rows().map(|row| dot(row, v));
        Vec3::new(x, y, z)
    }
}

fn dot(a: Vec3<Body>, b: Vec3<Body>) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Attitude;
    use std::f32::consts::{FRAC_PI_2, PI, TAU};
    use std::vec::Vec;

    const EARTH_UT: f32 = 48.0;
    const FACES: [(f32, f32); 6] =
        [(0.0, 0.0), (PI, 0.0), (FRAC_PI_2, 0.0), (-FRAC_PI_2, 0.0), (0.0, FRAC_PI_2 - 0.1), (0.0, 0.1 - FRAC_PI_2)];

    /// Roll, pitch and heading, about axes that follow.
    fn attitude(roll: f32, pitch: f32, heading: f32) -> Attitude {
        let ((sr, cr), (sp, cp), (sh, ch)) = (roll.sin_cos(), pitch.sin_cos(), heading.sin_cos());
        Attitude {
            rows: [
                [ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr],
                [sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr],
                [-sp, cp * sr, cp * cr],
            ],
        }
    }

    fn to_body(attitude: &Attitude, ned: [f32; 3]) -> Vec3<Body> {
        let column = |i: usize| (0..3).map(|row| attitude.rows[row][i] * ned[row]).sum();
        Vec3::new(column(0), column(1), column(2))
    }

    /// A machine with a compass and an accelerometer that are as built.
    struct Built {
        down: f32,
        accelerometer_m_s2: Vec3<Body>,
        noise_ut: f32,
    }

    impl Built {
        const USUAL: Self = Self { down: 1.13, accelerometer_m_s2: Vec3::new(0.2, -0.15, 0.1), noise_ut: 0.5 };

        fn field_ned(&self) -> [f32; 3] {
            [EARTH_UT * self.down.cos(), 0.0, EARTH_UT * self.down.sin()]
        }

        fn measured(&self, attitude: &Attitude) -> Vec3<Body> {
            let soft = Matrix([[1.06, 0.04, -0.03], [-0.05, 0.93, 0.06], [0.02, -0.04, 1.02]]);
            soft.times(to_body(attitude, self.field_ned())) + Vec3::new(12.0, -20.0, 7.0)
        }

        fn turned(&self, faces: &[(f32, f32)]) -> Poses {
            let mut poses = Poses::default();
            for (n, &(roll, pitch)) in faces.iter().enumerate() {
                for step in 0..8 {
                    let turn = TAU * step as f32 / 8.0 + 0.1 * n as f32;
                    let attitude = attitude(roll + 0.1 * (step as f32).sin(), pitch, turn);
                    let force = to_body(&attitude, [0.0, 0.0, -GRAVITY_M_S2]) + self.accelerometer_m_s2;
                    for i in 0..40 {
                        let noise = |prime: usize| ((i * prime) % 41) as f32 / 20.0 - 1.0;
                        let noise = Vec3::new(noise(7), noise(13), noise(19)) * self.noise_ut;
                        assert!(poses.note(self.measured(&attitude) + noise, force));
                    }
                }
            }
            poses
        }

        /// Headings that are found of a level machine that is turned once, less the true ones, rad.
        fn heading_errors(&self, compass: &Compass) -> Vec<f32> {
            let error = |step: u8| {
                let attitude = attitude(0.0, 0.0, TAU * f32::from(step) / 16.0);
                let field = attitude.to_ned(compass.correct(self.measured(&attitude), 0.0));
                field.y.atan2(field.x)
            };
            (0..16).map(error).collect()
        }
    }

    #[test]
    fn soft_and_hard_iron_and_the_turn_of_the_sensor_are_found_to_a_fifth_of_a_degree() {
        for down in [1.13, 0.4, -1.0] {
            let built = Built { down, ..Built::USUAL };
            let found = built.turned(&FACES).solve(EARTH_UT).unwrap();
            let before =
                built.heading_errors(&Compass::AS_BUILT).into_iter().fold(0.0, |most: f32, e| most.max(e.abs()));
            let after = built.heading_errors(&found.compass).into_iter().fold(0.0, |most: f32, e| most.max(e.abs()));
            assert!(before > 0.1 && after < 0.0035, "{before} {after} {found:?}");
            assert!((found.inclination - down.sin()).abs() < 0.002, "{found:?}");
            let off = found.accelerometer_m_s2 - built.accelerometer_m_s2;
            assert!(off.norm_squared() < 1e-6, "{found:?}");
            assert!((found.residual_ut - 0.29).abs() < 0.06, "{found:?}");
            let strength = found.compass.correct(built.measured(&attitude(0.3, 0.2, 1.0)), 0.0).norm_squared();
            assert!((strength.sqrt() / EARTH_UT - 1.0).abs() < 0.002);
        }
    }

    #[test]
    fn a_machine_that_is_not_turned_enough_is_refused() {
        for faces in [&FACES[..1], &FACES[..2], &FACES[..3]] {
            let refusal = Built::USUAL.turned(faces).solve(EARTH_UT);
            assert!(
                matches!(refusal, Err(Refusal::TooNarrow { .. } | Refusal::TooFew { .. })),
                "{faces:?} {refusal:?}"
            );
        }
    }

    #[test]
    fn samples_that_cannot_be_a_compass_are_refused() {
        assert_eq!(Poses::default().solve(EARTH_UT), Err(Refusal::TooFew { samples: 0 }));
        let rough = Built { noise_ut: 6.0, ..Built::USUAL }.turned(&FACES).solve(EARTH_UT);
        assert!(matches!(rough, Err(Refusal::TooRough { .. })), "{rough:?}");
        let level = Built { down: 0.1, noise_ut: 0.0, ..Built::USUAL }.turned(&FACES).solve(EARTH_UT);
        assert!(matches!(level, Err(Refusal::TooLevel { .. })), "{level:?}");
    }

    #[test]
    fn what_is_not_rest_or_not_a_number_does_not_count() {
        let mut poses = Poses::default();
        let field = Vec3::new(20.0, 0.0, 43.0);
        assert!(!poses.note(field, Vec3::new(0.0, 0.0, -11.0)));
        assert!(!poses.note(field, Vec3::new(f32::NAN, 0.0, -9.81)));
        assert!(!poses.note(Vec3::new(f32::INFINITY, 0.0, 0.0), Vec3::new(0.0, 0.0, -9.81)));
        assert!(poses.note(field, Vec3::new(0.0, 0.0, -9.81)));
    }
}
