//! ICM-42688-P: what is written to its registers, and what its bytes mean.
//!
//! ```text
//! ω = raw · 2000 °/s / 2¹⁵        f = raw · 16 g / 2¹⁵
//! ```
//!
//! One burst of [`BURST`] bytes reads temperature, accelerometer, gyro and whether they are new. A driver from the shelf reads
//! the part's FIFO instead, which costs a second transfer a sample and says no more.
//!
//! A line that stays high or low, and most of what a broken part may say, is no sample: the status must say *new*, with none
//! of the bits that cannot be set, and the temperature be one the part is made for.
//!
//! # Source
//! TDK DS-000347 rev 1.6, "ICM-42688-P datasheet": 4.10 and 14 for the registers, 3.1 and 3.2 for the scales.
use control_core::GRAVITY_M_S2;
use control_core::frames::{Body, Vec3};
use control_core::measurement::Imu;
use core::f32::consts::PI;

/// Fastest clock of its bus, Hz.
pub const SPI_HZ_MAX: u32 = 24_000_000;
/// Samples a second, as [`SETUP`] sets them.
pub const SAMPLE_HZ: f32 = 2_000.0;
/// The register that says what part this is, and what it says.
pub const WHO_AM_I: (u8, u8) = (0x75, 0x47);
/// In the first byte of a transfer: read.
pub const READ: u8 = 0x80;
/// How long a reset takes, µs.
pub const RESET_US: u64 = 2_000;
/// How long the gyro takes to start, µs.
pub const START_US: u64 = 45_000;
/// Resets all registers.
pub const RESET: (u8, u8) = (0x11, 0x01);
/// Registers and their values, in the order in which they are written.
pub const SETUP: [(u8, u8); 7] = [
    // INT_CONFIG: INT1 is pushed high for a moment at each sample.
    (0x14, 0x03),
    // INT_CONFIG1: INT_ASYNC_RESET must be cleared for INT1 to work.
    (0x64, 0x00),
    // INT_SOURCE0: data ready, on INT1.
    (0x65, 0x08),
    // GYRO_CONFIG0: 2000 °/s, 2 kHz.
    (0x4f, 0x05),
    // ACCEL_CONFIG0: 16 g, 2 kHz.
    (0x50, 0x05),
    // GYRO_ACCEL_CONFIG0: low-pass at half of the sample rate's Nyquist, the widest.
    (0x52, 0x00),
    // PWR_MGMT0: both on, low noise.
    (0x4e, 0x0f),
];

/// First register of the burst, and bytes of a transfer with its address: up to INT_STATUS, which is cleared by it.
pub const BURST: (u8, usize) = (0x1d, 18);

/// Of INT_STATUS: a sample is new; and that bit with those that no sample has: reserved, FSYNC, FIFO full.
const NEW: (u8, u8) = (0x08, 0x08 | 0x80 | 0x40 | 0x02);
/// Temperatures that the part is made for, °C; its counts a degree, and its zero.
const TEMPERATURE_C: (f32, f32) = (-40.0, 85.0);
const COUNTS_C: f32 = 132.48;
const ZERO_C: f32 = 25.0;

/// What a count of the gyro is, rad/s.
pub const RATE_RAD_S: f32 = 2_000.0 / 180.0 * PI / 32_768.0;
/// What a count of the accelerometer is, m/s².
pub const FORCE_M_S2: f32 = 16.0 * GRAVITY_M_S2 / 32_768.0;
/// What the part says where it has no sample.
const NOTHING: i16 = i16::MIN;

/// How the part is soldered: for each body axis, forward, right and down, the part's axis and whether it points the other way.
pub type Mount = [(usize, bool); 3];

