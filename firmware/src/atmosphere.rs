//! Atmosphere: pressure to altitude. Not for a tick: it calls `libm`.
//!
//! ```text
//! h = (1 − (p / p₀)^(1/5.25588)) · T₀ / L
//! ```
//!
//! The standard's pressure and temperature at sea level are p₀ and T₀, L is its lapse. In `f32` a step of h is 3 mm.
//!
//! # Source
//! ISO 2533:1975 "Standard Atmosphere".

/// Pressure at sea level, Pa.
const SEA_LEVEL_PA: f32 = 101_325.0;
/// Temperature at sea level over its lapse, m.
const SCALE_M: f32 = 288.15 / 0.0065;
const EXPONENT: f32 = 1.0 / 5.255_88;
/// Pressures that a barometer can tell, Pa: from 9,000 m down to a mine.
const RANGE_PA: core::ops::RangeInclusive<f32> = 30_000.0..=120_000.0;

/// Altitude in the standard atmosphere, m; none where no barometer measures.
pub fn altitude_m(pressure_pa: f32) -> Option<f32> {
    RANGE_PA.contains(&pressure_pa).then(|| (1.0 - libm::powf(pressure_pa / SEA_LEVEL_PA, EXPONENT)) * SCALE_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn altitudes_are_the_standards_table() {
        for (pressure_pa, want_m) in [(101_325.0, 0.0), (89_874.6, 1_000.0), (54_019.9, 5_000.0), (107_477.0, -500.0)] {
            let got_m = altitude_m(pressure_pa).unwrap();
            assert!((got_m - want_m).abs() < 0.5, "{pressure_pa} Pa: {got_m} m");
        }
    }

    #[test]
    fn what_no_barometer_measures_is_no_altitude() {
        for pressure_pa in [f32::NAN, 0.0, -1.0, 2e5, f32::INFINITY] {
            assert_eq!(altitude_m(pressure_pa), None, "{pressure_pa}");
        }
    }
}
