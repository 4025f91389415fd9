//! Wind: a steady stream, and gusts as a force that wanders.
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
}

impl Default for Wind {
    fn default() -> Self {
        Self { mean_ned_m_s: [0.0; 3], gust_rms_n: 0.0, gust_time_constant_s: 1.0, gust_vertical_share: 0.5 }
    }
}

/// Wind at one instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gust {
    /// Speed of the air, NED, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Gust force, NED, N.
    pub force_n: Vector3<f64>,
}

/// The gusts of one flight.
pub struct Gusts {
    wind: Wind,
    /// Unit-variance process on each axis.
    level: Vector3<f64>,
    random: Pcg64,
}

impl Gusts {
    /// Gusts that begin in their stationary distribution.
    pub fn new(wind: Wind, mut random: Pcg64) -> Self {
        let level = Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
        Self { wind, level, random }
    }

    /// The wind for the next `dt_s`. The process is sampled exactly, at any step.
    pub fn step(&mut self, dt_s: f64) -> Gust {
        let keep = libm::exp(-dt_s / self.wind.gust_time_constant_s);
        let kick = libm::sqrt(1.0 - keep * keep);
        let random = &mut self.random;
        self.level = self.level.map(|x| {
            let noise: f64 = StandardNormal.sample(random);
            keep * x + kick * noise
        });
        let vertical = self.wind.gust_vertical_share;
        Gust {
            velocity_m_s: self.wind.mean_ned_m_s.into(),
            force_n: self.level.component_mul(&Vector3::new(1.0, 1.0, vertical)) * self.wind.gust_rms_n,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn gusts_have_the_stated_strength_and_memory() {
        let wind = Wind { gust_rms_n: 0.3, ..Wind::default() };
        let mut gusts = Gusts::new(wind, Pcg64::seed_from_u64(1));
        let dt_s = 0.01;
        let samples: Vec<_> = (0..1_000_000).map(|_| gusts.step(dt_s).force_n).collect();
        let mean_of = |f: &dyn Fn(usize) -> f64, n: usize| (0..n).map(f).sum::<f64>() / n as f64;
        let rms = |axis: usize| libm::sqrt(mean_of(&|i| samples[i][axis] * samples[i][axis], samples.len()));
        // 10 000 time constants: the estimate is within 2 %.
        assert!((rms(0) - 0.3).abs() < 0.01, "{}", rms(0));
        assert!((rms(2) - 0.15).abs() < 0.005, "{}", rms(2));
        let lag = 100;
        let correlation = mean_of(&|i| samples[i].x * samples[i + lag].x, samples.len() - lag) / (rms(0) * rms(0));
        assert!((correlation - libm::exp(-1.0)).abs() < 0.03, "{correlation}");
    }
}
