//! A sensor fault as files write it: its kind by name, and every key of any kind beside it.
use super::super::check::{Allowed, FaultError, FaultValue};
use super::super::profile::Profile;
use super::{Sensor, SensorAxis, SensorFault, SensorFaultKind};

/// What breaks, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum SensorFaultName {
    /// No samples.
    Off,
    /// The reading of the onset, freshly stamped.
    Stuck,
    /// An offset: `offset`.
    Bias,
    /// An offset that grows: `rate`.
    Drift,
    /// Anything within the sensor's range.
    Garbage,
    /// Now and then a sample that is wrong: `size` and `rate_1_s`.
    Spikes,
    /// Old readings, freshly stamped: `delay_s`.
    Delayed,
    /// A share of the samples is lost: `loss`.
    Intermittent,
}

impl SensorFaultName {
    /// The name in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Stuck => "stuck",
            Self::Bias => "bias",
            Self::Drift => "drift",
            Self::Garbage => "garbage",
            Self::Spikes => "spikes",
            Self::Delayed => "delayed",
            Self::Intermittent => "intermittent",
        }
    }
}

/// One fault of one sensor. Which keys belong to it is decided by its kind.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SensorFaultKeys {
    /// What breaks.
    pub kind: SensorFaultName,
    /// The sensor it breaks.
    pub sensor: Sensor,
    /// Which of its kind, from 1.
    #[cfg_attr(feature = "serde", serde(default = "first"))]
    pub unit: u8,
    /// The axis it breaks; left out, all of them.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub axis: Option<SensorAxis>,
    /// `bias`: added to the reading, in its unit.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub offset: Option<f64>,
    /// `drift`: what the offset grows by a second, in the reading's unit.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub rate: Option<f64>,
    /// `spikes`: added or subtracted, in the reading's unit.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub size: Option<f64>,
    /// `spikes`: how many a second.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub rate_1_s: Option<f64>,
    /// `delayed`: how old readings are, s.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub delay_s: Option<f64>,
    /// `intermittent`: share of the samples that is lost, 0 to 1.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub loss: Option<f64>,
    /// Onset, s.
    pub from_s: f64,
    /// End, s.
    pub until_s: f64,
    /// Shape in between.
    #[cfg_attr(feature = "serde", serde(default))]
    pub profile: Profile,
}

#[cfg(feature = "serde")]
const fn first() -> u8 {
    1
}

impl SensorFaultKeys {
    /// Every parameter by name; none where it is left out.
    fn parameters(&self) -> [(&'static str, Option<f64>); 6] {
        let Self { offset, rate, size, rate_1_s, delay_s, loss, .. } = *self;
        [
            ("offset", offset),
            ("rate", rate),
            ("size", size),
            ("rate_1_s", rate_1_s),
            ("delay_s", delay_s),
            ("loss", loss),
        ]
    }
}

impl SensorFaultKind {
    /// Its name.
    pub const fn name(self) -> SensorFaultName {
        match self {
            Self::Off => SensorFaultName::Off,
            Self::Stuck => SensorFaultName::Stuck,
            Self::Bias { .. } => SensorFaultName::Bias,
            Self::Drift { .. } => SensorFaultName::Drift,
            Self::Garbage => SensorFaultName::Garbage,
            Self::Spikes { .. } => SensorFaultName::Spikes,
            Self::Delayed { .. } => SensorFaultName::Delayed,
            Self::Intermittent { .. } => SensorFaultName::Intermittent,
        }
    }

    /// The kind that `keys` name, with the parameters it needs.
    fn read(keys: &SensorFaultKeys) -> Result<Self, FaultError> {
        let need = |key: &'static str, value: Option<f64>| {
            let allowed = Allowed::GivenWith(keys.kind.as_str());
            value.ok_or(FaultError { key, value: FaultValue::Word("nothing"), allowed })
        };
        Ok(match keys.kind {
            SensorFaultName::Off => Self::Off,
            SensorFaultName::Stuck => Self::Stuck,
            SensorFaultName::Bias => Self::Bias { offset: need("offset", keys.offset)? },
            SensorFaultName::Drift => Self::Drift { rate: need("rate", keys.rate)? },
            SensorFaultName::Garbage => Self::Garbage,
            SensorFaultName::Spikes => {
                Self::Spikes { size: need("size", keys.size)?, rate_1_s: need("rate_1_s", keys.rate_1_s)? }
            }
            SensorFaultName::Delayed => Self::Delayed { delay_s: need("delay_s", keys.delay_s)? },
            SensorFaultName::Intermittent => Self::Intermittent { loss: need("loss", keys.loss)? },
        })
    }
}

