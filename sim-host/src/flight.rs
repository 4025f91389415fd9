//! One flight: plant, sensors, controller and faults in lock-step.
use crate::aboard::Aboard;
use crate::actuators::Told;
use crate::controllers::ControllerName;
use crate::machine::{Machine, Moment};
use crate::plant::Truth;
use crate::preflight;
use crate::reference::Target;
use crate::scenario::Scenario;
use crate::sensors::Sensors;
use crate::sortie::Decision;
use control_core::estimate::Estimate;
use control_core::estimation::EstimatorTelemetry;
use control_core::measurement::Measurements;
use control_core::{Config, ConfigError, Controller, Input, Output, Q16, Scalar, Telemetry, WiringFault};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use std::collections::VecDeque;
use std::fmt;

/// The arithmetic the controller flies in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NumberFormat {
    /// Single precision, as on the board.
    #[default]
    F32,
    /// Double precision, the reference.
    F64,
    /// Fixed point Q16.16.
    Q16,
}

/// One flight to fly.
#[derive(Clone, Copy)]
pub struct Flight<'a> {
    /// What happens.
    pub scenario: &'a Scenario,
    /// Who flies.
    pub controller: ControllerName,
    /// Seed of noise and wind; the same for every controller, so that they meet the same weather.
    pub seed: u64,
    /// The arithmetic.
    pub format: NumberFormat,
}

/// Everything about one tick.
pub struct Sample<'a> {
    /// Number of the tick, from 0.
    pub tick: usize,
    /// Time, s.
    pub t_s: f64,
    /// Where the machine is told to be.
    pub target: &'a Target,
    /// Where it is.
    pub truth: &'a Truth,
    /// What the controller sees.
    pub input: &'a Input,
    /// What has arrived from the sensors, if the scenario names any.
    pub measurements: &'a Measurements,
    /// The board's clock, s.
    pub clock_s: f64,
    /// What is believed of the motion, if the scenario names sensors.
    pub estimate: Option<&'a Estimate>,
    /// What made it.
    pub aboard: Option<&'a Aboard>,
    /// How the estimator and its sources are, if there are any.
    pub estimator: Option<&'a EstimatorTelemetry>,
    /// What the autopilot decided, if it flies.
    pub decision: Option<&'a Decision<'a>>,
    /// What it answers.
    pub output: &'a Output,
    /// What its answer asks of the body: u1 in N, u2 to u4 in N m.
    pub commanded: &'a [f64; 4],
    /// What it thinks.
    pub telemetry: &'a Telemetry,
    /// Share of its thrust each rotor still makes.
    pub effectiveness: &'a [f64; 4],
    /// What the controller was told of the faults, and what an oracle would be.
    pub told: &'a Told,
}

impl Sample<'_> {
    /// Altitude less its setpoint, m.
    pub fn altitude_error_m(&self) -> f64 {
        self.truth.altitude_m() - self.target.position_m[2]
    }

    /// North and east less their setpoints, m.
    pub fn lateral_error_m(&self) -> [f64; 2] {
        let [north, east, _] = self.target.position_m;
        [self.truth.position_m.x - north, self.truth.position_m.y - east]
    }

    /// Heading less its setpoint, the short way, rad.
    pub fn yaw_error_rad(&self) -> f64 {
        let [.., yaw_rad] = self.truth.angles_rad();
        crate::reference::wrap_pi(yaw_rad - self.target.yaw_rad)
    }
}

/// Why a flight ended before its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// |φ| or |θ| beyond [`TILT_RAD_MAX`].
    Tilt,
    /// Farther than [`DISTANCE_M_MAX`] from the setpoint.
    Distance,
    /// Met the ground too fast, or beyond [`UPRIGHT_RAD_MAX`].
    Ground(Touchdown),
    /// A state that is not a finite number.
    NotFinite,
}

