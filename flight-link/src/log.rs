//! The flight log over a line, where no card can be pulled out.
//!
//! ```text
//! Size ─► how much is written      Read ─► its parts, in order, as the line has room      Erase ─► Size, sector by sector, to 0
//! ```
//!
//! What is written is a row of blocks of 512 bytes, log after log, as docs/flight-log.md has it. A part that does not come is asked for again.
use serde::{Deserialize, Serialize};

/// Bytes of a part: a quarter of a block.
pub const PART_BYTES: usize = 128;

/// What is wished of the log, on the ground, disarmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LogWish {
    /// Say how much there is.
    Size,
    /// Say so many blocks from this one on; another wish of this kind ends it.
    Read(u32, u16),
    /// Erase all of it; the log that is being written begins anew, without what came before.
    Erase,
}

/// How much there is, in blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogSize {
    /// Written.
    pub used: u32,
    /// Written and not.
    pub room: u32,
    /// Where the log begins that is being written; `used` if none is.
    pub running: u32,
}

/// A part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogPart {
    /// Which, counted from the beginning of the first block.
    pub number: u32,
    /// Its bytes. (In rows, for serde knows no longer ones.)
    pub bytes: [[u8; 32]; PART_BYTES / 32],
}

/// Why a wish is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LogRefusal {
    /// It is armed, or a rotor turns.
    Armed,
    /// There is no log that can be read over a line, or its flash chip fails.
    Absent,
}
