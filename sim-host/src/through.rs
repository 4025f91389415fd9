//! A sortie through the emulator: the image that is flashed decides, on a chip that is emulated.
//!
//! ```text
//! truth ─► sensors ─► devices ─┐               ┌─► speed controllers ─► actuators, faults ─► plant
//!              radio ─► pilot ─┴─► the image ──┴─► record of each step ─► Twin: the same core on the host
//! ```
//!
//! Scenario, sensors, faults and metrics are those of every sortie; a tick is a sample of the image's inertial unit. Samples reach
//! the image as its parts would tell them, quantised by their registers. What the image believes is read of the host's
//! `Twin`, which is given what the image has decoded and must decide the same to the bit.
use crate::aboard::HELD_S;
use crate::emulator::{Answer, Emulator, EmulatorError, Store, Taken};
use crate::fault::sensors::SensorFault;
use crate::flight::{Ending, Flight, Sample};
use crate::machine::{Machine, Moment};
use crate::metrics::{Flown, measured};
use crate::sensors::{Calibration, Carrier, SensorKeys, SensorSuite, World};
use crate::sortie::Outside;
use control_core::compass::load;
use control_core::flight::Unflyable;
use control_core::geodesy::GeodesyError;
use control_core::measurement::Measurements;
use control_core::parameters::Parameters;
use firmware::stored::SaveError;
use said::Said;
use std::time::Instant;
use twin::Twin;

mod said;
pub(crate) mod twin;

pub use twin::{Parting, Verdict};

/// Core clock of the emulated chip, Hz.
pub const CORE_HZ: f64 = 168e6;

