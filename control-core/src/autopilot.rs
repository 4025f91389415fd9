//! The autopilot: from estimate and pilot to motor commands.
//!
//! ```text
//! act      estimate, plan ─► controller ─► motors, 0 to 1
//! decide   estimate ─► level ─┐                        ┌─► contact ─┐
//!          pilot ─────────────┼─► failsafes ─► arming ─► modes ─► guide ─► plan
//!          system ────────────┘
//! ```
//!
//! The motors are told first, by what was planned at the sample before; then there is time to decide what is planned for the next. An
//! [`Autopilot`] is immutable; what changes in flight is in [`AutopilotState`]. The steps are functions over facts, each in its own
//! module; this one gathers the facts and passes the results on.
//!
//! Invariants: every command is within 0 and 1 whatever comes in; every one is 0 while disarmed, but for a test on the bench.
use crate::arming::{self, Arming, Check, Moment};
use crate::controller::{Controller, State, Target};
use crate::estimate::Estimate;
use crate::failsafe::{self, Failsafe, Reaction, Watch};
use crate::modes::contact::{Contact, Feet, Felt, SPOOL_S};
use crate::modes::guide::{self, Guide, Home, Scene};
use crate::modes::{self, Level, Mode, Reason, Trust};
use crate::parameters::{Parameter, Parameters};
use crate::pilot::{Pilot, Reading, Shape};
use crate::restart::Tape;
use crate::set::Set;
use crate::{Airframe, Config, ConfigError, Output, Regulators, WiringFault};
use bench::Bench;
use core::hint::cold_path;
use signals::{Acted, Plan, believed, sample};

mod bench;
mod coast;
mod kept;
mod signals;

pub use bench::{BenchOrder, BenchTest};
pub use signals::{Command, Step, System};

/// Everything that changes in flight.
#[derive(Clone, Copy, Debug)]
pub struct AutopilotState {
    /// The controller's part, for its telemetry and reports.
    pub controller: State,
    trust: Trust,
    pilot: Pilot,
    watch: Watch,
    arming: Arming,
    aim: Mode,
    reason: Option<Reason>,
    home: Home,
    feet: Feet,
    landed: bool,
    guide: Guide,
    bench: Bench,
    wiring: Option<Result<(), WiringFault>>,
    plan: Plan,
    acted: Acted,
}

impl AutopilotState {
    /// What the last wiring check found; none before the first has ended.
    pub fn wiring(&self) -> Option<Result<(), WiringFault>> {
        self.wiring
    }

    /// What runs on the bench.
    pub fn bench(&self) -> Option<BenchTest> {
        match self.bench {
            Bench::Nothing => None,
            Bench::Motors(_) => Some(BenchTest::Motors),
            Bench::Wiring(_) => Some(BenchTest::Wiring),
        }
    }

    /// Arms or disarms; returns whether arming was refused.
    fn arm(
        &mut self,
        pilot: &Reading,
        level: Level,
        estimate: &Estimate,
        failsafes: Set<Failsafe>,
        failing: Set<Check>,
    ) -> bool {
        let was = self.arming;
        self.arming = was.next(&Moment {
            switch: pilot.arm,
            switch_rose: pilot.arm_rose,
            ready: failing.is_empty(),
            terminate: failsafes.first().is_some_and(|worst| worst.row().reaction == Reaction::Terminate),
            down: self.landed && self.aim.comes_down(),
        });
        if was == Arming::Disarmed && self.arming == Arming::Armed {
            let place = estimate.position_m;
            self.home = Home {
                place_m: (level >= Level::Position).then_some([place.x, place.y]),
                down_m: (level >= Level::Altitude).then_some(place.z),
            };
        }
        was == Arming::Disarmed && pilot.arm_rose && !failing.is_empty()
    }

