//! The compass of one machine: what iron and motor current make of the earth's field, learnt once and taken off every sample.
//!
//! ```text
//! measured  m = M Rᵀ B + h + k L            M soft iron and how the sensor is turned, h hard iron, k the motors' field
//! corrected   = A (m − h − k L)             A = M⁻¹
//! load      L = ¼ Σ u^1.5                   u thrust of each rotor as a share of its largest
//! ```
//!
//! The current of a rotor goes with its power, and that with the 1.5th power of its thrust (momentum theory), so that one vector is enough for
//! motors that share their wires. What is commanded stands for what is done: the rotors lag by less than the heading is averaged over.
//!
//! Elsewhere: `compass/poses.rs` learns A, h and the accelerometer's offset from a machine that is turned by hand, `compass/motors.rs` learns k from
//! one that is held down, `compass/normal.rs` is the least squares of both. All of it is stored as parameters.
//!
//! Invariant: without parameters a sample is left as it is, to the bit.
use crate::Scalar;
use crate::frames::{Body, Vec3};
use crate::parameters::{Parameter, ParameterError, Parameters};
use core::fmt;

mod motors;
mod normal;
mod poses;

pub use motors::{MotorRun, MotorsFound};
pub use poses::{Poses, PosesFound};

const OFFSET: [Parameter; 3] = [Parameter::MagOffX, Parameter::MagOffY, Parameter::MagOffZ];
const IRON: [[Parameter; 3]; 3] = [
    [Parameter::MagIronXx, Parameter::MagIronXy, Parameter::MagIronXz],
    [Parameter::MagIronYx, Parameter::MagIronYy, Parameter::MagIronYz],
    [Parameter::MagIronZx, Parameter::MagIronZy, Parameter::MagIronZz],
];
const MOTORS: [Parameter; 3] = [Parameter::MagMotX, Parameter::MagMotY, Parameter::MagMotZ];
const ACCELEROMETER: [Parameter; 3] = [Parameter::AccOffX, Parameter::AccOffY, Parameter::AccOffZ];

/// What is taken off a magnetometer's samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compass {
    /// Hard iron, µT.
    pub offset_ut: Vec3<Body>,
    /// What undoes soft iron and the sensor's turn, rows.
    pub iron: [[f32; 3]; 3],
    /// Field of the motors at full load, µT.
    pub motors_ut: Vec3<Body>,
}

impl Compass {
    /// Nothing is taken off.
    pub const AS_BUILT: Self = Self {
        offset_ut: Vec3::zero(),
        iron: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        motors_ut: Vec3::zero(),
    };

    /// What `parameters` say.
    pub fn of(parameters: &Parameters) -> Self {
        Self {
            offset_ut: vector(parameters, OFFSET),
            iron: IRON.map(|row| row.map(|place| parameters[place])),
            motors_ut: vector(parameters, MOTORS),
        }
    }

    /// Writes it into `parameters`.
    ///
    /// # Errors
    /// [`ParameterError`] at the first value that no sound machine has.
    pub fn store(&self, parameters: &mut Parameters) -> Result<(), ParameterError> {
        store(parameters, OFFSET, self.offset_ut)?;
        for (places, row) in IRON.into_iter().zip(self.iron) {
            store(parameters, places, Vec3::new(row[0], row[1], row[2]))?;
        }
        store(parameters, MOTORS, self.motors_ut)
    }

    /// The earth's field in body axes, µT, of what was measured while the motors bore `load`, as [`load`] has it.
    #[must_use]
    pub fn correct(&self, measured_ut: Vec3<Body>, load: f32) -> Vec3<Body> {
        if *self == Self::AS_BUILT {
            return measured_ut;
        }
        let left_ut = measured_ut - self.offset_ut - self.motors_ut * load;
        let [x, y, z] = self.iron.map(|[a, b, c]| a * left_ut.x + b * left_ut.y + c * left_ut.z);
        Vec3::new(x, y, z)
    }
}

/// What the accelerometer reads too much, as `parameters` say, m/s².
pub fn accelerometer_offset(parameters: &Parameters) -> Vec3<Body> {
    vector(parameters, ACCELEROMETER)
}

