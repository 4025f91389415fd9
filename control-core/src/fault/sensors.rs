//! Sensor faults as plain data: what breaks, on which sensor, when and in what shape.
//!
//! | kind           | parameters         | graded | decides the reading | what it does                                    |
//! |----------------|--------------------|--------|---------------------|-------------------------------------------------|
//! | `off`          |                    |        | yes                 | no samples                                      |
//! | `stuck`        |                    |        | yes                 | the reading of the onset, freshly stamped       |
//! | `bias`         | `offset`           | yes    |                     | adds `offset`                                   |
//! | `drift`        | `rate`             | yes    |                     | adds what grows by `rate` a second              |
//! | `garbage`      |                    |        | yes                 | anything within the sensor's range              |
//! | `spikes`       | `size`, `rate_1_s` | yes    |                     | now and then a sample off by `size`, up or down |
//! | `delayed`      | `delay_s`          | yes    |                     | old readings, freshly stamped                   |
//! | `intermittent` | `loss`             | yes    |                     | this share of the samples is lost, at random    |
//!
//! Offsets, rates and sizes are in the unit of the sensor's reading: see [`Sensor`]. A graded fault may be there in part,
//! as a ramp or a sine makes it. Of those that decide the reading, one at a time can have a sensor. Gyro and
//! accelerometer are one chip: if one is off or loses samples, there is no sample of either.
//!
//! Elsewhere: shapes over time are `fault/profile.rs`, the flat form of files is `fault/sensors/keys.rs`.
use super::check::{Allowed, Check, FAULT_S_MAX, FaultValue, must, range};
use super::profile::Profile;

mod keys;

pub use keys::{SensorFaultKeys, SensorFaultName};

/// A sensor that can fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Sensor {
    /// Body rates, rad/s.
    Gyro,
    /// Specific force, m/s².
    Accelerometer,
    /// Altitude by pressure, m.
    Baro,
    /// Magnetic field, µT.
    Mag,
    /// Position by satellite, m.
    Gnss,
    /// Distance to the ground, m.
    Range,
    /// Angular rate of the ground's image, rad/s.
    Flow,
    /// Position from outside, m.
    Vision,
    /// Speeds of the rotors, rad/s.
    RotorSpeed,
    /// Battery voltage, V.
    Battery,
}

/// One axis of a sensor: of the body, or north, east and down where the reading is a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum SensorAxis {
    /// Forward, or north.
    X,
    /// Right, or east.
    Y,
    /// Down.
    Z,
}

/// What breaks, and how badly at its worst. Units are those of the sensor's reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SensorFaultKind {
    /// No samples.
    Off,
    /// The reading of the onset again and again.
    Stuck,
    /// An offset.
    Bias {
        /// Added to the reading.
        offset: f64,
    },
    /// An offset that grows for as long as the fault lasts.
    Drift {
        /// What it grows by, 1/s.
        rate: f64,
    },
    /// Any reading within the range, drawn evenly, another one each sample.
    Garbage,
    /// Single samples that are wrong.
    Spikes {
        /// Added or subtracted.
        size: f64,
        /// How many a second, on average.
        rate_1_s: f64,
    },
    /// Readings that are old and do not say so.
    Delayed {
        /// How old, s.
        delay_s: f64,
    },
    /// A loose contact: samples are lost.
    Intermittent {
        /// Share of the samples that is lost, each by itself, 0 to 1.
        loss: f64,
    },
}

/// One fault of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(try_from = "SensorFaultKeys", into = "SensorFaultKeys"))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SensorFault {
    /// What breaks.
    pub kind: SensorFaultKind,
    /// The sensor it breaks.
    pub sensor: Sensor,
    /// Which of its kind, from 1: there may be two inertial units, and two barometers.
    pub unit: u8,
    /// The axis it breaks; left out, all of them.
    pub axis: Option<SensorAxis>,
    /// Onset, s.
    pub from_s: f64,
    /// End, s.
    pub until_s: f64,
    /// Shape in between.
    pub profile: Profile,
}

