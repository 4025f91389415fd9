//! Splits thrust and torques over four rotors; what saturation refuses is reported.
//!
//! Rotors 1 and 3 face each other, as do 2 and 4, so each pair has a difference, which makes roll and pitch, and a
//! sum, which makes thrust and yaw:
//!
//! ```text
//! δ1 = F3 − F1     δ2 = F2 − F4     (roll, pitch) = G (δ1, δ2)     s1 = F1 + F3     s2 = F2 + F4
//! thrust = s1 + s2                  yaw = κ (s1 − s2)
//! ```
//!
//! Roll and pitch come first: δ is clamped to what the pair can make. Each sum then has a range; the thrust is clamped
//! to the sum of both ranges, and yaw takes what is left. On a plus frame G is the arm length times identity.
//!
//! Invariants: every rotor thrust is within its own limits, to rounding; a demand that fits is refused exactly zero.
//! Source: docs/control-law.md, "Guidance, allocation, yaw guard".
use crate::airframe::Airframe;
use crate::frames::{Body, Vec3};
use crate::{ConfigError, Scalar};

/// Total thrust and body torques: asked for, achieved or refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand<S = f32> {
    /// Thrust along body −z, N.
    pub thrust_n: S,
    /// Torque about body x, N m.
    pub roll_nm: S,
    /// Torque about body y, N m.
    pub pitch_nm: S,
    /// Torque about body z, N m.
    pub yaw_nm: S,
}

impl<S: Scalar> Demand<S> {
    /// Asks for nothing.
    pub(crate) const NOTHING: Self = Self { thrust_n: S::ZERO, roll_nm: S::ZERO, pitch_nm: S::ZERO, yaw_nm: S::ZERO };

    /// The same demand with `torque_nm` more.
    pub(crate) fn with_torque(self, torque_nm: Vec3<Body, S>) -> Self {
        Self {
            thrust_n: self.thrust_n,
            roll_nm: self.roll_nm + torque_nm.x,
            pitch_nm: self.pitch_nm + torque_nm.y,
            yaw_nm: self.yaw_nm + torque_nm.z,
        }
    }

    /// The same demand in another number format.
    pub(crate) fn map<T>(&self, f: impl Fn(S) -> T) -> Demand<T> {
        Demand {
            thrust_n: f(self.thrust_n),
            roll_nm: f(self.roll_nm),
            pitch_nm: f(self.pitch_nm),
            yaw_nm: f(self.yaw_nm),
        }
    }
}

/// The thrust of each rotor, and what of the demand they do not meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allocation<S = f32> {
    /// Thrusts, N, in airframe order.
    pub thrust_n: [S; 4],
    /// Demand less what the thrusts achieve.
    pub refused: Demand<S>,
}

/// The split of one airframe.
#[derive(Clone, Debug)]
pub struct Allocator<S> {
    /// (roll, pitch) per (δ1, δ2), m, row-major.
    torque_per_difference: [[S; 2]; 2],
    /// The inverse, 1/m.
    difference_per_torque: [[S; 2]; 2],
    torque_per_thrust_m: S,
    thrust_per_torque_1_m: S,
    min_n: S,
    max_n: [S; 4],
}

impl<S: Scalar> Allocator<S> {
    /// The allocation of `airframe`; `saturates` is false for the paper's ideal rotors, which pull and push without limit.
    ///
    /// # Errors
    /// [`ConfigError`] if the rotors are not two facing pairs on crossing arms, or a limit makes no sense.
    pub fn try_new(airframe: &Airframe, saturates: bool) -> Result<Self, ConfigError> {
        airframe.check()?;
        let [right, front, ..] = airframe.rotors;
        let determinant = right.right_m * front.forward_m - right.forward_m * front.right_m;
        let s = S::from_f32;
        let limit = |n: f32| s(if saturates { n } else { UNLIMITED_N });
        Ok(Self {
            torque_per_difference: [[s(right.right_m), s(-front.right_m)], [s(-right.forward_m), s(front.forward_m)]],
            difference_per_torque: [
                [s(front.forward_m / determinant), s(front.right_m / determinant)],
                [s(right.forward_m / determinant), s(right.right_m / determinant)],
            ],
            torque_per_thrust_m: s(airframe.torque_per_thrust_m),
            thrust_per_torque_1_m: s(1.0 / airframe.torque_per_thrust_m),
            min_n: if saturates { s(airframe.thrust_n_min) } else { s(-UNLIMITED_N) },
            max_n: airframe.rotors.map(|rotor| limit(rotor.thrust_n_max)),
        })
    }

