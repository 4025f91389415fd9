//! USB OTG FS: a port with nothing plugged in. Registers keep what is written, resets are done at once and no session
//! is ever seen, so no interrupt is raised.
//!
//! # Source
//! RM0090, chapter 34.16 "OTG_FS control and status registers".
use std::collections::BTreeMap;

/// The port.
#[derive(Debug, Default)]
pub(crate) struct Otg {
    kept: BTreeMap<u32, u32>,
}

impl Otg {
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        let kept = self.kept.get(&offset).copied().unwrap_or(0);
        Some(match offset {
            // GOTGCTL: no session, device B.
            0x004 => kept | 1 << 16,
            // GRSTCTL: idle, and every reset or flush done.
            0x010 => (kept & !0x3f) | 1 << 31,
            // GINTSTS: device mode, nothing happens.
            0x014 => 0,
            // Core id.
            0x03c => 0x1200,
            0x008 | 0x00c | 0x018 | 0x024 | 0x028 | 0x038 | 0x100..=0x110 | 0x800..=0x834 | 0x900..=0xb7c | 0xe00 => {
                kept
            }
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x004..=0x03c | 0x100..=0x110 | 0x800..=0x834 | 0x900..=0xb7c | 0xe00 => self.kept.insert(offset, value),
            _ => return None,
        };
        Some(())
    }
}
