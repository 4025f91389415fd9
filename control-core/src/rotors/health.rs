//! Which rotor lost thrust, how much, since when: one cumulative sum for each hypothesis.
//!
//! ```text
//! h_i = −Σ_{j in i} c_j η_j m_j                what a total loss of hypothesis i would put into the residual
//! S_i ← max(0, S_i + n dt (d h_i'C⁻¹x̃ − d²/2 h_i'C⁻¹h_i))       x̃ = x less its slow mean
//! S_i > S_max:  onset where S_i left zero;  loss = h_i'C⁻¹x̃ / (h_i'C⁻¹h_i ρ),   ρ = share of a step that passed the filter since
//! ```
//!
//! Nine hypotheses: each rotor alone, all alike (battery, air), and each rotor pulling more than it is told, which a stuck or a
//! runaway one does: there h_i has the other sign. S_i is a log-likelihood ratio: "i lost the share d" against "nothing
//! did", with n independent samples a second. C is diagonal: what the sensors' noise leaves in the residual, and ten times
//! what the weather does, since gusts last and so are not independent. The weather is measured: its variance is what x̃ has had of late
//! beyond the noise, and at least what the configuration says. A single sample counts for three standard deviations at most, so that
//! a fault is found before it passes for weather. At first it is taken for bad, and what was seen counts for a short time only.
//!
//! A rotor that pulls more than it is told is taken for stuck: its thrust is a number that is followed, whatever it is told, and it is told
//! a quarter of the weight, until it pulls just that. It must lead by a handicap: the facing rotor's loss looks much the same.
//!
//! Once a hypothesis is found its factor is followed by normalised least squares, quickly while it is far off, slowly after; it is
//! dropped when it has been whole for a while.
//!
//! Source: docs/control-law.md, "Watching the rotors"; E. S. Page, "Continuous inspection schemes", 1954.
use super::{Column, Residual, RotorsState};
use crate::airframe::Airframe;
use crate::config::{ConfigError, positive};
use crate::filter::LowPass;
use crate::{Mask, Scalar};

/// What the detector takes for ordinary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorConfig {
    /// Loss that is looked for, as a share of the thrust.
    pub loss: f32,
    /// S that is an alarm, nats.
    pub alarm_nats: f32,
    /// White noise of the gyro, a tick, rad/s.
    pub gyro_noise_rad_s: f32,
    /// White noise of the accelerometer, a tick, m/s².
    pub accelerometer_noise_m_s2: f32,
    /// Torque of the weather about each axis, root mean square, N m.
    pub torque_rms_nm: f32,
    /// Vertical force of the weather, root mean square, N.
    pub force_rms_n: f32,
}

impl DetectorConfig {
    /// The sensors and the weather of the shipped scenarios.
    pub const NOMINAL: Self = Self {
        loss: 0.3,
        alarm_nats: 7.0,
        gyro_noise_rad_s: 0.01,
        accelerometer_noise_m_s2: 0.2,
        torque_rms_nm: 0.01,
        force_rms_n: 0.15,
    };
}

impl<S: Scalar> Alarm<S> {
    /// The same in the format of logs.
    pub(super) fn to_f32(self) -> Alarm {
        Alarm {
            rotor: self.rotor,
            stuck: self.stuck,
            onset_age_s: self.onset_age_s.to_f32(),
            loss: self.loss.to_f32(),
            confidence: self.confidence.to_f32(),
        }
    }
}

/// A loss that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alarm<S = f32> {
    /// The rotor, 0 to 3; `None` if all lost alike.
    pub rotor: Option<usize>,
    /// Whether it pulls more than it is told.
    pub stuck: bool,
    /// How long before the alarm it began, s.
    pub onset_age_s: S,
    /// Share of the thrust that is lost now; of a stuck rotor, what a quarter of the weight exceeds its thrust by, as a share of it.
    pub loss: S,
    /// Probability that it is this one rather than the next likeliest, or none.
    pub confidence: S,
}

