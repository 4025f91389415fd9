//! Whether a loss of all alike is one of two facing rotors: thrust and balance cannot tell, the turning can.
//!
//! ```text
//! alike:          ṙ = κ/Iz f Σ ±F_j                      rotors 1 and 3 turn the body one way, 2 and 4 the other
//! rotors 1, 3:    ṙ = κ/Iz ((2 f − 1)(F1 + F3) − (F2 + F4))       and the mirror image for 2, 4
//! ```
//!
//! | symbol | code         | unit  | what                                    |
//! |--------|--------------|-------|-----------------------------------------|
//! | f      | `factor`     |       | share of the thrust that is left        |
//! | F_j    | `made_n`     | N     | thrust of healthy rotors                |
//! | r      | `rate_rad_s` | rad/s | yaw rate                                |
//!
//! Both are integrated from the alarm on, until they are [`TELLING_RAD_S`] apart: then the nearer one is believed. In that time the
//! body hardly turns, so that its drag does not matter.
//!
//! Source: docs/control-law.md, "Watching the rotors".
use crate::airframe::Airframe;
use crate::{Mask, Scalar};

/// Distance of the two explanations at which one is believed, rad/s: five times what gusts turn the body by in that time.
const TELLING_RAD_S: f32 = 0.25;
/// Shared loss below which the two are not told apart.
const LEAST_LOSS: f32 = 0.15;

/// The test, configured.
#[derive(Clone, Debug)]
pub(super) struct Pairs<S> {
    /// κ / Iz, 1/(kg m).
    per_newton: S,
}

/// The test under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial<S> {
    /// What the yaw rate should be if all lost alike, if rotors 1 and 3 did, if 2 and 4 did, rad/s.
    expected_rad_s: [S; 3],
}

/// What came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// All lost alike.
    Alike,
    /// This rotor and the one facing it: 0 or 1.
    Pair(usize),
}

impl<S: Scalar> Pairs<S> {
    pub(super) fn new(airframe: &Airframe) -> Self {
        let [_, _, iz] = airframe.inertia_kg_m2;
        Self { per_newton: S::from_f32(airframe.torque_per_thrust_m / iz) }
    }

    /// Begins at the yaw rate `rate_rad_s`.
    pub(super) fn open(rate_rad_s: S) -> Trial<S> {
        Trial { expected_rad_s: [rate_rad_s; 3] }
    }

    /// One tick; the verdict, once there is one.
    ///
    /// - `factor`: share of the thrust that is left.
    /// - `made_n`: thrust that healthy rotors would make, N.
    pub(super) fn step(
        &self,
        trial: &mut Trial<S>,
        factor: S,
        made_n: &[S; 4],
        rate_rad_s: S,
        dt_s: S,
    ) -> Option<Verdict> {
        if S::from_f32(1.0 - LEAST_LOSS).lt(factor).all() {
            return None;
        }
        let [a, b, c, d] = *made_n;
        let (first, second) = (a + c, b + d);
        let left = (factor + factor - S::ONE).max(S::ZERO);
        let gain = self.per_newton * dt_s;
        for (expected, torque_n) in trial.expected_rad_s.iter_mut().zip([
            factor * (first - second),
            left * first - second,
            first - left * second,
        ]) {
            *expected = *expected + gain * torque_n;
        }
        let [alike, ..] = trial.expected_rad_s;
        let away = (rate_rad_s - alike).abs();
        for (rotor, &pair) in trial.expected_rad_s.iter().skip(1).enumerate() {
            let told = S::from_f32(TELLING_RAD_S).lt((pair - alike).abs());
            if (told & (rate_rad_s - pair).abs().lt(away)).all() {
                return Some(Verdict::Pair(rotor));
            }
            if !told.all() {
                return None;
            }
        }
        Some(Verdict::Alike)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f32 = 0.002;

    /// The verdict on a hover whose body turns faster by `turning_rad_s2`, and after how long, s.
    fn verdict(factor: f32, turning_rad_s2: f32) -> Option<(Verdict, f32)> {
        let airframe = Airframe::paper(3.0);
        let pairs = Pairs::<f32>::new(&airframe);
        let mut trial = Pairs::open(0.3);
        // Commands have risen so that what is left carries the weight.
        let made_n = [airframe.weight_n() / 4.0 / factor; 4];
        (1..500).map(|tick| DT_S * tick as f32).find_map(|t_s| {
            let verdict = pairs.step(&mut trial, factor, &made_n, 0.3 + turning_rad_s2 * t_s, DT_S)?;
            Some((verdict, t_s))
        })
    }

    #[test]
    fn the_turning_tells_which_pair_is_gone_or_that_none_is() {
        let airframe = Airframe::paper(3.0);
        let alone = airframe.torque_per_thrust_m * airframe.weight_n() / airframe.inertia_kg_m2[2];
        for (turning, want) in [(-alone, Verdict::Pair(0)), (alone, Verdict::Pair(1)), (0.0, Verdict::Alike)] {
            let (found, after_s) = verdict(0.5, turning).expect("half a second tells");
            assert_eq!(found, want);
            assert!((0.05..0.2).contains(&after_s), "{after_s}");
        }
    }

    #[test]
    fn a_small_shared_loss_is_not_put_on_trial() {
        assert_eq!(verdict(0.9, -1.0), None);
    }
}
