//! DWT: the cycle counter. It counts what the cycle model says (`block`, `flash_cache`), sleep included.
//!
//! # Source
//! ARMv7-M Architecture Reference Manual, C1.8 "The Data Watchpoint and Trace unit".
use super::only;

/// No comparators are modelled (NUMCOMP = 0).
const CYCCNTENA: u32 = 1;

/// The cycle counter.
#[derive(Debug, Default)]
pub(crate) struct Dwt {
    on: bool,
    /// What the counter showed at the cycle `since`.
    count: u32,
    since: u64,
}

impl Dwt {
    pub(crate) fn read(&self, offset: u32, now: u64) -> Option<u32> {
        match offset {
            0x0 => Some(u32::from(self.on)),
            0x4 => Some(self.count(now)),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: u64) -> Option<()> {
        match offset {
            0x0 => {
                self.count = self.count(now);
                self.on = only(value, CYCCNTENA)? != 0;
            }
            0x4 => self.count = value,
            _ => return None,
        }
        self.since = now;
        Some(())
    }

    fn count(&self, now: u64) -> u32 {
        if self.on { self.count.wrapping_add((now - self.since) as u32) } else { self.count }
    }
}
