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
//! did", with n independent samples a second. C is diagonal and in `weather.rs`; what becomes of a hypothesis is in `suspect.rs`.
//!
//! A rotor that pulls more than it is told is taken for stuck: its thrust is a number that is followed, whatever it is told, and it is told
//! a quarter of the weight, until it pulls just that. It must lead by a handicap: the facing rotor's loss looks much the same.
//!
//! Source: docs/control-law.md, "Watching the rotors"; E. S. Page, "Continuous inspection schemes", 1954.
use super::alarm::{Alarm, DetectorConfig};
use super::pair::{Pairs, Trial, Verdict};
use super::suspect::{Evidence, Suspect};
use super::weather::{Climate, Weather};
use super::{Column, Residual, RotorsState};
use crate::airframe::Airframe;
use crate::config::{ConfigError, positive};
use crate::filter::LowPass;
use crate::math::tanh;
use crate::restart::Tape;
use crate::{Mask, Scalar};
use core::ops::Range;

/// Loss of rotors 1 to 4, of all, and excess of rotors 1 to 4.
pub const HYPOTHESES: usize = 9;
/// The hypothesis that all lose alike.
const ALL: usize = 4;
/// The first hypothesis of a rotor that pulls too much.
const EXCESS: usize = 5;
/// Excess that is looked for, share of the thrust: less is left to the incremental loop, which needs no culprit.
const EXCESS_SOUGHT: f32 = 0.7;
/// Least thrust that a stuck rotor's command is taken to have asked for, N: it divides.
const FELT_N_MIN: f32 = 1e-3;
/// What a hypothesis must have beyond the alarm, nats: gusts along the thrust look like a loss of all, the facing rotor's loss like an excess.
const HANDICAPS_NATS: [f32; HYPOTHESES] = [0.0, 0.0, 0.0, 0.0, 5.0, 6.0, 6.0, 6.0, 6.0];

/// The detector, configured.
#[derive(Clone, Debug)]
pub(crate) struct Health<S> {
    climate: Climate<S>,
    /// c_j of each rotor, and the squares of its parts.
    columns: [([S; 3], [S; 3]); 4],
    /// The same of a newton spread over all: along z only.
    spread: S,
    /// Corner of the residual's filter, rad/s.
    filter_rad_s: S,
    /// n d and n d²/2 of a loss.
    loss_per_s: (S, S),
    /// The same of an excess.
    excess_per_s: (S, S),
    alarm_nats: S,
    pairs: Pairs<S>,
    /// A quarter of the weight, N, and its inverse.
    quarter_n: S,
    quarter_inverse: S,
}

/// What the detector remembers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HealthState<S> {
    suspects: [Suspect<S>; HYPOTHESES],
    /// How many of them are found, and which was followed last.
    found: usize,
    turn: usize,
    /// Whether a loss of all is one of a pair: open until it is known.
    trial: Option<Trial<S>>,
    weather: Weather<S>,
    /// c_j'C⁻¹c_j of each rotor.
    sharpness: [S; 4],
}

impl<S: Scalar> HealthState<S> {
    pub(super) fn new(health: Option<&Health<S>>) -> Self {
        let weather = Weather::unknown(health.map(|health| &health.climate));
        let sharpness = health.map_or([S::ZERO; 4], |health| health.sharpness(&weather));
        Self { suspects: [Suspect::innocent(); HYPOTHESES], found: 0, turn: 0, trial: None, weather, sharpness }
    }

    /// Whether nothing is found, and nothing suspected.
    pub(super) fn is_calm(&self) -> bool {
        self.found == 0 && !self.suspects.iter().any(|suspect| S::ONE.lt(suspect.nats).all())
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
            confidence: half + half * tanh(half * suspect.lead_nats),
        })
    }

    /// S of each hypothesis, less its handicap.
    pub(super) fn nats(&self) -> [S; HYPOTHESES] {
        core::array::from_fn(|i| self.suspects[i].judged(HANDICAPS_NATS[i]))
    }

    /// Which hypotheses are found.
    pub(super) fn found(&self) -> [bool; HYPOTHESES] {
        self.suspects.map(|suspect| suspect.found)
    }

    /// Standard error of the share of rotor `j`: large just after the onset.
    pub(crate) fn uncertainty(&self, j: usize) -> S {
        self.suspects[j].uncertainty()
    }

    /// Whether rotor `j` is stuck.
    pub(super) fn is_stuck(&self, j: usize) -> bool {
        self.suspects[EXCESS + j].found
    }

    /// Whether any rotor is stuck.
    pub(super) fn has_stuck(&self) -> bool {
        self.found > 0 && (0..4).any(|j| self.is_stuck(j))
    }

    /// Share of its thrust that rotor `j` is believed to make; none of a stuck one follows its command.
    pub(super) fn share(&self, j: usize) -> S {
        if self.is_stuck(j) { S::ZERO } else { self.suspects[ALL].factor * self.suspects[j].factor }
    }
}

