//! The image's steps, decided again by the host's build of what it flies, from what the image has decoded.
use crate::aloft::SAMPLE_HZ;
use control_core::flight::{Command, Flight};
use control_core::parameters::Parameters;
use control_core::restart::Memory;
use firmware::flight::boot;
use firmware::record::Record;

/// Steps between two that the image keeps over a reset (firmware/src/restart.rs).
const KEEP_EVERY: u32 = 8;

/// The host's build of what the image flies, given the same.
pub struct Host {
    flight: Flight,
    /// What is kept over a reset.
    kept: Option<Memory>,
    /// The last step that it has decided.
    pub last: u32,
    /// FNV-1a of all commands, the image's and the host's, as the image's log has it.
    pub hashes: [u32; 2],
}

impl Default for Host {
    fn default() -> Self {
        Self { flight: switched_on(), kept: None, last: 0, hashes: [0x811c_9dc5; 2] }
    }
}

impl Host {
    /// Starts anew, as the image has: after its watchdog it goes on, with what it has kept itself, if that lets it.
    ///
    /// - `first`: what the image has made of its first step since.
    pub fn reset(&mut self, by_watchdog: bool, first: &Record) {
        let kept = self.kept.filter(|_| by_watchdog);
        *self = Self { hashes: self.hashes, ..Self::default() };
        if let Some(kept) = kept {
            // If it does not go on it is as just switched on, like the image.
            self.flight.resume(kept, first.time_us);
        }
    }

    /// Decides what the image has decided, or fails.
    ///
    /// # Panics
    /// If it decides otherwise, or a step is missing.
    pub fn follow(&mut self, record: &Record) {
        assert_eq!(record.step, self.last + 1, "one step a sample");
        self.last = record.step;
        let command = self.flight.step(record.time_us, &record.arrived);
        if record.step.is_multiple_of(KEEP_EVERY) {
            self.kept = self.flight.remember();
        }
        for (hash, command) in self.hashes.iter_mut().zip([record.command, command]) {
            *hash = bits(command).into_iter().fold(*hash, |hash, word| (hash ^ word).wrapping_mul(0x0100_0193));
        }
        if record.step.is_multiple_of(SAMPLE_HZ) {
            println!("second {}: image {:08x}, host {:08x}", record.step / SAMPLE_HZ, self.hashes[0], self.hashes[1]);
        }
        let same = (bits(command), command == Command::Stop) == (bits(record.command), record.command == Command::Stop);
        assert!(same, "step {}: image {:?}, host {command:?}", record.step, record.command);
    }
}

fn switched_on() -> Flight {
    boot(&Parameters::default()).expect("the shipped configuration")
}

fn bits(command: Command) -> [u32; 4] {
    command.speeds().map(f32::to_bits)
}
