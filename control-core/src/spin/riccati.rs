//! Gains of a linear-quadratic regulator, by doubling.
//!
//! ```text
//! minimise Σ x'Q x + u'R u     over     x⁺ = A x + B u,   u = −K x,   K = (R + B'P B)⁻¹ B'P A
//! G_0 = B R⁻¹ B',  H_0 = Q,  W = (I + G H)⁻¹:     A ← A W A,   G ← G + A W G A',   H ← H + A'H W A      H → P
//! ```
//!
//! Quadratic convergence: twelve doublings look 4096 ticks ahead. Only sums, products and quotients, so that every machine, and the
//! compiler for it, gets the same bits.
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

pub(super) const fn product<const I: usize, const J: usize, const K: usize>(
    x: &[[f32; J]; I],
    y: &[[f32; K]; J],
) -> [[f32; K]; I] {
    let mut z = [[0.0; K]; I];
    let mut i = 0;
    while i < I {
        let mut j = 0;
        while j < J {
            let mut k = 0;
            while k < K {
                z[i][k] += x[i][j] * y[j][k];
                k += 1;
            }
            j += 1;
        }
        i += 1;
    }
    z
}

const fn transposed<const I: usize, const J: usize>(x: &[[f32; J]; I]) -> [[f32; I]; J] {
    let mut z = [[0.0; I]; J];
    let mut i = 0;
    while i < I {
        let mut j = 0;
        while j < J {
            z[j][i] = x[i][j];
            j += 1;
        }
        i += 1;
    }
    z
}

const fn sum(x: &Square, y: &Square) -> Square {
    let mut z = *x;
    let mut i = 0;
    while i < N {
        let mut j = 0;
        while j < N {
            z[i][j] += y[i][j];
            j += 1;
        }
        i += 1;
    }
    z
}

const fn diagonal(d: &[f32; N]) -> Square {
    let mut z = [[0.0; N]; N];
    let mut i = 0;
    while i < N {
        z[i][i] = d[i];
        i += 1;
    }
    z
}

/// Subtracts `share` of `other` from `row`.
const fn take(row: &mut [f32; N], share: f32, other: &[f32; N]) {
    let mut j = 0;
    while j < N {
        row[j] -= share * other[j];
        j += 1;
    }
}

const fn scaled(row: &[f32; N], scale: f32) -> [f32; N] {
    let mut z = *row;
    let mut j = 0;
    while j < N {
        z[j] *= scale;
        j += 1;
    }
    z
}

/// m⁻¹ y by elimination with row pivots; `m` is I + G H of two semi-definite matrices, and so never singular.
const fn solved(mut m: Square, mut y: Square) -> Square {
    let mut i = 0;
    while i < N {
        let (mut pivot, mut k) = (i, i + 1);
        while k < N {
            if m[k][i].abs() > m[pivot][i].abs() {
                pivot = k;
            }
            k += 1;
        }
        m.swap(i, pivot);
        y.swap(i, pivot);
        let scale = 1.0 / m[i][i];
        m[i] = scaled(&m[i], scale);
        y[i] = scaled(&y[i], scale);
        let (of_m, of_y) = (m[i], y[i]);
        let mut k = 0;
        while k < N {
            if k != i {
                let share = m[k][i];
                take(&mut m[k], share, &of_m);
                take(&mut y[k], share, &of_y);
            }
            k += 1;
        }
        i += 1;
    }
    y
}