    /// Splits a demand over the rotors; on saturation yaw yields first, then thrust, roll and pitch last.
    ///
    /// - `demand`: N and N m, body FRD, finite.
    /// - Returns thrusts in N, each within its rotor's limits to a millionth of its largest, and the part of the demand they refuse.
    pub fn allocate(&self, demand: &Demand<S>) -> Allocation<S> {
        self.split(demand, self.max_n)
    }

    /// The same for rotors that make only `shares` of what they are commanded: the demand is split within what they can still
    /// make, and each is commanded so much more. A share below 0.15 is not commanded for; it is kept turning a
    /// little, so that it is felt when it works again.
    pub fn allocate_weakened(&self, demand: &Demand<S>, shares: &[S; 4]) -> Allocation<S> {
        let least = S::from_f32(SHARE_MIN);
        let max_n = core::array::from_fn(|j| S::select(shares[j].lt(least), S::ZERO, self.max_n[j] * shares[j]));
        let mut allocation = self.split(demand, max_n);
        for ((thrust_n, &share), &max_n) in allocation.thrust_n.iter_mut().zip(shares).zip(&self.max_n) {
            let floor = S::select(share.lt(S::from_f32(WEAK)), max_n * S::from_f32(PROBE), S::ZERO);
            *thrust_n = (*thrust_n / share.max(least)).max(floor);
        }
        allocation
    }

    /// The thrust of each rotor at `share` of its largest, N.
    pub(crate) fn alike(&self, share: S) -> [S; 4] {
        self.max_n.map(|max_n| share * max_n)
    }

    #[inline]
    fn split(&self, demand: &Demand<S>, max_n: [S; 4]) -> Allocation<S> {
        let [max1, max2, max3, max4] = max_n;
        let min = self.min_n;
        let [row1, row2] = self.difference_per_torque;
        let wanted1 = row1[0] * demand.roll_nm + row1[1] * demand.pitch_nm;
        let wanted2 = row2[0] * demand.roll_nm + row2[1] * demand.pitch_nm;
        let d1 = wanted1.clamp(min - max1, max3 - min);
        let d2 = wanted2.clamp(min - max4, max2 - min);

        let twice = |x: S| x + x;
        let (low1, high1) = (twice(min) + d1.abs(), (twice(max1) + d1).min(twice(max3) - d1));
        let (low2, high2) = (twice(min) + d2.abs(), (twice(max2) - d2).min(twice(max4) + d2));
        let total = demand.thrust_n.clamp(low1 + low2, high1 + high2);

        let half = S::from_f32(0.5);
        let wanted_sum1 = half * (total + demand.yaw_nm * self.thrust_per_torque_1_m);
        let sum1 = wanted_sum1.clamp(low1.max(total - high2), high1.min(total - low2));
        let sum2 = total - sum1;

        let (refused1, refused2) = (wanted1 - d1, wanted2 - d2);
        let [roll, pitch] = self.torque_per_difference;
        Allocation {
            thrust_n: [half * (sum1 - d1), half * (sum2 + d2), half * (sum1 + d1), half * (sum2 - d2)],
            refused: Demand {
                thrust_n: demand.thrust_n - total,
                roll_nm: roll[0] * refused1 + roll[1] * refused2,
                pitch_nm: pitch[0] * refused1 + pitch[1] * refused2,
                yaw_nm: twice(wanted_sum1 - sum1) * self.torque_per_thrust_m,
            },
        }
    }
}

/// Share of its thrust below which a rotor is not counted on: what little it is believed to make may be noise, and a rotor that is told to
/// make up for it pulls with all its might when it works again.
const SHARE_MIN: f32 = 0.15;
/// Share below which a rotor is always told to pull a little.
const WEAK: f32 = 0.3;
/// Command of a rotor that is not counted on, share of its maximum.
const PROBE: f32 = 0.08;

/// Stands in for "no limit" without leaving the range of Q16.16.
const UNLIMITED_N: f32 = 8000.0;