impl Sensor {
    /// The name in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Gyro => "gyro",
            Self::Accelerometer => "accelerometer",
            Self::Baro => "baro",
            Self::Mag => "mag",
            Self::Gnss => "gnss",
            Self::Range => "range",
            Self::Flow => "flow",
            Self::Vision => "vision",
            Self::RotorSpeed => "rotor_speed",
            Self::Battery => "battery",
        }
    }

    /// How many axes it has; 0 for one that is not a vector in space.
    pub const fn axes(self) -> usize {
        match self {
            Self::Gyro | Self::Accelerometer | Self::Mag | Self::Gnss | Self::Vision => 3,
            Self::Flow => 2,
            Self::Baro | Self::Range | Self::RotorSpeed | Self::Battery => 0,
        }
    }

    /// How many of its kind a machine may carry.
    pub const fn units_max(self) -> u8 {
        match self {
            Self::Gyro | Self::Accelerometer | Self::Baro => 2,
            _ => 1,
        }
    }
}

impl SensorAxis {
    /// Its index, 0 to 2.
    pub const fn index(self) -> usize {
        match self {
            Self::X => 0,
            Self::Y => 1,
            Self::Z => 2,
        }
    }

    /// The name in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }
}

impl SensorFaultKind {
    /// Whether it can be there in part.
    pub const fn is_graded(self) -> bool {
        !self.takes_over()
    }

    /// Whether it decides the reading, so that no other such fault can at the same time.
    pub const fn takes_over(self) -> bool {
        matches!(self, Self::Off | Self::Stuck | Self::Garbage)
    }

    /// Whether it concerns the sample as a whole, so that no axis can be named.
    pub const fn is_whole(self) -> bool {
        matches!(self, Self::Off | Self::Delayed { .. } | Self::Intermittent { .. })
    }

    /// The range of each parameter. Sizes are bounded by what any sensor's range could be.
    fn check(self) -> Check {
        match self {
            Self::Off | Self::Stuck | Self::Garbage => Ok(()),
            Self::Bias { offset } => range("offset", offset, -1e5, 1e5),
            Self::Drift { rate } => range("rate", rate, -1e5, 1e5),
            Self::Spikes { size, rate_1_s } => {
                range("size", size, -1e5, 1e5)?;
                range("rate_1_s", rate_1_s, 0.001, 10_000.0)
            }
            Self::Delayed { delay_s } => range("delay_s", delay_s, 1e-4, 10.0),
            Self::Intermittent { loss } => range("loss", loss, 0.0, 1.0),
        }
    }
}

