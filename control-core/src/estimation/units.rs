//! Two inertial units compared, gyro and accelerometer apart, and the one at fault told from the other.
//!
//! ```text
//! off    = spare − used − above             above ← above + off / n,  n ≤ 10⁴: what lasts is bias, learnt while they agree
//! lately ← lately + off / 50
//!
//! jump:  |off|²    > JUMP² + TOLERANCE² |turn|²    at fault is the one that is farther from the last sample that was believed
//! late:  after a jump of the spare by j from the last believed, the one in use does the same within LATE_US:   moved · j > 0.8 |j|²
//! drift: |lately|² > DRIFT² + TOLERANCE² |turn|²   at fault is the one in use, if its estimated bias b has followed:
//!                                                   (b − b₀) · (−lately) > ½ |lately|², b₀ the bias when they last agreed
//! ```
//!
//! Where a fault of the spare leaves b at b₀ and one of the unit in use draws it to −lately, half way is the fair division. So that b can follow
//! a drift, its variance is raised by DRIFT² at once and by a quarter of that a second; it is judged when |lately| is five standard deviations of b along it.
//!
//! A gyro that says late what the other has said before looks at first as if the other jumped; then it follows, which no jump makes it do.
//!
//! The thresholds are far above what healthy units differ by. Gyro, rad/s: noise 0.002, vibration and samples that are 1 ms apart in a
//! rotor's fault (100 rad/s²) 0.1. Accelerometer, m/s²: noise 0.02, units 2 cm apart at 100 rad/s² 2. Bias does not count, and may move by a
//! drift threshold in ten seconds: 0.005 rad/s² and 0.05 m/s³, which no warming chip does. What grows with the turning: 1.5 % of scale and misalignment of each, and 3 cm ω² between their places.
//!
//! Invariant: the spare is the one that is held to be at fault, as long as [`Units::apart`] is set; it is believed again when it has
//! agreed for [`PAROLE_US`], and flown on when the unit in use says nothing that can be believed.
use super::filter::Filter;
use super::observe::components;
use super::sources::Source;
use crate::frames::{Body, Vec3};
use crate::measurement::Imu;

/// Of gyro, rad/s, and accelerometer, m/s²: beyond what a sample, and the mean of a twentieth of a second, may differ.
const JUMP: [f32; 2] = [0.15, 2.0];
const DRIFT: [f32; 2] = [0.05, 0.5];
/// Share of the rate, and of its square, m, that they may differ by.
const TOLERANCE: [f32; 2] = [0.03, 0.03];
/// What a difference is believed of each sample, and most samples that it is the mean of.
const LATELY: f32 = 0.02;
const LEARNT_MAX: u16 = 10_000;
/// Standard deviations of the bias that a drift must have grown to before it is judged: half of it is then two and a half.
const SURE: f32 = 5.0;
/// How late a gyro is to be found out to be, µs, and the share of a jump that it must make by then.
const LATE_US: u64 = 60_000;
const FOLLOWED: f32 = 0.8;
/// How long the one at fault must agree, µs.
const PAROLE_US: u64 = 1_000_000;

/// Gyro and accelerometer.
type Halves = [Vec3<Body>; 2];

/// What is known of one inertial unit by the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Units {
    /// Whether the second one is gone by.
    pub(super) on_second: bool,
    /// Whether the spare is held to be at fault.
    pub(super) apart: bool,
    /// How the spare reads above the unit in use, and beyond that lately.
    above: Halves,
    lately: Halves,
    /// The sample that was last gone by, and the biases when the units last agreed.
    last: Halves,
    calm: Halves,
    learnt: u16,
    /// When they last differed, µs.
    differed_us: u64,
    /// Where the spare's gyro jumped from, how far, and when, until it is known whether that in use follows.
    jumped: Option<(Vec3<Body>, Vec3<Body>, u64)>,
    /// The half in which a drift is looked for.
    doubted: Option<usize>,
    /// Whether a drift of the unit in use has been found.
    found: bool,
}

fn halves(imu: &Imu) -> Halves {
    [imu.rate_rad_s, imu.specific_force_m_s2]
}

fn sum(a: Halves, b: Halves) -> Halves {
    [a[0] + b[0], a[1] + b[1]]
}

fn difference(a: Halves, b: Halves) -> Halves {
    [a[0] - b[0], a[1] - b[1]]
}

/// Squares of the halves, each over that of its limit while the body turns.
fn beyond(off: Halves, limits: [f32; 2], turn_squared: f32) -> [f32; 2] {
    let turn = [turn_squared, turn_squared * turn_squared];
    core::array::from_fn(|i| {
        let limit = limits[i] * limits[i] + TOLERANCE[i] * TOLERANCE[i] * turn[i];
        off[i].norm_squared() / limit
    })
}

impl Units {
    /// Nothing compared yet; the first is gone by.
    pub(super) const NEW: Self = Self {
        on_second: false,
        apart: false,
        above: [Vec3::zero(); 2],
        lately: [Vec3::zero(); 2],
        last: [Vec3::zero(); 2],
        calm: [Vec3::zero(); 2],
        learnt: 0,
        differed_us: 0,
        jumped: None,
        doubted: None,
        found: false,
    };

