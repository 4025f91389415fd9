//! The log flash: a NOR flash chip on a bus of its own, a W25Q128 or another that speaks as it does, of up to 16 MiB.
//!
//! ```text
//! find     status: nobody? busy since before a reset? ─► identity ─► how large it is
//! write    enable ─► a page of 256 bytes ─► it programs it, some 0.4 to 3 ms; twice for a block of the log
//! erase    enable ─► 64 KiB ─► it erases them, 0.15 to 2 s
//! ```
//!
//! Programming only clears bits, so what is written was erased before; that takes too long for a flight. While the chip is busy its driver
//! sleeps and looks again, up to a time. (The crate `w25` 0.8, which drives it too, looks again without sleeping and without an end.)
//!
//! # Source
//! Winbond, "W25Q128JV" revision M, chapters 8.1 "Device ID and Instruction Set Tables", 8.2 "Instruction Descriptions", 9.6 "AC Electrical
//! Characteristics".
use embassy_time::{Duration, Instant, Timer};
use firmware::flight_log::BLOCK_BYTES;
use firmware::log_file::Blocks;

use crate::log_bus::LogBus;

/// Clock of the bus, Hz; the instruction that reads takes up to 50 MHz.
const HZ: u32 = 25_000_000;
/// Instructions.
const STATUS: u8 = 0x05;
const IDENTITY: u8 = 0x9f;
const ENABLE: u8 = 0x06;
const READ: u8 = 0x03;
const PROGRAM: u8 = 0x02;
const ERASE: u8 = 0xd8;
/// Bit of the status.
const BUSY: u8 = 1;
/// Bytes that are programmed at once, and those that are erased.
const PAGE_BYTES: usize = 256;
const SECTOR_BYTES: u32 = 64 * 1024;
/// Blocks of the log in what is erased at once.
pub(crate) const SECTOR_BLOCKS: u32 = SECTOR_BYTES / BLOCK_BYTES as u32;
/// Sizes that are driven, powers of two of bytes: one such part, and as much as three bytes of address reach.
const SIZES: core::ops::RangeInclusive<u8> = 16..=24;
/// Time within which it must do anything: erasing may take 2 s.
const BUSY_MAX: Duration = Duration::from_secs(3);
/// Time between two looks at a chip that is busy.
const LOOK: Duration = Duration::from_micros(250);

/// It does not do as it should.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Failing;

/// The chip.
pub(crate) struct LogFlash<'a> {
    bus: &'a mut LogBus,
    /// Blocks of the log for which it has room.
    pub(crate) blocks: u32,
}

impl<'a> LogFlash<'a> {
    /// The chip that is on the bus, if there is one.
    pub(crate) async fn find(bus: &'a mut LogBus) -> Option<Self> {
        bus.set_speed(HZ);
        bus.deselect();
        let mut flash = Self { bus, blocks: 0 };
        // The chip alone may have been reset, within what it was told.
        if flash.status() == u8::MAX || flash.ready().await.is_err() {
            return None;
        }
        let mut identity = [0; 3];
        flash.ask(&[IDENTITY], &mut identity);
        let [_, _, size] = identity;
        flash.blocks = (1 << size.min(*SIZES.end())) / BLOCK_BYTES as u32;
        SIZES.contains(&size).then_some(flash)
    }

    /// Writes a block that was erased.
    pub(crate) async fn write(&mut self, block: u32, bytes: &[u8; BLOCK_BYTES]) -> Result<(), Failing> {
        for (place, page) in (0..).zip(bytes.as_chunks::<PAGE_BYTES>().0) {
            self.enable().await?;
            self.bus.select();
            self.bus.send(&instruction(PROGRAM, block * BLOCK_BYTES as u32 + place * PAGE_BYTES as u32));
            let sent = self.bus.stream(page).await;
            self.bus.deselect();
            if !sent {
                return Err(Failing);
            }
        }
        Ok(())
    }

    /// Erases what a block is in, with [`SECTOR_BLOCKS`].
    pub(crate) async fn erase(&mut self, block: u32) -> Result<(), Failing> {
        self.enable().await?;
        self.ask(&instruction(ERASE, block * BLOCK_BYTES as u32), &mut []);
        self.ready().await
    }

    /// Lets it be written to, once.
    async fn enable(&mut self) -> Result<(), Failing> {
        self.ready().await?;
        self.ask(&[ENABLE], &mut []);
        Ok(())
    }

    /// Sleeps until it is no longer busy.
    async fn ready(&mut self) -> Result<(), Failing> {
        let began = Instant::now();
        while self.status() & BUSY != 0 {
            if began.elapsed() > BUSY_MAX {
                return Err(Failing);
            }
            Timer::after(LOOK).await;
        }
        Ok(())
    }

    fn status(&mut self) -> u8 {
        let mut status = [0];
        self.ask(&[STATUS], &mut status);
        status[0]
    }

    fn ask(&mut self, question: &[u8], answer: &mut [u8]) {
        self.bus.select();
        self.bus.send(question);
        self.bus.receive(answer);
        self.bus.deselect();
    }
}

impl Blocks for LogFlash<'_> {
    type Error = Failing;

    async fn read(&mut self, block: u32, bytes: &mut [u8; BLOCK_BYTES]) -> Result<(), Failing> {
        self.ready().await?;
        self.ask(&instruction(READ, block * BLOCK_BYTES as u32), bytes);
        Ok(())
    }
}

/// An instruction at an address.
fn instruction(instruction: u8, address: u32) -> [u8; 4] {
    let [_, a, b, c] = address.to_be_bytes();
    [instruction, a, b, c]
}
