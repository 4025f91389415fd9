//! eRPM: what a speed controller answers to a frame, of the samples of its line.
//!
//! ```text
//! samples ─► edges ─► 21 bits, an edge before each one ─► 4 × 5 bits ─► 4 × 4 bits: period, checksum
//!
//! period = m·2ᵉ µs, of 3 bits e and 9 bits m        ω = 2π / (pole pairs · period)        a ⊕ b ⊕ c ⊕ d = 15
//! ```
//!
//! The line rests high. Some 30 µs after a frame the speed controller pulls it low, which is the first of 21 bits at five quarters of the
//! frame's speed. From then on an edge where a bit begins is a one, none a zero. Codes of five bits have no more than two zeros in a row, also where
//! they meet, so runs are of three bits at most, and what a clock is off never adds up. All ones are a rotor that stands. An
//! exponent above 0 with the highest bit of the mantissa clear is no period but extended telemetry, which is recognised and left.
//!
//! Nothing here can fail: what is no answer is [`Answer::Nothing`] or [`Answer::Garbled`].
//!
//! # Source
//! The protocol has no standard; this is as the documentation of the AM32 and Betaflight firmwares describes it. Of the crates that know it,
//! dshot-frame 0.4 has the checksum of frames in the other direction and dshot-codec 0.1.3 checks a sum before the code is taken off.
use core::f32::consts::TAU;

/// Motors, and so lines.
pub const MOTORS: usize = 4;
/// Samples in a bit of an answer.
pub const SAMPLES_A_BIT: u32 = 3;
/// Bits of an answer a second, for each bit of a frame a second: numerator and denominator.
pub const SPEED_UP: (u32, u32) = (5, 4);
/// Bits of an answer.
const BITS: u32 = 21;
/// From the end of a frame to when an answer may begin, µs: they turn around after 25 to 35.
pub const LISTEN_US: u64 = 24;
/// Samples, in pairs, that hold an answer to a DShot600 frame which begins up to 25 µs later than that.
pub const SAMPLES: usize = 120;

/// What a speed controller has answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The line rested.
    Nothing,
    /// It did not, but that was no answer.
    Garbled,
    /// Something else than a speed.
    Extended,
    /// The rotor stands, or nearly.
    Stands,
    /// The time from one pair of its magnets' poles to the next, µs, above 0.
    Period(u32),
}

/// The answers in samples of all lines at once.
///
/// - `pairs`: two samples each, the earlier one in the lower half.
/// - `pins`: the bit of each motor's line in a sample, 0 to 15.
pub fn answers(pairs: impl Iterator<Item = u32>, pins: [u8; MOTORS]) -> [Answer; MOTORS] {
    // By bit, not by motor, and two samples at once: some fifty edges are to be taken in while a frame is sent.
    let mut words = [Word::default(); 16];
    let all = pins.into_iter().fold(0, |all, pin| all | 0x1_0001 << (pin & 15));
    let mut before = all & 0xffff;
    let mut at = 0;
    for pair in pairs {
        let pair = pair & all;
        // Each sample beside the one before it.
        let mut changed = pair ^ (pair << 16 | before);
        before = pair >> 16;
        while changed != 0 {
            let bit = changed.trailing_zeros();
            words[bit as usize & 15].edge(at + (bit >> 4));
            changed &= changed - 1;
        }
        at += 2;
    }
    pins.map(|pin| words[usize::from(pin & 15)].answer())
}

/// What is known of one line's answer.
#[derive(Clone, Copy, Default)]
struct Word {
    /// A one for each edge so far, the first being that into the answer, and a zero for each bit that began without; 0 before it.
    bits: u32,
    /// The sample of the last edge.
    at: u32,
}

impl Word {
    fn edge(&mut self, at: u32) {
        let run = (at - self.at + SAMPLES_A_BIT / 2) / SAMPLES_A_BIT;
        self.at = at;
        // Of a run that is no run the checksum tells.
        self.bits = self.bits.wrapping_shl(run) | 1;
    }

    fn answer(self) -> Answer {
        let Some(after_first) = self.bits.checked_ilog2() else { return Answer::Nothing };
        // Without what follows the answer, which is the line being let go; what is left of it has no edge.
        let bits = if after_first < BITS {
            self.bits << (BITS - 1 - after_first)
        } else {
            self.bits >> (after_first - (BITS - 1))
        };
        let (Some(a), Some(b), Some(c), Some(d)) =
            (nibble(bits >> 15), nibble(bits >> 10), nibble(bits >> 5), nibble(bits))
        else {
            return Answer::Garbled;
        };
        if a ^ b ^ c ^ d == 0xf { meaning(a << 8 | b << 4 | c) } else { Answer::Garbled }
    }
}

