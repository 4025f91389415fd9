//! Report: what one second of steps amounts to, for the log.
use control_core::arming::Check;
use control_core::flight::Command;
use control_core::set::Set;

use crate::erpm::{Heard, MOTORS};

/// One second of flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Steps since boot.
    pub steps: u32,
    /// Of these, how many took longer than a period.
    pub late: u32,
    /// Of these, how many had no inertial sample.
    pub blind: u32,
    /// Hash of all commands since boot: two machines that are given the same show the same.
    pub hash: u32,
    /// Core clock cycles of the dearest step of this second, from data ready to the motor frames sent.
    pub cycles_max: u32,
    /// The last command.
    pub command: Command,
    /// For what arming was refused in this second.
    pub refused: Set<Check>,
    /// What each speed controller has answered in this second, if they are asked; whoever sends the frames fills it in.
    pub answers: Option<[Heard; MOTORS]>,
}

/// FNV-1a, 32 bits, by words: what it starts with and what it multiplies by.
const HASH_START: u32 = 0x811c_9dc5;
const HASH_FACTOR: u32 = 0x0100_0193;

fn hash(before: u32, value: f32) -> u32 {
    (before ^ value.to_bits()).wrapping_mul(HASH_FACTOR)
}

/// Counts steps and closes a [`Report`] each second.
#[derive(Clone, Copy, Debug)]
pub struct Tally {
    steps_per_report: u32,
    left: u32,
    report: Report,
}

impl Tally {
    /// An empty count that closes a report every `rate_hz` steps, and no more often than every step.
    pub fn new(rate_hz: f32) -> Self {
        let steps_per_report = ((rate_hz + 0.5) as u32).max(1);
        let (command, refused) = (Command::Stop, Set::EMPTY);
        let report =
            Report { steps: 0, late: 0, blind: 0, hash: HASH_START, cycles_max: 0, command, refused, answers: None };
        Self { steps_per_report, left: steps_per_report, report }
    }

    /// Takes in one step: whether it had an inertial sample, what it decided, what it cost.
    pub fn step(&mut self, has_sample: bool, command: Command, cycles: u32) {
        let report = &mut self.report;
        report.steps = report.steps.saturating_add(1);
        report.blind = report.blind.saturating_add((!has_sample).into());
        report.hash = command.speeds().into_iter().fold(report.hash, hash);
        report.cycles_max = report.cycles_max.max(cycles);
        report.command = command;
    }

    /// Takes in that arming was refused in this step, because of `failing`.
    pub fn refuse(&mut self, failing: Set<Check>) {
        failing.iter().for_each(|check| self.report.refused.put(check, true));
    }

    /// Notes whether that step ended late; returns the report if the second is over.
    pub fn close(&mut self, late: bool) -> Option<Report> {
        self.report.late = self.report.late.saturating_add(late.into());
        self.left = self.left.saturating_sub(1);
        if self.left > 0 {
            return None;
        }
        let report = self.report;
        self.left = self.steps_per_report;
        (self.report.cycles_max, self.report.refused) = (0, Set::EMPTY);
        Some(report)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn a_report_closes_every_second_and_starts_its_maxima_anew() {
        let mut tally = Tally::new(500.0);
        let mut reports = Vec::new();
        for step in 0..1_000_u16 {
            tally.step(step % 100 != 7, Command::Run([0.5; 4]), u32::from(700 - step / 2));
            reports.extend(tally.close(step == 10));
        }
        let counts = |r: &Report| [r.steps, r.late, r.blind, r.cycles_max];
        let [first, second] = &reports[..] else { panic!("{} reports", reports.len()) };
        assert_eq!(counts(first), [500, 1, 5, 700]);
        assert_eq!(counts(second), [1_000, 1, 10, 450]);
        assert_ne!(first.hash, second.hash);
    }

    #[test]
    fn what_arming_was_refused_for_is_told_once() {
        let mut tally = Tally::new(2.0);
        let refused: Vec<Set<Check>> = [Some(Check::Link), Some(Check::Level), None, None]
            .into_iter()
            .filter_map(|check| {
                tally.refuse(check.into_iter().collect());
                tally.close(false)
            })
            .map(|report| report.refused)
            .collect();
        assert_eq!(refused, [[Check::Link, Check::Level].into_iter().collect(), Set::EMPTY]);
    }
}
