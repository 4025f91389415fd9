//! Record: what the last step was given and what it decided, in words.
//!
//! The image keeps one in RAM that no reset clears: whoever asks why it fell finds the last step there, and a probe or the
//! emulator can look while it flies. A record that is being written has an odd sequence number.
use control_core::autopilot::BenchOrder;
use control_core::flight::{Arrived, Command};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::{Gnss, Imu, Measurements, Stamped, Vision};
use control_core::modes::Mode;
use control_core::motor_test::MotorTestOrder;
use control_core::pilot::{PilotInput, Sticks};

/// Words of a record.
pub const WORDS: usize = 61;
/// Bits of the first word: which of the optional parts are there, and facts.
pub(crate) const HAS_IMU: u32 = 1;
const HAS_BATTERY: u32 = 1 << 1;
const HAS_PILOT: u32 = 1 << 2;
const RUNS: u32 = 1 << 3;
const LATE: u32 = 1 << 4;
const TESTED: u32 = 1 << 5;
const ARM: u32 = 1 << 6;
const VALID: u32 = 1 << 7;
const HAS_BARO: u32 = 1 << 8;
const HAS_FIELD: u32 = 1 << 9;
const HAS_GNSS: u32 = 1 << 10;
const FIXED: u32 = 1 << 11;
const HAS_VISION: u32 = 1 << 12;
const BENCH: u32 = 1 << 13;
const HAS_ROTORS: u32 = 1 << 14;
const HAS_CURRENT: u32 = 1 << 15;
/// Eight bits from here on, the pilot's mode by its place in [`Mode::ALL`].
const MODE_SHIFT: u32 = 16;
/// Two bits from here on, what is asked of the bench: 0 nothing, 1 to turn motors, 2 to check the wiring, 3 to stop.
const ORDER_SHIFT: u32 = 24;
/// Three bits from here on, the motor to be turned, 1 to 4; 0 for all.
const MOTOR_SHIFT: u32 = 26;

/// What comes less often than inertial samples and rotors' speeds: without any of these, words 16 to 51 are 0.
pub(crate) const SLOW: u32 =
    HAS_PILOT | HAS_BARO | HAS_FIELD | HAS_GNSS | HAS_VISION | ARM | FIXED | 0xff << MODE_SHIFT;

/// One step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Steps since boot.
    pub step: u32,
    /// When, µs since boot. The time of the inertial sample is the same.
    pub time_us: u64,
    /// What the step was given. Of the measurements, those that the image has sensors for; nobody speaks offboard.
    pub arrived: Arrived,
    /// What it decided.
    pub command: Command,
}

