//! What the flight log is on: the file of a card, or a flash chip, whichever the board has on the log's bus.
//!
//! Where there may be either, a card is looked for first: to a flash chip what is said to a card begins with no instruction of its own
//! and ends before it is asked who it is, whereas a card that is not awake takes a flash chip's instructions for the beginning of one.
//!
//! Both are filled from their beginning, and nothing of them is written twice: a card whose file is full wants a new file, a flash chip to be
//! erased (docs/flight-log.md).
use firmware::flight_log::{BLOCK_BYTES, is_log};
use firmware::log_file::{Blocks, Extent, FileError};

use crate::board::{LOG_ON_CARD, LOG_ON_FLASH};
use crate::card::{Card, CardError};
use crate::log_bus::LogBus;
use crate::log_flash::{Failing, LogFlash, SECTOR_BLOCKS};

/// Why no log is kept.
pub(crate) enum Trouble {
    /// There is nothing to keep it on.
    Missing,
    /// The card, or its file.
    Card(FileError<CardError>),
    /// The flash chip.
    Flash(Failing),
    /// Its file has no room left.
    Full,
}

impl Trouble {
    pub(crate) fn text(&self) -> &'static str {
        match self {
            Self::Missing if LOG_ON_CARD => "there is no card",
            Self::Missing => "no log flash answers that is driven",
            Self::Full => "FLIGHT.LOG is full",
            Self::Flash(Failing) => "the log flash fails",
            Self::Card(FileError::NoFile) => "the card has no FLIGHT.LOG",
            Self::Card(FileError::NoFat) => "the card has no FAT32",
            Self::Card(FileError::Card(CardError::Small)) => "the card is of less than 4 GB",
            Self::Card(FileError::Card(CardError::Failing | CardError::Missing)) => "the card fails",
        }
    }
}

impl From<CardError> for Trouble {
    fn from(error: CardError) -> Self {
        Self::Card(error.into())
    }
}

impl From<Failing> for Trouble {
    fn from(failing: Failing) -> Self {
        Self::Flash(failing)
    }
}

/// What it is on.
pub(crate) enum Medium<'a> {
    /// This file of a card.
    Card(Card<'a>, Extent),
    /// A flash chip.
    Flash(LogFlash<'a>),
}

impl<'a> Medium<'a> {
    /// The one that is there, and where the logs on it end, so that the next one may begin.
    pub(crate) async fn find(bus: &'a mut LogBus, empty: &mut bool) -> Result<(Self, u32), Trouble> {
        if LOG_ON_CARD {
            match Card::new(bus).wake(empty).await {
                Ok(()) => {
                    let mut card = Card::new(bus);
                    let file = Extent::find(&mut card).await.map_err(Trouble::Card)?;
                    let end = file.end(&mut card, is_log).await?;
                    card.start(file.first + end).await?;
                    return Ok((Self::Card(card, file), end));
                }
                Err(CardError::Missing) if LOG_ON_FLASH => {}
                Err(CardError::Missing) => return Err(Trouble::Missing),
                Err(error) => return Err(error.into()),
            }
        }
        let mut flash = LogFlash::find(bus).await.ok_or(Trouble::Missing)?;
        let mut first = [0; BLOCK_BYTES];
        flash.read(0, &mut first).await?;
        let all = Extent { first: 0, blocks: flash.blocks };
        // What somebody else has left there is not ours to search.
        let ours = is_log(&first) || !is_written(&first);
        let mut end = if ours { all.end(&mut flash, is_written).await? } else { all.blocks };
        // Power may have failed within an erasure: what is behind the end is blank, or the sector is left as it is.
        let sector_end = end.next_multiple_of(SECTOR_BLOCKS);
        for block in end..sector_end {
            flash.read(block, &mut first).await?;
            if is_written(&first) {
                end = sector_end;
                break;
            }
        }
        Ok((Self::Flash(flash), end))
    }

    /// Its name, for people.
    pub(crate) fn place(&self) -> &'static str {
        match self {
            Self::Card(..) => "FLIGHT.LOG",
            Self::Flash(_) => "the log flash",
        }
    }

    /// Blocks for which it has room.
    pub(crate) fn blocks(&self) -> u32 {
        match self {
            Self::Card(_, file) => file.blocks,
            Self::Flash(flash) => flash.blocks,
        }
    }

    /// Writes a block; of a card, the one after the last.
    pub(crate) async fn write(&mut self, block: u32, bytes: &[u8; BLOCK_BYTES]) -> Result<(), Trouble> {
        match self {
            Self::Card(card, _) => card.write(bytes).await?,
            Self::Flash(flash) => flash.write(block, bytes).await?,
        }
        Ok(())
    }

    /// Checks that a block was kept: a chip may be protected. A card says so itself.
    pub(crate) async fn check(&mut self, block: u32) -> Result<(), Trouble> {
        if let Self::Flash(flash) = self {
            let mut bytes = [0; BLOCK_BYTES];
            flash.read(block, &mut bytes).await?;
            if !is_log(&bytes) {
                return Err(Trouble::Flash(Failing));
            }
        }
        Ok(())
    }

    /// Lets a card keep what it has taken; `next` is the block that follows.
    pub(crate) async fn commit(&mut self, next: u32) -> Result<(), Trouble> {
        if let Self::Card(card, file) = self {
            card.stop().await?;
            card.start(file.first + next).await?;
        }
        Ok(())
    }

    /// There is no room left: a card is let go of, a flash chip can still be read.
    pub(crate) async fn end(&mut self) -> Result<(), Trouble> {
        if let Self::Card(card, _) = self {
            card.stop().await?;
            return Err(Trouble::Full);
        }
        Ok(())
    }
}

/// Whether anything of a flash chip's block was.
fn is_written(bytes: &[u8; BLOCK_BYTES]) -> bool {
    bytes.iter().any(|&byte| byte != u8::MAX)
}
