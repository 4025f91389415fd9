//! Where the machine was: what a delayed measurement is compared with.
//!
//! A measurement speaks of its own time. Two ways lead there: fuse everything late, at a horizon behind the slowest sensor, and predict
//! from there to now with a second state; or keep the path and compare the measurement with where the path was. The second is here:
//! no delay for the prompt sensors, no second integration, and 2.8 kB.
//!
//! ```text
//! now = C ∘ path(now)        then = C ∘ path(then)        C: sum of all corrections
//! ```
//!
//! What is stored is the path of dead reckoning with all corrections taken off, so a correction made since moves the past with it, at no
//! cost. The error then is carried from the error now by the inverse of Φ over the delay T, to first order: `p' = p − T v`, all else as now.
//!
//! Neglected: the drift of velocity that tilt and accelerometer bias make within the delay, together (one without the other would make
//! their difference look observed; 2 mm/s after 0.15 s, once that difference is known to 0.01 m/s²), what biases turn within it (0.3 mrad at
//! 2 mrad/s), the noise of the inertial unit within it (1 mm/s), and what corrections of velocity made within it moved.
//! Source: Larsen et al., Incorporation of time delayed measurements in a discrete-time Kalman filter (1998).
use super::quaternion::Quaternion;
use super::strapdown::Nominal;
use crate::frames::{Body, Ned, Vec3};

/// Steps kept: a quarter of a second and one step, at 250 Hz.
const STEPS: usize = 64;
/// The oldest measurement that is looked at, µs.
pub(crate) const DELAY_US_MAX: u64 = 250_000;

/// All corrections so far.
#[derive(Clone, Copy, Debug)]
struct Correction {
    rotation: Quaternion,
    velocity_m_s: Vec3<Ned>,
    position_m: Vec3<Ned>,
}

impl Correction {
    const NONE: Self = Self { rotation: Quaternion::IDENTITY, velocity_m_s: Vec3::zero(), position_m: Vec3::zero() };
}

/// A point of the path, corrections taken off.
#[derive(Clone, Copy, Debug)]
struct Point {
    /// The low 32 bits of the time: they roll over, differences do not.
    time_us: u32,
    path: Correction,
}

/// The path of the last quarter of a second.
#[derive(Clone, Copy, Debug)]
pub(crate) struct History {
    points: [Point; STEPS],
    /// Where the next point goes.
    next: usize,
    filled: usize,
    correction: Correction,
}

/// Where the machine was at the time of a measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Past {
    pub(crate) rotation: Quaternion,
    pub(crate) velocity_m_s: Vec3<Ned>,
    pub(crate) position_m: Vec3<Ned>,
    /// Body rates about then, rad/s.
    pub(crate) rate_rad_s: Vec3<Body>,
    /// T, s.
    pub(crate) delay_s: f32,
}

impl History {
    /// Nothing yet.
    pub(crate) const EMPTY: Self = Self {
        points: [Point { time_us: 0, path: Correction::NONE }; STEPS],
        next: 0,
        filled: 0,
        correction: Correction::NONE,
    };

    /// Adds the present, which the nominal has settled on.
    pub(crate) fn push(&mut self, time_us: u64, nominal: &Nominal) {
        let path = Correction {
            rotation: self.correction.rotation.inverse().after(nominal.rotation),
            velocity_m_s: nominal.velocity_m_s - self.correction.velocity_m_s,
            position_m: nominal.position_m - self.correction.position_m,
        };
        if let Some(point) = self.points.get_mut(self.next) {
            *point = Point { time_us: time_us as u32, path };
        }
        self.next = (self.next + 1) % STEPS;
        self.filled = STEPS.min(self.filled + 1);
    }

    /// Moves past and present by a correction.
    pub(crate) fn correct(&mut self, turn: Quaternion, velocity_m_s: Vec3<Ned>, position_m: Vec3<Ned>) {
        self.correction.rotation = turn.after(self.correction.rotation);
        self.correction.velocity_m_s = self.correction.velocity_m_s + velocity_m_s;
        self.correction.position_m = self.correction.position_m + position_m;
    }

