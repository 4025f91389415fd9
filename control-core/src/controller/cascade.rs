//! The cascade of one tick: position and heading errors to what is wanted of the body.
use super::{AXES, Controller, Errors, State};
use crate::attitude::AttitudeInput;
use crate::config::Cascade;
use crate::filter::LowPass;
use crate::frames::{Body, Vec3};
use crate::guidance::{Angles, Inner, Outer};
use crate::law::{AxisInput, Lesson};
use crate::{Demand, Mask, Scalar};

/// |e_z| below which the altitude integral moves, m: a climb does not wind it up.
const INTEGRAL_GATE_M: f32 = 0.5;

/// Altitude's place among the axes.
const Z: usize = 2;
/// Heading's.
pub(super) const PSI: usize = 3;

/// What an axis is to learn from a tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Taught<S: Scalar> {
    pub(super) axis: usize,
    pub(super) lesson: Lesson<S>,
}

impl<S: Scalar> Controller<S> {
    /// Thrust and torques, the body's own coupling not yet taken away. What is to be learnt is learnt at once, or, if there is more to
    /// [`Controller::reflect`] on, `LATER`.
    #[inline(always)]
    pub(super) fn wanted<const LATER: bool>(
        &self,
        state: &mut State<S>,
        rate: Vec3<Body, S>,
        angles: &Angles<S>,
        errors: &Errors<S>,
        dt_s: S,
    ) -> Demand<S> {
        let (outer, heading_nm) = self.command(state, errors, dt_s);
        let braking = self.braking(state, errors.yaw_rad, rate.z, dt_s);
        self.learn_in_turn::<LATER>(state, errors, braking, dt_s);
        let inner = self.guidance.convert(&outer, angles);
        let [roll_nm, pitch_nm] = self.inner(state, rate, angles, &inner, dt_s);
        state.tilt_setpoint_rad = [inner.roll_rad, inner.pitch_rad];
        state.refused_m_s2 = [inner.refused_north_m_s2, inner.refused_east_m_s2];
        let yaw_nm = S::select(braking, self.brake_nm(rate.z), heading_nm);
        Demand { thrust_n: inner.thrust_n, roll_nm, pitch_nm, yaw_nm }
    }

    /// The fast part of the four adaptive axes: accelerations north and east, force up; and the yaw torque.
    #[inline(always)]
    pub(super) fn command(&self, state: &mut State<S>, errors: &Errors<S>, dt_s: S) -> (Outer<S>, S) {
        let low_pass = LowPass::new(self.filter_rad_s, dt_s);
        let Errors { position_m: e, velocity_m_s: v, acceleration_m_s2: a, yaw_rad, yaw_rate_rad_s } = *errors;
        let [x, y, z, psi] = &self.axes;
        let [x_state, y_state, z_state, psi_state] = &mut state.axes;
        let input = |error, error_rate, error_accel| AxisInput { error, error_rate, error_accel };
        let outer = Outer {
            north_m_s2: x.command(x_state, &input(e.x, v.x, Some(a.x)), &low_pass),
            east_m_s2: y.command(y_state, &input(e.y, v.y, Some(a.y)), &low_pass),
            up_n: z.command(z_state, &input(-e.z, -v.z, Some(-a.z)), &low_pass),
        };
        (outer, psi.command(psi_state, &input(yaw_rad, yaw_rate_rad_s, None), &low_pass))
    }

    /// The force up, N, of a machine whose place and heading others hold; and what is to be learnt, by altitude alone.
    #[inline(always)]
    pub(super) fn altitude(&self, state: &mut State<S>, errors: &Errors<S>, dt_s: S) -> (S, Taught<S>) {
        let (outer, _) = self.command(state, errors, dt_s);
        (outer.up_n, Taught { axis: Z, lesson: self.altitude_lesson(state, errors, dt_s) })
    }

    /// Torque that only stops the body from turning, N m.
    pub(super) fn brake_nm(&self, yaw_rate_rad_s: S) -> S {
        -self.yaw_brake_nm_s * yaw_rate_rad_s
    }

