//! What is measured of a flight, from the true state at the control rate and the commanded thrusts.
use crate::flight::{Crash, Ending, Flight, Landing, Refusal, Sample};
use crate::scenario::Scenario;
use control_core::{Axis, ConfigError};

mod account;
mod list;

pub use account::{Account, FirstAlarm, LedDown};
use account::{Accountant, refused};
pub use list::{METRICS, Metric};

/// Band around the setpoint that counts as recovered, m.
pub const RECOVERED_M: f64 = 0.1;
/// How long before a jump of the reference its old value is read, s.
const JUST_BEFORE_S: f64 = 1e-9;
/// How much of the fault's end, and of the time before it, the learnt gain is averaged over, s.
const GAIN_WINDOW_S: f64 = 5.0;
/// How long after an onset a machine that can recover has recovered, s.
const SETTLED_S: f64 = 5.0;
/// How long after the last fault it is back on station, s.
const RETURNED_S: f64 = 20.0;
/// How long before the fault a limit cycle is looked for, s.
const CYCLE_WINDOW_S: f64 = 10.0;

/// Measurements of one flight; see [`METRICS`] for what each says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Metrics {
    altitude_deviation_max_m: Option<f64>,
    lateral_deviation_max_m: Option<f64>,
    yaw_deviation_max_rad: Option<f64>,
    altitude_rebound_max_m: Option<f64>,
    altitude_iae_m_s: Option<f64>,
    altitude_recovery_s: Option<f64>,
    altitude_overshoot_m: Option<f64>,
    motor_total_variation_n_s: Option<f64>,
    ki_ratio_z: Option<f64>,
    lateral_limit_cycle_m: Option<f64>,
    altitude_drop_max_m: Option<f64>,
    horizontal_excursion_max_m: Option<f64>,
    position_error_settled_m: Option<f64>,
    position_error_end_m: Option<f64>,
    tilt_max_rad: Option<f64>,
    yaw_rate_max_rad_s: Option<f64>,
    lyapunov_rising_share: Option<f64>,
    gain_at_bound_share: Option<f64>,
    refused_share: Option<f64>,
}

/// A flight that was flown and measured.
#[derive(Clone, Copy, Debug)]
pub struct Flown {
    /// Its seed.
    pub seed: u64,
    /// How it crashed, if it did.
    pub crash: Option<Crash>,
    /// How a fault brought it down in one piece, if it did.
    pub landing: Option<Landing>,
    /// Why it never took off, if so.
    pub refusal: Option<Refusal>,
    /// What was measured until then.
    pub metrics: Metrics,
    /// What the controller said and could not do, until then.
    pub account: Account,
}

impl Flown {
    /// Whether it flew to the end.
    pub fn survived(&self) -> bool {
        self.crash.is_none() && self.landing.is_none() && self.refusal.is_none()
    }
}

/// Flies and measures; `observe` sees every tick as well.
pub fn fly_measured(flight: &Flight, observe: &mut dyn FnMut(&Sample)) -> Result<Flown, ConfigError> {
    measured(flight, |observe| flight.fly(observe), observe)
}

/// Measures what `fly` flies.
pub(crate) fn measured<E>(
    flight: &Flight,
    fly: impl FnOnce(&mut dyn FnMut(&Sample)) -> Result<Option<Ending>, E>,
    observe: &mut dyn FnMut(&Sample),
) -> Result<Flown, E> {
    let mut meter = Meter::new(flight.scenario);
    let mut accountant = Accountant::new(flight.scenario);
    let ending = fly(&mut |sample| {
        meter.note(sample);
        accountant.note(sample);
        observe(sample);
    })?;
    let mut flown = Flown {
        seed: flight.seed,
        crash: None,
        landing: None,
        refusal: None,
        metrics: meter.finish(),
        account: accountant.finish(),
    };
    match ending {
        None => {}
        Some(Ending::Crashed(crash)) => flown.crash = Some(crash),
        Some(Ending::CameDown(landing)) => flown.landing = Some(landing),
        Some(Ending::Refused(refusal)) => flown.refusal = Some(refusal),
    }
    Ok(flown)
}

/// Running mean.
#[derive(Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn note(&mut self, x: f64) {
        self.sum += x;
        self.count += 1.0;
    }

    fn value(&self) -> Option<f64> {
        (self.count > 0.0).then(|| self.sum / self.count)
    }
}

