//! Battery: what is at the converter's pins to volts.
//!
//! ```text
//! U = share · 3.3 V · divider
//! ```

/// Reference of the converter, V.
const REFERENCE_V: f32 = 3.3;

/// Volts at the battery.
///
/// - `share`: pin voltage over the converter's reference.
/// - `divider`: battery voltage over pin voltage.
pub fn volts(share: f32, divider: f32) -> f32 {
    share * REFERENCE_V * divider
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_four_cell_battery_is_16_8_volts() {
        assert!((volts(1_895.0 / 4_095.0, 11.0) - 16.8).abs() < 0.01);
        assert_eq!(volts(0.0, 11.0), 0.0);
    }
}
