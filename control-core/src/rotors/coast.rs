//! A tick without an inertial sample: what the rotors do meanwhile is known, what the body does is not.
//!
//! ```text
//! made    as commanded, through the motors' lag
//! rate    += predicted Δt,   predicted += Δ made        so that the next sample is felt as what it differs by from this
//! ```
//!
//! Otherwise a rate that stands still while torque is commanded would look like rotors that are lost.
use super::{Column, Rotors, RotorsState};
use crate::Scalar;
use crate::filter::LowPass;

impl<S: Scalar> Rotors<S> {
    /// A tick without a sample: the rotors follow their commands, the body is taken to turn as they make it, and nothing is felt.
    pub(crate) fn coast(&self, state: &mut RotorsState<S>, command_n: &[S; 4], dt_s: S) {
        let motor = LowPass::new(S::ONE / state.lag.lag_s(), dt_s);
        let filter = LowPass::new(self.filter_rad_s, dt_s);
        let before = state.tilting_rad_s2;
        state.tilting_rad_s2 = [S::ZERO; 2];
        for (j, &command_n) in command_n.iter().enumerate() {
            motor.step(&mut state.made_n[j], command_n);
            filter.step(&mut state.felt_n[j], state.made_n[j]);
            let thrust_n = state.shares[j] * state.made_n[j] + state.stuck_n[j];
            let Column([roll, pitch, _]) = self.columns[j];
            let [about_x, about_y] = state.tilting_rad_s2;
            state.tilting_rad_s2 = [about_x + roll * thrust_n, about_y + pitch * thrust_n];
        }
        let axes = state.predicted.iter_mut().zip(&mut state.rate_rad_s);
        for ((predicted, rate_rad_s), (after, before)) in axes.zip(state.tilting_rad_s2.into_iter().zip(before)) {
            *predicted = *predicted + after - before;
            *rate_rad_s = *rate_rad_s + *predicted * dt_s;
        }
    }
}
