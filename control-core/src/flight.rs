//! Flight: what a control loop calls between reading and writing. The same on the board, in simulation and in replay.
//!
//! ```text
//!  act       inertial sample ─► Estimator::sample ─► estimate ─► Helm::act ─► Command ─► motors
//!                                    ▲ corrections                  ▲ plan
//!  decide    all that arrived ─► Estimator::settle ─► estimate ─► Helm::decide ◄─ pilot, companion, system
//! ```
//!
//! The motors are told before anything is done that can wait: corrections, decisions and what is learnt serve the next sample. Nothing
//! is decided here: the estimator and the autopilot decide. Where no inertial sample has come, the machine coasts on what was planned.
//! What arrives slowly is kept until the next of its kind. A command is a share of the largest thrust; a speed controller turns its rotor
//! in proportion to what it is told, and thrust grows with the square of the speed, so the share of the speed is its root.
//!
//! What is known of this machine's compass and accelerometer, by parameters, is given to the estimator, which takes it off what they say.
//!
//! [`Helm`] is the part after the estimate, for those who make the estimate themselves or are shown the truth.
//!
//! Invariant: without an armed autopilot, or one whose bench runs a rotor, the command is [`Command::Stop`].
use crate::autopilot::{self, Autopilot, AutopilotState, BenchOrder, System};
use crate::battery::Battery;
use crate::compass::{self, Compass};
use crate::estimate::Estimate;
use crate::estimation::{Estimator, EstimatorConfig, EstimatorConfigError, EstimatorState, EstimatorTelemetry, Phase};
use crate::measurement::{Measurements, Stamped};
use crate::modes::Mode;
use crate::parameters::Parameters;
use crate::pilot::{PilotInput, Sticks};
use crate::restart::{Memory, SOUND_S, Tape, VERSION, WORDS};
use crate::{Config, ConfigError, Controller, Regulators, Scalar, Setpoint};

/// What flies.
#[derive(Clone, Copy, Debug)]
pub struct FlightConfig<'a> {
    /// Machine and controller.
    pub controller: Config,
    /// What it flies with when a rotor is gone, made for this controller ([`Config::regulators`]).
    pub regulators: &'a Regulators,
    /// The estimator; the rate of its gyro is that of the steps.
    pub estimator: EstimatorConfig,
}

/// What cannot fly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unflyable {
    /// The part that the value belongs to, and its name.
    pub name: [&'static str; 2],
    /// The value.
    pub value: f32,
}

impl From<ConfigError> for Unflyable {
    fn from(error: ConfigError) -> Self {
        Self { name: [error.part, error.field], value: error.value }
    }
}

impl From<EstimatorConfigError> for Unflyable {
    fn from(error: EstimatorConfigError) -> Self {
        Self { name: ["estimator", error.field], value: error.value }
    }
}

/// What the motors do until the next step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// They stand.
    Stop,
    /// They turn, each at a share of its fastest speed, 0 to 1: even at 0 none stands, for one that does takes long to start.
    Run([f32; 4]),
    /// On the bench: those above 0 turn, at that share of their fastest speed, and the others stand.
    Bench([f32; 4]),
}

impl Command {
    /// Each motor's share of its fastest speed; 0 where it stands.
    pub fn speeds(self) -> [f32; 4] {
        match self {
            Self::Stop => [0.0; 4],
            Self::Run(speeds) | Self::Bench(speeds) => speeds,
        }
    }
}

/// Everything that has arrived since the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Arrived {
    /// From the sensors.
    pub measurements: Measurements,
    /// From the pilot, if there was a frame.
    pub pilot: Option<Stamped<PilotInput>>,
    /// From a companion computer, if it spoke.
    pub offboard: Option<Stamped<Setpoint>>,
    /// What is asked of the bench; nothing happens while armed.
    pub bench: Option<BenchOrder>,
    /// Whether the last step came late.
    pub late: bool,
    /// Whether every part has said that it is there.
    pub self_test_passed: bool,
    /// Whether every stored parameter was in its range.
    pub parameters_valid: bool,
}

