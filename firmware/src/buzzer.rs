//! Buzzer: what is to be heard of the machine.
//!
//! ```text
//! facts, ten times a second ─► the gravest of them ─► its tune, from its beginning
//! ```
//!
//! A tune is a row of tenths of a second, in which the buzzer sounds or not. Arming, disarming and a refusal are heard once; what lasts
//! is heard for as long as it does. A graver one breaks off another; what happens once while something graver sounds is not heard.
use control_core::autopilot::Command;
use control_core::failsafe::Failsafe;

/// Looks a second, and steps of a tune.
pub const LOOKS_HZ: u64 = 10;

/// What the machine is like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "independent facts, each heard by itself")]
pub struct Facts {
    /// Rotors may turn.
    pub armed: bool,
    /// Arming was refused since the last look.
    pub refused: bool,
    /// The battery is low.
    pub battery_low: bool,
    /// A failsafe acts.
    pub failsafe: bool,
}

impl Facts {
    /// Nothing to be heard.
    pub const NONE: Self = Self { armed: false, refused: false, battery_low: false, failsafe: false };

    /// These, and what one more decision shows; a refusal is kept.
    #[must_use]
    pub fn and(self, decision: &Command) -> Self {
        let mut others = decision.failsafes;
        for of_the_battery in [Failsafe::BatteryCritical, Failsafe::BatteryLow] {
            others.put(of_the_battery, false);
        }
        Self {
            armed: decision.armed,
            refused: self.refused || decision.refused,
            battery_low: others != decision.failsafes,
            failsafe: decision.armed && !others.is_empty(),
        }
    }
}

/// What is heard, the gravest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Tune {
    Failsafe,
    Battery,
    Refused,
    Armed,
    Disarmed,
}

impl Tune {
    /// Its steps, the first the lowest bit: 1 sounds; and how many there are.
    const fn steps(self) -> (u32, u32) {
        match self {
            Self::Failsafe => (0b1_1011, 8),
            Self::Battery => (0b11_1111, 20),
            Self::Refused => (0b1_0101, 8),
            Self::Armed => (0b1111, 6),
            Self::Disarmed => (0b11, 4),
        }
    }
}

/// What sounds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Buzzer {
    armed: bool,
    playing: Option<(Tune, u32)>,
}

impl Buzzer {
    /// Whether it sounds until the next look.
    pub fn look(&mut self, facts: Facts) -> bool {
        let Facts { armed, refused, battery_low, failsafe } = facts;
        let before = core::mem::replace(&mut self.armed, armed);
        let wanted = match (before, armed) {
            _ if failsafe => Some(Tune::Failsafe),
            _ if battery_low => Some(Tune::Battery),
            _ if refused => Some(Tune::Refused),
            (false, true) => Some(Tune::Armed),
            (true, false) => Some(Tune::Disarmed),
            _ => None,
        };
        if let Some(tune) = wanted.filter(|tune| self.playing.is_none_or(|(playing, _)| *tune < playing)) {
            self.playing = Some((tune, 0));
        }
        let Some((tune, at)) = self.playing else { return false };
        let (steps, length) = tune.steps();
        self.playing = (at + 1 < length).then_some((tune, at + 1));
        steps >> at & 1 != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    const STANDS: Facts = Facts::NONE;
    const FLIES: Facts = Facts { armed: true, ..STANDS };

    /// What is heard of a row of looks, each fact for so many: `#` sounds.
    fn heard(looks: &[(Facts, u32)]) -> String {
        let mut buzzer = Buzzer::default();
        let mut heard = String::new();
        for &(facts, times) in looks {
            heard.extend((0..times).map(|_| if buzzer.look(facts) { '#' } else { '.' }));
        }
        heard
    }

    #[test]
    fn arming_disarming_and_a_refusal_are_heard_once() {
        assert_eq!(heard(&[(STANDS, 3), (FLIES, 12), (STANDS, 8)]), "...####........##......");
        let refused = Facts { refused: true, ..STANDS };
        assert_eq!(heard(&[(STANDS, 2), (refused, 1), (STANDS, 12)]), "..#.#.#........");
    }

    #[test]
    fn a_low_battery_and_a_failsafe_are_heard_for_as_long_as_they_last_the_graver_first() {
        let low = Facts { battery_low: true, ..FLIES };
        let lost = Facts { failsafe: true, ..low };
        assert_eq!(heard(&[(low, 30)]), "######..............######....");
        // It breaks the other off, and ends its own.
        assert_eq!(heard(&[(low, 3), (lost, 16), (low, 8)]), "#####.##...##.##...######..");
        assert_eq!(heard(&[(lost, 1), (FLIES, 12)]), "##.##........");
    }
}
