//! ICM-42688-P: what is written to its registers, and what its bytes mean.
//!
//! ```text
//! ω = raw · 2000 °/s / 2¹⁵        f = raw · 16 g / 2¹⁵        sample = mean of all records since the last one
//! ```
//!
//! The part samples at 8 kHz into its FIFO, and raises its line when four records are in it, 2,000 times a second, and again at each that
//! comes before it is read. One burst of [`BURST`] bytes reads status, bytes held, and four records; what is left after it is read by
//! further ones.
//!
//! A mean of four has no gain at 2 and 4 kHz, |sin(4x)/(4 sin x)| with x = π·f/8 kHz between: 0.91 at 500 Hz, 0.65 at 1 kHz, below 0.27 from 1.6
//! to 2.4 kHz, which would come out as slow as 400 Hz. It is 1.5 records late, [`LATE_US`]. Before it there is the part's own filter for
//! this, which is left as it comes out of its reset; that which follows it, of the registers here, is set so wide that it costs nothing.
//! Records that wait for a step that is late are all in the mean: the integral of the rates misses none. Nothing is left out but what is
//! refused ([`Lost`]), and then there is no sample.
//!
//! A line that stays high or low, and most of what a broken part may say, is no sample: the status must have none of the bits that cannot be
//! set, the count be one of whole records, each record say that it is of both sensors, and its temperature be one the part is made for.
//!
//! # Source
//! TDK DS-000347 rev 1.6, "ICM-42688-P datasheet": 3.1 and 3.2 for the scales, 4.10 and 14 for the registers, 6 for the FIFO. Of FIFO and
//! pulses also Linux, `drivers/iio/imu/inv_icm42600/inv_icm42600_buffer.c`, by the part's maker: watermark in bytes, low byte first, set before its
//! interrupt; a header with its first bit set is of an empty FIFO; reading goes on where it ended; and PX4's driver of the same part, which reads
//! status, count and records in one burst.
use control_core::GRAVITY_M_S2;
use control_core::frames::{Body, Vec3};
use control_core::measurement::Imu;
use core::f32::consts::PI;

/// Fastest clock of its bus, Hz.
pub const SPI_HZ_MAX: u32 = 24_000_000;
/// Times a second that it is to be read, as [`SETUP`] sets it up.
pub const SAMPLE_HZ: f32 = 2_000.0;
/// Records a second.
pub const RECORD_HZ: f32 = 8_000.0;
/// How much later a sample is than what it is the mean of, µs: half of what lies between the first and the last record.
pub const LATE_US: f32 = (RECORDS - 1) as f32 / 2.0 / RECORD_HZ * 1e6;
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
/// SIGNAL_PATH_RESET: empties the FIFO.
pub const FLUSH: (u8, u8) = (0x4b, 0x02);
/// Registers and their values, in the order in which they are written.
pub const SETUP: [(u8, u8); 11] = [
    // INT_CONFIG: INT1 is pushed high for a moment.
    (0x14, 0x03),
    // INT_CONFIG1: for 8 µs, none held back after another, as from 4 kHz on it must be; INT_ASYNC_RESET must be cleared for INT1 to work.
    (0x64, 0x60),
    // FIFO_CONFIG: the newest records stay.
    (0x16, 0x40),
    // FIFO_CONFIG2 and 3: the watermark, bytes.
    (0x60, (RECORDS * RECORD) as u8),
    (0x61, 0),
    // FIFO_CONFIG1: both sensors and the temperature; a pulse at each record from the watermark on; reading goes on where it ended.
    (0x5f, 0x67),
    // INT_SOURCE0: the watermark, on INT1.
    (0x65, 0x04),
    // GYRO_CONFIG0: 2000 °/s, 8 kHz.
    (0x4f, 0x03),
    // ACCEL_CONFIG0: 16 g, 8 kHz.
    (0x50, 0x03),
    // GYRO_ACCEL_CONFIG0: low-pass at half of the sample rate, the widest.
    (0x52, 0x00),
    // PWR_MGMT0: both on, low noise.
    (0x4e, 0x0f),
];

/// Records of a burst, and bytes of one: header, three and three words, a byte of temperature, time.
pub const RECORDS: usize = 4;
const RECORD: usize = 16;
/// First register of the burst, INT_STATUS, which is cleared by it, and bytes of a transfer with its address.
pub const BURST: (u8, usize) = (0x2d, 4 + RECORDS * RECORD);
/// Bursts after which there is no record left, with those that come meanwhile.
pub const BURSTS_MAX: usize = HELD_MAX / RECORDS + 1;
/// Records beyond which the FIFO was not read for so long that they are of the past: 2 ms.
const HELD_MAX: usize = 16;

