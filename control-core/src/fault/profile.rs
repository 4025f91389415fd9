//! How a fault comes and goes between its onset and its end.

/// How a fault develops between its start and its end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Profile {
    /// All at once, all the time.
    #[default]
    Step,
    /// Grows linearly, then stays.
    Ramp(Ramp),
    /// On and off.
    PulseTrain(PulseTrain),
    /// Rises and falls as (1 − cos)/2, from nothing to all of it and back.
    Sine(Sine),
    /// On and off at random, for exponentially distributed times; it starts on.
    Intermittent(Intermittent),
}

/// Keys of a ramp.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Ramp {
    /// Time from nothing to all of it, s.
    pub rise_s: f64,
}

/// Keys of a pulse train.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PulseTrain {
    /// Time from one onset to the next, s.
    pub period_s: f64,
    /// Share of the period that it is there; the period starts with it.
    pub duty: f64,
}

/// Keys of a sine.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Sine {
    /// Time of one rise and fall, s.
    pub period_s: f64,
}

/// Keys of a fault that comes and goes at random.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Intermittent {
    /// Mean time that it is there, s.
    pub on_mean_s: f64,
    /// Mean time that it is not, s: it comes back 1 / `off_mean_s` times a second.
    pub off_mean_s: f64,
}

impl Profile {
    /// Its name in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Step => "step",
            Self::Ramp(_) => "ramp",
            Self::PulseTrain(_) => "pulse_train",
            Self::Sine(_) => "sine",
            Self::Intermittent(_) => "intermittent",
        }
    }

    /// Whether a fault is ever there in part.
    pub const fn is_gradual(self) -> bool {
        matches!(self, Self::Ramp(_) | Self::Sine(_))
    }

    /// How much of a fault is there `since_s` after its onset, 0..=1.
    ///
    /// - `drawn_on`: whether an intermittent fault is there, as its user has drawn.
    pub fn level(self, since_s: f64, drawn_on: bool) -> f64 {
        match self {
            Self::Step => 1.0,
            Self::Ramp(Ramp { rise_s }) => (since_s / rise_s).min(1.0),
            Self::PulseTrain(PulseTrain { period_s, duty }) => {
                f64::from(u8::from(since_s % period_s < duty * period_s))
            }
            Self::Sine(Sine { period_s }) => 0.5 - 0.5 * libm::cos(core::f64::consts::TAU * since_s / period_s),
            Self::Intermittent(_) => f64::from(u8::from(drawn_on)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Fault, FaultKind, Rotors};
    use super::*;

    #[test]
    fn profiles_have_their_shapes() {
        let pulse = Profile::PulseTrain(PulseTrain { period_s: 2.0, duty: 0.25 });
        let flicker = Profile::Intermittent(Intermittent { on_mean_s: 1.0, off_mean_s: 1.0 });
        for (why, profile, t_s, drawn_on, want) in [
            ("nothing before the onset", Profile::Step, 9.999, true, 0.0),
            ("a step is full at once", Profile::Step, 10.0, false, 1.0),
            ("nothing at the end", Profile::Step, 20.0, true, 0.0),
            ("a ramp is half way", Profile::Ramp(Ramp { rise_s: 4.0 }), 12.0, false, 0.5),
            ("a ramp stays", Profile::Ramp(Ramp { rise_s: 4.0 }), 19.0, false, 1.0),
            ("a pulse is on", pulse, 12.4, false, 1.0),
            ("a pulse is off", pulse, 12.6, false, 0.0),
            ("a sine starts from nothing", Profile::Sine(Sine { period_s: 4.0 }), 10.0, false, 0.0),
            ("a sine peaks half way", Profile::Sine(Sine { period_s: 4.0 }), 12.0, false, 1.0),
            ("an intermittent fault is as drawn", flicker, 12.0, true, 1.0),
            ("and goes as drawn", flicker, 12.0, false, 0.0),
            ("but not before its onset", flicker, 9.0, true, 0.0),
        ] {
            let kind = FaultKind::LossOfEffectiveness { loss: 0.4 };
            let fault = Fault { kind, rotors: Rotors::ALL, from_s: 10.0, until_s: 20.0, profile, reported: false };
            assert!((fault.level(t_s, drawn_on) - want).abs() < 1e-9, "{why}");
        }
    }
}
