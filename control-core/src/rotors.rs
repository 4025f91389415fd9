//! The rotors, watched: what their thrust should do to the body against what the body does.
//!
//! ```text
//! m_j ← lag(command_j)          thrust that a healthy rotor makes
//! x   = y_f − (Σ c_j η_j m_j − ω × I ω / I)_f          y = (ṗ, q̇, f_z),  c_j = (−right_j / Ix, forward_j / Iy, −1 / m)
//! ```
//!
//! | symbol | code         | unit            | what                                              |
//! |--------|--------------|-----------------|---------------------------------------------------|
//! | m_j    | `made_n`     | N               | last commands through the rotors' lag             |
//! | η_j    | `shares`     |                 | share of it that rotor j is believed to make      |
//! | ( )_f  | `filter`     |                 | one low-pass for all, so that all are of one age  |
//! | x      | `Residual`   | rad/s², m/s²    | acceleration that nothing known explains          |
//!
//! The residual serves three: the incremental loop takes it away by the next command (`Rotors::demand`); after that the detector in
//! `health.rs` looks for a rotor in it, and what of it follows the slope of the thrusts is a wrong lag (`lag.rs`). Roll, pitch and thrust
//! only: heading has κ for an arm, a tenth of the others', so that the noise of its ṙ would work the motors ten times harder than
//! everything else together, and the drag of a spinning body is not known.
//!
//! Source: docs/control-law.md, "Watching the rotors"; the incremental form after S. Sieberling, Q. P. Chu, J. A. Mulder, "Robust
//! flight control using incremental nonlinear dynamic inversion and angular acceleration prediction", 2010.
use crate::airframe::Airframe;
use crate::config::{ConfigError, positive};
use crate::filter::LowPass;
use crate::frames::{Body, Vec3};
use crate::restart::Tape;
use crate::spin::{Regulators, Spin, SpinConfig, Spinning};
use crate::{Demand, Scalar};

mod alarm;
mod coast;
mod health;
mod lag;
mod lost;
mod pair;
mod stuck;
mod suspect;
mod weather;

pub use alarm::{Alarm, DetectorConfig};
pub use health::HYPOTHESES;
use health::{Health, HealthState};
use lag::Lag;

/// Who says how healthy the rotors are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Knowledge {
    /// Nobody: they are taken to be as commanded.
    Assumed,
    /// Whoever calls [`crate::Controller::report`].
    Told,
    /// The detector, and whoever calls [`crate::Controller::report`].
    Estimated(DetectorConfig),
}

/// How the rotors are watched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorsConfig {
    /// Time constant of a rotor's thrust, s; where it starts if it is learnt.
    pub motor_lag_s: f32,
    /// Corner of the low-pass on what is compared, Hz.
    pub filter_hz: f32,
    /// Whether the residual is taken away by the next command.
    pub incremental: bool,
    /// Who says how healthy they are.
    pub knowledge: Knowledge,
    /// How to fly with one rotor gone, for those who know that it is.
    pub spin: Option<SpinConfig>,
}

impl RotorsConfig {
    /// A rotor of 20 ms; a corner between the noise it lets into the motors and the time a weak rotor has to push.
    pub const INCREMENTAL: Self =
        Self { motor_lag_s: 0.02, filter_hz: 15.0, incremental: true, knowledge: Knowledge::Assumed, spin: None };
    /// Told how healthy the rotors are; the residual is not used.
    pub const TOLD: Self =
        Self { incremental: false, knowledge: Knowledge::Told, spin: Some(SpinConfig::NOMINAL), ..Self::INCREMENTAL };
    /// Finds out how healthy the rotors are.
    pub const ESTIMATED: Self = Self {
        knowledge: Knowledge::Estimated(DetectorConfig::NOMINAL),
        spin: Some(SpinConfig::NOMINAL),
        ..Self::INCREMENTAL
    };
}

/// Share of the vertical residual that the next command takes away: all of it, on the robust law, swings when commands are 20 ms late.
const VERTICAL: f32 = 0.4;

/// What is believed of the rotors, for logs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorsTelemetry<S = f32> {
    /// Share of its thrust that each is believed to make.
    pub shares: [S; 4],
    /// The worst loss that was found.
    pub alarm: Option<Alarm<S>>,
    /// The detector's cumulative sums as it compares them, nats: loss of rotors 1 to 4, of all, excess of rotors 1 to 4.
    pub nats: [S; HYPOTHESES],
    /// Which of these are found.
    pub found: [bool; HYPOTHESES],
    /// Time constant of a rotor's thrust, s.
    pub lag_s: S,
    /// The rotor without which the machine spins, 0 to 3.
    pub spinning: Option<usize>,
    /// How far below the setpoint it is led, because two facing rotors are gone, m.
    pub sunk_m: S,
}