/// Why an image cannot fly.
#[derive(Debug, thiserror::Error)]
pub enum ThroughError {
    /// It does not run.
    #[error(transparent)]
    Emulator(#[from] EmulatorError),
    /// The host refuses what the image is configured with.
    #[error("{0}.{1} = {2}: cannot fly")]
    Unflyable(&'static str, &'static str, f32),
    /// Its parameters cannot be stored.
    #[error("the flash takes no parameters: {0:?}")]
    Store(SaveError),
    /// The world's origin is no place on earth.
    #[error(transparent)]
    Place(#[from] GeodesyError),
    /// The scenario names no sensors: see [`Scenario::for_image`](crate::scenario::Scenario::for_image).
    #[error("sensors: nothing: must be a table that names parts")]
    Blind,
}

/// What the flight took of the board, and what the host says to it.
#[derive(Clone, Debug)]
pub struct Board {
    /// How long it ran, s.
    pub emulated_s: f64,
    /// How long that took, s.
    pub wall_s: f64,
    /// Share of the time that the core was awake.
    pub load: f64,
    /// Longest time from an inertial sample to a motor frame through after it, s.
    pub latency_max_s: f64,
    /// Of the stack, and by each task.
    pub taken: Taken,
    /// Whether the host has decided the same.
    pub verdict: Verdict,
    /// What the image has logged.
    pub log: String,
}

/// Flies and measures; `observe` sees every sample as well.
///
/// # Errors
/// [`ThroughError`] if the image does not run to the end of the flight.
pub fn fly_measured(flight: &Flight, observe: &mut dyn FnMut(&Sample)) -> Result<(Flown, Board), ThroughError> {
    let mut board = None;
    let flown = measured(
        flight,
        |observe| {
            let (ending, flown_by) = fly(flight, observe)?;
            board = Some(flown_by);
            Ok::<_, ThroughError>(ending)
        },
        observe,
    )?;
    board.map(|board| (flown, board)).ok_or(ThroughError::Blind)
}

fn fly(flight: &Flight, observe: &mut dyn FnMut(&Sample)) -> Result<(Option<Ending>, Board), ThroughError> {
    let scenario = flight.scenario;
    let keys = scenario.sensors.as_ref().ok_or(ThroughError::Blind)?;
    let mut machine = Machine::standing(flight);
    let mut faults = scenario.sensor_fault.clone();
    for fault in &mut faults {
        fault.from_s += HELD_S;
        fault.until_s += HELD_S;
    }
    let mut suite = Trimmed::new(keys, &faults, &machine.carrier());
    let mut outside = Outside::new(&scenario.event);
    // They were looked at when the scenario was read.
    let parameters = scenario.autopilot.as_ref().and_then(|keys| keys.values().ok()).unwrap_or_default();
    let mut image = Image::switch_on(keys, &parameters)?;
    let weight_torque_nm = machine.vehicle.weight_torque_nm();
    let began = Instant::now();

    // As long as every flight on sensors is held before it begins. The first period is the whole boot.
    let start = machine.start();
    let held = (HELD_S / machine.dt_s).round() as usize;
    let mut first = None;
    let mut answer = None;
    for tick in 0..held {
        let t_s = tick as f64 * machine.dt_s;
        let next = image.period(t_s, &mut suite, &machine.held(&start), &outside)?;
        first.get_or_insert((next.cycles, next.busy));
        answer = Some(next);
    }
    let mut ending = None;
    for tick in 0..machine.ticks() {
        let moment = machine.look(tick);
        let &Moment { t_s, ref truth, ref effectiveness, .. } = &moment;
        let target = scenario.reference.target(t_s);
        outside.step(t_s);
        let next = image.period(t_s + HELD_S, &mut suite, &machine.world(&moment), &outside)?;
        // Of the largest thrust, which goes with the square of the speed.
        let shares = next.speeds().map(|speed| speed * speed);
        suite.load = load(&shares.map(|share| share as f32));
        let command_n = shares.map(|share| share * machine.vehicle.thrust_n_max());
        let torque = machine.vehicle.torque_n_m(&command_n);
        let told = machine.told();
        image.twin.show(&target, |seen| {
            observe(&Sample {
                tick,
                t_s,
                target: &target,
                truth,
                input: &seen.input,
                measurements: seen.measurements,
                clock_s: seen.clock_s,
                estimate: Some(seen.estimate),
                aboard: None,
                estimator: Some(&seen.estimator),
                decision: seen.decision.as_ref(),
                output: &control_core::Output { thrust_n: command_n.map(|n| n as f32), rejected: seen.rejected },
                commanded: &[command_n.iter().sum(), torque.x, torque.y, torque.z],
                telemetry: &seen.telemetry,
                effectiveness,
                told: &told,
            });
        });
        answer = Some(next);
        ending = flight.broken(t_s, truth);
        if ending.is_some() {
            break;
        }
        machine.act(command_n, outside.hand_nm(t_s, weight_torque_nm));
    }
    let (first, last) = (first.unwrap_or_default(), answer.as_ref().map_or((0, 0), |last| (last.cycles, last.busy)));
    let board = Board {
        emulated_s: last.0 as f64 / CORE_HZ,
        wall_s: began.elapsed().as_secs_f64(),
        load: (last.1 - first.1) as f64 / (last.0 - first.0).max(1) as f64,
        latency_max_s: answer.map_or(0.0, |last| last.latency_max as f64 / CORE_HZ),
        taken: image.emulator.taken()?,
        verdict: image.twin.finish(),
        log: image.log,
    };
    Ok((ending, board))
}

/// Sensors whose calibration is taken off before the image reads them, as if it were soldered in: its own parameters for them are the defaults.
struct Trimmed {
    suite: SensorSuite,
    calibration: Calibration,
    /// Of the motors, by what they were last told.
    load: f32,
}

impl Trimmed {
    fn new(keys: &SensorKeys, faults: &[SensorFault], carrier: &Carrier) -> Self {
        let calibration = Calibration::learn(keys, carrier).unwrap_or(Calibration::NONE);
        Self { suite: SensorSuite::new(keys, faults, carrier), calibration, load: 0.0 }
    }

    fn sample(&mut self, world: &World) -> Measurements {
        let mut measurements = self.suite.sample(world);
        self.calibration.correct(&mut measurements, self.load);
        if let Some(imu) = &mut measurements.imu {
            imu.value.specific_force_m_s2 = imu.value.specific_force_m_s2 - self.calibration.accelerometer_m_s2;
        }
        measurements
    }
}

/// The image, and who watches it.
struct Image {
    emulator: Emulator,
    said: Said,
    twin: Twin,
    log: String,
}

impl Image {
    fn switch_on(keys: &SensorKeys, parameters: &Parameters) -> Result<Self, ThroughError> {
        let mut emulator = Emulator::start()?;
        let set = parameters.iter().filter(|(known, value)| *value != known.default);
        emulator.fill_store(&Store::after(set.map(|(known, value)| (known.name, value))).map_err(ThroughError::Store)?);
        let said = Said::new(&mut emulator, keys)?;
        let twin = Twin::new(parameters)
            .map_err(|Unflyable { name: [part, name], value }| ThroughError::Unflyable(part, name, value))?;
        Ok(Self { emulator, said, twin, log: String::new() })
    }

    /// One period of the inertial unit.
    ///
    /// - `t_s`: since the sensors were switched on; that of `world` does not count.
    fn period(
        &mut self,
        t_s: f64,
        suite: &mut Trimmed,
        world: &World,
        outside: &Outside,
    ) -> Result<Answer, ThroughError> {
        let measurements = suite.sample(&World { t_s, ..*world });
        self.said.measure(&mut self.emulator, t_s, &measurements);
        self.said.late(&mut self.emulator, outside.is_late());
        self.said.pilot(&mut self.emulator, outside.pilot());
        let answer = self.emulator.period()?;
        if let Some(record) = &answer.record {
            self.twin.follow(record);
        }
        if !answer.log.is_empty() {
            self.log += &answer.log;
            self.log.push('\n');
        }
        Ok(answer)
    }
}