impl Record {
    /// The record in words, without its sequence number.
    pub fn to_words(&self) -> [u32; WORDS] {
        let Arrived { measurements, pilot, offboard: _, bench, late, self_test_passed, parameters_valid } =
            self.arrived;
        let Measurements { imu, battery_v, battery_a, baro_altitude_m, magnetic_ut, gnss, vision, rotor_rad_s, .. } =
            measurements;
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
        put(&mut words[12..16], &self.command.speeds());
        words[0] |= match self.command {
            Command::Stop => 0,
            Command::Run(_) => RUNS,
            Command::Bench(_) => BENCH,
        };
        if let Some(Stamped { time_us, value: PilotInput { sticks: s, arm, mode } }) = pilot {
            let place = Mode::ALL.iter().position(|&known| known == mode).unwrap_or(0) as u32;
            words[0] |= HAS_PILOT | bit(arm, ARM) | place << MODE_SHIFT;
            put(&mut words[16..20], &[s.right, s.forward, s.clockwise, s.throttle]);
            words[20] = self.age_us(time_us);
        }
        if let Some(Stamped { time_us, value }) = baro_altitude_m {
            words[0] |= HAS_BARO;
            [words[21], words[22]] = [value.to_bits(), self.age_us(time_us)];
        }
        if let Some(Stamped { time_us, value: b }) = magnetic_ut {
            words[0] |= HAS_FIELD;
            put(&mut words[23..26], &[b.x, b.y, b.z]);
            words[26] = self.age_us(time_us);
        }
        if let Some(Stamped { time_us, value: g }) = gnss {
            let (p, v) = (g.position_m, g.velocity_m_s);
            words[0] |= HAS_GNSS | bit(g.fixed, FIXED);
            put(&mut words[27..36], &[p.x, p.y, p.z, v.x, v.y, v.z, g.horizontal_m, g.vertical_m, g.speed_m_s]);
            words[36] = self.age_us(time_us);
        }
        if let Some(Stamped { time_us, value: v }) = vision {
            let p = v.position_m;
            words[0] |= HAS_VISION;
            put(&mut words[37..42], &[p.x, p.y, p.z, v.position_sigma_m, v.attitude_sigma_rad]);
            put(&mut words[42..51], v.attitude.rows.as_flattened());
            words[51] = self.age_us(time_us);
        }
        words[0] |= match bench {
            None => 0,
            Some(BenchOrder::Motors(MotorTestOrder { rotor, share, seconds })) => {
                put(&mut words[52..54], &[share, seconds]);
                1 << ORDER_SHIFT | rotor.map_or(0, |rotor| 1 + rotor.min(3) as u32) << MOTOR_SHIFT
            }
            Some(BenchOrder::Wiring) => 2 << ORDER_SHIFT,
            Some(BenchOrder::Stop) => 3 << ORDER_SHIFT,
        };
        if let Some(Stamped { time_us, value }) = rotor_rad_s {
            words[0] |= HAS_ROTORS;
            put(&mut words[54..58], &value);
            words[58] = self.age_us(time_us);
        }
        if let Some(Stamped { time_us, value }) = battery_a {
            words[0] |= HAS_CURRENT;
            [words[59], words[60]] = [value.to_bits(), self.age_us(time_us)];
        }
        words
    }

    /// The record that these words are.
    pub fn from_words(words: &[u32; WORDS]) -> Self {
        let float = |n: usize| f32::from_bits(words[n]);
        let has = |bit: u32| words[0] & bit != 0;
        let time_us = u64::from(words[3]) << 32 | u64::from(words[2]);
        let before = |age: usize| time_us.saturating_sub_signed(words[age].cast_signed().into());
        let imu = Imu { rate_rad_s: three(words, 4), specific_force_m_s2: three(words, 7) };
        let pilot = PilotInput {
            sticks: Sticks { right: float(16), forward: float(17), clockwise: float(18), throttle: float(19) },
            arm: has(ARM),
            mode: Mode::ALL.get((words[0] >> MODE_SHIFT & 0xff) as usize).copied().unwrap_or(Mode::Disarmed),
        };
        let order = MotorTestOrder {
            rotor: (words[0] >> MOTOR_SHIFT & 7).checked_sub(1).map(|rotor| rotor as usize),
            share: float(52),
            seconds: float(53),
        };
        let measurements = Measurements {
            imu: has(HAS_IMU).then_some(Stamped { time_us, value: imu }),
            battery_v: has(HAS_BATTERY).then(|| Stamped { time_us: before(11), value: float(10) }),
            battery_a: has(HAS_CURRENT).then(|| Stamped { time_us: before(60), value: float(59) }),
            baro_altitude_m: has(HAS_BARO).then(|| Stamped { time_us: before(22), value: float(21) }),
            magnetic_ut: has(HAS_FIELD).then(|| Stamped { time_us: before(26), value: three(words, 23) }),
            gnss: has(HAS_GNSS).then(|| Stamped {
                time_us: before(36),
                value: Gnss {
                    position_m: three(words, 27),
                    velocity_m_s: three(words, 30),
                    horizontal_m: float(33),
                    vertical_m: float(34),
                    speed_m_s: float(35),
                    fixed: has(FIXED),
                },
            }),
            vision: has(HAS_VISION).then(|| Stamped {
                time_us: before(51),
                value: Vision {
                    position_m: three(words, 37),
                    attitude: Attitude { rows: [42, 45, 48].map(|n| [n, n + 1, n + 2].map(float)) },
                    position_sigma_m: float(40),
                    attitude_sigma_rad: float(41),
                },
            }),
            rotor_rad_s: has(HAS_ROTORS).then(|| Stamped { time_us: before(58), value: [54, 55, 56, 57].map(float) }),
            ..Measurements::default()
        };
        Self {
            step: words[1],
            time_us,
            arrived: Arrived {
                measurements,
                pilot: has(HAS_PILOT).then(|| Stamped { time_us: before(20), value: pilot }),
                offboard: None,
                bench: match words[0] >> ORDER_SHIFT & 3 {
                    1 => Some(BenchOrder::Motors(order)),
                    2 => Some(BenchOrder::Wiring),
                    3 => Some(BenchOrder::Stop),
                    _ => None,
                },
                late: has(LATE),
                self_test_passed: has(TESTED),
                parameters_valid: has(VALID),
            },
            command: match (has(RUNS), has(BENCH)) {
                (true, _) => Command::Run([12, 13, 14, 15].map(float)),
                (_, true) => Command::Bench([12, 13, 14, 15].map(float)),
                _ => Command::Stop,
            },
        }
    }