/// What flies, checked, with these parameters; nothing of it changes in flight.
///
/// A flight is 12 kB: who has little stack checks first, and lets it begin where it is to stay.
#[derive(Debug)]
pub struct Checked {
    estimator: Estimator,
    autopilot: Autopilot,
}

impl Checked {
    /// Checks `config`, with its gains and limits as `parameters` say.
    ///
    /// # Errors
    /// [`Unflyable`] names the first value that cannot fly.
    // Not inlined: what it takes of the stack is free again after it.
    #[inline(never)]
    pub fn try_new(config: &FlightConfig, parameters: &Parameters) -> Result<Self, Unflyable> {
        let (compass, offset_m_s2) = (Compass::of(parameters), compass::accelerometer_offset(parameters));
        Ok(Self {
            estimator: Estimator::try_new(&config.estimator.calibrated(compass, offset_m_s2))?,
            autopilot: Autopilot::try_with(&config.controller, Some(config.regulators), parameters)?,
        })
    }

    /// Just switched on.
    #[inline(never)]
    pub fn flight(self) -> Flight {
        let Self { estimator, autopilot } = self;
        Flight { state: estimator.state(), estimator, helm: Helm::new(autopilot), resumed_us: 0 }
    }
}

/// Estimator and helm.
#[derive(Debug)]
pub struct Flight {
    estimator: Estimator,
    state: EstimatorState,
    helm: Helm,
    /// When it last went on after an interruption, µs; 0 if it never did.
    resumed_us: u64,
}

impl Flight {
    /// Just switched on, with these parameters.
    ///
    /// # Errors
    /// [`Unflyable`] names the first value that cannot fly.
    pub fn try_new(config: &FlightConfig, parameters: &Parameters) -> Result<Self, Unflyable> {
        Checked::try_new(config, parameters).map(Checked::flight)
    }

    /// What the motors do; to be called once an inertial sample, or when one is missed. Nothing that can wait until they are told is
    /// done here, but in [`Self::decide`].
    ///
    /// - `now_us`: µs since boot.
    pub fn act(&mut self, now_us: u64, arrived: &Arrived) -> Command {
        self.estimator.sample(&mut self.state, &arrived.measurements, now_us);
        let estimate = self.state.estimate();
        if self.state.is_new() { self.helm.act(now_us, estimate) } else { self.helm.coast(now_us, estimate) }
    }

    /// Takes in all that arrived, and decides what the next sample is met with; to be called once after each [`Self::act`], with the same.
    pub fn decide(&mut self, now_us: u64, arrived: &Arrived) {
        if arrived.measurements.magnetic_ut.is_some() {
            self.state.bear(self.helm.decision().map_or(0.0, |decision| compass::load(&decision.motors)));
        }
        self.estimator.settle(&mut self.state, &arrived.measurements, now_us);
        self.helm.decide(now_us, self.state.estimate(), self.state.phase() != Phase::Aligning, arrived);
    }

    /// [`Self::act`], then [`Self::decide`].
    pub fn step(&mut self, now_us: u64, arrived: &Arrived) -> Command {
        let command = self.act(now_us, arrived);
        self.decide(now_us, arrived);
        command
    }

    /// What is to be kept over a reset; nothing unless it flies, and knows at least which way is down.
    #[inline(never)]
    pub fn remember(&mut self) -> Option<Memory> {
        let flies = self.helm.state.flies() && self.state.phase() != Phase::Aligning && self.estimate().health.tilt;
        let mut memory = [0; WORDS];
        let mut tape = Tape::writing(&mut memory);
        tape.word(&mut VERSION.clone());
        tape.time(&mut self.resumed_us);
        self.state.pass(&mut tape);
        self.helm.pass(&mut tape);
        (flies && tape.is_sound()).then_some(memory)
    }

