//! The law of one outer axis: error and its derivatives in, command out.
//!
//! ```text
//! u = k · Π        Π = (e, ∫e, ė)        s = ė + λ e        V = s²/2        k_j = κ_j k0_j
//! ```
//!
//! | law            | what moves the gains                              | module  |
//! |----------------|---------------------------------------------------|---------|
//! | [`Law::Pid`]   | nothing                                           | here    |
//! | [`Law::Raw`]   | the paper's eq 23 and Table 2, exactly as printed | `raw`   |
//! | [`Law::Lgs`]   | the robust law, bounded and leaking               | `lgs`   |
//!
//! A gain is kept as its ratio κ to the start, which is near 1 on every axis: the same bounds serve all, and fixed
//! point resolves all alike. Shared by all three laws: ė through a one-pole low-pass, and an integrator that stops
//! while it pushes further into saturation.
//!
//! A tick has a fast part, `AxisLaw::command`, and a slow one, `AxisLaw::learn`: gains and integrals move over
//! tenths of a second, so that the axes may learn in turn, each by the time since its last turn.
//!
//! Invariants: |∫e| is bounded; under `Lgs` every κ is within [0.4, 3]. Proofs:
//! docs/theory.md, "Bounded, whatever the input".
use crate::Scalar;
use crate::config::{AxisConfig, ConfigError};
use crate::filter::LowPass;
use crate::restart::Tape;

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
pub(crate) struct AxisInput<S> {
    /// Setpoint less measurement, e.
    pub(crate) error: S,
    /// ė, per second.
    pub(crate) error_rate: S,
    /// ë, per second squared; where nothing measures it, the slope of the filtered ė.
    pub(crate) error_accel: Option<S>,
}

/// What the slow part of an axis learns from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lesson<S: Scalar> {
    /// Setpoint less measurement, e.
    pub(crate) error: S,
    /// What the last tick refused of the command; its sign is the direction that is saturated.
    pub(crate) refused: S,
    /// Whether ∫e may move.
    pub(crate) integrate: S::Mask,
    /// Time since the last lesson, s; zero if nothing is to be learnt.
    pub(crate) dt_s: S,
}

/// What an axis remembers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisState<S: Scalar> {
    /// κ = k / k0.
    ratios: [S::Sum; 3],
    integral: S::Sum,
    error_rate: S,
    error_accel: S,
    /// s of the last tick.
    s: S,
    /// u of the last tick.
    command: S,
}

impl AxisState<f32> {
    /// What it has learnt.
    pub(crate) fn pass(&mut self, tape: &mut Tape) {
        tape.floats(&mut self.ratios);
        tape.float(&mut self.integral);
    }
}

/// What an axis thought in the last tick, for logs.
#[derive(Clone, Copy, Debug)]
pub struct AxisTelemetry<S = f32> {
    /// The command u: m/s² for x and y, N for z, N m for heading.
    pub command: S,
    /// The gains (k_p, k_i, k_d).
    pub gains: [S; 3],
    /// The gains over those at the start.
    pub gain_ratios: [S; 3],
    /// The integral of the error, ∫e.
    pub integral: S,
    /// Filtered error s = ė + λ e.
    pub s: S,
    /// Its slope ṡ = ë + λ ė, from the filtered ė and ë that the law learns from.
    pub s_rate: S,
    /// Half-width ε of the boundary layer. It and the λ of s are the robust law's under every law, so that flights compare.
    pub layer: S,
}

impl<S: Scalar> AxisTelemetry<S> {
    /// Lyapunov function candidate V = s²/2 (the paper's eq 16).
    pub fn v(&self) -> S {
        S::from_f32(0.5) * self.s * self.s
    }

    /// Its slope V̇ = s ṡ. Measured, so with the noise and the delay of ė and ë.
    pub fn v_rate(&self) -> S {
        self.s * self.s_rate
    }

    /// Whether V rises outside the boundary layer, |s| > ε: an alarm to look at, not a proof.
    ///
    /// The reaching law makes V fall there unless what is missing of the command accelerates s by more than
    /// α ε + β tanh 1. A step of the setpoint, saturated rotors, a fault in its first moments and noise all do that for a
    /// while and are survived; an alarm that stays on says that what the law counts on does not hold.
    ///
    /// # Source
    /// docs/theory.md, "The monitor".
    pub fn v_rises(&self) -> S::Mask {
        self.layer.lt(self.s.abs()) & S::ZERO.lt(self.v_rate())
    }

    /// Whether each gain sits on a bound of the robust law: the projection is at work.
    pub fn at_bound(&self) -> [S::Mask; 3] {
        let (low, high) = (S::from_f32(GAIN_RATIO_MIN), S::from_f32(GAIN_RATIO_MAX));
        self.gain_ratios.map(|ratio| !(low.lt(ratio) & ratio.lt(high)))
    }

