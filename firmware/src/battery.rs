//! Battery: converter counts to volts.
//!
//! ```text
//! U = counts / 4095 · 3.3 V · divider
//! ```

/// Counts at the reference.
const FULL_SCALE: f32 = 4_095.0;
/// Reference of the converter, V.
const REFERENCE_V: f32 = 3.3;

/// Volts at the battery.
///
/// - `counts`: of the 12-bit converter.
/// - `divider`: battery voltage over pin voltage.
pub fn volts(counts: u16, divider: f32) -> f32 {
    f32::from(counts) / FULL_SCALE * REFERENCE_V * divider
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_four_cell_battery_is_16_8_volts() {
        assert!((volts(1_895, 11.0) - 16.8).abs() < 0.01);
        assert_eq!(volts(0, 11.0), 0.0);
    }
}
