//! A speed controller: hears what is on its line, and answers on it where it is asked.
//!
//! Pulses that come at 600 or 300 kHz are the bits of a DShot frame: ones if they last for three quarters of the time between them,
//! zeros if for three eighths, a frame being sixteen without a gap. Pulses of 1 to 2 ms, at most 490 a second, are a speed by
//! themselves. What it hears first it takes for its protocol until power goes: another one, or a pulse that is of none, is refused.
//!
//! A frame of low pulses, its checksum turned, is answered with the rotor's speed (`firmware/src/erpm.rs` says how): some 30 µs after its end, at
//! five quarters of its speed, by a clock of the controller's own. Meanwhile it drives the line; before and after it does not.
use crate::peripheral::timer::Pulse;
use std::f32::consts::TAU;
use std::ops::RangeInclusive;

/// Bits a second of each kind of frame, and how far they may be off, per mille.
const RATES: [(u64, Protocol); 2] = [(300_000, Protocol::DShot300), (600_000, Protocol::DShot600)];
const OFF_PER_MILLE: u64 = 30;
/// Widths of pulses that are a speed, and the shortest time between them, µs.
const PULSE_US: RangeInclusive<u64> = 1_000..=2_000;
const BETWEEN_US_MIN: u64 = 2_040;
/// Pairs of a motor's poles.
const POLE_PAIRS: f32 = 7.0;
/// Bits of an answer.
const ANSWER_BITS: u64 = 21;
/// Codes of four bits.
const CODES: [u32; 16] =
    [0x19, 0x1b, 0x12, 0x13, 0x1d, 0x15, 0x16, 0x17, 0x1a, 0x09, 0x0a, 0x0b, 0x1e, 0x0d, 0x0e, 0x0f];

/// The last thing that was understood.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Heard {
    #[default]
    Nothing,
    /// A DShot value, 0 to 2047.
    Value(u16),
    /// A pulse, µs.
    PulseUs(u16),
}

/// What a controller takes its line to carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Frames at 300 kbit/s.
    DShot300 = 1,
    /// Frames at 600 kbit/s.
    DShot600 = 2,
    /// Pulses.
    Pwm = 3,
}

impl Protocol {
    /// The one that a pulse is of, if any.
    fn of(pulse: &Pulse, cycles_us: u64) -> Option<Self> {
        let near = |hz: u64| (pulse.period * hz).abs_diff(1_000_000 * cycles_us) <= OFF_PER_MILLE * 1_000 * cycles_us;
        // Of the time between bits, in 64ths: 24 and 48.
        let bit = matches!(64 * pulse.long / pulse.period, 22..=26 | 46..=50);
        let frames = RATES.into_iter().find(|&(hz, _)| bit && near(hz)).map(|(_, protocol)| protocol);
        let wide = PULSE_US.contains(&(pulse.long / cycles_us)) && pulse.period >= BETWEEN_US_MIN * cycles_us;
        frames.or((wide && !pulse.low).then_some(Self::Pwm))
    }
}

/// How a controller answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Telemetry {
    /// Never.
    Silent,
    /// As it should.
    #[default]
    Well,
    /// With a bit turned.
    Garbled,
}

/// An answer on the line.
#[derive(Clone, Copy, Debug)]
struct Answer {
    /// Its levels, the first bit the highest.
    levels: u32,
    /// When it begins, and how long its bits are, core cycles.
    at: u64,
    bit: u64,
}

/// The controller.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Esc {
    pub(crate) heard: Heard,
    /// Its protocol, once it has heard something.
    pub(crate) protocol: Option<Protocol>,
    /// A pulse that it cannot take.
    pub(crate) refused: Option<Pulse>,
    /// Frames and pulses understood, frames with a wrong checksum or length.
    pub(crate) good: u32,
    pub(crate) bad: u32,
    /// When the last frame was through, core cycles.
    pub(crate) through_at: u64,
    /// Speed of its rotor, rad/s.
    pub(crate) rotor_rad_s: f32,
    pub(crate) telemetry: Telemetry,
    /// Time from a frame to its answer, µs, and how far its clock is off, per mille.
    turn_around_us: u64,
    off_per_mille: i64,
    answer: Option<Answer>,
    bits: u32,
    count: u32,
    last_at: u64,
}

impl Esc {
    /// One of several: no two take the same time, nor have the same clock.
    pub(crate) fn new(n: usize) -> Self {
        let (turn_around_us, off_per_mille) = [(27, -15), (29, 8), (31, -4), (33, 20)][n % 4];
        Self {
            heard: Heard::Nothing,
            protocol: None,
            refused: None,
            good: 0,
            bad: 0,
            through_at: 0,
            rotor_rad_s: 0.0,
            telemetry: Telemetry::Well,
            turn_around_us,
            off_per_mille,
            answer: None,
            bits: 0,
            count: 0,
            last_at: 0,
        }
    }

