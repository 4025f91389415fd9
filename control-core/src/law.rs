//! The law of one outer axis: error and its derivatives in, command out.
//!
//! ```text
//! u = k · Π        Π = (e, ∫e, ė)        s = ė + λ e        V = s²/2
//! ```
//!
//! | law            | what moves the gains                              | module  |
//! |----------------|---------------------------------------------------|---------|
//! | [`Law::Pid`]   | nothing                                           | here    |
//! | [`Law::Raw`]   | the paper's eq 23 and Table 2, exactly as printed | `raw`   |
//! | [`Law::Lgs`]   | the robust law, bounded and leaking               | `lgs`   |
//!
//! Shared by all three: ė through a one-pole low-pass, and an integrator that stops while it pushes further into
//! saturation. Invariants: |∫e| is bounded; under `Lgs` every gain is within [0.4, 3] times its start.
use crate::Scalar;
use crate::config::{AxisConfig, ConfigError};
use crate::filter::LowPass;

mod lgs;
mod raw;

pub use lgs::{GAIN_RATIO_MAX, GAIN_RATIO_MIN, LgsGains};
pub use raw::{RawGains, TABLE_2_PSI, TABLE_2_X, TABLE_2_Y, TABLE_2_Z};

/// Which law moves the gains of the outer axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// Fixed gains.
    Pid,
    /// The paper's law as printed. It needs actuators that do not saturate; its gains have no bound.
    Raw,
    /// The robust Lyapunov-gain-scheduled law, the one that flies.
    Lgs,
}

/// What an axis sees in one tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisInput<S: Scalar> {
    /// Setpoint less measurement, e.
    pub(crate) error: S,
    /// ė, per second.
    pub(crate) error_rate: S,
    /// ë, per second squared.
    pub(crate) error_accel: S,
    /// What the last tick refused of the command; its sign is the direction that is saturated.
    pub(crate) refused: S,
    /// Whether ∫e may move.
    pub(crate) integrate: S::Mask,
    /// Whether the gains may move.
    pub(crate) adapt: S::Mask,
}

/// What an axis remembers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisState<S: Scalar> {
    gains: [S::Sum; 3],
    integral: S::Sum,
    error_rate: S,
    error_accel: S,
}

/// What an axis says in one tick.
#[derive(Clone, Copy, Debug)]
pub struct AxisOutput<S: Scalar = f32> {
    /// The command u: m/s² for x and y, N for z, N m for heading.
    pub command: S,
    /// The gains (k_p, k_i, k_d) behind it.
    pub gains: [S; 3],
    /// Filtered error s = ė + λ e.
    pub s: S,
    /// Lyapunov function candidate V = s²/2.
    pub v: S,
    /// Whether each gain sits on one of its bounds: the projection is at work.
    pub at_bound: [S::Mask; 3],
}

/// What moves the gains.
#[derive(Clone, Debug)]
enum Adaptation<S> {
    Fixed,
    Raw(raw::Raw<S>),
    Lgs(lgs::Lgs<S>),
}

/// One axis, configured.
#[derive(Clone, Debug)]
pub(crate) struct AxisLaw<S> {
    start: [S; 3],
    error_max: S,
    integral_max: S,
    lambda: S,
    adaptation: Adaptation<S>,
}

/// Regressor and filtered errors of one tick.
#[derive(Clone, Copy)]
struct Regressor<S> {
    /// Π = (e, ∫e, ė).
    pi: [S; 3],
    /// ë.
    error_accel: S,
    /// s = ė + λ e.
    s: S,
}

impl<S: Scalar> AxisLaw<S> {
    /// The law of one axis; `name` leads the field names of errors.
    pub(crate) fn try_new(name: &'static str, law: Law, config: &AxisConfig) -> Result<Self, ConfigError> {
        config.check(name, law)?;
        let start = config.k0.map(S::from_f32);
        Ok(Self {
            start,
            error_max: S::from_f32(config.error_max),
            integral_max: S::from_f32(config.integral_max),
            lambda: S::from_f32(config.lgs.lambda),
            adaptation: match law {
                Law::Pid => Adaptation::Fixed,
                Law::Raw => Adaptation::Raw(raw::Raw::new(&config.raw)),
                Law::Lgs => Adaptation::Lgs(lgs::Lgs::new(&config.lgs, &config.k0)),
            },
        })
    }

    /// At rest with the starting gains, commanding `command` through the integral.
    pub(crate) fn state(&self, command: S) -> AxisState<S> {
        AxisState {
            gains: self.start.map(S::to_sum),
            integral: (command / self.start[1]).to_sum(),
            error_rate: S::ZERO,
            error_accel: S::ZERO,
        }
    }

    /// What [`Self::state`] says before its first tick.
    pub(crate) fn output(&self, command: S) -> AxisOutput<S> {
        AxisOutput { command, gains: self.start, s: S::ZERO, v: S::ZERO, at_bound: [crate::Mask::splat(false); 3] }
    }

    /// One tick: filter, integrate, adapt, command.
    pub(crate) fn step(
        &self,
        state: &mut AxisState<S>,
        input: &AxisInput<S>,
        low_pass: &LowPass<S>,
        output: &mut AxisOutput<S>,
    ) {
        let error = input.error.clamp(-self.error_max, self.error_max);
        low_pass.step(&mut state.error_rate, input.error_rate);
        low_pass.step(&mut state.error_accel, input.error_accel);

        let stuck = S::ZERO.lt(input.refused * error) | !input.integrate;
        let rate = S::select(stuck, S::ZERO, error);
        let bounds = (-self.integral_max, self.integral_max);
        state.integral = S::integrate(state.integral, rate, low_pass.dt_s(), bounds);

        let regressor = Regressor {
            pi: [error, S::from_sum(state.integral), state.error_rate],
            error_accel: state.error_accel,
            s: state.error_rate + self.lambda * error,
        };
        match &self.adaptation {
            Adaptation::Fixed => {}
            Adaptation::Raw(law) => law.adapt(&mut state.gains, &regressor, low_pass.dt_s()),
            Adaptation::Lgs(law) => {
                law.adapt(&mut state.gains, &regressor, input, low_pass.dt_s());
            }
        }
        let gains = state.gains.map(S::from_sum);
        let [kp, ki, kd] = gains;
        let [e, integral, e_rate] = regressor.pi;
        *output = AxisOutput {
            command: kp * e + ki * integral + kd * e_rate,
            gains,
            s: regressor.s,
            v: S::from_f32(0.5) * regressor.s * regressor.s,
            at_bound: self.at_bound(gains),
        };
    }

    fn at_bound(&self, gains: [S; 3]) -> [S::Mask; 3] {
        match &self.adaptation {
            Adaptation::Lgs(law) => law.at_bound(gains),
            Adaptation::Fixed | Adaptation::Raw(_) => [crate::Mask::splat(false); 3],
        }
    }
}