/// What a burst says, its first byte being what came while the address was sent; none while the part has no new sample.
pub fn sample(burst: &[u8; BURST.1], mount: &Mount) -> Option<Imu> {
    let word = |at: usize| i16::from_be_bytes([burst[at], burst[at + 1]]);
    let temperature_c = f32::from(word(1)) / COUNTS_C + ZERO_C;
    if burst[BURST.1 - 1] & NEW.1 != NEW.0 || !(TEMPERATURE_C.0..=TEMPERATURE_C.1).contains(&temperature_c) {
        return None;
    }
    // After the temperature.
    let force = [word(3), word(5), word(7)];
    let rate = [word(9), word(11), word(13)];
    if force.contains(&NOTHING) || rate.contains(&NOTHING) {
        return None;
    }
    let (rate, force) = (to_body(rate, RATE_RAD_S, mount), to_body(force, FORCE_M_S2, mount));
    Some(Imu { rate_rad_s: rate, specific_force_m_s2: force })
}

/// What a part's counts are along the body's axes, by its scale.
pub fn to_body(raw: [i16; 3], scale: f32, mount: &Mount) -> Vec3<Body> {
    let [x, y, z] = mount.map(|(axis, turned)| {
        // The bound is said where the compiler sees it: no index panics in flight.
        let value = f32::from(raw[axis % 3]) * scale;
        if turned { -value } else { value }
    });
    Vec3::new(x, y, z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRAIGHT: Mount = [(0, false), (1, false), (2, false)];

    fn burst(force: [i16; 3], rate: [i16; 3]) -> [u8; BURST.1] {
        let mut bytes = [0; BURST.1];
        bytes[BURST.1 - 1] = NEW.0;
        for (n, word) in force.into_iter().chain(rate).enumerate() {
            bytes[3 + 2 * n..5 + 2 * n].copy_from_slice(&word.to_be_bytes());
        }
        bytes
    }

    #[test]
    fn full_scale_is_16_g_and_2000_degrees_a_second() {
        let imu = sample(&burst([-2_048, 0, 16_384], [16_384, -16_384, 0]), &STRAIGHT).unwrap();
        assert!((imu.specific_force_m_s2.x + GRAVITY_M_S2).abs() < 1e-5);
        assert!((imu.specific_force_m_s2.z - 8.0 * GRAVITY_M_S2).abs() < 1e-4);
        assert!((imu.rate_rad_s.x - 1_000_f32.to_radians()).abs() < 1e-4);
        assert!((imu.rate_rad_s.y + 1_000_f32.to_radians()).abs() < 1e-4);
    }

    #[test]
    fn axes_go_where_the_mount_says() {
        let turned: Mount = [(1, false), (0, false), (2, true)];
        let imu = sample(&burst([1, 2, 3], [4, 5, 6]), &turned).unwrap();
        let raw = |v: f32, scale: f32| (v / scale + 0.5).floor();
        assert_eq!(raw(imu.rate_rad_s.x, RATE_RAD_S), 5.0);
        assert_eq!(raw(imu.rate_rad_s.y, RATE_RAD_S), 4.0);
        assert_eq!(raw(imu.specific_force_m_s2.z, FORCE_M_S2), -3.0);
    }

    #[test]
    fn a_line_that_stays_where_it_is_says_nothing_nor_does_a_sample_that_is_old_or_from_the_oven() {
        assert_eq!(sample(&[0; BURST.1], &STRAIGHT), None);
        assert_eq!(sample(&[0xff; BURST.1], &STRAIGHT), None);
        let good = burst([1, 2, 3], [4, 5, 6]);
        assert!(sample(&good, &STRAIGHT).is_some());
        for (at, byte) in [(BURST.1 - 1, 0), (BURST.1 - 1, 0x88), (BURST.1 - 1, 0x0a), (1, 0x7f), (1, 0x80)] {
            let mut bad = good;
            bad[at] = byte;
            assert_eq!(sample(&bad, &STRAIGHT), None, "{byte:#04x} at {at}");
        }
    }

    #[test]
    fn no_sample_is_made_of_the_value_that_means_none() {
        for n in 0..6 {
            let mut words = [7; 6];
            words[n] = NOTHING;
            let [a, b, c, d, e, f] = words;
            assert_eq!(sample(&burst([a, b, c], [d, e, f]), &STRAIGHT), None, "{n}");
        }
    }
}
