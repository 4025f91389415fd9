//! Which rotor lost thrust, how much, since when: one cumulative sum for each hypothesis.
//!
//! ```text
//! h_i = −Σ_{j in i} c_j η_j m_j                what a total loss of hypothesis i would put into the residual
//! S_i ← max(0, S_i + n dt (d h_i'C⁻¹x̃ − d²/2 h_i'C⁻¹h_i))       x̃ = x less its slow mean
//! S_i > S_max:  onset where S_i left zero;  loss = h_i'C⁻¹x̃ / (h_i'C⁻¹h_i ρ),   ρ = share of a step that passed the filter since
//! ```
//!
//! Five hypotheses: each rotor alone, and all alike (battery, air). S_i is a log-likelihood ratio: "i lost the share d" against "nothing
//! did", with n independent samples a second. C is diagonal: what the sensors' noise leaves in the residual, and ten times
//! what the weather does, since gusts last and so are not independent.
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
        alarm_nats: 12.0,
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
    /// How long before the alarm it began, s.
    pub onset_age_s: S,
    /// Share of the thrust that is lost now.
    pub loss: S,
    /// Probability that it is this one rather than the next likeliest, or none.
    pub confidence: S,
}

/// Rotors 1 to 4, and all.
pub const HYPOTHESES: usize = 5;
/// The hypothesis that all lose alike.
const ALL: usize = 4;
/// What the weather counts for beyond its variance.
const WEATHER: f32 = 10.0;
/// Time over which the residual's mean is taken, s.
const MEAN_S: f32 = 10.0;
/// Times in which a found factor is followed: while far off, and else, s.
const FOLLOW_S: (f32, f32) = (0.02, 0.25);
/// Error of a factor that is far off.
const FAR: f32 = 0.25;
/// Loss below which a rotor is called whole, and for how long, s.
const WHOLE: (f32, f32) = (0.06, 1.0);
/// h'C⁻¹h below which a rotor pulls too little to be judged.
const FAINT: f32 = 0.5;
/// S beyond which nothing is added: it only says "certain".
const NATS_MAX: f32 = 100.0;

/// The detector, configured.
#[derive(Clone, Debug)]
pub(crate) struct Health<S> {
    /// Diagonal of C⁻¹.
    weights: [S; 3],
    /// n d and n d²/2.
    gain_per_s: S,
    drift_per_s: S,
    alarm_nats: S,
    mean_per_s: S,
}

/// What is known of one hypothesis.
#[derive(Clone, Copy, Debug)]
struct Suspect<S> {
    nats: S,
    /// ρ.
    risen: S,
    /// Time since S left zero; after the alarm, as it was then, s.
    age_s: S,
    /// What is left: 1 less the loss.
    factor: S,
    /// Lead over the next likeliest at the alarm, nats.
    lead_nats: S,
    whole_s: S,
    found: bool,
}

/// What the detector remembers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HealthState<S> {
    suspects: [Suspect<S>; HYPOTHESES],
    mean: [S; 3],
}

impl<S: Scalar> HealthState<S> {
    pub(super) fn new() -> Self {
        let suspect = Suspect {
            nats: S::ZERO,
            risen: S::ZERO,
            age_s: S::ZERO,
            factor: S::ONE,
            lead_nats: S::ZERO,
            whole_s: S::ZERO,
            found: false,
        };
        Self { suspects: [suspect; HYPOTHESES], mean: [S::ZERO; 3] }
    }

    /// Whether nothing is found, and nothing suspected.
    pub(super) fn is_calm(&self) -> bool {
        !self.suspects.iter().any(|suspect| suspect.found || S::ONE.lt(suspect.nats).all())
    }

    /// The worst loss that was found, if any.
    pub(crate) fn alarm(&self) -> Option<Alarm<S>> {
        let mut worst: Option<(usize, &Suspect<S>)> = None;
        for (i, suspect) in self.suspects.iter().enumerate() {
            if suspect.found && worst.is_none_or(|(_, w)| suspect.factor.lt(w.factor).all()) {
                worst = Some((i, suspect));
            }
        }
        let (i, suspect) = worst?;
        let half = S::from_f32(0.5);
        Some(Alarm {
            rotor: (i != ALL).then_some(i),
            onset_age_s: suspect.age_s,
            loss: S::ONE - suspect.factor,
            confidence: half + half * crate::math::tanh(half * suspect.lead_nats),
        })
    }

    /// S of each hypothesis.
    pub(super) fn nats(&self) -> [S; HYPOTHESES] {
        self.suspects.map(|suspect| suspect.nats)
    }

    /// Which hypotheses are found.
    pub(super) fn found(&self) -> [bool; HYPOTHESES] {
        self.suspects.map(|suspect| suspect.found)
    }

