//! The range of every parameter of a fault, and what of it cannot be together.
use super::{Fault, FaultKind, Intermittent, Profile, PulseTrain, Ramp, Recurrence, Rotors, Sine};
use core::fmt;

/// Latest end of a fault: two hours, s.
pub const FAULT_S_MAX: f64 = 7200.0;

/// Why a fault is refused: a key, what it is, and what it must be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultError {
    /// The key, as in files: `loss`, `profile.ramp.rise_s`.
    pub key: &'static str,
    /// What it is.
    pub value: FaultValue,
    /// What it must be.
    pub allowed: Allowed,
}

/// A value that is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultValue {
    /// A number.
    Number(f64),
    /// A word.
    Word(&'static str),
    /// A list of rotors.
    Rotors(Rotors),
}

/// What a value must be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Allowed {
    /// Within two bounds, both included.
    Range(f64, f64),
    /// Something given, with the kind of this name.
    GivenWith(&'static str),
    /// Left out, with the kind of this name.
    LeftOutWith(&'static str),
    /// What the first words say with the kind of this name, because of the last.
    With(&'static str, &'static str, &'static str),
    /// What the words say.
    Words(&'static str),
}

impl fmt::Display for FaultValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => write!(f, "{value}"),
            Self::Word(word) => f.write_str(word),
            Self::Rotors(rotors) => f.debug_list().entries(rotors.numbers()).finish(),
        }
    }
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Range(low, high) => write!(f, "a number from {low} to {high}"),
            Self::GivenWith(name) => write!(f, "given with the kind `{name}`"),
            Self::LeftOutWith(name) => write!(f, "left out with the kind `{name}`"),
            Self::With(words, name, why) => write!(f, "{words} with the kind `{name}`, {why}"),
            Self::Words(words) => f.write_str(words),
        }
    }
}

impl fmt::Display for FaultError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key, value, allowed } = self;
        write!(f, "{key} = {value}: must be {allowed}")
    }
}

impl core::error::Error for FaultError {}

pub(super) type Check = Result<(), FaultError>;

/// Refuses a number outside `low..=high`; NaN is outside.
pub(super) fn range(key: &'static str, value: f64, low: f64, high: f64) -> Check {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(FaultError { key, value: FaultValue::Number(value), allowed: Allowed::Range(low, high) })
}

/// Refuses what is not so.
pub(super) fn must(so: bool, key: &'static str, value: FaultValue, allowed: Allowed) -> Check {
    if so { Ok(()) } else { Err(FaultError { key, value, allowed }) }
}

impl Fault {
    /// Refuses the first thing about this fault that makes no sense, on whatever machine.
    ///
    /// # Errors
    /// [`FaultError`] with the key as in files.
    pub fn check(&self) -> Check {
        self.kind.check()?;
        self.check_rotors()?;
        range("from_s", self.from_s, 0.0, FAULT_S_MAX)?;
        range("until_s", self.until_s, self.from_s, FAULT_S_MAX)?;
        self.profile.check()?;
        let (name, shape) = (self.kind.name().as_str(), FaultValue::Word(self.profile.name()));
        let fits = self.kind.is_graded() || !self.profile.is_gradual();
        let whole = Allowed::With("step, pulse_train or intermittent", name, "which is there or not");
        must(fits, "profile", shape, whole)?;
        let lasts = self.kind != FaultKind::Swapped || self.profile == Profile::Step;
        must(lasts, "profile", shape, Allowed::With("step", name, "which is wiring"))?;
        let tells = !self.reported || self.kind.concerns_share();
        let nothing = Allowed::With("false", name, "which takes no share of the thrust");
        must(tells, "reported", FaultValue::Word("true"), nothing)
    }

    fn check_rotors(&self) -> Check {
        let (count, name) = (self.rotors.count(), self.kind.name().as_str());
        let (enough, allowed) = match self.kind {
            FaultKind::BatterySag { .. } => (count == 4, Allowed::With("[1, 2, 3, 4]", name, "which is of all rotors")),
            FaultKind::Swapped => (count == 2, Allowed::With("a list of two rotors", name, "which exchanges them")),
            _ => (count > 0, Allowed::Words("a list of at least one of the rotors 1 to 4")),
        };
        must(enough, "rotors", FaultValue::Rotors(self.rotors), allowed)
    }
}

impl FaultKind {
    fn check(self) -> Check {
        match self {
            Self::Stopped | Self::HardOver | Self::Swapped => Ok(()),
            Self::LossOfEffectiveness { loss } => range("loss", loss, 0.0, 1.0),
            Self::Stuck { thrust_n } => range("thrust_n", thrust_n.unwrap_or(0.0), 0.0, 1000.0),
            Self::Floating { spin_down_s } => range("spin_down_s", spin_down_s, 0.02, 10.0),
            Self::SlowMotor { lag_factor, rate_n_s_max } => {
                range("lag_factor", lag_factor, 1.0, 50.0)?;
                range("rate_n_s_max", rate_n_s_max.unwrap_or(1.0), 0.01, 10_000.0)
            }
            Self::CommandDelay { delay_s } => range("delay_s", delay_s, 1e-4, 1.0),
            Self::CommandJitter { delay_s_max } => range("delay_s_max", delay_s_max, 1e-4, 1.0),
            Self::EscDesync { dropout_s, restart_s, recurrence } => {
                range("dropout_s", dropout_s, 0.001, 10.0)?;
                range("restart_s", restart_s, 0.0, 10.0)?;
                match recurrence {
                    Recurrence::Period { period_s } => range("period_s", period_s, dropout_s, 600.0),
                    Recurrence::Rate { rate_1_s } => range("rate_1_s", rate_1_s, 0.001, 100.0),
                }
            }
            Self::PropellerDamage { loss, unbalance_kg_m } => {
                range("loss", loss, 0.0, 1.0)?;
                range("unbalance_kg_m", unbalance_kg_m, 0.0, 0.01)
            }
            Self::BatterySag { sag } => range("sag", sag, 0.0, 0.9),
            Self::Reversed { share } => range("share", share, 0.0, 1.0),
        }
    }
}