    /// Moves the mode aimed at.
    fn take_aim(&mut self, pilot: &Reading, failsafes: Set<Failsafe>) {
        let armed = self.arming == Arming::Armed;
        let just_armed = armed && self.aim == Mode::Disarmed;
        let (aim, reason) = self.aim.next(&modes::Facts {
            armed,
            chosen: (just_armed || pilot.mode_moved).then_some(pilot.mode).filter(|mode| *mode != Mode::Disarmed),
            failsafe: failsafes.first(),
            arrived: self.guide.arrived(),
        });
        self.aim = aim;
        self.reason = reason.or(self.reason);
    }
}

/// A checked configuration. Immutable: one may serve many states.
#[derive(Clone, Debug)]
pub struct Autopilot {
    controller: Controller,
    airframe: Airframe,
    shape: Shape,
    failsafe: failsafe::Limits,
    arming: arming::Limits,
    guide: guide::Limits,
    cells: f32,
    idle: f32,
    spool: f32,
    nominal_s: f32,
}

/// Share of the hover's command to which the rotors spool up.
const SPOOL_SHARE: f32 = 0.5;
/// Climb stick beyond which the machine is to leave the ground.
const LIFT_STICK: f32 = 0.1;
/// How far above the ground a setpoint from outside must be to leave it, m.
const LIFT_M: f32 = 0.3;
/// Longest step that is believed, s.
const STEP_S_MAX: f32 = 0.1;

impl Autopilot {
    /// Checks `config`, with its gains as `parameters` say, and builds the autopilot.
    ///
    /// # Errors
    /// [`ConfigError`] names the first field that cannot fly, its value and what is allowed.
    pub fn try_new(config: &Config, parameters: &Parameters) -> Result<Self, ConfigError> {
        Self::try_with(config, config.regulators().as_ref(), parameters)
    }

    /// The same with regulators that were made beforehand: see [`Controller::try_with`].
    ///
    /// # Errors
    /// [`ConfigError`] as for [`Self::try_new`], and for regulators of another machine.
    pub fn try_with(
        config: &Config,
        regulators: Option<&Regulators>,
        parameters: &Parameters,
    ) -> Result<Self, ConfigError> {
        let config = Config { gains: parameters.tune(config.gains), ..*config };
        let airframe = config.airframe;
        let thrust_n_max: f32 = airframe.rotors.iter().map(|rotor| rotor.thrust_n_max).sum();
        let idle = parameters[Parameter::MotorIdle];
        Ok(Self {
            controller: Controller::try_with(&config, regulators)?,
            airframe,
            shape: parameters.into(),
            failsafe: parameters.into(),
            arming: parameters.into(),
            guide: guide::Limits::new(parameters, &airframe),
            cells: parameters[Parameter::BatCells],
            idle,
            spool: (SPOOL_SHARE * airframe.weight_n() / thrust_n_max - idle).max(0.0),
            nominal_s: 1.0 / config.control_hz,
        })
    }

    /// The state at power-up: disarmed, on the ground.
    #[inline(never)]
    pub fn state(&self) -> AutopilotState {
        AutopilotState {
            controller: self.controller.hover_state(),
            trust: Trust::NONE,
            pilot: Pilot::UNHEARD,
            watch: Watch::NEW,
            arming: Arming::Disarmed,
            aim: Mode::Disarmed,
            reason: None,
            home: Home::default(),
            feet: Feet::STANDING,
            landed: true,
            guide: Guide::AT_REST,
            bench: Bench::Nothing,
            wiring: None,
            plan: Plan::Turn([0.0; 4]),
            acted: Acted::NOTHING,
        }
    }

    /// The controller, for its telemetry and reports.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// [`Self::act`], then [`Self::decide`].
    pub fn step(&self, state: &mut AutopilotState, step: &Step) -> Command {
        self.act(state, step.estimate, step.dt_s);
        self.decide(state, step)
    }