    /// Where the machine was at `time_us`; `None` if that is before what is kept.
    ///
    /// - `now_us`: the time of the last point pushed.
    pub(crate) fn at(&self, time_us: u64, now_us: u64) -> Option<Past> {
        let age_us = now_us.saturating_sub(time_us);
        if age_us > DELAY_US_MAX {
            return None;
        }
        let (age_us, now_us) = (age_us as u32, now_us as u32);
        let (before, after) = self.around(age_us, now_us)?;
        let span_us = after.time_us.wrapping_sub(before.time_us);
        let into_us = now_us.wrapping_sub(before.time_us) - age_us;
        let share = if span_us == 0 { 1.0 } else { into_us as f32 / span_us as f32 };
        let blend = |a: Vec3<Ned>, b: Vec3<Ned>| a + (b - a) * share;
        let rotation = before.path.rotation.towards(after.path.rotation, share);
        let velocity_m_s = blend(before.path.velocity_m_s, after.path.velocity_m_s) + self.correction.velocity_m_s;
        let turned: Vec3<Body> = before.path.rotation.inverse().after(after.path.rotation).small_angle();
        Some(Past {
            rotation: self.correction.rotation.after(rotation),
            velocity_m_s,
            position_m: blend(before.path.position_m, after.path.position_m) + self.correction.position_m,
            rate_rad_s: turned * (1e6 / (span_us as f32).max(1.0)),
            delay_s: age_us as f32 * 1e-6,
        })
    }

    /// The points on both sides of that age.
    fn around(&self, age_us: u32, now_us: u32) -> Option<(&Point, &Point)> {
        let mut later: Option<&Point> = None;
        for back in 1..=self.filled {
            let point = self.points.get((self.next + STEPS - back) % STEPS)?;
            if now_us.wrapping_sub(point.time_us) >= age_us {
                // Between the last point and now there is nothing to blend, and before it the rate is still wanted.
                let newest_has_a_rate = later.is_none() && back < self.filled;
                if newest_has_a_rate {
                    let previous = self.points.get((self.next + STEPS - back - 1) % STEPS)?;
                    return Some((previous, point));
                }
                return Some((point, later.unwrap_or(point)));
            }
            later = Some(point);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A path along north at 1 m/s that turns at `spin` rad/s about down, known every 4 ms up to `end_us`.
    fn flown(spin: f32, end_us: u64) -> (History, Nominal) {
        let mut history = History::EMPTY;
        let mut nominal = Nominal::at_rest(Quaternion::IDENTITY, Vec3::zero());
        nominal.velocity_m_s.x = 1.0;
        let turn = Quaternion::exp(Vec3::<Body>::new(0.0, 0.0, spin * 0.004));
        for time_us in (0..=end_us).step_by(4000) {
            nominal.position_m.x = time_us as f32 * 1e-6;
            history.push(time_us, &nominal);
            if time_us < end_us {
                nominal.rotation = nominal.rotation.after(turn);
            }
        }
        (history, nominal)
    }

    #[test]
    fn the_past_lies_on_the_path_between_two_steps() {
        let (history, nominal) = flown(35.0, 400_000);
        for age_us in [0, 1000, 2000, 100_500, 249_000] {
            let past = history.at(400_000 - age_us, 400_000).expect("kept");
            let age_s = age_us as f32 * 1e-6;
            assert!((past.position_m.x - (0.4 - age_s)).abs() < 1e-6, "{age_us}: {past:?}");
            let turned: Vec3<Body> = past.rotation.inverse().after(nominal.rotation).small_angle();
            let want = 2.0 * libm::sinf(0.5 * 35.0 * age_s);
            assert!((turned.z.abs() - want.abs()).abs() < 2e-4, "{age_us}: {turned:?} {want}");
            assert!((past.rate_rad_s.z - 35.0).abs() < 0.05, "{age_us}: {past:?}");
        }
    }

    #[test]
    fn a_correction_moves_the_past_with_the_present() {
        let (mut history, _) = flown(0.0, 400_000);
        let (turn, jump) = (Quaternion::exp(Vec3::<Ned>::new(0.0, 0.0, 0.1)), Vec3::new(0.0, 3.0, 0.0));
        history.correct(turn, Vec3::zero(), jump);
        let past = history.at(300_000, 400_000).expect("kept");
        assert!((past.position_m.y - 3.0).abs() < 1e-6 && (past.position_m.x - 0.3).abs() < 1e-6, "{past:?}");
        assert!((past.rotation.small_angle::<Ned>().z - 0.1).abs() < 1e-3, "{past:?}");
    }

    #[test]
    fn what_is_not_kept_is_not_invented() {
        let (history, _) = flown(1.0, 400_000);
        assert!(history.at(400_000 - DELAY_US_MAX - 1, 400_000).is_none());
        let (history, _) = flown(1.0, 40_000);
        assert!(history.at(0, 40_000).is_some() && History::EMPTY.at(0, 0).is_none());
    }
}
