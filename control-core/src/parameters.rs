//! Parameters: everything about the flight logic that may be changed without a compiler, each declared once.
//!
//! A declaration is a name as MAVLink allows it, a unit, a range, a default and a line of text. The validation here, the parameter
//! protocol's list, docs/parameters.md and `sim-host params` are all made from it.
//!
//! Angles are in degrees and charges in mAh here, as on every ground station; [`Parameters::rad`] and
//! [`Parameters::battery_use_as`] are where they become SI. A
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
    /// From one value to the next; 0 if there are some between any two.
    pub step: f32,
    /// Value until it is set.
    pub default: f32,
    /// One line for people.
    pub text: &'static str,
}

impl Declaration {
    /// Whether it may have this value.
    pub fn takes(&self, value: f32) -> bool {
        let steps = (value - self.min) / self.step;
        (self.min..=self.max).contains(&value) && (self.step == 0.0 || steps == f32::from(steps as u16))
    }
}

/// Which values it may have, with their unit: "0, 1 or 2", or "from 0.1 to 10 s".
impl fmt::Display for Declaration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { unit, min, max, step, .. } = self;
        if *step == 0.0 {
            write!(f, "from {min} to {max}")?;
        } else {
            let mut value = *min;
            while value + step < *max {
                write!(f, "{value}, ")?;
                value += step;
            }
            write!(f, "{value} or {max}")?;
        }
        let space = if unit.is_empty() { "" } else { " " };
        write!(f, "{space}{unit}")
    }
}

/// Why a parameter was not set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ParameterError {
    /// There is none of this name.
    Unknown,
    /// The value is not one that it may have, or not a number.
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
            Self::OutOfRange { declaration, value } => {
                write!(f, "{} = {value}: must be {declaration}", declaration.name)
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
        if !declaration.takes(value) {
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

    /// Charge of the battery that may be used, A s; infinite if nobody minds.
    pub fn battery_use_as(&self) -> f32 {
        let most_mah = self[Parameter::BatUseMax];
        if most_mah > 0.0 { 3.6 * most_mah } else { f32::INFINITY }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Airframe;
    use std::string::ToString;

    #[test]
    fn declarations_are_as_mavlink_and_sense_allow() {
        for (i, d) in TABLE.iter().enumerate() {
            assert!(!d.name.is_empty() && d.name.len() <= NAME_LENGTH_MAX, "{}", d.name);
            assert!(d.name.bytes().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == b'_'), "{}", d.name);
            assert!(d.min < d.max && [d.min, d.max, d.default].iter().all(|&value| d.takes(value)), "{}", d.name);
            assert!(d.text.ends_with('.') && !d.text.contains('\n'), "{}", d.name);
            assert_eq!(index_of(d.name), Some(i), "{} is declared once", d.name);
        }
    }

    #[test]
    fn a_value_out_of_range_is_refused_with_the_range_and_changes_nothing() {
        let mut parameters = Parameters::default();
        for (name, value, says) in [
            ("FS_LINK_S", 100.0, "FS_LINK_S = 100: must be from 0.1 to 10 s"),
            ("FS_LINK_S", f32::NAN, "FS_LINK_S = NaN: must be from 0.1 to 10 s"),
            ("STICK_EXPO", -1.0, "STICK_EXPO = -1: must be from 0 to 0.9"),
            ("MOT_PROTOCOL", 150.0, "MOT_PROTOCOL = 150: must be 0, 300 or 600"),
            ("MOT_PROTOCOL", 300.5, "MOT_PROTOCOL = 300.5: must be 0, 300 or 600"),
            ("MOT_PROTOCOL", 900.0, "MOT_PROTOCOL = 900: must be 0, 300 or 600"),
            ("MOT_PROTOCOL", f32::NAN, "MOT_PROTOCOL = NaN: must be 0, 300 or 600"),
            ("FS_LINKS", 1.0, "there is no parameter of this name"),
        ] {
            let error = parameters.set(name, value).expect_err(name);
            assert_eq!(error.to_string(), says);
        }
        assert_eq!(parameters, Parameters::default());
    }

    #[test]
    fn every_parameter_takes_the_ends_of_its_range_and_nothing_beyond() {
        for (i, d) in TABLE.iter().enumerate() {
            let mut parameters = Parameters::default();
            for value in [d.min, d.max] {
                assert_eq!(parameters.set(d.name, value), Ok(i));
                assert_eq!(parameters.get(d.name), Some(value));
            }
            for value in [d.min.next_down(), d.max.next_up(), f32::INFINITY] {
                assert!(parameters.set_at(i, value).is_err(), "{} = {value}", d.name);
            }
        }
        assert_eq!(Parameters::default().set_at(COUNT, 0.0), Err(ParameterError::Unknown));
    }

    #[test]
    fn gains_are_what_they_were_unless_a_factor_is_set() {
        let gains = Gains::flight(&Airframe::paper(2.2));
        let mut parameters = Parameters::default();
        assert_eq!(parameters.tune(gains), gains);
        for (name, changed) in [
            (
                "GAIN_TILT",
                (|a, b| a.phi.kp == 2.0 * b.phi.kp && a.theta.kd == 2.0 * b.theta.kd) as fn(Gains, Gains) -> _,
            ),
            ("GAIN_HORIZ", |a, b| a.x.k0 == b.x.k0.map(|k| 2.0 * k) && a.y.k0 == b.y.k0.map(|k| 2.0 * k)),
            ("GAIN_ALT", |a, b| a.z.k0 == b.z.k0.map(|k| 2.0 * k)),
            ("GAIN_HEADING", |a, b| a.psi.k0 == b.psi.k0.map(|k| 2.0 * k)),
        ] {
            parameters.set(name, 2.0).expect("in its range");
            assert!(changed(parameters.tune(gains), gains), "{name}");
        }
    }
}
