//! Satellites, optical flow and dead reckoning, which all know the velocity: who yields where they differ for seconds.
//!
//! ```text
//! apart ← apart + (v_satellites − v − apart) / 10, a fix     while fixes are steady; fades where they are not
//! seen  ← seen + (v_flow − v − seen) / 50, an image
//!
//! |apart| > LIMIT + SHARE |v|, horizontally, and flow agrees with v, 2 |seen| < |apart|:   flow is out, and v is set to what satellites say
//! |apart| > ASTRAY + SHARE |v|, and flow does not, or is not heard, or it is vertical:     the accelerometer is doubted, for DOUBT_US and while
//!                                                                                        its bias is beyond what a sound part has
//! ```
//!
//! Flow is precise and comes five times as often, so that the filter follows it wherever it drifts, and it is the satellites that seem to
//! disagree. But flow rests on light, texture and one range, and the velocity of a fix on the Doppler of many satellites that check one
//! another. What garbage of a receiver says is not steady, and votes for nothing.
//!
//! Where both are ahead of dead reckoning, it is that which is wrong, and its accelerometer the likely cause; a tilt that is wrong looks the same in
//! a hover. With the walk of a bias that is well the filter would follow in minutes, and refuse all others by then. Let move by
//! [`LOOSE_M_S2`] a fix, the bias follows 0.3 m/s³ within 0.1 m/s.
//!
//! Flow that is out is compared on, and let in again when it has agreed for [`PAROLE_US`], or when the satellites say nothing steady for
//! [`HEARD_US`].
use super::covariance::Observation;
use crate::frames::{Ned, Vec3};

/// Steady difference that is a fault: m/s, of flow and of the accelerometer; and of the speed, what scales of flow and range may be off by together.
const LIMIT_M_S: f32 = 0.5;
const ASTRAY_M_S: f32 = 0.3;
const SHARE: f32 = 0.1;
/// What the last fix, and the last image, is believed of their mean difference: a second of either.
const FIX: f32 = 0.1;
const IMAGE: f32 = 0.02;
/// How long flow must agree, µs.
const PAROLE_US: u64 = 3_000_000;
/// How long ago satellites must have been steady to vouch for the velocity, µs.
const HEARD_US: u64 = 1_000_000;
/// How long an accelerometer that is not broken is doubted, µs, and what its bias may have moved by: at first, and meanwhile at each fix, m/s².
const DOUBT_US: u64 = 10_000_000;
const JUMPED_M_S2: f32 = 1.0;
const LOOSE_M_S2: f32 = 0.14;

/// Who is at fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Blame {
    /// Nobody: what they differ by is ordinary.
    Nobody,
    /// Flow, which is out from now on.
    Flow,
    /// The accelerometer of a lone unit, whose bias may have moved by so much, 1 σ, m/s².
    Accelerometer(f32),
}

/// How they have got on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rivals {
    /// What satellites say beyond what is believed, north, east and down, m/s.
    apart_m_s: [f32; 3],
    /// The same of flow, in its own axes.
    seen_m_s: [f32; 2],
    out: bool,
    /// When flow that is out last differed, and when satellites were last steady, µs.
    differed_us: u64,
    steady_us: u64,
    /// Until when the accelerometer is doubted, µs.
    doubted_us: u64,
}

impl Rivals {
    /// None heard.
    pub(super) const NEW: Self =
        Self { apart_m_s: [0.0; 3], seen_m_s: [0.0; 2], out: false, differed_us: 0, steady_us: 0, doubted_us: 0 };

    /// Whether flow may not be gone by at `now_us`.
    pub(super) fn is_out(&self, now_us: u64) -> bool {
        self.out && now_us.saturating_sub(self.steady_us) < HEARD_US
    }

    /// Takes the velocity of a fix; who is at fault.
    ///
    /// - `led`: whether flow leads the velocity `believed_m_s`; `steady`: whether the receiver keeps to what it says; `broken`: whether the
    ///   accelerometer's bias is beyond what a sound part has.
    pub(super) fn hear_fix(
        &mut self,
        moved: &[Observation; 3],
        believed_m_s: Vec3<Ned>,
        (led, steady, broken): (bool, bool, bool),
        now_us: u64,
    ) -> Blame {
        if steady {
            self.steady_us = now_us;
        }
        let to = core::array::from_fn(|axis| if steady { moved[axis].innovation } else { 0.0 });
        follow(&mut self.apart_m_s, to, FIX);
        let [north, east, down] = self.apart_m_s;
        let (mut level, seen) = (north * north + east * east, squared(self.seen_m_s));
        if !self.is_out(now_us) {
            self.out = false;
            // What flow contradicts half as much is not led by it.
            if led && 4.0 * seen < level {
                if beyond(level, LIMIT_M_S, believed_m_s) {
                    (self.out, self.differed_us, self.apart_m_s) = (true, now_us, [0.0; 3]);
                    return Blame::Flow;
                }
                level = 0.0;
            }
        }
        let doubted = broken || now_us < self.doubted_us;
        if beyond(level + down * down, ASTRAY_M_S, believed_m_s) {
            self.doubted_us = now_us + DOUBT_US;
            if !doubted {
                return Blame::Accelerometer(JUMPED_M_S2);
            }
        }
        if doubted { Blame::Accelerometer(LOOSE_M_S2) } else { Blame::Nobody }
    }

