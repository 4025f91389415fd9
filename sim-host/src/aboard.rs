//! What is aboard: the sensors of a scenario and the estimator that makes a motion of them.
//!
//! A flight begins in a hover, and an estimator at rest: for [`HELD_S`] before the flight the machine is held where it will begin,
//! its rotors still for two seconds and then turning, while the sensors are read. The board's clock began then.
use crate::fault::sensors::SensorFault;
use crate::sensors::{Calibration, Carrier, SensorKeys, SensorSuite, World};
use control_core::compass;
use control_core::estimate::Estimate;
use control_core::estimation::{
    Estimator, EstimatorConfig, EstimatorConfigError, EstimatorState, EstimatorTelemetry, GyroConfig, STATES,
};
use control_core::frames::{Ned, Vec3};
use control_core::measurement::Measurements;
use control_core::{Input, Setpoint};
use nalgebra::Vector3;

mod account;
mod apart;
mod consistency;

pub use account::{Account, Lost, QUANTITIES, Quantity, Verdict};
pub use apart::Apart;
pub use consistency::{Consistency, band, consistency};

/// How long the machine is held before a flight, s: the estimator finds rest, then the biases settle.
pub const HELD_S: f64 = 6.0;
/// How long of that no rotor turns, s: their vibration is not rest.
const STILL_S: f64 = 2.0;

/// Sensors and estimator of one flight.
pub struct Aboard {
    suite: SensorSuite,
    calibration: Calibration,
    /// Largest thrust of a rotor, N, and the load of the motors by their last command.
    thrust_n_max: f64,
    load: f32,
    estimator: Estimator,
    state: EstimatorState,
    flown: bool,
    /// When the flight began, by the board's clock, s.
    began_s: f64,
    dt_s: f64,
    /// Whether a source knows where the flight is; else the flight begins where it is said to.
    placed: bool,
    /// Where the estimator's origin is, m.
    origin_m: Vec3<Ned>,
    estimate: Estimate,
    /// What arrived in the last tick.
    arrived: Measurements,
    /// The same less what is known of the compass, for those who look on.
    measurements: Measurements,
}

/// The estimator for the sensors `keys`, sampled `control_hz` times a second, of which `calibration` is known.
///
/// # Errors
/// [`EstimatorConfigError`] names what it cannot fly with.
pub fn estimator(
    keys: &SensorKeys,
    control_hz: f64,
    calibration: &Calibration,
) -> Result<Estimator, EstimatorConfigError> {
    let [north, east, down] = keys.earth.field_ned_ut().map(|ut| ut as f32);
    let config = EstimatorConfig {
        earth_field_ut: Vec3::new(north, east, down),
        gyro: GyroConfig { sample_hz: control_hz as f32, ..EstimatorConfig::FLIGHT.gyro },
        ..EstimatorConfig::FLIGHT
    };
    Estimator::try_new(&config.calibrated(calibration.compass, calibration.accelerometer_m_s2))
}

impl Aboard {
    /// Sensors and estimator as `keys` say. Those that are flown are switched on before the flight; faults count from its beginning.
    pub fn new(keys: &SensorKeys, faults: &[SensorFault], carrier: &Carrier) -> Self {
        let held_s = if keys.flown { HELD_S } else { 0.0 };
        let mut shifted = faults.to_vec();
        for fault in &mut shifted {
            fault.from_s += held_s;
            fault.until_s += held_s;
        }
        // One that is refused is not calibrated: a builder would fly it as it is, or not at all.
        let calibration = Calibration::learn(keys, carrier).unwrap_or(Calibration::NONE);
        // The scenario's check has built it before.
        let estimator = estimator(keys, carrier.control_hz, &calibration).unwrap_or_else(|error| panic!("{error}"));
        let mut state = estimator.state();
        let estimate = *estimator.step(&mut state, &Measurements::default(), 0);
        Self {
            suite: SensorSuite::new(keys, &shifted, carrier),
            calibration,
            thrust_n_max: carrier.vehicle.thrust_n_max(),
            load: 0.0,
            estimator,
            state,
            flown: keys.flown,
            began_s: held_s,
            dt_s: 1.0 / carrier.control_hz,
            placed: keys.gnss.is_some() || keys.vision.is_some(),
            origin_m: Vec3::zero(),
            estimate,
            arrived: Measurements::default(),
            measurements: Measurements::default(),
        }
    }

