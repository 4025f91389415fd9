//! The covariance of the error state, and how time and a measurement change it.
//!
//! ```text
//! x = (θ, v, p, b_g, b_a, b_h)        R = exp(θ) R̂ in NED        every other error: true less estimate
//!
//! predict   x_i ← x_i + M x_j        one block at a time, which is all that Φ is made of
//! measure   W = P hᵀ    S = h W + σ²    K = W / S    P ← P − W Wᵀ / S
//! ```
//!
//! What keeps it symmetric and positive definite in `f32`:
//! - only the upper half is computed, the lower is its mirror image: symmetric to the bit;
//! - a measurement may shrink a variance to no less than [`INFORMATION_MIN`] of itself: beyond that it counts as less precise than it
//!   claims, so that no difference cancels to its last digits;
//! - every step of time adds [`LOADING`] of each variance to itself, which is above what rounding takes off the smallest eigenvalue of
//!   the correlation matrix, and below any noise that matters (a standard deviation grows by 0.03 % a second).
//!
//! Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017), section 7, with errors in world axes: the attitude error
//! then does not turn with the body, and Φ needs no rates even at 35 rad/s.

/// Size of the error state.
pub const STATES: usize = 16;

/// Where each error begins.
pub(crate) const ATTITUDE: usize = 0;
pub(crate) const VELOCITY: usize = 3;
pub(crate) const POSITION: usize = 6;
pub(crate) const GYRO_BIAS: usize = 9;
pub(crate) const ACCELEROMETER_BIAS: usize = 12;
pub(crate) const BARO_OFFSET: usize = 15;

/// Least share of a variance that one measurement leaves.
const INFORMATION_MIN: f32 = 1e-4;
/// Share of each variance that a step of time adds.
const LOADING: f32 = 2e-6;

/// Most states that a measurement depends on.
const TERMS_MAX: usize = 7;

/// One scalar that was measured: how far it is from what was expected, and what that says of the errors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    /// Measured less expected.
    pub(crate) innovation: f32,
    /// Variance of the measurement.
    pub(crate) variance: f32,
    terms: [(usize, f32); TERMS_MAX],
    count: usize,
}

impl Observation {
    /// - `terms`: the row h, as states and their coefficients.
    pub(crate) fn new<const N: usize>(innovation: f32, variance: f32, terms: [(usize, f32); N]) -> Self {
        const { assert!(N <= TERMS_MAX) };
        let mut all = [(0, 0.0); TERMS_MAX];
        for (slot, term) in all.iter_mut().zip(terms) {
            *slot = term;
        }
        Self { innovation, variance, terms: all, count: N }
    }

    fn terms(&self) -> impl Iterator<Item = (usize, f32)> {
        // The mask changes nothing, and shows the compiler that no index is out of range.
        self.terms.iter().take(self.count).map(|&(state, factor)| (state & (STATES - 1), factor))
    }

    /// h x.
    pub(crate) fn seen(&self, x: &[f32; STATES]) -> f32 {
        self.terms().map(|(state, factor)| factor * x[state]).sum()
    }
}

/// The matrix P.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Covariance([[f32; STATES]; STATES]);

impl Covariance {
    /// Independent errors with these standard deviations.
    pub(crate) fn diagonal(sigma: [f32; STATES]) -> Self {
        let mut p = [[0.0; STATES]; STATES];
        for (i, sigma) in sigma.into_iter().enumerate() {
            p[i][i] = sigma * sigma;
        }
        Self(p)
    }

    /// Variance of a state.
    pub(crate) fn variance(&self, state: usize) -> f32 {
        self.0[state & (STATES - 1)][state & (STATES - 1)]
    }

    /// Block `X` ← block `X` + `m` · block `Y`, of the errors.
    pub(crate) fn shear<const X: usize, const Y: usize>(&mut self, m: &[[f32; 3]; 3]) {
        let from = [self.0[Y], self.0[Y + 1], self.0[Y + 2]];
        for (i, m) in m.iter().enumerate() {
            for (j, cell) in self.0[X + i].iter_mut().enumerate() {
                *cell += m[0] * from[0][j] + m[1] * from[1][j] + m[2] * from[2][j];
            }
        }
        for i in 0..3 {
            for (j, m) in m.iter().enumerate().skip(i) {
                let row = &mut self.0[X + i];
                row[X + j] += m[0] * row[Y] + m[1] * row[Y + 1] + m[2] * row[Y + 2];
            }
        }
        self.mirror::<X>();
    }

