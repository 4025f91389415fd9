//! One tick: sensors, setpoint and elapsed time in; rotor thrusts and telemetry out.
//!
//! ```text
//! position, velocity ── x, y, z, ψ laws ── guidance ── roll, pitch PIDs ─┐
//!                            │                                           ├─ allocation ── thrusts
//!                            └────────── yaw torque, yaw guard ──────────┘      │
//!                   ▲                                                           │
//!                   └───────────────── refused demand, next tick ───────────────┘
//! ```
//!
//! Invariants: thrusts stay within each rotor's limits; a sample that is not plausible changes nothing but
//! [`Output::rejected`], so the rotors keep their last command.
use crate::allocation::{Allocator, Demand};
use crate::attitude::{AttitudeInput, AttitudeLaw};
use crate::config::{Cascade, Config, ConfigError};
use crate::filter::LowPass;
use crate::frames::{Body, Ned, Vec3};
use crate::guidance::{Angles, Guidance, Inner, Outer};
use crate::law::{AxisInput, AxisLaw, AxisState, Law, Lesson};
use crate::math::wrap_pi;
use crate::rotors::{Rotors, RotorsState};
use crate::signals::{Input, Output, Telemetry};
use crate::spin::{Spin, SpinInput};
use crate::yaw_guard::YawGuard;
use crate::{GRAVITY_M_S2, Mask, Scalar};

/// Everything that changes in flight.
#[derive(Clone, Copy, Debug)]
pub struct State<S: Scalar = f32> {
    axes: [AxisState<S>; AXES],
    /// The axis that learns next.
    turn: usize,
    /// How long the last ticks were, one in each turn.
    ticks_s: [S; AXES],
    tilt_integrals: [S::Sum; 2],
    rotors: Option<RotorsState<S>>,
    spinning: Option<Spinning<S>>,
    guard: YawGuard<S>,
    tilt_setpoint_rad: [S; 2],
    /// What the tilt limit refused, north and east, m/s².
    refused_m_s2: [S; 2],
    /// What the allocation refused.
    refused: Demand<S>,
    output: Output<S>,
}

/// A checked configuration in the scalar that flies. Immutable: one may serve many states.
#[derive(Clone, Debug)]
pub struct Controller<S: Scalar = f32> {
    axes: [AxisLaw<S>; AXES],
    roll: AttitudeLaw<S>,
    pitch: AttitudeLaw<S>,
    guidance: Guidance<S>,
    allocator: Allocator<S>,
    /// Whether the axes learn in turn, or all in every tick.
    in_turn: bool,
    /// Whether the altitude integral moves far from the setpoint too.
    always_integrates: S::Mask,
    cascade: Cascade,
    coupling: Coupling<S>,
    rotors: Option<Rotors<S>>,
    spin: Option<Spin<S>>,
    mass_kg: S,
    hover_share: S,
    weight_n: S,
    yaw_brake_nm_s: S,
    filter_rad_s: S,
    dt_s_range: (S, S),
}

/// A flight that has given its heading up.
#[derive(Clone, Copy, Debug)]
struct Spinning<S> {
    /// The rotor that is gone.
    rotor: usize,
    /// Whether it works again and the body only has to stop turning.
    healed: bool,
    /// Horizontal push of the wind, north and east, m/s².
    wind_m_s2: [S; 2],
}

/// ω × I ω for principal axes, which the rigid body adds and the flight cascade takes away again.
#[derive(Clone, Debug)]
struct Coupling<S> {
    /// Iz − Iy, Ix − Iz, Iy − Ix; zero where nothing is fed forward.
    differences_kg_m2: [S; 3],
}

impl<S: Scalar> Coupling<S> {
    fn new(cascade: Cascade, [ix, iy, iz]: [f32; 3]) -> Self {
        let differences = match cascade {
            Cascade::Paper => [0.0; 3],
            Cascade::Flight => [iz - iy, ix - iz, iy - ix],
        };
        Self { differences_kg_m2: differences.map(S::from_f32) }
    }

