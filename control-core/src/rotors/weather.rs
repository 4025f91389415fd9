//! What is ordinary: the mean and the variance that the residual has when no rotor is at fault.
//!
//! ```text
//! x̃ = x − x̄        C = C_w + 10 V        V = what x̃ has had of late beyond C_w, and at least what the configuration says
//! ```
//!
//! C_w is what the sensors' noise leaves; the weather V counts tenfold, since gusts last and so are not independent. One sample counts for
//! three standard deviations at most, so that a fault is found before it passes for weather. At first the weather is taken for bad, and
//! what was seen counts for a short time only. One axis is brought up to date a tick.
use crate::Scalar;

/// What the weather counts for beyond its variance.
const WEATHER: f32 = 10.0;
/// What one sample's square counts for at most, over the variance.
const OUTLIER: f32 = 9.0;
/// Variance that the weather has at first, over the least.
const WARY: f32 = 9.0;
/// Time over which mean and variance are taken at first, s; it grows with the flight up to the last.
const MEMORY_S: (f32, f32) = (0.3, 10.0);
/// Axes of the residual.
const AXES: usize = 3;

/// What the sensors and the calmest weather make of the residual.
#[derive(Clone, Debug)]
pub(super) struct Climate<S> {
    noise: [S; AXES],
    calm: [S; AXES],
}

/// The weather as it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weather<S> {
    mean: [S; AXES],
    variance: [S; AXES],
    /// Diagonal of C⁻¹.
    pub(super) weights: [S; AXES],
    memory_s: S,
    turn: usize,
}

impl<S: Scalar> Climate<S> {
    /// Variances that the sensors' noise and the calmest weather leave in the residual.
    pub(super) fn new(noise: [f32; AXES], calm: [f32; AXES]) -> Self {
        Self { noise: noise.map(S::from_f32), calm: calm.map(S::from_f32) }
    }
}

impl<S: Scalar> Weather<S> {
    /// Bad, until it is known better.
    pub(super) fn unknown(climate: Option<&Climate<S>>) -> Self {
        let variance = climate.map_or([S::ONE; AXES], |climate| climate.calm.map(|calm| calm * S::from_f32(WARY)));
        let noise = climate.map_or([S::ONE; AXES], |climate| climate.noise);
        let weights = core::array::from_fn(|axis| weight(noise[axis], variance[axis]));
        Self { mean: [S::ZERO; AXES], variance, weights, memory_s: S::from_f32(MEMORY_S.0), turn: 0 }
    }

    /// What of the residual is not ordinary.
    pub(super) fn beside(&self, residual: &[S; AXES]) -> [S; AXES] {
        core::array::from_fn(|axis| residual[axis] - self.mean[axis])
    }

    /// C⁻¹x̃.
    pub(super) fn weighted(&self, residual: &[S; AXES]) -> [S; AXES] {
        let beside = self.beside(residual);
        core::array::from_fn(|axis| beside[axis] * self.weights[axis])
    }

    /// Learns from a residual without a fault.
    pub(super) fn learn(&mut self, climate: &Climate<S>, residual: &[S; AXES], dt_s: S) {
        let axis = self.turn % AXES;
        self.turn = axis + 1;
        self.memory_s = (self.memory_s + dt_s).min(S::from_f32(MEMORY_S.1));
        let keep = S::from_f32(AXES as f32) * dt_s / self.memory_s;
        let (noise, calm) = (climate.noise[axis], climate.calm[axis]);
        let beside = residual[axis] - self.mean[axis];
        self.mean[axis] = self.mean[axis] + keep * beside;
        let usual = noise + self.variance[axis];
        let change = (beside * beside).min(usual * S::from_f32(OUTLIER)) - usual;
        self.variance[axis] = (self.variance[axis] + keep * change).max(calm);
        self.weights[axis] = weight(noise, self.variance[axis]);
    }
}

fn weight<S: Scalar>(noise: S, weather: S) -> S {
    S::ONE / (noise + weather * S::from_f32(WEATHER))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Weights after 60 s of a residual that swings by `swing` about `mean`.
    fn after(mean: f32, swing: f32) -> (Weather<f32>, f32) {
        let climate = Climate::new([1.0; AXES], [0.01; AXES]);
        let mut weather = Weather::unknown(Some(&climate));
        for tick in 0..30_000 {
            let x = mean + if tick / 3 % 2 == 0 { swing } else { -swing };
            weather.learn(&climate, &[x; AXES], 0.002);
        }
        let [beside, ..] = weather.beside(&[mean; AXES]);
        (weather, beside)
    }

    #[test]
    fn weather_is_learnt_about_its_mean_and_never_calmer_than_it_can_be() {
        let (calm, beside) = after(5.0, 0.1);
        assert!((calm.weights[0] - 1.0 / 1.1).abs() < 1e-3 && beside.abs() < 0.1, "{:?} {beside}", calm.weights);
        let (bad, _) = after(0.0, 3.0);
        assert!((bad.weights[0] - 1.0 / 81.0).abs() < 0.05 / 81.0, "9 less the noise, tenfold: {:?}", bad.weights);
    }

    #[test]
    fn at_first_the_weather_is_taken_for_bad() {
        let climate = Climate::new([1.0_f32; AXES], [0.5; AXES]);
        assert!((Weather::<f32>::unknown(Some(&climate)).weights[0] - 1.0 / 46.0).abs() < 1e-6);
    }
}