/// Measures while a flight is flown.
struct Meter {
    windows_s: Vec<(f64, f64)>,
    /// From the first altitude step to what disturbs it, and the altitudes it goes from and to.
    step: Option<(f64, f64, f64, f64)>,
    dt_s: f64,
    metrics: Metrics,
    variation_n: f64,
    fault_s: f64,
    last_command_n: Option<[f32; 4]>,
    ki_before: Mean,
    ki_learnt: Mean,
    cycle: [Option<(f64, f64)>; 2],
    v_rises: Mean,
    gain_at_bound: Mean,
    refused: Mean,
}

fn keep_max(place: &mut Option<f64>, x: f64) {
    *place = Some(place.map_or(x, |most| most.max(x)));
}

impl Meter {
    fn new(scenario: &Scenario) -> Self {
        let windows_s = scenario.fault_windows_s();
        let jumps_s = scenario.reference.jumps_s();
        let altitude = |t_s: f64| scenario.reference.target(t_s).position_m[2];
        let first_step = jumps_s.iter().position(|&at_s| altitude(at_s - JUST_BEFORE_S) != altitude(at_s));
        let step = first_step.map(|i| {
            let at_s = jumps_s[i];
            let next_s = jumps_s.get(i + 1).copied();
            let onset_s = windows_s.iter().map(|w| w.0).find(|&from_s| from_s > at_s);
            let end_s = [next_s, onset_s].into_iter().flatten().fold(scenario.duration_s, f64::min);
            (at_s, end_s, altitude(at_s - JUST_BEFORE_S), altitude(at_s))
        });
        let mut metrics = Metrics::default();
        if !windows_s.is_empty() {
            metrics.altitude_recovery_s = Some(0.0);
            metrics.altitude_iae_m_s = Some(0.0);
        }
        Self {
            windows_s,
            step,
            dt_s: 1.0 / scenario.control_hz(),
            metrics,
            variation_n: 0.0,
            fault_s: 0.0,
            last_command_n: None,
            ki_before: Mean::default(),
            ki_learnt: Mean::default(),
            cycle: [None; 2],
            v_rises: Mean::default(),
            gain_at_bound: Mean::default(),
            refused: Mean::default(),
        }
    }

    fn note(&mut self, sample: &Sample) {
        self.note_step(sample);
        self.note_faults(sample);
        self.note_upset(sample);
        self.note_first_fault(sample);
        self.note_monitor(sample);
        self.last_command_n = Some(sample.output.thrust_n);
    }

    /// Overshoot of the first step.
    fn note_step(&mut self, sample: &Sample) {
        let Some((at_s, end_s, from_m, to_m)) = self.step else { return };
        if (at_s..end_s).contains(&sample.t_s) {
            let beyond = (sample.truth.altitude_m() - to_m) * (to_m - from_m).signum();
            keep_max(&mut self.metrics.altitude_overshoot_m, beyond.max(0.0));
        }
    }

    /// Deviations in the fault windows and after them.
    fn note_faults(&mut self, sample: &Sample) {
        let Some(&(first_s, _)) = self.windows_s.first() else { return };
        let t_s = sample.t_s;
        if t_s < first_s {
            return;
        }
        let metrics = &mut self.metrics;
        let altitude = sample.altitude_error_m().abs();
        *metrics.altitude_iae_m_s.get_or_insert_default() += altitude * self.dt_s;
        let onset_s = self.windows_s.iter().map(|w| w.0).rfind(|&from_s| from_s <= t_s);
        if let Some(onset_s) = onset_s
            && altitude > RECOVERED_M
        {
            keep_max(&mut metrics.altitude_recovery_s, t_s - onset_s);
        }
        if self.windows_s.iter().any(|&(from_s, until_s)| (from_s..until_s).contains(&t_s)) {
            let [north, east] = sample.lateral_error_m();
            keep_max(&mut metrics.altitude_deviation_max_m, altitude);
            keep_max(&mut metrics.lateral_deviation_max_m, north.abs().max(east.abs()));
            keep_max(&mut metrics.yaw_deviation_max_rad, sample.yaw_error_rad().abs());
            self.fault_s += self.dt_s;
            let last = self.last_command_n.unwrap_or(sample.output.thrust_n);
            for (now, before) in sample.output.thrust_n.iter().zip(last) {
                self.variation_n += f64::from((now - before).abs());
            }
        } else if self.windows_s.last().is_some_and(|&(_, until_s)| t_s >= until_s) {
            keep_max(&mut metrics.altitude_rebound_max_m, altitude);
        }
    }

