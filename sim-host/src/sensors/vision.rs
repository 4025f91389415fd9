//! A pose from outside: motion capture, late by its processing and its radio.
//!
//! ```text
//! p = p_true + σ n        R = R_true · small(a + σ' n),   a the error of alignment between markers and body
//! ```
use super::World;
use super::broken::{Broken, Reading};
use super::chance::{Chance, register};
use super::keys::SensorKeys;
use super::line::Line;
use super::parts::{VisionPart, VisionSheet};
use super::{narrow, small_rotation, stream};
use crate::fault::sensors::{Sensor, SensorFault};
use control_core::frames::Attitude;
use control_core::measurement::{Stamped, Vision};
use nalgebra::{Matrix3, Vector3};

/// Position and attitude; faults are of the position, and take the attitude along where they take the whole.
#[derive(Clone, Copy)]
struct Pose {
    position_m: Vector3<f64>,
    attitude: Matrix3<f64>,
}

impl Reading for Pose {
    fn channels(&mut self) -> &mut [f64] {
        self.position_m.as_mut_slice()
    }
}

/// Motion capture in flight.
pub(super) struct VisionModel {
    sheet: VisionSheet,
    line: Line<Vision>,
    chance: Chance,
    broken: Broken<Pose>,
    noise: f64,
    alignment_rad: Vector3<f64>,
}

impl VisionModel {
    pub(super) fn new(part: VisionPart, keys: &SensorKeys, faults: &[SensorFault], seed: u64) -> Self {
        let sheet = part.sheet();
        let tuned = keys.tuned(sheet.timing, |each| each.vision);
        let mut chance = stream(seed, Sensor::Vision, 1);
        Self {
            line: Line::new(tuned.timing, chance.even()),
            broken: Broken::new(faults, Sensor::Vision, 1, seed),
            noise: tuned.noise,
            alignment_rad: chance.normals() * (sheet.alignment_rad * tuned.noise),
            chance,
            sheet,
        }
    }

    pub(super) fn sample(&mut self, world: &World) -> Option<Stamped<Vision>> {
        if self.line.is_due(world.t_s) {
            let VisionSheet { noise_m, noise_rad, alignment_rad, lsb_m, span_m, .. } = self.sheet;
            let position_m = world.truth.position_m + self.chance.normals() * (noise_m * self.noise);
            let error_rad = self.alignment_rad + self.chance.normals() * (noise_rad * self.noise);
            let pose = Pose { position_m, attitude: world.truth.attitude * small_rotation(error_rad) };
            let Pose { position_m, attitude } = self.broken.read(world.t_s, pose, |_| (-span_m, span_m));
            let lost = self.broken.is_lost();
            let vision = Vision {
                position_m: narrow(&position_m.map(|x| register(x, lsb_m, (-span_m, span_m)))),
                attitude: Attitude { rows: std::array::from_fn(|i| std::array::from_fn(|j| attitude[(i, j)] as f32)) },
                position_sigma_m: (noise_m * self.noise) as f32,
                attitude_sigma_rad: (libm::hypot(noise_rad, alignment_rad) * self.noise) as f32,
            };
            self.line.send(world.t_s, (!lost).then_some(vision), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }
}