/// Loss of rotors 1 to 4, of all, and excess of rotors 1 to 4.
pub const HYPOTHESES: usize = 9;
/// The hypothesis that all lose alike.
const ALL: usize = 4;
/// The first hypothesis of a rotor that pulls too much.
const EXCESS: usize = 5;
/// Excess that is looked for, share of the thrust: less is left to the incremental loop, which needs no culprit.
const EXCESS_SOUGHT: f32 = 0.7;
/// What an excess must have beyond the alarm, nats.
const HANDICAP_NATS: f32 = 6.0;
/// Distance of a stuck rotor from what it is told at which it is called whole, share of a quarter of the weight.
const FOLLOWS: f32 = 0.12;
/// What the weather counts for beyond its variance.
const WEATHER: f32 = 10.0;
/// What one sample's square counts for at most, over the variance.
const OUTLIER: f32 = 9.0;
/// Variance that the weather has at first, over the least.
const WARY: f32 = 9.0;
/// Time over which the variance is taken at first, s; it grows with the flight up to [`MEAN_S`].
const WARY_S: f32 = 0.3;
/// Time over which the residual's mean and variance are taken, s.
const MEAN_S: f32 = 10.0;
/// Times in which a found factor is followed: while far off, and else, s.
const FOLLOW_S: (f32, f32) = (0.02, 0.25);
/// Error of a factor that is far off.
const FAR: f32 = 0.25;
/// How long after the alarm the factor is taken as it is seen, s.
const FRESH_S: f32 = 0.02;
/// How long a factor may be followed fast, s, and what of it comes back in a second: a model that is wrong for another reason, such as a
/// delay, must not swing.
const HASTE: (f32, f32) = (0.15, 0.05);
/// Loss below which a rotor is called whole, and for how long, s.
const WHOLE: (f32, f32) = (0.06, 1.0);
/// h'C⁻¹h below which a rotor pulls too little to be judged.
const FAINT: f32 = 0.5;
/// Largest thrust that a rotor is believed to be stuck at, over a quarter of the weight.
const STUCK_MAX: f32 = 8.0;
/// S beyond which nothing is added: it only says "certain".
const NATS_MAX: f32 = 100.0;

/// The detector, configured.
#[derive(Clone, Debug)]
pub(crate) struct Health<S> {
    /// Variance that the sensors' noise leaves in the residual.
    noise: [S; 3],
    /// Least variance of the weather in it.
    calm: [S; 3],
    /// n d and n d²/2 of a loss.
    loss_per_s: (S, S),
    /// The same of an excess.
    excess_per_s: (S, S),
    alarm_nats: S,
    mean_per_s: S,
    /// A quarter of the weight, N, and its inverse.
    quarter_n: S,
    quarter_inverse: S,
}

/// What is known of one hypothesis.
#[derive(Clone, Copy, Debug)]
struct Suspect<S> {
    nats: S,
    /// ρ.
    risen: S,
    /// Time since S left zero; after the alarm, as it was then, s.
    age_s: S,
    /// What is left: 1 less the loss. Of a stuck rotor: its thrust over a quarter of the weight.
    factor: S,
    /// Lead over the next likeliest at the alarm, nats.
    lead_nats: S,
    whole_s: S,
    /// How long what is seen is still taken as it is, s.
    fresh_s: S,
    /// How long it may still be followed fast, s.
    haste_s: S,
    found: bool,
}

/// What the detector remembers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HealthState<S> {
    suspects: [Suspect<S>; HYPOTHESES],
    mean: [S; 3],
    /// Variance of the weather in the residual.
    weather: [S; 3],
    /// Time over which that is taken, s; zero before the first sample.
    memory_s: S,
}

