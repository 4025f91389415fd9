//! Instructions of an estimator step: what every inertial sample takes before the motors are told, and the worst step in all, with whatever
//! arrives.
//!
//! A machine at rest is enough: no path of the filter depends on what it estimates, but for resets, which are cheaper than what they replace.
use crate::count::Counter;
use crate::stack::Canvas;
use control_core::autopilot::{Autopilot, AutopilotState};
use control_core::estimation::{Estimator, EstimatorConfig, EstimatorState};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::{Flow, Gnss, Imu, Measurements, Stamped, Vision};
use control_core::{Controller, State};
use core::hint::black_box;
use cortex_m_semihosting::hprintln;

/// Samples of 2 ms: a second to align, and the rest to count.
const SAMPLES: u64 = 1500;
const ALIGNED: u64 = 500;
/// Everything arrives together this often, in samples; on an even one, where the covariance steps.
const TOGETHER: u64 = 50;

/// What arrives with the covariance's step.
#[derive(Clone, Copy, PartialEq)]
enum Arrival {
    Nothing,
    Vision,
    Gnss,
    /// Barometer, magnetometer, range and flow.
    Rest,
    Everything,
}

/// Prints one line an arrival, and one of sizes.
pub(crate) fn print(counter: &Counter) -> Result<(), &'static str> {
    let estimator = Estimator::try_new(black_box(&EstimatorConfig::FLIGHT)).map_err(|_| "the estimator is refused")?;
    for (name, arrival) in [
        ("nothing", Arrival::Nothing),
        ("vision", Arrival::Vision),
        ("gnss", Arrival::Gnss),
        ("rest", Arrival::Rest),
        ("everything", Arrival::Everything),
    ] {
        let (path, step, stack) = worst(counter, &estimator, arrival);
        hprintln!("estimator arrival={} path={} step={} stack={}", name, path, step, stack);
    }
    hprintln!(
        "bytes estimator={} estimator_state={} controller={} controller_state={} autopilot={} autopilot_state={}",
        size_of::<Estimator>(),
        size_of::<EstimatorState>(),
        size_of::<Controller>(),
        size_of::<State>(),
        size_of::<Autopilot>(),
        size_of::<AutopilotState>()
    );
    Ok(())
}

/// The most instructions of a sample, and of all that an estimator's step does, and the stack they use, bytes.
fn worst(counter: &Counter, estimator: &Estimator, arrival: Arrival) -> (u32, u32, u32) {
    let mut state = estimator.state();
    let (mut path, mut step) = (0, 0);
    let canvas = Canvas::paint();
    for i in 1..SAMPLES {
        let now_us = i * 2000;
        let measurements = black_box(sample(i, arrival));
        let (sampled, ()) = counter.instructions(|| call_sample(estimator, &mut state, &measurements, now_us));
        let (settled, ()) = counter.instructions(|| call_settle(estimator, &mut state, &measurements, now_us));
        if i > ALIGNED {
            (path, step) = (sampled.max(path), (sampled + settled).max(step));
        }
    }
    (path, step, canvas.depth())
}

/// The first part of a step as a task would call it: not inlined, so that the call is counted too.
#[inline(never)]
fn call_sample(estimator: &Estimator, state: &mut EstimatorState, measurements: &Measurements, now_us: u64) {
    black_box(estimator.sample(state, measurements, now_us));
}

/// The rest of it.
#[inline(never)]
fn call_settle(estimator: &Estimator, state: &mut EstimatorState, measurements: &Measurements, now_us: u64) {
    black_box(estimator.settle(state, measurements, now_us));
}

fn sample(i: u64, arrival: Arrival) -> Measurements {
    // No two samples have the same bits: those would be taken for stuck.
    let jitter = (i % 17) as f32 * 1e-3;
    let now_us = i * 2000;
    let imu = Imu {
        rate_rad_s: Vec3::new(jitter, -jitter, 0.5 * jitter),
        specific_force_m_s2: Vec3::new(jitter, jitter, jitter - 9.81),
    };
    let mut m = Measurements { imu: Some(Stamped { time_us: now_us, value: imu }), ..Measurements::default() };
    m.rotor_rad_s = Some(Stamped { time_us: now_us, value: [500.0 + jitter; 4] });
    let first = i == 20;
    if first {
        // What it needs to align.
        m.magnetic_ut = Some(Stamped { time_us: now_us - 10_000, value: Vec3::new(20.0 + jitter, 1.2, 44.0) });
    }
    if i <= ALIGNED || !i.is_multiple_of(TOGETHER) {
        return m;
    }
    let has = |kind: Arrival| arrival == kind || arrival == Arrival::Everything;
    if has(Arrival::Vision) {
        let value = Vision {
            position_m: Vec3::new(jitter, 0.0, 0.0),
            attitude: Attitude::level(),
            position_sigma_m: 0.002,
            attitude_sigma_rad: 0.01,
        };
        m.vision = Some(Stamped { time_us: now_us - 20_000, value });
    }
    if has(Arrival::Gnss) {
        let value = Gnss {
            position_m: Vec3::new(jitter, 0.0, 0.0),
            velocity_m_s: Vec3::new(0.0, jitter, 0.0),
            horizontal_m: 1.0,
            vertical_m: 1.5,
            speed_m_s: 0.1,
            fixed: true,
        };
        m.gnss = Some(Stamped { time_us: now_us - 240_000, value });
    }
    if has(Arrival::Rest) {
        m.baro_altitude_m = Some(Stamped { time_us: now_us - 20_000, value: jitter });
        m.magnetic_ut = Some(Stamped { time_us: now_us - 10_000, value: Vec3::new(20.0 + jitter, 1.2, 44.0) });
        m.range_m = Some(Stamped { time_us: now_us - 20_000, value: 1.0 + jitter });
        m.flow = Some(Stamped { time_us: now_us - 20_000, value: Flow { rate_rad_s: [jitter, 0.0], quality: 1.0 } });
    }
    m
}