/// Writes what the accelerometer reads too much into `parameters`.
///
/// # Errors
/// [`ParameterError`] at the first value that no sound part has.
pub fn store_accelerometer_offset(offset_m_s2: Vec3<Body>, parameters: &mut Parameters) -> Result<(), ParameterError> {
    store(parameters, ACCELEROMETER, offset_m_s2)
}

/// Load of the motors, 0 to 1, where each makes a share of its largest thrust.
pub fn load(thrust: &[f32; 4]) -> f32 {
    let [a, b, c, d] = thrust.map(|share| share.max(0.0) * Scalar::sqrt(share.max(0.0)));
    0.25 * (a + b + c + d)
}

/// Why a calibration has found nothing to be kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// Too few samples at rest.
    TooFew {
        /// How many there were.
        samples: u32,
    },
    /// The machine was not turned far enough about all axes, or its motors not run up far enough.
    TooNarrow {
        /// Least share of a term that the others do not explain.
        coverage: f32,
    },
    /// The samples contradict each other: it was moved, or there is iron nearby.
    TooRough {
        /// What they contradict each other by, rms, µT.
        residual_ut: f32,
    },
    /// The earth's field is too level here: gravity and field together say nothing.
    TooLevel {
        /// Sine of its inclination.
        inclination: f32,
    },
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFew { samples } => write!(f, "only {samples} samples at rest"),
            Self::TooNarrow { coverage } => write!(f, "not turned or run up far enough: coverage {coverage:.3}"),
            Self::TooRough { residual_ut } => {
                write!(f, "samples contradict each other by {residual_ut:.1} uT: moved, or iron nearby")
            }
            Self::TooLevel { inclination } => write!(f, "the field is too level here: sine {inclination:.2}"),
        }
    }
}

impl core::error::Error for Refusal {}

fn vector(parameters: &Parameters, [x, y, z]: [Parameter; 3]) -> Vec3<Body> {
    Vec3::new(parameters[x], parameters[y], parameters[z])
}

fn store(parameters: &mut Parameters, places: [Parameter; 3], v: Vec3<Body>) -> Result<(), ParameterError> {
    for (place, value) in places.into_iter().zip([v.x, v.y, v.z]) {
        parameters.set_at(place as usize, value)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_parameters_a_sample_is_left_as_it_is() {
        let compass = Compass::of(&Parameters::default());
        assert_eq!(compass, Compass::AS_BUILT);
        let measured_ut = Vec3::new(20.1, -3.3, 43.7);
        assert_eq!(compass.correct(measured_ut, 0.7), measured_ut);
    }

    #[test]
    fn what_is_stored_is_what_is_taken_off() {
        let compass = Compass {
            offset_ut: Vec3::new(1.0, -2.0, 3.0),
            iron: [[1.1, 0.01, 0.02], [0.03, 0.9, 0.04], [0.05, 0.06, 1.05]],
            motors_ut: Vec3::new(4.0, 5.0, -6.0),
        };
        let mut parameters = Parameters::default();
        compass.store(&mut parameters).unwrap();
        assert_eq!(Compass::of(&parameters), compass);
        // (10, 20, 30) less the offset, less half of the motors' field.
        let corrected = compass.correct(Vec3::new(10.0, 20.0, 30.0), 0.5);
        let left = [7.0_f32, 19.5, 30.0];
        for (found, row) in [corrected.x, corrected.y, corrected.z].into_iter().zip(compass.iron) {
            let want: f32 = row.iter().zip(left).map(|(a, b)| a * b).sum();
            assert!((found - want).abs() < 1e-5, "{found} {want}");
        }
        let absurd = Compass { offset_ut: Vec3::new(1e4, 0.0, 0.0), ..compass };
        assert!(absurd.store(&mut parameters).is_err());
    }

    #[test]
    fn load_goes_with_power() {
        assert_eq!(load(&[1.0; 4]), 1.0);
        assert_eq!(load(&[0.0; 4]), 0.0);
        assert!((load(&[0.25; 4]) - 0.125).abs() < 1e-7);
        assert_eq!(load(&[-0.1, 0.0, 0.0, 0.0]), 0.0);
    }
}
