//! DPS310, and the SPL06-001 that shows the same registers: what is written to them, and what their bytes mean.
//!
//! ```text
//! t = T / k_T        p = P / k_P
//! temperature = c0 / 2 + c1 t
//! pressure = c00 + p (c10 + p (c20 + p c30)) + t c01 + t p (c11 + p c21)
//! ```
//!
//! P and T are what the converter says, 24 bits, k its full scale by oversampling, c the part's own calibration.
//!
//! Not applied: the correction by undocumented registers that Infineon's library makes to early parts whose temperature is
//! wrong.
//!
//! # Source
//! Infineon, "DPS310 datasheet" rev 1.2: 4.9 for the equations and scales, 7 and 8 for the registers. Goertek, "SPL06-001
//! datasheet" V1.0, has the same ones.

/// Where the part may be on its bus, by a pin of its own.
pub const ADDRESSES: [u8; 2] = [0x76, 0x77];
/// The register that says what part this is, and what it says.
pub const PRODUCT_ID: (u8, u8) = (0x0d, 0x10);
/// Resets all registers.
pub const RESET: (u8, u8) = (0x0c, 0x89);
/// How long a reset takes, µs: until the calibration can be read.
pub const RESET_US: u64 = 40_000;
/// What of the part is ready: [`CALIBRATION_READY`], [`PRESSURE_READY`].
pub const STATUS: u8 = 0x08;
/// The calibration can be read, and the part can measure.
pub const CALIBRATION_READY: u8 = 0xc0;
/// There is a new pressure.
pub const PRESSURE_READY: u8 = 0x10;
/// The calibration's first register, and its bytes.
pub const CALIBRATION: (u8, usize) = (0x10, 18);
/// Which of its two thermometers the calibration is for, in the highest bit.
pub const THERMOMETER: u8 = 0x28;
/// The first register of the newest pressure and temperature, and their bytes.
pub const BURST: (u8, usize) = (0x00, 6);
/// Pressures a second, as [`setup`] sets them.
pub const SAMPLE_HZ: f32 = 32.0;
/// How long a pressure is averaged, µs: 16 measurements. It is true for the middle of that.
pub const AVERAGED_US: u64 = 27_600;

/// k of 16 measurements of pressure, and of one of temperature.
const PRESSURE_SCALE: f32 = 253_952.0;
const TEMPERATURE_SCALE: f32 = 524_288.0;
/// What the part says where it has no sample.
const NOTHING: i32 = -0x80_0000;

/// Registers and their values, in the order in which they are written.
///
/// - `thermometer`: what [`THERMOMETER`] says.
pub fn setup(thermometer: u8) -> [(u8, u8); 4] {
    [
        // PRS_CFG: 32 a second, each the mean of 16.
        (0x06, 0x54),
        // TMP_CFG: 4 a second, single, by the thermometer of the calibration.
        (0x07, 0x20 | thermometer & 0x80),
        // CFG_REG: P_SHIFT, which more than 8 measurements ask for.
        (0x09, 0x04),
        // MEAS_CFG: pressure and temperature, again and again.
        (STATUS, 0x07),
    ]
}

/// A part's own calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    c00: f32,
    c10: f32,
    c20: f32,
    c30: f32,
    c01: f32,
    c11: f32,
    c21: f32,
}

impl Calibration {
    /// The calibration that these registers hold.
    pub fn new(bytes: &[u8; CALIBRATION.1]) -> Self {
        let half = |at: usize| f32::from(i16::from_be_bytes([bytes[at], bytes[at + 1]]));
        // Both have 20 bits, five nibbles; the first three bytes hold c0 and c1, of the temperature alone.
        let long = |nibbles: [u8; 3]| (i32::from_be_bytes([nibbles[0], nibbles[1], nibbles[2], 0]) >> 12) as f32;
        let c10 = [bytes[5] << 4 | bytes[6] >> 4, bytes[6] << 4 | bytes[7] >> 4, bytes[7] << 4];
        Self {
            c00: long([bytes[3], bytes[4], bytes[5]]),
            c10: long(c10),
            c01: half(8),
            c11: half(10),
            c20: half(12),
            c21: half(14),
            c30: half(16),
        }
    }

    /// The pressure that a burst says, Pa; none while the part has none yet.
    pub fn pressure_pa(&self, burst: &[u8; BURST.1]) -> Option<f32> {
        let raw = |at: usize| i32::from_be_bytes([burst[at], burst[at + 1], burst[at + 2], 0]) >> 8;
        let (pressure, temperature) = (raw(0), raw(3));
        if pressure == NOTHING || temperature == NOTHING {
            return None;
        }
        let (p, t) = (pressure as f32 / PRESSURE_SCALE, temperature as f32 / TEMPERATURE_SCALE);
        let Self { c00, c10, c20, c30, c01, c11, c21 } = *self;
        Some(c00 + p * (c10 + p * (c20 + p * c30)) + t * c01 + t * p * (c11 + p * c21))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// c0 = 204, c1 = −261, c00 = 81 873, c10 = −53 968, c01 = −2 519, c11 = 1 440, c20 = −9 853, c21 = 150, c30 = −1 271.
    const BYTES: [u8; 18] =
        [0x0c, 0xce, 0xfb, 0x13, 0xfd, 0x1f, 0x2d, 0x30, 0xf6, 0x29, 0x05, 0xa0, 0xd9, 0x83, 0x00, 0x96, 0xfb, 0x09];

    fn burst(pressure: i32, temperature: i32) -> [u8; 6] {
        let [_, a, b, c] = pressure.to_be_bytes();
        let [_, d, e, f] = temperature.to_be_bytes();
        [a, b, c, d, e, f]
    }

    #[test]
    fn calibration_is_cut_into_its_20_and_16_bits_with_signs() {
        let Calibration { c00, c10, c20, c30, c01, c11, c21 } = Calibration::new(&BYTES);
        assert_eq!([c00, c10], [81_873.0, -53_968.0]);
        assert_eq!([c01, c11, c20, c21, c30], [-2_519.0, 1_440.0, -9_853.0, 150.0, -1_271.0]);
    }

    #[test]
    fn a_burst_is_a_pressure_by_the_datasheets_polynomial() {
        let calibration = Calibration::new(&BYTES);
        // In f64, by hand: p = −0.3, t = 0.25.
        let (pressure, temperature) = (-76_186, 131_072);
        let (p, t) = (f64::from(pressure) / 253_952.0, 0.25);
        let want =
            81_873.0 + p * (-53_968.0 + p * (-9_853.0 - p * 1_271.0)) - t * 2_519.0 + t * p * (1_440.0 + p * 150.0);
        let got = calibration.pressure_pa(&burst(pressure, temperature)).unwrap();
        assert!((f64::from(got) - want).abs() < 0.02, "{got} {want}");
        assert!((90_000.0..100_000.0).contains(&got), "{got}");
    }

    #[test]
    fn no_pressure_is_made_of_the_value_that_means_none() {
        let calibration = Calibration::new(&BYTES);
        assert_eq!(calibration.pressure_pa(&burst(-0x80_0000, 0)), None);
        assert_eq!(calibration.pressure_pa(&burst(0, -0x80_0000)), None);
    }

    #[test]
    fn the_thermometer_of_the_calibration_is_chosen() {
        assert_eq!(setup(0x80)[1], (0x07, 0xa0));
        assert_eq!(setup(0x7f)[1], (0x07, 0x20));
    }
}