    /// Power comes on again.
    pub(crate) fn power_up(&mut self) {
        (self.heard, self.protocol, self.answer) = (Heard::Nothing, None, None);
    }

    /// A pulse has begun.
    pub(crate) fn hear(&mut self, pulse: Pulse, cycles_us: u64) {
        let protocol = Protocol::of(&pulse, cycles_us);
        if protocol.is_none() || self.protocol.is_some() && self.protocol != protocol {
            self.refused = Some(pulse);
            return;
        }
        self.protocol = protocol;
        if protocol == Some(Protocol::Pwm) {
            self.heard = Heard::PulseUs((pulse.long / cycles_us) as u16);
            self.good += 1;
            self.through_at = pulse.at + pulse.long;
            return;
        }
        let gap = 2 * (pulse.at - self.last_at) > 3 * pulse.period;
        if gap {
            self.bad += u32::from(self.count > 0);
            (self.bits, self.count) = (0, 0);
        }
        self.last_at = pulse.at;
        self.bits = self.bits << 1 | u32::from(2 * pulse.long > pulse.period);
        self.count += 1;
        if self.count == 16 {
            self.finish(&pulse, cycles_us);
        }
    }

    fn finish(&mut self, last: &Pulse, cycles_us: u64) {
        let (data, sum) = (self.bits >> 4, self.bits & 0xf);
        let asked = if last.low { 0xf } else { 0 };
        if (data ^ data >> 4 ^ data >> 8) & 0xf == sum ^ asked {
            self.heard = Heard::Value((data >> 1) as u16);
            self.good += 1;
            self.through_at = last.at + last.period;
            if last.low && self.telemetry != Telemetry::Silent {
                let spoilt = if self.telemetry == Telemetry::Garbled { 1 << 7 } else { 0 };
                let bit = last.period * 4 / 5 * (1_000 + self.off_per_mille) as u64 / 1_000;
                let at = self.through_at + self.turn_around_us * cycles_us;
                self.answer = Some(Answer { levels: levels(told(self.rotor_rad_s)) ^ spoilt, at, bit });
            }
        } else {
            self.bad += 1;
        }
        (self.bits, self.count) = (0, 0);
    }

    /// The level that it drives its line to, if it does.
    pub(crate) fn level(&self, now: u64) -> Option<bool> {
        let Answer { levels, at, bit } = self.answer?;
        let place = now.checked_sub(at)? / bit;
        (place < ANSWER_BITS).then(|| levels >> (ANSWER_BITS - 1 - place) & 1 != 0)
    }
}

/// The twelve bits that tell a rotor's speed: those of the finest step that has its period.
fn told(rotor_rad_s: f32) -> u32 {
    let period_us = TAU * 1e6 / (POLE_PAIRS * rotor_rad_s.abs());
    let exponent = (0..8_u32).find(|&exponent| period_us < 511.5 * f32::from(1_u16 << exponent));
    exponent.map_or(0xfff, |exponent| {
        let mantissa = (period_us / f32::from(1_u16 << exponent)).round().max(1.0) as u32;
        exponent << 9 | mantissa
    })
}

