//! QMC5883L, a magnetometer: what is written to its registers, and what its bytes mean.
//!
//! ```text
//! B = raw · 100 µT / 3000, at ±8 G
//! ```
//!
//! # Source
//! QST, "QMC5883L datasheet" rev 1.0: 9.2 for the registers, 2.1 for the scale.
use control_core::frames::{Body, Vec3};

use crate::icm42688::{Mount, to_body};

/// Where the part is on its bus.
pub const ADDRESS: u8 = 0x0d;
/// The register that says what part this is, and what it says.
pub const CHIP_ID: (u8, u8) = (0x0d, 0xff);
/// Registers and their values, in the order in which they are written.
pub const SETUP: [(u8, u8); 3] = [
    // CONTROL2: reset.
    (0x0a, 0x80),
    // SET/RESET period, as the maker wants it.
    (0x0b, 0x01),
    // CONTROL1: again and again, 50 a second, ±8 G, each the mean of 512.
    (0x09, 0x15),
];
/// Which of [`READY`] is the case.
pub const STATUS: u8 = 0x06;
/// There is a new sample.
pub const READY: u8 = 0x01;
/// The first register of the newest sample, and its bytes with the status after it.
pub const BURST: (u8, usize) = (0x00, 7);
/// Samples a second, as [`SETUP`] sets them.
pub const SAMPLE_HZ: f32 = 50.0;

/// An axis was beyond its range.
const OVERFLOW: u8 = 0x02;
const FIELD_UT: f32 = 100.0 / 3_000.0;

/// The field that a burst says, µT; none beyond the part's range.
pub fn field_ut(burst: &[u8; BURST.1], mount: &Mount) -> Option<Vec3<Body>> {
    let word = |at: usize| i16::from_le_bytes([burst[at], burst[at + 1]]);
    (burst[6] & OVERFLOW == 0).then(|| to_body([word(0), word(2), word(4)].map(f32::from), FIELD_UT, mount))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEFT_UP: Mount = [(0, false), (1, true), (2, true)];

    #[test]
    fn a_burst_is_a_field_along_the_bodys_axes() {
        let field = field_ut(&[0x58, 0x02, 0xd4, 0xfe, 0x4c, 0xfb, 0x01], &LEFT_UP).unwrap();
        // 600, −300 and −1204 counts, y and z turned.
        assert!((field.x - 20.0).abs() < 1e-4 && (field.y - 10.0).abs() < 1e-4, "{field:?}");
        assert!((field.z - 40.133_33).abs() < 1e-4, "{field:?}");
    }

    #[test]
    fn no_field_is_made_of_one_beyond_the_range() {
        assert_eq!(field_ut(&[0, 0x80, 0, 0, 0, 0, 0x03], &LEFT_UP), None);
    }
}