/// Of INT_STATUS: what is never set: reserved, FSYNC; and what is no more when it is too late: FIFO full.
const WRONG: u8 = 0x80 | 0x40 | 0x02;
/// The half of a header that says what is in a record, and what it must say: not empty, accelerometer, gyro, 16 bits.
const HEADER: (u8, u8) = (0xf0, 0x60);
/// The highest temperature that the part is made for, 85 °C, in a record's counts, 2.07 a degree from 25 °C on; the lowest is none of them.
const HOTTEST: i8 = ((85.0 - 25.0) * 2.07) as i8;

/// What a count of the gyro is, rad/s.
pub const RATE_RAD_S: f32 = 2_000.0 / 180.0 * PI / 32_768.0;
/// What a count of the accelerometer is, m/s².
pub const FORCE_M_S2: f32 = 16.0 * GRAVITY_M_S2 / 32_768.0;
/// What the part says where it has no sample.
const NOTHING: i16 = i16::MIN;

/// How the part is soldered: for each body axis, forward, right and down, the part's axis and whether it points the other way.
pub type Mount = [(usize, bool); 3];

/// What the FIFO holds is not to be used: it must be flushed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost;

/// The records of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Records {
    /// Of force and rate, counts.
    sums: [i32; 6],
    count: i16,
}

impl Records {
    /// Takes those of a burst, its first byte being what came while the address was sent; whether that was all.
    ///
    /// # Errors
    /// If the FIFO was full or not read for 2 ms, is out of step, or has a record that is none.
    pub fn take(&mut self, burst: &[u8; BURST.1]) -> Result<bool, Lost> {
        let [_, status, high, low, records @ ..] = burst;
        let bytes = usize::from(u16::from_be_bytes([*high, *low]));
        if status & WRONG != 0 || bytes % RECORD != 0 || bytes > HELD_MAX * RECORD {
            return Err(Lost);
        }
        let held = bytes / RECORD;
        let (records, _) = records.as_chunks::<RECORD>();
        for record in records.iter().take(held) {
            self.add(record)?;
        }
        Ok(held <= RECORDS)
    }

    fn add(&mut self, record: &[u8; RECORD]) -> Result<(), Lost> {
        let [header, words @ .., temperature, _, _] = record;
        let mut there = header & HEADER.0 == HEADER.1 && temperature.cast_signed() <= HOTTEST;
        let (words, _) = words.as_chunks::<2>();
        for (sum, &word) in self.sums.iter_mut().zip(words) {
            let value = i16::from_be_bytes(word);
            there &= value != NOTHING;
            *sum += i32::from(value);
        }
        self.count += 1;
        if there { Ok(()) } else { Err(Lost) }
    }

    /// Their mean, along the body's axes; none of none.
    pub fn mean(&self, mount: &Mount) -> Option<Imu> {
        if self.count == 0 {
            return None;
        }
        let share = 1.0 / f32::from(self.count);
        let [fx, fy, fz, rx, ry, rz] = self.sums.map(|sum| sum as f32);
        let rate = to_body([rx, ry, rz], RATE_RAD_S * share, mount);
        let force = to_body([fx, fy, fz], FORCE_M_S2 * share, mount);
        Some(Imu { rate_rad_s: rate, specific_force_m_s2: force })
    }
}

