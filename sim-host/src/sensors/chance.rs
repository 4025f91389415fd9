//! Random processes that sensors err by, each drawn from the stream of its sensor.
//!
//! ```text
//! walk          b ← b + σ √dt n                       σ in unit/√s
//! Gauss-Markov  e ← e exp(−dt/τ) + σ √(1 − exp(−2dt/τ)) n, begun in its stationary distribution
//! ```
use nalgebra::Vector3;
use rand::RngExt;
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_pcg::Pcg64;

/// The random numbers of one sensor.
pub(super) struct Chance(pub(super) Pcg64);

impl Chance {
    /// Of mean 0 and variance 1.
    pub(super) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// The same on three axes.
    pub(super) fn normals(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal())
    }

    /// Evenly within 0..1.
    pub(super) fn even(&mut self) -> f64 {
        self.0.random()
    }

    /// A waiting time of this mean.
    pub(super) fn wait_s(&mut self, mean_s: f64) -> f64 {
        let unit: f64 = Exp1.sample(&mut self.0);
        mean_s * unit
    }
}

/// An error on three axes that wanders and comes back.
pub(super) struct GaussMarkov {
    pub(super) value: Vector3<f64>,
    sigma: Vector3<f64>,
    time_s: f64,
}

impl GaussMarkov {
    pub(super) fn new(sigma: Vector3<f64>, time_s: f64, chance: &mut Chance) -> Self {
        Self { value: sigma.component_mul(&chance.normals()), sigma, time_s }
    }

    /// Its value `dt_s` later. Sampled exactly, at any step.
    pub(super) fn step(&mut self, dt_s: f64, chance: &mut Chance) -> Vector3<f64> {
        let keep = libm::exp(-dt_s / self.time_s);
        let kick = libm::sqrt(1.0 - keep * keep);
        self.value = self.value * keep + self.sigma.component_mul(&chance.normals()) * kick;
        self.value
    }
}

/// The nearest step of a register, within its range.
pub(super) fn register(value: f64, lsb: f64, (low, high): (f64, f64)) -> f64 {
    libm::round(value.clamp(low, high) / lsb) * lsb
}