    /// The slow part of the axes: one a tick in turn, by the time since its last turn; under the paper's law all of
    /// them, at once, as printed.
    #[inline(always)]
    fn learn_in_turn<const LATER: bool>(&self, state: &mut State<S>, errors: &Errors<S>, braking: S::Mask, dt_s: S) {
        if !self.in_turn {
            for axis in 0..AXES {
                self.learn_axis(axis, state, errors, braking, dt_s);
            }
            return;
        }
        let axis = state.turn % AXES;
        state.turn = axis + 1;
        state.ticks_s[axis] = dt_s;
        let [a, b, c, d] = state.ticks_s;
        // In pairs: equal ticks add up without rounding.
        let since_s = (a + b) + (c + d);
        if LATER {
            state.taught = Some(Taught { axis, lesson: self.lesson(axis, state, errors, braking, since_s) });
        } else {
            self.learn_axis(axis, state, errors, braking, since_s);
        }
    }

    /// Moves one axis by what it was taught.
    #[inline(always)]
    pub(super) fn learn(&self, state: &mut State<S>, axis: usize, lesson: &Lesson<S>) {
        if let (Some(law), Some(state)) = (self.axes.get(axis), state.axes.get_mut(axis)) {
            law.learn(state, lesson);
        }
    }

    /// The slow part of altitude alone.
    pub(super) fn learn_altitude(&self, state: &mut State<S>, errors: &Errors<S>, since_s: S) {
        let lesson = self.altitude_lesson(state, errors, since_s);
        self.axes[Z].learn(&mut state.axes[Z], &lesson);
    }

    #[inline(always)]
    fn altitude_lesson(&self, state: &State<S>, errors: &Errors<S>, dt_s: S) -> Lesson<S> {
        let down_m = errors.position_m.z;
        Lesson {
            error: -down_m,
            refused: state.refused.thrust_n,
            integrate: down_m.abs().lt(S::from_f32(INTEGRAL_GATE_M)) | self.always_integrates,
            dt_s,
        }
    }

    /// The slow part of one axis, x, y, z or psi.
    pub(super) fn learn_axis(
        &self,
        axis: usize,
        state: &mut State<S>,
        errors: &Errors<S>,
        braking: S::Mask,
        since_s: S,
    ) {
        let lesson = self.lesson(axis, state, errors, braking, since_s);
        self.learn(state, axis, &lesson);
    }

    /// What one axis is to learn. Heading learns nothing while the guard brakes.
    #[inline(always)]
    fn lesson(&self, axis: usize, state: &State<S>, errors: &Errors<S>, braking: S::Mask, since_s: S) -> Lesson<S> {
        let error = errors.position_m;
        let lesson = |error, refused| Lesson { error, refused, integrate: S::Mask::splat(true), dt_s: since_s };
        match axis {
            0 => lesson(error.x, state.refused_m_s2[0]),
            1 => lesson(error.y, state.refused_m_s2[1]),
            Z => self.altitude_lesson(state, errors, since_s),
            _ => Lesson { dt_s: S::select(braking, S::ZERO, since_s), ..lesson(errors.yaw_rad, state.refused.yaw_nm) },
        }
    }

    /// The torques that roll and pitch want.
    #[inline(always)]
    pub(super) fn inner(
        &self,
        state: &mut State<S>,
        rate: Vec3<Body, S>,
        angles: &Angles<S>,
        setpoint: &Inner<S>,
        dt_s: S,
    ) -> [S; 2] {
        let [roll_integral, pitch_integral] = &mut state.tilt_integrals;
        let roll = AttitudeInput {
            error_rad: setpoint.roll_rad - angles.roll_rad,
            rate_rad_s: rate.x,
            refused_nm: state.refused.roll_nm,
            dt_s,
        };
        let pitch = AttitudeInput {
            error_rad: setpoint.pitch_rad - angles.pitch_rad,
            rate_rad_s: rate.y,
            refused_nm: state.refused.pitch_nm,
            dt_s,
        };
        [self.roll.step(roll_integral, &roll), self.pitch.step(pitch_integral, &pitch)]
    }

    pub(super) fn braking(&self, state: &mut State<S>, error_rad: S, rate_rad_s: S, dt_s: S) -> S::Mask {
        match self.cascade {
            Cascade::Paper => S::Mask::splat(false),
            Cascade::Flight => state.guard.step(error_rad, rate_rad_s, state.refused.yaw_nm, dt_s),
        }
    }
}