    /// Goes on with a flight that was interrupted, on a clock that has gone on; returns whether it does. If not, it is as just switched on.
    ///
    /// - `memory`: of [`Self::remember`], with these parameters, checked to be whole.
    /// - `now_us`: the next step, rather later than it comes.
    #[cold]
    #[inline(never)]
    pub fn resume(&mut self, mut memory: Memory, now_us: u64) -> bool {
        let mut tape = Tape::reading(&mut memory);
        let (mut version, mut resumed_us) = (0, 0);
        tape.word(&mut version);
        tape.time(&mut resumed_us);
        self.estimator.go_on(&mut self.state, &mut tape, now_us);
        self.helm.go_on(&mut tape, self.state.estimate());
        let lasted_us = self.estimate().time_us.saturating_sub(resumed_us);
        let sound = tape.is_sound() && version == VERSION && self.state.is_sound();
        let goes_on = sound && (resumed_us == 0 || lasted_us >= SOUND_S * 1_000_000);
        if goes_on {
            self.resumed_us = now_us;
        } else {
            self.state = self.estimator.state();
            self.helm.forget();
        }
        goes_on
    }

    /// What is believed of the motion.
    pub fn estimate(&self) -> &Estimate {
        self.state.estimate()
    }

    /// How the estimator and its sources are.
    ///
    /// - `now_us`: µs since boot.
    pub fn telemetry(&self, now_us: u64) -> EstimatorTelemetry {
        self.estimator.telemetry(&self.state, now_us)
    }

    /// What decides.
    pub fn helm(&self) -> &Helm {
        &self.helm
    }
}

/// Autopilot, and what it is told only now and then.
#[derive(Debug)]
pub struct Helm {
    autopilot: Autopilot,
    state: AutopilotState,
    pilot: Option<Stamped<PilotInput>>,
    offboard: Option<Stamped<Setpoint>>,
    battery: Battery,
    acted_us: Option<u64>,
    /// Time between the last two samples, s.
    dt_s: f32,
    decision: Option<autopilot::Command>,
}

impl Helm {
    /// Just switched on, with these parameters.
    ///
    /// # Errors
    /// [`ConfigError`] names the first value that cannot fly.
    pub fn try_new(config: &Config, parameters: &Parameters) -> Result<Self, ConfigError> {
        Ok(Self::new(Autopilot::try_new(config, parameters)?))
    }

    fn new(autopilot: Autopilot) -> Self {
        Self {
            state: autopilot.state(),
            autopilot,
            pilot: None,
            offboard: None,
            battery: Battery::default(),
            acted_us: None,
            dt_s: 0.0,
            decision: None,
        }
    }

    /// What the motors do, by what was decided at the estimate before; to be called at each.
    ///
    /// - `now_us`: µs since boot.
    pub fn act(&mut self, now_us: u64, estimate: &Estimate) -> Command {
        self.advance(now_us);
        let motors = self.autopilot.act(&mut self.state, estimate, self.dt_s);
        self.command(motors)
    }

    /// The same where no estimate has come, and `estimate` is the one before.
    #[cold]
    #[inline(never)]
    pub fn coast(&mut self, now_us: u64, estimate: &Estimate) -> Command {
        self.advance(now_us);
        let motors = self.autopilot.coast(&mut self.state, estimate, self.dt_s);
        self.command(motors)
    }

    fn advance(&mut self, now_us: u64) {
        let elapsed_us = now_us.saturating_sub(self.acted_us.unwrap_or(now_us));
        self.acted_us = Some(now_us);
        // 32 bits have an hour in them, and an instruction to convert them.
        self.dt_s = u32::try_from(elapsed_us).unwrap_or(u32::MAX) as f32 * 1e-6;
    }

    fn command(&self, motors: [f32; 4]) -> Command {
        match motors.map(Scalar::sqrt) {
            speeds if self.is_armed() => Command::Run(speeds),
            speeds if speeds == [0.0; 4] => Command::Stop,
            speeds => Command::Bench(speeds),
        }
    }