    /// The one that is gone by, and the other.
    pub(super) fn sources(&self) -> (Source, Source) {
        let (first, second) = (Source::Inertial, Source::InertialSecond);
        if self.on_second { (second, first) } else { (first, second) }
    }

    /// Compares two samples of the same time; whether the one in use is at fault.
    pub(super) fn compare(&mut self, used: &Imu, spare: &Imu, filter: &mut Filter, now_us: u64) -> bool {
        let (used, spare) = (halves(used), halves(spare));
        let off = difference(difference(spare, used), self.above);
        for (lately, off) in self.lately.iter_mut().zip(off) {
            *lately = *lately + (off - *lately) * LATELY;
        }
        // The slower of the two: a gyro that is at fault may not excuse itself.
        let turn_squared = used[0].norm_squared().min(spare[0].norm_squared());
        let [jumped, drifted] =
            [(off, JUMP), (self.lately, DRIFT)].map(|(off, limits)| beyond(off, limits, turn_squared));
        let beyond_any = |ratios: [f32; 2]| ratios.iter().any(|ratio| *ratio > 1.0);
        let mut at_fault = self.found || self.is_late(used[0], now_us);
        if beyond_any(jumped) || beyond_any(drifted) {
            self.differed_us = now_us;
            if !self.apart {
                self.apart = true;
                if beyond_any(jumped) {
                    let i = usize::from(jumped[1] > jumped[0]);
                    let left = |x: Halves| (x[i] - self.last[i]).norm_squared();
                    let spare = difference(spare, self.above);
                    at_fault = left(used) > left(spare);
                    if i == 0 && !at_fault {
                        self.jumped = Some((self.last[0], spare[0] - self.last[0], now_us));
                    }
                } else {
                    let i = usize::from(drifted[1] > drifted[0]);
                    self.doubted = Some(i);
                    filter.doubt_bias(i, DRIFT[i] * DRIFT[i]);
                }
            }
        } else if self.apart {
            self.apart = now_us.saturating_sub(self.differed_us) < PAROLE_US;
        } else {
            self.learnt = (self.learnt + 1).min(LEARNT_MAX);
            let share = 1.0 / f32::from(self.learnt);
            self.above = sum(self.above, off.map(|off| off * share));
            self.calm = [filter.nominal.gyro_bias_rad_s, filter.nominal.accelerometer_bias_m_s2];
        }
        at_fault
    }

    /// Whether the gyro in use now says what the spare's said before, when it seemed to jump.
    fn is_late(&mut self, used_rad_s: Vec3<Body>, now_us: u64) -> bool {
        let Some((from, by, since_us)) = self.jumped else { return false };
        let follows = (used_rad_s - from).dot(by) > FOLLOWED * by.norm_squared();
        if follows || now_us.saturating_sub(since_us) > LATE_US {
            self.jumped = None;
        }
        follows
    }

    /// Keeps the sample that is gone by.
    pub(super) fn believe(&mut self, imu: &Imu) {
        self.last = halves(imu);
    }

    /// Goes by the other unit, whose biases are those of this one and how much it reads above it.
    pub(super) fn change(&mut self, filter: &mut Filter) {
        if self.apart {
            // The bias may have followed the fault.
            [filter.nominal.gyro_bias_rad_s, filter.nominal.accelerometer_bias_m_s2] = self.calm;
        }
        filter.trade_biases(self.above[0], self.above[1]);
        self.calm = sum(self.calm, self.above);
        self.above = self.above.map(|above| -above);
        self.lately = self.lately.map(|lately| -lately);
        self.on_second = !self.on_second;
        (self.jumped, self.doubted, self.found) = (None, None, false);
    }

