//! DBGMCU: what a probe may freeze. There is none: the bits are kept and do nothing.
//!
//! # Source
//! RM0090, chapter 38.16 "MCU debug component".
use super::only;

/// Device 0x413, revision Z.
const IDCODE: u32 = 0x1001_6413;

/// The debug controller.
#[derive(Debug, Default)]
pub(crate) struct Dbgmcu {
    cr: u32,
    freeze: [u32; 2],
}

impl Dbgmcu {
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x0 => IDCODE,
            0x4 => self.cr,
            0x8 => self.freeze[0],
            0xc => self.freeze[1],
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x4 => self.cr = only(value, 0x7)?,
            0x8 => self.freeze[0] = only(value, 0x06e0_1dff)?,
            0xc => self.freeze[1] = only(value, 0x0007_0003)?,
            _ => return None,
        }
        Some(())
    }
}
