//! How wrong the estimate of a flight was beside the truth, and whether it knew; [`QUANTITIES`] says what each figure is.
use super::apart::{Apart, wide};
use super::consistency::{JUDGED, band, nees};
use crate::flight::Sample;
use control_core::estimate::Health;
use nalgebra::{SVector, Vector3};

/// How often the estimate is looked at, Hz.
const LOOKS_HZ: f64 = 50.0;
/// Where the covariance has velocity, position and the biases of gyro and accelerometer.
const VELOCITY: usize = 3;
const POSITION: usize = 6;
const BIASES: [usize; 2] = [9, 12];
/// The facts of [`Health`], in order.
const FACTS: [&str; 6] = ["rates", "tilt", "heading", "altitude", "velocity", "position"];

fn facts(health: &Health) -> [bool; 6] {
    let Health { rates, tilt, heading, altitude, velocity, position } = *health;
    [rates, tilt, heading, altitude, velocity, position]
}

/// One figure of a flight.
pub struct Quantity {
    /// Name with unit, as in JSON.
    pub name: &'static str,
    /// What it says, in words.
    pub title: &'static str,
    /// Its value.
    pub of: fn(&Verdict) -> f64,
}

/// Every figure, in the order of tables. Root mean squares are over the flight, of the sizes of vectors.
pub static QUANTITIES: [Quantity; 20] = [
    Quantity { name: "attitude_rms_deg", title: "attitude error, rms", of: |v| v.attitude_rms_deg },
    Quantity { name: "tilt_rms_deg", title: "of it, error of the vertical", of: |v| v.tilt_rms_deg },
    Quantity { name: "heading_rms_deg", title: "of it, error of the heading", of: |v| v.heading_rms_deg },
    Quantity { name: "velocity_rms_m_s", title: "velocity error, rms", of: |v| v.velocity_rms_m_s },
    Quantity { name: "position_rms_m", title: "position error, rms", of: |v| v.position_rms_m },
    Quantity { name: "altitude_rms_m", title: "of it, altitude", of: |v| v.altitude_rms_m },
    Quantity {
        name: "distance_95_m",
        title: "true distance from the setpoint, 95 % of the time",
        of: |v| v.distance_95_m,
    },
    Quantity { name: "horizontal_distance_95_m", title: "the same, horizontal", of: |v| v.horizontal_distance_95_m },
    Quantity {
        name: "gyro_bias_error_end_rad_s",
        title: "gyro bias beside the gyro's steady error, at the end",
        of: |v| v.bias_error_end[0],
    },
    Quantity {
        name: "gyro_bias_sigmas_end",
        title: "the same on its worst axis, in its own standard deviations",
        of: |v| v.bias_sigmas_end[0],
    },
    Quantity { name: "gyro_bias_sigmas_max", title: "the same at its worst time", of: |v| v.bias_sigmas_max[0] },
    Quantity {
        name: "accelerometer_bias_error_end_m_s2",
        title: "accelerometer bias beside the accelerometer's steady error, at the end",
        of: |v| v.bias_error_end[1],
    },
    Quantity {
        name: "accelerometer_bias_sigmas_end",
        title: "the same on its worst axis, in its own standard deviations",
        of: |v| v.bias_sigmas_end[1],
    },
    Quantity {
        name: "accelerometer_bias_sigmas_max",
        title: "the same at its worst time",
        of: |v| v.bias_sigmas_max[1],
    },
    Quantity {
        name: "nees_mean",
        title: "NEES of attitude, velocity and position, mean; 9 is right",
        of: |v| mean(&v.nees),
    },
    Quantity {
        name: "nees_inside_share",
        title: "share of the time that it is within its band of 95 %",
        of: |v| v.nees_inside(),
    },
    Quantity { name: "nees_attitude_mean", title: "NEES of attitude alone; 3 is right", of: |v| v.nees_of[0] },
    Quantity { name: "nees_velocity_mean", title: "NEES of velocity alone; 3 is right", of: |v| v.nees_of[1] },
    Quantity { name: "nees_position_mean", title: "NEES of position alone; 3 is right", of: |v| v.nees_of[2] },
    Quantity {
        name: "resets",
        title: "states set anew, and times the filter was given up",
        of: |v| f64::from(v.resets + v.fallbacks),
    },
];

/// A fact of the estimate's health that did not hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lost {
    /// Which.
    pub fact: &'static str,
    /// When it first did not, s.
    pub from_s: f64,
    /// How long in all, s.
    pub for_s: f64,
}

/// How wrong the estimate of one flight was. Fields that are not explained here are in [`QUANTITIES`].
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    attitude_rms_deg: f64,
    tilt_rms_deg: f64,
    heading_rms_deg: f64,
    velocity_rms_m_s: f64,
    position_rms_m: f64,
    altitude_rms_m: f64,
    distance_95_m: f64,
    horizontal_distance_95_m: f64,
    /// Of gyro and accelerometer.
    bias_error_end: [f64; 2],
    bias_sigmas_end: [f64; 2],
    bias_sigmas_max: [f64; 2],
    /// Of attitude, velocity and position.
    nees_of: [f64; 3],
    /// States that were set anew.
    pub resets: u32,
    /// Times the filter was given up for fixed gains.
    pub fallbacks: u32,
    /// NEES of attitude, velocity and position together, 50 times a second.
    pub nees: Vec<f64>,
    /// Facts of its health that did not hold at some time.
    pub lost: Vec<Lost>,
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

