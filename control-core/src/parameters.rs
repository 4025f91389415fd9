//! Parameters: everything about the flight logic that may be changed without a compiler, each declared once.
//!
//! A declaration is a name as MAVLink allows it, a unit, a range, a default and a line of text. The validation here, the parameter
//! protocol's list, docs/parameters.md and `sim-host params` are all made from it.
//!
//! Angles are in degrees here, as on every ground station; [`Parameters::rad`] is where they become radians. A
//! [`Parameters`] holds values in their ranges, always: one that is not is refused.
use crate::Gains;
use core::f32::consts::PI;
use core::fmt;
use core::ops::Index;

mod table;

pub use table::{Parameter, TABLE};

/// How many there are.
pub const COUNT: usize = TABLE.len();
/// Longest name that MAVLink carries.
pub const NAME_LENGTH_MAX: usize = 16;

/// What is known of a parameter before it has a value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Declaration {
    /// Upper case, at most [`NAME_LENGTH_MAX`] characters.
    pub name: &'static str,
    /// Empty for a number.
    pub unit: &'static str,
    /// Smallest value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
    /// Value until it is set.
    pub default: f32,
    /// One line for people.
    pub text: &'static str,
}

/// Why a parameter was not set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ParameterError {
    /// There is none of this name.
    Unknown,
    /// The value is outside its range, or not a number.
    OutOfRange {
        /// The parameter.
        declaration: &'static Declaration,
        /// The value refused.
        value: f32,
    },
}

impl fmt::Display for ParameterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => write!(f, "there is no parameter of this name"),
            Self::OutOfRange { declaration: Declaration { name, unit, min, max, .. }, value } => {
                let space = if unit.is_empty() { "" } else { " " };
                write!(f, "{name} = {value}: must be from {min} to {max}{space}{unit}")
            }
        }
    }
}

impl core::error::Error for ParameterError {}

/// The values, each in its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    values: [f32; COUNT],
}

impl Default for Parameters {
    fn default() -> Self {
        Self { values: TABLE.map(|declaration| declaration.default) }
    }
}

impl Parameters {
    /// Sets the parameter called `name`; returns its index.
    ///
    /// # Errors
    /// [`ParameterError`] if there is none, or its range does not have `value`; nothing changes then.
    pub fn set(&mut self, name: &str, value: f32) -> Result<usize, ParameterError> {
        let index = index_of(name).ok_or(ParameterError::Unknown)?;
        self.set_at(index, value)?;
        Ok(index)
    }

    /// Sets the parameter at `index` of [`TABLE`].
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn set_at(&mut self, index: usize, value: f32) -> Result<(), ParameterError> {
        let (Some(declaration), Some(slot)) = (TABLE.get(index), self.values.get_mut(index)) else {
            return Err(ParameterError::Unknown);
        };
        if !(declaration.min..=declaration.max).contains(&value) {
            return Err(ParameterError::OutOfRange { declaration, value });
        }
        *slot = value;
        Ok(())
    }

    /// The value of the parameter called `name`, if there is one.
    pub fn get(&self, name: &str) -> Option<f32> {
        self.values.get(index_of(name)?).copied()
    }

    /// Every declaration with its value, in the order of [`TABLE`].
    pub fn iter(&self) -> impl Iterator<Item = (&'static Declaration, f32)> + use<> {
        TABLE.iter().zip(self.values)
    }

    /// `gains` with the factors set here; untouched, to the bit, where they are 1.
    #[must_use]
    pub fn tune(&self, mut gains: Gains) -> Gains {
        let [tilt, horizontal, altitude, heading] =
            [Parameter::GainTilt, Parameter::GainHorizontal, Parameter::GainAltitude, Parameter::GainHeading]
                .map(|parameter| self[parameter]);
        for law in [&mut gains.phi, &mut gains.theta] {
            *law = law.scaled(tilt);
        }
        for (axis, factor) in [
            (&mut gains.x, horizontal),
            (&mut gains.y, horizontal),
            (&mut gains.z, altitude),
            (&mut gains.psi, heading),
        ] {
            axis.k0 = axis.k0.map(|k| k * factor);
        }
        gains
    }

    /// The value of one that is in degrees, or degrees a second, in radians.
    pub fn rad(&self, parameter: Parameter) -> f32 {
        self[parameter] * (PI / 180.0)
    }
}

impl Index<Parameter> for Parameters {
    type Output = f32;

    fn index(&self, parameter: Parameter) -> &f32 {
        &self.values[parameter as usize]
    }
}

/// Where in [`TABLE`] the parameter called `name` is.
pub fn index_of(name: &str) -> Option<usize> {
    TABLE.iter().position(|declaration| declaration.name == name)
}