    /// Block `X` ← block `X` + `k` · block `Y`.
    pub(crate) fn shear_evenly<const X: usize, const Y: usize>(&mut self, k: f32) {
        for i in 0..3 {
            let from = self.0[Y + i];
            for (cell, from) in self.0[X + i].iter_mut().zip(from) {
                *cell += k * from;
            }
        }
        for i in 0..3 {
            for j in i..3 {
                let row = &mut self.0[X + i];
                row[X + j] += k * row[Y + j];
            }
        }
        self.mirror::<X>();
    }

    /// Copies the rows of block `X`, and of it the upper half, to their mirror image.
    fn mirror<const X: usize>(&mut self) {
        self.0[X + 1][X] = self.0[X][X + 1];
        self.0[X + 2][X] = self.0[X][X + 2];
        self.0[X + 2][X + 1] = self.0[X + 1][X + 2];
        for i in 0..3 {
            let row = self.0[X + i];
            for (j, value) in row.into_iter().enumerate() {
                self.0[j][X + i] = value;
            }
        }
    }

    /// Adds noise to a block, and to every state the load that outweighs rounding.
    pub(crate) fn add_noise(&mut self, variances: &[f32; STATES]) {
        for (i, variance) in variances.iter().enumerate() {
            let own = self.0[i][i];
            self.0[i][i] = own + (own * LOADING + variance);
        }
    }

    /// Variance of what an observation sees, without its own noise.
    pub(crate) fn seen(&self, observation: &Observation) -> f32 {
        observation.terms().map(|(i, a)| a * observation.terms().map(|(j, b)| b * self.0[i][j]).sum::<f32>()).sum()
    }

    /// Takes an observation in; adds what it says of the errors to `x`.
    ///
    /// Returns `false`, and changes nothing, if the matrix is not positive where it looks.
    pub(crate) fn observe(&mut self, observation: &Observation, x: &mut [f32; STATES]) -> bool {
        let mut w = [0.0; STATES];
        for (state, factor) in observation.terms() {
            for (w, p) in w.iter_mut().zip(&self.0[state]) {
                *w += factor * p;
            }
        }
        let seen = observation.seen(&w);
        let total = seen + observation.variance.max(INFORMATION_MIN * seen);
        if !(seen > 0.0 && total < f32::MAX) {
            return false;
        }
        let inverse = 1.0 / total;
        let surprise = (observation.innovation - observation.seen(x)) * inverse;
        for (x, w) in x.iter_mut().zip(w) {
            *x += w * surprise;
        }
        self.subtract(&w, inverse);
        true
    }

    /// P ← P − w wᵀ · k.
    #[inline(never)]
    fn subtract(&mut self, w: &[f32; STATES], k: f32) {
        for i in 0..STATES {
            let gain = w[i] * k;
            for j in i..STATES {
                let value = self.0[i][j] - gain * w[j];
                self.0[i][j] = value;
                self.0[j][i] = value;
            }
        }
    }

    /// Forgets what is known of a state: its variance becomes `variance`, independent of all others.
    pub(crate) fn reset(&mut self, state: usize, variance: f32) {
        let state = state & (STATES - 1);
        self.0[state] = [0.0; STATES];
        for row in &mut self.0 {
            row[state] = 0.0;
        }
        self.0[state][state] = variance;
    }

    /// Sets what two states have in common.
    pub(crate) fn correlate(&mut self, a: usize, b: usize, covariance: f32) {
        let (a, b) = (a & (STATES - 1), b & (STATES - 1));
        self.0[a][b] = covariance;
        self.0[b][a] = covariance;
    }

    /// Whether every variance is positive and finite.
    pub(crate) fn is_sound(&self) -> bool {
        (0..STATES).all(|i| self.0[i][i] > 0.0 && self.0[i][i] < 1e12)
    }

    /// The matrix, for checks from outside.
    pub(crate) fn matrix(&self) -> &[[f32; STATES]; STATES] {
        &self.0
    }
}