/// Tilt that is a crash, rad.
pub const TILT_RAD_MAX: f64 = 1.4;
/// Distance from the setpoint that is a crash, m.
pub const DISTANCE_M_MAX: f64 = 30.0;
/// Tilt at ground contact that is a crash once a fault has begun, rad.
pub const UPRIGHT_RAD_MAX: f64 = std::f64::consts::FRAC_PI_4;

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tilt => write!(f, "tilted beyond {TILT_RAD_MAX} rad"),
            Self::Distance => write!(f, "strayed more than {DISTANCE_M_MAX} m from the setpoint"),
            Self::Ground(touchdown) => write!(f, "hit the ground {touchdown}"),
            Self::NotFinite => f.write_str("reached a state that is not a finite number"),
        }
    }
}

/// How the ground was met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touchdown {
    /// Vertical speed, m/s.
    pub speed_m_s: f64,
    /// Angle of the rotors' axis to the vertical, rad.
    pub tilt_rad: f64,
}

impl fmt::Display for Touchdown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at {:.2} m/s, tilted by {:.2} rad", self.speed_m_s, self.tilt_rad)
    }
}

/// A crash.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crash {
    /// When, s.
    pub t_s: f64,
    /// Why.
    pub cause: Cause,
}

impl fmt::Display for Crash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "crashed at {:.3} s: {}", self.t_s, self.cause)
    }
}

/// A flight that a fault brought down in one piece.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landing {
    /// When, s.
    pub t_s: f64,
    /// How.
    pub touchdown: Touchdown,
}

impl fmt::Display for Landing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "came down at {:.3} s: {}", self.t_s, self.touchdown)
    }
}

/// A flight that the check before take-off forbade.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refusal {
    /// Why.
    pub fault: WiringFault,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "refused to take off: {}", self.fault)
    }
}

/// How a flight ended before its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ending {
    /// It is broken.
    Crashed(Crash),
    /// It is on the ground, upright and whole: once a fault has begun, meeting the ground ends a flight.
    CameDown(Landing),
    /// It never took off.
    Refused(Refusal),
}

/// Streams of random numbers that never mix: more draws of one leave the others as they were.
#[derive(Clone, Copy)]
pub(crate) enum Stream {
    Noise = 1,
    Wind = 2,
    Fault = 3,
    Torque = 4,
    Campaign = 5,
    Preflight = 6,
    Sensor = 7,
    SensorFault = 8,
    Calibration = 9,
}

pub(crate) fn random(seed: u64, stream: Stream) -> Pcg64 {
    random_of(seed, stream, 0)
}

/// The same for one of many of a kind.
pub(crate) fn random_of(seed: u64, stream: Stream, index: u8) -> Pcg64 {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    bytes[8] = stream as u8;
    bytes[9] = index;
    // `from_seed` takes the bytes as they are; one round of splitting spreads neighbouring seeds.
    Pcg64::from_rng(&mut Pcg64::from_seed(bytes))
}

