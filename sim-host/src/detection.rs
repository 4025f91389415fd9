//! A campaign of the detector in flight: silent losses of one rotor, and hours without any.
//!
//! Every flight is of the controller `default`, in f32, with a seed of its own. Its rotor and onset are drawn from that seed, so
//! that results do not depend on how many threads fly.
//!
//! A detector whose alarm is out of reach sees, up to its first alarm, the same flight as one that acts: it is the same arithmetic. So
//! the sums it logs give the first passage of every threshold, and a healthy flight below the threshold need not be flown again.
//!
//! Elsewhere: percentiles and intervals are `detection/statistics.rs`, thresholds `detection/roc.rs`, the picture
//! `detection/picture.rs`, words and numbers `detection/tables.rs`.
use crate::controllers::ControllerName;
use crate::fault::{Fault, FaultKind, Profile, Rotors};
use crate::flight::{Flight, NumberFormat, Sample, Stream, random};
use crate::scenario::Scenario;
use control_core::{Config, ConfigError, DetectorConfig, HYPOTHESES, Knowledge, RotorsConfig, RotorsTelemetry};
use rand::RngExt;
use rayon::prelude::*;

mod picture;
mod roc;
pub mod statistics;
mod tables;

pub use picture::{PICTURE, svg};
use roc::{Crossings, Passages};
pub use roc::{IN_TIME_S, Roc};
pub use tables::Page;

/// Span in which the onset is drawn, s: the detector's slow mean has settled by then.
pub const ONSET_S: (f64, f64) = (12.0, 14.0);
/// How long after the onset an alarm is waited for, s; the flight ends then.
pub const WATCHED_S: f64 = 3.0;
/// When the estimate of the share is read, after the onset, s.
pub const READ_S: f64 = 0.5;
/// Losses that the ROC shows.
const ROC_LOSS_MAX: f64 = 0.6;
/// A sum that is never reached: the detector watches, and does not act.
const OUT_OF_REACH_NATS: f32 = 1e4;
/// Seeds from the first of the losses to the first of the healthy flights.
const HEALTHY_SEEDS: u64 = 1 << 32;

/// What is flown.
pub struct Campaign<'a> {
    /// Machine, sensors, weather and reference, without a fault; as long as one healthy flight.
    pub scenario: &'a Scenario,
    /// The detector.
    pub detector: DetectorConfig,
    /// First seed.
    pub seed: u64,
    /// Losses, each 0 to 1.
    pub losses: Vec<f64>,
    /// Flights of each loss.
    pub flights: u64,
    /// Flights without a fault.
    pub healthy_flights: u64,
}

/// What one flight with a fault showed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[expect(clippy::struct_excessive_bools, reason = "each is counted by itself")]
pub struct Outcome {
    /// Whether there was an alarm before the onset.
    pub early: bool,
    /// From the onset to the first alarm after it, s.
    pub alarm_s: Option<f64>,
    /// Whether that alarm named the rotor.
    pub right: bool,
    /// Whether another alarm followed, of what was not there.
    pub second: bool,
    /// Believed share less the true one, [`READ_S`] after the onset.
    pub share_error: Option<f64>,
    /// Whether it flew to the end.
    pub survived: bool,
}

/// The flights of one loss.
pub struct Step {
    /// Share of the thrust that is lost.
    pub loss: f64,
    /// One a flight.
    pub outcomes: Vec<Outcome>,
}

/// The flights without a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Healthy {
    /// How long they were.
    pub hours: f64,
    /// Alarms.
    pub alarms: u64,
    /// Largest cumulative sum, nats.
    pub nats_max: f32,
    /// Flights that ended before their time.
    pub lost: u64,
}

/// What came out.
pub struct Results {
    /// One a loss.
    pub steps: Vec<Step>,
    /// Without a fault.
    pub healthy: Healthy,
    /// Detection against false alarms.
    pub roc: Roc,
}

/// Why a scenario cannot be used.
pub fn refusal(scenario: &Scenario) -> Option<String> {
    let shortest_s = ONSET_S.1 + WATCHED_S;
    if !scenario.fault.is_empty() {
        Some("fault: must be left out: detect adds its own".to_owned())
    } else if scenario.plant == crate::plant::PlantKind::Paper {
        Some("plant = paper: must be rigid: detect needs motors".to_owned())
    } else if scenario.duration_s < shortest_s {
        Some(format!("duration_s = {}: must be at least {shortest_s} for detect", scenario.duration_s))
    } else {
        None
    }
}

