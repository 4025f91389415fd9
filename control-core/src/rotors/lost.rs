//! Whether to fly without a rotor, and which: what the shares are worth for holding a heading.
//!
//! A rotor is done without if it surely makes less than [`LOST`] of what a heading needs, or if it makes less than that and the body
//! turns. Where one is stuck with much thrust, it is the facing one that cannot push as it should. It is taken back when all make
//! [`HEALED`] times what a heading needs: then the body is braked, and heading returns when it hardly turns.
//!
//! Source: docs/control-law.md, "One rotor gone".
use super::{Rotors, RotorsState};
use crate::spin::Spinning;
use crate::{Mask, Scalar};

/// Share of what a heading needs below which a rotor is done without.
const LOST: f32 = 0.7;
/// Share below which the rotor that faces a lost one is done without too, and above which it is used again.
const PAIR: (f32, f32) = (0.25, 0.4);
/// Share of what a heading needs above which a rotor is taken back.
const HEALED: f32 = 1.1;
/// Share of its maximum at which a stuck rotor leaves the facing one no room.
const OVERBEARING: f32 = 0.8;
/// Standard errors that make an estimate sure.
const SURE: f32 = 2.0;
/// Yaw rate at which a machine that cannot hold its heading is better off spinning, and at which it has stopped, rad/s.
const TURNING_RAD_S: (f32, f32) = (8.0, 2.0);

impl<S: Scalar> Rotors<S> {
    /// Whether to spin in the next tick, and without which rotor.
    pub(super) fn next_spinning(&self, state: &RotorsState<S>) -> Option<Spinning<S>> {
        let s = S::from_f32;
        let turns = state.yaw_rad_s.abs();
        let mut weakest = 0;
        for rotor in 1..4 {
            if state.shares[rotor].lt(state.shares[weakest]).all() {
                weakest = rotor;
            }
        }
        let share = state.shares[weakest];
        if let Some(spinning) = state.spinning {
            let healed = (s(HEALED) * self.hover_share).lt(share);
            let done = healed & turns.lt(s(TURNING_RAD_S.1));
            return (!done).all().then_some(Spinning { healed: healed.all(), ..spinning.beside(state) });
        }
        let turning = share.lt(self.hover_share) & s(TURNING_RAD_S.0).lt(turns);
        let stuck_n = state.stuck_n[weakest];
        let (lost, rotor) = if state.health.is_stuck(weakest) {
            let facing = (weakest + 2) % 4;
            let rotor = if self.quarter_n.lt(stuck_n).all() { facing } else { weakest };
            ((s(OVERBEARING) * self.thrust_n_max).lt(stuck_n), rotor)
        } else {
            let doubt = if state.told[weakest].is_some() { S::ZERO } else { state.health.uncertainty(weakest) };
            ((share + s(SURE) * doubt).lt(s(LOST) * self.hover_share), weakest)
        };
        (lost | turning).all().then(|| Spinning::without(rotor).beside(state))
    }
}

impl<S: Scalar> Spinning<S> {
    /// Does without the facing rotor too, or with it.
    fn beside(self, state: &RotorsState<S>) -> Self {
        let facing = (self.rotor + 2) % 4;
        let least = if self.pair { PAIR.1 } else { PAIR.0 };
        let pair = !state.health.is_stuck(facing) && state.shares[facing].lt(S::from_f32(least)).all();
        Self { pair, ..self }
    }
}
