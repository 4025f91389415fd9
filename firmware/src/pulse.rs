//! Pulse: what an analogue speed controller is sent, from the thrust the core asks for.
//!
//! ```text
//! width = stop + (full − stop)·√(F / F_max)
//! ```
//!
//! A speed controller turns its rotor about in proportion to the pulse, and thrust grows with the square of the speed.
//!
//! Invariant: `STOP <= Pulse <= FULL`, whatever the thrust is. NaN and infinity are [`Pulse::STOP`].
use control_core::{Airframe, Scalar};

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

    /// The pulses that give `thrust_n`, both in airframe order.
    pub fn from_thrusts(thrust_n: [f32; 4], airframe: &Airframe) -> [Self; 4] {
        let [a, b, c, d] = thrust_n;
        let [ra, rb, rc, rd] = airframe.rotors.map(|rotor| rotor.thrust_n_max);
        [Self::from_thrust(a, ra), Self::from_thrust(b, rb), Self::from_thrust(c, rc), Self::from_thrust(d, rd)]
    }

    fn from_thrust(thrust_n: f32, thrust_n_max: f32) -> Self {
        let share = thrust_n / thrust_n_max;
        if !share.is_finite() {
            return Self::STOP;
        }
        Self::from_speed(Scalar::sqrt(share.clamp(0.0, 1.0)))
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
    fn pulse_follows_the_square_root_of_thrust() {
        for (share, want_us) in [(0.0, 1_000), (0.01, 1_100), (0.25, 1_500), (0.454_545_45, 1_674), (1.0, 2_000)] {
            assert_eq!(Pulse::from_thrust(share * 2.8, 2.8).us(), want_us, "{share}");
        }
    }

    #[test]
    fn no_thrust_leaves_the_range() {
        for thrust_n in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, -0.0] {
            assert_eq!(Pulse::from_thrust(thrust_n, 2.8), Pulse::STOP, "{thrust_n}");
        }
        for thrust_n in [2.8, 2.801, 1e30] {
            assert_eq!(Pulse::from_thrust(thrust_n, 2.8), Pulse::FULL, "{thrust_n}");
        }
        for thrust_n_max in [0.0, f32::NAN, f32::INFINITY] {
            assert_eq!(Pulse::from_thrust(0.0, thrust_n_max), Pulse::STOP, "{thrust_n_max}");
        }
    }

    #[test]
    fn hover_is_the_same_pulse_on_every_rotor() {
        let airframe = Airframe::paper(2.2);
        let pulses = Pulse::from_thrusts([airframe.weight_n() / 4.0; 4], &airframe);
        assert_eq!(pulses.map(Pulse::us), [1_674; 4]);
    }
}