impl Outcome {
    fn note(&mut self, rotors: &RotorsTelemetry, rotor: usize, loss: f64, since_s: f64) {
        let alarmed = rotors.found.iter().any(|&found| found);
        if since_s < 0.0 {
            self.early |= alarmed;
            return;
        }
        if self.alarm_s.is_none() && alarmed && !self.early {
            self.alarm_s = Some(since_s);
            self.right = rotors.found[rotor];
        }
        let others = (0..HYPOTHESES).any(|i| i != rotor && rotors.found[i]);
        self.second |= self.right && others;
        if self.share_error.is_none() && since_s >= READ_S {
            self.share_error = Some(f64::from(rotors.shares[rotor]) - (1.0 - loss));
        }
    }

    /// From the onset to the alarm of this very rotor, if it was the first, s.
    pub fn delay_s(&self) -> Option<f64> {
        self.alarm_s.filter(|_| self.right)
    }
}

impl Step {
    /// The flights without an alarm before the onset.
    pub fn fair(&self) -> impl Iterator<Item = &Outcome> {
        self.outcomes.iter().filter(|outcome| !outcome.early)
    }
}

impl Campaign<'_> {
    /// The controller, with an alarm at `alarm_nats`.
    fn config(&self, alarm_nats: f32) -> Config {
        let detector = DetectorConfig { alarm_nats, ..self.detector };
        let mut config = ControllerName::Default.config(self.scenario);
        let rotors = config.rotors.unwrap_or(RotorsConfig::ESTIMATED);
        config.rotors = Some(RotorsConfig { knowledge: Knowledge::Estimated(detector), ..rotors });
        config
    }

    /// How many flights it takes.
    pub fn count(&self) -> u64 {
        let with_roc = self.losses.iter().filter(|&&loss| loss <= ROC_LOSS_MAX).count();
        self.flights * (self.losses.len() + with_roc) as u64 + self.healthy_flights
    }

    /// Flies everything; `flown` is called after each flight.
    ///
    /// # Errors
    /// [`ConfigError`] if the controller refuses the detector.
    pub fn fly(&self, flown: &(dyn Fn() + Sync)) -> Result<Results, ConfigError> {
        let mut steps = Vec::new();
        let mut roc = Roc::new(self.detector.alarm_nats);
        for (&loss, number) in self.losses.iter().zip(0..) {
            let seeds = self.seed.wrapping_add(number * self.flights);
            let fly = |i: u64| {
                let seed = seeds.wrapping_add(i);
                let outcome = self.fly_loss(loss, seed)?;
                flown();
                if loss > ROC_LOSS_MAX {
                    return Ok((outcome, None));
                }
                let passages = self.fly_passages(loss, seed)?;
                flown();
                Ok((outcome, Some(passages)))
            };
            let flights: Result<Vec<_>, ConfigError> = (0..self.flights).into_par_iter().map(fly).collect();
            let (outcomes, passages): (Vec<_>, Vec<_>) = flights?.into_iter().unzip();
            steps.push(Step { loss, outcomes });
            if loss <= ROC_LOSS_MAX {
                roc.detections.push((loss, passages.into_iter().flatten().collect()));
            }
        }
        let healthy = self.fly_healthy(&mut roc, flown)?;
        Ok(Results { steps, healthy, roc })
    }

    /// The scenario of one flight with a fault: its rotor's index, its onset, and the flight.
    fn faulty(&self, loss: f64, seed: u64) -> (usize, f64, Scenario) {
        let mut draw = random(seed, Stream::Campaign);
        let rotor = draw.random_range(0..4);
        let from_s = draw.random_range(ONSET_S.0..ONSET_S.1);
        let mut scenario = self.scenario.clone();
        scenario.duration_s = from_s + WATCHED_S;
        scenario.fault = vec![Fault {
            kind: FaultKind::LossOfEffectiveness { loss },
            rotors: Rotors::new(std::array::from_fn(|i| i == rotor)),
            from_s,
            until_s: scenario.duration_s + 1.0,
            profile: Profile::Step,
            reported: false,
        }];
        (rotor, from_s, scenario)
    }

    fn fly_loss(&self, loss: f64, seed: u64) -> Result<Outcome, ConfigError> {
        let (rotor, from_s, scenario) = self.faulty(loss, seed);
        let mut outcome = Outcome::default();
        let ending = flight(&scenario, seed).fly_as(&self.config(self.detector.alarm_nats), &mut |sample| {
            if let Some(rotors) = &sample.telemetry.rotors {
                outcome.note(rotors, rotor, loss, sample.t_s - from_s);
            }
        })?;
        outcome.survived = ending.is_none();
        Ok(outcome)
    }

    fn fly_passages(&self, loss: f64, seed: u64) -> Result<Passages, ConfigError> {
        let (rotor, from_s, scenario) = self.faulty(loss, seed);
        let mut passages = Passages::default();
        flight(&scenario, seed).fly_as(&self.config(OUT_OF_REACH_NATS), &mut |sample| {
            passages.note(&nats(sample), rotor, sample.t_s - from_s);
        })?;
        Ok(passages)
    }

    fn fly_healthy(&self, roc: &mut Roc, flown: &(dyn Fn() + Sync)) -> Result<Healthy, ConfigError> {
        let seeds = self.seed.wrapping_add(HEALTHY_SEEDS);
        let fly = |i: u64| {
            let seed = seeds.wrapping_add(i);
            let (mut crossings, mut end_s) = (Crossings::default(), 0.0);
            let ending = flight(self.scenario, seed).fly_as(&self.config(OUT_OF_REACH_NATS), &mut |sample| {
                crossings.note(&nats(sample));
                end_s = sample.t_s;
            })?;
            let alarms = if crossings.nats_max > self.detector.alarm_nats { self.count_alarms(seed)? } else { 0 };
            flown();
            let healthy =
                Healthy { hours: end_s / 3600.0, alarms, nats_max: crossings.nats_max, lost: ending.is_some().into() };
            Ok((healthy, crossings))
        };
        let flights: Result<Vec<_>, ConfigError> = (0..self.healthy_flights).into_par_iter().map(fly).collect();
        let mut sum = Healthy::default();
        for (healthy, crossings) in flights? {
            sum.hours += healthy.hours;
            sum.alarms += healthy.alarms;
            sum.nats_max = sum.nats_max.max(healthy.nats_max);
            sum.lost += healthy.lost;
            roc.note_healthy(&crossings);
        }
        roc.hours = sum.hours;
        Ok(sum)
    }

    /// Alarms of the detector that acts, in a healthy flight.
    fn count_alarms(&self, seed: u64) -> Result<u64, ConfigError> {
        let (mut before, mut alarms) = ([false; HYPOTHESES], 0);
        flight(self.scenario, seed).fly_as(&self.config(self.detector.alarm_nats), &mut |sample| {
            let found = sample.telemetry.rotors.map_or(before, |rotors| rotors.found);
            alarms += found.iter().zip(before).filter(|&(&now, before)| now && !before).count() as u64;
            before = found;
        })?;
        Ok(alarms)
    }
}