    /// Decides what the next estimate is met with; to be called once after each [`Self::act`].
    ///
    /// - `now_us`: µs since boot.
    /// - `gyro_calibrated`: whether the gyro's bias is known.
    pub fn decide(&mut self, now_us: u64, estimate: &Estimate, gyro_calibrated: bool, arrived: &Arrived) {
        self.pilot = arrived.pilot.or(self.pilot);
        self.offboard = arrived.offboard.or(self.offboard);
        self.battery.note(&arrived.measurements);
        if let Some(order) = &arrived.bench {
            self.autopilot.order(&mut self.state, order);
        }
        let system = System {
            battery_v: self.battery.voltage_v(now_us),
            used_as: self.battery.used_as(),
            gyro_calibrated,
            self_test_passed: arrived.self_test_passed,
            parameters_valid: arrived.parameters_valid,
            late: arrived.late,
        };
        let step = autopilot::Step {
            now_us,
            dt_s: self.dt_s,
            estimate,
            pilot: self.pilot.as_ref(),
            offboard: self.offboard.as_ref(),
            system: &system,
        };
        self.decision = Some(self.autopilot.decide(&mut self.state, &step));
    }

    fn pass(&mut self, tape: &mut Tape) {
        pass_pilot(self.pilot, tape);
        tape.float(self.battery.used_mut());
        self.state.pass(tape);
    }

    /// Takes what was kept.
    fn go_on(&mut self, tape: &mut Tape, estimate: &Estimate) {
        let pilot = pass_pilot(None, tape);
        tape.float(self.battery.used_mut());
        self.pilot = Some(pilot);
        self.state.go_on(tape, estimate, pilot.value.mode);
    }

    /// As just switched on.
    fn forget(&mut self) {
        (self.state, self.pilot, self.battery) = (self.autopilot.state(), None, Battery::default());
    }

    /// Tells the controller what is known of the rotors: see [`Controller::report`].
    pub fn report(&mut self, shares: [Option<f32>; 4]) {
        self.autopilot.controller().report(&mut self.state.controller, shares);
    }

    fn is_armed(&self) -> bool {
        self.decision.as_ref().is_some_and(|decision| decision.armed)
    }

    /// What is known of the battery.
    pub fn battery(&self) -> &Battery {
        &self.battery
    }

    /// The autopilot's last decision, once it has made one.
    pub fn decision(&self) -> Option<&autopilot::Command> {
        self.decision.as_ref()
    }

    /// The autopilot's state.
    pub fn state(&self) -> &AutopilotState {
        &self.state
    }

    /// The controller, for its telemetry.
    pub fn controller(&self) -> &Controller {
        self.autopilot.controller()
    }
}

