//! Pace: when the next tick is due, how long ago the last one was, and whether it finished in time.
//!
//! After a late tick the schedule starts anew from now. A ticker that catches up would answer one long tick with a
//! burst of short ones, whose elapsed times are far from what the law was tuned for.

/// Schedule of a fixed-rate loop, in microseconds since boot.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "a unit is not a prefix to drop")]
pub struct Pace {
    period_us: u64,
    due_us: u64,
    started_us: u64,
}

impl Pace {
    /// A schedule whose first tick is due one period after `now_us`.
    ///
    /// - `rate_hz`: above zero; the period is rounded to a microsecond and is at least one.
    pub fn new(rate_hz: f32, now_us: u64) -> Self {
        // The cast saturates: no rate, however wrong, makes the loop spin without a pause.
        let period_us = ((1e6 / rate_hz + 0.5) as u64).max(1);
        Self { period_us, due_us: now_us.saturating_add(period_us), started_us: now_us }
    }

    /// When the next tick is due, µs.
    pub fn due_us(&self) -> u64 {
        self.due_us
    }

    /// Notes that a tick starts; returns the time since the last one started, s.
    pub fn start(&mut self, now_us: u64) -> f32 {
        let elapsed_us = now_us.saturating_sub(self.started_us);
        self.started_us = now_us;
        elapsed_us as f32 * 1e-6
    }

    /// Notes that the tick is done; returns whether that was late, with the next one already due.
    pub fn finish(&mut self, now_us: u64) -> bool {
        let next_us = self.due_us.saturating_add(self.period_us);
        let late = now_us >= next_us;
        self.due_us = if late { now_us.saturating_add(self.period_us) } else { next_us };
        late
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_on_time_keep_the_grid() {
        let mut pace = Pace::new(500.0, 1_000);
        for tick in 1..=1_000 {
            let due_us = 1_000 + 2_000 * tick;
            assert_eq!(pace.due_us(), due_us);
            // Up to 90 µs of jitter at the start must not move the schedule.
            let now_us = due_us + tick % 91;
            assert!((pace.start(now_us) - 0.002).abs() < 1e-4);
            assert!(!pace.finish(now_us + 300));
        }
    }

    #[test]
    fn a_late_tick_is_counted_once_and_not_caught_up() {
        let mut pace = Pace::new(500.0, 0);
        pace.start(2_000);
        assert!(pace.finish(9_500));
        assert_eq!(pace.due_us(), 11_500);
        assert!((pace.start(11_500) - 0.0095).abs() < 1e-6);
        assert!(!pace.finish(11_800));
        assert_eq!(pace.due_us(), 13_500);
    }

    #[test]
    fn no_rate_makes_a_loop_without_a_pause() {
        for rate_hz in [f32::NAN, f32::INFINITY, -1.0, 1e9] {
            assert_eq!(Pace::new(rate_hz, 7).due_us(), 8, "{rate_hz}");
        }
    }
}
