//! The covariance of the error state, and how time and a measurement change it.
//!
//! ```text
//! x = (θ, v, p, b_g, b_a, b_h, d_g)        R = exp(θ) R̂ in NED        every other error: true less estimate
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
pub const STATES: usize = 17;

/// Where each error begins.
pub(crate) const ATTITUDE: usize = 0;
pub(crate) const VELOCITY: usize = 3;
pub(crate) const POSITION: usize = 6;
pub(crate) const GYRO_BIAS: usize = 9;
pub(crate) const ACCELEROMETER_BIAS: usize = 12;
pub(crate) const BARO_OFFSET: usize = 15;
pub(crate) const GROUND: usize = 16;

/// Least share of a variance that one measurement leaves.
const INFORMATION_MIN: f32 = 1e-4;
/// Share of each variance that a step of time adds.
const LOADING: f32 = 2e-6;

/// Most states that a measurement depends on.
const TERMS_MAX: usize = 8;

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
        // The bound changes nothing, and shows the compiler that no index is out of range.
        self.terms.iter().take(self.count).map(|&(state, factor)| (held(state), factor))
    }

    /// h x.
    pub(crate) fn seen(&self, x: &[f32; STATES]) -> f32 {
        self.terms().map(|(state, factor)| factor * x[state]).sum()
    }
}