    /// How long before the step something was true, µs, in two's complement: what arrives while the inertial unit is read is
    /// younger than the step.
    fn age_us(&self, time_us: u64) -> u32 {
        let age_us = self.time_us.wrapping_sub(time_us).cast_signed();
        age_us.clamp(i32::MIN.into(), i32::MAX.into()) as u32
    }
}

fn three<F: Copy>(words: &[u32; WORDS], at: usize) -> Vec3<F> {
    let [x, y, z] = [at, at + 1, at + 2].map(|n| f32::from_bits(words[n]));
    Vec3::new(x, y, z)
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
        let gnss = Gnss {
            position_m: Vec3::new(1.0, -2.0, 3.0),
            velocity_m_s: Vec3::new(-0.1, 0.2, -0.3),
            horizontal_m: 1.3,
            vertical_m: 1.9,
            speed_m_s: 0.05,
            fixed: true,
        };
        let vision = Vision {
            position_m: Vec3::new(0.5, 0.6, 0.7),
            attitude: Attitude { rows: [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]] },
            position_sigma_m: 0.001,
            attitude_sigma_rad: 0.002,
        };
        let full = Record {
            arrived: Arrived {
                measurements: Measurements {
                    imu: Some(Stamped { time_us, value: imu }),
                    battery_v: Some(Stamped { time_us: time_us + 40, value: 16.1 }),
                    battery_a: Some(Stamped { time_us: time_us - 60, value: 4.5 }),
                    baro_altitude_m: Some(Stamped { time_us: time_us - 14_000, value: 1.25 }),
                    magnetic_ut: Some(Stamped { time_us: time_us - 5_000, value: Vec3::new(20.0, -1.0, 43.0) }),
                    gnss: Some(Stamped { time_us: time_us - 129_000, value: gnss }),
                    vision: Some(Stamped { time_us: time_us - 10_500, value: vision }),
                    rotor_rad_s: Some(Stamped { time_us: time_us - 410, value: [310.0, 0.0, 290.5, 305.0] }),
                    ..Measurements::default()
                },
                pilot: Some(Stamped { time_us: time_us - 12_345, value: pilot }),
                offboard: None,
                bench: Some(BenchOrder::Motors(MotorTestOrder { rotor: Some(2), share: 0.1, seconds: 2.0 })),
                late: true,
                self_test_passed: true,
                parameters_valid: true,
            },
            command: Command::Run([0.1, 0.2, 0.3, 0.4]),
            ..bare
        };
        let asked = |order| Record { arrived: Arrived { bench: Some(order), ..Arrived::default() }, ..bare };
        let all = BenchOrder::Motors(MotorTestOrder { rotor: None, share: 0.2, seconds: 1.0 });
        let turns = Record { command: Command::Bench([0.0, 0.3, 0.0, 0.0]), ..bare };
        for record in [bare, full, turns, asked(all), asked(BenchOrder::Wiring), asked(BenchOrder::Stop)] {
            assert_eq!(Record::from_words(&record.to_words()), record);
        }
    }
}