    /// What the motors do until the next sample, each a share of its largest thrust, by what was planned; and nothing that can wait until
    /// they are told.
    ///
    /// - `dt_s`: time since the last sample.
    pub fn act(&self, state: &mut AutopilotState, estimate: &Estimate, dt_s: f32) -> [f32; 4] {
        state.acted = match state.plan {
            Plan::Turn(motors) => Acted { motors, ..Acted::NOTHING },
            Plan::Fly(ref target, level) => {
                let input = sample(estimate, level, self.lasted_s(dt_s), target.setpoint());
                let Output { thrust_n, rejected } = self.controller.act_toward(&mut state.controller, &input, target);
                Acted { motors: self.shares(&thrust_n), thrust_n, rejected }
            }
        };
        state.acted.motors
    }

    /// A step's time that can be true, s.
    fn lasted_s(&self, dt_s: f32) -> f32 {
        let sane_s = if dt_s > 0.0 { dt_s } else { self.nominal_s };
        if sane_s < STEP_S_MAX { sane_s } else { STEP_S_MAX }
    }

    /// Learns from what was felt, and plans what the motors do at the next sample; to be called once after each [`Self::act`].
    pub fn decide(&self, state: &mut AutopilotState, step: &Step) -> Command {
        self.controller.reflect(&mut state.controller);
        let dt_s = self.lasted_s(step.dt_s);
        let level = state.trust.step(Level::of(&believed(step.estimate)), dt_s);
        let pilot = state.pilot.read(&self.shape, step.pilot, step.now_us);
        let cell_v = step.system.battery_v.filter(|_| self.cells > 0.0).map(|v| v / self.cells);

        let failsafes = self.watch(state, step, &pilot, level, cell_v, dt_s);
        let failing = self.failing(state, step, &pilot, level, cell_v);
        let refused = state.arm(&pilot, level, step.estimate, failsafes, failing);
        let armed = state.arming == Arming::Armed;
        state.take_aim(&pilot, failsafes);
        let (mode, lacks) = state.aim.flown(level);

        let landed = if armed {
            let offboard = step.offboard.filter(|_| step.offboard_age_s() <= self.failsafe.offboard_s);
            let scene = Scene {
                estimate: step.estimate,
                level,
                pilot: &pilot,
                home: state.home,
                offboard: offboard.map(|setpoint| &setpoint.value),
                dt_s,
            };
            let landed = self.touch(state, mode, &scene);
            let target = self.target(state, mode, &scene, landed);
            self.controller.brace(&mut state.controller, state.feet.suspects());
            state.plan = Plan::Fly(target, level);
            landed
        } else {
            (state.feet, state.landed, state.guide) = (Feet::STANDING, true, Guide::AT_REST);
            state.plan = Plan::Turn(self.run_bench(state, step.estimate, dt_s));
            true
        };
        Command {
            motors: state.acted.motors,
            armed,
            aim: state.aim,
            mode,
            reason: lacks.or(state.reason),
            failsafes,
            failing,
            refused,
            landed,
            rejected: state.acted.rejected,
        }
    }

    /// The failsafes that act; none while disarmed.
    // Not inlined: `cargo fw` knows by its name where it calls through pointers.
    #[inline(never)]
    fn watch(
        &self,
        state: &mut AutopilotState,
        step: &Step,
        pilot: &Reading,
        level: Level,
        cell_v: Option<f32>,
        dt_s: f32,
    ) -> Set<Failsafe> {
        if state.arming == Arming::Disarmed {
            state.watch = Watch::NEW;
            return Set::EMPTY;
        }
        let position = step.estimate.position_m;
        let home = state.home.place_m.filter(|_| level >= Level::Position);
        let facts = failsafe::Facts {
            aim: state.aim,
            level,
            link_age_s: pilot.age_s,
            offboard_age_s: step.offboard_age_s(),
            cell_v,
            used_as: step.system.used_as,
            from_home_m: home.map(|home| guide::length([position.x - home[0], position.y - home[1]])),
            height_m: state.home.down_m.filter(|_| level >= Level::Altitude).map(|down_m| down_m - position.z),
            upright: step.estimate.attitude.rows[2][2],
            rotor_lost: state.controller.flies_without().is_some(),
            late: step.system.late,
        };
        state.watch.step(&facts, &self.failsafe, pilot.mode_moved, dt_s)
    }

