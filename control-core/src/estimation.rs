//! The estimator: inertial samples and whatever else arrives in; attitude, motion, biases, their uncertainty and health out.
//!
//! ```text
//!  gyro, accelerometer ─► dead reckoning ────────────────► Estimate, every sample
//!                              │ every 4 ms     ▲
//!                              ▼                │ corrections
//!                         covariance, history ──┴─ GNSS, barometer, magnetometer, range and flow, vision: each at its own time
//! ```
//!
//! An error-state Kalman filter of seventeen states: attitude, velocity, position, gyro and accelerometer bias, the barometer's offset and the
//! ground's height. It starts at rest (`alignment.rs`), and falls back to fixed gains (`complementary.rs`) while its covariance or state cannot be believed.
//! Nothing is assumed of what makes the machine move: no thrust, drag or hover enters, so that wind and a lost rotor are motion, which
//! they are, and not bias.
//!
//! Invariants: no input makes it panic or put out a number that is not finite; a sample that cannot be true changes nothing but its
//! source's telemetry; the estimate of a step depends on nothing but the steps before.
//!
//! Elsewhere: `phases.rs` from rest to the filter to fixed gains and back, `strapdown.rs` dead reckoning, `covariance.rs` the matrix, `history.rs` delays, `observe.rs` the models, `fusing.rs` what is done
//! with each source, `sources.rs` what is let in, `rivals.rs` satellites against flow and dead reckoning, `units.rs` one inertial unit against the other, `gyro.rs` the filters of the rates. docs/estimation.md has the equations and figures.
use crate::Scalar;
use crate::estimate::Estimate;
use crate::frames::{Body, Vec3};
use crate::measurement::{Imu, Measurements, Stamped};
use crate::restart::Tape;
use alignment::Alignment;
use filter::Filter;
use gyro::{GyroChain, GyroState};
use rivals::Rivals;
use sources::Watch;
use units::Units;

mod admission;
mod alignment;
mod complementary;
mod config;
mod covariance;
mod filter;
mod fusing;
mod gyro;
mod health;
mod history;
mod observe;
mod phases;
mod quaternion;
mod rivals;
mod sources;
mod start;
mod strapdown;
mod units;

pub use config::{AidingNoise, EstimatorConfig, EstimatorConfigError, HealthLimits, InertialNoise};
pub use covariance::STATES;
pub use gyro::GyroConfig;
pub use sources::{SOURCES, Source, SourceFault, SourceStatus};

/// What the estimator is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Waiting for rest, and for a direction to call north.
    Aligning,
    /// The filter runs.
    Running,
    /// The filter was not to be believed; fixed gains hold the attitude.
    FallenBack,
}

/// What the estimator is doing, and how its sources are, for logs and arming checks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorTelemetry {
    /// What it is doing.
    pub phase: Phase,
    /// In the order of [`Source::ALL`].
    pub sources: [SourceStatus; SOURCES],
    /// States that were set anew because the filter and a source disagreed for too long.
    pub resets: u32,
    /// Times the filter was not to be believed.
    pub fallbacks: u32,
    /// What the barometer reads above altitude, m.
    pub barometer_offset_m: f32,
    /// The inertial unit that is gone by.
    pub inertial: Source,
    /// Where range and flow see the ground, m down.
    pub ground_m: Option<f32>,
    /// How much later slow motion leaves the filters of the rates than it enters them, s.
    pub rate_delay_s: f32,
}

/// Time between two steps of the covariance, and what a sample may come early, µs.
const STEP_US: u64 = 4_000;
const EARLY_US: u64 = 250;
/// A gap between inertial samples that is bridged with the last rates; and in pieces of what length, s.
const GAP_S_MAX: f32 = 0.5;
const PIECE_S: f32 = 0.02;

/// When each quantity was last observed, µs.
#[derive(Clone, Copy, Debug, Default)]
#[expect(clippy::struct_field_names, reason = "the unit")]
struct Aided {
    velocity_us: u64,
    position_us: u64,
    altitude_us: u64,
    heading_us: u64,
    /// By external vision, which outranks the magnetometer.
    seen_us: u64,
}

/// An inertial sample that was gone by.
#[derive(Clone, Copy, Debug)]
struct Due {
    imu: Stamped<Imu>,
    /// Its rates, less their bias where it is known.
    rate_rad_s: Vec3<Body>,
    /// How long it lasted, s.
    dt_s: f32,
}

