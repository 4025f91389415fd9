//! The tick of a controller that watches its rotors: the same cascade on what is known of them, or the spin without it.
//!
//! | from    | to      | when                                                                                          |
//! |---------|---------|-----------------------------------------------------------------------------------------------|
//! | cascade | spin    | a rotor surely makes less than 0.7 of what a heading needs; or less than that, and the body turns |
//! | spin    | healed  | the rotor makes 1.1 times what a heading needs: the lean is given up, the turning braked        |
//! | healed  | spin    | it does not any more                                                                            |
//! | healed  | cascade | the body hardly turns                                                                           |
//!
//! What a heading needs of each rotor is a quarter of the weight, 1/R of its maximum with R the thrust-to-weight ratio. Altitude
//! is held by the same law throughout; place and heading keep what they had learnt before.
use super::{Controller, Errors, State};
use crate::guidance::Angles;
use crate::rotors::Rotors;
use crate::signals::Input;
use crate::spin::{SpinInput, Wanted};
use crate::{Demand, Scalar};

impl<S: Scalar> Controller<S> {
    #[cold]
    #[inline(never)]
    pub(super) fn advance_watching(
        &self,
        rotors: &Rotors<S>,
        state: &mut State<S>,
        input: &Input<S>,
        angles: &Angles<S>,
        errors: &Errors<S>,
        dt_s: S,
    ) {
        let rate = input.rate_rad_s;
        let coupling = self.coupling.torque_nm(rate) + rotors.gyroscopic_nm(&mut state.rotors, rate);
        let force_m_s2 = input.specific_force_m_s2.z;
        let residual = rotors.observe(&mut state.rotors, &state.output.thrust_n, rate, coupling, force_m_s2, dt_s);
        let spinning = rotors.next_spinning(&state.rotors, rate.z);
        state.rotors.spinning = spinning;
        let demand = if let (Some(spin), Some(mut spinning)) = (&rotors.spin, spinning) {
            let up_n = self.altitude(state, errors, dt_s);
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
            let wanted = self.wanted(state, rate, angles, errors, dt_s);
            rotors.demand(&wanted.with_torque(coupling), &residual)
        };
        let demand = rotors.less_stuck(&state.rotors, &demand);
        let mut allocation = self.allocator.allocate_weakened(&demand, &state.rotors.shares);
        rotors.tell_stuck(&state.rotors, &mut allocation.thrust_n);
        state.take(allocation);
    }
}