    /// Takes what an image says beyond the velocity `believed_m_s`.
    pub(super) fn hear_image(&mut self, seen: &[Observation; 2], believed_m_s: Vec3<Ned>, now_us: u64) {
        follow(&mut self.seen_m_s, [seen[0].innovation, seen[1].innovation], IMAGE);
        if !self.out {
            return;
        }
        if beyond(squared(self.seen_m_s), 0.5 * LIMIT_M_S, believed_m_s) {
            self.differed_us = now_us;
        } else if now_us.saturating_sub(self.differed_us) > PAROLE_US {
            self.out = false;
        }
    }
}

fn follow<const N: usize>(mean: &mut [f32; N], to: [f32; N], share: f32) {
    for (mean, to) in mean.iter_mut().zip(to) {
        *mean += share * (to - *mean);
    }
}

fn squared([x, y]: [f32; 2]) -> f32 {
    x * x + y * y
}

/// Whether a difference of this square is beyond `limit_m_s` and what speed makes of it.
fn beyond(apart_squared: f32, limit_m_s: f32, v: Vec3<Ned>) -> bool {
    // Of squares, less than the square of the sum: no root is wanted.
    apart_squared > limit_m_s * limit_m_s + SHARE * SHARE * squared([v.x, v.y])
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOOSE: Blame = Blame::Accelerometer(LOOSE_M_S2);

    fn off<const N: usize>(north_m_s: f32) -> [Observation; N] {
        core::array::from_fn(|axis| Observation::new(if axis == 0 { north_m_s } else { 0.0 }, 0.09, [(3 + axis, 1.0)]))
    }

    /// Who is at fault after four seconds of images that are `seen_m_s` off and fixes that are `apart_m_s` off, north.
    fn blame(rivals: &mut Rivals, (seen_m_s, apart_m_s): (f32, f32), (led, steady): (bool, bool)) -> Blame {
        let (still, mut blame) = (Vec3::zero(), Blame::Nobody);
        for image in 1..=200 {
            let now_us = 20_000 * image;
            rivals.hear_image(&off(seen_m_s), still, now_us);
            if image % 5 == 0 {
                blame = rivals.hear_fix(&off(apart_m_s), still, (led, steady, false), now_us);
            }
            if blame == Blame::Flow {
                break;
            }
        }
        blame
    }

    #[test]
    fn where_velocities_differ_for_seconds_the_one_that_is_alone_yields() {
        for (why, offs, heard, want) in [
            ("flow leads away from the satellites", (0.0, 0.8), (true, true), Blame::Flow),
            ("they agree within what a receiver is off by", (0.0, 0.3), (true, true), Blame::Nobody),
            ("flow says what the satellites say", (0.8, 0.8), (true, true), LOOSE),
            ("there is no flow", (0.0, 0.8), (false, true), LOOSE),
            ("it is within what a receiver is off by", (0.0, 0.25), (false, true), Blame::Nobody),
            ("the receiver says anything", (0.8, 0.8), (true, false), Blame::Nobody),
        ] {
            let mut rivals = Rivals::NEW;
            assert_eq!(blame(&mut rivals, offs, heard), want, "{why}");
        }
    }

    #[test]
    fn an_accelerometer_that_lifts_is_told_by_satellites_alone_and_believed_again_after_seconds() {
        let mut rivals = Rivals::NEW;
        let climbing = |m_s: f32| {
            core::array::from_fn(|axis| Observation::new(if axis == 2 { m_s } else { 0.0 }, 0.09, [(3 + axis, 1.0)]))
        };
        let mut hear = |seconds: u64, m_s: f32, broken: bool| {
            let begin_us = rivals.steady_us;
            (1..=10 * seconds).fold(Blame::Nobody, |_, fix| {
                rivals.hear_fix(&climbing(m_s), Vec3::zero(), (true, true, broken), begin_us + 100_000 * fix)
            })
        };
        assert_eq!(hear(4, 0.25, false), Blame::Nobody);
        assert_eq!(hear(4, -0.8, false), LOOSE);
        assert_eq!(hear(9, 0.0, false), LOOSE);
        assert_eq!(hear(4, 0.0, false), Blame::Nobody);
        assert_eq!(hear(30, 0.0, true), LOOSE, "what is broken is not well again");
    }

    #[test]
    fn flow_comes_back_when_it_has_agreed_or_satellites_are_gone() {
        let mut rivals = Rivals::NEW;
        assert_eq!(blame(&mut rivals, (0.0, 0.8), (true, true)), Blame::Flow);
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
