//! What happened in a sortie, in words: who armed, which mode was flown and why, what failed and what was done.
use crate::flight::Sample;
use crate::sortie::Decision;
use control_core::arming::Check;
use control_core::estimation::{EstimatorTelemetry, SOURCES, Source, SourceFault};
use control_core::failsafe::Failsafe;
use control_core::modes::{Mode, Reason};
use std::fmt::Display;

/// One thing that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Happening {
    /// When, s.
    pub t_s: f64,
    /// What.
    pub what: String,
}

/// Everything that happened in a flight, in order.
#[derive(Default)]
pub struct Chronicle {
    happenings: Vec<Happening>,
    armed: bool,
    landed: Option<bool>,
    mode: Option<(Mode, Option<Reason>)>,
    failsafes: Vec<Failsafe>,
    wiring: bool,
    sources: [Option<SourceFault>; SOURCES],
    inertial: Option<Source>,
}

impl Chronicle {
    /// Everything so far.
    pub fn happenings(&self) -> &[Happening] {
        &self.happenings
    }

    fn note(&mut self, t_s: f64, what: impl Display) {
        self.happenings.push(Happening { t_s, what: what.to_string() });
    }

    /// Notes one tick.
    pub fn step(&mut self, sample: &Sample) {
        self.look(sample.t_s, sample.estimator, sample.decision);
    }

    /// Notes what estimator and autopilot say at one time, as far as they are there.
    pub fn look(&mut self, t_s: f64, estimator: Option<&EstimatorTelemetry>, decision: Option<&Decision>) {
        if let Some(estimator) = estimator {
            for (i, source) in Source::ALL.into_iter().enumerate() {
                let fault = estimator.sources[i].fault;
                // A sensor that has never been heard is not there.
                if fault != self.sources[i] && estimator.sources[i].taken > 0 {
                    match fault {
                        Some(fault) => self.note(t_s, format_args!("{source}: {fault}")),
                        None => self.note(t_s, format_args!("{source}: well again")),
                    }
                    self.sources[i] = fault;
                }
            }
        }
        let inertial = estimator.map(|estimator| estimator.inertial);
        if let (Some(_), Some(unit)) = (self.inertial, inertial.filter(|_| inertial != self.inertial)) {
            self.note(t_s, format_args!("flies on the {unit}"));
        }
        self.inertial = inertial;
        let Some(decision) = decision else { return };
        let command = decision.command;
        if let Some(verdict) = decision.state.wiring().filter(|_| !self.wiring) {
            self.wiring = true;
            match verdict {
                Ok(()) => self.note(t_s, "wiring check: passed"),
                Err(fault) => self.note(t_s, format_args!("wiring check: {fault}")),
            }
        }
        if command.refused {
            let failing: Vec<String> = command.failing.iter().map(|check: Check| check.to_string()).collect();
            self.note(t_s, format_args!("arming refused: {}", failing.join("; ")));
        }
        let acting: Vec<Failsafe> = command.failsafes.iter().collect();
        for failsafe in &acting {
            if !self.failsafes.contains(failsafe) {
                self.note(t_s, format_args!("failsafe: {failsafe}: {}", failsafe.row().reaction));
            }
        }
        for failsafe in std::mem::take(&mut self.failsafes) {
            if !acting.contains(&failsafe) && command.armed {
                self.note(t_s, format_args!("failsafe over: {failsafe}"));
            }
        }
        self.failsafes = acting;
        if command.armed != self.armed {
            self.armed = command.armed;
            self.note(t_s, if command.armed { "armed" } else { "disarmed" });
        }
        if command.armed && self.mode != Some((command.mode, command.reason)) {
            self.mode = Some((command.mode, command.reason));
            match command.reason {
                Some(reason) => self.note(t_s, format_args!("{}: {reason}", command.mode)),
                None => self.note(t_s, command.mode),
            }
        }
        if self.landed != Some(command.landed) {
            if self.landed.is_some() {
                self.note(t_s, if command.landed { "on the ground" } else { "in the air" });
            }
            self.landed = Some(command.landed);
        }
    }
}
