//! PWR: the regulator, ready at once. Sleep modes deeper than WFI are not modelled.
//!
//! # Source
//! RM0090, chapter 5.5 "Power control registers (STM32F405xx)".
use super::only;

const VOSRDY: u32 = 1 << 14;
const BRR: u32 = 1 << 3;

/// The power controller.
#[derive(Debug)]
pub(crate) struct Pwr {
    cr: u32,
    csr: u32,
}

impl Pwr {
    pub(crate) fn new() -> Self {
        Self { cr: 0x4000, csr: 0 }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0x00 => Some(self.cr),
            0x04 => Some(self.csr | VOSRDY | (self.csr >> 9 & 1) * BRR),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            // VOS, DBP, FPDS, and the clearing bits, which have nothing to clear. Bit 15 is a second bit of VOS on larger
            // chips; libraries write it here too.
            0x00 => self.cr = only(value, 0xc30c)? & 0x4300,
            // The backup regulator.
            0x04 => self.csr = only(value & !(VOSRDY | BRR), 1 << 9)?,
            _ => return None,
        }
        Some(())
    }

    /// Whether the backup domain may be written.
    pub(crate) fn unlocks_backup(&self) -> bool {
        self.cr & 1 << 8 != 0
    }
}
