//! The rotors' lag, learnt: what of the residual follows the slope of the thrusts is a wrong lag.
//!
//! ```text
//! ∂/∂τ 1/(1 + τ s) = −s/(1 + τ s)²     so     x ≈ −ψ (τ − τ̂),   ψ = filter(lag(ṁ))     τ̂ ← τ̂ − ψ x dt / J,   J = ∫ψ²
//! ```
//!
//! Least squares with forgetting, on roll and pitch together, only where ψ is far above what the gyro's noise makes of it by way of the
//! commands: that part is correlated with the residual's own noise, and would pull the lag down. So it takes a manoeuvre.
use crate::filter::LowPass;
use crate::{Mask, Scalar};

/// Range of the lag, s: below, one tick is as long; above, nothing flies.
const LAG_S: (f32, f32) = (0.005, 0.15);
/// How long what was seen in manoeuvres counts, s of manoeuvre.
const MEMORY_S: f32 = 20.0;
/// ∫ψ² that the first guess is worth, (rad/s³)² s.
const FIRST_GUESS: f32 = 150.0;
/// ψ below which nothing is learnt, rad/s³.
const EXCITED: f32 = 60.0;
/// Units in which ψ is squared: fixed point holds a thousand of them.
const UNIT: f32 = 32.0;

/// What is known of the lag.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lag<S: Scalar> {
    /// τ̂, s.
    constant_s: S::Sum,
    information: S::Sum,
    once: [S; 2],
    twice: [S; 2],
}

impl<S: Scalar> Lag<S> {
    pub(super) fn new(lag_s: S) -> Self {
        Self { constant_s: lag_s.to_sum(), information: S::ZERO.to_sum(), once: [S::ZERO; 2], twice: [S::ZERO; 2] }
    }

    /// τ̂, to be kept.
    pub(super) fn constant_mut(&mut self) -> &mut S::Sum {
        &mut self.constant_s
    }

    pub(super) fn lag_s(&self) -> S {
        S::from_sum(self.constant_s)
    }

    /// Takes the slope of the believed acceleration, rad/s³, and the residual, rad/s², about roll and pitch; `calm` says whether
    /// nothing else can explain the residual.
    pub(super) fn learn(
        &mut self,
        slope: [S; 2],
        residual: [S; 2],
        motor: &LowPass<S>,
        filter: &LowPass<S>,
        calm: impl FnOnce() -> bool,
        dt_s: S,
    ) {
        let s = S::from_f32;
        let mut square = S::ZERO;
        let mut product = S::ZERO;
        for axis in 0..2 {
            motor.step(&mut self.once[axis], slope[axis] * s(1.0 / UNIT));
            filter.step(&mut self.twice[axis], self.once[axis]);
            square = square + self.twice[axis] * self.twice[axis];
            product = product + self.twice[axis] * residual[axis];
        }
        if s(EXCITED * EXCITED / (UNIT * UNIT)).lt(square).all() && calm() {
            let known = S::from_sum(self.information);
            let rate = square - known * s(1.0 / MEMORY_S);
            self.information = S::integrate(self.information, rate, dt_s, (S::ZERO, s(1000.0)));
            let change = -product / ((known + s(FIRST_GUESS / (UNIT * UNIT))) * s(UNIT));
            self.constant_s = S::integrate(self.constant_s, change, dt_s, (s(LAG_S.0), s(LAG_S.1)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is learnt of a rotor of `true_s` in ten seconds of commands that change by `step` every 0.2 s, believed to be of 20 ms.
    fn learnt(true_s: f32, step: f32, calm: bool) -> f32 {
        let dt_s = 0.002;
        let filter = LowPass::new(94.0, dt_s);
        let mut lag = Lag::new(0.02_f32);
        let (mut real, mut model, mut real_felt, mut model_felt) = (0.0_f32, 0.0, 0.0, 0.0);
        for tick in 0..5000 {
            let command = if tick / 100 % 2 == 0 { step } else { 0.0 };
            LowPass::new(1.0 / true_s, dt_s).step(&mut real, command);
            let motor = LowPass::new(1.0 / lag.lag_s(), dt_s);
            let slope = motor.step(&mut model, command);
            filter.step(&mut real_felt, real);
            filter.step(&mut model_felt, model);
            lag.learn([slope, 0.0], [real_felt - model_felt, 0.0], &motor, &filter, || calm, dt_s);
        }
        lag.lag_s()
    }

    #[test]
    fn manoeuvres_teach_the_lag_and_noise_does_not() {
        for true_s in [0.01, 0.02, 0.05, 0.1] {
            let found = learnt(true_s, 10.0, true);
            assert!((found - true_s).abs() < 0.2 * true_s, "{true_s}: {found}");
        }
        assert_eq!(learnt(0.05, 0.5, true), 0.02, "too little happens");
        assert_eq!(learnt(0.05, 10.0, false), 0.02, "something else is wrong");
    }
}
