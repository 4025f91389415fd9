//! Flash whose words have check bits, the STM32H7's: a word that power has cut short, while it was written or erased, fails its check, and the
//! bus then answers a read with an error, which is a fault. Here such a word reads as zeros, which no seal and no item of [`Stored`](firmware::stored::Stored) is.
//!
//! At the priority of a hard fault, and if it is told so, the core takes no notice of that error; the flash keeps a flag. Never tried on silicon.
//!
//! # Source
//! RM0433, chapter 4, "Embedded Flash memory": DBECCERR; Arm v7-M Architecture Reference Manual, B3.2.8 "Configuration and Control Register":
//! BFHFNMIGN. That such a read faults on an STM32H7, and that this keeps it from faulting, was tried for Zephyr (its issue 33140, pull request 34374).
use core::arch::asm;

use cortex_m::peripheral::SCB;
use embassy_stm32::flash::{Bank2Region, Blocking, Error};
use embassy_stm32::pac;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

/// Bytes that are checked together.
const WORD: usize = 32;
/// The second bank, counted from 0.
const BANK: usize = 1;
/// BFHFNMIGN: at the priority of faults, data that the bus refuses are none.
const IGNORE: u32 = 1 << 8;
/// What the core notes of the bus: cleared by ones.
const BUS_FAULTS: u32 = 0xff00;

/// The second bank.
pub(crate) struct Checked(pub(crate) Bank2Region<'static, Blocking>);

impl ErrorType for Checked {
    type Error = Error;
}

impl ReadNorFlash for Checked {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        let (mut place, mut left) = (offset, bytes);
        while !left.is_empty() {
            let room = WORD - place as usize % WORD;
            let (piece, rest) = left.split_at_mut(room.min(left.len()));
            if !unflinching(|| self.0.read(place, piece))? {
                piece.fill(0);
            }
            place += piece.len() as u32;
            left = rest;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for Checked {
    const WRITE_SIZE: usize = <Bank2Region<'static, Blocking> as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = <Bank2Region<'static, Blocking> as NorFlash>::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        self.0.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        self.0.write(offset, bytes)
    }
}

/// Reads, whatever the bus answers; returns whether what was read is what was written.
fn unflinching(read: impl FnOnce() -> Result<(), Error>) -> Result<bool, Error> {
    let flags = pac::FLASH.bank(BANK);
    flags.ccr().write(|w| w.set_clr_dbeccerr(true));
    // SAFETY: nothing else has the priority of faults, and it is given back at once; the registers are the core's own.
    let result = unsafe {
        let core = &*SCB::PTR;
        asm!("cpsid f");
        core.ccr.modify(|w| w | IGNORE);
        asm!("dsb", "isb");
        let result = read();
        asm!("dsb");
        core.ccr.modify(|w| w & !IGNORE);
        core.cfsr.write(BUS_FAULTS);
        asm!("cpsie f", "isb");
        result
    };
    result.map(|()| !flags.sr().read().dbeccerr())
}