/// Everything that changes in flight.
#[derive(Clone, Copy, Debug)]
pub struct EstimatorState {
    phase: Phase,
    filter: Filter,
    alignment: Alignment,
    watches: [Watch; SOURCES],
    /// Admitted, to be fused with the next step of the covariance; of the compass, the field of the earth.
    pending: Measurements,
    /// What the motors bear: see [`Self::bear`].
    motor_load: f32,
    gyro: GyroState,
    aided: Aided,
    /// Whether a position, and an altitude, of the world's frame has been seen.
    placed: bool,
    levelled: bool,
    /// The barometer that the offset is of.
    barometer_heard: Option<Source>,
    units: Units,
    rivals: Rivals,
    /// Time of the last inertial sample, of the last step of the covariance, and of the last whose corrections were made, µs.
    time_us: u64,
    stepped_us: u64,
    settled_us: u64,
    /// What of the present step no sample covered, s.
    gap_s: f32,
    /// The last sample, until it is settled.
    due: Option<Due>,
    fallen_s: f32,
    /// When the range last agreed with the ground, µs.
    ranged_us: u64,
    /// Whether the last step fused a pose or a fix.
    large_last: bool,
    /// Steps since dead reckoning was last held together.
    unaided_steps: u8,
    resets: u32,
    fallbacks: u32,
    estimate: Estimate,
}

impl EstimatorState {
    /// The covariance of the errors: attitude (NED, rad), velocity, position, gyro bias, accelerometer bias, the barometer's
    /// offset and the ground.
    pub fn covariance(&self) -> &[[f32; STATES]; STATES] {
        self.filter.covariance.matrix()
    }

    /// What the last step made of everything.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// How the estimate is made at present.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Hears what the motors bear, as [`crate::compass::load`] has it: what their field at the compass is made of from now on.
    pub fn bear(&mut self, motor_load: f32) {
        self.motor_load = motor_load;
    }

    /// Whether the last [`Estimator::sample`] had an inertial sample.
    pub(crate) fn is_new(&self) -> bool {
        self.due.is_some()
    }

    /// Whether filter and estimate may be believed.
    pub(crate) fn is_sound(&self) -> bool {
        self.filter.is_sound() && admission::is_rotation(&self.estimate.attitude)
    }

    /// What a board that was interrupted goes on from.
    pub(crate) fn pass(&mut self, tape: &mut Tape) {
        self.estimate.pass(tape);
        tape.float(&mut self.filter.barometer_offset_m);
        let mut heard = self.barometer_heard == Some(Source::Barometer);
        tape.bits([&mut self.placed, &mut self.levelled, &mut heard]);
        self.barometer_heard = heard.then_some(Source::Barometer).or(self.barometer_heard);
    }
}

/// A checked configuration. Immutable: one may serve many states.
#[derive(Clone, Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    chain: GyroChain,
    /// Unit vector north and east of the earth's field.
    earth: [f32; 2],
    /// Its part down over its horizontal part.
    steep: f32,
    earth_ut: f32,
    /// What iron may turn the heading by.
    iron_rad: f32,
    /// Longest dead reckoning, µs.
    reckoning_us: u64,
}

impl Estimator {
    /// Checks `config` and builds the estimator.
    ///
    /// # Errors
    /// [`EstimatorConfigError`] names the first field that cannot fly, its value and what is allowed.
    pub fn try_new(config: &EstimatorConfig) -> Result<Self, EstimatorConfigError> {
        config.check()?;
        let field = config.earth_field_ut;
        let horizontal = Scalar::sqrt(field.x * field.x + field.y * field.y);
        Ok(Self {
            config: *config,
            chain: GyroChain::new(&config.gyro),
            earth: [field.x / horizontal, field.y / horizontal],
            steep: field.z / horizontal,
            earth_ut: Scalar::sqrt(field.norm_squared()),
            iron_rad: config.aiding.magnetic_bias_ut / horizontal,
            reckoning_us: (config.limits.dead_reckoning_s * 1e6) as u64,
        })
    }

