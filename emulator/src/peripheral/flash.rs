//! FLASH: the registers of the flash memory: wait states and caches, programming and erasing.
//!
//! Programming takes 16 µs a word and erasing a sector 16, 64 or 128 KiB 0.25, 0.55 or 1 s (the data sheet's typical
//! values at 32 bits); bits only ever go from one to zero until their sector is erased. All that time the core stands still:
//! this chip has one bank, and the program is in it. (A loop that the caches hold would run on.)
//!
//! Power may fail at any of these operations, which then is done in part: of the bits that a word was to lose, each is lost by
//! chance; of a sector, each word by chance is as it was, erased, or has gained some of its bits. What then is read is read the
//! same each time; on silicon a bit may be near its threshold, and waver.
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
        /// How much of it power allows.
        extent: Extent,
    },
}

/// How much of an operation is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Extent {
    /// All.
    Whole,
    /// Power fails within it. Of chance.
    Part(u32),
    /// Power has failed before it.
    Nothing,
}

impl Extent {
    /// What a word is afterwards.
    pub(crate) fn of(self, address: u32, before: u32, after: u32) -> u32 {
        match self {
            Self::Whole => after,
            Self::Part(chance) => {
                let mixed = mix(chance ^ address);
                // The bits that change are the ones by chance, for one word in two; else all or none.
                let done = match mixed % 4 {
                    0 if after == u32::MAX => 0,
                    1 if after == u32::MAX => u32::MAX,
                    _ => mix(mixed),
                };
                before & !done | after & done
            }
            Self::Nothing => before,
        }
    }
}

/// Mixes the bits of a number: the finalizer of MurmurHash3.
fn mix(x: u32) -> u32 {
    let x = (x ^ x >> 16).wrapping_mul(0x85eb_ca6b);
    let x = (x ^ x >> 13).wrapping_mul(0xc2b2_ae35);
    x ^ x >> 16
}

/// When power fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cut {
    /// Operations that are still done whole.
    pub(crate) after: u32,
    /// Whether the next one is done in part.
    pub(crate) within: bool,
}

/// The interface's registers.
#[derive(Debug)]
pub(crate) struct Flash {
    acr: u32,
    sr: u32,
    cr: u32,
    keys: u32,
    busy_until: u64,
    /// Words programmed and sectors erased.
    operations: u32,
    /// Power fails, if it is to.
    pub(crate) cut: Option<Cut>,
    /// Power has failed, which ends all this.
    pub(crate) powerless: bool,
    /// What [`Self::write`] has started and nobody has done yet.
    pub(crate) started: Option<Operation>,
}

impl Flash {
    pub(crate) fn new() -> Self {
        Self {
            acr: 0,
            sr: 0,
            cr: LOCK,
            keys: 0,
            busy_until: 0,
            operations: 0,
            cut: None,
            powerless: false,
            started: None,
        }
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
        let extent = self.operate();
        self.started = Some(Operation::Erase { start: FLASH_START + 1024 * start, length: 1024 * kib, extent });
        self.busy_until = now + ms * core_hz / 1_000;
        self.sr |= EOP;
    }

    /// How much of a store to flash programs it now, if it does; it then takes its time.
    pub(crate) fn program(&mut self, now: u64, core_hz: u64) -> Option<Extent> {
        if self.cr & (PG | LOCK) != PG || now < self.busy_until {
            return None;
        }
        self.busy_until = now + 16 * core_hz / 1_000_000;
        Some(self.operate())
    }

    /// One operation: how much of it is done.
    fn operate(&mut self) -> Extent {
        self.operations += 1;
        if self.powerless {
            return Extent::Nothing;
        }
        match &mut self.cut {
            None => Extent::Whole,
            Some(Cut { after: 0, within }) => {
                self.powerless = true;
                if *within { Extent::Part(self.operations) } else { Extent::Nothing }
            }
            Some(cut) => {
                cut.after -= 1;
                Extent::Whole
            }
        }
    }

    /// How long the core must wait for the flash, cycles.
    pub(crate) fn stall(&self, now: u64) -> u64 {
        self.busy_until.saturating_sub(now)
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
        let extent = Extent::Whole;
        assert_eq!(flash.started, Some(Operation::Erase { start: 0x0802_0000, length: 0x2_0000, extent }));
        assert_eq!(flash.read(0x0c, HZ - 1), Some(BSY | EOP));
        assert_eq!(flash.read(0x0c, HZ), Some(EOP));
    }

    #[test]
    fn a_store_programs_only_when_unlocked_and_asked_for() {
        let mut flash = Flash::new();
        assert_eq!(flash.program(0, HZ), None);
        flash.write(0x04, 0x4567_0123, 0, HZ);
        flash.write(0x04, 0xcdef_89ab, 0, HZ);
        assert_eq!(flash.program(0, HZ), None);
        flash.write(0x10, PG | 2 << 8, 0, HZ);
        assert_eq!(flash.program(0, HZ), Some(Extent::Whole));
        assert_eq!(flash.program(100, HZ), None, "busy");
    }

    #[test]
    fn power_fails_at_the_operation_it_was_to_fail_at_and_nothing_follows() {
        let mut flash = Flash::new();
        (flash.cr, flash.cut) = (PG, Some(Cut { after: 2, within: true }));
        let done: Vec<_> = (0..4).map(|n| flash.program(n * HZ, HZ).expect("it is ready")).collect();
        assert_eq!(done, [Extent::Whole, Extent::Whole, Extent::Part(3), Extent::Nothing]);
        assert!(flash.powerless);
    }

    #[test]
    fn a_word_done_in_part_has_only_bits_that_it_had_or_was_to_have() {
        let mut kinds = [0; 3];
        for address in (0..4_096).step_by(4) {
            let erased = Extent::Part(7).of(address, 0x1234_5678, u32::MAX);
            assert_eq!(erased & 0x1234_5678, 0x1234_5678);
            kinds[match erased {
                0x1234_5678 => 0,
                u32::MAX => 1,
                _ => 2,
            }] += 1;
            let programmed = Extent::Part(7).of(address, u32::MAX, 0x1234_5678);
            assert_eq!(programmed & 0x1234_5678, 0x1234_5678);
        }
        assert!(kinds.iter().all(|&words| words > 200), "{kinds:?}");
    }
}
