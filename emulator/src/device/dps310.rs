//! DPS310: the barometer, as its registers show it.
//!
//! ```text
//! pressure = c00 + p (c10 + p (c20 + p c30)) + t c01 + t p (c11 + p c21)        temperature = c0 / 2 + c1 t
//! ```
//!
//! Measuring without pause it averages for the time of its oversampling, as often a second as it is told. What it measures is
//! what held in the middle of that; p is found by Newton's method. Temperature comes with each pressure, whatever its own
//! rate. FIFO, interrupts, single measurements and noise are not modelled: the simulator adds errors.
//!
//! # Source
//! Infineon, "DPS310 datasheet" rev 1.2, chapters 4.9, 7 and 8; table 16 for the times, table 9 for the scales.
use super::Registers;

/// Where it is on its bus.
pub(crate) const ADDRESS: u8 = 0x76;

/// c0, c1, c00, c10, c01, c11, c20, c21, c30: of the order of a real part's.
const CALIBRATION: [f64; 9] = [204.0, -261.0, 81_873.0, -53_968.0, -2_519.0, 1_440.0, -9_853.0, 150.0, -1_271.0];
/// The same in its registers.
const COEFFICIENTS: [u8; 18] =
    [0x0c, 0xce, 0xfb, 0x13, 0xfd, 0x1f, 0x2d, 0x30, 0xf6, 0x29, 0x05, 0xa0, 0xd9, 0x83, 0x00, 0x96, 0xfb, 0x09];
/// Scales by oversampling, 1 to 128.
const SCALES: [f64; 8] =
    [524_288.0, 1_572_864.0, 3_670_016.0, 7_864_320.0, 253_952.0, 516_096.0, 1_040_384.0, 2_088_960.0];
/// Times of a pressure by oversampling, µs.
const AVERAGED_US: [u64; 8] = [3_600, 5_200, 8_400, 14_800, 27_600, 53_200, 104_400, 206_800];
/// After a reset: until the part can measure, and until the calibration can be read, µs.
const SENSOR_US: u64 = 12_000;
const COEFFICIENTS_US: u64 = 40_000;
const READY: u8 = 0x30;

/// The part.
#[derive(Debug)]
pub(crate) struct Dps310 {
    /// Pressure, Pa, and temperature, °C, around it.
    air: (f32, f32),
    cycles_us: u64,
    reset_at: u64,
    /// PRS_CFG, TMP_CFG, CFG_REG.
    config: [u8; 3],
    /// When it began to measure without pause, core cycles.
    since: Option<u64>,
    /// Pressures of which it has seen the middle, and the end; the last of each, raw.
    seen: (u64, u64),
    middle: (i32, i32),
    ready: (i32, i32),
    fresh: u8,
}

impl Dps310 {
    pub(crate) fn new(cycles_us: u64) -> Self {
        Self {
            air: (101_325.0, 15.0),
            cycles_us,
            reset_at: 0,
            config: [0; 3],
            since: None,
            seen: (0, 0),
            middle: (0, 0),
            ready: (-0x80_0000, -0x80_0000),
            fresh: 0,
        }
    }

    /// Tells the part what is around it from now on.
    pub(crate) fn feel(&mut self, pressure_pa: f32, temperature_c: f32, now: u64) {
        self.catch_up(now);
        self.air = (pressure_pa, temperature_c);
    }

    /// Measures what is due.
    fn catch_up(&mut self, now: u64) {
        let Some(since) = self.since else { return };
        let [pressure, ..] = self.config;
        let period = self.cycles_us * 1_000_000 >> (pressure >> 4 & 7);
        let averaged = self.cycles_us * AVERAGED_US[usize::from(pressure & 7)];
        loop {
            let (middles, ends) = self.seen;
            let middle_at = since + middles * period + averaged / 2;
            let end_at = since + ends * period + averaged;
            if middles == ends && middle_at <= now {
                self.middle = self.raw();
                self.seen.0 += 1;
            } else if middles > ends && end_at <= now {
                (self.ready, self.fresh) = (self.middle, READY);
                self.seen.1 += 1;
            } else {
                return;
            }
        }
    }

    /// What the converter makes of the air: pressure and temperature.
    fn raw(&self) -> (i32, i32) {
        let [pressure, temperature, _] = self.config.map(usize::from);
        let [c0, c1, c00, c10, c01, c11, c20, c21, c30] = CALIBRATION;
        let (pressure_pa, temperature_c) = (f64::from(self.air.0), f64::from(self.air.1));
        let t = (temperature_c - 0.5 * c0) / c1;
        let mut p = 0.0;
        for _ in 0..8 {
            let value = c00 + p * (c10 + p * (c20 + p * c30)) + t * c01 + t * p * (c11 + p * c21);
            let slope = c10 + p * (2.0 * c20 + p * 3.0 * c30) + t * (c11 + 2.0 * p * c21);
            p -= (value - pressure_pa) / slope;
        }
        let raw = |share: f64, scale: f64| (share * scale).round().clamp(-8_388_607.0, 8_388_607.0) as i32;
        (raw(p, SCALES[pressure & 7]), raw(t, SCALES[temperature & 7]))
    }
}