impl<S: Scalar> RotorsTelemetry<S> {
    /// The same in the format of logs.
    pub(crate) fn to_f32(self) -> RotorsTelemetry {
        RotorsTelemetry {
            shares: self.shares.map(S::to_f32),
            alarm: self.alarm.map(Alarm::to_f32),
            nats: self.nats.map(S::to_f32),
            found: self.found,
            lag_s: self.lag_s.to_f32(),
            spinning: self.spinning,
            sunk_m: self.sunk_m.to_f32(),
        }
    }
}

/// What each rotor does to the body, per newton: roll and pitch acceleration, 1/(kg m), specific force along z, 1/kg.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column<S>(pub(crate) [S; 3]);

/// Acceleration about roll and pitch, rad/s², and along body z, m/s², that nothing known explains.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residual<S>(pub(crate) [S; 3]);

/// What a tick felt, to be reflected on after it.
#[derive(Clone, Copy, Debug)]
struct Felt<S> {
    residual: Residual<S>,
    /// Of the believed roll and pitch acceleration, rad/s³.
    slope: [S; 2],
    motor: LowPass<S>,
    filter: LowPass<S>,
    dt_s: S,
}

/// The watch, configured.
#[derive(Clone, Debug)]
pub(crate) struct Rotors<S> {
    columns: [Column<S>; 4],
    inertia_kg_m2: [S; 2],
    inertia_inverse: [S; 2],
    /// Mass times [`VERTICAL`], kg.
    vertical_kg: S,
    filter_rad_s: S,
    incremental: bool,
    listens: bool,
    health: Option<Health<S>>,
    lag_s: S,
    /// Share of its thrust that a rotor needs for a hover with heading.
    hover_share: S,
    /// A quarter of the weight, N.
    quarter_n: S,
    /// Largest thrust of the weakest rotor, N.
    thrust_n_max: S,
    /// Yaw torque per thrust of each rotor, m.
    turning_m: [S; 4],
    /// Angular momentum about body z of each rotor, per square root of its thrust.
    momentum: [S; 4],
    pub(crate) spin: Option<Spin<S>>,
}

/// What the watch remembers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RotorsState<S: Scalar> {
    /// m_j.
    made_n: [S; 4],
    /// m_j through the filter.
    felt_n: [S; 4],
    rate_rad_s: [S; 2],
    yaw_rad_s: S,
    /// Slope of the filtered rates, rad/s².
    slope_rad_s2: [S; 2],
    /// Roll and pitch acceleration that the rotors are believed to make, rad/s².
    pub(crate) tilting_rad_s2: [S; 2],
    /// Predicted acceleration through the filter.
    predicted: [S; 2],
    force: S,
    lag: Lag<S>,
    /// η_j.
    pub(crate) shares: [S; 4],
    /// Thrust of a rotor that is stuck, whatever it is told, N; its share is zero.
    stuck_n: [S; 4],
    /// Shares that somebody else knows.
    told: [Option<S>; 4],
    /// Whether something else may bear the machine, so that what it feels says nothing of the rotors.
    pub(crate) borne: bool,
    /// Angular momentum of each rotor about body z, N m s, and whose is next.
    momentum_nm_s: [S; 4],
    turn: usize,
    /// What the last tick felt, until it is reflected on.
    felt: Option<Felt<S>>,
    health: HealthState<S>,
    /// The spin, if heading is given up.
    pub(crate) spinning: Option<Spinning<S>>,
    /// How far below the setpoint a machine that cannot stay up is led, m.
    pub(crate) sunk_m: S,
}