    /// The checks that fail; while armed none are made.
    fn failing(
        &self,
        state: &AutopilotState,
        step: &Step,
        pilot: &Reading,
        level: Level,
        cell_v: Option<f32>,
    ) -> Set<Check> {
        if state.arming == Arming::Armed {
            return Set::EMPTY;
        }
        let facts = arming::Facts {
            link_age_s: pilot.age_s,
            throttle: pilot.sticks.throttle,
            mode: pilot.mode,
            parameters_valid: step.system.parameters_valid,
            self_test_passed: step.system.self_test_passed,
            gyro_calibrated: step.system.gyro_calibrated,
            rate_rad_s: step.estimate.rate_rad_s,
            force_m_s2: step.estimate.specific_force_m_s2,
            level,
            cell_v,
            used_as: step.system.used_as,
            wiring_passed: state.wiring == Some(Ok(())),
            on_bench: !matches!(state.bench, Bench::Nothing),
            late: step.system.late,
        };
        facts.failing(&self.arming)
    }

    /// Whether the machine stands on its feet, by what it wants and feels.
    fn touch(&self, state: &mut AutopilotState, mode: Mode, scene: &Scene) -> bool {
        let shares = state.controller.shares();
        let made_n: f32 = state.acted.thrust_n.iter().zip(shares).map(|(n, share)| n * share).sum();
        let thrust_low = scene.pilot.sticks.throttle <= arming::THROTTLE_LOW;
        let lift = match mode {
            Mode::Disarmed | Mode::Return | Mode::Land | Mode::Descend => false,
            Mode::Rate | Mode::Angle => !thrust_low,
            Mode::AltitudeHold | Mode::PositionHold => scene.pilot.climb > LIFT_STICK,
            Mode::TakeOff => true,
            Mode::Offboard => scene.offboard.is_some_and(|to| to.position_m.z < scene.estimate.position_m.z - LIFT_M),
        };
        let felt = Felt {
            armed: true,
            lift,
            spool_s: if mode.throttle_is_thrust() { 0.0 } else { SPOOL_S },
            thrust_weights: made_n / self.airframe.weight_n(),
            force_z_m_s2: scene.estimate.specific_force_m_s2.z,
            rate_rad_s: scene.estimate.rate_rad_s,
            pressed: state
                .guide
                .below_m(scene.estimate)
                .filter(|_| scene.level >= Level::Altitude)
                .map(|below_m| (below_m, scene.estimate.velocity_m_s.z)),
        };
        state.landed = state.feet.step(&felt, scene.dt_s) != Contact::Flying;
        state.landed
    }

    fn target(&self, state: &mut AutopilotState, mode: Mode, scene: &Scene, landed: bool) -> Target {
        if landed {
            state.guide = Guide::AT_REST;
            return Target::Ground { share: self.idle + state.feet.spooled() * self.spool };
        }
        if scene.level == Level::Nothing {
            return Target::Coast;
        }
        state.guide.step(&self.guide, mode, scene)
    }

    /// Thrusts as shares of the largest.
    fn shares(&self, thrust_n: &[f32; 4]) -> [f32; 4] {
        core::array::from_fn(|i| unit(thrust_n[i] / self.airframe.rotors[i].thrust_n_max))
    }
}

/// `x` within 0 and 1; 0 if it is not a number.
fn unit(x: f32) -> f32 {
    if (0.0..=1.0).contains(&x) {
        return x;
    }
    cold_path();
    if x > 1.0 { 1.0 } else { 0.0 }
}