impl<S: Scalar> HealthState<S> {
    pub(super) fn new() -> Self {
        Self {
            suspects: [Suspect::innocent(); HYPOTHESES],
            mean: [S::ZERO; 3],
            weather: [S::ZERO; 3],
            memory_s: S::ZERO,
        }
    }

    /// Whether nothing is found, and nothing suspected.
    pub(super) fn is_calm(&self) -> bool {
        !self.suspects.iter().any(|suspect| suspect.found || S::ONE.lt(suspect.nats).all())
    }

    /// The worst loss that was found, if any.
    pub(crate) fn alarm(&self) -> Option<Alarm<S>> {
        let mut worst: Option<(usize, &Suspect<S>)> = None;
        for (i, suspect) in self.suspects.iter().enumerate() {
            let worse = |(j, w): (usize, &Suspect<S>)| i >= EXCESS || j < EXCESS && suspect.factor.lt(w.factor).all();
            if suspect.found && worst.is_none_or(worse) {
                worst = Some((i, suspect));
            }
        }
        let (i, suspect) = worst?;
        let half = S::from_f32(0.5);
        Some(Alarm {
            rotor: if i < ALL { Some(i) } else { i.checked_sub(EXCESS) },
            stuck: i >= EXCESS,
            onset_age_s: suspect.age_s,
            loss: S::ONE - suspect.factor,
            confidence: half + half * crate::math::tanh(half * suspect.lead_nats),
        })
    }

    /// S of each hypothesis, less its handicap.
    pub(super) fn nats(&self) -> [S; HYPOTHESES] {
        core::array::from_fn(|i| self.suspects[i].judged(i))
    }

    /// Which hypotheses are found.
    pub(super) fn found(&self) -> [bool; HYPOTHESES] {
        self.suspects.map(|suspect| suspect.found)
    }

    /// Standard error of the share of rotor `j`: large just after the onset.
    pub(crate) fn uncertainty(&self, j: usize) -> S {
        S::from_f32(0.08) / self.suspects[j].risen.max(S::from_f32(0.1))
    }

    /// Whether rotor `j` is stuck.
    pub(super) fn is_stuck(&self, j: usize) -> bool {
        self.suspects[EXCESS + j].found
    }

    /// Whether any rotor is stuck.
    pub(super) fn has_stuck(&self) -> bool {
        (0..4).any(|j| self.is_stuck(j))
    }
}

impl<S: Scalar> Health<S> {
    pub(super) fn try_new(
        config: &DetectorConfig,
        airframe: &Airframe,
        filter_hz: f32,
        control_hz: f32,
    ) -> Result<Self, ConfigError> {
        let DetectorConfig { loss, alarm_nats, gyro_noise_rad_s, accelerometer_noise_m_s2, torque_rms_nm, force_rms_n } =
            *config;
        for (field, value) in [
            ("loss", loss),
            ("alarm_nats", alarm_nats),
            ("gyro_noise_rad_s", gyro_noise_rad_s),
            ("accelerometer_noise_m_s2", accelerometer_noise_m_s2),
            ("torque_rms_nm", torque_rms_nm),
            ("force_rms_n", force_rms_n),
        ] {
            positive("detector", field, value)?;
        }
        let square = |x: f32| x * x;
        let corner = core::f32::consts::TAU * filter_hz;
        let slope = corner / (1.0 + corner / control_hz);
        // Share of white noise's variance that the low-pass keeps.
        let kept = slope / (2.0 * control_hz - slope);
        let turning = square(slope * gyro_noise_rad_s) * (1.0 + kept);
        let falling = square(accelerometer_noise_m_s2) * kept;
        let [ix, iy, _] = airframe.inertia_kg_m2;
        let independent_per_s = corner / 2.0;
        let s = S::from_f32;
        let rates = |d: f32| (s(independent_per_s * d), s(independent_per_s * d * d / 2.0));
        Ok(Self {
            noise: [turning, turning, falling].map(s),
            calm: [torque_rms_nm / ix, torque_rms_nm / iy, force_rms_n / airframe.mass_kg].map(|x| s(square(x))),
            loss_per_s: rates(loss),
            excess_per_s: rates(EXCESS_SOUGHT),
            alarm_nats: s(alarm_nats),
            mean_per_s: s(1.0 / MEAN_S),
            quarter_n: s(airframe.weight_n() / 4.0),
            quarter_inverse: s(4.0 / airframe.weight_n()),
        })
    }