/// Passes the pilot's last frame, whose arm switch is on.
fn pass_pilot(pilot: Option<Stamped<PilotInput>>, tape: &mut Tape) -> Stamped<PilotInput> {
    let unheard = PilotInput { sticks: Sticks::NEUTRAL, arm: true, mode: Mode::Disarmed };
    let mut frame = pilot.unwrap_or(Stamped { time_us: 0, value: unheard });
    let PilotInput { sticks: Sticks { right, forward, clockwise, throttle }, mode, .. } = &mut frame.value;
    for stick in [right, forward, clockwise, throttle] {
        tape.float(stick);
    }
    let mut place = *mode as usize;
    tape.index(&mut place, Mode::ALL.len());
    *mode = Mode::ALL.get(place).copied().unwrap_or(*mode);
    tape.time(&mut frame.time_us);
    frame
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Airframe;
    use crate::estimation::GyroConfig;
    use crate::frames::Vec3;
    use crate::measurement::Imu;
    use std::vec::Vec;

    const PERIOD_US: u64 = 500;
    const SAMPLE_HZ: f32 = 2_000.0;

    fn flight() -> Flight {
        let gyro = GyroConfig { sample_hz: SAMPLE_HZ, ..EstimatorConfig::FLIGHT.gyro };
        let controller = Config { control_hz: SAMPLE_HZ, ..Config::tolerant(Airframe::paper(2.2)) };
        let config = FlightConfig {
            controller,
            regulators: &controller.regulators().unwrap(),
            estimator: EstimatorConfig { gyro, ..EstimatorConfig::FLIGHT },
        };
        Flight::try_new(&config, &Parameters::default()).unwrap()
    }

    /// A machine at rest on the ground whose arm switch goes on after `armed_s`; returns the last command.
    fn rest(seconds: f32, armed_s: f32, self_test_passed: bool) -> (Command, Flight) {
        let (commands, flight) = rest_since(0, seconds, armed_s, self_test_passed);
        (*commands.last().unwrap(), flight)
    }

    /// The same, with a clock that begins at `start_us`; returns every command.
    fn rest_since(start_us: u64, seconds: f32, armed_s: f32, self_test_passed: bool) -> (Vec<Command>, Flight) {
        let mut flight = flight();
        let mut commands = Vec::new();
        for n in 0..(seconds * SAMPLE_HZ) as u64 {
            let elapsed_us = PERIOD_US * (n + 1);
            let now_us = start_us + elapsed_us;
            // A part that always says the same is taken for one that is stuck.
            let noise = (n % 7) as f32 * 1e-3;
            let rate_rad_s = Vec3::new(noise, -noise, noise);
            let value = Imu { rate_rad_s, specific_force_m_s2: Vec3::new(noise, noise, -9.81 - noise) };
            let sticks = Sticks { throttle: 0.0, ..Sticks::NEUTRAL };
            let arm = elapsed_us as f32 > 1e6 * armed_s;
            let pilot = PilotInput { sticks, arm, mode: Mode::Angle };
            commands.push(flight.step(
                now_us,
                &Arrived {
                    measurements: Measurements {
                        imu: Some(Stamped { time_us: now_us, value }),
                        ..Measurements::default()
                    },
                    pilot: Some(Stamped { time_us: now_us, value: pilot }),
                    self_test_passed,
                    parameters_valid: true,
                    ..Arrived::default()
                },
            ));
        }
        (commands, flight)
    }

    #[test]
    fn nothing_changes_where_32_bits_of_microseconds_or_of_milliseconds_roll_over() {
        let (commands, _) = rest_since(0, 6.0, 4.5, true);
        assert!(commands.iter().any(|command| matches!(command, Command::Run(_))));
        for wrap_us in [1_u64 << 31, 1 << 32, 1000 << 32, 36_000_000_000] {
            // While it aligns, and after it has armed.
            for before_us in [1_000_000, 5_000_000] {
                let (same, _) = rest_since(wrap_us - before_us, 6.0, 4.5, true);
                let first = commands.iter().zip(&same).position(|(a, b)| a != b);
                assert_eq!(first, None, "steps after {wrap_us} - {before_us} us");
            }
        }
    }

    #[test]
    fn a_machine_at_rest_arms_when_the_switch_goes_on_and_idles() {
        let (command, flight) = rest(5.0, 4.5, true);
        let Command::Run(shares) = command else { panic!("{:?}", flight.helm().decision()) };
        assert!(shares.iter().all(|&share| (0.05..0.6).contains(&share)), "{shares:?}");
    }

    #[test]
    fn no_motor_turns_before_the_switch_nor_with_a_part_that_is_not_there() {
        for (why, armed_s, self_test_passed) in [("not armed", 9.0, true), ("a part is gone", 4.5, false)] {
            assert_eq!(rest(5.0, armed_s, self_test_passed).0, Command::Stop, "{why}");
        }
        let (command, flight) = rest(2.0, 1.0, true);
        assert_eq!(command, Command::Stop, "the gyro's bias is not known yet: {:?}", flight.helm().decision());
    }
}
