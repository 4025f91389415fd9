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
use crate::frames::{Body, Vec3};
use crate::guidance::{Angles, Guidance, Inner, Outer};
use crate::law::{AxisInput, AxisLaw, AxisState};
use crate::math::wrap_pi;
use crate::signals::{Input, Output, Telemetry};
use crate::yaw_guard::YawGuard;
use crate::{GRAVITY_M_S2, Mask, Scalar};

/// Everything that changes in flight.
#[derive(Clone, Copy, Debug)]
pub struct State<S: Scalar = f32> {
    axes: [AxisState<S>; 4],
    tilt_integrals: [S::Sum; 2],
    yaw_rate_rad_s: S,
    refused_north_m_s2: S,
    refused_east_m_s2: S,
    guard: YawGuard<S>,
    output: Output<S>,
}

/// A checked configuration in the scalar that flies. Immutable: one may serve many states.
#[derive(Clone, Debug)]
pub struct Controller<S = f32> {
    axes: [AxisLaw<S>; 4],
    roll: AttitudeLaw<S>,
    pitch: AttitudeLaw<S>,
    guidance: Guidance<S>,
    allocator: Allocator<S>,
    cascade: Cascade,
    inertia_kg_m2: Vec3<Body, S>,
    weight_n: S,
    yaw_brake_nm_s: S,
    filter_rad_s: S,
    dt_s_range: (S, S),
}

/// |e_z| below which the altitude integral moves, m: a climb does not wind it up.
const INTEGRAL_GATE_M: f32 = 0.5;

impl<S: Scalar> Controller<S> {
    /// Checks `config` and builds the controller.
    ///
    /// # Errors
    /// [`ConfigError`] names the first field that cannot fly, its value and what is allowed.
    pub fn try_new(config: &Config) -> Result<Self, ConfigError> {
        config.check_rates()?;
        let Config { airframe, law, cascade, yaw_turns_thrust, gains, control_hz, filter_hz } = *config;
        let s = S::from_f32;
        let [ix, iy, iz] = airframe.inertia_kg_m2.map(s);
        let flies = cascade == Cascade::Flight;
        Ok(Self {
            allocator: Allocator::try_new(&airframe, flies)?,
            axes: [
                AxisLaw::try_new("x", law, &gains.x)?,
                AxisLaw::try_new("y", law, &gains.y)?,
                AxisLaw::try_new("z", law, &gains.z)?,
                AxisLaw::try_new("psi", law, &gains.psi)?,
            ],
            roll: AttitudeLaw::try_new("phi", &gains.phi)?,
            pitch: AttitudeLaw::try_new("theta", &gains.theta)?,
            guidance: Guidance::new(cascade, yaw_turns_thrust, airframe.mass_kg),
            cascade,
            inertia_kg_m2: Vec3::new(ix, iy, iz),
            weight_n: s(airframe.weight_n()),
            yaw_brake_nm_s: s(gains.psi.k0[2]),
            filter_rad_s: s(core::f32::consts::TAU * filter_hz),
            dt_s_range: (s(0.25 / control_hz), s(4.0 / control_hz)),
        })
    }

    /// The state of a level hover: starting gains, the weight carried, every rotor at a quarter of it.
    pub fn hover_state(&self) -> State<S> {
        let carried = match self.cascade {
            Cascade::Paper => S::ZERO,
            Cascade::Flight => self.weight_n,
        };
        let commands = [S::ZERO, S::ZERO, carried, S::ZERO];
        let [x, y, z, psi] = &self.axes;
        let [cx, cy, cz, cpsi] = commands;
        State {
            axes: [x.state(cx), y.state(cy), z.state(cz), psi.state(cpsi)],
            tilt_integrals: [S::ZERO.to_sum(); 2],
            yaw_rate_rad_s: S::ZERO,
            refused_north_m_s2: S::ZERO,
            refused_east_m_s2: S::ZERO,
            guard: YawGuard::new(),
            output: Output {
                thrust_n: [self.weight_n * S::from_f32(0.25); 4],
                telemetry: Telemetry {
                    axes: [x.output(cx), y.output(cy), z.output(cz), psi.output(cpsi)],
                    angles_rad: [S::ZERO; 3],
                    tilt_setpoint_rad: [S::ZERO; 2],
                    demand: Demand { thrust_n: self.weight_n, ..Demand::NOTHING },
                    refused: Demand::NOTHING,
                    yaw_guard: S::Mask::splat(false),
                },
                rejected: false,
            },
        }
    }