    fn torque_nm(&self, rate: Vec3<Body, S>) -> Vec3<Body, S> {
        let [x, y, z] = self.differences_kg_m2;
        Vec3::new(x * rate.y * rate.z, y * rate.z * rate.x, z * rate.x * rate.y)
    }
}

/// What is wrong, before anything is done about it.
struct Errors<S> {
    position_m: Vec3<Ned, S>,
    velocity_m_s: Vec3<Ned, S>,
    acceleration_m_s2: Vec3<Ned, S>,
    yaw_rad: S,
    yaw_rate_rad_s: S,
}

/// Sum of squares above which a sample is taken for garbage: 20 km off, which no real one is. Q16.16 ends at 181 m.
const PLAUSIBLE_MAX: f32 = 4e8;
/// Difference from one at which the squared length of a row or column of the attitude is garbage.
const CROOKED_MAX: f32 = 0.02;

impl<S: Scalar> Errors<S> {
    fn of(input: &Input<S>, angles: &Angles<S>) -> Self {
        let setpoint = &input.setpoint;
        let gravity = Vec3::new(S::ZERO, S::ZERO, S::from_f32(GRAVITY_M_S2));
        let acceleration = input.attitude.to_ned(input.specific_force_m_s2) + gravity;
        Self {
            position_m: setpoint.position_m - input.position_m,
            velocity_m_s: setpoint.velocity_m_s - input.velocity_m_s,
            acceleration_m_s2: setpoint.acceleration_m_s2 - acceleration,
            yaw_rad: wrap_pi(setpoint.yaw_rad - angles.yaw_rad),
            yaw_rate_rad_s: setpoint.yaw_rate_rad_s - input.rate_rad_s.z,
        }
    }

    /// Whether every number behind these errors is finite and of a size that can be true, and the attitude a rotation.
    ///
    /// One sum of squares shows all sizes: NaN and infinity survive it, and the acceleration has every entry of the
    /// attitude.
    fn are_plausible(&self, input: &Input<S>) -> S::Mask {
        let [[r11, ..], [r21, ..], [r31, r32, r33]] = input.attitude.rows;
        let skew = Vec3::<Body, S>::new(r11, r21, r31).norm_squared() - S::ONE;
        let stretch = Vec3::<Body, S>::new(r31, r32, r33).norm_squared() - S::ONE;
        let crooked = skew * skew + stretch * stretch;
        let sum = self.position_m.norm_squared()
            + self.velocity_m_s.norm_squared()
            + self.acceleration_m_s2.norm_squared()
            + input.rate_rad_s.norm_squared()
            + self.yaw_rad * self.yaw_rad
            + self.yaw_rate_rad_s * self.yaw_rate_rad_s
            + input.dt_s * input.dt_s;
        // Each on its own scale: on one, the limit of the crooked would be beyond Q16.16.
        sum.lt(S::from_f32(PLAUSIBLE_MAX)) & crooked.lt(S::from_f32(CROOKED_MAX * CROOKED_MAX))
    }
}

/// Adaptive axes: x, y, z, psi.
const AXES: usize = 4;

/// |e_z| below which the altitude integral moves, m: a climb does not wind it up.
const INTEGRAL_GATE_M: f32 = 0.5;

/// Corner of the wind's estimate, rad/s: above the gusts, below the spin.
const WIND_RAD_S: f32 = 4.0;

