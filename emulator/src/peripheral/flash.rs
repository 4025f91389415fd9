//! FLASH: the registers of the flash memory: wait states and caches, programming and erasing.
//!
//! Programming takes 16 µs a word and erasing a sector 16, 64 or 128 KiB 0.25, 0.55 or 1 s (the data sheet's typical
//! values at 32 bits); bits only ever go from one to zero until their sector is erased.
//!
//! # Source
//! RM0090, chapter 3.9 "Flash interface registers"; DS8626 table 39.
use super::only;

const BSY: u32 = 1 << 16;
const EOP: u32 = 1;
const LOCK: u32 = 1 << 31;
const STRT: u32 = 1 << 16;
const PG: u32 = 1;
const SER: u32 = 2;

/// Where flash begins.
pub(crate) const FLASH_START: u32 = 0x0800_0000;

/// Something to do to the memory itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Operation {
    /// Set these bytes to 0xFF.
    Erase {
        /// First address.
        start: u32,
        /// Bytes.
        length: u32,
    },
}

/// The interface's registers.
#[derive(Debug)]
pub(crate) struct Flash {
    acr: u32,
    sr: u32,
    cr: u32,
    keys: u32,
    busy_until: u64,
    /// What [`Self::write`] has started and nobody has done yet.
    pub(crate) started: Option<Operation>,
}

impl Flash {
    pub(crate) fn new() -> Self {
        Self { acr: 0, sr: 0, cr: LOCK, keys: 0, busy_until: 0, started: None }
    }

    pub(crate) fn read(&self, offset: u32, now: u64) -> Option<u32> {
        Some(match offset {
            0x00 => self.acr,
            0x0c => self.sr | if now < self.busy_until { BSY } else { 0 },
            0x10 => self.cr,
            0x14 => 0x0fff_aaed,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: u64, core_hz: u64) -> Option<()> {
        match offset {
            // Latency, caches on, caches reset; the prefetch is not modelled.
            0x00 => self.acr = only(value, 0x1e07)? & 0x0607,
            0x04 => match (self.keys, value) {
                (0, 0x4567_0123) => self.keys = 1,
                (1, 0xcdef_89ab) => {
                    self.keys = 0;
                    self.cr &= !LOCK;
                }
                _ => return None,
            },
            0x0c => self.sr &= !value,
            0x10 => {
                // Once locked, only the keys open it; mass erase is not modelled.
                if self.cr & LOCK == 0 || value & LOCK != 0 {
                    self.cr = only(value, LOCK | STRT | PG | SER | 0x37c | 3 << 24)? & !STRT;
                }
                if value & STRT != 0 && self.cr & SER != 0 && self.cr & LOCK == 0 {
                    self.erase(value >> 3 & 0xf, now, core_hz);
                }
            }
            _ => return None,
        }
        Some(())
    }

    fn erase(&mut self, sector: u32, now: u64, core_hz: u64) {
        let (start, kib, ms) = match sector {
            0..=3 => (16 * sector, 16, 250),
            4 => (64, 64, 550),
            _ => (128 * (sector - 4), 128, 1_000),
        };
        self.started = Some(Operation::Erase { start: FLASH_START + 1024 * start, length: 1024 * kib });
        self.busy_until = now + ms * core_hz / 1_000;
        self.sr |= EOP;
    }

    /// Whether a store to flash programs it now; it then takes its time.
    pub(crate) fn program(&mut self, now: u64, core_hz: u64) -> bool {
        let ready = self.cr & (PG | LOCK) == PG && now >= self.busy_until;
        if ready {
            self.busy_until = now + 16 * core_hz / 1_000_000;
        }
        ready
    }

    /// Wait states, and whether the instruction and the data cache are on.
    pub(crate) fn wait_states(&self) -> (u64, bool, bool) {
        (u64::from(self.acr & 7), self.acr & 1 << 9 != 0, self.acr & 1 << 10 != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HZ: u64 = 168_000_000;

    #[test]
    fn a_sector_is_erased_only_after_both_keys() {
        let mut flash = Flash::new();
        flash.write(0x10, STRT | SER | 5 << 3, 0, HZ);
        assert_eq!(flash.started, None);
        flash.write(0x04, 0x4567_0123, 0, HZ);
        flash.write(0x04, 0xcdef_89ab, 0, HZ);
        flash.write(0x10, STRT | SER | 5 << 3, 0, HZ);
        assert_eq!(flash.started, Some(Operation::Erase { start: 0x0802_0000, length: 0x2_0000 }));
        assert_eq!(flash.read(0x0c, HZ - 1), Some(BSY | EOP));
        assert_eq!(flash.read(0x0c, HZ), Some(EOP));
    }

    #[test]
    fn a_store_programs_only_when_unlocked_and_asked_for() {
        let mut flash = Flash::new();
        assert!(!flash.program(0, HZ));
        flash.write(0x04, 0x4567_0123, 0, HZ);
        flash.write(0x04, 0xcdef_89ab, 0, HZ);
        assert!(!flash.program(0, HZ));
        flash.write(0x10, PG | 2 << 8, 0, HZ);
        assert!(flash.program(0, HZ));
        assert!(!flash.program(100, HZ), "busy");
    }
}
