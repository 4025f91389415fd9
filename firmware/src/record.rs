//! Record: what the last step was given and what it decided, in words.
//!
//! The image keeps one in RAM that no reset clears: whoever asks why it fell finds the last step there, and a probe or the
//! emulator can look while it flies. A record that is being written has an odd sequence number.
use control_core::frames::Vec3;
use control_core::measurement::{Imu, Measurements, Stamped};

use crate::flight::{Command, Step};

/// Words of a record.
pub const WORDS: usize = 20;
/// Says which of the optional parts are there.
const HAS_IMU: u32 = 1;
const HAS_BATTERY: u32 = 2;
const RUNS: u32 = 4;
const REJECTED: u32 = 8;

/// One step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Steps since boot.
    pub step: u32,
    /// When, µs since boot.
    pub time_us: u64,
    /// The inertial sample; when is [`Self::time_us`].
    pub imu: Option<Imu>,
    /// Battery, V, if it was measured since the last step, and when, µs since boot.
    pub battery_v: Option<Stamped<f32>>,
    /// What the motors were told.
    pub command: Command,
    /// What the core asked of the rotors, N.
    pub thrust_n: [f32; 4],
    /// Whether the core refused the sample.
    pub rejected: bool,
}

impl Record {
    /// The record of a step.
    pub fn of(number: u32, time_us: u64, measurements: &Measurements, step: &Step) -> Self {
        Self {
            step: number,
            time_us,
            imu: measurements.imu.map(|imu| imu.value),
            battery_v: measurements.battery_v,
            command: step.command,
            thrust_n: step.output.thrust_n,
            rejected: step.output.rejected,
        }
    }

    /// What the step was given.
    pub fn measurements(&self) -> Measurements {
        let time_us = self.time_us;
        Measurements {
            imu: self.imu.map(|value| Stamped { time_us, value }),
            battery_v: self.battery_v,
            ..Measurements::default()
        }
    }

    /// The record in words, without its sequence number.
    pub fn to_words(&self) -> [u32; WORDS] {
        let mut words = [0; WORDS];
        let has = |on: bool, bit: u32| if on { bit } else { 0 };
        let shares = if let Command::Run(shares) = self.command { Some(shares) } else { None };
        words[0] = has(self.imu.is_some(), HAS_IMU)
            | has(self.battery_v.is_some(), HAS_BATTERY)
            | has(shares.is_some(), RUNS)
            | has(self.rejected, REJECTED);
        words[1] = self.step;
        [words[2], words[3]] = halves(self.time_us);
        if let Some(Imu { rate_rad_s: r, specific_force_m_s2: f }) = self.imu {
            put(&mut words[4..10], &[r.x, r.y, r.z, f.x, f.y, f.z]);
        }
        if let Some(battery) = self.battery_v {
            words[10] = battery.value.to_bits();
            // The rest of its time is that of the step.
            words[11] = self.time_us.saturating_sub(battery.time_us).min(u32::MAX.into()) as u32;
        }
        put(&mut words[12..16], &shares.unwrap_or_default());
        put(&mut words[16..20], &self.thrust_n);
        words
    }

    /// The record that these words are.
    pub fn from_words(words: &[u32; WORDS]) -> Self {
        let float = |n: usize| f32::from_bits(words[n]);
        let three = |n: usize| Vec3::new(float(n), float(n + 1), float(n + 2));
        let four = |n: usize| [float(n), float(n + 1), float(n + 2), float(n + 3)];
        let has = |bit: u32| words[0] & bit != 0;
        let time_us = u64::from(words[3]) << 32 | u64::from(words[2]);
        Self {
            step: words[1],
            time_us,
            imu: has(HAS_IMU).then(|| Imu { rate_rad_s: three(4), specific_force_m_s2: three(7) }),
            battery_v: has(HAS_BATTERY)
                .then(|| Stamped { time_us: time_us.saturating_sub(words[11].into()), value: float(10) }),
            command: if has(RUNS) { Command::Run(four(12)) } else { Command::Stop },
            thrust_n: four(16),
            rejected: has(REJECTED),
        }
    }
}

fn halves(x: u64) -> [u32; 2] {
    [x as u32, (x >> 32) as u32]
}

fn put(words: &mut [u32], values: &[f32]) {
    for (word, value) in words.iter_mut().zip(values) {
        *word = value.to_bits();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_read_as_it_was_written() {
        let imu = Imu { rate_rad_s: Vec3::new(0.1, -0.2, 0.3), specific_force_m_s2: Vec3::new(1.0, 2.0, -9.8) };
        let bare = Record {
            step: 7,
            time_us: 0x1_2345_6789,
            imu: None,
            battery_v: None,
            command: Command::Stop,
            thrust_n: [1.0, 2.0, 3.0, 4.0],
            rejected: true,
        };
        let full = Record {
            imu: Some(imu),
            battery_v: Some(Stamped { time_us: bare.time_us - 400, value: 16.1 }),
            command: Command::Run([0.1, 0.2, 0.3, 0.4]),
            rejected: false,
            ..bare
        };
        for record in [bare, full] {
            assert_eq!(Record::from_words(&record.to_words()), record);
        }
    }
}
