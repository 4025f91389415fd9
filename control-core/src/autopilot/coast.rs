//! A step without an inertial sample.
use super::signals::{Acted, Plan};
use super::{Autopilot, AutopilotState};
use crate::estimate::Estimate;
use crate::{Output, Target};

impl Autopilot {
    /// What [`Self::act`] is to a sample, where none has come: in the air the thrusts stay, or the machine coasts where that is planned.
    ///
    /// - `estimate`: the one before.
    #[cold]
    #[inline(never)]
    pub fn coast(&self, state: &mut AutopilotState, estimate: &Estimate, dt_s: f32) -> [f32; 4] {
        let level = match state.plan {
            Plan::Turn(_) | Plan::Fly(Target::Ground { .. }, _) => return self.act(state, estimate, dt_s),
            Plan::Fly(ref target, _) => matches!(target, Target::Coast),
        };
        let Output { thrust_n, rejected } = self.controller.coast(&mut state.controller, level, self.lasted_s(dt_s));
        state.acted = Acted { motors: self.shares(&thrust_n), thrust_n, rejected };
        state.acted.motors
    }
}
