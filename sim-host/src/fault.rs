//! A fault in flight: how much of it is there, tick by tick, with what chance decides.
//!
//! What faults are is in the core, for all who speak of them. Random numbers are drawn here, each fault from a stream of
//! its own.
pub use control_core::fault::*;
use rand::RngExt;
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64;

/// Rotors as people name them: `rotor 1`, `rotors 1, 3`.
pub fn in_words(rotors: Rotors) -> String {
    let numbers: Vec<_> = rotors.numbers().map(|number| number.to_string()).collect();
    format!("rotor{} {}", if numbers.len() == 1 { "" } else { "s" }, numbers.join(", "))
}

/// Something that goes on and off.
#[derive(Clone, Debug)]
pub(crate) struct Toggle {
    pub(crate) on: bool,
    until_s: f64,
}

impl Toggle {
    /// Off, to go on at `from_s`.
    pub(crate) fn off_until(from_s: f64) -> Self {
        Self { on: false, until_s: from_s }
    }

    /// Brings it to `t_s`; `lasts_s` says how long each state lasts.
    pub(crate) fn advance(&mut self, t_s: f64, mut lasts_s: impl FnMut(bool) -> f64) {
        while t_s >= self.until_s {
            self.on = !self.on;
            self.until_s += lasts_s(self.on);
        }
    }
}

/// A fault and where it stands.
#[derive(Clone, Debug)]
pub struct Occurrence {
    fault: Fault,
    random: Pcg64,
    /// Whether an intermittent fault is there.
    drawn: Toggle,
    /// Whether a speed controller has lost its motor, and until when.
    dropout: Toggle,
    /// Where between none and all of it each rotor's delay is, if delays are drawn.
    delays: [f64; 4],
    level: f64,
}

impl Occurrence {
    /// `fault` before its flight.
    pub fn new(fault: Fault, random: Pcg64) -> Self {
        let before = Toggle::off_until(fault.from_s);
        Self { fault, random, drawn: before.clone(), dropout: before, delays: [0.0; 4], level: 0.0 }
    }

    /// Brings it to `t_s`, which never goes back.
    pub fn advance(&mut self, t_s: f64) {
        let random = &mut self.random;
        let mut about = |mean_s: f64| -> f64 {
            let unit: f64 = Exp1.sample(random);
            mean_s * unit
        };
        if self.fault.is_active(t_s) {
            if let Profile::Intermittent(Intermittent { on_mean_s, off_mean_s }) = self.fault.profile {
                self.drawn.advance(t_s, |on| about(if on { on_mean_s } else { off_mean_s }));
            }
            if let FaultKind::EscDesync { dropout_s, recurrence, .. } = self.fault.kind {
                self.dropout.advance(t_s, |out| match recurrence {
                    _ if out => dropout_s,
                    Recurrence::Period { period_s } => period_s - dropout_s,
                    Recurrence::Rate { rate_1_s } => about(1.0 / rate_1_s),
                });
            }
        }
        self.level = self.fault.level(t_s, self.drawn.on);
        if self.level > 0.0 && matches!(self.fault.kind, FaultKind::CommandJitter { .. }) {
            self.delays = self.random.random();
        }
    }

    /// The fault.
    pub fn fault(&self) -> &Fault {
        &self.fault
    }

    /// How much of it is there, 0..=1.
    pub fn level(&self) -> f64 {
        self.level
    }

    /// How late the command to rotor `index + 1` is now, s.
    pub fn delay_s(&self, index: usize) -> f64 {
        self.level
            * match self.fault.kind {
                FaultKind::CommandDelay { delay_s } => delay_s,
                FaultKind::CommandJitter { delay_s_max } => delay_s_max * self.delays[index],
                _ => 0.0,
            }
    }

    /// Whether a speed controller that loses its motor has lost it now.
    pub fn has_dropped_out(&self) -> bool {
        self.dropout.on
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn occurrence(kind: FaultKind, profile: Profile, seed: u64) -> Occurrence {
        let fault = Fault { kind, rotors: Rotors::ALL, from_s: 10.0, until_s: 4000.0, profile, reported: false };
        Occurrence::new(fault, Pcg64::seed_from_u64(seed))
    }

    /// Share of the time it is `on` between 10 and 4000 s, number of onsets, and whether it was on at 10 s.
    fn measure(mut fault: Occurrence, on: impl Fn(&Occurrence) -> bool) -> (f64, f64, bool) {
        let (mut ticks, mut share, mut onsets, mut was, mut first) = (0.0, 0.0, 0.0, false, None);
        for i in 0..400_000 {
            let t_s = f64::from(i) * 0.01;
            fault.advance(t_s);
            if t_s < 10.0 {
                assert!(!on(&fault), "nothing before the onset");
                continue;
            }
            let is = on(&fault);
            first.get_or_insert(is);
            ticks += 1.0;
            share += f64::from(u8::from(is));
            onsets += f64::from(u8::from(is && !was));
            was = is;
        }
        (share / ticks, onsets, first == Some(true))
    }

    #[test]
    fn intermittent_faults_last_and_return_as_stated() {
        let profile = Profile::Intermittent(Intermittent { on_mean_s: 0.5, off_mean_s: 1.5 });
        let fault = occurrence(FaultKind::Stopped, profile, 1);
        let (share, onsets, first) = measure(fault, |fault| fault.level() > 0.0);
        assert!(first, "it starts on");
        // 2000 cycles: the estimates are within 5 %.
        assert!((share - 0.25).abs() < 0.02, "{share}");
        assert!((onsets / 3990.0 - 0.5).abs() < 0.03, "{onsets}");
    }

    #[test]
    fn desync_drops_out_by_period_or_by_rate() {
        let desync = |recurrence| {
            occurrence(FaultKind::EscDesync { dropout_s: 0.1, restart_s: 0.1, recurrence }, Profile::Step, 2)
        };
        let (share, onsets, _) = measure(desync(Recurrence::Period { period_s: 1.0 }), Occurrence::has_dropped_out);
        assert!((share - 0.1).abs() < 0.002 && (onsets - 3990.0).abs() <= 1.0, "{share} {onsets}");
        let (share, onsets, _) = measure(desync(Recurrence::Rate { rate_1_s: 2.0 }), Occurrence::has_dropped_out);
        // Half a second of running between drop-outs of a tenth.
        assert!((share - 1.0 / 6.0).abs() < 0.01 && (onsets / 3990.0 - 1.0 / 0.6).abs() < 0.08, "{share} {onsets}");
    }
}