/// The four bits that the low five of a word stand for.
fn nibble(code: u32) -> Option<u32> {
    const CODES: [u8; 16] = [
        0b11001, 0b11011, 0b10010, 0b10011, 0b11101, 0b10101, 0b10110, 0b10111, 0b11010, 0b01001, 0b01010, 0b01011,
        0b11110, 0b01101, 0b01110, 0b01111,
    ];
    const NONE: u8 = 16;
    /// By code.
    const NIBBLES: [u8; 32] = {
        let mut nibbles = [NONE; 32];
        let mut n = 0;
        while n < CODES.len() {
            nibbles[CODES[n] as usize] = n as u8;
            n += 1;
        }
        nibbles
    };
    NIBBLES.get((code & 0x1f) as usize).filter(|&&nibble| nibble != NONE).map(|&nibble| nibble.into())
}

/// What twelve bits with a checksum that was right say.
fn meaning(value: u32) -> Answer {
    let (exponent, mantissa) = (value >> 9, value & 0x1ff);
    match (exponent, mantissa) {
        (7, 0x1ff) => Answer::Stands,
        (0, 0) => Answer::Garbled,
        (1.., ..0x100) => Answer::Extended,
        _ => Answer::Period(mantissa << exponent),
    }
}

/// Time for which the last word of a silent speed controller counts, µs: as long as the estimator follows one that says nothing.
const SILENCE_US_MAX: u64 = 100_000;

/// How many frames a speed controller has answered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Heard {
    /// With something understood.
    pub understood: u16,
    /// With something else.
    pub garbled: u16,
}

/// Rotor speeds, of answers.
#[derive(Clone, Copy, Debug)]
pub struct Tachometer {
    /// 2π µs / pole pairs.
    scale: f32,
    rotor_rad_s: [f32; MOTORS],
    heard_us: [u64; MOTORS],
    heard: [Heard; MOTORS],
}

impl Tachometer {
    /// Nothing heard yet.
    ///
    /// - `poles`: magnets of a motor, above 0.
    pub fn new(poles: f32) -> Self {
        let scale = TAU * 1e6 / (0.5 * poles);
        Self { scale, rotor_rad_s: [0.0; MOTORS], heard_us: [0; MOTORS], heard: Default::default() }
    }

    /// Takes in the answers to one frame; returns the rotors' speeds, rad/s, if any of them told its own.
    ///
    /// One that has told nothing for 0.1 s is 0, which for the estimator is a rotor without a notch.
    pub fn hear(&mut self, answers: [Answer; MOTORS], now_us: u64) -> Option<[f32; MOTORS]> {
        let mut told = false;
        for (n, answer) in answers.into_iter().enumerate() {
            let (Some(speed), Some(heard_us), Some(heard)) =
                (self.rotor_rad_s.get_mut(n), self.heard_us.get_mut(n), self.heard.get_mut(n))
            else {
                continue;
            };
            match answer {
                Answer::Nothing => {}
                Answer::Garbled => heard.garbled = heard.garbled.saturating_add(1),
                Answer::Extended | Answer::Stands | Answer::Period(_) => {
                    heard.understood = heard.understood.saturating_add(1);
                }
            }
            let period_us = match answer {
                Answer::Period(period_us) => Some(period_us),
                Answer::Stands => None,
                _ => {
                    if now_us.saturating_sub(*heard_us) > SILENCE_US_MAX {
                        *speed = 0.0;
                    }
                    continue;
                }
            };
            *speed = period_us.map_or(0.0, |period_us| self.scale / period_us as f32);
            *heard_us = now_us;
            told = true;
        }
        told.then_some(self.rotor_rad_s)
    }

