//! A magnetometer as it is built in: the earth's field, iron, and the motors' current. What a calibration makes of it is `calibration.rs`.
//!
//! ```text
//! m = (1 + S) Rᵀ B + h + k I + w + σ n,   w a random walk
//! ```
//!
//! B is the field in NED by strength, inclination and declination, S soft iron, h hard iron, k the field of the current I.
use super::World;
use super::broken::Broken;
use super::chance::{Chance, register};
use super::keys::{EarthKeys, SensorKeys};
use super::line::Line;
use super::parts::{MagPart, MagSheet};
use super::{narrow, stream};
use crate::fault::sensors::{Sensor, SensorFault};
use control_core::frames::{Body, Vec3};
use control_core::measurement::Stamped;
use nalgebra::{Matrix3, Vector3};

/// Hard iron, each axis, 1 σ, µT.
const HARD_UT: f64 = 10.0;
/// Soft iron and how the sensor is turned, each element, 1 σ.
const SOFT: f64 = 0.05;

impl EarthKeys {
    /// The field, NED, µT.
    pub fn field_ned_ut(&self) -> [f64; 3] {
        let level_ut = self.field_ut * libm::cos(self.inclination_rad);
        let (sin, cos) = (libm::sin(self.declination_rad), libm::cos(self.declination_rad));
        [level_ut * cos, level_ut * sin, self.field_ut * libm::sin(self.inclination_rad)]
    }
}

/// A magnetometer in flight.
pub(super) struct MagModel {
    sheet: MagSheet,
    line: Line<Vec3<Body>>,
    chance: Chance,
    broken: Broken<Vector3<f64>>,
    noise: f64,
    period_s: f64,
    field_ut: Vector3<f64>,
    soft: Matrix3<f64>,
    /// Hard iron, and what it has wandered.
    hard_ut: Vector3<f64>,
    current_ut_a: Vector3<f64>,
}

impl MagModel {
    pub(super) fn new(part: MagPart, keys: &SensorKeys, faults: &[SensorFault], seed: u64) -> Self {
        let sheet = part.sheet();
        let tuned = keys.tuned(sheet.timing, |each| each.mag);
        let mut chance = stream(seed, Sensor::Mag, 1);
        Self {
            line: Line::new(tuned.timing, chance.even()),
            broken: Broken::new(faults, Sensor::Mag, 1, seed),
            noise: tuned.noise,
            period_s: 1.0 / tuned.timing.rate_hz,
            field_ut: keys.earth.field_ned_ut().into(),
            soft: Matrix3::from_fn(|_, _| SOFT * tuned.noise * chance.normal()),
            hard_ut: chance.normals() * (HARD_UT * tuned.noise),
            current_ut_a: keys.mag_ut_per_a.into(),
            chance,
            sheet,
        }
    }

    /// The same compass at another time: other noise, and an offset that has wandered for `apart_s`.
    pub(super) fn at_another_time(mut self, apart_s: f64, mut chance: Chance) -> Self {
        self.hard_ut += chance.normals() * (self.sheet.walk_ut * self.noise * libm::sqrt(apart_s));
        Self { chance, ..self }
    }

    /// - `current_a`: of all motors.
    pub(super) fn sample(&mut self, world: &World, current_a: f64) -> Option<Stamped<Vec3<Body>>> {
        if self.line.is_due(world.t_s) {
            let MagSheet { noise_ut, walk_ut, lsb_ut, span_ut, .. } = self.sheet;
            let field_ut = world.truth.attitude.transpose() * self.field_ut;
            self.hard_ut += self.chance.normals() * (walk_ut * self.noise * libm::sqrt(self.period_s));
            let white_ut = self.chance.normals() * (noise_ut * self.noise);
            let iron_ut = self.soft * field_ut + self.hard_ut;
            let there_ut = field_ut + iron_ut + self.current_ut_a * current_a + white_ut;
            let span = |axis: usize| (-span_ut[axis], span_ut[axis]);
            let read_ut = self.broken.read(world.t_s, there_ut, span);
            let read_ut = Vector3::from_fn(|axis, _| register(read_ut[axis], lsb_ut, span(axis)));
            let lost = self.broken.is_lost();
            self.line.send(world.t_s, (!lost).then(|| narrow(&read_ut)), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }
}
