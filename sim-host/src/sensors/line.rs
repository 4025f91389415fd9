//! When a sensor samples, how late its samples arrive, and how well they are stamped.
//!
//! A sample is of the first tick at or after its due time, since truth is known at ticks. It is handed over at the first
//! tick by which its latency has passed. What a driver would miss, the last but one of two that arrive together, is lost.
use super::chance::Chance;
use control_core::measurement::Stamped;
use std::collections::VecDeque;

/// Slack of a comparison of times, s: far below a tick, far above rounding.
const SLACK_S: f64 = 1e-7;

/// Rate, latency and jitter of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Timing {
    /// Samples a second.
    pub(super) rate_hz: f64,
    /// From when a sample is true to when it is handed over, s.
    pub(super) latency_s: f64,
    /// Standard deviation of its time stamp, s.
    pub(super) jitter_s: f64,
}

/// One sensor's samples, from due to handed over.
pub(super) struct Line<T> {
    timing: Timing,
    /// When the first is due, s.
    phase_s: f64,
    /// Samples so far.
    taken: u64,
    /// When each will arrive, oldest first.
    under_way: VecDeque<(f64, Stamped<T>)>,
}

impl<T> Line<T> {
    /// - `phase`: when the first sample is due, in periods: sensors are not in step with the control loop.
    pub(super) fn new(timing: Timing, phase: f64) -> Self {
        Self { timing, phase_s: phase / timing.rate_hz, taken: 0, under_way: VecDeque::new() }
    }

    /// Whether a sample is due at `t_s`; the next one then is one period later, or at the next tick if that is over.
    pub(super) fn is_due(&mut self, t_s: f64) -> bool {
        let due = |taken: u64| self.phase_s + taken as f64 / self.timing.rate_hz;
        if t_s + SLACK_S < due(self.taken) {
            return false;
        }
        self.taken += 1;
        if t_s + SLACK_S >= due(self.taken) {
            self.taken = ((t_s - self.phase_s + SLACK_S) * self.timing.rate_hz) as u64 + 1;
        }
        true
    }

    /// Sends what was true at `true_s`, if it is not lost, and draws the error of its stamp in any case.
    pub(super) fn send(&mut self, true_s: f64, value: Option<T>, chance: &mut Chance) {
        let stamp_s = true_s + self.timing.jitter_s * chance.normal();
        let Some(value) = value else { return };
        let time_us = libm::round(stamp_s.max(0.0) * 1e6) as u64;
        self.under_way.push_back((true_s + self.timing.latency_s, Stamped { time_us, value }));
    }

    /// The newest sample that has arrived by `t_s`.
    pub(super) fn receive(&mut self, t_s: f64) -> Option<Stamped<T>> {
        let mut newest = None;
        while self.under_way.front().is_some_and(|(arrives_s, _)| *arrives_s <= t_s + SLACK_S) {
            newest = self.under_way.pop_front().map(|(_, sample)| sample);
        }
        newest
    }
}