    /// What it is doing, and how its sources are at `now_us`.
    pub fn telemetry(&self, state: &EstimatorState, now_us: u64) -> EstimatorTelemetry {
        let mut sources = [Watch::UNHEARD.status; SOURCES];
        for ((status, watch), source) in sources.iter_mut().zip(&state.watches).zip(Source::ALL) {
            *status = watch.status_at(source, now_us);
            // Flown on with that bias taken off, but not well.
            if source == state.inertial() && state.filter.is_broken(self.config.accelerometer_offset_m_s2) {
                status.fault = status.fault.or(Some(SourceFault::Disagrees));
            }
        }
        EstimatorTelemetry {
            phase: state.phase,
            sources,
            resets: state.resets,
            fallbacks: state.fallbacks,
            barometer_offset_m: state.filter.barometer_offset_m,
            inertial: state.inertial(),
            ground_m: state.filter.ground_m,
            rate_delay_s: self.chain.delay_s(&state.gyro),
        }
    }

    /// Takes in everything that arrived since the last step: [`Self::sample`], then [`Self::settle`].
    ///
    /// - `now_us`: the present, of the clock of the time stamps. Call it once an inertial sample; more or less often is borne.
    /// - Returns the estimate, which lives in the state until the next step.
    pub fn step<'a>(&self, state: &'a mut EstimatorState, measurements: &Measurements, now_us: u64) -> &'a Estimate {
        self.sample(state, measurements, now_us);
        self.settle(state, measurements, now_us)
    }

    /// Goes on by the inertial sample, and nothing that can wait until the motors are told.
    ///
    /// - `now_us`: as for [`Self::step`].
    /// - Returns the motion as it is believed from this sample alone; uncertainty and health are the last step's.
    pub fn sample<'a>(&self, state: &'a mut EstimatorState, measurements: &Measurements, now_us: u64) -> &'a Estimate {
        state.due = None;
        if let Some(imu) = state.admit_inertial(measurements, now_us) {
            let dt_s = state.lasted_s(imu, &self.config);
            let raw = imu.value;
            let (rate_rad_s, force_m_s2) = if state.phase == Phase::Aligning {
                (raw.rate_rad_s, raw.specific_force_m_s2)
            } else {
                let unbiased = state.filter.unbiased(&raw);
                state.reckon(unbiased, dt_s);
                unbiased
            };
            let filtered_rad_s = self.chain.step(&mut state.gyro, rate_rad_s, now_us);
            state.fill_fast(imu.time_us, force_m_s2, filtered_rad_s);
            state.due = Some(Due { imu: *imu, rate_rad_s, dt_s });
            state.time_us = imu.time_us;
        }
        &state.estimate
    }

    /// Takes in the rest of what arrived, and does what every 4 ms hangs on the samples; to be called once after each.
    pub fn settle<'a>(&self, state: &'a mut EstimatorState, measurements: &Measurements, now_us: u64) -> &'a Estimate {
        let before = (state.settled_us, state.phase);
        let due = state.due.take();
        if let Some(due) = &due {
            match state.phase {
                Phase::Aligning => self.align(state, due),
                Phase::Running | Phase::FallenBack => self.correct(state, due),
            }
        }
        // After the corrections: what is fused was there when the step of the covariance was closed.
        self.admit(state, measurements, now_us);
        // Between two corrections nothing changes of it but that samples fail to come.
        if due.is_none() || before != (state.settled_us, state.phase) {
            self.judge(state, now_us);
        }
        &state.estimate
    }
}

impl EstimatorState {
    /// Dead reckoning by one sample.
    fn reckon(&mut self, (rate_rad_s, force_m_s2): (Vec3<Body>, Vec3<Body>), dt_s: f32) {
        if dt_s <= PIECE_S {
            self.filter.advance(rate_rad_s, force_m_s2, dt_s);
            return;
        }
        self.gap_s += dt_s - PIECE_S;
        let mut left_s = dt_s.min(GAP_S_MAX);
        while left_s > PIECE_S {
            self.filter.advance(rate_rad_s, force_m_s2, PIECE_S);
            left_s -= PIECE_S;
        }
        self.filter.advance(rate_rad_s, force_m_s2, left_s);
    }

    /// How long a sample lasted, s.
    fn lasted_s(&self, imu: &Stamped<Imu>, config: &EstimatorConfig) -> f32 {
        if self.time_us == 0 {
            return 1.0 / config.gyro.sample_hz;
        }
        // Of 32 bits, which the chip converts by itself; an hour is a gap like any other.
        let lasted_us = u32::try_from(imu.time_us - self.time_us).unwrap_or(u32::MAX);
        lasted_us as f32 * 1e-6
    }
}