impl Flight<'_> {
    /// Flies; `observe` sees every tick. Returns how the flight ended, if before its time.
    ///
    /// # Errors
    /// [`ConfigError`] if the controller refuses its configuration.
    pub fn fly(&self, observe: &mut dyn FnMut(&Sample)) -> Result<Option<Ending>, ConfigError> {
        self.fly_as(&self.controller.config(self.scenario), observe)
    }

    /// The same with a configuration that is not quite the controller's own.
    pub fn fly_as(&self, config: &Config, observe: &mut dyn FnMut(&Sample)) -> Result<Option<Ending>, ConfigError> {
        if self.scenario.preflight
            && let Err(fault) = preflight::check(self.scenario, self.seed, &mut |_| {})
        {
            return Ok(Some(Ending::Refused(Refusal { fault })));
        }
        if let Some(keys) = &self.scenario.autopilot {
            return self.fly_sortie(keys, config, observe);
        }
        match self.format {
            NumberFormat::F32 => self.fly_in::<f32>(config, observe),
            NumberFormat::F64 => self.fly_in::<f64>(config, observe),
            NumberFormat::Q16 => self.fly_in::<Q16>(config, observe),
        }
    }

    fn fly_in<S: Scalar>(
        &self,
        config: &Config,
        observe: &mut dyn FnMut(&Sample),
    ) -> Result<Option<Ending>, ConfigError> {
        let scenario = self.scenario;
        let controller = Controller::<S>::try_new(config)?;
        let mut state = controller.hover_state();
        let mut machine = Machine::hovering(self);
        let mut sensors = Sensors::new(scenario.noise, random(self.seed, Stream::Noise));
        let mut aboard = machine.aboard();
        let late = (scenario.oracle_delay_s * scenario.control_hz()).round() as usize;
        let nothing = Measurements::default();
        let mut news = VecDeque::from(vec![[1.0; 4]; late]);
        for tick in 0..machine.ticks() {
            let moment = machine.look(tick);
            let &Moment { t_s, ref truth, ref effectiveness, .. } = &moment;
            let target = scenario.reference.target(t_s);
            let mut input = sensors.sample(truth, machine.vibration(), &target, machine.dt_s);
            if let Some(aboard) = &mut aboard {
                aboard.step(&machine.world(&moment));
                if aboard.is_flown() {
                    input = aboard.input(target.setpoint());
                }
            }
            let told = machine.told();
            news.push_back(told.truth);
            let known = news.pop_front().unwrap_or(told.truth);
            let shares = if self.controller == ControllerName::Oracle { known.map(Some) } else { told.reported };
            controller.report(&mut state, shares.map(|share| share.map(S::from_f32)));
            let output = controller.tick(&mut state, &input.cast()).to_f32();
            let telemetry = controller.telemetry(&state).to_f32();
            let command_n = output.thrust_n.map(f64::from);
            let torque = machine.vehicle.torque_n_m(&command_n);
            observe(&Sample {
                commanded: &[command_n.iter().sum(), torque.x, torque.y, torque.z],
                tick,
                t_s,
                target: &target,
                truth,
                input: &input,
                measurements: aboard.as_ref().map_or(&nothing, Aboard::measurements),
                clock_s: aboard.as_ref().map_or(t_s, |aboard| aboard.clock_us(t_s) as f64 * 1e-6),
                estimate: aboard.as_ref().map(Aboard::estimate),
                aboard: aboard.as_ref(),
                estimator: aboard.as_ref().map(|aboard| aboard.telemetry(t_s)).as_ref(),
                decision: None,
                output: &output,
                telemetry: &telemetry,
                effectiveness,
                told: &told,
            });
            if let Some(ending) = self.ending(t_s, truth, &target) {
                return Ok(Some(ending));
            }
            if let Some(aboard) = &mut aboard {
                aboard.hear(&command_n);
            }
            machine.act(command_n, 0.0);
        }
        Ok(None)
    }

    /// Whether this is the end of the flight.
    fn ending(&self, t_s: f64, truth: &Truth, target: &Target) -> Option<Ending> {
        let [north, east, up] = target.position_m;
        let away = truth.position_m - nalgebra::vector![north, east, -up];
        let [roll, pitch, _] = truth.angles_rad();
        let touchdown = Touchdown { speed_m_s: truth.impact_m_s, tilt_rad: truth.tilt_rad() };
        let fast = touchdown.speed_m_s > self.scenario.airframe.impact_m_s_max();
        let faulty = self.scenario.fault.iter().any(|fault| fault.from_s <= t_s);
        let down = truth.touching && faulty;
        let cause = if !(away.norm() + truth.velocity_m_s.norm() + truth.rate_rad_s.norm()).is_finite() {
            Cause::NotFinite
        } else if fast || (down && touchdown.tilt_rad > UPRIGHT_RAD_MAX) {
            Cause::Ground(touchdown)
        } else if down {
            return Some(Ending::CameDown(Landing { t_s, touchdown }));
        } else if roll.abs().max(pitch.abs()) > TILT_RAD_MAX {
            Cause::Tilt
        } else if away.norm() > DISTANCE_M_MAX {
            Cause::Distance
        } else {
            return None;
        };
        Some(Ending::Crashed(Crash { t_s, cause }))
    }
}
