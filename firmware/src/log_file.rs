//! The log's file: where on a card it lies, and where in it the last log ends.
//!
//! ```text
//! block 0: partitions ─► the first one's head ─► root folder: FLIGHT.LOG ─► its clusters, as far as they follow each other
//! ```
//!
//! The file was made before, by `sim-host card`, full of zeros: the image only fills it, start after start, and so writes to no other
//! part of the card, whatever power does meanwhile. Only FAT32 is known: all cards of 4 to 32 GB are sold with it.
//!
//! Invariants: nothing outside of the file is ever named, as the card's tables have it; any bytes are taken.
//!
//! # Source
//! Microsoft, "FAT: General Overview of On-Disk Format" 1.03, "Boot Sector and BPB", "FAT Data Structure", "FAT Directory Structure".
use crate::flight_log::BLOCK_BYTES;

/// The file's name, without the point.
const NAME: &[u8; 11] = b"FLIGHT  LOG";
/// Kinds of a partition with FAT32.
const FAT32: [u8; 2] = [0x0b, 0x0c];
/// Bits of an entry's kind: a volume's name, a folder.
const NO_FILE: u8 = 0x08 | 0x10;
const ENTRY_BYTES: usize = 32;
/// Clusters that a block of the table tells of, and the bits of each that count.
const LINKS: u32 = (BLOCK_BYTES / 4) as u32;
const LINK: u32 = 0x0fff_ffff;
/// Longest root folder, blocks: 65,536 entries.
const FOLDER_BLOCKS_MAX: u32 = 4_096;

/// What reads blocks.
#[expect(async_fn_in_trait, reason = "the one task that calls it does not move")]
pub trait Blocks {
    /// Why one was not read.
    type Error;

    /// Reads a block.
    ///
    /// # Errors
    /// If the card fails.
    async fn read(&mut self, block: u32, bytes: &mut [u8; BLOCK_BYTES]) -> Result<(), Self::Error>;
}

/// Why there is no file to be filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileError<E> {
    /// The card fails.
    Card(E),
    /// Its first partition has no FAT32.
    NoFat,
    /// There is no such file, or it is shorter than a block.
    NoFile,
}

impl<E> From<E> for FileError<E> {
    fn from(error: E) -> Self {
        Self::Card(error)
    }
}

/// Blocks that follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The first one.
    pub first: u32,
    /// How many.
    pub blocks: u32,
}

impl Extent {
    /// Finds the file; of one in pieces, the first.
    ///
    /// # Errors
    /// [`FileError`] if there is none.
    pub async fn find<B: Blocks>(card: &mut B) -> Result<Self, FileError<B::Error>> {
        let mut bytes = [0; BLOCK_BYTES];
        card.read(0, &mut bytes).await?;
        let start = long(&bytes, 454);
        if !signed(&bytes) || !FAT32.contains(&bytes[450]) {
            return Err(FileError::NoFat);
        }
        card.read(start, &mut bytes).await?;
        let volume = Volume::read(start, &bytes).ok_or(FileError::NoFat)?;
        let mut cluster = long(&bytes, 44) & LINK;
        let mut left = FOLDER_BLOCKS_MAX;
        while volume.has(cluster, 1) && left > 0 {
            for block in 0..volume.cluster_blocks {
                card.read(volume.block(cluster) + block, &mut bytes).await?;
                left = left.saturating_sub(1);
                let entries = bytes.as_chunks::<ENTRY_BYTES>().0;
                if let Some(entry) = entries.iter().find(|entry| entry.starts_with(NAME)).copied() {
                    return volume.extent(card, &entry, &mut bytes).await;
                }
            }
            card.read(volume.table + cluster / LINKS, &mut bytes).await?;
            cluster = link(&bytes, cluster);
        }
        Err(FileError::NoFile)
    }

    /// Where in it the logs end, which fill it from its beginning: blocks from there.
    ///
    /// - `written`: whether a block is.
    ///
    /// # Errors
    /// If it cannot be read.
    pub async fn end<B: Blocks>(
        self,
        medium: &mut B,
        written: fn(&[u8; BLOCK_BYTES]) -> bool,
    ) -> Result<u32, B::Error> {
        let mut bytes = [0; BLOCK_BYTES];
        let (mut low, mut high) = (0, self.blocks);
        while low < high {
            let middle = low + (high - low) / 2;
            medium.read(self.first + middle, &mut bytes).await?;
            if written(&bytes) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        Ok(low)
    }
}

/// A partition's plan.
struct Volume {
    /// First block of the table.
    table: u32,
    /// First block of cluster 2, which is the first.
    data: u32,
    cluster_blocks: u32,
    clusters: u32,
}

impl Volume {
    /// Of a partition that begins at block `start` with these bytes, if it has a plan.
    fn read(start: u32, bytes: &[u8; BLOCK_BYTES]) -> Option<Self> {
        let (cluster_blocks, reserved) = (u32::from(bytes[13]), u32::from(short(bytes, 14)));
        let tables = u32::from(bytes[16]).checked_mul(long(bytes, 36))?;
        let before_data = reserved.checked_add(tables)?;
        let clusters = long(bytes, 32).checked_sub(before_data)?.checked_div(cluster_blocks)?;
        // So that no block of it is beyond what 32 bits count.
        start.checked_add(long(bytes, 32))?;
        let told = long(bytes, 36).saturating_mul(LINKS).saturating_sub(2);
        let known = signed(bytes) && usize::from(short(bytes, 11)) == BLOCK_BYTES && clusters <= told;
        known.then_some(Self { table: start + reserved, data: start + before_data, cluster_blocks, clusters })
    }