impl HealthState<f32> {
    /// What was found.
    pub(super) fn pass(&mut self, tape: &mut Tape) {
        let mut found = self.suspects.map(|suspect| suspect.found);
        tape.bits(found.each_mut());
        for (suspect, found) in self.suspects.iter_mut().zip(found) {
            let mut factor = suspect.factor;
            tape.float(&mut factor);
            if found && !suspect.found {
                *suspect = Suspect::known(factor);
            }
        }
        self.found = self.suspects.iter().filter(|suspect| suspect.found).count();
    }
}

impl<S: Scalar> Health<S> {
    pub(super) fn try_new(
        config: &DetectorConfig,
        airframe: &Airframe,
        columns: &[[f32; 3]; 4],
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
        let calm = [torque_rms_nm / ix, torque_rms_nm / iy, force_rms_n / airframe.mass_kg].map(square);
        let independent_per_s = corner / 2.0;
        let s = S::from_f32;
        let rates = |d: f32| (s(independent_per_s * d), s(independent_per_s * d * d / 2.0));
        Ok(Self {
            climate: Climate::new([turning, turning, falling], calm),
            columns: columns.map(|column| (column.map(s), column.map(|x| s(square(x))))),
            spread: s(square(1.0 / airframe.mass_kg)),
            filter_rad_s: s(corner),
            loss_per_s: rates(loss),
            excess_per_s: rates(EXCESS_SOUGHT),
            alarm_nats: s(alarm_nats),
            pairs: Pairs::new(airframe),
            quarter_n: s(airframe.weight_n() / 4.0),
            quarter_inverse: s(4.0 / airframe.weight_n()),
        })
    }

    /// One sample: judges the residual, and takes out of it what is found.
    pub(super) fn step(
        &self,
        state: &mut RotorsState<S>,
        columns: &[Column<S>; 4],
        mut residual: Residual<S>,
        dt_s: S,
    ) {
        let per_newton = self.per_newton(state, &residual);
        let calm = state.health.found == 0;
        let pair = state.health.trial.is_some() && self.try_pairs(state, dt_s)
            || state.spinning.is_some_and(|spinning| spinning.pair);
        // Of two rotors none can be spared: whatever else is felt, it is weather.
        let alarmed = !pair && self.judge(state, &residual, &per_newton, dt_s);
        if alarmed {
            self.accuse(state);
        } else if !calm {
            self.follow(state, columns, &mut residual, &per_newton, dt_s);
        }
        if alarmed || !calm {
            self.settle(state);
        }
        if calm {
            state.health.weather.learn(&self.climate, &residual.0, dt_s);
            state.health.sharpness = self.sharpness(&state.health.weather);
        }
    }

