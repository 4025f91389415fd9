//! One hypothesis about the rotors: how much speaks for it, and how large it is.
//!
//! While it is only suspected it collects evidence. Once found, its factor is taken as it is seen for an instant, then followed by normalised
//! least squares: quickly while it is far off, as long as there is haste left, slowly after. It is dropped when it has been whole for a while.
use crate::filter::LowPass;
use crate::{Mask, Scalar};

/// Distance of a stuck rotor from what it is told at which it is called whole, share of a quarter of the weight.
const FOLLOWS: f32 = 0.12;
/// Times in which a found factor is followed: while far off, and else, s.
const FOLLOW_S: (f32, f32) = (0.02, 0.25);
/// Error of a factor that is far off.
const FAR: f32 = 0.25;
/// Standard error of a factor as it is seen in one sample, and as it is followed.
const SEEN_ERROR: f32 = 0.08;
const FOLLOWED_ERROR: f32 = 0.03;
/// How long after the alarm the factor is taken as it is seen, s.
const FRESH_S: f32 = 0.02;
/// How long a factor may be followed fast, s, and what of it comes back in a second: a model that is wrong for another reason, such as a
/// delay, must not swing.
const HASTE: (f32, f32) = (0.15, 0.05);
/// Loss below which a rotor is called whole, and for how long, s.
const WHOLE: (f32, f32) = (0.06, 1.0);
/// h'C⁻¹h below which a rotor pulls too little to be judged.
const FAINT: f32 = 0.5;
/// Least h'C⁻¹h that divides.
const SIZE_MIN: f32 = 1e-3;
/// Largest thrust that a rotor is believed to be stuck at, over a quarter of the weight.
const STUCK_MAX: f32 = 8.0;

/// What a residual says of one hypothesis: h'C⁻¹x̃ and h'C⁻¹h.
#[derive(Clone, Copy)]
pub(super) struct Evidence<S> {
    pub(super) seen: S,
    pub(super) size: S,
}

/// What is known of one hypothesis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suspect<S> {
    pub(super) nats: S,
    /// Time since S left zero; after the alarm, as it was then, s.
    pub(super) age_s: S,
    /// ρ, since the alarm.
    pub(super) risen: S,
    /// What is left: 1 less the loss. Of a stuck rotor: its thrust over a quarter of the weight.
    pub(super) factor: S,
    /// Lead over the next likeliest at the alarm, nats.
    pub(super) lead_nats: S,
    whole_s: S,
    /// How long what is seen is still taken as it is, s.
    fresh_s: S,
    /// How long it may still be followed fast, s.
    haste_s: S,
    pub(super) found: bool,
}

impl<S: Scalar> Suspect<S> {
    /// Adds the evidence of one tick, by its rates a tick, unless it is found; returns whether S is beyond `limit`.
    #[inline(always)]
    pub(super) fn judge(&mut self, evidence: &Evidence<S>, (gain, drift): (S, S), limit: S, dt_s: S) -> S::Mask {
        if self.found {
            return S::Mask::splat(false);
        }
        self.nats = (self.nats + (gain * evidence.seen - drift * evidence.size)).max(S::ZERO);
        self.age_s = S::select(S::ZERO.lt(self.nats), self.age_s + dt_s, S::ZERO);
        limit.lt(self.nats)
    }

    /// S as it is compared.
    pub(super) fn judged(&self, handicap_nats: f32) -> S {
        self.nats - S::from_f32(handicap_nats)
    }

    /// Follows the factor; returns what of the effect of a total loss this explains.
    pub(super) fn follow(&mut self, &Evidence { seen, size }: &Evidence<S>, filter: &LowPass<S>, dt_s: S) -> S {
        let s = S::from_f32;
        let error = seen / ((size + s(FAINT)) * self.risen);
        let before = self.factor;
        self.factor = (before - self.stride(error, dt_s)).clamp(S::ZERO, S::ONE);
        let change = (before - self.factor) * self.risen;
        filter.step(&mut self.risen, S::ONE);
        self.acquit(s(1.0 - WHOLE.0).lt(self.factor), dt_s);
        change
    }

    /// Follows the thrust of a stuck rotor that is told `told`, both over a quarter of the weight; returns how much more it explains.
    pub(super) fn follow_stuck(
        &mut self,
        &Evidence { seen, size }: &Evidence<S>,
        told: S,
        filter: &LowPass<S>,
        dt_s: S,
    ) -> S {
        let s = S::from_f32;
        // Where all are believed to make nothing there is nothing to divide by.
        let error = seen / (size * self.risen).max(s(SIZE_MIN));
        let before = self.factor;
        self.factor = (before + self.stride(error, dt_s)).clamp(S::ZERO, s(STUCK_MAX));
        let change = (self.factor - before) * self.risen;
        filter.step(&mut self.risen, S::ONE);
        self.acquit((self.factor - told).abs().lt(s(FOLLOWS)), dt_s);
        change
    }

    /// How far to go when `error` away: all of it just after the onset, fast while far off and there is haste left, else slowly.
    fn stride(&mut self, error: S, dt_s: S) -> S {
        let s = S::from_f32;
        let fresh = self.risen.lt(s(0.95)) | S::ZERO.lt(self.fresh_s);
        self.fresh_s = (self.fresh_s - dt_s).max(S::ZERO);
        let hurry = s(FAR).lt(error.abs()) & S::ZERO.lt(self.haste_s);
        let spent = S::select(hurry, dt_s, -(dt_s * s(HASTE.1)));
        self.haste_s = (self.haste_s - spent).min(s(HASTE.0));
        let time_s = S::select(hurry, s(FOLLOW_S.0), s(FOLLOW_S.1));
        S::select(fresh, error, error * (dt_s / time_s).min(S::ONE))
    }