impl SensorFault {
    /// Whether it is between onset and end at `t_s`.
    pub fn is_active(&self, t_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&t_s)
    }

    /// How much of it is there at `t_s`, 0..=1.
    ///
    /// - `drawn_on`: what was drawn for an intermittent profile; the others do not ask.
    pub fn level(&self, t_s: f64, drawn_on: bool) -> f64 {
        if self.is_active(t_s) { self.profile.level(t_s - self.from_s, drawn_on) } else { 0.0 }
    }

    /// Whether both would decide the same reading at the same time.
    pub fn contends(&self, other: &Self) -> bool {
        let axes_meet = self.axis.is_none() || other.axis.is_none() || self.axis == other.axis;
        let together = self.from_s < other.until_s && other.from_s < self.until_s;
        let same = self.sensor == other.sensor && self.unit == other.unit && axes_meet;
        same && together && self.kind.takes_over() && other.kind.takes_over()
    }

    /// Refuses the first thing about this fault that makes no sense, on whatever machine.
    ///
    /// # Errors
    /// [`super::FaultError`] with the key as in files.
    pub fn check(&self) -> Check {
        self.kind.check()?;
        range("from_s", self.from_s, 0.0, FAULT_S_MAX)?;
        range("until_s", self.until_s, self.from_s, FAULT_S_MAX)?;
        self.profile.check()?;
        range("unit", f64::from(self.unit), 1.0, f64::from(self.sensor.units_max()))?;
        self.check_axis()?;
        let fits = self.kind.is_graded() || !self.profile.is_gradual();
        let (name, shape) = (self.kind.name().as_str(), FaultValue::Word(self.profile.name()));
        let whole = Allowed::With("step, pulse_train or intermittent", name, "which is there or not");
        must(fits, "profile", shape, whole)
    }

    fn check_axis(&self) -> Check {
        let Some(axis) = self.axis else { return Ok(()) };
        let word = FaultValue::Word(axis.as_str());
        let whole = Allowed::With("left out", self.kind.name().as_str(), "which is of the whole sample");
        must(!self.kind.is_whole(), "axis", word, whole)?;
        let vector = Allowed::Words("left out with a sensor that has no axes");
        must(self.sensor.axes() > 0, "axis", word, vector)?;
        must(axis.index() < self.sensor.axes(), "axis", word, Allowed::Words("x or y with the sensor `flow`"))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{PulseTrain, Ramp};
    use super::*;
    use std::string::ToString;

    fn fault(kind: SensorFaultKind, sensor: Sensor) -> SensorFault {
        SensorFault { kind, sensor, unit: 1, axis: None, from_s: 1.0, until_s: 2.0, profile: Profile::Step }
    }

    #[test]
    fn sound_faults_pass() {
        let ramp = Profile::Ramp(Ramp { rise_s: 1.0 });
        let pulse = Profile::PulseTrain(PulseTrain { period_s: 1.0, duty: 0.5 });
        let bias = SensorFaultKind::Bias { offset: 0.1 };
        for sound in [
            fault(SensorFaultKind::Off, Sensor::Gnss),
            SensorFault { profile: pulse, ..fault(SensorFaultKind::Stuck, Sensor::Mag) },
            SensorFault { profile: ramp, ..fault(bias, Sensor::Gyro) },
            SensorFault { unit: 2, axis: Some(SensorAxis::Z), ..fault(bias, Sensor::Accelerometer) },
            SensorFault { axis: Some(SensorAxis::Y), ..fault(bias, Sensor::Flow) },
            fault(SensorFaultKind::Spikes { size: -3.0, rate_1_s: 2.0 }, Sensor::Range),
        ] {
            assert_eq!(sound.check(), Ok(()), "{sound:?}");
        }
    }

    #[test]
    fn senseless_faults_are_refused_by_key_value_and_what_is_allowed() {
        let ramp = Profile::Ramp(Ramp { rise_s: 1.0 });
        let bias = SensorFaultKind::Bias { offset: 0.1 };
        let on = |axis, fault| SensorFault { axis: Some(axis), ..fault };
        for (fault, says) in [
            (SensorFault { profile: ramp, ..fault(SensorFaultKind::Off, Sensor::Mag) }, "profile = ramp: must be step"),
            (
                on(SensorAxis::X, fault(SensorFaultKind::Off, Sensor::Mag)),
                "axis = x: must be left out with the kind `off`",
            ),
            (on(SensorAxis::X, fault(bias, Sensor::Baro)), "axis = x: must be left out with a sensor that has no axes"),
            (on(SensorAxis::Z, fault(bias, Sensor::Flow)), "axis = z: must be x or y with the sensor `flow`"),
            (SensorFault { unit: 2, ..fault(bias, Sensor::Mag) }, "unit = 2: must be a number from 1 to 1"),
            (SensorFault { unit: 0, ..fault(bias, Sensor::Gyro) }, "unit = 0: must be a number from 1 to 2"),
            (
                fault(SensorFaultKind::Intermittent { loss: 1.5 }, Sensor::Gnss),
                "loss = 1.5: must be a number from 0 to 1",
            ),
            (fault(SensorFaultKind::Delayed { delay_s: f64::NAN }, Sensor::Gnss), "delay_s = NaN"),
            (SensorFault { until_s: 0.5, ..fault(bias, Sensor::Gyro) }, "until_s = 0.5: must be a number from 1"),
        ] {
            let line = fault.check().expect_err("it makes no sense").to_string();
            assert!(line.contains(says), "`{says}` is not in: {line}");
        }
    }

    #[test]
    fn two_faults_contend_for_a_reading_only_where_they_meet() {
        let stuck = fault(SensorFaultKind::Stuck, Sensor::Gyro);
        let bias = fault(SensorFaultKind::Bias { offset: 0.1 }, Sensor::Gyro);
        let on = |axis| SensorFault { axis: Some(axis), ..stuck };
        for (why, one, other, want) in [
            ("both decide", stuck, fault(SensorFaultKind::Garbage, Sensor::Gyro), true),
            ("an offset adds to it", stuck, bias, false),
            ("another sensor", stuck, fault(SensorFaultKind::Stuck, Sensor::Accelerometer), false),
            ("another unit", stuck, SensorFault { unit: 2, ..stuck }, false),
            ("another time", stuck, SensorFault { from_s: 2.0, until_s: 3.0, ..stuck }, false),
            ("one axis of all", stuck, on(SensorAxis::X), true),
            ("another axis", on(SensorAxis::Y), on(SensorAxis::X), false),
        ] {
            assert_eq!((one.contends(&other), other.contends(&one)), (want, want), "{why}");
        }
    }
}