impl Registers for Dps310 {
    fn read(&mut self, register: u8, now: u64) -> Option<u8> {
        self.catch_up(now);
        let after = now.saturating_sub(self.reset_at) / self.cycles_us;
        let byte = |value: i32, at: u8| (value >> (8 * (2 - at))) as u8;
        Some(match register {
            0x00..=0x02 => {
                self.fresh &= !0x10;
                byte(self.ready.0, register)
            }
            0x03..=0x05 => {
                self.fresh &= !0x20;
                byte(self.ready.1, register - 3)
            }
            0x06 | 0x07 => self.config[usize::from(register - 6)],
            0x08 => {
                let flag = |on: bool, bit: u8| if on { bit } else { 0 };
                flag(after >= COEFFICIENTS_US, 0x80)
                    | flag(after >= SENSOR_US, 0x40)
                    | self.fresh
                    | flag(self.since.is_some(), 0x07)
            }
            0x09 => self.config[2],
            0x0d => 0x10,
            0x10..=0x21 if after >= COEFFICIENTS_US => COEFFICIENTS[usize::from(register - 0x10)],
            0x10..=0x21 => 0,
            // The coefficients are for the external thermometer.
            0x28 => 0x80,
            _ => return None,
        })
    }

    fn write(&mut self, register: u8, value: u8, now: u64) -> Option<()> {
        match register {
            // Settings belong to the time before it measures.
            0x06 if self.since.is_none() && value & 0x88 == 0 => self.config[0] = value,
            // By the thermometer that the coefficients are for.
            0x07 if self.since.is_none() && value & 0x88 == 0x80 => self.config[1] = value,
            // P_SHIFT and T_SHIFT, where the oversampling wants them.
            0x09 if value & !0x0c == 0 => self.config[2] = value,
            0x08 if value == 0x07 => {
                let [pressure, temperature, shifts] = self.config;
                let wanted = u8::from(pressure & 7 > 3) << 2 | u8::from(temperature & 7 > 3) << 3;
                let time_us = (AVERAGED_US[usize::from(pressure & 7)] << (pressure >> 4 & 7))
                    + (AVERAGED_US[usize::from(temperature & 7)] << (temperature >> 4 & 7));
                if shifts != wanted || time_us >= 1_000_000 {
                    return None;
                }
                (self.since, self.seen) = (Some(now), (0, 0));
            }
            0x0c if value & 0x0f == 0x09 => {
                *self = Self { air: self.air, reset_at: now, ..Self::new(self.cycles_us) };
            }
            _ => return None,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pressure_is_of_the_middle_of_its_time_and_the_coefficients_give_it_back() {
        let mut part = Dps310::new(1);
        assert_eq!(part.read(0x08, 39_999), Some(0x40));
        for (register, value) in [(0x06, 0x54), (0x07, 0xa0), (0x09, 0x04), (0x08, 0x07)] {
            assert_eq!(part.write(register, value, 50_000), Some(()), "{register:#x}");
        }
        part.feel(90_000.0, 30.0, 50_000);
        part.feel(99_000.0, 25.0, 50_000 + 13_801);
        assert_eq!(part.read(0x08, 50_000 + 27_599), Some(0xc7));
        assert_eq!(part.read(0x08, 50_000 + 27_600), Some(0xf7));
        let burst: Vec<i32> = (0..6).map(|n| i32::from(part.read(n, 78_000).unwrap_or(0))).collect();
        assert_eq!(part.read(0x08, 78_000), Some(0xc7), "fetched");
        let word = |at: usize| (burst[at] << 24 | burst[at + 1] << 16 | burst[at + 2] << 8) >> 8;
        let (p, t) = (f64::from(word(0)) / 253_952.0, f64::from(word(3)) / 524_288.0);
        let [c0, c1, c00, c10, c01, c11, c20, c21, c30] = CALIBRATION;
        let pressure = c00 + p * (c10 + p * (c20 + p * c30)) + t * c01 + t * p * (c11 + p * c21);
        assert!((pressure - 90_000.0).abs() < 0.2, "{pressure}");
        assert!((0.5 * c0 + c1 * t - 30.0).abs() < 0.01);
        assert_eq!(part.read(0x08, 50_000 + 31_250 + 27_600), Some(0xf7), "32 a second");
    }

    #[test]
    fn what_the_part_could_not_do_is_refused() {
        let mut part = Dps310::new(1);
        part.write(0x06, 0x64, 0);
        part.write(0x07, 0x80, 0);
        part.write(0x09, 0x04, 0);
        assert_eq!(part.write(0x08, 0x07, 0), None, "64 times 27.6 ms are more than a second");
        part.write(0x06, 0x54, 0);
        part.write(0x09, 0x00, 0);
        assert_eq!(part.write(0x08, 0x07, 0), None, "16 measurements need P_SHIFT");
        assert_eq!(part.write(0x07, 0x20, 0), None, "the wrong thermometer");
        assert_eq!(part.read(0x0a, 0), None);
    }
}