    /// Runs the whole controller once.
    ///
    /// - `state`: of this controller, from [`Self::hover_state`] or the last tick.
    /// - Returns thrusts and telemetry, which live in the state until the next tick.
    ///
    /// A sample that is not plausible leaves the state and the thrusts as they were and sets [`Output::rejected`].
    /// A vector of flights is held as one: whoever batches them takes a flight that is lost out of the batch.
    pub fn tick<'a>(&self, state: &'a mut State<S>, input: &Input<S>) -> &'a Output<S> {
        state.output.rejected = !input.is_plausible().all();
        if !state.output.rejected {
            self.advance(state, input);
        }
        &state.output
    }

    fn advance(&self, state: &mut State<S>, input: &Input<S>) {
        let dt_s = input.dt_s.clamp(self.dt_s_range.0, self.dt_s_range.1);
        let low_pass = LowPass::new(self.filter_rad_s, dt_s);
        let angles = Angles::of(&input.attitude);

        let outer = self.outer(state, input, &angles, &low_pass);
        let inner = self.guidance.convert(&outer, &angles);
        let demand = self.inner(state, input, &angles, &inner, dt_s);
        let allocation = self.allocator.allocate(&demand);

        state.refused_north_m_s2 = inner.refused_north_m_s2;
        state.refused_east_m_s2 = inner.refused_east_m_s2;
        state.output.thrust_n = allocation.thrust_n;
        let telemetry = &mut state.output.telemetry;
        telemetry.angles_rad = [angles.roll_rad, angles.pitch_rad, angles.yaw_rad];
        telemetry.tilt_setpoint_rad = [inner.roll_rad, inner.pitch_rad];
        telemetry.demand = demand;
        telemetry.refused = allocation.refused;
    }

    /// The four adaptive axes: accelerations north and east, force up; the yaw torque stays in the telemetry.
    fn outer(&self, state: &mut State<S>, input: &Input<S>, angles: &Angles<S>, low_pass: &LowPass<S>) -> Outer<S> {
        let setpoint = &input.setpoint;
        let gravity = Vec3::new(S::ZERO, S::ZERO, S::from_f32(GRAVITY_M_S2));
        let acceleration = input.attitude.to_ned(input.specific_force_m_s2) + gravity;
        let error = setpoint.position_m - input.position_m;
        let error_rate = setpoint.velocity_m_s - input.velocity_m_s;
        let error_accel = setpoint.acceleration_m_s2 - acceleration;

        let yaw_error = wrap_pi(setpoint.yaw_rad - angles.yaw_rad);
        let yaw_accel = low_pass.step(&mut state.yaw_rate_rad_s, input.rate_rad_s.z);
        let refused = state.output.telemetry.refused;
        let braking = self.braking(state, yaw_error, input.rate_rad_s.z, refused.yaw_nm, low_pass.dt_s());
        state.output.telemetry.yaw_guard = braking;

        let always = S::Mask::splat(true);
        let horizontal = |error, error_rate, error_accel, refused| AxisInput {
            error,
            error_rate,
            error_accel,
            refused,
            integrate: always,
            adapt: always,
        };
        let inputs = [
            horizontal(error.x, error_rate.x, error_accel.x, state.refused_north_m_s2),
            horizontal(error.y, error_rate.y, error_accel.y, state.refused_east_m_s2),
            AxisInput {
                error: -error.z,
                error_rate: -error_rate.z,
                error_accel: -error_accel.z,
                refused: refused.thrust_n,
                integrate: error.z.abs().lt(S::from_f32(INTEGRAL_GATE_M)) | self.is_paper(),
                adapt: always,
            },
            AxisInput {
                error: yaw_error,
                error_rate: setpoint.yaw_rate_rad_s - input.rate_rad_s.z,
                error_accel: -yaw_accel,
                refused: refused.yaw_nm,
                integrate: !braking,
                adapt: !braking,
            },
        ];
        let axes = &mut state.output.telemetry.axes;
        for (((law, state), input), output) in self.axes.iter().zip(&mut state.axes).zip(&inputs).zip(&mut *axes) {
            law.step(state, input, low_pass, output);
        }
        let [x, y, z, _] = axes;
        Outer { north_m_s2: x.command, east_m_s2: y.command, up_n: z.command }
    }

    /// Roll and pitch torques, and the yaw torque of the heading law or of the guard.
    fn inner(
        &self,
        state: &mut State<S>,
        input: &Input<S>,
        angles: &Angles<S>,
        setpoint: &Inner<S>,
        dt_s: S,
    ) -> Demand<S> {
        let Output { telemetry, .. } = &state.output;
        let rate = input.rate_rad_s;
        let [roll_integral, pitch_integral] = &mut state.tilt_integrals;
        let roll_nm = self.roll.step(
            roll_integral,
            &AttitudeInput {
                error_rad: wrap_pi(setpoint.roll_rad - angles.roll_rad),
                rate_rad_s: rate.x,
                refused_nm: telemetry.refused.roll_nm,
                dt_s,
            },
        );
        let pitch_nm = self.pitch.step(
            pitch_integral,
            &AttitudeInput {
                error_rad: setpoint.pitch_rad - angles.pitch_rad,
                rate_rad_s: rate.y,
                refused_nm: telemetry.refused.pitch_nm,
                dt_s,
            },
        );
        let [.., heading] = &telemetry.axes;
        let yaw_nm = S::select(telemetry.yaw_guard, -self.yaw_brake_nm_s * rate.z, heading.command);
        let coupling = self.coupling(rate);
        Demand {
            thrust_n: setpoint.thrust_n,
            roll_nm: roll_nm + coupling.x,
            pitch_nm: pitch_nm + coupling.y,
            yaw_nm: yaw_nm + coupling.z,
        }
    }

    /// ω × I ω, which the rigid body adds and the flight cascade takes away again.
    fn coupling(&self, rate: Vec3<Body, S>) -> Vec3<Body, S> {
        match self.cascade {
            Cascade::Paper => Vec3::zero(),
            Cascade::Flight => {
                let i = self.inertia_kg_m2;
                rate.cross(Vec3::new(i.x * rate.x, i.y * rate.y, i.z * rate.z))
            }
        }
    }

    fn braking(&self, state: &mut State<S>, error_rad: S, rate_rad_s: S, refused_nm: S, dt_s: S) -> S::Mask {
        match self.cascade {
            Cascade::Paper => S::Mask::splat(false),
            Cascade::Flight => state.guard.step(error_rad, rate_rad_s, refused_nm, dt_s),
        }
    }

    fn is_paper(&self) -> S::Mask {
        S::Mask::splat(self.cascade == Cascade::Paper)
    }
}
