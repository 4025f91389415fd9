//! Record: what the last step was given and what it decided, in words.
//!
//! The image keeps one in RAM that no reset clears: whoever asks why it fell finds the last step there, and a probe or the
//! emulator can look while it flies. A record that is being written has an odd sequence number.
use control_core::flight::{Arrived, Command};
use control_core::frames::Vec3;
use control_core::measurement::{Imu, Measurements, Stamped};
use control_core::modes::Mode;
use control_core::pilot::{PilotInput, Sticks};

/// Words of a record.
pub const WORDS: usize = 22;
/// Bits of the first word: which of the optional parts are there, and facts.
const HAS_IMU: u32 = 1;
const HAS_BATTERY: u32 = 1 << 1;
const HAS_PILOT: u32 = 1 << 2;
const RUNS: u32 = 1 << 3;
const LATE: u32 = 1 << 4;
const TESTED: u32 = 1 << 5;
const ARM: u32 = 1 << 6;
const VALID: u32 = 1 << 7;
/// From here on, the pilot's mode by its place in [`Mode::ALL`].
const MODE_SHIFT: u32 = 8;

/// One step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Steps since boot.
    pub step: u32,
    /// When, µs since boot. The time of the inertial sample is the same.
    pub time_us: u64,
    /// What the step was given. Of the measurements, the inertial sample and the battery; nobody speaks offboard.
    pub arrived: Arrived,
    /// What it decided.
    pub command: Command,
}

impl Record {
    /// The record in words, without its sequence number.
    pub fn to_words(&self) -> [u32; WORDS] {
        let Arrived { measurements, pilot, offboard: _, late, self_test_passed, parameters_valid } = self.arrived;
        let Measurements { imu, battery_v, .. } = measurements;
        let mut words = [0; WORDS];
        let bit = |on: bool, bit: u32| if on { bit } else { 0 };
        words[0] = bit(imu.is_some(), HAS_IMU) | bit(late, LATE) | bit(self_test_passed, TESTED);
        words[0] |= bit(parameters_valid, VALID);
        words[1] = self.step;
        [words[2], words[3]] = [self.time_us as u32, (self.time_us >> 32) as u32];
        if let Some(Stamped { value: Imu { rate_rad_s: r, specific_force_m_s2: f }, .. }) = imu {
            put(&mut words[4..10], &[r.x, r.y, r.z, f.x, f.y, f.z]);
        }
        if let Some(Stamped { time_us, value }) = battery_v {
            words[0] |= HAS_BATTERY;
            [words[10], words[11]] = [value.to_bits(), self.age_us(time_us)];
        }
        if let Command::Run(shares) = self.command {
            words[0] |= RUNS;
            put(&mut words[12..16], &shares);
        }
        if let Some(Stamped { time_us, value: PilotInput { sticks: s, arm, mode } }) = pilot {
            let place = Mode::ALL.iter().position(|&known| known == mode).unwrap_or(0) as u32;
            words[0] |= HAS_PILOT | bit(arm, ARM) | place << MODE_SHIFT;
            put(&mut words[16..20], &[s.right, s.forward, s.clockwise, s.throttle]);
            words[20] = self.age_us(time_us);
        }
        words
    }

    /// The record that these words are.
    pub fn from_words(words: &[u32; WORDS]) -> Self {
        let float = |n: usize| f32::from_bits(words[n]);
        let three = |n: usize| Vec3::new(float(n), float(n + 1), float(n + 2));
        let has = |bit: u32| words[0] & bit != 0;
        let time_us = u64::from(words[3]) << 32 | u64::from(words[2]);
        let before = |age: usize| time_us.saturating_sub(words[age].into());
        let imu = Imu { rate_rad_s: three(4), specific_force_m_s2: three(7) };
        let pilot = PilotInput {
            sticks: Sticks { right: float(16), forward: float(17), clockwise: float(18), throttle: float(19) },
            arm: has(ARM),
            mode: Mode::ALL.get((words[0] >> MODE_SHIFT) as usize).copied().unwrap_or(Mode::Disarmed),
        };
        let measurements = Measurements {
            imu: has(HAS_IMU).then_some(Stamped { time_us, value: imu }),
            battery_v: has(HAS_BATTERY).then(|| Stamped { time_us: before(11), value: float(10) }),
            ..Measurements::default()
        };
        Self {
            step: words[1],
            time_us,
            arrived: Arrived {
                measurements,
                pilot: has(HAS_PILOT).then(|| Stamped { time_us: before(20), value: pilot }),
                offboard: None,
                late: has(LATE),
                self_test_passed: has(TESTED),
                parameters_valid: has(VALID),
            },
            command: if has(RUNS) { Command::Run([12, 13, 14, 15].map(float)) } else { Command::Stop },
        }
    }

    /// How long before the step something was true, µs.
    fn age_us(&self, time_us: u64) -> u32 {
        self.time_us.saturating_sub(time_us).min(u32::MAX.into()) as u32
    }
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
        let time_us = 0x1_2345_6789;
        let bare = Record { step: 7, time_us, arrived: Arrived::default(), command: Command::Stop };
        let imu = Imu { rate_rad_s: Vec3::new(0.1, -0.2, 0.3), specific_force_m_s2: Vec3::new(1.0, 2.0, -9.8) };
        let sticks = Sticks { right: 0.1, forward: -0.2, clockwise: 0.3, throttle: 0.4 };
        let pilot = PilotInput { sticks, arm: true, mode: Mode::Return };
        let full = Record {
            arrived: Arrived {
                measurements: Measurements {
                    imu: Some(Stamped { time_us, value: imu }),
                    battery_v: Some(Stamped { time_us: time_us - 400, value: 16.1 }),
                    ..Measurements::default()
                },
                pilot: Some(Stamped { time_us: time_us - 12_345, value: pilot }),
                offboard: None,
                late: true,
                self_test_passed: true,
                parameters_valid: true,
            },
            command: Command::Run([0.1, 0.2, 0.3, 0.4]),
            ..bare
        };
        for record in [bare, full] {
            assert_eq!(Record::from_words(&record.to_words()), record);
        }
    }
}
