//! RTC: its backup registers, which keep their value over a reset. The clock itself is not modelled.
//!
//! # Source
//! RM0090, chapter 26.6.20 "RTC backup registers".

/// The backup registers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rtc {
    backup: [u32; 20],
}

impl Rtc {
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0x50..=0x9c => Some(self.backup[(offset as usize - 0x50) / 4]),
            _ => None,
        }
    }

    /// Writes, if the backup domain is unlocked; a write to a locked one is lost, as on the chip.
    pub(crate) fn write(&mut self, offset: u32, value: u32, unlocked: bool) -> Option<()> {
        match offset {
            0x50..=0x9c if unlocked => self.backup[(offset as usize - 0x50) / 4] = value,
            0x50..=0x9c => {}
            _ => return None,
        }
        Some(())
    }
}
