//! QMC5883L: the magnetometer, as its registers show it.
//!
//! Measuring without pause it has a sample as often as it is told; what it measures is what held then, rounded to its scale
//! and limited to its range. The temperature, interrupts, rolling pointers and noise are not modelled.
//!
//! # Source
//! QST, "QMC5883L datasheet" rev 1.0, chapter 9.2 "Register definition".
use super::Registers;

/// Where it is on its bus.
pub(crate) const ADDRESS: u8 = 0x0d;

/// Samples a second and counts a gauss, by their fields in CONTROL1.
const RATES_HZ: [u64; 4] = [10, 50, 100, 200];
const COUNTS_GAUSS: [f32; 2] = [12_000.0, 3_000.0];
const UT_GAUSS: f32 = 100.0;
const CONTINUOUS: u8 = 0x01;
const READY: u8 = 0x01;
const OVERFLOW: u8 = 0x02;

/// The part.
#[derive(Debug)]
pub(crate) struct Qmc5883l {
    /// Along its own axes, µT.
    field_ut: [f32; 3],
    cycles_us: u64,
    control: u8,
    /// When the next sample is taken, core cycles.
    next: u64,
    sample: [i16; 3],
    status: u8,
}

impl Qmc5883l {
    pub(crate) fn new(cycles_us: u64) -> Self {
        Self { field_ut: [20.0, 0.0, -43.0], cycles_us, control: 0, next: 0, sample: [0; 3], status: 0 }
    }

    /// Tells the part the field along its own axes from now on, µT.
    pub(crate) fn feel(&mut self, field_ut: [f32; 3], now: u64) {
        self.catch_up(now);
        self.field_ut = field_ut;
    }

    fn catch_up(&mut self, now: u64) {
        let period = 1_000_000 / RATES_HZ[usize::from(self.control >> 2 & 3)] * self.cycles_us;
        while self.control & 3 == CONTINUOUS && self.next <= now {
            let counts = COUNTS_GAUSS[usize::from(self.control >> 4 & 1)] / UT_GAUSS;
            let raw = self.field_ut.map(|field_ut| (field_ut * counts).round());
            let beyond = raw.iter().any(|raw| raw.abs() > 32_767.0);
            self.sample = raw.map(|raw| raw as i16);
            self.status = READY | if beyond { OVERFLOW } else { 0 };
            self.next += period;
        }
    }
}

impl Registers for Qmc5883l {
    fn read(&mut self, register: u8, now: u64) -> Option<u8> {
        self.catch_up(now);
        Some(match register {
            0x00..=0x05 => {
                self.status &= !READY;
                self.sample[usize::from(register / 2)].to_le_bytes()[usize::from(register % 2)]
            }
            0x06 => self.status,
            0x09 => self.control,
            0x0d => 0xff,
            _ => return None,
        })
    }

    fn write(&mut self, register: u8, value: u8, now: u64) -> Option<()> {
        match register {
            // Standing by or without pause; ±2 or ±8 G.
            0x09 if value & 0x22 == 0 => {
                (self.control, self.next) =
                    (value, now + 1_000_000 / RATES_HZ[usize::from(value >> 2 & 3)] * self.cycles_us);
            }
            0x0a if value == 0x80 => *self = Self { field_ut: self.field_ut, ..Self::new(self.cycles_us) },
            0x0b if value == 0x01 => {}
            _ => return None,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_samples_at_its_rate_and_says_so_until_it_is_fetched() {
        let mut part = Qmc5883l::new(1);
        assert_eq!(part.write(0x09, 0x15, 0), Some(()));
        part.feel([20.0, -10.0, 900.0], 19_999);
        assert_eq!(part.read(0x06, 19_999), Some(0));
        assert_eq!(part.read(0x06, 20_000), Some(READY));
        let bytes: Vec<u8> = (0..6).filter_map(|n| part.read(n, 20_100)).collect();
        assert_eq!(bytes, [0x58, 0x02, 0xd4, 0xfe, 0x78, 0x69]);
        assert_eq!(part.read(0x06, 39_999), Some(0));
        part.feel([0.0, 0.0, 1_100.0], 39_999);
        assert_eq!(part.read(0x06, 40_000), Some(READY | OVERFLOW));
    }
}
