//! Actuator faults: which rotors, how much, when, in what shape.
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// A rotor makes only a share of its thrust, and of the torque that goes with it.
    LossOfEffectiveness,
}

/// How a fault develops between its start and its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// All at once, all the time.
    #[default]
    Step,
    /// Grows linearly, then stays.
    #[serde(rename = "ramp")]
    Ramp(Ramp),
    /// On and off.
    #[serde(rename = "pulse_train")]
    PulseTrain(PulseTrain),
    /// Rises and falls as (1 − cos)/2, from nothing to the full loss and back.
    #[serde(rename = "sine")]
    Sine(Sine),
}

/// Keys of a ramp.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    /// Time from nothing to the full loss, s.
    pub rise_s: f64,
}

/// Keys of a pulse train.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PulseTrain {
    /// Time from one onset to the next, s.
    pub period_s: f64,
    /// Share of the period with the full loss; the period starts with it.
    pub duty: f64,
}

/// Keys of a sine.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sine {
    /// Time of one rise and fall, s.
    pub period_s: f64,
}

/// `[[fault]]`: one fault. Faults on the same rotor multiply.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// What breaks.
    pub kind: FaultKind,
    /// The rotors it breaks, 1 to 4.
    pub rotors: Vec<i64>,
    /// Share of the thrust that is lost, 0 to 1.
    pub loss: f64,
    /// Onset, s.
    pub from_s: f64,
    /// End, s.
    pub until_s: f64,
    /// Shape in between.
    #[serde(default)]
    pub profile: Profile,
}

impl Fault {
    /// Whether it is between onset and end at `t_s`.
    pub fn is_active(&self, t_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&t_s)
    }

    /// Share of the thrust lost at `t_s`.
    pub fn loss_at(&self, t_s: f64) -> f64 {
        if !self.is_active(t_s) {
            return 0.0;
        }
        let since_s = t_s - self.from_s;
        self.loss
            * match self.profile {
                Profile::Step => 1.0,
                Profile::Ramp(Ramp { rise_s }) => (since_s / rise_s).min(1.0),
                Profile::PulseTrain(PulseTrain { period_s, duty }) => f64::from(since_s % period_s < duty * period_s),
                Profile::Sine(Sine { period_s }) => 0.5 - 0.5 * libm::cos(std::f64::consts::TAU * since_s / period_s),
            }
    }
}

/// Share of its thrust each rotor still makes at `t_s`.
pub fn effectiveness(faults: &[Fault], t_s: f64) -> [f64; 4] {
    let mut shares = [1.0; 4];
    for fault in faults {
        let keeps = 1.0 - fault.loss_at(t_s);
        for &rotor in &fault.rotors {
            // A scenario is checked: rotors are 1 to 4.
            shares[(rotor - 1) as usize] *= keeps;
        }
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(profile: Profile) -> Fault {
        Fault { kind: FaultKind::LossOfEffectiveness, rotors: vec![2], loss: 0.4, from_s: 10.0, until_s: 20.0, profile }
    }

    #[test]
    fn profiles_have_their_shapes() {
        let pulse = Profile::PulseTrain(PulseTrain { period_s: 2.0, duty: 0.25 });
        for (why, profile, t_s, want) in [
            ("nothing before the onset", Profile::Step, 9.999, 0.0),
            ("a step is full at once", Profile::Step, 10.0, 0.4),
            ("nothing at the end", Profile::Step, 20.0, 0.0),
            ("a ramp is half way", Profile::Ramp(Ramp { rise_s: 4.0 }), 12.0, 0.2),
            ("a ramp stays", Profile::Ramp(Ramp { rise_s: 4.0 }), 19.0, 0.4),
            ("a pulse is on", pulse, 12.4, 0.4),
            ("a pulse is off", pulse, 12.6, 0.0),
            ("a sine starts from nothing", Profile::Sine(Sine { period_s: 4.0 }), 10.0, 0.0),
            ("a sine peaks half way", Profile::Sine(Sine { period_s: 4.0 }), 12.0, 0.4),
        ] {
            assert!((fault(profile).loss_at(t_s) - want).abs() < 1e-9, "{why}");
        }
    }

    #[test]
    fn faults_on_one_rotor_multiply() {
        let both = [fault(Profile::Step), fault(Profile::Step)];
        let shares = effectiveness(&both, 15.0);
        assert!((shares[1] - 0.36).abs() < 1e-12);
        assert_eq!([shares[0], shares[2], shares[3]], [1.0; 3]);
    }
}
