//! Linear least squares by normal equations, summed sample by sample: bounded work and memory, however long it takes.
//!
//! ```text
//! minimise Σ (xᵀ r − y)²      N = Σ r rᵀ,  b = Σ r y,  N x = b      N = L D Lᵀ
//! ```
//!
//! A pivot of D over its diagonal in N is the share of that term which those before it do not explain. The least of them is the coverage: nothing where
//! the samples leave a combination of terms open. Terms must be of about the size of 1.

/// Sums of samples with `N` terms.
#[derive(Clone, Copy, Debug)]
pub(super) struct Normal<const N: usize> {
    /// The lower half counts.
    matrix: [[f32; N]; N],
    right: [f32; N],
    squares: f32,
    pub(super) samples: u32,
}

/// A solution.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solution<const N: usize> {
    pub(super) x: [f32; N],
    pub(super) coverage: f32,
    /// Mean square of what is not explained, for the terms that were spent on it.
    pub(super) residual_square: f32,
}

impl<const N: usize> Normal<N> {
    pub(super) const EMPTY: Self = Self { matrix: [[0.0; N]; N], right: [0.0; N], squares: 0.0, samples: 0 };

    /// Adds a sample: `row` · x should be `target`.
    pub(super) fn note(&mut self, row: &[f32; N], target: f32) {
        for (i, (sums, &r)) in self.matrix.iter_mut().zip(row).enumerate() {
            for (sum, &c) in sums.iter_mut().zip(row).take(i + 1) {
                *sum += r * c;
            }
        }
        for (sum, &r) in self.right.iter_mut().zip(row) {
            *sum += r * target;
        }
        self.squares += target * target;
        self.samples += 1;
    }

    /// Sum of the product of two terms.
    pub(super) fn product(&self, i: usize, j: usize) -> f32 {
        self.matrix.get(i.max(j)).and_then(|row| row.get(i.min(j))).copied().unwrap_or(0.0)
    }

    /// Sum of a term times its target.
    pub(super) fn pulled(&self, i: usize) -> f32 {
        self.right.get(i).copied().unwrap_or(0.0)
    }

    /// The solution. With a coverage of 0 there is none, and `x` means nothing.
    pub(super) fn solve(&self) -> Solution<N> {
        let (mut l, mut d, mut x, mut coverage) = (self.matrix, [0.0; N], self.right, 1.0_f32);
        for j in 0..N {
            let pivot = (0..j).fold(l[j][j], |left, k| left - l[j][k] * l[j][k] * d[k]);
            let share = if l[j][j] > 0.0 { pivot / l[j][j] } else { 0.0 };
            if share.is_nan() || share < f32::EPSILON {
                return Solution { x, coverage: 0.0, residual_square: f32::INFINITY };
            }
            coverage = coverage.min(share);
            d[j] = pivot;
            for i in j + 1..N {
                let left = (0..j).fold(l[i][j], |left, k| left - l[i][k] * l[j][k] * d[k]);
                l[i][j] = left / pivot;
            }
        }
        for i in 0..N {
            x[i] = (0..i).fold(x[i], |left, k| left - l[i][k] * x[k]);
        }
        for i in (0..N).rev() {
            x[i] = (i + 1..N).fold(x[i] / d[i], |left, k| left - l[k][i] * x[k]);
        }
        let explained: f32 = x.iter().zip(&self.right).map(|(x, b)| x * b).sum();
        let free = self.samples.saturating_sub(N as u32).max(1) as f32;
        Solution { x, coverage, residual_square: ((self.squares - explained) / free).max(0.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_and_what_is_off_it() {
        let mut normal = Normal::<2>::EMPTY;
        for i in 0..10 {
            let x = i as f32 / 10.0;
            let off = if i % 2 == 0 { 0.1 } else { -0.1 };
            normal.note(&[x, 1.0], 2.0 * x - 1.0 + off);
        }
        let found = normal.solve();
        assert!((found.x[0] - 2.0).abs() < 0.1 && (found.x[1] + 1.0).abs() < 0.1, "{found:?}");
        assert!((found.residual_square - 0.0125).abs() < 0.002, "{found:?}");
        assert!(found.coverage > 0.1);
    }

    #[test]
    fn terms_that_say_the_same_have_no_coverage() {
        let mut normal = Normal::<2>::EMPTY;
        for i in 0..10 {
            let x = i as f32;
            normal.note(&[x, 2.0 * x], x);
        }
        assert_eq!(normal.solve().coverage, 0.0);
        assert_eq!(Normal::<3>::EMPTY.solve().coverage, 0.0);
        let mut broken = Normal::<1>::EMPTY;
        broken.note(&[f32::NAN], 1.0);
        assert_eq!(broken.solve().coverage, 0.0);
    }
}
