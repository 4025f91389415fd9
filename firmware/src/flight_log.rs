//! Flight log: what every step since boot was given and what it decided, in blocks that a card takes whole.
//!
//! ```text
//! file      preamble blocks, then step blocks, each of 512 bytes
//! block     "QF" │ version u8 │ kind u8 │ number u32 │ bytes used u16 │ 500 bytes │ CRC-16
//! preamble  name, value; name, value; …        what flew: image, board, parameters (preamble.rs)
//! steps     step; step; …                      a record's words, those that can be foreseen left out (steps.rs)
//! ```
//!
//! All numbers are little-endian. A block is understood without the ones before it. Blocks count up from 0 in a file, steps from 1
//! at boot: where either jumps, something is missing. A step is a [`Record`](crate::record::Record), so the log holds whatever
//! that holds, to the bit: who repeats the steps from the first one on must decide the same.
//!
//! Invariant: writing never fails and never panics; reading takes any bytes.

mod preamble;
mod steps;

pub use preamble::{Fact, Facts, FactsError, MEMORY, Preamble, Resumed};
pub use steps::{COUNT_M_S2, COUNT_RAD_S, Packer, StepError, Steps};

/// Bytes of a block: a card's sector.
pub const BLOCK_BYTES: usize = 512;
/// Version of the format. Raise it when a byte changes its meaning.
pub const VERSION: u8 = 2;
const MAGIC: [u8; 2] = *b"QF";
/// Bytes before the content, and of the checksum after it.
const HEAD: usize = 10;
const CHECKSUM: usize = 2;
/// Bytes of content.
pub const ROOM: usize = BLOCK_BYTES - HEAD - CHECKSUM;

/// What a block is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// What flew.
    Preamble = 0,
    /// Steps.
    Steps = 1,
}

/// Why bytes are no block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockError {
    /// It does not begin as a block does.
    Foreign,
    /// It has another version of the format.
    Version(u8),
    /// Its checksum is wrong: it was torn, or damaged.
    Checksum,
    /// It is of no known kind, or longer than itself.
    Garbled,
}

/// A block that is being filled.
#[derive(Clone, Debug)]
pub struct Block {
    bytes: [u8; BLOCK_BYTES],
    used: usize,
}

impl Block {
    /// An empty one.
    pub fn new(kind: Kind) -> Self {
        let mut bytes = [0; BLOCK_BYTES];
        [bytes[0], bytes[1]] = MAGIC;
        [bytes[2], bytes[3]] = [VERSION, kind as u8];
        Self { bytes, used: 0 }
    }

    /// Appends `content` whole; false if there is no room for it, and nothing changes then.
    pub fn put(&mut self, content: &[u8]) -> bool {
        let start = HEAD + self.used;
        let end = start + content.len();
        let Some(place) = self.bytes.get_mut(start..end).filter(|_| end <= HEAD + ROOM) else { return false };
        place.copy_from_slice(content);
        self.used += content.len();
        true
    }

    /// Whether nothing is in it.
    pub fn is_empty(&self) -> bool {
        self.used == 0
    }

    /// Empties it. What was in it stays beyond what is used.
    pub fn clear(&mut self) {
        self.used = 0;
    }

    /// The block as it is stored, the `number`-th of its file.
    pub fn sealed(&self, number: u32) -> [u8; BLOCK_BYTES] {
        let mut bytes = self.bytes;
        bytes[4..8].copy_from_slice(&number.to_le_bytes());
        bytes[8..HEAD].copy_from_slice(&(self.used as u16).to_le_bytes());
        let checksum = flight_link::checksum(&bytes[..HEAD + ROOM]);
        bytes[HEAD + ROOM..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }
}

/// A block that was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opened<'a> {
    /// What it is about.
    pub kind: Kind,
    /// Its place in the file.
    pub number: u32,
    /// What is in it.
    pub content: &'a [u8],
}

/// Reads a block.
///
/// # Errors
/// [`BlockError`] if these bytes are none.
pub fn open(bytes: &[u8; BLOCK_BYTES]) -> Result<Opened<'_>, BlockError> {
    let [m0, m1, version, kind, n0, n1, n2, n3, u0, u1, ..] = *bytes;
    if [m0, m1] != MAGIC {
        return Err(BlockError::Foreign);
    }
    if version != VERSION {
        return Err(BlockError::Version(version));
    }
    let (checked, checksum) = bytes.split_at(HEAD + ROOM);
    if flight_link::checksum(checked).to_le_bytes() != checksum {
        return Err(BlockError::Checksum);
    }
    let kind = match kind {
        0 => Kind::Preamble,
        1 => Kind::Steps,
        _ => return Err(BlockError::Garbled),
    };
    let used = usize::from(u16::from_le_bytes([u0, u1]));
    let content = checked[HEAD..].get(..used).ok_or(BlockError::Garbled)?;
    Ok(Opened { kind, number: u32::from_le_bytes([n0, n1, n2, n3]), content })
}

/// Whether these bytes begin as a block does, torn or of another version as it may be.
pub fn is_log(bytes: &[u8; BLOCK_BYTES]) -> bool {
    bytes.starts_with(&MAGIC)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_read_as_it_was_filled() {
        let mut block = Block::new(Kind::Steps);
        assert!(block.is_empty());
        assert!(block.put(b"abc") && block.put(&[7; ROOM - 3]));
        assert!(!block.put(&[1]), "it is full");
        let bytes = block.sealed(0x0102_0304);
        let opened = open(&bytes).unwrap();
        assert_eq!((opened.kind, opened.number, opened.content.len()), (Kind::Steps, 0x0102_0304, ROOM));
        assert_eq!(&opened.content[..4], b"abc\x07");
    }

    #[test]
    fn a_block_with_a_wrong_bit_is_none() {
        let mut block = Block::new(Kind::Preamble);
        block.put(b"what flew");
        let good = block.sealed(3);
        for bit in 0..8 * BLOCK_BYTES {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(open(&bad).is_err(), "bit {bit}");
        }
        assert_eq!(open(&[0; BLOCK_BYTES]), Err(BlockError::Foreign));
        let mut newer = good;
        newer[2] = 9;
        assert_eq!(open(&newer), Err(BlockError::Version(9)));
    }
}
