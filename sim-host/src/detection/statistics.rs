//! What may be said from few flights: percentiles with misses, and intervals of rates.

/// Standard normal quantile of a two-sided interval of 95 %.
const Z: f64 = 1.959_964;
/// What is left out on each side of an interval of 95 %.
const TAIL: f64 = 0.025;

/// The smallest delay that at least `share` of all flights have reached: a miss is later than everything. None if it is a miss.
pub fn percentile(delays_s: impl IntoIterator<Item = Option<f64>>, share: f64) -> Option<f64> {
    let mut delays_s: Vec<f64> = delays_s.into_iter().map(|delay| delay.unwrap_or(f64::INFINITY)).collect();
    delays_s.sort_by(f64::total_cmp);
    let rank = (share * delays_s.len() as f64).ceil().max(1.0) as usize;
    delays_s.get(rank - 1).copied().filter(|delay| delay.is_finite())
}

/// Interval of 95 % of a rate of which `count` of `of` were seen.
///
/// # Source
/// E. B. Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
pub fn wilson(count: usize, of: usize) -> (f64, f64) {
    if of == 0 {
        return (0.0, 1.0);
    }
    let n = of as f64;
    let p = count as f64 / n;
    let middle = p + Z * Z / (2.0 * n);
    let half = Z * libm::sqrt(p * (1.0 - p) / n + Z * Z / (4.0 * n * n));
    let scale = 1.0 + Z * Z / n;
    // Rounding must not leave a sliver below none or above all.
    let low = if count == 0 { 0.0 } else { (middle - half) / scale };
    let high = if count == of { 1.0 } else { (middle + half) / scale };
    (low, high)
}

/// Probability of at most `count` events where `mean` are expected.
fn poisson_at_most(count: u64, mean: f64) -> f64 {
    // By logarithms: the probability of none underflows where hundreds are expected.
    let term = |k: f64| libm::exp(k * libm::log(mean) - mean - libm::lgamma(k + 1.0));
    (0..=count).map(|k| term(k as f64)).sum()
}

/// Interval of 95 % of the number of events expected, of which `count` were seen: exact, by bisection.
///
/// # Source
/// F. Garwood, "Fiducial limits for the Poisson distribution", 1936.
pub fn poisson(count: u64) -> (f64, f64) {
    let most = 20.0 + 2.0 * count as f64;
    let solve = |falls_to: &dyn Fn(f64) -> bool| {
        let (mut low, mut high) = (0.0, most);
        for _ in 0..100 {
            let middle = f64::midpoint(low, high);
            if falls_to(middle) { high = middle } else { low = middle }
        }
        high
    };
    let low = if count == 0 { 0.0 } else { solve(&|mean| 1.0 - poisson_at_most(count - 1, mean) >= TAIL) };
    (low, solve(&|mean| poisson_at_most(count, mean) <= TAIL))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_miss_is_later_than_every_delay() {
        let delays = |missed: usize| (1..=20).map(move |i| (i <= 20 - missed).then_some(f64::from(i as u32)));
        assert_eq!(percentile(delays(0), 0.5), Some(10.0));
        assert_eq!(percentile(delays(0), 0.95), Some(19.0));
        assert_eq!(percentile(delays(1), 0.95), Some(19.0), "one in twenty may be missed");
        assert_eq!(percentile(delays(2), 0.95), None);
        assert_eq!(percentile(delays(10), 0.5), Some(10.0));
        assert_eq!(percentile(delays(11), 0.5), None);
        assert_eq!(percentile([], 0.5), None);
        assert_eq!(percentile([Some(3.0)], 0.95), Some(3.0));
    }

    #[test]
    fn wilson_intervals_are_the_textbook_ones() {
        for (count, of, low, high) in [(0, 200, 0.0, 0.01885), (10, 200, 0.02737, 0.08957), (200, 200, 0.98115, 1.0)] {
            let (got_low, got_high) = wilson(count, of);
            assert!((got_low - low).abs() < 1e-4 && (got_high - high).abs() < 1e-4, "{count}: {got_low} {got_high}");
        }
        assert_eq!(wilson(0, 0), (0.0, 1.0));
    }

    #[test]
    fn poisson_intervals_are_the_textbook_ones() {
        for (count, low, high) in
            [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.391), (100, 81.36, 121.63), (1000, 938.97, 1063.96)]
        {
            let (got_low, got_high) = poisson(count);
            assert!((got_low - low).abs() < 0.01 && (got_high - high).abs() < 0.01, "{count}: {got_low} {got_high}");
        }
    }
}