    /// Reads the sensors while the machine is held, until the flight begins.
    pub fn hold(&mut self, still: &World) {
        for tick in 0..(self.began_s / self.dt_s).round() as usize {
            let t_s = tick as f64 * self.dt_s;
            let rotor_n = if t_s < STILL_S { &[0.0; 4] } else { still.rotor_n };
            self.hear(rotor_n);
            self.step(&World { t_s: t_s - self.began_s, rotor_n, ..*still });
        }
        if !self.placed {
            let [north, east, down] = still.truth.position_m.map(|x| x as f32).into();
            self.origin_m = Vec3::new(north, east, down) - self.estimate.position_m;
        }
    }

    /// Reads the sensors, and estimates: [`Self::sample`], then [`Self::settle`].
    pub fn step(&mut self, world: &World) {
        self.sample(world);
        self.settle(world.t_s);
    }

    /// Reads the sensors, and estimates what the motors wait for; to be called once a tick. Times of `world` are the flight's.
    pub fn sample(&mut self, world: &World) {
        let t_s = world.t_s + self.began_s;
        self.arrived = self.suite.sample(&World { t_s, ..*world });
        self.measurements = self.arrived;
        self.calibration.correct(&mut self.measurements, self.load);
        self.state.bear(self.load);
        let now_us = self.clock_us(world.t_s);
        let estimate = *self.estimator.sample(&mut self.state, &self.arrived, now_us);
        self.believe(estimate);
    }

    /// Estimates the rest, at `t_s` of the flight; to be called once after each sample.
    pub fn settle(&mut self, t_s: f64) {
        let now_us = self.clock_us(t_s);
        let estimate = *self.estimator.settle(&mut self.state, &self.arrived, now_us);
        self.believe(estimate);
    }

    fn believe(&mut self, estimate: Estimate) {
        self.estimate = Estimate { position_m: estimate.position_m + self.origin_m, ..estimate };
    }

    /// Hears what the rotors are commanded, N.
    pub fn hear(&mut self, command_n: &[f64; 4]) {
        self.load = compass::load(&command_n.map(|n| (n / self.thrust_n_max) as f32));
    }

    /// Whether controllers fly on the estimate.
    pub fn is_flown(&self) -> bool {
        self.flown
    }

    /// The board's clock when the flight's is `t_s`, µs.
    pub fn clock_us(&self, t_s: f64) -> u64 {
        libm::round((t_s + self.began_s) * 1e6) as u64
    }

    /// What arrived in the last tick, less what is known of the compass.
    pub fn measurements(&self) -> &Measurements {
        &self.measurements
    }

    /// What is believed of the motion.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// How the estimator and its sources are, at `t_s` of the flight.
    pub fn telemetry(&self, t_s: f64) -> EstimatorTelemetry {
        self.estimator.telemetry(&self.state, self.clock_us(t_s))
    }

    /// Covariance of the estimate's errors, in the order of [`EstimatorState::covariance`].
    pub fn covariance(&self) -> &[[f32; STATES]; STATES] {
        self.state.covariance()
    }

    /// What the estimator should find as biases of the first inertial unit: see [`SensorSuite::inertial_errors`].
    pub fn true_biases(&self) -> Option<[Vector3<f64>; 2]> {
        self.suite.inertial_errors()
    }

    /// The controller's sample made of the estimate.
    pub fn input(&self, setpoint: Setpoint) -> Input {
        let Estimate { position_m, velocity_m_s, attitude, rate_rad_s, specific_force_m_s2, .. } = self.estimate;
        let dt_s = self.dt_s as f32;
        Input { dt_s, position_m, velocity_m_s, attitude, rate_rad_s, specific_force_m_s2, setpoint }
    }
}