    /// Weighs what the residual says of every hypothesis that is not found; returns whether one is.
    fn judge(&self, state: &mut RotorsState<S>, residual: &Residual<S>, per_newton: &[S; 4], dt_s: S) -> bool {
        let all = self.of_all(state, per_newton);
        let losses: [Evidence<S>; 4] = core::array::from_fn(|j| of_one(state, per_newton, j));
        let HealthState { suspects, found, weather, .. } = &mut state.health;
        let scaled = |(gain, drift): (S, S)| (gain * dt_s, drift * dt_s);
        let (loss, excess) = (scaled(self.loss_per_s), scaled(self.excess_per_s));
        let limit = self.alarm_nats;
        let [_, _, sunk] = weather.beside(&residual.0);
        let lifted = sunk.lt(S::ZERO).all();
        let without = state.spinning.map(|spinning| spinning.rotor);
        let mut alarmed = suspects[ALL].judge(&all, loss, limit + S::from_f32(HANDICAPS_NATS[ALL]), dt_s);
        for (j, Evidence { seen, size }) in (0..4).zip(losses) {
            // Where one has lost much, what comes and goes of it looks like a fault of the facing one, but for the lift.
            let facing = (j + 2) % 4;
            let spared = *found > 0 && (suspects[facing].is_far_gone() || suspects[EXCESS + facing].found)
                || without == Some(facing);
            if !spared {
                alarmed = alarmed | suspects[j].judge(&Evidence { seen, size }, loss, limit, dt_s);
            } else if !lifted {
                continue;
            }
            // What comes back from a loss is no excess.
            if *found == 0 || !(suspects[j].found || suspects[ALL].found) {
                let limit = limit + S::from_f32(HANDICAPS_NATS[EXCESS]);
                alarmed = alarmed | suspects[EXCESS + j].judge(&Evidence { seen: -seen, size }, excess, limit, dt_s);
            }
        }
        alarmed.all()
    }

    /// c_j'C⁻¹c_j.
    fn sharpness(&self, weather: &Weather<S>) -> [S; 4] {
        let [wx, wy, wz] = weather.weights;
        self.columns.map(|(_, squares)| squares[0] * wx + squares[1] * wy + squares[2] * wz)
    }

    /// c_j'C⁻¹x̃.
    fn per_newton(&self, state: &RotorsState<S>, residual: &Residual<S>) -> [S; 4] {
        let [x, y, z] = state.health.weather.weighted(&residual.0);
        self.columns.map(|(c, _)| c[0] * x + c[1] * y + c[2] * z)
    }

    /// What speaks for a loss of all. Its size is taken as if they pulled alike: in a hover they do.
    fn of_all(&self, state: &RotorsState<S>, per_newton: &[S; 4]) -> Evidence<S> {
        let HealthState { suspects, weather, .. } = &state.health;
        let (mut seen_n, mut total_n) = (S::ZERO, S::ZERO);
        for (j, &per_newton) in per_newton.iter().enumerate() {
            let shared_n = state.felt_n[j] * suspects[j].factor;
            seen_n = seen_n + shared_n * per_newton;
            total_n = total_n + shared_n;
        }
        Evidence { seen: -seen_n, size: total_n * total_n * self.spread * weather.weights[2] }
    }

    /// Finds the likeliest, and clears the others for now.
    #[cold]
    fn accuse(&self, state: &mut RotorsState<S>) {
        let HealthState { suspects, found, .. } = &mut state.health;
        let (mut likeliest, mut nats, mut next) = (0, S::ZERO, S::ZERO);
        // What is found has no nats.
        for ((i, suspect), handicap_nats) in (0..HYPOTHESES).zip(suspects.iter_mut()).zip(HANDICAPS_NATS) {
            let judged = suspect.judged(handicap_nats);
            if nats.lt(judged).all() {
                (likeliest, nats, next) = (i, judged, nats);
            } else {
                next = next.max(judged);
            }
            suspect.nats = S::ZERO;
        }
        // 1 − exp(−ω t), by way of the tangent that is at hand.
        // The bound is said where the compiler sees it: no index panics in flight.
        let likeliest = likeliest % HYPOTHESES;
        let accused = &mut suspects[likeliest];
        let half = tanh(S::from_f32(0.5) * self.filter_rad_s * accused.age_s);
        let risen = (half + half) / (S::ONE + half);
        *accused = Suspect::caught(accused.age_s, risen, nats - next);
        *found += 1;
        if likeliest == ALL {
            state.health.trial = Some(Pairs::open(state.yaw_rad_s));
        } else if let Some(j) = likeliest.checked_sub(EXCESS) {
            // From here on its thrust is a number: what it was believed to be.
            let factor = state.felt_n[j] * suspects[ALL].factor * suspects[j].factor * self.quarter_inverse;
            suspects[likeliest].factor = factor;
            *found -= usize::from(suspects[j].found);
            suspects[j] = Suspect::innocent();
        }
    }

