//! SYSCFG: which port each external interrupt line watches.
//!
//! # Source
//! RM0090, chapter 9.2 "SYSCFG registers for STM32F405xx".
use super::only;

/// The system configuration controller.
#[derive(Debug, Default)]
pub(crate) struct Syscfg {
    exticr: [u32; 4],
}

impl Syscfg {
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            // Memory remap: flash.
            0x00 => Some(0),
            0x08..=0x14 => Some(self.exticr[(offset as usize - 8) / 4]),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x08..=0x14 => self.exticr[(offset as usize - 8) / 4] = only(value, 0xffff)?,
            _ => return None,
        }
        Some(())
    }

    /// The port, A being 0, that line `line` watches.
    pub(crate) fn port_of(&self, line: u32) -> usize {
        (self.exticr[line as usize / 4] >> (4 * (line % 4)) & 0xf) as usize
    }
}