/// What a part's counts are along the body's axes, by its scale.
pub fn to_body(raw: [f32; 3], scale: f32, mount: &Mount) -> Vec3<Body> {
    let [x, y, z] = mount.map(|(axis, turned)| {
        // The bound is said where the compiler sees it: no index panics in flight.
        let value = raw[axis % 3] * scale;
        if turned { -value } else { value }
    });
    Vec3::new(x, y, z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRAIGHT: Mount = [(0, false), (1, false), (2, false)];

    fn record(words: [i16; 6]) -> [u8; RECORD] {
        let mut bytes = [0; RECORD];
        bytes[0] = HEADER.1;
        for (to, word) in bytes[1..].chunks_exact_mut(2).zip(words) {
            to.copy_from_slice(&word.to_be_bytes());
        }
        bytes
    }

    /// A burst of a FIFO that holds `held` records, of which these come first.
    fn burst(held: u16, records: &[[u8; RECORD]]) -> [u8; BURST.1] {
        let mut bytes = [0xff; BURST.1];
        bytes[1] = 0x0c;
        bytes[2..4].copy_from_slice(&(held * RECORD as u16).to_be_bytes());
        for (to, record) in bytes[4..].chunks_exact_mut(RECORD).zip(records) {
            to.copy_from_slice(record);
        }
        bytes
    }

    /// The sample of one burst.
    fn sample(burst: &[u8; BURST.1], mount: &Mount) -> Option<Imu> {
        let mut records = Records::default();
        records.take(burst).ok()?;
        records.mean(mount)
    }

    #[test]
    fn full_scale_is_16_g_and_2000_degrees_a_second() {
        let imu = sample(&burst(4, &[record([-2_048, 0, 16_384, 16_384, -16_384, 0]); 4]), &STRAIGHT).unwrap();
        assert!((imu.specific_force_m_s2.x + GRAVITY_M_S2).abs() < 1e-5);
        assert!((imu.specific_force_m_s2.z - 8.0 * GRAVITY_M_S2).abs() < 1e-4);
        assert!((imu.rate_rad_s.x - 1_000_f32.to_radians()).abs() < 1e-4);
        assert!((imu.rate_rad_s.y + 1_000_f32.to_radians()).abs() < 1e-4);
    }

    #[test]
    fn axes_go_where_the_mount_says() {
        let turned: Mount = [(1, false), (0, false), (2, true)];
        let imu = sample(&burst(4, &[record([1, 2, 3, 4, 5, 6]); 4]), &turned).unwrap();
        let raw = |v: f32, scale: f32| (v / scale + 0.5).floor();
        assert_eq!(raw(imu.rate_rad_s.x, RATE_RAD_S), 5.0);
        assert_eq!(raw(imu.rate_rad_s.y, RATE_RAD_S), 4.0);
        assert_eq!(raw(imu.specific_force_m_s2.z, FORCE_M_S2), -3.0);
    }

    #[test]
    fn a_sample_is_the_mean_of_four_records_which_at_2_and_4_khz_is_nothing() {
        // Records of an oscillation of 8,000 counts, at a frequency, by 8 kHz.
        let mean = |hz: f32| {
            let at = |n: i16| (8_000.0 * (2.0 * PI * hz / RECORD_HZ * (f32::from(n) - 1.5)).cos()).round() as i16;
            let records = [0, 1, 2, 3].map(|n| record([0, 0, 0, at(n), 0, 0]));
            sample(&burst(4, &records), &STRAIGHT).unwrap().rate_rad_s.x / (8_000.0 * RATE_RAD_S)
        };
        for (hz, share) in
            [(0.0, 1.0), (500.0, 0.906), (1_000.0, 0.653), (1_600.0, 0.250), (2_000.0, 0.0), (4_000.0, 0.0)]
        {
            assert!((mean(hz) - share).abs() < 1e-3, "{} at {hz} Hz", mean(hz));
        }
        assert_eq!(LATE_US, 187.5);
    }

    #[test]
    fn records_that_wait_are_all_in_the_mean_and_what_is_not_there_is_not() {
        let of = |values: [i16; 4]| values.map(|value| record([0, 0, 0, value, 0, 0]));
        let counts = |records: &Records| (records.mean(&STRAIGHT).unwrap().rate_rad_s.x / RATE_RAD_S).round();
        // Late by three records.
        let mut records = Records::default();
        assert_eq!(records.take(&burst(7, &of([10, 20, 30, 40]))), Ok(false));
        assert_eq!(records.take(&burst(3, &of([50, 60, 70, 9])[..3])), Ok(true));
        assert_eq!(counts(&records), 40.0);
        // Early, when it is read by time: what follows the third is an empty FIFO.
        let mut records = Records::default();
        assert_eq!(records.take(&burst(3, &of([10, 20, 60, 9])[..3])), Ok(true));
        assert_eq!(counts(&records), 30.0);
        let mut records = Records::default();
        assert_eq!((records.take(&burst(0, &[])), records.mean(&STRAIGHT)), (Ok(true), None));
    }

    #[test]
    fn a_fifo_that_ran_over_is_out_of_step_or_was_not_read_for_2_ms_is_lost() {
        let good = burst(4, &[record([1; 6]); 4]);
        assert!(sample(&good, &STRAIGHT).is_some());
        let full = (1, 0x0e);
        let out_of_step = [(3, 65), (4, 0x80), (20, 0xff), (36, 0x70), (52, 0x20)];
        let old = (2, 1);
        for (at, byte) in [full, old].into_iter().chain(out_of_step) {
            let mut bad = good;
            bad[at] = byte;
            assert_eq!(Records::default().take(&bad), Err(Lost), "{byte:#04x} at {at}");
        }
        assert_eq!(Records::default().take(&burst(16, &[record([1; 6]); 4])), Ok(false));
    }

    #[test]
    fn a_line_that_stays_where_it_is_says_nothing_nor_does_a_record_from_the_oven() {
        assert_eq!(sample(&[0; BURST.1], &STRAIGHT), None);
        assert_eq!(sample(&[0xff; BURST.1], &STRAIGHT), None);
        // 85 °C are 124 counts.
        for (counts, believed) in [(124, true), (125, false)] {
            let mut hot = record([1; 6]);
            hot[13] = counts;
            assert_eq!(sample(&burst(4, &[hot; 4]), &STRAIGHT).is_some(), believed, "{counts}");
        }
    }

    #[test]
    fn no_sample_is_made_of_the_value_that_means_none() {
        for n in 0..6 {
            let mut words = [7; 6];
            words[n] = NOTHING;
            let records = [record([7; 6]), record(words), record([7; 6]), record([7; 6])];
            assert_eq!(sample(&burst(4, &records), &STRAIGHT), None, "{n}");
        }
    }
}
