//! An inertial unit: what turns and accelerates it, through its own low-pass, with its errors, to its registers.
//!
//! ```text
//! x   mean rate and mean specific force of the tick, from attitudes and velocities, so that their integrals are exact
//! y = low-pass( (1 + M) x + b + vibration + N √(f/2) n )         b ← b + σ √dt n,   n white, of variance 1
//! ```
//!
//! M is scale error and misalignment, f the control rate, N the noise density: a one-sided density N through the chip's
//! second-order low-pass. Readings are means of y since the last sample. The low-pass is bilinear and pre-warped, of the
//! control rate; where its corner is beyond 0.45 of that rate, it is left out. Vibration is what damaged propellers shake,
//! and the residual unbalance of healthy ones, at the frequency of each rotor and, vertically, at twice that.
use super::World;
use super::broken::Broken;
use super::chance::{Chance, register};
use super::keys::SensorKeys;
use super::line::{Line, Timing};
use super::parts::{ImuPart, ImuSheet, InertialSheet};
use super::{narrow, stream};
use crate::fault::sensors::{Sensor, SensorFault};
use crate::plant::Truth;
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use control_core::measurement::{Imu, Stamped};
use nalgebra::{Matrix3, Vector3};
use std::array::from_fn;
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// Vertical force of a blade that passes an arm, over the rotor's thrust.
const BLADE_PASSAGE: f64 = 0.02;
/// Height of the rotors' plane above the centre of mass, m.
const ROTOR_HEIGHT_M: f64 = 0.05;
/// How long an error must last to be steady, s.
const STEADY_S: f64 = 1.0;
/// Highest corner of the low-pass, over the control rate.
const CORNER_MAX: f64 = 0.45;

/// Residual vibration of healthy rotors.
pub(super) struct Shake {
    unbalance_kg_m: f64,
    angles_rad: [f64; 4],
    dt_s: f64,
}

impl Shake {
    pub(super) fn new(unbalance_kg_m: f64, dt_s: f64, chance: &mut Chance) -> Self {
        Self { unbalance_kg_m, angles_rad: from_fn(|_| TAU * chance.even()), dt_s }
    }

    /// Specific force and rates that it adds now, body axes.
    pub(super) fn step(&mut self, vehicle: &Vehicle, rotor_n: &[f64; 4]) -> [Vector3<f64>; 2] {
        let [mut force, mut rate] = [Vector3::zeros(); 2];
        let inertia = Vector3::from(vehicle.inertia_kg_m2);
        for (i, angle_rad) in self.angles_rad.iter_mut().enumerate() {
            let thrust_n = rotor_n[i].max(0.0);
            let speed_rad_s = libm::sqrt(thrust_n / vehicle.thrust_coefficient_n_s2);
            // Rotors 1 and 3 turn counter-clockwise seen from above, against body z.
            let turn_rad_s = if i % 2 == 0 { -speed_rad_s } else { speed_rad_s };
            *angle_rad = (*angle_rad + turn_rad_s * self.dt_s) % TAU;
            let (sin, cos) = (libm::sin(*angle_rad), libm::cos(*angle_rad));
            let radial_n = self.unbalance_kg_m * speed_rad_s * speed_rad_s;
            let passage_n = BLADE_PASSAGE * thrust_n * libm::sin(2.0 * *angle_rad);
            force += Vector3::new(radial_n * cos, radial_n * sin, passage_n) / vehicle.mass_kg;
            let [forward, right] = vehicle.arms_m[i];
            let impulse_n_s = Vector3::new(sin, -cos, 0.0) * (self.unbalance_kg_m * turn_rad_s);
            rate += Vector3::new(forward, right, -ROTOR_HEIGHT_M).cross(&impulse_n_s).component_div(&inertia);
        }
        [force, rate]
    }
}

/// Second-order Butterworth low-pass on three axes.
struct LowPass {
    gain: f64,
    /// Of the last two outputs.
    back: [f64; 2],
    memory: Option<[Vector3<f64>; 2]>,
}

