//! Satellites and optical flow, which both measure the velocity: where they differ for seconds, flow yields.
//!
//! ```text
//! apart ← apart + (v_satellites − v − apart) / 10, a fix     while fixes are steady; fades where they are not
//! |apart| > LIMIT + SHARE |v|:  flow is out, and the velocity is set to what satellites say
//! ```
//!
//! Flow is precise and comes five times as often, so that the filter follows it wherever it drifts, and it is the satellites that seem to
//! disagree. But flow rests on light, texture and one range, and the velocity of a fix on the Doppler of many satellites that check one
//! another. What garbage of a receiver says is not steady, and votes for nothing.
//!
//! Flow that is out is compared on, and let in again when it has agreed for [`PAROLE_US`], or when the satellites say nothing steady for
//! [`HEARD_US`].
use super::covariance::Observation;
use crate::frames::{Ned, Vec3};

/// Steady difference that is a fault: m/s, and of the speed, what scales of flow and range may be off by together.
const LIMIT_M_S: f32 = 0.5;
const SHARE: f32 = 0.1;
/// What the last fix, and the last image, is believed of their mean difference: a second of either.
const FIX: f32 = 0.1;
const IMAGE: f32 = 0.02;
/// How long flow must agree, µs.
const PAROLE_US: u64 = 3_000_000;
/// How long ago satellites must have been steady to vouch for the velocity, µs.
const HEARD_US: u64 = 1_000_000;

/// How the two have got on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rivals {
    /// What satellites say beyond what is believed, or flow while it is out, m/s.
    apart_m_s: [f32; 2],
    out: bool,
    /// When flow that is out last differed, and when satellites were last steady, µs.
    differed_us: u64,
    steady_us: u64,
}

impl Rivals {
    /// Neither heard.
    pub(super) const NEW: Self = Self { apart_m_s: [0.0; 2], out: false, differed_us: 0, steady_us: 0 };

    /// Whether flow may not be gone by at `now_us`.
    pub(super) fn is_out(&self, now_us: u64) -> bool {
        self.out && now_us.saturating_sub(self.steady_us) < HEARD_US
    }

    /// Takes the velocity of a fix; whether flow is out from now on.
    ///
    /// - `led`: whether flow leads the velocity `believed_m_s`; `steady`: whether the receiver keeps to what it says.
    pub(super) fn hear_fix(
        &mut self,
        moved: &[Observation; 3],
        believed_m_s: Vec3<Ned>,
        (led, steady): (bool, bool),
        now_us: u64,
    ) -> bool {
        if steady {
            self.steady_us = now_us;
        }
        if self.is_out(now_us) {
            return false;
        }
        self.out = false;
        let north_east = [moved[0].innovation, moved[1].innovation];
        let to = if led && steady { north_east } else { [0.0; 2] };
        self.follow(to, FIX);
        if self.differ(LIMIT_M_S, believed_m_s) {
            *self = Self { apart_m_s: self.apart_m_s.map(|apart| -apart), out: true, differed_us: now_us, ..*self };
        }
        self.out
    }

    /// Takes what an image says beyond the velocity `believed_m_s`, while flow is out.
    pub(super) fn hear_image(&mut self, seen: &[Observation; 2], believed_m_s: Vec3<Ned>, now_us: u64) {
        self.follow([seen[0].innovation, seen[1].innovation], IMAGE);
        if self.differ(0.5 * LIMIT_M_S, believed_m_s) {
            self.differed_us = now_us;
        } else if now_us.saturating_sub(self.differed_us) > PAROLE_US {
            *self = Self { steady_us: self.steady_us, ..Self::NEW };
        }
    }

    fn follow(&mut self, to: [f32; 2], share: f32) {
        for (apart, to) in self.apart_m_s.iter_mut().zip(to) {
            *apart += share * (to - *apart);
        }
    }

    /// Whether they are apart by more than `limit_m_s` and what speed makes of it.
    fn differ(&self, limit_m_s: f32, v: Vec3<Ned>) -> bool {
        let [north, east] = self.apart_m_s;
        // Of squares, less than the square of the sum: no root is wanted.
        north * north + east * east > limit_m_s * limit_m_s + SHARE * SHARE * (v.x * v.x + v.y * v.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn off<const N: usize>(north_m_s: f32) -> [Observation; N] {
        core::array::from_fn(|axis| Observation::new(if axis == 0 { north_m_s } else { 0.0 }, 0.09, [(3 + axis, 1.0)]))
    }

    /// Whether flow is out after `seconds` of fixes that are `north_m_s` off.
    fn out_after(rivals: &mut Rivals, seconds: u64, north_m_s: f32, led: bool, steady: bool) -> bool {
        let still = Vec3::zero();
        let begin_us = rivals.steady_us;
        for fix in 1..=10 * seconds {
            rivals.hear_fix(&off(north_m_s), still, (led, steady), begin_us + 100_000 * fix);
        }
        rivals.is_out(begin_us + 1_000_000 * seconds)
    }

    #[test]
    fn flow_yields_to_satellites_that_say_the_same_for_seconds() {
        for (why, north_m_s, led, steady, want) in [
            ("they are apart", 0.8, true, true, true),
            ("they agree within what a receiver is off by", 0.3, true, true, false),
            ("the receiver says anything", 0.8, true, false, false),
            ("flow is not gone by", 0.8, false, true, false),
        ] {
            let mut rivals = Rivals::NEW;
            assert_eq!(out_after(&mut rivals, 4, north_m_s, led, steady), want, "{why}");
        }
    }

    #[test]
    fn flow_comes_back_when_it_has_agreed_or_satellites_are_gone() {
        let mut rivals = Rivals::NEW;
        assert!(out_after(&mut rivals, 4, 0.8, true, true));
        assert!(!rivals.is_out(rivals.steady_us + HEARD_US), "nobody else knows the velocity");
        let mut agreeing = |seconds: u64, north_m_s: f32| {
            for _ in 0..50 * seconds {
                rivals.steady_us += 20_000;
                rivals.hear_image(&off(north_m_s), Vec3::zero(), rivals.steady_us);
            }
            rivals.is_out(rivals.steady_us)
        };
        assert!(agreeing(10, 0.8), "it still drifts");
        assert!(agreeing(3, 0.0), "just now");
        assert!(!agreeing(3, 0.0), "for long enough");
    }
}