impl<S: Scalar> RotorsState<S> {
    /// Rotors that have made `thrust_n` each for long, level and at rest.
    pub(crate) fn new(thrust_n: S, rotors: Option<&Rotors<S>>) -> Self {
        Self {
            made_n: [thrust_n; 4],
            felt_n: [thrust_n; 4],
            rate_rad_s: [S::ZERO; 2],
            yaw_rad_s: S::ZERO,
            slope_rad_s2: [S::ZERO; 2],
            tilting_rad_s2: [S::ZERO; 2],
            predicted: [S::ZERO; 2],
            force: S::ZERO,
            lag: Lag::new(rotors.map_or(S::ONE, |rotors| rotors.lag_s)),
            shares: [S::ONE; 4],
            stuck_n: [S::ZERO; 4],
            told: [None; 4],
            borne: false,
            momentum_nm_s: [S::ZERO; 4],
            turn: 0,
            felt: None,
            health: HealthState::new(rotors.and_then(|rotors| rotors.health.as_ref())),
            spinning: None,
            sunk_m: S::ZERO,
        }
    }

    /// What is believed of the rotors.
    pub(crate) fn telemetry(&self) -> RotorsTelemetry<S> {
        RotorsTelemetry {
            shares: self.shares,
            alarm: self.health.alarm(),
            nats: self.health.nats(),
            found: self.health.found(),
            lag_s: self.lag.lag_s(),
            spinning: self.spinning.map(|spinning| spinning.rotor),
            sunk_m: self.sunk_m,
        }
    }
}

impl RotorsState<f32> {
    /// What is believed of the rotors, and whether it flies without one.
    pub(crate) fn pass(&mut self, tape: &mut Tape) {
        self.health.pass(tape);
        tape.floats(&mut self.shares);
        tape.floats(&mut self.stuck_n);
        tape.float(self.lag.constant_mut());
        tape.float(&mut self.sunk_m);
        let mut spins = self.spinning.is_some();
        let mut spinning = self.spinning.unwrap_or(Spinning::without(0));
        tape.bits([&mut spins, &mut spinning.pair, &mut spinning.healed]);
        tape.index(&mut spinning.rotor, 4);
        tape.float(&mut spinning.leaning);
        tape.floats(&mut spinning.wind_m_s2);
        self.spinning = spins.then_some(spinning);
    }
}

impl<S: Scalar> Rotors<S> {
    /// - `regulators`: of the spin; not looked at by those who do not spin.
    pub(crate) fn try_new(
        config: &RotorsConfig,
        regulators: Option<&Regulators>,
        airframe: &Airframe,
        control_hz: f32,
    ) -> Result<Self, ConfigError> {
        positive("rotors", "motor_lag_s", config.motor_lag_s)?;
        positive("rotors", "filter_hz", config.filter_hz)?;
        let [ix, iy, _] = airframe.inertia_kg_m2;
        let s = S::from_f32;
        let columns = airframe.rotors.map(|r| [-r.right_m / ix, r.forward_m / iy, -1.0 / airframe.mass_kg]);
        let health = match config.knowledge {
            Knowledge::Assumed | Knowledge::Told => None,
            Knowledge::Estimated(detector) => {
                Some(Health::try_new(&detector, airframe, &columns, config.filter_hz, control_hz)?)
            }
        };
        Ok(Self {
            columns: columns.map(|column| Column(column.map(s))),
            inertia_kg_m2: [s(ix), s(iy)],
            inertia_inverse: [s(1.0 / ix), s(1.0 / iy)],
            vertical_kg: s(VERTICAL * airframe.mass_kg),
            filter_rad_s: s(core::f32::consts::TAU * config.filter_hz),
            incremental: config.incremental,
            listens: config.knowledge != Knowledge::Assumed,
            health,
            lag_s: s(config.motor_lag_s),
            quarter_n: s(airframe.weight_n() / 4.0),
            thrust_n_max: s(airframe.rotors.iter().map(|r| r.thrust_n_max).fold(f32::INFINITY, f32::min)),
            turning_m: [1.0, -1.0, 1.0, -1.0].map(|turn: f32| s(turn * airframe.torque_per_thrust_m)),
            momentum: [-1.0, 1.0, -1.0, 1.0].map(|turn: f32| s(turn * airframe.rotor_momentum)),
            hover_share: s(airframe.weight_n() / airframe.rotors.iter().map(|r| r.thrust_n_max).sum::<f32>()),
            spin: config
                .spin
                .map(|spin| Spin::try_new(&spin, regulators, airframe, config.motor_lag_s, control_hz))
                .transpose()?,
        })
    }

    /// What turning the spinning rotors takes, N m: ω × h.
    pub(crate) fn gyroscopic_nm(state: &RotorsState<S>, rate: Vec3<Body, S>) -> Vec3<Body, S> {
        let [a, b, c, d] = state.momentum_nm_s;
        let sum = (a + b) + (c + d);
        Vec3::new(rate.y * sum, -(rate.x * sum), S::ZERO)
    }