    /// One sample: judges the residual, and takes out of it what is found.
    pub(super) fn step(
        &self,
        state: &mut RotorsState<S>,
        columns: &[Column<S>; 4],
        residual: &mut Residual<S>,
        filter: &LowPass<S>,
        dt_s: S,
    ) {
        let HealthState { suspects, mean, weather, memory_s } = &mut state.health;
        let all = suspects[ALL].factor;
        let quiet = !suspects.iter().any(|suspect| suspect.found);
        let mut effects = [[S::ZERO; 3]; HYPOTHESES];
        for j in 0..4 {
            let Column(column) = columns[j];
            let felt_n = -state.felt_n[j];
            let (alone_n, shared_n) = (felt_n * all, felt_n * suspects[j].factor);
            // A stuck rotor loses nothing; more of its thrust is so much of a quarter of the weight.
            let stuck = suspects[EXCESS + j].found;
            for axis in 0..3 {
                effects[j][axis] = if stuck { S::ZERO } else { column[axis] * alone_n };
                effects[ALL][axis] = effects[ALL][axis] + column[axis] * shared_n;
                if !quiet {
                    effects[EXCESS + j][axis] = if stuck { column[axis] * self.quarter_n } else { -effects[j][axis] };
                }
            }
        }
        let Residual(x) = residual;
        let mut beside: [S; 3] = core::array::from_fn(|axis| x[axis] - mean[axis]);
        if !S::ZERO.lt(*memory_s).all() {
            *weather = self.calm.map(|calm| calm * S::from_f32(WARY));
            *memory_s = S::from_f32(WARY_S);
        }
        *memory_s = (*memory_s + dt_s).min(S::from_f32(MEAN_S));
        let keep = dt_s / *memory_s;
        let mut weights = [S::ZERO; 3];
        for axis in 0..3 {
            if quiet {
                let all = self.noise[axis] + weather[axis];
                let change = (beside[axis] * beside[axis]).min(all * S::from_f32(OUTLIER)) - all;
                weather[axis] = (weather[axis] + keep * change).max(self.calm[axis]);
            }
            weights[axis] = S::ONE / (self.noise[axis] + weather[axis] * S::from_f32(WEATHER));
        }
        let lossy: [bool; 4] = core::array::from_fn(|j| suspects[j].found || suspects[ALL].found);
        let mut likeliest = (S::ZERO, S::ZERO, HYPOTHESES);
        let mut fits = [(S::ZERO, S::ZERO); HYPOTHESES];
        for (i, (suspect, effect)) in suspects.iter_mut().zip(&effects).enumerate() {
            let (seen, size) = if quiet && i >= EXCESS {
                // The loss, the other way round.
                let (seen, size) = fits[i - EXCESS];
                (-seen, size)
            } else {
                fit(effect, &weights, &beside)
            };
            fits[i] = (seen, size);
            if suspect.found {
                let explained = if i < EXCESS {
                    suspect.follow(seen, size, filter, dt_s)
                } else {
                    let told = state.made_n[i - EXCESS] * self.quarter_inverse;
                    suspect.follow_stuck(seen, size, told, filter, dt_s)
                };
                for axis in 0..3 {
                    x[axis] = x[axis] - explained * effect[axis];
                    beside[axis] = x[axis] - mean[axis];
                }
                continue;
            }
            // What comes back from a loss is no excess.
            let (gain, drift) = if i < EXCESS { self.loss_per_s } else { self.excess_per_s };
            let known = i >= EXCESS && lossy[i - EXCESS];
            let slope = if known { -size } else { gain * seen - drift * size };
            suspect.nats = (suspect.nats + slope * dt_s).clamp(S::ZERO, S::from_f32(NATS_MAX));
            let rising = S::ZERO.lt(suspect.nats);
            if (!rising).all() {
                (suspect.risen, suspect.age_s) = (S::ZERO, S::ZERO);
                continue;
            }
            filter.step(&mut suspect.risen, S::ONE);
            suspect.risen = S::select(rising, suspect.risen, S::ZERO);
            suspect.age_s = S::select(rising, suspect.age_s + dt_s, S::ZERO);
            let nats = suspect.judged(i);
            if likeliest.0.lt(nats).all() {
                likeliest = (nats, likeliest.0, i);
            } else {
                likeliest.1 = likeliest.1.max(nats);
            }
        }
        let (nats, next, i) = likeliest;
        if self.alarm_nats.lt(nats).all() {
            for suspect in suspects.iter_mut().filter(|suspect| !suspect.found) {
                suspect.nats = S::ZERO;
            }
            suspects[i].found = true;
            suspects[i].lead_nats = nats - next;
            if let Some(j) = i.checked_sub(EXCESS) {
                // From here on its thrust is a number: what it was believed to be.
                suspects[i].factor = state.felt_n[j] * all * suspects[j].factor * self.quarter_inverse;
                suspects[j] = Suspect::innocent();
            }
        } else if quiet {
            let keep = self.mean_per_s * dt_s;
            for axis in 0..3 {
                mean[axis] = mean[axis] + keep * beside[axis];
            }
        }
        // What was explained away was so since the onset.
        state.predicted = [state.slope_rad_s2[0] - x[0], state.slope_rad_s2[1] - x[1]];
        state.force = x[2];
        let all = suspects[ALL].factor;
        for j in 0..4 {
            let excess = &suspects[EXCESS + j];
            let (share, stuck_n) = if excess.found {
                (S::ZERO, excess.factor * self.quarter_n)
            } else {
                (all * suspects[j].factor, S::ZERO)
            };
            state.shares[j] = state.told[j].unwrap_or(share);
            state.stuck_n[j] = stuck_n;
        }
    }
}

