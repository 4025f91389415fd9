//! Pulse: what an analogue speed controller is sent.
//!
//! ```text
//! width = stop + (full − stop)·share of the fastest speed
//! ```
//!
//! Invariant: `STOP <= Pulse <= FULL`. NaN and infinity are [`Pulse::STOP`].

/// A pulse width, µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pulse(u16);

impl Pulse {
    /// The rotor stands; the speed controller is disarmed by it.
    pub const STOP: Self = Self(1_000);
    /// Full speed.
    pub const FULL: Self = Self(2_000);

    /// The width, µs.
    pub const fn us(self) -> u16 {
        self.0
    }

    /// The pulse of a rotor's speed, as a share of the fastest, 0 to 1.
    pub fn from_speed(share: f32) -> Self {
        if !share.is_finite() {
            return Self::STOP;
        }
        let span_us = f32::from(Self::FULL.0 - Self::STOP.0);
        let above_stop_us = (span_us * share.clamp(0.0, 1.0) + 0.5) as u16;
        Self(Self::STOP.0 + above_stop_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulses_follow_the_speed_and_never_leave_the_range() {
        for (share, want_us) in [(-1.0, 1_000), (-0.0, 1_000), (0.25, 1_250), (1.0, 2_000), (1e30, 2_000)] {
            assert_eq!(Pulse::from_speed(share).us(), want_us, "{share}");
        }
        for share in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(Pulse::from_speed(share), Pulse::STOP, "{share}");
        }
    }
}