fn flight(scenario: &Scenario, seed: u64) -> Flight<'_> {
    Flight { scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 }
}

fn nats(sample: &Sample) -> [f32; HYPOTHESES] {
    sample.telemetry.rotors.map_or([0.0; HYPOTHESES], |rotors| rotors.nats)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn telemetry(found: [bool; HYPOTHESES], share: f32) -> RotorsTelemetry {
        RotorsTelemetry {
            shares: [share; 4],
            alarm: None,
            nats: [0.0; HYPOTHESES],
            found,
            lag_s: 0.02,
            spinning: None,
            sunk_m: 0.0,
        }
    }

    const NONE: [bool; HYPOTHESES] = [false; HYPOTHESES];

    #[test]
    fn the_first_alarm_decides_and_a_later_one_is_counted_apart() {
        let only = |i: usize| std::array::from_fn(|j| j == i);
        let mut outcome = Outcome::default();
        outcome.note(&telemetry(NONE, 1.0), 2, 0.4, -0.1);
        outcome.note(&telemetry(only(2), 0.7), 2, 0.4, 0.05);
        assert_eq!((outcome.delay_s(), outcome.second), (Some(0.05), false));
        let mut both: [bool; HYPOTHESES] = only(2);
        both[4] = true;
        outcome.note(&telemetry(both, 0.65), 2, 0.4, 0.6);
        assert!(outcome.right && outcome.second && !outcome.early);
        assert!((outcome.share_error.unwrap() - 0.05).abs() < 1e-6);

        let mut wrong = Outcome::default();
        wrong.note(&telemetry(only(4), 0.7), 2, 0.4, 0.05);
        wrong.note(&telemetry(both, 0.7), 2, 0.4, 0.06);
        assert_eq!((wrong.alarm_s, wrong.delay_s(), wrong.second), (Some(0.05), None, false));
    }

    #[test]
    fn an_alarm_before_the_onset_is_no_detection() {
        let mut outcome = Outcome::default();
        outcome.note(&telemetry([true; HYPOTHESES], 1.0), 0, 0.4, -0.1);
        outcome.note(&telemetry([true; HYPOTHESES], 1.0), 0, 0.4, 0.1);
        assert!(outcome.early && outcome.alarm_s.is_none());
    }
}