    /// While a drift is looked for: lets the biases follow it, and finds the unit in use at fault where they have.
    ///
    /// - `span_s`: since the last time.
    pub(super) fn doubt(&mut self, filter: &mut Filter, span_s: f32) {
        // The bound is said where the compiler sees it: no index panics in flight.
        let Some(i) = self.doubted.filter(|&i| i < DRIFT.len()) else { return };
        if !self.apart {
            self.doubted = None;
            return;
        }
        let nominal = &filter.nominal;
        let bias = [nominal.gyro_bias_rad_s, nominal.accelerometer_bias_m_s2];
        let (lately, moved) = (components(self.lately[i]), components(bias[i] - self.calm[i]));
        let size = self.lately[i].norm_squared();
        let variances = filter.bias_variances(i);
        let along = -(0..3).map(|axis| lately[axis] * moved[axis]).sum::<f32>();
        let unsure = (0..3).map(|axis| lately[axis] * lately[axis] * variances[axis]).sum::<f32>();
        if size * size > SURE * SURE * unsure && size > DRIFT[i] * DRIFT[i] {
            self.found = along > 0.5 * size;
            self.doubted = None;
        } else {
            filter.doubt_bias(i, 0.25 * DRIFT[i] * DRIFT[i] * span_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::EstimatorConfig;
    use super::super::filter::Start;
    use super::super::quaternion::Quaternion;
    use super::super::strapdown::Nominal;
    use super::*;

    fn filter() -> Filter {
        let start = Start {
            tilt_rad: 0.01,
            heading_rad: 0.1,
            velocity_m_s: 0.1,
            position_m: 0.1,
            gyro_bias_rad_s: 0.01,
            levelled_by_accelerometer: false,
        };
        Filter::new(&EstimatorConfig::FLIGHT, Nominal::at_rest(Quaternion::IDENTITY, Vec3::zero()), &start)
    }

    fn imu(rate: f32, force: f32) -> Imu {
        Imu { rate_rad_s: Vec3::new(rate, 0.0, 0.0), specific_force_m_s2: Vec3::new(force, 0.0, -9.8) }
    }

    /// Two units that have agreed for 2 s, whose biases differ by 0.02 rad/s and 0.3 m/s².
    fn agreed(filter: &mut Filter) -> Units {
        let mut units = Units::NEW;
        for ms in 0..2_000 {
            assert!(!units.compare(&imu(0.1, 0.0), &imu(0.12, 0.3), filter, 1000 * ms));
            units.believe(&imu(0.1, 0.0));
        }
        assert!(!units.apart);
        units
    }

    #[test]
    fn of_two_units_the_one_that_jumps_is_at_fault_and_the_other_is_flown_on() {
        for (what, used, spare, at_fault) in [
            ("gyro in use", imu(0.4, 0.0), imu(0.12, 0.3), true),
            ("gyro of the spare", imu(0.1, 0.0), imu(0.42, 0.3), false),
            ("accelerometer in use", imu(0.1, 3.0), imu(0.12, 0.3), true),
            ("accelerometer of the spare", imu(0.1, 0.0), imu(0.12, 3.3), false),
        ] {
            let mut filter = filter();
            let mut units = agreed(&mut filter);
            assert_eq!(units.compare(&used, &spare, &mut filter, 2_000_000), at_fault, "{what}");
            assert!(units.apart, "{what}");
        }
    }

    #[test]
    fn of_two_gyros_the_one_that_says_late_what_the_other_has_said_is_at_fault() {
        const LATE_MS: u64 = 20;
        // The body speeds up at 30 rad/s² from 2 s on.
        let rate = |ms: u64| 0.1 + 0.03 * ms.saturating_sub(2_000).min(100) as f32;
        for (used_late_ms, spare_late_ms, at_fault) in [(LATE_MS, 0, true), (0, LATE_MS, false)] {
            let mut filter = filter();
            let mut units = agreed(&mut filter);
            let changes = (2_000..2_200).find(|&ms| {
                let used = imu(rate(ms - used_late_ms), 0.0);
                let at_fault = units.compare(&used, &imu(rate(ms - spare_late_ms) + 0.02, 0.3), &mut filter, 1000 * ms);
                units.believe(&used);
                at_fault
            });
            assert_eq!(changes.is_some(), at_fault, "{changes:?}");
            assert!(units.apart && changes.is_none_or(|ms| ms < 2_050), "{changes:?}");
        }
    }

    #[test]
    fn a_jump_that_both_make_is_motion() {
        let mut filter = filter();
        let mut units = agreed(&mut filter);
        assert!(!units.compare(&imu(5.1, 20.0), &imu(5.12, 20.3), &mut filter, 2_000_000));
        assert!(!units.apart);
    }

    #[test]
    fn a_unit_that_was_at_fault_is_believed_after_a_second_of_agreement() {
        let mut filter = filter();
        let mut units = agreed(&mut filter);
        units.compare(&imu(0.1, 0.0), &imu(5.0, 0.3), &mut filter, 2_000_000);
        let believed_ms = (2_001..5_000).find(|ms| {
            units.compare(&imu(0.1, 0.0), &imu(0.12, 0.3), &mut filter, 1000 * ms);
            !units.apart
        });
        assert!((3_000..3_200).contains(&believed_ms.expect("believed again")), "{believed_ms:?}");
    }

    #[test]
    fn a_drift_is_of_the_unit_in_use_if_its_bias_has_followed_and_of_the_spare_if_not() {
        for (bias_rad_s, at_fault) in [(0.1, true), (0.01, false)] {
            let mut filter = filter();
            let mut units = agreed(&mut filter);
            let mut changes = false;
            for ms in 2_000..6_000_u16 {
                let drift = 1e-4 * f32::from(ms - 2_000).min(1_500.0);
                changes |= units.compare(&imu(0.1 + drift, 0.0), &imu(0.12, 0.3), &mut filter, 1000 * u64::from(ms));
                if ms == 4_000 {
                    filter.nominal.gyro_bias_rad_s.x = bias_rad_s;
                    // What the aiding sources have seen of it.
                    (0..3).for_each(|axis| filter.covariance.reset(super::super::covariance::GYRO_BIAS + axis, 1e-4));
                }
                units.doubt(&mut filter, 0.0);
            }
            assert_eq!((changes, units.apart), (at_fault, true), "{bias_rad_s}");
        }
    }
}