impl LowPass {
    /// None where the control rate is too low for the corner.
    fn new(corner_hz: f64, control_hz: f64) -> Option<Self> {
        if corner_hz > CORNER_MAX * control_hz {
            return None;
        }
        let k = libm::tan(PI * corner_hz / control_hz);
        let norm = 1.0 / (1.0 + k / FRAC_1_SQRT_2 + k * k);
        let back = [2.0 * (k * k - 1.0) * norm, (1.0 - k / FRAC_1_SQRT_2 + k * k) * norm];
        Some(Self { gain: k * k * norm, back, memory: None })
    }

    fn step(&mut self, x: Vector3<f64>) -> Vector3<f64> {
        let [a1, a2] = self.back;
        // At rest in its first input.
        let [s1, s2] = self.memory.unwrap_or([x * (1.0 - self.gain), x * (self.gain - a2)]);
        let y = x * self.gain + s1;
        self.memory = Some([x * (2.0 * self.gain) - y * a1 + s2, x * self.gain - y * a2]);
        y
    }
}

/// Gyro or accelerometer of a unit.
struct Half {
    sheet: InertialSheet,
    chance: Chance,
    broken: Broken<Vector3<f64>>,
    bias: Vector3<f64>,
    /// Scale error and misalignment.
    skew: Matrix3<f64>,
    /// Mean of what bias, scale and misalignment make, over [`STEADY_S`].
    steady: Vector3<f64>,
    noise: f64,
    low_pass: Option<LowPass>,
    sum: Vector3<f64>,
}

impl Half {
    fn new(sheet: InertialSheet, unit: &ImuSheet, setup: &Setup, sensor: Sensor) -> Self {
        let Setup { keys, faults, control_hz, index, seed, .. } = *setup;
        let mut chance = stream(seed, sensor, index);
        let noise = keys.noise.imu.unwrap_or(1.0);
        let (bias, skew) =
            if keys.calibrated { (sheet.residual, unit.scale_residual) } else { (sheet.offset, unit.scale) };
        Self {
            broken: Broken::new(faults, sensor, index, seed),
            bias: chance.normals() * (bias * noise),
            skew: Matrix3::from_fn(|_, _| skew * noise * chance.normal()),
            steady: Vector3::zeros(),
            low_pass: LowPass::new(unit.corner_hz, control_hz),
            sum: Vector3::zeros(),
            sheet,
            chance,
            noise,
        }
    }

    /// The same at another time: other noise, and a bias that has wandered for `apart_s`.
    fn at_another_time(mut self, apart_s: f64, mut chance: Chance) -> Self {
        self.bias += chance.normals() * (self.sheet.walk * self.noise * libm::sqrt(apart_s));
        Self { chance, ..self }
    }

    /// One tick of the signal.
    fn step(&mut self, truth: Vector3<f64>, vibration: Vector3<f64>, dt_s: f64) {
        self.bias += self.chance.normals() * (self.sheet.walk * self.noise * libm::sqrt(dt_s));
        let white = self.chance.normals() * (self.sheet.density * self.noise * libm::sqrt(0.5 / dt_s));
        let error = self.skew * truth + self.bias;
        self.steady += (error - self.steady) * (dt_s / STEADY_S);
        let signal = truth + self.skew * truth + self.bias + vibration + white;
        self.sum += match &mut self.low_pass {
            Some(low_pass) => low_pass.step(signal),
            None => signal,
        };
    }

    /// What the registers say of the ticks since the last sample, and whether anyone hears it.
    fn read(&mut self, t_s: f64, ticks: f64) -> (Vector3<f64>, bool) {
        let mean = self.sum / ticks;
        self.sum = Vector3::zeros();
        let InertialSheet { lsb, span, .. } = self.sheet;
        let read = self.broken.read(t_s, mean, |_| (-span, span));
        (read.map(|x| register(x, lsb, (-span, span))), self.broken.is_lost())
    }
}

/// What a unit is made from.
pub(super) struct Setup<'a> {
    pub(super) keys: &'a SensorKeys,
    pub(super) faults: &'a [SensorFault],
    pub(super) control_hz: f64,
    /// Which of its kind, from 1.
    pub(super) index: u8,
    pub(super) seed: u64,
}

