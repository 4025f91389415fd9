//! IWDG: the independent watchdog, which resets the chip when it is not fed.
//!
//! ```text
//! time to reset = (RLR + 1)·4·2^PR / 32 kHz
//! ```
//!
//! The oscillator is taken at its nominal 32 kHz; on the chip it may be 17 to 47.
//!
//! # Source
//! RM0090, chapter 21.4 "IWDG registers".
use super::{NEVER, only};

const LSI_HZ: u64 = 32_000;

/// The watchdog.
#[derive(Debug)]
pub(crate) struct Iwdg {
    unlocked: bool,
    prescaler: u32,
    reload: u32,
    bites_at: Option<u64>,
}

impl Iwdg {
    pub(crate) fn new() -> Self {
        Self { unlocked: false, prescaler: 0, reload: 0xfff, bites_at: None }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0x4 => Some(self.prescaler),
            0x8 => Some(self.reload),
            // Updates are done at once.
            0xc => Some(0),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: u64, core_hz: u64) -> Option<()> {
        match (offset, value) {
            (0x0, 0xcccc) => self.bites_at = Some(now + self.timeout(core_hz)),
            (0x0, 0xaaaa) if self.bites_at.is_some() => self.bites_at = Some(now + self.timeout(core_hz)),
            (0x0, 0xaaaa) => {}
            (0x0, 0x5555) => {
                self.unlocked = true;
                return Some(());
            }
            (0x4, _) if self.unlocked => self.prescaler = only(value, 7)?,
            (0x8, _) if self.unlocked => self.reload = only(value, 0xfff)?,
            _ => return None,
        }
        self.unlocked &= offset != 0x0;
        Some(())
    }

    /// When it resets the chip.
    pub(crate) fn next(&self) -> u64 {
        self.bites_at.unwrap_or(NEVER)
    }

    fn timeout(&self, core_hz: u64) -> u64 {
        u64::from(self.reload + 1) * (4 << self.prescaler.min(6)) * core_hz / LSI_HZ
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_bites_after_its_time_unless_fed() {
        let mut dog = Iwdg::new();
        let hz = 168_000_000;
        assert_eq!(dog.write(0x8, 99, 0, hz), None, "locked");
        dog.write(0x0, 0x5555, 0, hz);
        dog.write(0x4, 1, 0, hz);
        dog.write(0x8, 99, 0, hz);
        assert_eq!(dog.next(), NEVER);
        dog.write(0x0, 0xcccc, 1_000, hz);
        assert_eq!(dog.next(), 1_000 + 100 * 8 * 5_250);
        dog.write(0x0, 0xaaaa, 2_000, hz);
        assert_eq!(dog.next(), 2_000 + 100 * 8 * 5_250);
    }
}