impl From<SensorFault> for SensorFaultKeys {
    fn from(fault: SensorFault) -> Self {
        let SensorFault { kind, sensor, unit, axis, from_s, until_s, profile } = fault;
        let (offset, rate, size, rate_1_s, delay_s, loss) = (None, None, None, None, None, None);
        let name = kind.name();
        let none = Self {
            kind: name,
            sensor,
            unit,
            axis,
            offset,
            rate,
            size,
            rate_1_s,
            delay_s,
            loss,
            from_s,
            until_s,
            profile,
        };
        match kind {
            SensorFaultKind::Off | SensorFaultKind::Stuck | SensorFaultKind::Garbage => none,
            SensorFaultKind::Bias { offset } => Self { offset: Some(offset), ..none },
            SensorFaultKind::Drift { rate } => Self { rate: Some(rate), ..none },
            SensorFaultKind::Spikes { size, rate_1_s } => Self { size: Some(size), rate_1_s: Some(rate_1_s), ..none },
            SensorFaultKind::Delayed { delay_s } => Self { delay_s: Some(delay_s), ..none },
            SensorFaultKind::Intermittent { loss } => Self { loss: Some(loss), ..none },
        }
    }
}

impl TryFrom<SensorFaultKeys> for SensorFault {
    type Error = FaultError;

    /// # Errors
    /// A key that the kind needs and that is left out, or one that it does not have.
    fn try_from(keys: SensorFaultKeys) -> Result<Self, FaultError> {
        let SensorFaultKeys { sensor, unit, axis, from_s, until_s, profile, .. } = keys;
        let fault = Self { kind: SensorFaultKind::read(&keys)?, sensor, unit, axis, from_s, until_s, profile };
        let known = SensorFaultKeys::from(fault);
        for ((key, given), (_, known)) in keys.parameters().into_iter().zip(known.parameters()) {
            if let (Some(value), None) = (given, known) {
                let allowed = Allowed::LeftOutWith(keys.kind.as_str());
                return Err(FaultError { key, value: FaultValue::Number(value), allowed });
            }
        }
        Ok(fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    /// Every kind, each parameter another number.
    const KINDS: [SensorFaultKind; 8] = [
        SensorFaultKind::Off,
        SensorFaultKind::Stuck,
        SensorFaultKind::Bias { offset: 1.0 },
        SensorFaultKind::Drift { rate: 2.0 },
        SensorFaultKind::Garbage,
        SensorFaultKind::Spikes { size: 3.0, rate_1_s: 4.0 },
        SensorFaultKind::Delayed { delay_s: 5.0 },
        SensorFaultKind::Intermittent { loss: 6.0 },
    ];

    fn fault(kind: SensorFaultKind) -> SensorFault {
        let (sensor, axis, profile) = (Sensor::Mag, Some(SensorAxis::Y), Profile::Step);
        SensorFault { kind, sensor, unit: 1, axis, from_s: 1.0, until_s: 2.0, profile }
    }

    #[test]
    fn every_kind_is_written_and_read_back() {
        for kind in KINDS {
            assert_eq!(SensorFault::try_from(SensorFaultKeys::from(fault(kind))), Ok(fault(kind)));
        }
    }

    #[test]
    fn keys_of_other_kinds_and_missing_keys_are_refused_by_name() {
        let off = SensorFaultKeys::from(fault(SensorFaultKind::Off));
        let spikes = SensorFaultKeys::from(fault(KINDS[5]));
        for (keys, says) in [
            (SensorFaultKeys { loss: Some(0.4), ..off }, "loss = 0.4: must be left out with the kind `off`"),
            (
                SensorFaultKeys { kind: SensorFaultName::Bias, ..off },
                "offset = nothing: must be given with the kind `bias`",
            ),
            (SensorFaultKeys { rate_1_s: None, ..spikes }, "rate_1_s = nothing: must be given with the kind `spikes`"),
        ] {
            let line = SensorFault::try_from(keys).expect_err("it is refused").to_string();
            assert!(line.contains(says), "`{says}` is not in: {line}");
        }
    }
}
