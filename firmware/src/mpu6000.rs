//! MPU-6000: what is written to its registers, and what its bytes mean.
//!
//! ```text
//! ω = raw · 2000 °/s / 2¹⁵        f = raw · 16 g / 2¹⁵        rate = 8 kHz / (1 + SMPLRT_DIV)
//! ```
//!
//! One burst reads whether a sample is new, accelerometer, temperature and gyro. The accelerometer has a new value every
//! millisecond only: at 2 kHz it says each one twice.
//!
//! What is no sample is told as of an ICM-42688-P (`icm42688.rs`): by the status, which must say *new* and nothing that is not
//! switched on, and by the temperature. It has no value that means none.
//!
//! # Source
//! `InvenSense` RM-MPU-6000A-00 rev 4.2, "Register Map and Descriptions": 4.2 to 4.5, 4.15, 4.17 to 4.20, 4.27 to 4.30, 4.32; PS-MPU-6000A-00 rev
//! 3.4, "Product Specification": 6.1 and 6.2 for the scales, 6.5 for the bus.
use crate::icm42688::{FORCE_M_S2, Mount, RATE_RAD_S, to_body};
use control_core::measurement::Imu;

/// What the register that says what part this is says; it is that of the ICM-42688-P.
pub const WHO_AM_I: u8 = 0x68;
/// Fastest clock of its bus, Hz: of all registers, and of those that [`BURST`] reads.
pub const SPI_HZ_MAX: (u32, u32) = (1_000_000, 20_000_000);
/// How long a reset takes, and as long again that of the paths of its signals, µs.
pub const RESET_US: u64 = 100_000;
/// How long the gyro takes to start, µs.
pub const START_US: u64 = 30_000;
/// Registers and their values that reset it; the second a reset's time after the first, which leaves it asleep.
pub const RESET: [(u8, u8); 2] = [
    // PWR_MGMT_1: all registers.
    (0x6b, 0x80),
    // SIGNAL_PATH_RESET: gyro, accelerometer, temperature.
    (0x68, 0x07),
];
/// Registers and their values, in the order in which they are written.
pub const SETUP: [(u8, u8); 8] = [
    // PWR_MGMT_1: awake, by the gyro's oscillator, which is the steadier.
    (0x6b, 0x01),
    // USER_CTRL: no I2C, which noise on the select line might wake.
    (0x6a, 0x10),
    // CONFIG: the widest filter, 256 Hz, with which the gyro has 8,000 samples a second.
    (0x1a, 0x00),
    // SMPLRT_DIV: of these, every fourth.
    (0x19, 0x03),
    // GYRO_CONFIG: 2000 °/s.
    (0x1b, 0x18),
    // ACCEL_CONFIG: 16 g.
    (0x1c, 0x18),
    // INT_PIN_CFG: pushed high for 50 µs.
    (0x37, 0x00),
    // INT_ENABLE: data ready.
    (0x38, 0x01),
];

/// First register of the burst, INT_STATUS, which is cleared by it, and bytes of a transfer with its address.
pub const BURST: (u8, usize) = (0x3a, 16);

/// Of INT_STATUS: a sample is new; and that bit with FIFO overflow and I2C master, which are off.
const NEW: (u8, u8) = (0x01, 0x01 | 0x10 | 0x08);
/// Temperatures that the part is made for, °C; its counts a degree, and its zero.
const TEMPERATURE_C: (f32, f32) = (-40.0, 85.0);
const COUNTS_C: f32 = 340.0;
const ZERO_C: f32 = 36.53;

/// What a burst says, its first byte being what came while the address was sent; none while the part has no new sample.
pub fn sample(burst: &[u8; BURST.1], mount: &Mount) -> Option<Imu> {
    let word = |at: usize| i16::from_be_bytes([burst[at], burst[at + 1]]);
    let temperature_c = f32::from(word(8)) / COUNTS_C + ZERO_C;
    if burst[1] & NEW.1 != NEW.0 || !(TEMPERATURE_C.0..=TEMPERATURE_C.1).contains(&temperature_c) {
        return None;
    }
    let force = [word(2), word(4), word(6)].map(f32::from);
    let rate = [word(10), word(12), word(14)].map(f32::from);
    let (rate, force) = (to_body(rate, RATE_RAD_S, mount), to_body(force, FORCE_M_S2, mount));
    Some(Imu { rate_rad_s: rate, specific_force_m_s2: force })
}

#[cfg(test)]
mod tests {
    use super::*;
    use control_core::GRAVITY_M_S2;

    const STRAIGHT: Mount = [(0, false), (1, false), (2, false)];

    fn burst(force: [i16; 3], rate: [i16; 3]) -> [u8; BURST.1] {
        let mut bytes = [0; BURST.1];
        bytes[1] = NEW.0;
        for (n, word) in force.into_iter().chain([0]).chain(rate).enumerate() {
            bytes[2 + 2 * n..4 + 2 * n].copy_from_slice(&word.to_be_bytes());
        }
        bytes
    }

    #[test]
    fn full_scale_is_16_g_and_2000_degrees_a_second() {
        // The manual's sensitivities: 2,048 counts a g, 16.4 a degree a second.
        let imu = sample(&burst([-2_048, 0, 16_384], [16_400, -16_400, 0]), &STRAIGHT).unwrap();
        assert!((imu.specific_force_m_s2.x + GRAVITY_M_S2).abs() < 1e-5);
        assert!((imu.specific_force_m_s2.z - 8.0 * GRAVITY_M_S2).abs() < 1e-4);
        assert!((imu.rate_rad_s.x - 1_000_f32.to_radians()).abs() < 0.02);
        assert!((imu.rate_rad_s.y + 1_000_f32.to_radians()).abs() < 0.02);
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
        // The sensor's range ends at −26,020 and 16,480 counts.
        for (at, byte) in [(1, 0), (1, 0x11), (1, 0x09), (8, 0x7f), (8, 0x80), (8, 0x42)] {
            let mut bad = good;
            bad[at] = byte;
            assert_eq!(sample(&bad, &STRAIGHT), None, "{byte:#04x} at {at}");
        }
    }
}