/// The levels that answer twelve bits.
fn levels(value: u32) -> u32 {
    let frame = value << 4 | !(value ^ value >> 4 ^ value >> 8) & 0xf;
    let code = (0..4).rev().fold(0, |code, n| code << 5 | CODES[(frame >> (4 * n) & 0xf) as usize]);
    // An edge before each one.
    (0..20).rev().fold(0, |levels, n| levels << 1 | (levels ^ code >> n) & 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends the bits of a frame from `at`, 280 cycles each.
    fn send(esc: &mut Esc, frame: u16, at: u64, low: bool) {
        for bit in 0..16 {
            let long = if frame >> (15 - bit) & 1 == 1 { 210 } else { 105 };
            esc.hear(Pulse { channel: 0, at: at + 280 * bit, long, period: 280, low }, 168);
        }
    }

    #[test]
    fn frames_are_understood_and_bad_ones_counted() {
        let mut esc = Esc::new(0);
        send(&mut esc, 0x82c6, 1_000, false);
        assert_eq!((esc.heard, esc.good, esc.through_at), (Heard::Value(1_046), 1, 1_000 + 16 * 280));
        send(&mut esc, 0x82c7, 10_000, false);
        assert_eq!((esc.heard, esc.good, esc.bad), (Heard::Value(1_046), 1, 1));
        // Half a frame, then a whole one.
        esc.hear(Pulse { channel: 0, at: 20_000, long: 210, period: 280, low: false }, 168);
        send(&mut esc, 0, 30_000, false);
        assert_eq!((esc.heard, esc.good, esc.bad), (Heard::Value(0), 2, 2));
        assert!((0..100_000).all(|now| esc.level(now).is_none()), "nobody has asked");
    }

    #[test]
    fn a_long_pulse_is_a_speed() {
        let mut esc = Esc::new(0);
        esc.hear(Pulse { channel: 0, at: 0, long: 1_500 * 168, period: 2_500 * 168, low: false }, 168);
        assert_eq!((esc.heard, esc.protocol), (Heard::PulseUs(1_500), Some(Protocol::Pwm)));
    }

    #[test]
    fn frames_of_half_the_speed_are_understood_and_answered_at_half_the_speed() {
        let mut esc = Esc::new(2);
        for bit in 0..16 {
            let long = if 0x82c9 >> (15 - bit) & 1 == 1 { 420 } else { 210 };
            esc.hear(Pulse { channel: 0, at: 560 * bit, long, period: 560, low: true }, 168);
        }
        assert_eq!((esc.heard, esc.protocol), (Heard::Value(1_046), Some(Protocol::DShot300)));
        let driven = (0..40_000).filter(|&now| esc.level(now).is_some()).count() as u64;
        assert_eq!(driven, 21 * (560 * 4 / 5 * 996 / 1_000));
    }

    #[test]
    fn what_is_of_no_protocol_or_of_another_than_before_is_refused() {
        let pulse = |long, period, low| Pulse { channel: 0, at: 0, long, period, low };
        for (why, other) in [
            ("between a zero and a one", pulse(168, 280, false)),
            ("at 150 kHz", pulse(840, 1_120, false)),
            ("too short for a speed", pulse(900 * 168, 2_500 * 168, false)),
            ("too long", pulse(2_100 * 168, 2_500 * 168, false)),
            ("too often", pulse(1_000 * 168, 2_000 * 168, false)),
            ("low", pulse(1_000 * 168, 2_500 * 168, true)),
        ] {
            let mut esc = Esc::new(0);
            esc.hear(other, 168);
            assert_eq!((esc.refused, esc.protocol), (Some(other), None), "{why}");
        }
        let (mut esc, slower) = (Esc::new(0), pulse(420, 560, false));
        send(&mut esc, 0x82c6, 1_000, false);
        esc.hear(slower, 168);
        assert_eq!((esc.refused.take(), esc.good), (Some(slower), 1));
        esc.power_up();
        esc.hear(slower, 168);
        assert_eq!((esc.refused, esc.protocol), (None, Some(Protocol::DShot300)));
    }

    #[test]
    fn a_frame_that_asks_is_answered_at_its_time_and_no_other() {
        let mut esc = Esc::new(1);
        esc.rotor_rad_s = 1_496.0;
        send(&mut esc, 0x82c6, 0, true);
        assert_eq!((esc.good, esc.bad), (0, 1), "it does not ask by its checksum");
        send(&mut esc, 0x82c9, 20_000, true);
        assert_eq!((esc.heard, esc.good), (Heard::Value(1_046), 1));
        let begins = 20_000 + 16 * 280 + 29 * 168;
        let driven: Vec<u64> = (0..60_000).filter(|&now| esc.level(now).is_some()).collect();
        // 0.8 of a bit, by a clock that is 0.8 % slow.
        let bit = 280 * 4 / 5 * 1_008 / 1_000;
        assert_eq!((driven[0], driven.len() as u64), (begins, 21 * bit));
        let seen = (0..21).fold(0, |seen, n| seen << 1 | u32::from(esc.level(begins + n * bit) == Some(true)));
        // 600 µs: 0x32c2, as 10011 10010 11110 10010.
        assert_eq!(told(1_496.0), 0x32c);
        assert_eq!(seen, 0b0_11101_00011_01011_00011);
        esc.telemetry = Telemetry::Silent;
        send(&mut esc, 0x82c9, 60_000, true);
        assert!((60_000..100_000).all(|now| esc.level(now).is_none()));
    }

    #[test]
    fn speeds_are_told_in_the_finest_steps_and_a_rotor_that_stands_as_ones() {
        for (rotor_rad_s, value) in [(0.0, 0xfff), (1.0, 0xfff), (1_760.0, 510), (1_750.0, 1 << 9 | 256)] {
            assert_eq!(told(rotor_rad_s), value, "{rotor_rad_s}");
        }
    }
}