/// h'C⁻¹x̃ and h'C⁻¹h.
#[inline(always)]
fn fit<S: Scalar>(effect: &[S; 3], weights: &[S; 3], beside: &[S; 3]) -> (S, S) {
    let [hr, hp, hz] = *effect;
    let (hr_w, hp_w, hz_w) = (hr * weights[0], hp * weights[1], hz * weights[2]);
    (hr_w * beside[0] + hp_w * beside[1] + hz_w * beside[2], hr_w * hr + hp_w * hp + hz_w * hz)
}

impl<S: Scalar> Suspect<S> {
    /// S of hypothesis `i` as it is compared.
    fn judged(&self, i: usize) -> S {
        if i < EXCESS { self.nats } else { self.nats - S::from_f32(HANDICAP_NATS) }
    }

    /// Follows the factor; returns what of the effect of a total loss this explains.
    fn follow(&mut self, seen: S, size: S, filter: &LowPass<S>, dt_s: S) -> S {
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
    fn follow_stuck(&mut self, seen: S, size: S, told: S, filter: &LowPass<S>, dt_s: S) -> S {
        let s = S::from_f32;
        let error = seen / (size * self.risen);
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

    /// Drops the suspicion when it has been whole for long enough.
    fn acquit(&mut self, whole: S::Mask, dt_s: S) {
        self.whole_s = S::select(whole, self.whole_s + dt_s, S::ZERO);
        if S::from_f32(WHOLE.1).lt(self.whole_s).all() {
            *self = Self::innocent();
        }
    }

    fn innocent() -> Self {
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