    /// How far it is thrown by the faults, and how it comes back.
    fn note_upset(&mut self, sample: &Sample) {
        let (Some(&(first_s, _)), Some(&(_, last_s))) = (self.windows_s.first(), self.windows_s.last()) else { return };
        let t_s = sample.t_s;
        if t_s < first_s {
            return;
        }
        let metrics = &mut self.metrics;
        let [north, east] = sample.lateral_error_m();
        let (lateral, up) = (libm::hypot(north, east), sample.altitude_error_m());
        let away = libm::hypot(lateral, up);
        keep_max(&mut metrics.tilt_max_rad, sample.truth.tilt_rad());
        keep_max(&mut metrics.yaw_rate_max_rad_s, sample.truth.rate_rad_s.z.abs());
        if let Some(&(from_s, _)) = self.windows_s.iter().find(|(from_s, until_s)| (*from_s..*until_s).contains(&t_s)) {
            keep_max(&mut metrics.altitude_drop_max_m, (-up).max(0.0));
            keep_max(&mut metrics.horizontal_excursion_max_m, lateral);
            if t_s >= from_s + SETTLED_S {
                keep_max(&mut metrics.position_error_settled_m, away);
            }
        }
        if t_s <= last_s + RETURNED_S {
            metrics.position_error_end_m = Some(away);
        }
    }

    /// What the gains learn from the first fault, and what the machine did before it.
    fn note_first_fault(&mut self, sample: &Sample) {
        let Some(&(from_s, until_s)) = self.windows_s.first() else { return };
        let t_s = sample.t_s;
        let [_, ki, _] = sample.telemetry.axes[Axis::Z as usize].gains;
        if (from_s - GAIN_WINDOW_S..from_s).contains(&t_s) {
            self.ki_before.note(ki.into());
        }
        if ((until_s - GAIN_WINDOW_S).max(from_s)..until_s).contains(&t_s) {
            self.ki_learnt.note(ki.into());
        }
        if (from_s - CYCLE_WINDOW_S..from_s).contains(&t_s) {
            for (range, x) in self.cycle.iter_mut().zip(sample.lateral_error_m()) {
                let (low, high) = range.unwrap_or((x, x));
                *range = Some((low.min(x), high.max(x)));
            }
        }
    }

    /// What the run-time monitor says.
    fn note_monitor(&mut self, sample: &Sample) {
        let axes = &sample.telemetry.axes;
        let at_bound = axes.iter().any(|axis| axis.at_bound().contains(&true));
        self.gain_at_bound.note(f64::from(at_bound));
        if self.windows_s.iter().any(|&(from_s, until_s)| (from_s..until_s).contains(&sample.t_s)) {
            let (thrust, tilting) = refused(sample);
            self.v_rises.note(f64::from(axes[Axis::Z as usize].v_rises()));
            self.refused.note(f64::from(thrust || tilting));
        }
    }

    fn finish(self) -> Metrics {
        let cycle = self.cycle.iter().flatten().map(|(low, high)| (high - low) / 2.0);
        Metrics {
            motor_total_variation_n_s: (self.fault_s > 0.0).then(|| self.variation_n / self.fault_s),
            ki_ratio_z: self.ki_learnt.value().zip(self.ki_before.value()).map(|(learnt, before)| learnt / before),
            lateral_limit_cycle_m: cycle.reduce(f64::max),
            lyapunov_rising_share: self.v_rises.value(),
            gain_at_bound_share: self.gain_at_bound.value(),
            refused_share: self.refused.value(),
            ..self.metrics
        }
    }
}

/// Median and worst of a metric over the flights that survived; none if there is none.
pub fn median_and_worst(flights: &[Flown], metric: &Metric) -> Option<(f64, f64)> {
    let mut values: Vec<f64> =
        flights.iter().filter(|flown| flown.survived()).filter_map(|flown| (metric.of)(&flown.metrics)).collect();
    values.sort_by(f64::total_cmp);
    let worst = *values.last()?;
    let middle = values.len() / 2;
    let median =
        if values.len().is_multiple_of(2) { f64::midpoint(values[middle - 1], values[middle]) } else { values[middle] };
    Some((median, worst))
}