    /// Compares what the last commands should have done with what the sensors felt.
    ///
    /// - `command_n`: last thrust commands.
    /// - `coupling_nm`: ω × I ω.
    pub(crate) fn observe(
        &self,
        state: &mut RotorsState<S>,
        command_n: &[S; 4],
        rate: Vec3<Body, S>,
        coupling_nm: Vec3<Body, S>,
        force_z_m_s2: S,
        dt_s: S,
    ) -> Residual<S> {
        let motor = LowPass::new(S::ONE / state.lag.lag_s(), dt_s);
        let filter = LowPass::new(self.filter_rad_s, dt_s);
        let mut made = [S::ZERO; 3];
        let mut slope = [S::ZERO; 2];
        for (j, &command_n) in command_n.iter().enumerate() {
            let slope_n = motor.step(&mut state.made_n[j], command_n);
            filter.step(&mut state.felt_n[j], state.made_n[j]);
            let share = state.shares[j];
            let (thrust_n, slope_n) = (share * state.made_n[j] + state.stuck_n[j], share * slope_n);
            let Column([roll, pitch, z]) = self.columns[j];
            made = [made[0] + roll * thrust_n, made[1] + pitch * thrust_n, made[2] + z * thrust_n];
            slope = [slope[0] + roll * slope_n, slope[1] + pitch * slope_n];
        }
        state.tilting_rad_s2 = [made[0], made[1]];
        filter.step(&mut state.predicted[0], made[0] - coupling_nm.x * self.inertia_inverse[0]);
        filter.step(&mut state.predicted[1], made[1] - coupling_nm.y * self.inertia_inverse[1]);
        state.slope_rad_s2 =
            [filter.step(&mut state.rate_rad_s[0], rate.x), filter.step(&mut state.rate_rad_s[1], rate.y)];
        let roll = state.slope_rad_s2[0] - state.predicted[0];
        let pitch = state.slope_rad_s2[1] - state.predicted[1];
        state.yaw_rad_s = rate.z;
        filter.step(&mut state.force, force_z_m_s2 - made[2]);
        let residual = Residual([roll, pitch, state.force]);
        state.felt = Some(Felt { residual, slope, motor, filter, dt_s });
        residual
    }

    /// Learns from what the last tick felt, and decides what the next one flies without.
    pub(crate) fn reflect(&self, state: &mut RotorsState<S>) {
        let Some(Felt { residual, slope, motor, filter, dt_s }) = state.felt.take() else { return };
        if let Some(health) = &self.health
            && !state.borne
        {
            let [roll, pitch, _] = residual.0;
            state.lag.learn(slope, [roll, pitch], &motor, &filter, || state.health.is_calm(), dt_s);
            health.step(state, &self.columns, residual, dt_s);
        }
        // A root is dear: one rotor's momentum is brought up to date a tick.
        let j = state.turn % 4;
        state.turn = j + 1;
        let thrust_n = (state.shares[j] * state.made_n[j] + state.stuck_n[j]).max(S::ZERO);
        state.momentum_nm_s[j] = self.momentum[j] * thrust_n.sqrt();
        state.spinning = self.next_spinning(state);
    }

    /// Takes what somebody else knows of the rotors' shares, each within 0 and 1; `None` where nothing is known.
    pub(crate) fn listen(&self, state: &mut RotorsState<S>, shares: [Option<S>; 4]) {
        if self.listens {
            state.told = shares.map(|share| Some(share?.clamp(S::ZERO, S::ONE)));
            for j in 0..4 {
                state.shares[j] = state.told[j].unwrap_or(state.health.share(j));
            }
        }
    }

    /// What must be asked for so that the body feels `wanted`.
    pub(crate) fn demand(&self, wanted: &Demand<S>, residual: &Residual<S>) -> Demand<S> {
        if !self.incremental {
            return *wanted;
        }
        let Residual([roll, pitch, force]) = *residual;
        Demand {
            thrust_n: wanted.thrust_n + self.vertical_kg * force,
            roll_nm: wanted.roll_nm - self.inertia_kg_m2[0] * roll,
            pitch_nm: wanted.pitch_nm - self.inertia_kg_m2[1] * pitch,
            yaw_nm: wanted.yaw_nm,
        }
    }
}