    /// Standard error of the factor: of one sample just after the onset, of many later.
    pub(super) fn uncertainty(&self) -> S {
        let s = S::from_f32;
        let fresh = S::ZERO.lt(self.fresh_s);
        S::select(fresh, s(SEEN_ERROR) / self.risen.max(s(0.1)), s(FOLLOWED_ERROR))
    }

    /// Whether it is found to have lost more than half.
    pub(super) fn is_far_gone(&self) -> bool {
        self.found && self.factor.lt(S::from_f32(0.5)).all()
    }

    /// Drops the suspicion when it has been whole for long enough.
    fn acquit(&mut self, whole: S::Mask, dt_s: S) {
        self.whole_s = S::select(whole, self.whole_s + dt_s, S::ZERO);
        if S::from_f32(WHOLE.1).lt(self.whole_s).all() {
            *self = Self::innocent();
        }
    }

    /// Found: what began `age_s` ago, `risen` of which has passed the filter.
    pub(super) fn caught(age_s: S, risen: S, lead_nats: S) -> Self {
        Self { found: true, age_s, risen, lead_nats, ..Self::innocent() }
    }

    /// One that was found before the program was stopped: followed slowly from where it was.
    pub(super) fn known(factor: S) -> Self {
        Self { found: true, risen: S::ONE, factor, fresh_s: S::ZERO, ..Self::innocent() }
    }

    pub(super) fn innocent() -> Self {
        Self {
            nats: S::ZERO,
            risen: S::ZERO,
            age_s: S::ZERO,
            factor: S::ONE,
            lead_nats: S::ZERO,
            whole_s: S::ZERO,
            fresh_s: S::from_f32(FRESH_S),
            haste_s: S::from_f32(HASTE.0),
            found: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f32 = 0.002;

    /// Follows a rotor that makes `share` for `seconds`, seen without noise.
    fn follow(suspect: &mut Suspect<f32>, share: f32, seconds: f32) {
        let filter = LowPass::new(94.0, DT_S);
        for _ in 0..(seconds / DT_S) as usize {
            if suspect.found {
                let seen = 50.0 * (suspect.factor - share);
                suspect.follow(&Evidence { seen, size: 50.0 }, &filter, DT_S);
            }
        }
    }

    #[test]
    fn evidence_adds_up_to_an_alarm_and_forgets_what_speaks_against_it() {
        let mut suspect = Suspect::<f32>::innocent();
        let judge =
            |suspect: &mut Suspect<f32>, seen| suspect.judge(&Evidence { seen, size: 50.0 }, (0.03, 0.0045), 7.0, DT_S);
        assert!((0..100).all(|_| !judge(&mut suspect, 5.0)), "half of what is sought pulls S down: {suspect:?}");
        assert_eq!((suspect.nats, suspect.age_s), (0.0, 0.0));
        let ticks = (1..100).find(|_| judge(&mut suspect, 50.0));
        assert_eq!(ticks, Some(6), "1.275 nats a tick");
        assert!((suspect.age_s - 6.0 * DT_S).abs() < 1e-6);
    }

    #[test]
    fn a_loss_is_taken_as_it_is_seen_followed_and_dropped_when_it_has_gone() {
        let mut suspect = Suspect::caught(0.01, 0.6, 5.0);
        follow(&mut suspect, 0.6, 0.1);
        assert!(suspect.found && (suspect.factor - 0.6).abs() < 0.02, "{suspect:?}");
        follow(&mut suspect, 1.0, 0.2);
        assert!(suspect.factor > 0.85, "far off is followed fast: {suspect:?}");
        follow(&mut suspect, 1.0, 2.0);
        assert!(!suspect.found && suspect.factor == 1.0, "{suspect:?}");
    }

    #[test]
    fn haste_runs_out_so_that_a_wrong_model_does_not_swing() {
        let mut suspect = Suspect::caught(0.1, 1.0, 5.0);
        for _ in 0..20 {
            follow(&mut suspect, 0.2, 0.05);
            follow(&mut suspect, 0.8, 0.05);
        }
        let before = suspect.factor;
        follow(&mut suspect, 0.2, 0.05);
        assert!((before - suspect.factor).abs() < 0.25, "{before} {suspect:?}");
    }

    #[test]
    fn a_stuck_rotor_is_believed_again_when_it_does_what_it_is_told() {
        let filter = LowPass::new(94.0, DT_S);
        let mut suspect = Suspect::caught(0.02, 0.8, 5.0);
        let mut run = |thrust: f32| {
            for _ in 0..1000 {
                if suspect.found {
                    let seen = 50.0 * (thrust - suspect.factor);
                    suspect.follow_stuck(&Evidence { seen, size: 50.0 }, 1.0, &filter, DT_S);
                }
            }
            suspect
        };
        let stuck = run(1.8);
        assert!(stuck.found && (stuck.factor - 1.8).abs() < 0.01, "{stuck:?}");
        assert!(!run(1.0).found);
    }

    #[test]
    fn without_evidence_a_stuck_rotor_stays_what_it_was() {
        let mut suspect = Suspect::<f32>::caught(0.02, 0.8, 5.0);
        let filter = LowPass::new(94.0, DT_S);
        assert_eq!(suspect.follow_stuck(&Evidence { seen: 0.0, size: 0.0 }, 3.0, &filter, DT_S), 0.0);
        assert_eq!(suspect.factor, 1.0);
    }
}
