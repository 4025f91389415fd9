//! Battery: what of its measurements still holds, and the charge that was taken from it.
//!
//! ```text
//! Q = Σ ½ (I_k + I_{k−1}) (t_k − t_{k−1})
//! ```
//!
//! A reading counts for [`HOLDS_US`]. Over a gap the current is taken to have been the mean of both ends.
//!
//! Invariant: the charge is finite, and one that a reset may keep (`restart.rs`). A reading that is not a number, or no later than the one before, changes nothing.
use crate::measurement::{Measurements, Stamped};
use crate::restart::LARGEST;

/// How long a reading counts, µs: ten are made a second.
pub const HOLDS_US: u64 = 1_000_000;

/// What is known of a battery.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Battery {
    voltage_v: Option<Stamped<f32>>,
    current_a: Option<Stamped<f32>>,
    used_as: f32,
}

impl Battery {
    /// Takes in what has arrived.
    pub fn note(&mut self, measurements: &Measurements) {
        if let Some(voltage_v) = measurements.battery_v.filter(|reading| reading.value.is_finite()) {
            self.voltage_v = Some(voltage_v);
        }
        if let Some(current_a) = measurements.battery_a.filter(|reading| reading.value.is_finite()) {
            self.draw(current_a);
        }
    }

    fn draw(&mut self, current_a: Stamped<f32>) {
        let Some(before) = self.current_a.replace(current_a) else { return };
        // 32 bits of microseconds have an hour in them.
        let elapsed_us = u32::try_from(current_a.time_us.saturating_sub(before.time_us)).unwrap_or(u32::MAX);
        let used_as = self.used_as + 0.5 * (before.value + current_a.value) * (elapsed_us as f32 * 1e-6);
        if used_as.is_finite() {
            self.used_as = used_as.clamp(-LARGEST, LARGEST);
        }
    }

    /// Its voltage, if it was measured lately, V.
    pub fn voltage_v(&self, now_us: u64) -> Option<f32> {
        lately(self.voltage_v, now_us)
    }

    /// The current out of it, if it was measured lately, A.
    pub fn current_a(&self, now_us: u64) -> Option<f32> {
        lately(self.current_a, now_us)
    }

    /// Charge taken from it since the start, A s; NaN until its current was measured.
    pub fn used_as(&self) -> f32 {
        if self.current_a.is_some() { self.used_as } else { f32::NAN }
    }

    /// The charge, to be kept over a reset.
    pub(crate) fn used_mut(&mut self) -> &mut f32 {
        &mut self.used_as
    }
}

fn lately(reading: Option<Stamped<f32>>, now_us: u64) -> Option<f32> {
    reading.filter(|reading| now_us.saturating_sub(reading.time_us) <= HOLDS_US).map(|reading| reading.value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn amperes(time_us: u64, value: f32) -> Measurements {
        Measurements { battery_a: Some(Stamped { time_us, value }), ..Measurements::default() }
    }

    #[test]
    fn the_charge_is_the_current_over_time_gaps_included() {
        let mut battery = Battery::default();
        // Rises by 1 A a second from 5 A, ten readings a second; two seconds of them are missing.
        for n in (0..=100).filter(|n| !(40..60).contains(n)) {
            battery.note(&amperes(100_000 * n, 5.0 + 0.1 * n as f32));
        }
        assert!((battery.used_as() - 100.0).abs() < 1e-3, "{}", battery.used_as());
        assert_eq!(battery.current_a(10_000_000), Some(15.0));
    }

    #[test]
    fn a_reading_counts_for_a_second_and_the_charge_for_ever() {
        let mut battery = Battery::default();
        assert_eq!((battery.voltage_v(0), battery.current_a(0)), (None, None));
        assert!(battery.used_as().is_nan(), "nobody knows it");
        battery.note(&Measurements { battery_v: Some(Stamped { time_us: 7, value: 16.0 }), ..amperes(7, 2.0) });
        battery.note(&amperes(500_007, 2.0));
        assert_eq!((battery.voltage_v(1_000_007), battery.voltage_v(1_000_008)), (Some(16.0), None));
        assert_eq!((battery.current_a(1_500_007), battery.current_a(1_500_008)), (Some(2.0), None));
        assert_eq!(battery.used_as(), 1.0);
    }

    #[test]
    fn what_cannot_be_changes_nothing() {
        let mut battery = Battery::default();
        battery.note(&amperes(1_000_000, 3.0));
        battery.note(&amperes(2_000_000, 3.0));
        for wrong in [amperes(2_500_000, f32::NAN), amperes(2_500_000, f32::INFINITY), amperes(2_000_000, 3.0)] {
            battery.note(&wrong);
            assert_eq!((battery.used_as(), battery.current_a(2_500_000)), (3.0, Some(3.0)));
        }
        battery.note(&amperes(u64::MAX, f32::MAX));
        assert_eq!(battery.used_as(), 3.0);
        let mut open = Battery::default();
        (0..30_000).for_each(|n| open.note(&amperes(900_000 * n, 132.0)));
        assert_eq!(open.used_as(), LARGEST, "a reset keeps no more");
    }
}
