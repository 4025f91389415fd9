//! Rotors that are stuck: what they make is taken off the demand, and they are told what shows that they are well again.
use super::{Column, Rotors, RotorsState};
use crate::{Demand, Scalar};

impl<S: Scalar> Rotors<S> {
    /// What of `demand` is left for the rotors that are not stuck.
    pub(crate) fn less_stuck(&self, state: &RotorsState<S>, demand: &Demand<S>) -> Demand<S> {
        let mut left = *demand;
        if state.health.has_stuck() {
            for j in 0..4 {
                if !state.health.is_stuck(j) {
                    continue;
                }
                let Column([roll, pitch, _]) = self.columns[j];
                let thrust_n = state.stuck_n[j];
                left.thrust_n = left.thrust_n - thrust_n;
                left.roll_nm = left.roll_nm - self.inertia_kg_m2[0] * roll * thrust_n;
                left.pitch_nm = left.pitch_nm - self.inertia_kg_m2[1] * pitch * thrust_n;
                left.yaw_nm = left.yaw_nm - self.turning_m[j] * thrust_n;
            }
        }
        left
    }

    /// Tells stuck rotors what a healthy one would do in a hover: when they do it, they are not stuck any more.
    pub(crate) fn tell_stuck(&self, state: &RotorsState<S>, thrust_n: &mut [S; 4]) {
        if state.health.has_stuck() {
            for (j, thrust_n) in thrust_n.iter_mut().enumerate() {
                if state.health.is_stuck(j) {
                    *thrust_n = self.quarter_n;
                }
            }
        }
    }
}