/// An index within the state.
fn held(state: usize) -> usize {
    state.min(STATES - 1)
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
        self.0[held(state)][held(state)]
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

    /// P hᵀ: how what an observation sees goes with every state.
    fn seen_with(&self, observation: &Observation) -> [f32; STATES] {
        let mut w = [0.0; STATES];
        for (state, factor) in observation.terms() {
            for (w, p) in w.iter_mut().zip(&self.0[state]) {
                *w += factor * p;
            }
        }
        w
    }

    /// Adds to `x` what an observation would say of the errors if its variance were `variance`, and learns nothing of how large they are.
    pub(crate) fn follow(&self, observation: &Observation, variance: f32, x: &mut [f32; STATES]) {
        let w = self.seen_with(observation);
        let surprise = (observation.innovation - observation.seen(x)) / (observation.seen(&w) + variance);
        for (x, w) in x.iter_mut().zip(w) {
            *x += w * surprise;
        }
    }

    /// Takes an observation in; adds what it says of the errors to `x`.
    ///
    /// Returns `false`, and changes nothing, if the matrix is not positive where it looks.
    pub(crate) fn observe(&mut self, observation: &Observation, x: &mut [f32; STATES]) -> bool {
        let w = self.seen_with(observation);
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

    /// P ← P − w wᵀ · k, row by row, each unrolled: a third fewer instructions than in loops.
    #[inline(never)]
    fn subtract(&mut self, w: &[f32; STATES], k: f32) {
        self.subtract_row::<0>(w, k);
        self.subtract_row::<1>(w, k);
        self.subtract_row::<2>(w, k);
        self.subtract_row::<3>(w, k);
        self.subtract_row::<4>(w, k);
        self.subtract_row::<5>(w, k);
        self.subtract_row::<6>(w, k);
        self.subtract_row::<7>(w, k);
        self.subtract_row::<8>(w, k);
        self.subtract_row::<9>(w, k);
        self.subtract_row::<10>(w, k);
        self.subtract_row::<11>(w, k);
        self.subtract_row::<12>(w, k);
        self.subtract_row::<13>(w, k);
        self.subtract_row::<14>(w, k);
        self.subtract_row::<15>(w, k);
        self.subtract_row::<16>(w, k);
    }

    /// Row `I` of the upper half, and its mirror image.
    #[inline(always)]
    #[expect(clippy::needless_range_loop, reason = "both triangles are written")]
    fn subtract_row<const I: usize>(&mut self, w: &[f32; STATES], k: f32) {
        let gain = w[I] * k;
        for j in I..STATES {
            let value = self.0[I][j] - gain * w[j];
            self.0[I][j] = value;
            self.0[j][I] = value;
        }
    }

    /// Forgets what is known of a state: its variance becomes `variance`, independent of all others.
    pub(crate) fn reset(&mut self, state: usize, variance: f32) {
        let state = held(state);
        self.0[state] = [0.0; STATES];
        for row in &mut self.0 {
            row[state] = 0.0;
        }
        self.0[state][state] = variance;
    }

    /// State `to` ← state `to` + `k` · state `from`, of the errors.
    pub(crate) fn add_multiple(&mut self, from: usize, to: usize, k: f32) {
        let (from, to) = (held(from), held(to));
        let mut row = self.0[to];
        for (cell, from) in row.iter_mut().zip(self.0[from]) {
            *cell += k * from;
        }
        row[to] += k * row[from];
        self.0[to] = row;
        for (cells, value) in self.0.iter_mut().zip(row) {
            cells[to] = value;
        }
    }

    /// Makes state `to` the error of state `from` and an independent one of `variance`: what is read off another is wrong as that is.
    pub(crate) fn copy(&mut self, from: usize, to: usize, variance: f32) {
        let (from, to) = (held(from), held(to));
        self.reset(to, 0.0);
        let mut row = self.0[from];
        row[to] = row[from] + variance;
        self.0[to] = row;
        for (cells, value) in self.0.iter_mut().zip(row) {
            cells[to] = value;
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Some positive definite matrix.
    fn some() -> Covariance {
        let mut p = Covariance::diagonal(core::array::from_fn(|i| 1.0 + 0.1 * i as f32));
        p.shear::<VELOCITY, ATTITUDE>(&[[0.1, -0.5, 0.3], [0.2, 0.4, -0.1], [0.6, -0.2, 0.5]]);
        p.shear_evenly::<POSITION, VELOCITY>(0.25);
        p
    }

    /// F P Fᵀ in f64.
    fn congruent(f: &[[f64; STATES]; STATES], p: &Covariance) -> [[f64; STATES]; STATES] {
        let fp: [[f64; STATES]; STATES] = core::array::from_fn(|i| {
            core::array::from_fn(|j| (0..STATES).map(|k| f[i][k] * f64::from(p.0[k][j])).sum())
        });
        core::array::from_fn(|i| core::array::from_fn(|j| (0..STATES).map(|k| fp[i][k] * f[j][k]).sum()))
    }

    fn apart(p: &Covariance, want: &[[f64; STATES]; STATES]) -> f64 {
        p.0.iter().flatten().zip(want.iter().flatten()).map(|(&a, b)| (f64::from(a) - b).abs()).fold(0.0, f64::max)
    }

    fn unit() -> [[f64; STATES]; STATES] {
        core::array::from_fn(|i| core::array::from_fn(|j| f64::from(u8::from(i == j))))
    }

    #[test]
    fn a_shear_is_the_product_that_it_stands_for() {
        let m = [[0.3, -0.2, 0.1], [0.0, 0.5, -0.4], [0.7, 0.2, 0.6]];
        let (mut p, mut f) = (some(), unit());
        for (i, row) in m.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                f[ATTITUDE + i][GYRO_BIAS + j] = f64::from(value);
            }
        }
        let want = congruent(&f, &p);
        p.shear::<ATTITUDE, GYRO_BIAS>(&m);
        assert!(apart(&p, &want) < 1e-6);

        let (mut p, mut f) = (some(), unit());
        for i in 0..3 {
            f[POSITION + i][VELOCITY + i] = 0.5;
        }
        let want = congruent(&f, &p);
        p.shear_evenly::<POSITION, VELOCITY>(0.5);
        assert!(apart(&p, &want) < 1e-5);
    }

    #[test]
    fn adding_a_multiple_of_one_state_is_a_shear_of_one_axis() {
        let (mut p, mut f) = (some(), unit());
        f[POSITION + 1][VELOCITY + 1] = f64::from(0.15_f32);
        let want = congruent(&f, &p);
        p.add_multiple(VELOCITY + 1, POSITION + 1, 0.15);
        assert!(apart(&p, &want) < 1e-6);
    }

    #[test]
    fn an_observation_is_the_textbook_update() {
        let (mut p, mut x) = (some(), [0.0; STATES]);
        let observation = Observation::new(0.7, 0.5, [(VELOCITY, 1.0), (ATTITUDE + 1, -0.3)]);
        let mut h = [0.0; STATES];
        (h[VELOCITY], h[ATTITUDE + 1]) = (1.0, f64::from(-0.3_f32));
        let w: [f64; STATES] = core::array::from_fn(|i| (0..STATES).map(|k| f64::from(p.0[i][k]) * h[k]).sum());
        let total = 0.5 + w.iter().zip(h).map(|(w, h)| w * h).sum::<f64>();
        let want: [[f64; STATES]; STATES] =
            core::array::from_fn(|i| core::array::from_fn(|j| f64::from(p.0[i][j]) - w[i] * w[j] / total));
        assert!(p.observe(&observation, &mut x));
        assert!(apart(&p, &want) < 1e-6);
        for (x, w) in x.iter().zip(w) {
            assert!((f64::from(*x) - w * f64::from(0.7_f32) / total).abs() < 1e-6);
        }
        assert!((0..STATES).all(|i| (0..STATES).all(|j| p.0[i][j] == p.0[j][i])), "symmetric to the bit");
    }

    #[test]
    fn what_is_read_off_another_state_differs_from_it_by_its_own_noise_only() {
        let mut p = some();
        p.copy(POSITION + 2, GROUND, 0.25);
        let difference = Observation::new(0.0, 0.0, [(POSITION + 2, 1.0), (GROUND, -1.0)]);
        assert!((p.seen(&difference) - 0.25).abs() < 1e-5);
        let other = Observation::new(0.0, 0.0, [(VELOCITY, 1.0), (GROUND, 1.0)]);
        let same = Observation::new(0.0, 0.0, [(VELOCITY, 1.0), (POSITION + 2, 1.0)]);
        assert!((p.seen(&other) - p.seen(&same) - 0.25).abs() < 1e-5);
    }

    #[test]
    fn a_matrix_that_is_not_positive_is_told() {
        let mut p = some();
        p.0[VELOCITY][VELOCITY] = -1.0;
        let before = p.0;
        assert!(!p.is_sound());
        assert!(!p.observe(&Observation::new(0.1, 0.01, [(VELOCITY, 1.0)]), &mut [0.0; STATES]));
        assert_eq!(p.0, before);
    }
}
