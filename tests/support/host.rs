//! The image's steps, decided again by the host's build of what it flies, from what the image has decoded.
use crate::aloft::SAMPLE_HZ;
use control_core::flight::{Command, Flight};
use control_core::parameters::Parameters;
use firmware::record::Record;

/// The host's build of what the image flies, given the same.
pub struct Host {
    flight: Flight,
    /// The last step that it has decided.
    pub last: u32,
    /// FNV-1a of all commands, the image's and the host's, as the image's log has it.
    pub hashes: [u32; 2],
}

impl Default for Host {
    fn default() -> Self {
        let flight = firmware::flight::boot(&Parameters::default()).expect("the shipped configuration");
        Self { flight, last: 0, hashes: [0x811c_9dc5; 2] }
    }
}

impl Host {
    /// Decides what the image has decided, or fails.
    ///
    /// # Panics
    /// If it decides otherwise, or a step is missing.
    pub fn follow(&mut self, record: &Record) {
        assert_eq!(record.step, self.last + 1, "one step a sample");
        self.last = record.step;
        let command = self.flight.step(record.time_us, &record.arrived);
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

fn bits(command: Command) -> [u32; 4] {
    command.speeds().map(f32::to_bits)
}