    /// Finds out whether it is a pair that lost, where it seems to be all; returns whether it is.
    #[cold]
    fn try_pairs(&self, state: &mut RotorsState<S>, dt_s: S) -> bool {
        let HealthState { suspects, found, trial, .. } = &mut state.health;
        let shared = suspects[ALL];
        let verdict = match trial {
            Some(trial) if shared.found => self.pairs.step(trial, shared.factor, &state.made_n, state.yaw_rad_s, dt_s),
            _ => Some(Verdict::Alike),
        };
        let Some(verdict) = verdict else { return false };
        *trial = None;
        let Verdict::Pair(first) = verdict else { return false };
        let left = (shared.factor + shared.factor - S::ONE).max(S::ZERO);
        suspects[ALL] = Suspect::innocent();
        for j in [first, first + 2] {
            suspects[j] = shared;
            suspects[j].factor = left;
        }
        *found = suspects.iter().filter(|suspect| suspect.found).count();
        true
    }

    /// Follows what is found, and takes it out of the residual, of which `per_newton` speaks. Of several, which share one residual, one
    /// has its turn, by the time since its last.
    fn follow(
        &self,
        state: &mut RotorsState<S>,
        columns: &[Column<S>; 4],
        residual: &mut Residual<S>,
        per_newton: &[S; 4],
        dt_s: S,
    ) {
        let HealthState { suspects, found, turn, .. } = &mut state.health;
        let found_in = |mut range: Range<usize>| range.find(|&i| suspects[i].found);
        let i = found_in(*turn + 1..HYPOTHESES).or_else(|| found_in(0..HYPOTHESES)).unwrap_or(0).min(HYPOTHESES - 1);
        *turn = i;
        let rotor = i.checked_sub(EXCESS).unwrap_or(i) % 4;
        let dt_s = dt_s * S::from_f32(*found as f32);
        let filter = LowPass::new(self.filter_rad_s, dt_s);
        let evidence = if i == ALL { self.of_all(state, per_newton) } else { of_one(state, per_newton, rotor) };
        let HealthState { suspects, found, .. } = &mut state.health;
        let mut effect = [S::ZERO; 3];
        let explained = if i >= EXCESS {
            effect = columns[rotor].0.map(|x| x * self.quarter_n);
            let told = state.made_n[rotor] * self.quarter_inverse;
            let pulled_n = (state.felt_n[rotor] * suspects[ALL].factor).max(S::from_f32(FELT_N_MIN));
            let per_quarter = self.quarter_n / pulled_n;
            let Evidence { seen, size } = evidence;
            let evidence = Evidence { seen: -(seen * per_quarter), size: size * per_quarter * per_quarter };
            suspects[i].follow_stuck(&evidence, told, &filter, dt_s)
        } else {
            for j in if i == ALL { 0..4 } else { rotor..rotor + 1 } {
                let other = if i == ALL { suspects[j].factor } else { suspects[ALL].factor };
                let felt_n = state.felt_n[j] * other;
                effect = core::array::from_fn(|axis| effect[axis] - columns[j].0[axis] * felt_n);
            }
            suspects[i].follow(&evidence, &filter, dt_s)
        };
        *found -= usize::from(!suspects[i].found);
        residual.0 = core::array::from_fn(|axis| residual.0[axis] - explained * effect[axis]);
        // What was explained away was so since the onset.
        let Residual([roll, pitch, force]) = *residual;
        state.predicted = [state.slope_rad_s2[0] - roll, state.slope_rad_s2[1] - pitch];
        state.force = force;
    }

    /// Writes down what is believed.
    fn settle(&self, state: &mut RotorsState<S>) {
        for j in 0..4 {
            let stuck = &state.health.suspects[EXCESS + j];
            state.stuck_n[j] = if stuck.found { stuck.factor * self.quarter_n } else { S::ZERO };
            state.shares[j] = state.told[j].unwrap_or(state.health.share(j));
        }
    }
}

/// What speaks for a loss of rotor `j`, by each c_j'C⁻¹x̃.
fn of_one<S: Scalar>(state: &RotorsState<S>, per_newton: &[S; 4], j: usize) -> Evidence<S> {
    let alone_n = state.felt_n[j] * state.health.suspects[ALL].factor;
    Evidence { seen: -(alone_n * per_newton[j]), size: alone_n * alone_n * state.health.sharpness[j] }
}