    /// Whether there are so many clusters from this one on.
    fn has(&self, cluster: u32, count: u32) -> bool {
        cluster >= 2 && count <= self.clusters && cluster - 2 <= self.clusters - count
    }

    /// First block of a cluster that it has.
    fn block(&self, cluster: u32) -> u32 {
        self.data + (cluster - 2) * self.cluster_blocks
    }

    /// Where a file lies, as far as its clusters follow each other.
    async fn extent<B: Blocks>(
        &self,
        card: &mut B,
        entry: &[u8; ENTRY_BYTES],
        bytes: &mut [u8; BLOCK_BYTES],
    ) -> Result<Extent, FileError<B::Error>> {
        let first = (u32::from(short(entry, 20)) << 16 | u32::from(short(entry, 26))) & LINK;
        let blocks = long(entry, 28) / BLOCK_BYTES as u32;
        let clusters = blocks.div_ceil(self.cluster_blocks);
        if entry[11] & NO_FILE != 0 || blocks == 0 || !self.has(first, clusters) {
            return Err(FileError::NoFile);
        }
        let mut last = first;
        card.read(self.table + last / LINKS, bytes).await?;
        while last - first + 1 < clusters && link(bytes, last) == last + 1 {
            last += 1;
            if last.is_multiple_of(LINKS) {
                card.read(self.table + last / LINKS, bytes).await?;
            }
        }
        let blocks = blocks.min((last - first + 1) * self.cluster_blocks);
        Ok(Extent { first: self.block(first), blocks })
    }
}

/// Whether a block ends as the first one of a card and of a partition do.
fn signed(bytes: &[u8; BLOCK_BYTES]) -> bool {
    bytes.ends_with(&[0x55, 0xaa])
}

/// The cluster that follows one, by the block of the table that tells of it.
fn link(bytes: &[u8; BLOCK_BYTES], cluster: u32) -> u32 {
    long(bytes, 4 * (cluster % LINKS) as usize) & LINK
}

fn short(bytes: &[u8], at: usize) -> u16 {
    bytes.get(at..at + 2).map_or(0, |bytes| u16::from_le_bytes([bytes[0], bytes[1]]))
}

fn long(bytes: &[u8], at: usize) -> u32 {
    u32::from(short(bytes, at + 2)) << 16 | u32::from(short(bytes, at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight_log::{Block, Kind, is_log};
    use core::convert::Infallible;
    use embassy_futures::block_on;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// A card with a partition of one table, clusters of two blocks, and a root folder in clusters 2 and 5.
    struct Card(Vec<[u8; BLOCK_BYTES]>);

    const START: usize = 3;
    const TABLE: usize = START + 4;
    const DATA: usize = TABLE + 2;
    const CLUSTERS: usize = 200;

    impl Blocks for Card {
        type Error = Infallible;

        async fn read(&mut self, block: u32, bytes: &mut [u8; BLOCK_BYTES]) -> Result<(), Infallible> {
            *bytes = self.0.get(block as usize).copied().unwrap_or([0xa5; BLOCK_BYTES]);
            Ok(())
        }
    }

    impl Card {
        /// - `links`: which cluster follows which, beyond the root folder's.
        /// - `files`: name, kind, first cluster, bytes.
        fn new(links: &[(usize, u32)], files: &[(&[u8; 11], u8, u32, u32)]) -> Self {
            let mut card = Self(vec![[0; BLOCK_BYTES]; DATA + 2 * CLUSTERS]);
            card.put(0, 450, &[0x0c]);
            card.put(0, 454, &(START as u32).to_le_bytes());
            card.put(START, 11, &512_u16.to_le_bytes());
            card.put(START, 13, &[2, 4, 0, 1]);
            card.put(START, 32, &((6 + 2 * CLUSTERS) as u32).to_le_bytes());
            card.put(START, 36, &2_u32.to_le_bytes());
            card.put(START, 44, &2_u32.to_le_bytes());
            for block in [0, START] {
                card.put(block, 510, &[0x55, 0xaa]);
            }
            for (cluster, next) in [(2, 5), (5, LINK)].iter().chain(links) {
                card.put(TABLE + cluster / 128, 4 * (cluster % 128), &next.to_le_bytes());
            }
            // In the last block of the folder; those before it are of files that are gone.
            for block in [0, 1, 6] {
                (0..16).for_each(|place| card.put(DATA + block, 32 * place, &[0xe5]));
            }
            for (place, (name, kind, first, bytes)) in files.iter().enumerate() {
                let at = 32 * place;
                card.put(DATA + 7, at, *name);
                card.put(DATA + 7, at + 11, &[*kind]);
                card.put(DATA + 7, at + 20, &first.to_le_bytes()[2..]);
                card.put(DATA + 7, at + 26, &first.to_le_bytes()[..2]);
                card.put(DATA + 7, at + 28, &bytes.to_le_bytes());
            }
            card
        }

        fn put(&mut self, block: usize, at: usize, bytes: &[u8]) {
            self.0[block][at..at + bytes.len()].copy_from_slice(bytes);
        }

        fn find(&mut self) -> Result<Extent, FileError<Infallible>> {
            block_on(Extent::find(self))
        }
    }

    /// Links of a file whose clusters follow each other.
    fn row(first: u32, last: u32) -> Vec<(usize, u32)> {
        (first..last).map(|cluster| (cluster as usize, cluster + 1)).chain([(last as usize, LINK)]).collect()
    }

    #[test]
    fn a_file_is_found_with_all_its_blocks_and_no_more() {
        let other = (b"README  TXT", 0x20, 3, 700);
        // Over two blocks of the table; the last cluster is not full.
        let mut card = Card::new(&row(100, 150), &[other, (NAME, 0x20, 100, 51 * 1_024 - 600)]);
        let first = (DATA + 2 * 98) as u32;
        assert_eq!(card.find(), Ok(Extent { first, blocks: 100 }));
        // In pieces: the first one.
        card.put(TABLE + 1, 4 * 2, &180_u32.to_le_bytes());
        assert_eq!(card.find(), Ok(Extent { first, blocks: 62 }));
    }

    #[test]
    fn a_card_without_such_a_file_is_refused_and_told_why() {
        let good = (NAME, 0x20, 10, 4_096);
        let links = row(10, 13);
        assert_eq!(Card::new(&links, &[good]).find(), Ok(Extent { first: (DATA + 16) as u32, blocks: 8 }));
        for (why, file) in [
            ("another name", (b"FLIGHT  TXT", 0x20, 10, 4_096)),
            ("a folder", (NAME, 0x10, 10, 0)),
            ("nothing in it", (NAME, 0x20, 0, 0)),
            ("less than a block", (NAME, 0x20, 10, 511)),
            ("no cluster", (NAME, 0x20, 1, 4_096)),
            ("beyond the card", (NAME, 0x20, 199, 4_096)),
            ("longer than the card", (NAME, 0x20, 10, u32::MAX)),
        ] {
            assert_eq!(Card::new(&links, &[file]).find(), Err(FileError::NoFile), "{why}");
        }
        for (why, block, at, bytes) in [
            ("no partitions", 0, 510, &[0, 0][..]),
            ("another kind of partition", 0, 450, &[0x07]),
            ("a partition that is not there", 0, 456, &[1]),
            ("a partition without a plan", START, 510, &[0, 0]),
            ("blocks of another size", START, 11, &[0, 16]),
            ("clusters of no blocks", START, 13, &[0]),
            ("tables longer than all", START, 36, &[0xff; 4]),
            ("tables for fewer clusters", START, 36, &[1]),
        ] {
            let mut card = Card::new(&links, &[good]);
            card.put(block, at, bytes);
            assert_eq!(card.find(), Err(FileError::NoFat), "{why}");
        }
        let mut card = Card::new(&links, &[]);
        card.put(TABLE, 4 * 5, &2_u32.to_le_bytes());
        assert_eq!(card.find(), Err(FileError::NoFile), "a folder that never ends");
    }

    #[test]
    fn the_next_log_begins_where_the_last_one_ends() {
        let mut card = Card::new(&row(10, 59), &[(NAME, 0x20, 10, 100 * 512)]);
        let extent = card.find().unwrap();
        for written in 0..=100 {
            assert_eq!(block_on(extent.end(&mut card, is_log)), Ok(written));
            if written < 100 {
                card.0[(extent.first + written) as usize] = Block::new(Kind::Steps).sealed(written);
            }
        }
    }

    proptest! {
        #[test]
        fn whatever_is_on_a_card_no_block_outside_of_its_partition_is_named(
            bytes in proptest::collection::vec((0..DATA + 10, 0..BLOCK_BYTES, any::<u8>()), 0..40)
        ) {
            let mut card = Card::new(&row(10, 59), &[(NAME, 0x20, 10, 100 * 512)]);
            for (block, at, byte) in bytes {
                card.put(block, at, &[byte]);
            }
            let start = long(&card.0[0], 454);
            if let Ok(Extent { first, blocks }) = card.find() {
                let end = start + long(&card.0[start as usize], 32);
                prop_assert!(blocks > 0 && first > start && end - first >= blocks, "{} and {} of {}", first, blocks, end);
            }
        }
    }
}
