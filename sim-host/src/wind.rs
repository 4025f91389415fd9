//! Wind: a steady stream, and gusts as a force and a torque that wander.
use nalgebra::Vector3;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[wind]`: air that moves.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Wind {
    /// Steady wind (north, east, down), m/s. It acts through the vehicle's linear drag.
    pub mean_ned_m_s: [f64; 3],
    /// Root mean square of the gust force on each horizontal axis, N.
    pub gust_rms_n: f64,
    /// Time constant of the gusts, an Ornstein-Uhlenbeck process, s.
    pub gust_time_constant_s: f64,
    /// Vertical gust force over horizontal.
    pub gust_vertical_share: f64,
    /// Root mean square of the air's torque about each body axis, N m.
    pub torque_rms_nm: f64,
    /// Time constant of that torque, an Ornstein-Uhlenbeck process, s.
    pub torque_time_constant_s: f64,
}

impl Default for Wind {
    fn default() -> Self {
        Self {
            mean_ned_m_s: [0.0; 3],
            gust_rms_n: 0.0,
            gust_time_constant_s: 1.0,
            gust_vertical_share: 0.5,
            torque_rms_nm: 0.0,
            torque_time_constant_s: 0.3,
        }
    }
}

/// Wind at one instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gust {
    /// Speed of the air, NED, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Gust force, NED, N.
    pub force_n: Vector3<f64>,
    /// Torque of the air, body, N m.
    pub torque_nm: Vector3<f64>,
}

/// An Ornstein-Uhlenbeck process of unit variance on each of three axes, which begins in its stationary distribution.
struct Wandering {
    level: Vector3<f64>,
    random: Pcg64,
}

impl Wandering {
    fn new(mut random: Pcg64) -> Self {
        Self { level: Vector3::from_fn(|_, _| StandardNormal.sample(&mut random)), random }
    }

    /// Its level `dt_s` later. Sampled exactly, at any step.
    fn step(&mut self, dt_s: f64, time_constant_s: f64) -> &Vector3<f64> {
        let keep = libm::exp(-dt_s / time_constant_s);
        let kick = libm::sqrt(1.0 - keep * keep);
        let random = &mut self.random;
        self.level = self.level.map(|x| {
            let noise: f64 = StandardNormal.sample(random);
            keep * x + kick * noise
        });
        &self.level
    }
}

/// The gusts of one flight.
pub struct Gusts {
    wind: Wind,
    force: Wandering,
    torque: Wandering,
}

impl Gust {
    /// Air that stands.
    pub const CALM: Self = Self {
        velocity_m_s: Vector3::new(0.0, 0.0, 0.0),
        force_n: Vector3::new(0.0, 0.0, 0.0),
        torque_nm: Vector3::new(0.0, 0.0, 0.0),
    };
}

impl Gusts {
    /// Gusts with their own random numbers, forces and torques apart.
    pub fn new(wind: Wind, force: Pcg64, torque: Pcg64) -> Self {
        Self { wind, force: Wandering::new(force), torque: Wandering::new(torque) }
    }

    /// The wind for the next `dt_s`.
    pub fn step(&mut self, dt_s: f64) -> Gust {
        let wind = &self.wind;
        let force = self.force.step(dt_s, wind.gust_time_constant_s);
        let torque = self.torque.step(dt_s, wind.torque_time_constant_s);
        Gust {
            velocity_m_s: wind.mean_ned_m_s.into(),
            force_n: force.component_mul(&Vector3::new(1.0, 1.0, wind.gust_vertical_share)) * wind.gust_rms_n,
            torque_nm: torque * wind.torque_rms_nm,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn gusts_have_the_stated_strength_and_memory() {
        let wind = Wind { gust_rms_n: 0.3, torque_rms_nm: 0.01, ..Wind::default() };
        let mut gusts = Gusts::new(wind, Pcg64::seed_from_u64(1), Pcg64::seed_from_u64(2));
        let dt_s = 0.01;
        let (samples, torques): (Vec<_>, Vec<_>) = (0..1_000_000)
            .map(|_| {
                let gust = gusts.step(dt_s);
                (gust.force_n, gust.torque_nm)
            })
            .unzip();
        let mean_of = |f: &dyn Fn(usize) -> f64, n: usize| (0..n).map(f).sum::<f64>() / n as f64;
        let rms = |axis: usize| libm::sqrt(mean_of(&|i| samples[i][axis] * samples[i][axis], samples.len()));
        // 10 000 time constants: the estimate is within 2 %.
        assert!((rms(0) - 0.3).abs() < 0.01, "{}", rms(0));
        assert!((rms(2) - 0.15).abs() < 0.005, "{}", rms(2));
        let lag = 100;
        let correlation = mean_of(&|i| samples[i].x * samples[i + lag].x, samples.len() - lag) / (rms(0) * rms(0));
        assert!((correlation - libm::exp(-1.0)).abs() < 0.03, "{correlation}");

        let lag = 30;
        let square = |axis: usize| mean_of(&|i| torques[i][axis] * torques[i][axis], torques.len());
        for axis in 0..3 {
            assert!((libm::sqrt(square(axis)) - 0.01).abs() < 2e-4, "torque about {axis}");
        }
        let correlation = mean_of(&|i| torques[i].z * torques[i + lag].z, torques.len() - lag) / square(2);
        assert!((correlation - libm::exp(-1.0)).abs() < 0.03, "{correlation}");
        let together = mean_of(&|i| torques[i].x * samples[i].x, torques.len()) / (0.3 * 0.01);
        assert!(together.abs() < 0.03, "force and torque are drawn apart: {together}");
    }
}