impl<S: Scalar> Controller<S> {
    /// Checks `config` and builds the controller.
    ///
    /// # Errors
    /// [`ConfigError`] names the first field that cannot fly, its value and what is allowed.
    pub fn try_new(config: &Config) -> Result<Self, ConfigError> {
        config.check_rates()?;
        let Config { airframe, law, cascade, yaw_turns_thrust, rotors, spin, gains, control_hz, filter_hz } = *config;
        let s = S::from_f32;
        Ok(Self {
            allocator: Allocator::try_new(&airframe, cascade == Cascade::Flight)?,
            axes: [
                AxisLaw::try_new("x", law, &gains.x)?,
                AxisLaw::try_new("y", law, &gains.y)?,
                AxisLaw::try_new("z", law, &gains.z)?,
                AxisLaw::try_new("psi", law, &gains.psi)?,
            ],
            roll: AttitudeLaw::try_new("phi", &gains.phi)?,
            pitch: AttitudeLaw::try_new("theta", &gains.theta)?,
            guidance: Guidance::new(cascade, yaw_turns_thrust, airframe.mass_kg),
            in_turn: law != Law::Raw,
            always_integrates: S::Mask::splat(cascade == Cascade::Paper),
            cascade,
            coupling: Coupling::new(cascade, airframe.inertia_kg_m2),
            rotors: rotors.map(|config| Rotors::try_new(&config, &airframe, control_hz)).transpose()?,
            spin: spin.map(|config| Spin::new(&config, &airframe, 0.02, control_hz)),
            mass_kg: s(airframe.mass_kg),
            hover_share: s(airframe.weight_n() / airframe.rotors.iter().map(|r| r.thrust_n_max).sum::<f32>()),
            weight_n: s(airframe.weight_n()),
            yaw_brake_nm_s: s(gains.psi.k0[2]),
            filter_rad_s: s(core::f32::consts::TAU * filter_hz),
            dt_s_range: (s(0.25 / control_hz), s(4.0 / control_hz)),
        })
    }

    /// The state of a level hover: starting gains, the weight carried, every rotor at a quarter of it.
    pub fn hover_state(&self) -> State<S> {
        let carried_n = match self.cascade {
            Cascade::Paper => S::ZERO,
            Cascade::Flight => self.weight_n,
        };
        let [x, y, z, psi] = &self.axes;
        State {
            axes: [x.state(S::ZERO), y.state(S::ZERO), z.state(carried_n), psi.state(S::ZERO)],
            turn: 0,
            ticks_s: [S::ZERO; AXES],
            tilt_integrals: [S::ZERO.to_sum(); 2],
            rotors: self.rotors.as_ref().map(|rotors| rotors.state(self.weight_n * S::from_f32(0.25))),
            spinning: None,
            guard: YawGuard::new(),
            tilt_setpoint_rad: [S::ZERO; 2],
            refused_m_s2: [S::ZERO; 2],
            refused: Demand::NOTHING,
            output: Output { thrust_n: [self.weight_n * S::from_f32(0.25); 4], rejected: false },
        }
    }

    /// What the last tick thought.
    pub fn telemetry(&self, state: &State<S>) -> Telemetry<S> {
        let [x, y, z, psi] = &self.axes;
        let [sx, sy, sz, spsi] = &state.axes;
        Telemetry {
            axes: [x.telemetry(sx), y.telemetry(sy), z.telemetry(sz), psi.telemetry(spsi)],
            tilt_setpoint_rad: state.tilt_setpoint_rad,
            refused: state.refused,
            yaw_guard: state.guard.is_braking(),
            rotors: self.rotors.as_ref().zip(state.rotors.as_ref()).map(|(rotors, state)| rotors.telemetry(state)),
            spinning: state.spinning.map(|spinning| spinning.rotor),
        }
    }

    /// Tells the controller what somebody else knows of the rotors: a speed sensor, a pilot, the simulator.
    ///
    /// - `shares`: of its commanded thrust that each rotor makes, 0 to 1; `None` where nothing is known.
    ///
    /// Holds until told otherwise. A controller that takes the rotors as commanded does not listen.
    pub fn report(&self, state: &mut State<S>, shares: [Option<S>; 4]) {
        if let (Some(rotors), Some(watch)) = (&self.rotors, &mut state.rotors) {
            rotors.listen(watch, shares);
        }
    }

