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
use crate::allocation::{Allocation, Allocator, Demand};
use crate::attitude::AttitudeLaw;
use crate::config::{Cascade, Config, ConfigError};
use crate::frames::{Body, Ned, Vec3};
use crate::guidance::{Angles, Guidance};
use crate::law::{AxisLaw, AxisState, Law};
use crate::math::wrap_pi;
use crate::restart::Tape;
use crate::rotors::{Rotors, RotorsState};
use crate::signals::{Input, Output, Telemetry};
use crate::spin::Regulators;
use crate::yaw_guard::YawGuard;
use crate::{GRAVITY_M_S2, Mask, Scalar};
use cascade::Taught;

mod cascade;
mod manual;
mod tolerant;

pub use manual::{Lift, Target};

/// Everything that changes in flight.
#[derive(Clone, Copy, Debug)]
pub struct State<S: Scalar = f32> {
    axes: [AxisState<S>; AXES],
    /// The axis that learns next.
    turn: usize,
    /// How long the last ticks were, one in each turn.
    ticks_s: [S; AXES],
    /// What an axis is to learn from the last tick, until it is reflected on.
    taught: Option<Taught<S>>,
    tilt_integrals: [S::Sum; 2],
    rotors: RotorsState<S>,
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
    weight_n: S,
    yaw_brake_nm_s: S,
    filter_rad_s: S,
    dt_s_range: (S, S),
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

impl<S: Scalar> Controller<S> {
    /// Checks `config` and builds the controller.
    ///
    /// # Errors
    /// [`ConfigError`] names the first field that cannot fly, its value and what is allowed.
    pub fn try_new(config: &Config) -> Result<Self, ConfigError> {
        Self::try_with(config, config.regulators().as_ref())
    }

    /// The same with regulators that were made beforehand, which it needs if it is to fly without a rotor.
    ///
    /// # Errors
    /// [`ConfigError`] as for [`Self::try_new`], and for regulators of another machine.
    pub fn try_with(config: &Config, regulators: Option<&Regulators>) -> Result<Self, ConfigError> {
        config.check_rates()?;
        let Config { airframe, law, cascade, yaw_turns_thrust, rotors, gains, control_hz, filter_hz } = *config;
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
            rotors: match &rotors {
                Some(config) => Some(Rotors::try_new(config, regulators, &airframe, control_hz)?),
                None => None,
            },
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
            taught: None,
            tilt_integrals: [S::ZERO.to_sum(); 2],
            rotors: RotorsState::new(self.weight_n * S::from_f32(0.25), self.rotors.as_ref()),
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
            rotors: self.rotors.is_some().then(|| state.rotors.telemetry()),
        }
    }

    /// Tells the controller what somebody else knows of the rotors: a speed sensor, a pilot, the simulator.
    ///
    /// - `shares`: of its commanded thrust that each rotor makes, 0 to 1; `None` where nothing is known.
    ///
    /// Holds until told otherwise. A controller that takes the rotors as commanded does not listen.
    pub fn report(&self, state: &mut State<S>, shares: [Option<S>; 4]) {
        if let Some(rotors) = &self.rotors {
            rotors.listen(&mut state.rotors, shares);
        }
    }

    /// Tells the controller whether the ground, or a hand, may bear the machine: nothing is learnt of the rotors meanwhile.
    pub fn brace(&self, state: &mut State<S>, borne: bool) {
        state.rotors.borne = borne;
    }

    /// Runs the whole controller once: [`Self::act`], then [`Self::reflect`].
    pub fn tick<'a>(&self, state: &'a mut State<S>, input: &Input<S>) -> &'a Output<S> {
        self.act(state, input);
        self.reflect(state);
        &state.output
    }

    /// From the sample to the thrusts, and nothing that can wait until the motors have them.
    ///
    /// - `state`: of this controller, from [`Self::hover_state`] or the last tick.
    /// - Returns the thrusts, which live in the state until the next tick; see [`Self::telemetry`] for the rest.
    ///
    /// A sample that is not plausible leaves the state and the thrusts as they were and sets [`Output::rejected`].
    /// A vector of flights is held as one: whoever batches them takes a flight that is lost out of the batch.
    pub fn act<'a>(&self, state: &'a mut State<S>, input: &Input<S>) -> &'a Output<S> {
        let angles = Angles::of(&input.attitude);
        let mut errors = Errors::of(input, &angles);
        state.output.rejected = !errors.are_plausible(input).all();
        if !state.output.rejected {
            self.advance(state, input, &angles, &mut errors);
        }
        &state.output
    }

    /// Learns from what the last sample felt, for the next; to be called once after each.
    pub fn reflect(&self, state: &mut State<S>) {
        if let Some(rotors) = &self.rotors {
            self.reflect_watching(rotors, state);
        }
    }

    fn advance(&self, state: &mut State<S>, input: &Input<S>, angles: &Angles<S>, errors: &mut Errors<S>) {
        let dt_s = input.dt_s.clamp(self.dt_s_range.0, self.dt_s_range.1);
        if let Some(rotors) = &self.rotors {
            self.advance_watching(rotors, state, input, angles, errors, dt_s);
            return;
        }
        let wanted = self.wanted::<false>(state, input.rate_rad_s, angles, errors, dt_s);
        let coupling = self.coupling.torque_nm(input.rate_rad_s);
        state.take(self.allocator.allocate(&wanted.with_torque(coupling)));
    }
}

impl State<f32> {
    /// What it has learnt, of the laws and of the rotors.
    pub(crate) fn pass(&mut self, tape: &mut Tape) {
        for axis in &mut self.axes {
            axis.pass(tape);
        }
        tape.floats(&mut self.tilt_integrals);
        self.rotors.pass(tape);
    }
}

impl<S: Scalar> State<S> {
    /// The rotor without which the machine spins, 0 to 3, if it does.
    pub(crate) fn flies_without(&self) -> Option<usize> {
        self.rotors.spinning.map(|spinning| spinning.rotor)
    }

    /// Share of its thrust that each rotor is believed to make.
    pub fn shares(&self) -> [S; 4] {
        self.rotors.shares
    }

    fn take(&mut self, allocation: Allocation<S>) {
        self.refused = allocation.refused;
        self.output.thrust_n = allocation.thrust_n;
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
