//! SysTick: the core's own 24-bit down-counter, on the core's clock.
//!
//! # Source
//! ARMv7-M Architecture Reference Manual, B3.3 "The system timer, SysTick".
use super::{NEVER, only};

const ENABLE: u32 = 1;
const TICKINT: u32 = 2;
const CLKSOURCE: u32 = 4;
const COUNTFLAG: u32 = 1 << 16;

/// The counter.
#[derive(Debug, Default)]
pub(crate) struct SysTick {
    ctrl: u32,
    load: u32,
    /// When the counter reaches zero next.
    zero_at: u64,
    /// Value while stopped.
    held: u32,
    reached: bool,
}

impl SysTick {
    /// Reads at `offset` of the page 0xE000E000.
    pub(crate) fn read(&mut self, offset: u32, now: u64) -> Option<u32> {
        Some(match offset {
            0x010 => self.ctrl | if std::mem::take(&mut self.reached) { COUNTFLAG } else { 0 },
            0x014 => self.load,
            0x018 if self.is_on() => self.zero_at.saturating_sub(now) as u32,
            0x018 => self.held,
            0x01c => 0xc000_0000,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: u64) -> Option<()> {
        match offset {
            0x010 => {
                let was_on = self.is_on();
                // Only the core's clock is modelled.
                self.ctrl = only(value, ENABLE | TICKINT | CLKSOURCE)?;
                match (was_on, self.is_on()) {
                    (false, true) => self.zero_at = now + u64::from(if self.held == 0 { self.load } else { self.held }),
                    (true, false) => self.held = self.zero_at.saturating_sub(now) as u32,
                    _ => {}
                }
            }
            0x014 => self.load = only(value, 0x00ff_ffff)?,
            // Any write clears it; it reloads at the next clock.
            0x018 => {
                self.held = 0;
                self.reached = false;
                self.zero_at = now + u64::from(self.load) + 1;
            }
            _ => return None,
        }
        Some(())
    }

    pub(crate) fn next(&self) -> u64 {
        if self.is_on() { self.zero_at } else { NEVER }
    }

    /// The counter has reached zero; whether that is an exception.
    pub(crate) fn event(&mut self) -> bool {
        self.reached = true;
        self.zero_at += u64::from(self.load) + 1;
        self.ctrl & TICKINT != 0
    }

    fn is_on(&self) -> bool {
        self.ctrl & ENABLE != 0 && self.load > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_reaches_zero_every_load_plus_one_cycles() {
        let mut tick = SysTick::default();
        tick.write(0x014, 999, 0);
        tick.write(0x018, 0, 10);
        tick.write(0x010, 7, 10);
        assert_eq!(tick.next(), 1_009);
        assert!(tick.event());
        assert_eq!(tick.next(), 2_009);
        assert_eq!(tick.read(0x018, 1_509), Some(500));
        assert_eq!(tick.read(0x010, 1_509).map(|ctrl| ctrl & COUNTFLAG), Some(COUNTFLAG));
        assert_eq!(tick.read(0x010, 1_509).map(|ctrl| ctrl & COUNTFLAG), Some(0));
    }
}