    /// Standard error of what is known of rotor `j`: large just after the onset.
    pub(crate) fn uncertainty(&self, j: usize) -> S {
        S::from_f32(0.08) / self.suspects[j].risen.max(S::from_f32(0.1))
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
        let weight = |noise: f32, weather: f32| S::from_f32(1.0 / (noise + WEATHER * square(weather)));
        let [ix, iy, _] = airframe.inertia_kg_m2;
        let independent_per_s = corner / 2.0;
        let s = S::from_f32;
        Ok(Self {
            weights: [
                weight(turning, torque_rms_nm / ix),
                weight(turning, torque_rms_nm / iy),
                weight(falling, force_rms_n / airframe.mass_kg),
            ],
            gain_per_s: s(independent_per_s * loss),
            drift_per_s: s(independent_per_s * loss * loss / 2.0),
            alarm_nats: s(alarm_nats),
            mean_per_s: s(1.0 / MEAN_S),
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
        let HealthState { suspects, mean } = &mut state.health;
        let all = suspects[ALL].factor;
        let mut effects = [[S::ZERO; 3]; HYPOTHESES];
        for j in 0..4 {
            let Column(column) = columns[j];
            let felt_n = -state.felt_n[j];
            let (alone_n, shared_n) = (felt_n * all, felt_n * suspects[j].factor);
            for axis in 0..3 {
                effects[j][axis] = column[axis] * alone_n;
                effects[ALL][axis] = effects[ALL][axis] + column[axis] * shared_n;
            }
        }
        let Residual(x) = residual;
        let mut likeliest = (S::ZERO, S::ZERO, HYPOTHESES);
        let quiet = !suspects.iter().any(|suspect| suspect.found);
        for (i, (suspect, effect)) in suspects.iter_mut().zip(&effects).enumerate() {
            let [wr, wp, wz] = self.weights;
            let [hr, hp, hz] = *effect;
            let (hr_w, hp_w, hz_w) = (hr * wr, hp * wp, hz * wz);
            let seen = hr_w * (x[0] - mean[0]) + hp_w * (x[1] - mean[1]) + hz_w * (x[2] - mean[2]);
            let size = hr_w * hr + hp_w * hp + hz_w * hz;
            if suspect.found {
                let change = suspect.follow(seen, size, filter, dt_s);
                for axis in 0..3 {
                    x[axis] = x[axis] - change * effect[axis];
                }
                continue;
            }
            let slope = self.gain_per_s * seen - self.drift_per_s * size;
            suspect.nats = (suspect.nats + slope * dt_s).clamp(S::ZERO, S::from_f32(NATS_MAX));
            let rising = S::ZERO.lt(suspect.nats);
            filter.step(&mut suspect.risen, S::ONE);
            suspect.risen = S::select(rising, suspect.risen, S::ZERO);
            suspect.age_s = S::select(rising, suspect.age_s + dt_s, S::ZERO);
            if likeliest.0.lt(suspect.nats).all() {
                likeliest = (suspect.nats, likeliest.0, i);
            } else {
                likeliest.1 = likeliest.1.max(suspect.nats);
            }
        }
        let (nats, next, i) = likeliest;
        if self.alarm_nats.lt(nats).all() {
            for suspect in suspects.iter_mut().filter(|suspect| !suspect.found) {
                suspect.nats = S::ZERO;
            }
            suspects[i].found = true;
            suspects[i].lead_nats = nats - next;
        } else if quiet {
            let keep = self.mean_per_s * dt_s;
            for axis in 0..3 {
                mean[axis] = mean[axis] + keep * (x[axis] - mean[axis]);
            }
        }
        // What was explained away was so since the onset.
        state.predicted = [state.slope_rad_s2[0] - x[0], state.slope_rad_s2[1] - x[1]];
        state.force = x[2];
        let all = suspects[ALL].factor;
        for j in 0..4 {
            state.shares[j] = state.told[j].unwrap_or(all * suspects[j].factor);
        }
    }
}

impl<S: Scalar> Suspect<S> {
    /// Follows the factor; returns what of the effect of a total loss this explains.
    fn follow(&mut self, seen: S, size: S, filter: &LowPass<S>, dt_s: S) -> S {
        let s = S::from_f32;
        let error = seen / ((size + s(FAINT)) * self.risen);
        let fresh = self.risen.lt(s(0.95));
        let time_s = S::select(s(FAR).lt(error.abs()), s(FOLLOW_S.0), s(FOLLOW_S.1));
        let step = S::select(fresh, error, error * (dt_s / time_s).min(S::ONE));
        let before = self.factor;
        self.factor = (before - step).clamp(S::ZERO, S::ONE);
        let change = (before - self.factor) * self.risen;
        filter.step(&mut self.risen, S::ONE);
        let whole = s(1.0 - WHOLE.0).lt(self.factor);
        self.whole_s = S::select(whole, self.whole_s + dt_s, S::ZERO);
        if s(WHOLE.1).lt(self.whole_s).all() {
            self.found = false;
            self.factor = S::ONE;
            self.whole_s = S::ZERO;
            self.nats = S::ZERO;
        }
        change
    }
}
