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
use crate::{Mask, Scalar};

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
/// What an excess must have beyond the alarm, nats, and what a loss of all must: gusts along the thrust look like one.
const HANDICAP_NATS: f32 = 6.0;
const SHARED_NATS: f32 = 5.0;

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
    /// How many of them are found.
    found: usize,
    /// Whether a loss of all is one of a pair: open until it is known.
    trial: Option<Trial<S>>,
    weather: Weather<S>,
}

impl<S: Scalar> HealthState<S> {
    pub(super) fn new(health: Option<&Health<S>>) -> Self {
        let weather = Weather::unknown(health.map(|health| &health.climate));
        Self { suspects: [Suspect::innocent(); HYPOTHESES], found: 0, trial: None, weather }
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
        core::array::from_fn(|i| judged(&self.suspects[i], i))
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
        residual: &mut Residual<S>,
        filter: &LowPass<S>,
        dt_s: S,
    ) {
        // Several share one residual: each sees what the others left, and what one leaves can wait for the next tick.
        let several = state.health.found > 1;
        let nothing = Evidence { seen: S::ZERO, size: S::ZERO };
        let (mut losses, mut all) = if several { ([nothing; 4], nothing) } else { self.evidence(state, residual) };
        if state.health.found > 0 {
            self.follow(state, columns, residual, (&mut losses, &mut all), filter, dt_s);
        } else {
            state.health.weather.learn(&self.climate, &residual.0, dt_s);
        }
        if state.spinning.is_some_and(|spinning| spinning.pair) {
            // Of two rotors none can be spared: whatever else is felt, it is weather.
            return;
        }
        if several {
            (losses, all) = self.evidence(state, residual);
        }
        let HealthState { suspects, found, weather, .. } = &mut state.health;
        let scaled = |(gain, drift): (S, S)| (gain * dt_s, drift * dt_s);
        let (loss, excess) = (scaled(self.loss_per_s), scaled(self.excess_per_s));
        let limit = self.alarm_nats;
        let [_, _, sunk] = weather.beside(&residual.0);
        let lifted = sunk.lt(S::ZERO).all();
        let without = state.spinning.map(|spinning| spinning.rotor);
        let mut alarmed = suspects[ALL].judge(&all, loss, limit + S::from_f32(SHARED_NATS), dt_s);
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
                let limit = limit + S::from_f32(HANDICAP_NATS);
                alarmed = alarmed | suspects[EXCESS + j].judge(&Evidence { seen: -seen, size }, excess, limit, dt_s);
            }
        }
        if alarmed.all() {
            self.accuse(state);
        } else if state.health.trial.is_some() {
            self.try_pairs(state, dt_s);
        }
    }

    /// What the residual says of a loss of each rotor, and of all alike. Of all, as if they pulled alike: in a hover they do.
    fn evidence(&self, state: &RotorsState<S>, residual: &Residual<S>) -> ([Evidence<S>; 4], Evidence<S>) {
        let HealthState { suspects, weather, .. } = &state.health;
        let [wx, wy, wz] = weather.weights;
        let [x, y, z] = weather.beside(&residual.0);
        let (x, y, z) = (x * wx, y * wy, z * wz);
        let all = suspects[ALL].factor;
        let (mut seen_n, mut total_n) = (S::ZERO, S::ZERO);
        let losses = core::array::from_fn(|j| {
            let (c, squares) = &self.columns[j];
            let per_newton = c[0] * x + c[1] * y + c[2] * z;
            let per_newton_squared = squares[0] * wx + squares[1] * wy + squares[2] * wz;
            let (alone_n, shared_n) = (state.felt_n[j] * all, state.felt_n[j] * suspects[j].factor);
            seen_n = seen_n + shared_n * per_newton;
            total_n = total_n + shared_n;
            Evidence { seen: -(alone_n * per_newton), size: alone_n * alone_n * per_newton_squared }
        });
        (losses, Evidence { seen: -seen_n, size: total_n * total_n * self.spread * wz })
    }

    /// Finds the likeliest, and clears the others for now.
    #[cold]
    fn accuse(&self, state: &mut RotorsState<S>) {
        let HealthState { suspects, found, .. } = &mut state.health;
        let (mut likeliest, mut nats, mut next) = (0, S::ZERO, S::ZERO);
        for (i, suspect) in (0..HYPOTHESES).zip(suspects.iter_mut()).filter(|(_, suspect)| !suspect.found) {
            let judged = judged(suspect, i);
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
        self.settle(state);
    }

    /// Finds out whether it is a pair that lost, where it seems to be all.
    #[cold]
    fn try_pairs(&self, state: &mut RotorsState<S>, dt_s: S) {
        let HealthState { suspects, found, trial, .. } = &mut state.health;
        let shared = suspects[ALL];
        let verdict = match trial {
            Some(trial) if shared.found => self.pairs.step(trial, shared.factor, &state.made_n, state.yaw_rad_s, dt_s),
            _ => Some(Verdict::Alike),
        };
        let Some(verdict) = verdict else { return };
        *trial = None;
        let Verdict::Pair(first) = verdict else { return };
        let left = (shared.factor + shared.factor - S::ONE).max(S::ZERO);
        suspects[ALL] = Suspect::innocent();
        for j in [first, first + 2] {
            suspects[j] = shared;
            suspects[j].factor = left;
        }
        *found = suspects.iter().filter(|suspect| suspect.found).count();
        self.settle(state);
    }

    /// Follows what is found, and takes it out of the residual.
    fn follow(
        &self,
        state: &mut RotorsState<S>,
        columns: &[Column<S>; 4],
        residual: &mut Residual<S>,
        (losses, all): (&mut [Evidence<S>; 4], &mut Evidence<S>),
        filter: &LowPass<S>,
        dt_s: S,
    ) {
        for i in 0..HYPOTHESES {
            if !state.health.suspects[i].found {
                continue;
            }
            if state.health.found > 1 {
                (*losses, *all) = self.evidence(state, residual);
            }
            let HealthState { suspects, found, .. } = &mut state.health;
            let mut effect = [S::ZERO; 3];
            let explained = if let Some(j) = i.checked_sub(EXCESS) {
                effect = columns[j].0.map(|x| x * self.quarter_n);
                let told = state.made_n[j] * self.quarter_inverse;
                let pulled_n = (state.felt_n[j] * suspects[ALL].factor).max(S::from_f32(FELT_N_MIN));
                let per_quarter = self.quarter_n / pulled_n;
                let Evidence { seen, size } = losses[j];
                let evidence = Evidence { seen: -(seen * per_quarter), size: size * per_quarter * per_quarter };
                suspects[i].follow_stuck(&evidence, told, filter, dt_s)
            } else {
                for (j, column) in columns.iter().enumerate().filter(|(j, _)| i == ALL || i == *j) {
                    let other = if i == ALL { suspects[j].factor } else { suspects[ALL].factor };
                    let felt_n = state.felt_n[j] * other;
                    effect = core::array::from_fn(|axis| effect[axis] - column.0[axis] * felt_n);
                }
                suspects[i].follow(if i == ALL { all } else { &losses[i] }, filter, dt_s)
            };
            *found -= usize::from(!suspects[i].found);
            residual.0 = core::array::from_fn(|axis| residual.0[axis] - explained * effect[axis]);
        }
        // What was explained away was so since the onset.
        let Residual([roll, pitch, force]) = *residual;
        state.predicted = [state.slope_rad_s2[0] - roll, state.slope_rad_s2[1] - pitch];
        state.force = force;
        self.settle(state);
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

/// S of hypothesis `i` as it is compared.
fn judged<S: Scalar>(suspect: &Suspect<S>, i: usize) -> S {
    let handicap = match i {
        ALL => SHARED_NATS,
        _ if i < ALL => 0.0,
        _ => HANDICAP_NATS,
    };
    suspect.nats - S::from_f32(handicap)
}
