//! Pulse: what an analogue speed controller is sent.
//!
//! ```text
//! width = slowest + (full − slowest)·share of the fastest speed
//! ```
//!
//! Invariant: `STOP <= Pulse <= FULL`, and a pulse that is to run a rotor does. NaN and infinity are [`Pulse::STOP`].
//!
//! # Source
//! There is no standard. That a speed controller calibrated to 1,000 and 2,000 µs runs from 1,070 on is what Betaflight takes them to do (`min_throttle`).

/// A pulse width, µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pulse(u16);

impl Pulse {
    /// The rotor stands; the speed controller is disarmed by it.
    pub const STOP: Self = Self(1_000);
    /// The rotor turns, as slowly as it can.
    pub const SLOWEST: Self = Self(1_070);
    /// Full speed.
    pub const FULL: Self = Self(2_000);

    /// The width, µs.
    pub const fn us(self) -> u16 {
        self.0
    }

    /// A running rotor's speed, as a share of the fastest, 0 to 1; what is not a number stops it.
    pub fn running(share: f32) -> Self {
        if !share.is_finite() {
            return Self::STOP;
        }
        let span_us = f32::from(Self::FULL.0 - Self::SLOWEST.0);
        let above_us = (span_us * share.clamp(0.0, 1.0) + 0.5) as u16;
        Self(Self::SLOWEST.0 + above_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulses_follow_the_speed_and_never_leave_the_range() {
        for (share, want_us) in [(-1.0, 1_070), (-0.0, 1_070), (0.5, 1_535), (1.0, 2_000), (1e30, 2_000)] {
            assert_eq!(Pulse::running(share).us(), want_us, "{share}");
        }
        for share in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(Pulse::running(share), Pulse::STOP, "{share}");
        }
    }
}