/// An inertial unit in flight.
pub(super) struct ImuModel {
    line: Line<Imu>,
    gyro: Half,
    accelerometer: Half,
    before: Option<(Vector3<f64>, Matrix3<f64>)>,
    ticks: f64,
    dt_s: f64,
}

impl ImuModel {
    pub(super) fn new(part: ImuPart, setup: &Setup) -> Self {
        let sheet = part.sheet();
        let timing = Timing { rate_hz: setup.control_hz, latency_s: 0.0, jitter_s: sheet.jitter_s };
        let timing = setup.keys.tuned(timing, |each| each.imu).timing;
        Self {
            line: Line::new(timing, 0.0),
            gyro: Half::new(part.sheet().gyro, &sheet, setup, Sensor::Gyro),
            accelerometer: Half::new(part.sheet().accelerometer, &sheet, setup, Sensor::Accelerometer),
            before: None,
            ticks: 0.0,
            dt_s: 1.0 / setup.control_hz,
        }
    }

    /// The same unit at another time: other noise, and biases that have wandered for `apart_s`.
    pub(super) fn at_another_time(self, apart_s: f64, [gyro, accelerometer]: [Chance; 2]) -> Self {
        Self {
            gyro: self.gyro.at_another_time(apart_s, gyro),
            accelerometer: self.accelerometer.at_another_time(apart_s, accelerometer),
            ..self
        }
    }

    /// - `shaken`: specific force and rates that healthy rotors add.
    pub(super) fn sample(&mut self, world: &World, shaken: &[Vector3<f64>; 2]) -> Option<Stamped<Imu>> {
        let [force, rate] = self.means(world.truth);
        self.before = Some((world.truth.velocity_m_s, world.truth.attitude));
        let vibration = world.vibration;
        self.gyro.step(rate, vibration.rate_rad_s + shaken[1], self.dt_s);
        self.accelerometer.step(force, vibration.specific_force_m_s2 + shaken[0], self.dt_s);
        self.ticks += 1.0;
        if self.line.is_due(world.t_s) {
            let (rate, gyro_lost) = self.gyro.read(world.t_s, self.ticks);
            let (force, accelerometer_lost) = self.accelerometer.read(world.t_s, self.ticks);
            self.ticks = 0.0;
            let sample = Imu { rate_rad_s: narrow(&rate), specific_force_m_s2: narrow(&force) };
            // One chip: without one half there is no sample.
            self.line.send(world.t_s, (!(gyro_lost | accelerometer_lost)).then_some(sample), &mut self.gyro.chance);
        }
        self.line.receive(world.t_s)
    }

    /// What it reads beyond the truth for a second and longer, vibration and faults apart: gyro, then accelerometer.
    pub(super) fn steady_errors(&self) -> [Vector3<f64>; 2] {
        [self.gyro.steady, self.accelerometer.steady]
    }

    /// Mean specific force and rates since the last tick, body axes.
    fn means(&self, truth: &Truth) -> [Vector3<f64>; 2] {
        let Some((velocity_m_s, attitude)) = self.before else {
            return [truth.specific_force_m_s2, truth.rate_rad_s];
        };
        let turn = attitude.transpose() * truth.attitude;
        let sine =
            Vector3::new(turn[(2, 1)] - turn[(1, 2)], turn[(0, 2)] - turn[(2, 0)], turn[(1, 0)] - turn[(0, 1)]) * 0.5;
        let size = sine.norm().min(1.0);
        let rate = sine * (if size > 1e-9 { libm::asin(size) / size } else { 1.0 } / self.dt_s);
        let gravity = Vector3::z() * f64::from(GRAVITY_M_S2);
        let force_ned = (truth.velocity_m_s - velocity_m_s) / self.dt_s - gravity;
        // Seen from the attitude half way: the mean of both, to the second order of a tick.
        [(attitude + truth.attitude).transpose() * force_ned * 0.5, rate]
    }
}