    /// Runs the whole controller once.
    ///
    /// - `state`: of this controller, from [`Self::hover_state`] or the last tick.
    /// - Returns the thrusts, which live in the state until the next tick; see [`Self::telemetry`] for the rest.
    ///
    /// A sample that is not plausible leaves the state and the thrusts as they were and sets [`Output::rejected`].
    /// A vector of flights is held as one: whoever batches them takes a flight that is lost out of the batch.
    pub fn tick<'a>(&self, state: &'a mut State<S>, input: &Input<S>) -> &'a Output<S> {
        let angles = Angles::of(&input.attitude);
        let errors = Errors::of(input, &angles);
        state.output.rejected = !errors.are_plausible(input).all();
        if !state.output.rejected {
            self.advance(state, input, &angles, &errors);
        }
        &state.output
    }

    fn advance(&self, state: &mut State<S>, input: &Input<S>, angles: &Angles<S>, errors: &Errors<S>) {
        let dt_s = input.dt_s.clamp(self.dt_s_range.0, self.dt_s_range.1);
        if self.rotors.is_some() {
            self.advance_watching(state, input, angles, errors, dt_s);
            return;
        }
        let wanted = self.wanted(state, input.rate_rad_s, angles, errors, dt_s);
        let coupling = self.coupling.torque_nm(input.rate_rad_s);
        let allocation = self.allocator.allocate(&Demand {
            roll_nm: wanted.roll_nm + coupling.x,
            pitch_nm: wanted.pitch_nm + coupling.y,
            yaw_nm: wanted.yaw_nm + coupling.z,
            ..wanted
        });
        state.refused = allocation.refused;
        state.output.thrust_n = allocation.thrust_n;
    }

    /// What the cascade wants of the body.
    #[inline]
    fn wanted(
        &self,
        state: &mut State<S>,
        rate: Vec3<Body, S>,
        angles: &Angles<S>,
        errors: &Errors<S>,
        dt_s: S,
    ) -> Demand<S> {
        let (outer, heading_nm) = self.outer(state, rate, errors, dt_s);
        let inner = self.guidance.convert(&outer, angles);
        let torque = self.inner(state, rate, angles, &inner, dt_s);
        state.tilt_setpoint_rad = [inner.roll_rad, inner.pitch_rad];
        state.refused_m_s2 = [inner.refused_north_m_s2, inner.refused_east_m_s2];
        Demand { thrust_n: inner.thrust_n, roll_nm: torque.x, pitch_nm: torque.y, yaw_nm: heading_nm }
    }

    /// The same with an eye on the rotors.
    #[inline(never)]
    fn advance_watching(
        &self,
        state: &mut State<S>,
        input: &Input<S>,
        angles: &Angles<S>,
        errors: &Errors<S>,
        dt_s: S,
    ) {
        let Some(rotors) = &self.rotors else { return };
        let Some(mut watch) = state.rotors else { return };
        let rate = input.rate_rad_s;
        let coupling = self.coupling.torque_nm(rate);
        let residual =
            rotors.observe(&mut watch, &state.output.thrust_n, rate, coupling, input.specific_force_m_s2.z, dt_s);
        state.spinning = self.next_spinning(state.spinning, &watch, rate.z);
        let demand = if let (Some(spinning), Some(spin)) = (state.spinning, &self.spin) {
            self.pointed(state, input, errors, spin, spinning, rotors.tilting_rad_s2(&watch), residual.0[2], dt_s)
        } else {
            let wanted = self.wanted(state, rate, angles, errors, dt_s);
            let wanted = Demand {
                roll_nm: wanted.roll_nm + coupling.x,
                pitch_nm: wanted.pitch_nm + coupling.y,
                yaw_nm: wanted.yaw_nm + coupling.z,
                ..wanted
            };
            rotors.demand(&wanted, &residual)
        };
        let allocation = self.allocator.allocate_weakened(&demand, &watch.shares);
        state.refused = allocation.refused;
        state.output.thrust_n = allocation.thrust_n;
        state.rotors = Some(watch);
    }

    /// Whether to spin, and for which rotor.
    fn next_spinning(&self, now: Option<Spinning<S>>, watch: &RotorsState<S>, yaw_rate: S) -> Option<Spinning<S>> {
        let s = S::from_f32;
        self.spin.as_ref()?;
        let mut weakest = 0;
        for j in 1..4 {
            if watch.shares[j].lt(watch.shares[weakest]).all() {
                weakest = j;
            }
        }
        let share = watch.shares[weakest];
        match now {
            None => {
                let limit = s(0.7) * self.hover_share;
                let sure = share + s(2.0) * watch.health.uncertainty(weakest);
                let fast = s(8.0).lt(yaw_rate.abs()) & share.lt(self.hover_share);
                (sure.lt(limit) | fast).all().then_some(Spinning { rotor: weakest, healed: false, wind_m_s2: [S::ZERO; 2] })
            }
            Some(spinning) => {
                let share = watch.shares[spinning.rotor];
                let healed = s(1.1).lt(share / self.hover_share).all();
                if healed && yaw_rate.abs().lt(s(2.0)).all() {
                    return None;
                }
                Some(Spinning { healed, ..spinning })
            }
        }
    }

    /// Demand of the spin: thrust that points where the position wants it.
    #[expect(clippy::too_many_arguments)]
    fn pointed(
        &self,
        state: &mut State<S>,
        input: &Input<S>,
        errors: &Errors<S>,
        spin: &Spin<S>,
        spinning: Spinning<S>,
        tilting_rad_s2: [S; 2],
        residual_z: S,
        dt_s: S,
    ) -> Demand<S> {
        let (outer, _) = self.outer(state, input.rate_rad_s, errors, dt_s);
        let felt = input.specific_force_m_s2;
        let push = input.attitude.to_ned(Vec3::new(felt.x, felt.y, residual_z));
        let calm = LowPass::new(S::from_f32(WIND_RAD_S), dt_s);
        if let Some(Spinning { wind_m_s2: [north, east], .. }) = &mut state.spinning {
            calm.step(north, push.x);
            calm.step(east, push.y);
        }
        let (pointing, thrust_n) =
            spin.aim(errors.position_m, errors.velocity_m_s, spinning.wind_m_s2, outer.up_n, &input.attitude);
        let [roll_nm, pitch_nm] = spin.torque_nm(&SpinInput {
            rotor: spinning.rotor,
            healed: spinning.healed,
            tilting_rad_s2,
            pointing,
            rate: input.rate_rad_s,
        });
        Demand { thrust_n, roll_nm, pitch_nm, yaw_nm: -self.yaw_brake_nm_s * input.rate_rad_s.z }
    }

    /// The four adaptive axes: accelerations north and east, force up; and the yaw torque.
    fn outer(&self, state: &mut State<S>, rate: Vec3<Body, S>, errors: &Errors<S>, dt_s: S) -> (Outer<S>, S) {
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
        let heading_nm = psi.command(psi_state, &input(yaw_rad, yaw_rate_rad_s, None), &low_pass);
        let braking = self.braking(state, yaw_rad, rate.z, dt_s);
        self.learn(state, errors, braking, dt_s);
        (outer, S::select(braking, -self.yaw_brake_nm_s * rate.z, heading_nm))
    }

    /// The slow part of the axes: one a tick in turn, by the time since its last turn; under the paper's law all of
    /// them, as printed.
    fn learn(&self, state: &mut State<S>, errors: &Errors<S>, braking: S::Mask, dt_s: S) {
        if self.in_turn {
            let turn = state.turn % AXES;
            state.turn = turn + 1;
            if state.spinning.is_some() && turn != 2 {
                return;
            }
            state.ticks_s[turn] = dt_s;
            let [a, b, c, d] = state.ticks_s;
            // In pairs: equal ticks add up without rounding.
            self.learn_axis(turn, state, errors, braking, (a + b) + (c + d));
        } else {
            for axis in 0..AXES {
                self.learn_axis(axis, state, errors, braking, dt_s);
            }
        }
    }

    /// The slow part of one axis, x, y, z or psi. Heading learns nothing while the guard brakes.
    fn learn_axis(&self, axis: usize, state: &mut State<S>, errors: &Errors<S>, braking: S::Mask, since_s: S) {
        let error = errors.position_m;
        let lesson = |error, refused| Lesson { error, refused, integrate: S::Mask::splat(true), dt_s: since_s };
        let lesson = match axis {
            0 => lesson(error.x, state.refused_m_s2[0]),
            1 => lesson(error.y, state.refused_m_s2[1]),
            2 => Lesson {
                integrate: error.z.abs().lt(S::from_f32(INTEGRAL_GATE_M)) | self.always_integrates,
                ..lesson(-error.z, state.refused.thrust_n)
            },
            _ => Lesson { dt_s: S::select(braking, S::ZERO, since_s), ..lesson(errors.yaw_rad, state.refused.yaw_nm) },
        };
        if let (Some(law), Some(state)) = (self.axes.get(axis), state.axes.get_mut(axis)) {
            law.learn(state, &lesson);
        }
    }

    /// The torques that roll and pitch want.
    fn inner(
        &self,
        state: &mut State<S>,
        rate: Vec3<Body, S>,
        angles: &Angles<S>,
        setpoint: &Inner<S>,
        dt_s: S,
    ) -> Vec3<Body, S> {
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
        let roll_nm = self.roll.step(roll_integral, &roll);
        let pitch_nm = self.pitch.step(pitch_integral, &pitch);
        Vec3::new(roll_nm, pitch_nm, S::ZERO)
    }

    fn braking(&self, state: &mut State<S>, error_rad: S, rate_rad_s: S, dt_s: S) -> S::Mask {
        match self.cascade {
            Cascade::Paper => S::Mask::splat(false),
            Cascade::Flight => state.guard.step(error_rad, rate_rad_s, state.refused.yaw_nm, dt_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Airframe;
    use std::format;

    fn flight<S: Scalar>(law: Law) -> (Controller<S>, State<S>) {
        let controller = Controller::try_new(&Config::flight(law, Airframe::paper(2.2))).expect("the shipped gains");
        let state = controller.hover_state();
        (controller, state)
    }

    /// How far a second 0.1 m below the setpoint moves the altitude command, its ticks as long as `dt_s` in turn.
    fn moved_in_a_second(law: Law, dt_s: [f32; AXES]) -> f32 {
        let (controller, mut state) = flight::<f32>(law);
        // Altitude is the last of each four to learn, so that the last tick's lesson closes the second.
        state.turn = 3;
        let mut input = Input::hovering();
        input.position_m.z = 0.1;
        let mut tick = |dt_s| {
            input.dt_s = dt_s;
            assert!(!controller.tick(&mut state, &input).rejected);
            controller.telemetry(&state).axes[2].command
        };
        let first = tick(dt_s[0]);
        dt_s.into_iter().cycle().take(501).skip(1).fold(first, |_, dt_s| tick(dt_s)) - first
    }

    #[test]
    fn a_late_tick_is_learnt_once_whosever_turn_it_is() {
        let short_s = 0.008 / 6.0;
        for law in [Law::Pid, Law::Lgs] {
            let steady = moved_in_a_second(law, [0.002; AXES]);
            assert!(steady > 0.5, "{law:?} {steady}");
            for late in 0..AXES {
                let mut dt_s = [short_s; AXES];
                dt_s[late] = 3.0 * short_s;
                let moved = moved_in_a_second(law, dt_s);
                assert!((moved - steady).abs() < 0.01 * steady, "{law:?}, {late} late: {moved}, steady {steady}");
            }
        }
    }

    fn refuses_a_crooked_attitude<S: Scalar>() {
        let (controller, mut state) = flight::<S>(Law::Lgs);
        assert!(!controller.tick(&mut state, &Input::hovering()).rejected);
        let mut input = Input::hovering();
        input.attitude.rows[2][0] = S::from_f32(0.8);
        let before = state;
        assert!(controller.tick(&mut state, &input).rejected);
        state.output.rejected = false;
        assert_eq!(format!("{state:?}"), format!("{before:?}"));
    }

    #[test]
    fn a_crooked_attitude_changes_nothing_in_any_format() {
        refuses_a_crooked_attitude::<f32>();
        refuses_a_crooked_attitude::<f64>();
        #[cfg(feature = "fixed")]
        refuses_a_crooked_attitude::<crate::Q16>();
    }
}