impl Profile {
    pub(super) fn check(self) -> Check {
        /// Shortest time that a shape has, s.
        const LEAST_S: f64 = 0.001;
        match self {
            Self::Step => Ok(()),
            Self::Ramp(Ramp { rise_s }) => range("profile.ramp.rise_s", rise_s, LEAST_S, FAULT_S_MAX),
            Self::PulseTrain(PulseTrain { period_s, duty }) => {
                range("profile.pulse_train.period_s", period_s, LEAST_S, FAULT_S_MAX)?;
                range("profile.pulse_train.duty", duty, 0.0, 1.0)
            }
            Self::Sine(Sine { period_s }) => range("profile.sine.period_s", period_s, LEAST_S, FAULT_S_MAX),
            Self::Intermittent(Intermittent { on_mean_s, off_mean_s }) => {
                range("profile.intermittent.on_mean_s", on_mean_s, LEAST_S, FAULT_S_MAX)?;
                range("profile.intermittent.off_mean_s", off_mean_s, LEAST_S, FAULT_S_MAX)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const ONE: Rotors = Rotors::new([true, false, false, false]);

    fn fault(kind: FaultKind, rotors: Rotors) -> Fault {
        Fault { kind, rotors, from_s: 1.0, until_s: 2.0, profile: Profile::Step, reported: false }
    }

    #[test]
    fn sound_faults_pass() {
        for kind in [
            FaultKind::LossOfEffectiveness { loss: 1.0 },
            FaultKind::Stopped,
            FaultKind::Stuck { thrust_n: None },
            FaultKind::Stuck { thrust_n: Some(0.0) },
            FaultKind::HardOver,
            FaultKind::Floating { spin_down_s: 0.2 },
            FaultKind::SlowMotor { lag_factor: 3.0, rate_n_s_max: None },
            FaultKind::CommandDelay { delay_s: 0.02 },
            FaultKind::CommandJitter { delay_s_max: 0.02 },
            FaultKind::PropellerDamage { loss: 0.1, unbalance_kg_m: 3e-5 },
            FaultKind::Reversed { share: 0.5 },
        ] {
            assert_eq!(fault(kind, ONE).check(), Ok(()), "{kind:?}");
        }
        assert_eq!(fault(FaultKind::BatterySag { sag: 0.2 }, Rotors::ALL).check(), Ok(()));
        assert_eq!(fault(FaultKind::Swapped, Rotors::new([true, true, false, false])).check(), Ok(()));
    }

    #[test]
    fn senseless_faults_are_refused_by_key_value_and_what_is_allowed() {
        let sag = FaultKind::BatterySag { sag: 0.2 };
        let ramp = Profile::Ramp(Ramp { rise_s: 1.0 });
        let pulse = Profile::PulseTrain(PulseTrain { period_s: 1.0, duty: 0.5 });
        let desync = |period_s| FaultKind::EscDesync {
            dropout_s: 0.1,
            restart_s: 0.1,
            recurrence: Recurrence::Period { period_s },
        };
        let pair = Rotors::new([true, true, false, false]);
        for (fault, says) in [
            (fault(sag, ONE), "rotors = [1]: must be [1, 2, 3, 4] with the kind `battery_sag`"),
            (fault(FaultKind::Swapped, ONE), "rotors = [1]: must be a list of two rotors"),
            (fault(FaultKind::Stopped, Rotors::default()), "rotors = []"),
            (Fault { profile: ramp, ..fault(FaultKind::Stopped, ONE) }, "profile = ramp: must be step, pulse_train or"),
            (Fault { profile: pulse, ..fault(FaultKind::Swapped, pair) }, "profile = pulse_train: must be step"),
            (Fault { reported: true, ..fault(FaultKind::Swapped, pair) }, "reported = true: must be false"),
            (fault(FaultKind::SlowMotor { lag_factor: 0.5, rate_n_s_max: None }, ONE), "lag_factor = 0.5"),
            (fault(FaultKind::LossOfEffectiveness { loss: f64::NAN }, ONE), "loss = NaN: must be a number from 0 to 1"),
            (fault(desync(0.05), ONE), "period_s = 0.05: must be a number from 0.1 to 600"),
            (Fault { until_s: 0.5, ..fault(FaultKind::HardOver, ONE) }, "until_s = 0.5: must be a number from 1"),
        ] {
            let line = fault.check().expect_err("it makes no sense").to_string();
            assert!(line.contains(says), "`{says}` is not in: {line}");
        }
    }
}
