//! Report: what one second of ticks amounts to, for the log.
use crate::flight::Step;
use crate::pulse::Pulse;

/// One second of flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Ticks since boot.
    pub ticks: u32,
    /// Of these, how many ended when the next one was already due.
    pub late: u32,
    /// Of these, how many refused their sample as implausible.
    pub rejected: u32,
    /// Of these, how many had no inertial sample.
    pub blind: u32,
    /// Hash of all thrusts since boot: two machines that are given the same samples show the same.
    pub hash: u32,
    /// Core clock cycles of the dearest tick of this second.
    pub cycles_max: u32,
    /// Largest magnitude of the altitude error in this second, m.
    pub altitude_error_m_max: f32,
    /// Gains `(k_p, k_i, k_d)` of the altitude axis; zero until whoever closes the report fills them in.
    pub altitude_gains: [f32; 3],
    /// What the motors would be sent if this image could arm.
    pub pulses: [Pulse; 4],
}

/// FNV-1a, 32 bits, by words: what it starts with and what it multiplies by.
const HASH_START: u32 = 0x811c_9dc5;
const HASH_FACTOR: u32 = 0x0100_0193;

fn hash(before: u32, value: f32) -> u32 {
    (before ^ value.to_bits()).wrapping_mul(HASH_FACTOR)
}

/// Counts ticks and closes a [`Report`] each second.
#[derive(Clone, Copy, Debug)]
pub struct Tally {
    ticks_per_report: u32,
    left: u32,
    report: Report,
}

impl Tally {
    /// An empty count that closes a report every `control_hz` ticks, and no more often than every tick.
    pub fn new(control_hz: f32) -> Self {
        let ticks_per_report = ((control_hz + 0.5) as u32).max(1);
        let report = Report {
            ticks: 0,
            late: 0,
            rejected: 0,
            blind: 0,
            hash: HASH_START,
            cycles_max: 0,
            altitude_error_m_max: 0.0,
            altitude_gains: [0.0; 3],
            pulses: [Pulse::STOP; 4],
        };
        Self { ticks_per_report, left: ticks_per_report, report }
    }

    /// Takes in one tick: what it saw, what it gave, what it cost.
    pub fn tick(&mut self, step: &Step, has_sample: bool, pulses: [Pulse; 4], cycles: u32) {
        let (report, input) = (&mut self.report, &step.input);
        report.ticks = report.ticks.saturating_add(1);
        report.rejected = report.rejected.saturating_add(step.output.rejected.into());
        report.blind = report.blind.saturating_add((!has_sample).into());
        report.hash = step.output.thrust_n.into_iter().fold(report.hash, hash);
        report.cycles_max = report.cycles_max.max(cycles);
        let altitude_error_m = (input.setpoint.position_m.z - input.position_m.z).abs();
        report.altitude_error_m_max = report.altitude_error_m_max.max(altitude_error_m);
        report.pulses = pulses;
    }

    /// Notes whether that tick ended late; returns the report if the second is over.
    pub fn close(&mut self, late: bool) -> Option<Report> {
        self.report.late = self.report.late.saturating_add(late.into());
        self.left = self.left.saturating_sub(1);
        if self.left > 0 {
            return None;
        }
        let report = self.report;
        self.left = self.ticks_per_report;
        self.report.cycles_max = 0;
        self.report.altitude_error_m_max = 0.0;
        Some(report)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::{Command, Step};
    use control_core::{Input, Output};
    use std::vec::Vec;

    #[test]
    fn a_report_closes_every_second_and_starts_its_maxima_anew() {
        let mut tally = Tally::new(500.0);
        let mut reports = Vec::new();
        for tick in 0..1_000_u16 {
            let mut input = Input::hovering();
            // Sinks back from half a metre too high.
            input.position_m.z = (f32::from(tick) - 1_000.0) / 2_000.0;
            let output = Output { thrust_n: [1.0; 4], rejected: tick == 600 };
            let step = Step { command: Command::Stop, input, output };
            tally.tick(&step, tick % 100 != 7, [Pulse::STOP; 4], u32::from(700 - tick / 2));
            reports.extend(tally.close(tick == 10));
        }
        let counts = |r: &Report| [r.ticks, r.late, r.rejected, r.blind, r.cycles_max];
        let [first, second] = &reports[..] else { panic!("{} reports", reports.len()) };
        assert_eq!(counts(first), [500, 1, 0, 5, 700]);
        assert_eq!(counts(second), [1_000, 1, 1, 10, 450]);
        assert_ne!(first.hash, second.hash);
        assert!((first.altitude_error_m_max - 0.5).abs() < 1e-6);
        assert!((second.altitude_error_m_max - 0.25).abs() < 1e-6);
    }
}
