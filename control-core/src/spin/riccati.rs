//! Gains of a linear-quadratic regulator, by doubling.
//!
//! ```text
//! minimise Σ x'Q x + u'R u     over     x⁺ = A x + B u,   u = −K x,   K = (R + B'P B)⁻¹ B'P A
//! G_0 = B R⁻¹ B',  H_0 = Q,  W = (I + G H)⁻¹:     A ← A W A,   G ← G + A W G A',   H ← H + A'H W A      H → P
//! ```
//!
//! Quadratic convergence: twelve doublings look 4096 ticks ahead. Only sums, products and quotients, so that every machine
//! gets the same bits.
//!
//! Source: E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, "A structure-preserving doubling algorithm for continuous-time algebraic Riccati
//! equations", 2005, in its discrete form.

/// States.
pub(super) const N: usize = 6;
/// Inputs.
pub(super) const M: usize = 2;
const DOUBLINGS: usize = 12;

pub(super) type Square = [[f32; N]; N];

/// A plant x⁺ = A x + B u and the weights of its states and inputs.
pub(super) struct Problem {
    pub(super) a: Square,
    pub(super) b: [[f32; M]; N],
    pub(super) q: [f32; N],
    pub(super) r: [f32; M],
}

fn product<const I: usize, const J: usize, const K: usize>(x: &[[f32; J]; I], y: &[[f32; K]; J]) -> [[f32; K]; I] {
    core::array::from_fn(|i| core::array::from_fn(|k| (0..J).map(|j| x[i][j] * y[j][k]).sum()))
}

fn transposed<const I: usize, const J: usize>(x: &[[f32; J]; I]) -> [[f32; I]; J] {
    core::array::from_fn(|j| core::array::from_fn(|i| x[i][j]))
}

fn sum(x: &Square, y: &Square) -> Square {
    core::array::from_fn(|i| core::array::from_fn(|j| x[i][j] + y[i][j]))
}

fn diagonal(d: &[f32; N]) -> Square {
    core::array::from_fn(|i| core::array::from_fn(|j| if i == j { d[i] } else { 0.0 }))
}

/// m⁻¹ y by elimination with row pivots; `m` is I + G H of two semi-definite matrices, and so never singular.
fn solved(mut m: Square, mut y: Square) -> Square {
    for i in 0..N {
        let pivot = (i..N).fold(i, |best, k| if m[k][i].abs() > m[best][i].abs() { k } else { best });
        m.swap(i, pivot);
        y.swap(i, pivot);
        let scale = 1.0 / m[i][i];
        m[i] = m[i].map(|x| x * scale);
        y[i] = y[i].map(|x| x * scale);
        let (of_m, of_y) = (m[i], y[i]);
        for k in (0..N).filter(|&k| k != i) {
            let share = m[k][i];
            for j in 0..N {
                m[k][j] -= share * of_m[j];
                y[k][j] -= share * of_y[j];
            }
        }
    }
    y
}

impl Problem {
    /// K: one row an input.
    pub(super) fn gains(&self) -> [[f32; N]; M] {
        let weighted: [[f32; M]; N] = self.b.map(|row| [row[0] / self.r[0], row[1] / self.r[1]]);
        let (mut a, mut g, mut h) = (self.a, product(&weighted, &transposed(&self.b)), diagonal(&self.q));
        for _ in 0..DOUBLINGS {
            let mixed = sum(&diagonal(&[1.0; N]), &product(&g, &h));
            let (wa, wg) = (solved(mixed, a), solved(mixed, g));
            let next_g = sum(&g, &product(&product(&a, &wg), &transposed(&a)));
            h = sum(&h, &product(&product(&transposed(&a), &h), &wa));
            a = product(&a, &wa);
            g = next_g;
        }
        let pb = product(&h, &self.b);
        let [[s11, s12], [s21, s22]] = product(&transposed(&self.b), &pb);
        let (s11, s22) = (s11 + self.r[0], s22 + self.r[1]);
        let determinant = s11 * s22 - s12 * s21;
        let [ba1, ba2] = product(&transposed(&pb), &self.a);
        [
            core::array::from_fn(|j| (s22 * ba1[j] - s12 * ba2[j]) / determinant),
            core::array::from_fn(|j| (s11 * ba2[j] - s21 * ba1[j]) / determinant),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six independent copies of x⁺ = x + u would need six inputs; two integrators and four dead states have a known answer.
    #[test]
    fn gains_of_integrators_are_those_of_the_scalar_riccati_equation() {
        let mut a = diagonal(&[0.5; N]);
        a[0][0] = 1.0;
        a[1][1] = 1.0;
        let mut b = [[0.0; M]; N];
        b[0][0] = 1.0;
        b[1][1] = 1.0;
        let problem = Problem { a, b, q: [1.0, 3.0, 0.0, 0.0, 0.0, 0.0], r: [1.0, 2.0] };
        let [first, second] = problem.gains();
        // p = q + p − p²/(r + p), k = p/(r + p).
        let known = |q: f32, r: f32| {
            let p = f32::midpoint(q, libm::sqrtf(q * q + 4.0 * q * r));
            p / (r + p)
        };
        assert!((first[0] - known(1.0, 1.0)).abs() < 1e-5, "{first:?}");
        assert!((second[1] - known(3.0, 2.0)).abs() < 1e-5, "{second:?}");
        assert!(first[1..].iter().all(|k| k.abs() < 1e-6));
    }
}
