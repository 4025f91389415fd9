//! What the controller said and could not do from the first onset on: why a flight ended, and when its fault was known.
use super::Mean;
use crate::flight::Sample;
use crate::scenario::Scenario;
use control_core::Demand;

/// A refusal of thrust that is more than rounding in any number format, N.
const REFUSED_N: f32 = 1e-3;
/// The same of a torque, N m.
const REFUSED_NM: f32 = 2e-4;

/// The first word of the detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstAlarm {
    /// How long after the first onset, s; negative if there was nothing to find yet.
    pub delay_s: f64,
    /// The rotor, 0 to 3; `None` if all lost alike.
    pub rotor: Option<usize>,
    /// Share of the thrust that it said is lost, at the worst.
    pub loss: f64,
}

/// Two facing rotors that were done without, so that the machine was led down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LedDown {
    /// How long after the first onset, s.
    pub delay_s: f64,
    /// The lower of the two, 0 or 1; the other is two further.
    pub rotor: usize,
}

/// Shares of the time from the first onset on; none if it was not reached.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Account {
    /// The first alarm, if there was one.
    pub alarm: Option<FirstAlarm>,
    /// Why and when it was led down, if it was.
    pub led_down: Option<LedDown>,
    /// Thrust was refused by the allocation.
    pub thrust_refused_share: Option<f64>,
    /// Roll or pitch was.
    pub tilting_refused_share: Option<f64>,
    /// Heading was given up.
    pub heading_given_up_share: Option<f64>,
}

/// Whether the allocation refused thrust, and whether it refused roll or pitch.
pub(super) fn refused(sample: &Sample) -> (bool, bool) {
    let Demand { thrust_n, roll_nm, pitch_nm, yaw_nm: _ } = sample.telemetry.refused;
    (thrust_n.abs() > REFUSED_N, roll_nm.abs().max(pitch_nm.abs()) > REFUSED_NM)
}

/// Keeps the account while a flight is flown.
pub(super) struct Accountant {
    onset_s: Option<f64>,
    alarm: Option<FirstAlarm>,
    led_down: Option<LedDown>,
    thrust: Mean,
    tilting: Mean,
    heading: Mean,
}

impl Accountant {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let onset_s = scenario.fault_windows_s().first().map(|window| window.0);
        let (thrust, tilting, heading) = (Mean::default(), Mean::default(), Mean::default());
        Self { onset_s, alarm: None, led_down: None, thrust, tilting, heading }
    }

    pub(super) fn note(&mut self, sample: &Sample) {
        let Some(onset_s) = self.onset_s else { return };
        let rotors = sample.telemetry.rotors;
        if let Some(alarm) = rotors.and_then(|rotors| rotors.alarm) {
            let first = FirstAlarm { delay_s: sample.t_s - onset_s, rotor: alarm.rotor, loss: alarm.loss.into() };
            let kept = self.alarm.get_or_insert(first);
            if kept.rotor == alarm.rotor {
                kept.loss = kept.loss.max(alarm.loss.into());
            }
        }
        if let Some(rotor) = rotors.filter(|rotors| rotors.sunk_m > 0.0).and_then(|rotors| rotors.spinning) {
            self.led_down.get_or_insert(LedDown { delay_s: sample.t_s - onset_s, rotor: rotor % 2 });
        }
        if sample.t_s >= onset_s {
            let (thrust, tilting) = refused(sample);
            let spins = rotors.is_some_and(|rotors| rotors.spinning.is_some());
            self.thrust.note(f64::from(thrust));
            self.tilting.note(f64::from(tilting));
            self.heading.note(f64::from(sample.telemetry.yaw_guard || spins));
        }
    }

    pub(super) fn finish(self) -> Account {
        Account {
            alarm: self.alarm,
            led_down: self.led_down,
            thrust_refused_share: self.thrust.value(),
            tilting_refused_share: self.tilting.value(),
            heading_given_up_share: self.heading.value(),
        }
    }
}
