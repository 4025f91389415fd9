//! The tick of a controller that watches its rotors: the same cascade on what is known of them, or the spin without it.
//!
//! | from    | to      | when                                                                                          |
//! |---------|---------|-----------------------------------------------------------------------------------------------|
//! | cascade | spin    | a rotor surely makes less than 0.7 of what a heading needs; or less than that, and the body turns |
//! | spin    | healed  | the rotor makes 1.1 times what a heading needs: the lean is given up, the turning braked        |
//! | healed  | spin    | it does not any more                                                                            |
//! | healed  | cascade | the body hardly turns                                                                           |
//!
//! A machine on two rotors is led down at [`SINK_M_S`]: their torque spins it up beyond what a gyro measures, and one whose inertia about
//! the vertical is the sum of the others cannot be steered at all. If the rotors come back it is led up again.
//!
//! What a heading needs of each rotor is a quarter of the weight, 1/R of its maximum with R the thrust-to-weight ratio. Altitude
//! is held by the same law throughout; place and heading keep what they had learnt before.
use super::cascade::Taught;
use super::{Controller, Errors, State};
use crate::frames::{Body, Vec3};
use crate::guidance::Angles;
use crate::rotors::{Residual, Rotors, RotorsState};
use crate::signals::Input;
use crate::spin::{SpinInput, Wanted};
use crate::{Demand, Mask, Scalar};
use core::hint::cold_path;

/// Speed at which a machine on two rotors is led down, m/s: its feet bear 2.
const SINK_M_S: f32 = 1.4;

impl<S: Scalar> Controller<S> {
    #[cold]
    #[inline(never)]
    pub(super) fn advance_watching(
        &self,
        rotors: &Rotors<S>,
        state: &mut State<S>,
        input: &Input<S>,
        angles: &Angles<S>,
        errors: &mut Errors<S>,
        dt_s: S,
    ) {
        let rate = input.rate_rad_s;
        let (coupling, residual) = self.feel(rotors, state, input, dt_s);
        let demand = if let (Some(spin), Some(mut spinning)) = (&rotors.spin, state.rotors.spinning) {
            errors.lead_down(&mut state.rotors, spinning.pair, dt_s);
            let (up_n, taught) = self.altitude(state, errors, dt_s);
            state.taught = Some(taught);
            spinning.advance(input, &residual, dt_s);
            state.rotors.spinning = Some(spinning);
            let wanted = Wanted {
                error_m: errors.position_m,
                error_m_s: errors.velocity_m_s,
                forward_m_s2: input.setpoint.acceleration_m_s2,
            };
            let (pointing, thrust_n) = spin.aim(&spinning, &wanted, up_n, rate.z, &input.attitude);
            let tilting_rad_s2 = state.rotors.tilting_rad_s2;
            let [roll_nm, pitch_nm] = spin.torque_nm(&spinning, &SpinInput { tilting_rad_s2, pointing, rate });
            Demand { thrust_n, roll_nm, pitch_nm, yaw_nm: self.brake_nm(rate.z) }
        } else {
            errors.lead_down(&mut state.rotors, false, dt_s);
            let wanted = self.wanted::<true>(state, rate, angles, errors, dt_s);
            rotors.demand(&wanted.with_torque(coupling), &residual)
        };
        self.share_out(rotors, state, &demand);
    }

    #[cold]
    #[inline(never)]
    pub(super) fn reflect_watching(&self, rotors: &Rotors<S>, state: &mut State<S>) {
        rotors.reflect(&mut state.rotors);
        if let Some(Taught { axis, lesson }) = state.taught.take() {
            self.learn(state, axis, &lesson);
        }
    }

    /// The torque that the body's own turning takes, and what nothing known explains.
    #[inline(always)]
    pub(super) fn feel(
        &self,
        rotors: &Rotors<S>,
        state: &mut State<S>,
        input: &Input<S>,
        dt_s: S,
    ) -> (Vec3<Body, S>, Residual<S>) {
        let rate = input.rate_rad_s;
        let coupling = self.coupling.torque_nm(rate) + Rotors::gyroscopic_nm(&state.rotors, rate);
        let force_m_s2 = input.specific_force_m_s2.z;
        (coupling, rotors.observe(&mut state.rotors, &state.output.thrust_n, rate, coupling, force_m_s2, dt_s))
    }

    /// Shares a demand out among what each rotor still makes.
    #[inline(always)]
    pub(super) fn share_out(&self, rotors: &Rotors<S>, state: &mut State<S>, demand: &Demand<S>) {
        let demand = rotors.less_stuck(&state.rotors, demand);
        let mut allocation = self.allocator.allocate_weakened(&demand, &state.rotors.shares);
        rotors.tell_stuck(&state.rotors, &mut allocation.thrust_n);
        state.take(allocation);
    }
}

impl<S: Scalar> Errors<S> {
    /// Makes them those of a machine that is led down while `sinking`, and up again after.
    #[inline(always)]
    fn lead_down(&mut self, rotors: &mut RotorsState<S>, sinking: bool, dt_s: S) {
        if sinking || S::ZERO.lt(rotors.sunk_m).all() {
            cold_path();
            let speed_m_s = S::from_f32(if sinking { SINK_M_S } else { -SINK_M_S });
            rotors.sunk_m = (rotors.sunk_m + speed_m_s * dt_s).max(S::ZERO);
            self.position_m.z = self.position_m.z + rotors.sunk_m;
            self.velocity_m_s.z = self.velocity_m_s.z + speed_m_s;
        }
    }
}
