//! The card: a microSD card on a bus of its own, in SPI mode, read and written by blocks.
//!
//! ```text
//! wake     74 clocks ─► CMD0 ─► CMD8 ─► ACMD41 until it is up ─► CMD58: of high capacity? ─► the fast clock
//! read     CMD17 ─► it finds the block ─► the block
//! write    CMD25 ─► a block, it programs it; a block, it programs it; … ─► stop
//! ```
//!
//! While the card is busy its driver sleeps and looks again. A block is written by DMA (`log_bus.rs`).
//!
//! A reset of the chip alone may find the card within a block: it is given the rest of one and told to stop before it is woken.
//! Blocks are sent without checksums of the bus, which the card does not ask for: those of the log have their own.
//!
//! # Source
//! SD Association, "Physical Layer Simplified Specification" 9.00, chapter 7 "SPI Mode"; 4.6.2: times.
use embassy_futures::yield_now;
use embassy_time::{Duration, Instant, Timer};
use firmware::flight_log::BLOCK_BYTES;
use firmware::log_file::Blocks;

use crate::log_bus::LogBus;

/// Clock of the bus until the card is up, and then; Hz.
const SLOW_HZ: u32 = 400_000;
const FAST_HZ: u32 = 25_000_000;
/// Bytes with the card not selected before it is spoken to: more than 74 clocks.
const WAKE_BYTES: usize = 10;
/// Bytes that end a block which the card is within, some at a time.
const PIECE_BYTES: usize = 16;
const PIECES: usize = BLOCK_BYTES / PIECE_BYTES + 1;
/// Bytes within which a card answers.
const ANSWER_BYTES: usize = 9;
/// Its answer that all is well, and that it is but not up yet.
const READY: u8 = 0;
const IDLE: u8 = 1;
/// Before a block that it sends, and one that it is sent of several; after the last one.
const START: u8 = 0xfe;
const START_OF_MANY: u8 = 0xfc;
const STOP: u8 = 0xfd;
/// What it says of a block, and of one that it takes.
const VERDICT: u8 = 0x1f;
const ACCEPTED: u8 = 0x05;
/// 2.7 to 3.6 V, and a pattern that it must repeat.
const SUPPLY: u32 = 0x1aa;
/// That blocks are counted, not bytes; asked for, and found.
const HIGH_CAPACITY: u32 = 1 << 30;
/// Time within which it must come up.
const UP_MAX: Duration = Duration::from_secs(1);
/// Time within which it must find a block, or program one: twice what cards are allowed.
const BUSY_MAX: Duration = Duration::from_millis(500);
/// Time between two looks at a card that is busy.
const LOOK: Duration = Duration::from_micros(500);

/// There is no card, or one that does not do as it should, or of less than 4 GB.
#[derive(Clone, Copy)]
pub(crate) enum CardError {
    Missing,
    Failing,
    Small,
}

/// A card; its select line stays low once it is awake.
pub(crate) struct Card<'a>(&'a mut LogBus);

impl<'a> Card<'a> {
    /// The one in the slot, if there is one.
    pub(crate) fn new(bus: &'a mut LogBus) -> Self {
        Self(bus)
    }

    /// Brings a card up, whatever it was doing.
    ///
    /// - `empty`: whether the slot was found empty before, and is now.
    pub(crate) async fn wake(&mut self, empty: &mut bool) -> Result<(), CardError> {
        self.0.set_speed(SLOW_HZ);
        self.0.deselect();
        self.0.send(&[0xff; WAKE_BYTES]);
        self.0.select();
        // While the clock is slow others have their turn between any two commands.
        yield_now().await;
        self.ready().await?;
        if self.command(0, 0) != IDLE {
            // One that is put in is in no block.
            if core::mem::replace(empty, true) {
                return Err(CardError::Missing);
            }
            yield_now().await;
            for _ in 0..PIECES {
                self.0.send(&[0xff; PIECE_BYTES]);
                yield_now().await;
            }
            self.stop().await?;
            yield_now().await;
            self.ready().await?;
            if self.command(0, 0) != IDLE {
                return Err(CardError::Missing);
            }
        }
        *empty = false;
        yield_now().await;
        if self.command(8, SUPPLY) != IDLE || self.word() & 0xfff != SUPPLY {
            return Err(CardError::Small);
        }
        let began = Instant::now();
        while self.command(55, 0) > IDLE || self.command(41, HIGH_CAPACITY) != READY {
            if began.elapsed() > UP_MAX {
                return Err(CardError::Failing);
            }
            Timer::after(10 * LOOK).await;
        }
        if self.command(58, 0) != READY || self.word() & HIGH_CAPACITY == 0 {
            return Err(CardError::Small);
        }
        self.0.set_speed(FAST_HZ);
        Ok(())
    }

    /// Begins to write at a block.
    pub(crate) async fn start(&mut self, block: u32) -> Result<(), CardError> {
        self.ready().await?;
        if self.command(25, block) == READY { Ok(()) } else { Err(CardError::Failing) }
    }

    /// Writes the next block.
    pub(crate) async fn write(&mut self, bytes: &[u8; BLOCK_BYTES]) -> Result<(), CardError> {
        self.ready().await?;
        self.0.send(&[0xff, START_OF_MANY]);
        let sent = self.0.stream(bytes).await;
        // A checksum that nobody reads, and the verdict.
        let mut bytes = [0xff; 3];
        self.0.receive(&mut bytes);
        if sent && bytes[2] & VERDICT == ACCEPTED { Ok(()) } else { Err(CardError::Failing) }
    }

    /// Ends writing: the card keeps what it has taken.
    pub(crate) async fn stop(&mut self) -> Result<(), CardError> {
        self.ready().await?;
        self.0.send(&[STOP, 0xff]);
        Ok(())
    }

    /// Says a command; its first answer, with the upper bit set if there was none.
    fn command(&mut self, number: u8, argument: u32) -> u8 {
        let [a, b, c, d] = argument.to_be_bytes();
        // Of the two that it checks.
        let checksum = match number {
            0 => 0x95,
            8 => 0x87,
            _ => 1,
        };
        self.0.send(&[0xff, 0x40 | number, a, b, c, d, checksum]);
        (0..ANSWER_BYTES).map(|_| self.0.byte()).find(|&answer| answer >> 7 == 0).unwrap_or(u8::MAX)
    }

    /// Sleeps until the card is no longer busy.
    async fn ready(&mut self) -> Result<(), CardError> {
        self.until(|answer| answer == 0xff).await
    }

    /// Sleeps until the card says what is waited for.
    async fn until(&mut self, said: impl Fn(u8) -> bool) -> Result<(), CardError> {
        let began = Instant::now();
        while !said(self.0.byte()) {
            if began.elapsed() > BUSY_MAX {
                return Err(CardError::Failing);
            }
            Timer::after(LOOK).await;
        }
        Ok(())
    }

    fn word(&mut self) -> u32 {
        u32::from_be_bytes([self.0.byte(), self.0.byte(), self.0.byte(), self.0.byte()])
    }
}

impl Blocks for Card<'_> {
    type Error = CardError;

    async fn read(&mut self, block: u32, bytes: &mut [u8; BLOCK_BYTES]) -> Result<(), CardError> {
        self.ready().await?;
        if self.command(17, block) != READY {
            return Err(CardError::Failing);
        }
        self.until(|answer| answer == START).await?;
        self.0.receive(bytes);
        // Its checksum.
        self.0.send(&[0xff; 2]);
        Ok(())
    }
}
