//! Whether an estimator knows how wrong it is: normalised estimation error squared, NEES.
//!
//! ```text
//! ε = eᵀ P⁻¹ e        of n errors that are Gaussian with covariance P: χ² with n degrees of freedom, of mean n
//! mean of ε over N flights at one time: χ² with N n degrees of freedom, over N
//! ```
//!
//! ε above the band says that the estimator is too sure of itself, below it that it is not sure enough. The errors of one flight last, so a
//! mean over its time scatters as few independent values do: the band of N flights is for one instant of each.
//!
//! Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.
use control_core::estimation::STATES;
use nalgebra::{SMatrix, SVector};

/// Standard normal quantile of a two-sided interval of 95 %.
const Z: f64 = 1.959_964;

/// Errors that are judged: attitude, velocity and position on three axes each.
pub(super) const JUDGED: usize = 9;

/// The central 95 % of χ² with `degrees` of freedom over `flights`, for a mean of that many; within 1 % from nine degrees on.
///
/// # Source
/// E. B. Wilson and M. M. Hilferty, "The distribution of chi-square", 1931.
pub fn band(degrees: usize, flights: usize) -> (f64, f64) {
    let all = (degrees * flights) as f64;
    let k = 2.0 / (9.0 * all);
    let quantile = |z: f64| all * libm::pow(1.0 - k + z * libm::sqrt(k), 3.0) / flights as f64;
    (quantile(-Z), quantile(Z))
}

/// ε of `N` errors that begin at state `first` of the covariance `p`; infinite if `p` is not positive definite there.
pub(super) fn nees<const N: usize>(p: &[[f32; STATES]; STATES], first: usize, error: &SVector<f64, N>) -> f64 {
    let p = SMatrix::<f64, N, N>::from_fn(|i, j| f64::from(p[first + i][first + j]));
    p.cholesky().map_or(f64::INFINITY, |root| error.dot(&root.solve(error)))
}

/// What ε says over several flights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Consistency {
    /// Mean over flights and time; 9 is right.
    pub mean: f64,
    /// Where the mean over the flights at one time should be, 19 times of 20.
    pub band: (f64, f64),
    /// Share of the time at which it is there.
    pub inside: f64,
}

/// Judges the ε of several flights, each at the same times; until the first ends. None without any.
pub fn consistency(flights: &[&[f64]]) -> Option<Consistency> {
    let length = flights.iter().map(|flight| flight.len()).min().filter(|&length| length > 0)?;
    let count = flights.len() as f64;
    let means: Vec<f64> = (0..length).map(|i| flights.iter().map(|flight| flight[i]).sum::<f64>() / count).collect();
    let band = band(JUDGED, flights.len());
    let inside = means.iter().filter(|&&mean| (band.0..=band.1).contains(&mean)).count();
    Some(Consistency { mean: means.iter().sum::<f64>() / length as f64, band, inside: inside as f64 / length as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64;

    #[test]
    fn the_band_is_that_of_the_tables() {
        // Bar-Shalom's tables: χ² of 9 has 2.70 and 19.02, of 100 has 74.2 and 129.6.
        for (degrees, flights, low, high) in [(9, 1, 2.70, 19.02), (1, 100, 0.742, 1.296)] {
            let found = band(degrees, flights);
            assert!((found.0 / low - 1.0).abs() < 0.012 && (found.1 / high - 1.0).abs() < 0.002, "{found:?}");
        }
    }

    #[test]
    fn errors_of_the_covariance_they_are_said_to_have_are_consistent_and_larger_ones_are_not() {
        // P = L Lᵀ with L lower, a ramp of correlations.
        let l = SMatrix::<f64, 9, 9>::from_fn(|i, j| if i >= j { 1.0 / (1.0 + (i - j) as f64) } else { 0.0 });
        let product = l * l.transpose();
        let p = std::array::from_fn(|i| {
            std::array::from_fn(|j| if i < 9 && j < 9 { product[(i, j)] as f32 } else { f32::from(u8::from(i == j)) })
        });
        let mut random = Pcg64::seed_from_u64(1);
        let mut flight = |scale: f64| -> Vec<f64> {
            let mut error = || l * SVector::<f64, 9>::from_fn(|_, _| StandardNormal.sample(&mut random)) * scale;
            (0..2000).map(|_| nees(&p, 0, &error())).collect()
        };
        let (honest, boastful): (Vec<_>, Vec<_>) = (0..5).map(|_| (flight(1.0), flight(1.5))).unzip();
        let judge = |flights: &[Vec<f64>]| {
            consistency(&flights.iter().map(Vec::as_slice).collect::<Vec<_>>()).expect("flights")
        };
        let (right, wrong) = (judge(&honest), judge(&boastful));
        assert!((right.mean - 9.0).abs() < 0.2 && (right.inside - 0.95).abs() < 0.02, "{right:?}");
        assert!(wrong.mean > wrong.band.1 && wrong.inside < 0.2, "{wrong:?}");
    }

    #[test]
    fn a_covariance_that_is_none_is_never_consistent() {
        let mut p = [[0.0; STATES]; STATES];
        p[0][0] = -1.0;
        assert_eq!(nees(&p, 0, &SVector::<f64, 3>::zeros()), f64::INFINITY);
    }
}
