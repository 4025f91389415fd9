//! A speed controller: hears what is on its line.
//!
//! Short pulses are the bits of a DShot frame: one if high for more than half of the time between them, a frame being
//! sixteen without a gap. Long pulses, of about 1 to 2 ms, are a speed by themselves.
use crate::peripheral::timer::Pulse;

/// Pulses longer than this are no bits, µs.
const BIT_US_MAX: u64 = 50;

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

/// The controller.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Esc {
    pub(crate) heard: Heard,
    /// Frames and pulses understood, frames with a wrong checksum or length.
    pub(crate) good: u32,
    pub(crate) bad: u32,
    /// When the last frame was through, core cycles.
    pub(crate) through_at: u64,
    bits: u32,
    count: u32,
    last_at: u64,
}

impl Esc {
    /// A pulse has begun.
    pub(crate) fn hear(&mut self, pulse: Pulse, cycles_us: u64) {
        if pulse.high > BIT_US_MAX * cycles_us {
            self.heard = Heard::PulseUs((pulse.high / cycles_us) as u16);
            self.good += 1;
            self.through_at = pulse.at + pulse.high;
            return;
        }
        let gap = 2 * (pulse.at - self.last_at) > 3 * pulse.period;
        if gap {
            self.bad += u32::from(self.count > 0);
            (self.bits, self.count) = (0, 0);
        }
        self.last_at = pulse.at;
        self.bits = self.bits << 1 | u32::from(2 * pulse.high > pulse.period);
        self.count += 1;
        if self.count == 16 {
            self.finish(pulse.at + pulse.period);
        }
    }

    fn finish(&mut self, at: u64) {
        let (data, sum) = (self.bits >> 4, self.bits & 0xf);
        if (data ^ data >> 4 ^ data >> 8) & 0xf == sum {
            self.heard = Heard::Value((data >> 1) as u16);
            self.good += 1;
            self.through_at = at;
        } else {
            self.bad += 1;
        }
        (self.bits, self.count) = (0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends the bits of a frame from `at`, 280 cycles each.
    fn send(esc: &mut Esc, frame: u16, at: u64) {
        for bit in 0..16 {
            let high = if frame >> (15 - bit) & 1 == 1 { 210 } else { 105 };
            esc.hear(Pulse { channel: 0, at: at + 280 * bit, high, period: 280 }, 168);
        }
    }

    #[test]
    fn frames_are_understood_and_bad_ones_counted() {
        let mut esc = Esc::default();
        send(&mut esc, 0x82c6, 1_000);
        assert_eq!((esc.heard, esc.good, esc.through_at), (Heard::Value(1_046), 1, 1_000 + 16 * 280));
        send(&mut esc, 0x82c7, 10_000);
        assert_eq!((esc.heard, esc.good, esc.bad), (Heard::Value(1_046), 1, 1));
        // Half a frame, then a whole one.
        esc.hear(Pulse { channel: 0, at: 20_000, high: 210, period: 280 }, 168);
        send(&mut esc, 0, 30_000);
        assert_eq!((esc.heard, esc.good, esc.bad), (Heard::Value(0), 2, 2));
    }

    #[test]
    fn a_long_pulse_is_a_speed() {
        let mut esc = Esc::default();
        esc.hear(Pulse { channel: 0, at: 0, high: 1_500 * 168, period: 2_500 * 168 }, 168);
        assert_eq!(esc.heard, Heard::PulseUs(1_500));
    }
}