    /// The same in the format of logs.
    pub fn to_f32(&self) -> AxisTelemetry {
        let f = S::to_f32;
        AxisTelemetry {
            command: f(self.command),
            gains: self.gains.map(f),
            gain_ratios: self.gain_ratios.map(f),
            integral: f(self.integral),
            s: f(self.s),
            s_rate: f(self.s_rate),
            layer: f(self.layer),
        }
    }
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
    /// k0.
    start: [S; 3],
    integral_max: S,
    lambda: S,
    /// ε, for telemetry.
    layer: S,
    adaptation: Adaptation<S>,
}

/// Regressor and filtered errors of one tick.
#[derive(Clone, Copy)]
struct Regressor<S> {
    /// Π = (e, ∫e, ė).
    pi: [S; 3],
    /// k0_j Π_j: what each starting gain commands.
    terms: [S; 3],
    /// ë.
    error_accel: S,
    /// s = ė + λ e.
    s: S,
}

impl<S: Scalar> AxisLaw<S> {
    /// The law of one axis; `name` leads the field names of errors.
    pub(crate) fn try_new(name: &'static str, law: Law, config: &AxisConfig) -> Result<Self, ConfigError> {
        config.check(name, law)?;
        Ok(Self {
            start: config.k0.map(S::from_f32),
            integral_max: S::from_f32(config.integral_max),
            lambda: S::from_f32(config.lgs.lambda),
            layer: S::from_f32(config.lgs.eps),
            adaptation: match law {
                Law::Pid => Adaptation::Fixed,
                Law::Raw => Adaptation::Raw(raw::Raw::new(&config.raw, &config.k0)),
                Law::Lgs => Adaptation::Lgs(lgs::Lgs::new(&config.lgs, &config.k0)),
            },
        })
    }

    /// At rest with the starting gains, commanding `command` through the integral.
    pub(crate) fn state(&self, command: S) -> AxisState<S> {
        let [_, ki, _] = self.start;
        AxisState {
            ratios: [S::ONE.to_sum(); 3],
            integral: (command / ki).to_sum(),
            error_rate: S::ZERO,
            error_accel: S::ZERO,
            s: S::ZERO,
            command,
        }
    }

    /// What the state says for logs.
    pub(crate) fn telemetry(&self, state: &AxisState<S>) -> AxisTelemetry<S> {
        let gain_ratios = state.ratios.map(S::from_sum);
        let ([p, i, d], [rp, ri, rd]) = (self.start, gain_ratios);
        AxisTelemetry {
            command: state.command,
            gains: [p * rp, i * ri, d * rd],
            gain_ratios,
            integral: S::from_sum(state.integral),
            s: state.s,
            s_rate: state.error_accel + self.lambda * state.error_rate,
            layer: self.layer,
        }
    }

    /// The fast part of a tick: filters the errors and commands with the present gains. Returns u.
    #[inline(always)]
    pub(crate) fn command(&self, state: &mut AxisState<S>, input: &AxisInput<S>, low_pass: &LowPass<S>) -> S {
        let slope = low_pass.step(&mut state.error_rate, input.error_rate);
        low_pass.step(&mut state.error_accel, input.error_accel.unwrap_or(slope));
        let Regressor { terms: [p, i, d], s, .. } = self.regressor(state, input.error);
        let [rp, ri, rd] = state.ratios.map(S::from_sum);
        state.s = s;
        state.command = rp * p + ri * i + rd * d;
        state.command
    }

    /// The slow part: moves ∫e, then the gains, by what the last tick teaches.
    #[inline(always)]
    pub(crate) fn learn(&self, state: &mut AxisState<S>, lesson: &Lesson<S>) {
        let stuck = S::ZERO.lt(lesson.refused * lesson.error) | !lesson.integrate;
        let rate = S::select(stuck, S::ZERO, lesson.error);
        let bounds = (-self.integral_max, self.integral_max);
        state.integral = S::integrate(state.integral, rate, lesson.dt_s, bounds);

        let regressor = self.regressor(state, lesson.error);
        match &self.adaptation {
            Adaptation::Fixed => {}
            Adaptation::Raw(law) => law.adapt(&mut state.ratios, &regressor, lesson.dt_s),
            Adaptation::Lgs(law) => law.adapt(&mut state.ratios, &regressor, lesson),
        }
    }

