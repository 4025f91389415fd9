//! Detection against false alarms, for every threshold at once, from sums that no alarm has cut short.
use control_core::HYPOTHESES;
use std::sync::LazyLock;

/// How many thresholds.
const LEVELS: usize = 64;
/// Smallest and largest threshold, nats; above, the detector does not count.
const RANGE_NATS: (f32, f32) = (0.05, 95.0);
/// Times within which a detection is in time, s.
pub const IN_TIME_S: [f64; 2] = [0.1, 0.2];
/// An alarm is over when the largest sum is below this share of its threshold: the sums start again.
const OVER: f32 = 0.5;

/// The thresholds, evenly spaced in their logarithm.
static THRESHOLDS_NATS: LazyLock<[f32; LEVELS]> = LazyLock::new(|| {
    let (low, high) = RANGE_NATS;
    std::array::from_fn(|k| low * libm::powf(high / low, k as f32 / (LEVELS - 1) as f32))
});

/// The likeliest hypothesis and its sum, as the detector picks it.
fn likeliest(nats: &[f32; HYPOTHESES]) -> (usize, f32) {
    nats.iter().copied().enumerate().fold((HYPOTHESES, 0.0), |most, (i, x)| if x > most.1 { (i, x) } else { most })
}

/// When the sums of a flight with a fault first passed each threshold.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Passages {
    /// Whether it was passed before the onset, and not over yet.
    before: Levels<bool>,
    /// Delay, and whether the right rotor passed it.
    first: Levels<Option<(f64, bool)>>,
}

/// One value a threshold.
#[derive(Clone, Copy, Debug)]
struct Levels<T>([T; LEVELS]);

impl<T: Copy + Default> Default for Levels<T> {
    fn default() -> Self {
        Self([T::default(); LEVELS])
    }
}

impl Passages {
    pub(super) fn note(&mut self, nats: &[f32; HYPOTHESES], rotor: usize, since_s: f64) {
        let (leader, most) = likeliest(nats);
        for (k, level) in THRESHOLDS_NATS.iter().copied().enumerate() {
            let above = most > level;
            if since_s < 0.0 {
                self.before.0[k] = above;
            } else if above && self.first.0[k].is_none() {
                self.first.0[k] = Some((since_s, leader == rotor && !self.before.0[k]));
            }
        }
    }

    /// Whether threshold `k` was first passed by the right rotor within `in_time_s` of the onset.
    fn detected(&self, k: usize, in_time_s: f64) -> bool {
        self.first.0[k].is_some_and(|(delay_s, right)| right && delay_s <= in_time_s)
    }
}

/// How often a healthy flight passed each threshold.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Crossings {
    lasting: Levels<bool>,
    count: Levels<u64>,
    pub(super) nats_max: f32,
}

impl Crossings {
    pub(super) fn note(&mut self, nats: &[f32; HYPOTHESES]) {
        let (_, most) = likeliest(nats);
        self.nats_max = self.nats_max.max(most);
        for (k, level) in THRESHOLDS_NATS.iter().copied().enumerate() {
            let lasting = &mut self.lasting.0[k];
            if most > level {
                self.count.0[k] += u64::from(!*lasting);
                *lasting = true;
            } else if most < OVER * level {
                *lasting = false;
            }
        }
    }
}

/// Detection rate against false alarms.
#[derive(Default)]
pub struct Roc {
    /// The threshold that flies, nats.
    pub alarm_nats: f32,
    /// Healthy hours behind the false alarms.
    pub hours: f64,
    /// Each loss, and the passages of its flights.
    pub(super) detections: Vec<(f64, Vec<Passages>)>,
    false_alarms: Levels<u64>,
}

/// One threshold of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Threshold, nats.
    pub nats: f32,
    /// False alarms, of all healthy hours.
    pub false_alarms: u64,
    /// Share of the flights in which the right rotor was found in time.
    pub detected: f64,
}

impl Roc {
    pub(super) fn new(alarm_nats: f32) -> Self {
        Self { alarm_nats, ..Self::default() }
    }

    pub(super) fn note_healthy(&mut self, crossings: &Crossings) {
        for (sum, count) in self.false_alarms.0.iter_mut().zip(crossings.count.0) {
            *sum += count;
        }
    }

    /// The losses that were flown.
    pub fn losses(&self) -> impl Iterator<Item = f64> {
        self.detections.iter().map(|(loss, _)| *loss)
    }

    /// The curve of a loss, by rising threshold.
    pub fn curve(&self, loss: f64, in_time_s: f64) -> Vec<Point> {
        let flights = self.detections.iter().filter(|(flown, _)| *flown == loss).flat_map(|(_, flights)| flights);
        let flights: Vec<_> = flights.collect();
        let point = |(k, nats): (usize, f32)| {
            let detected = flights.iter().filter(|passages| passages.detected(k, in_time_s)).count();
            Point { nats, false_alarms: self.false_alarms.0[k], detected: detected as f64 / flights.len() as f64 }
        };
        THRESHOLDS_NATS.iter().copied().enumerate().map(point).collect()
    }

    /// The threshold of a curve nearest to the one that flies.
    pub fn flying(&self, curve: &[Point]) -> Option<Point> {
        let off = |point: &Point| (point.nats / self.alarm_nats).ln().abs();
        curve.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sums(first: [f32; 2]) -> [f32; HYPOTHESES] {
        std::array::from_fn(|i| first.get(i).copied().unwrap_or(0.0))
    }

    #[test]
    fn a_threshold_is_passed_once_and_by_the_likeliest() {
        let mut passages = Passages::default();
        passages.note(&sums([3.0, 0.0]), 1, -0.1);
        passages.note(&sums([3.0, 20.0]), 1, 0.05);
        passages.note(&sums([90.0, 20.0]), 1, 0.15);
        let levels = *THRESHOLDS_NATS;
        let at = |nats: f32| levels.iter().position(|&level| level > nats).expect("within");
        assert!(!passages.detected(0, 0.1), "passed before the onset");
        assert!(passages.detected(at(5.0), 0.1) && passages.detected(at(16.0), 0.1));
        assert!(!passages.detected(at(5.0), 0.04));
        assert!(!passages.detected(at(30.0), 0.2), "another rotor is likelier by then");
    }

    #[test]
    fn a_healthy_excursion_is_one_false_alarm_of_every_threshold_below_its_peak() {
        let mut crossings = Crossings::default();
        for most in [0.0, 5.0, 4.0, 5.0, 1.0, 5.0, 0.0, 11.0] {
            crossings.note(&sums([most, 0.0]));
        }
        let mut roc = Roc::new(12.0);
        roc.note_healthy(&crossings);
        let levels = *THRESHOLDS_NATS;
        let count = |nats: f32| roc.false_alarms.0[levels.iter().position(|&level| level > nats).expect("within")];
        assert_eq!((count(4.05), count(9.0), count(11.5)), (3, 1, 0));
        assert_eq!(crossings.nats_max, 11.0);
    }
}