impl Verdict {
    /// The figure of this name.
    ///
    /// # Panics
    /// If there is none.
    pub fn of(&self, name: &str) -> f64 {
        let quantity = QUANTITIES.iter().find(|quantity| quantity.name == name);
        (quantity.unwrap_or_else(|| panic!("{name}: no such quantity")).of)(self)
    }

    fn nees_inside(&self) -> f64 {
        let (low, high) = band(JUDGED, 1);
        self.nees.iter().filter(|&&nees| (low..=high).contains(&nees)).count() as f64 / self.nees.len() as f64
    }
}

/// Takes account while a flight is flown.
pub struct Account {
    every: usize,
    looks: f64,
    /// Sums of squares: tilt, heading, velocity, position, altitude.
    squares: [f64; 5],
    distances_m: Vec<f64>,
    horizontal_m: Vec<f64>,
    nees_sums: [f64; 3],
    lost: [Option<Lost>; 6],
    verdict: Verdict,
}

impl Account {
    /// An account of a flight whose controller runs `control_hz` times a second.
    pub fn new(control_hz: f64) -> Self {
        Self {
            every: (control_hz / LOOKS_HZ).round().max(1.0) as usize,
            looks: 0.0,
            squares: [0.0; 5],
            distances_m: Vec::new(),
            horizontal_m: Vec::new(),
            nees_sums: [0.0; 3],
            lost: [None; 6],
            verdict: Verdict::default(),
        }
    }

    /// Notes one tick. A flight without sensors leaves nothing to account for.
    pub fn note(&mut self, sample: &Sample) {
        let Some(aboard) = sample.aboard.filter(|_| sample.tick.is_multiple_of(self.every)) else { return };
        let (truth, estimate) = (sample.truth, aboard.estimate());
        let apart = Apart::of(truth, estimate);
        self.looks += 1.0;
        for (sum, error) in self.squares.iter_mut().zip([
            apart.tilt_rad(),
            apart.heading_rad(),
            apart.velocity_m_s.norm(),
            apart.position_m.norm(),
            apart.position_m.z,
        ]) {
            *sum += error * error;
        }
        let [north, east] = sample.lateral_error_m();
        self.horizontal_m.push(libm::hypot(north, east));
        self.distances_m.push(libm::hypot(libm::hypot(north, east), sample.altitude_error_m()));

        let p = aboard.covariance();
        let Apart { attitude_rad, velocity_m_s, position_m } = apart;
        let all = [attitude_rad, velocity_m_s, position_m];
        let error = SVector::<f64, JUDGED>::from_fn(|i, _| all[i / 3][i % 3]);
        self.verdict.nees.push(nees(p, 0, &error));
        for ((sum, first), error) in self.nees_sums.iter_mut().zip([0, VELOCITY, POSITION]).zip(&all) {
            *sum += nees(p, first, error);
        }

        let believed = [wide(estimate.gyro_bias_rad_s), wide(estimate.accelerometer_bias_m_s2)];
        let true_ones = aboard.true_biases().unwrap_or([Vector3::zeros(); 2]);
        for (half, (believed, true_one)) in believed.iter().zip(&true_ones).enumerate() {
            let error = true_one - believed;
            let sigma = |axis: usize| libm::sqrt(f64::from(p[BIASES[half] + axis][BIASES[half] + axis]));
            let sigmas = (0..3).map(|axis| error[axis].abs() / sigma(axis)).fold(0.0, f64::max);
            self.verdict.bias_error_end[half] = error.norm();
            self.verdict.bias_sigmas_end[half] = sigmas;
            self.verdict.bias_sigmas_max[half] = self.verdict.bias_sigmas_max[half].max(sigmas);
        }

        for ((lost, holds), fact) in self.lost.iter_mut().zip(facts(&estimate.health)).zip(FACTS) {
            if !holds {
                lost.get_or_insert(Lost { fact, from_s: sample.t_s, for_s: 0.0 }).for_s += 1.0 / LOOKS_HZ;
            }
        }
        let telemetry = aboard.telemetry(sample.t_s);
        (self.verdict.resets, self.verdict.fallbacks) = (telemetry.resets, telemetry.fallbacks);
    }

    /// The verdict on the flight; figures of a flight without a tick are not numbers.
    pub fn finish(mut self) -> Verdict {
        let [tilt, heading, velocity, position, altitude] = self.squares;
        let rms = |square: f64| libm::sqrt(square / self.looks);
        let share_95 = |values: &mut Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get((0.95 * values.len() as f64) as usize).copied().unwrap_or(f64::NAN)
        };
        Verdict {
            attitude_rms_deg: rms(tilt + heading).to_degrees(),
            tilt_rms_deg: rms(tilt).to_degrees(),
            heading_rms_deg: rms(heading).to_degrees(),
            velocity_rms_m_s: rms(velocity),
            position_rms_m: rms(position),
            altitude_rms_m: rms(altitude),
            distance_95_m: share_95(&mut self.distances_m),
            horizontal_distance_95_m: share_95(&mut self.horizontal_m),
            nees_of: self.nees_sums.map(|sum| sum / self.looks),
            lost: self.lost.into_iter().flatten().collect(),
            ..self.verdict
        }
    }
}