    fn regressor(&self, state: &AxisState<S>, error: S) -> Regressor<S> {
        let pi = [error, S::from_sum(state.integral), state.error_rate];
        let [kp, ki, kd] = self.start;
        Regressor {
            pi,
            terms: [kp * pi[0], ki * pi[1], kd * pi[2]],
            error_accel: state.error_accel,
            s: state.error_rate + self.lambda * error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Airframe, Config};
    use std::format;

    const DT_S: f32 = 0.002;

    fn altitude(law: Law) -> (AxisLaw<f32>, AxisState<f32>) {
        let config = Config::flight(law, Airframe::paper(2.2));
        let law = AxisLaw::try_new("z", law, &config.gains.z).expect("the shipped gains");
        let state = law.state(5.0);
        (law, state)
    }

    /// A second below the setpoint by `error`, with the last command refused by `refused`.
    fn after_a_second(law: Law, error: f32, refused: f32) -> AxisTelemetry {
        let (law, mut state) = altitude(law);
        for _ in 0..500 {
            let input = AxisInput { error, error_rate: 0.0, error_accel: Some(0.0) };
            law.command(&mut state, &input, &LowPass::new(157.0, DT_S));
            law.learn(&mut state, &Lesson { error, refused, integrate: true, dt_s: DT_S });
        }
        law.telemetry(&state)
    }

    #[test]
    fn at_rest_the_integral_carries_the_command() {
        let (law, mut state) = altitude(Law::Lgs);
        let input = AxisInput { error: 0.0, error_rate: 0.0, error_accel: Some(0.0) };
        let command = law.command(&mut state, &input, &LowPass::new(157.0, DT_S));
        assert!((command - 5.0).abs() < 1e-6);
    }

    #[test]
    fn gains_rise_when_the_machine_is_too_low_and_fall_when_too_high() {
        let [_, low, _] = after_a_second(Law::Lgs, 0.1, 0.0).gain_ratios;
        let [_, high, _] = after_a_second(Law::Lgs, -0.1, 0.0).gain_ratios;
        assert!(low > 1.1 && high < 0.9, "{low} {high}");
    }

    #[test]
    fn nothing_is_learnt_inside_the_dead_zone() {
        let AxisTelemetry { gain_ratios, s, .. } = after_a_second(Law::Lgs, 1e-3, 0.0);
        assert!(s > 0.0);
        assert_eq!(gain_ratios, [1.0; 3]);
    }

    #[test]
    fn integral_and_gains_wait_while_they_would_push_into_saturation() {
        let free = after_a_second(Law::Lgs, 0.1, 0.0);
        let stuck = after_a_second(Law::Lgs, 0.1, 1.0);
        let other_way = after_a_second(Law::Lgs, 0.1, -1.0);
        assert_eq!(stuck.gain_ratios, [1.0; 3]);
        assert!(stuck.command < free.command);
        assert_eq!(format!("{other_way:?}"), format!("{free:?}"), "saturation the other way does not matter");
    }

    #[test]
    fn gains_stop_at_their_bounds_and_say_so() {
        let (law, mut state) = altitude(Law::Lgs);
        for _ in 0..100_000 {
            law.learn(&mut state, &Lesson { error: 5.0, refused: 0.0, integrate: true, dt_s: DT_S });
        }
        let high = law.telemetry(&state);
        assert_eq!(high.gain_ratios[1], GAIN_RATIO_MAX);
        assert!(high.at_bound()[1] && !after_a_second(Law::Lgs, 1e-3, 0.0).at_bound()[1]);
    }

    /// What an axis thinks after half a second of an error with this motion.
    fn moving(error: f32, error_rate: f32, error_accel: f32) -> AxisTelemetry {
        let (law, mut state) = altitude(Law::Pid);
        for _ in 0..250 {
            let input = AxisInput { error, error_rate, error_accel: Some(error_accel) };
            law.command(&mut state, &input, &LowPass::new(157.0, DT_S));
        }
        law.telemetry(&state)
    }

    #[test]
    fn the_alarm_is_for_a_v_that_rises_outside_the_boundary_layer() {
        for (why, motion, want) in [
            ("far off and coming nearer", moving(0.2, -0.5, 1.0), false),
            ("far off and leaving", moving(0.2, 0.5, 0.0), true),
            ("far off on the other side and leaving", moving(-0.2, -0.5, 0.0), true),
            ("leaving, but inside the layer", moving(0.02, 0.05, 0.0), false),
            ("at rest", moving(0.0, 0.0, 0.0), false),
        ] {
            assert_eq!(motion.v_rises(), want, "{why}: {motion:?}");
        }
        let AxisTelemetry { s, s_rate, .. } = moving(0.2, 0.5, 0.3);
        assert!((s - 1.3).abs() < 1e-5 && (s_rate - 2.3).abs() < 1e-5, "{s} {s_rate}");
    }

    #[test]
    fn fixed_gains_stay_and_printed_ones_have_no_bound() {
        assert_eq!(after_a_second(Law::Pid, 0.5, 0.0).gain_ratios, [1.0; 3]);
        assert!(after_a_second(Law::Raw, 0.5, 0.0).gain_ratios[0] > GAIN_RATIO_MAX);
    }
}