    /// How many frames each speed controller has answered since the last call.
    pub fn take(&mut self) -> [Heard; MOTORS] {
        core::mem::take(&mut self.heard)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const LINES: [u8; MOTORS] = [6, 7, 0, 1];

    /// Levels of a line, the first bit first, that answer these twelve bits.
    fn levels(value: u16) -> Vec<bool> {
        let sum = !(value ^ value >> 4 ^ value >> 8) & 0xf;
        let frame = value << 4 | sum;
        let mut level = false;
        let mut levels = std::vec![level];
        for place in [12, 8, 4, 0] {
            let wanted = u32::from(frame >> place & 0xf);
            let code = (0..32).find(|&code| nibble(code) == Some(wanted)).expect("each nibble has a code");
            for bit in (0..5).rev() {
                level ^= code >> bit & 1 == 1;
                levels.push(level);
            }
        }
        levels
    }

    /// Samples of lines, each of which answers from a sample on, its bits being so many samples long.
    fn sampled(answers: [Option<(u16, f64, f64)>; MOTORS]) -> Vec<u16> {
        (0..SAMPLES)
            .map(|n| {
                let mut sample = 0;
                for (answer, line) in answers.iter().zip(LINES) {
                    let high = answer.as_ref().is_none_or(|&(value, from, long)| {
                        let bit = ((n as f64 - from) / long).floor();
                        if bit < 0.0 { true } else { levels(value).get(bit as usize).copied().unwrap_or(true) }
                    });
                    sample |= u16::from(high) << line;
                }
                sample
            })
            .collect()
    }

    fn taken(samples: &[u16]) -> [Answer; MOTORS] {
        answers(samples.chunks_exact(2).map(|pair| u32::from(pair[1]) << 16 | u32::from(pair[0])), LINES)
    }

    fn heard(lines: [Option<(u16, f64, f64)>; MOTORS]) -> [Answer; MOTORS] {
        taken(&sampled(lines))
    }

    #[test]
    fn every_value_is_heard_on_any_line_however_it_begins_and_with_a_clock_that_is_off_by_6_percent() {
        for value in 0..0x1000_u16 {
            let place = f64::from(value % 97) / 3.0;
            let off = 0.94 + 0.12 * f64::from(value % 13) / 12.0;
            let line = Some((value, 7.0 + place, off * 3.0));
            let all = heard([line, None, line, None]);
            let wanted = meaning(value.into());
            assert_eq!(all, [wanted, Answer::Nothing, wanted, Answer::Nothing], "{value:#05x}, {off}");
        }
    }

    #[test]
    fn values_mean_what_the_field_says() {
        for (value, answer) in [
            (0xfff, Answer::Stands),
            (0x000, Answer::Garbled),
            (0x001, Answer::Period(1)),
            (0x0ff, Answer::Period(255)),
            (0x32c, Answer::Period(600)),
            (0xffe, Answer::Period(510 << 7)),
            // Temperature, voltage and state of extended telemetry.
            (0x255, Answer::Extended),
            (0x440, Answer::Extended),
            (0xe00, Answer::Extended),
        ] {
            assert_eq!(meaning(value), answer, "{value:#05x}");
        }
    }

    #[test]
    fn a_turned_level_anywhere_is_no_other_speed() {
        let clean = sampled([Some((0x32c, 20.0, 3.0)); MOTORS]);
        let (mut garbled, mut wrong) = (0, 0);
        // A whole bit of it, from each sample on.
        for at in 20..80 {
            let mut spoilt = clean.clone();
            spoilt[at..at + 3].iter_mut().for_each(|sample| *sample ^= 1 << LINES[2]);
            let [first, _, third, _] = taken(&spoilt);
            assert_eq!(first, Answer::Period(600));
            match third {
                Answer::Garbled => garbled += 1,
                Answer::Period(600) => {}
                _ => wrong += 1,
            }
        }
        assert!(garbled > 40 && wrong == 0, "{garbled} {wrong}");
    }

    #[test]
    fn no_noise_makes_it_stop_and_little_of_it_is_taken_for_speeds() {
        let mut random = 1_u32;
        let (mut speeds, rounds) = (0, 20_000);
        for _ in 0..rounds {
            let noise = [(); SAMPLES].map(|()| {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (random >> 16) as u16
            });
            let all = taken(&noise);
            speeds += all.iter().filter(|answer| matches!(answer, Answer::Period(_))).count();
        }
        assert!(speeds < 4 * rounds / 50, "{speeds} of {}", 4 * rounds);
        assert_eq!(taken(&[0; SAMPLES]), [Answer::Garbled; MOTORS], "shorted lines");
    }

    #[test]
    fn speeds_are_of_the_rotor_and_those_of_a_silent_one_are_dropped_after_a_tenth_of_a_second() {
        let mut tachometer = Tachometer::new(14.0);
        // 100,000 pairs of poles a minute.
        let all = tachometer.hear([Answer::Period(600); MOTORS], 1_000).expect("all have told");
        assert!(all.iter().all(|speed| (speed - TAU * 100_000.0 / 60.0 / 7.0).abs() < 1e-2), "{all:?}");
        let others = [Answer::Period(300), Answer::Nothing, Answer::Garbled, Answer::Stands];
        let soon = tachometer.hear(others, 2_000).expect("two have told");
        assert_eq!([soon[1], soon[2], soon[3]], [all[1], all[2], 0.0]);
        let later = tachometer.hear(others, 101_001).expect("two have told");
        assert_eq!([later[1], later[2]], [0.0; 2]);
        assert_eq!(tachometer.hear([Answer::Extended; MOTORS], 101_002), None);
        let counts = tachometer.take().map(|heard| [heard.understood, heard.garbled]);
        assert_eq!(counts, [[4, 0], [2, 0], [2, 2], [4, 0]]);
        assert_eq!(tachometer.take(), [Heard::default(); MOTORS]);
    }
}