impl Problem {
    /// K: one row an input.
    pub(super) const fn gains(&self) -> [[f32; N]; M] {
        let mut weighted = self.b;
        let mut i = 0;
        while i < N {
            weighted[i] = [self.b[i][0] / self.r[0], self.b[i][1] / self.r[1]];
            i += 1;
        }
        let (mut a, mut g, mut h) = (self.a, product(&weighted, &transposed(&self.b)), diagonal(&self.q));
        let mut doubling = 0;
        while doubling < DOUBLINGS {
            let mixed = sum(&diagonal(&[1.0; N]), &product(&g, &h));
            let (wa, wg) = (solved(mixed, a), solved(mixed, g));
            let next_g = sum(&g, &product(&product(&a, &wg), &transposed(&a)));
            h = sum(&h, &product(&product(&transposed(&a), &h), &wa));
            a = product(&a, &wa);
            g = next_g;
            doubling += 1;
        }
        let pb = product(&h, &self.b);
        let [[s11, s12], [s21, s22]] = product(&transposed(&self.b), &pb);
        let (s11, s22) = (s11 + self.r[0], s22 + self.r[1]);
        let determinant = s11 * s22 - s12 * s21;
        let [ba1, ba2] = product(&transposed(&pb), &self.a);
        let mut gains = [[0.0; N]; M];
        let mut j = 0;
        while j < N {
            gains[0][j] = (s22 * ba1[j] - s12 * ba2[j]) / determinant;
            gains[1][j] = (s11 * ba2[j] - s21 * ba1[j]) / determinant;
            j += 1;
        }
        gains
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

    /// The recursion itself, in f64: P ← Q + A'P (A − B K).
    fn iterated(problem: &Problem, steps: u32) -> [[f64; N]; M] {
        let wide = |x: f32| f64::from(x);
        let (a, b) = (problem.a.map(|row| row.map(wide)), problem.b.map(|row| row.map(wide)));
        let (q, r) = (problem.q.map(wide), problem.r.map(wide));
        let mut p: [[f64; N]; N] = core::array::from_fn(|i| core::array::from_fn(|j| if i == j { q[i] } else { 0.0 }));
        let mut k = [[0.0; N]; M];
        for _ in 0..steps {
            let pa: [[f64; N]; N] =
                core::array::from_fn(|i| core::array::from_fn(|j| (0..N).map(|l| p[i][l] * a[l][j]).sum()));
            let pb: [[f64; M]; N] =
                core::array::from_fn(|i| core::array::from_fn(|j| (0..N).map(|l| p[i][l] * b[l][j]).sum()));
            let bpb = |i: usize, j: usize| (0..N).map(|l| b[l][i] * pb[l][j]).sum::<f64>();
            let bpa = |i: usize, j: usize| (0..N).map(|l| b[l][i] * pa[l][j]).sum::<f64>();
            let (s11, s12, s22) = (bpb(0, 0) + r[0], bpb(0, 1), bpb(1, 1) + r[1]);
            let determinant = s11 * s22 - s12 * s12;
            k = [
                core::array::from_fn(|j| (s22 * bpa(0, j) - s12 * bpa(1, j)) / determinant),
                core::array::from_fn(|j| (s11 * bpa(1, j) - s12 * bpa(0, j)) / determinant),
            ];
            p = core::array::from_fn(|i| {
                core::array::from_fn(|j| {
                    let fed: f64 = (0..M).map(|m| bpa(m, i) * k[m][j]).sum();
                    (0..N).map(|l| a[l][i] * pa[l][j]).sum::<f64>() - fed + if i == j { q[i] } else { 0.0 }
                })
            });
        }
        k
    }

    #[test]
    fn gains_are_within_two_thousandths_of_those_that_the_recursion_in_f64_ends_at() {
        for (spin, stiffness) in [(5.0, 4.0), (20.0, 15.0), (35.0, 30.0)] {
            let (dt_s, lag) = (0.002_f32, -50.0);
            let slope: Square = [
                [0.0, spin, 0.0, -1.0, 0.0, 0.0],
                [-spin, 0.0, 1.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, -stiffness, 1.0, 0.0],
                [0.0, 0.0, stiffness, 0.0, 0.0, 1.0],
                [0.0, 0.0, 0.0, 0.0, lag, 0.0],
                [0.0, 0.0, 0.0, 0.0, 0.0, lag],
            ];
            let first = slope.map(|row| row.map(|x| x * dt_s));
            let second = product(&first, &first).map(|row| row.map(|x| 0.5 * x));
            let a = sum(&sum(&diagonal(&[1.0; N]), &first), &second);
            let mut b = [[0.0; M]; N];
            (b[4][0], b[5][1]) = (0.1, 0.1);
            let problem = Problem { a, b, q: [128.0, 128.0, 2.9, 2.9, 0.0, 0.0], r: [0.02, 0.014] };
            let (found, want) = (problem.gains(), iterated(&problem, 20_000));
            let largest = want.iter().flatten().fold(0.0_f64, |most, k| most.max(k.abs()));
            let off = found.iter().flatten().zip(want.iter().flatten());
            let off = off.map(|(found, want)| (f64::from(*found) - want).abs()).fold(0.0, f64::max);
            assert!(off < 2e-3 * largest, "{spin} rad/s: off by {off} of {largest}");
        }
    }
}
