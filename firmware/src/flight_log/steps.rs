//! Steps: the words of a record, without those that can be foreseen.
//!
//! ```text
//! step      lead u16 │ µs since the last u16, if it follows │ inertial counts 6 × i16, if there is a sample
//!           │ for each group of eight words with an unforeseen one: which u8 │ those words u32
//! lead      bits 0 to 13: groups with an unforeseen word; 14: counts; 15: it follows
//! ```
//!
//! Foreseen is 0; for a step that follows the last one in its block, the same first word, a step number one higher, the
//! time that is given, and the same rotors' speeds; and what the counts say. A sample is the mean of four records, so its count is a quarter of
//! the part's; a value is its count times that, as the driver computes it. Where this does not give its bits, the value follows as a word.
//!
//! Invariant: what is read has the bits of what was written, whatever they are.
use super::{Block, Kind, ROOM};
use crate::icm42688::{FORCE_M_S2, RATE_RAD_S, RECORDS};
use crate::record::{HAS_IMU, Record, SLOW, WORDS};

const FOLLOWS: u16 = 1 << 15;
const COUNTED: u16 = 1 << 14;
/// Words of a group, and how many groups there are.
const GROUP: usize = 8;
const GROUPS: usize = WORDS.div_ceil(GROUP);
/// Longest step.
const STEP_BYTES: usize = 2 + 2 + 12 + GROUPS + 4 * WORDS;
const _: () = assert!(GROUPS <= 14 && STEP_BYTES <= ROOM);
/// The words with the rotors' speeds and their age.
const ROTORS: core::ops::Range<usize> = 54..59;
/// The groups that are foreseen to be 0, and mostly are.
const SLOW_GROUPS: core::ops::Range<usize> = 2..ROTORS.start / GROUP;
/// The words with the inertial sample: rates, specific force.
const INERTIAL: core::ops::Range<usize> = 4..10;

type Words = [u32; WORDS];

/// What is foreseen of a step.
#[derive(Clone, Debug)]
struct Foreseen {
    /// Between two steps, of the last one: which parts are there, number, time, the rotors' speeds and their age. The others are 0, but for
    /// the inertial sample, which is written anew for each.
    words: Words,
    /// Whether there was a last one.
    follows: bool,
}

impl Foreseen {
    fn nothing() -> Self {
        Self { words: [0; WORDS], follows: false }
    }

    /// Time from the last step to the one after it, µs, if this is that and the time is no longer than two bytes.
    fn elapsed_us(&self, words: &Words) -> Option<u16> {
        let follows = self.follows && words[1] == self.words[1].wrapping_add(1);
        time_us(words).checked_sub(time_us(&self.words)).filter(|_| follows)?.try_into().ok()
    }

    /// Goes on to the next step.
    ///
    /// - `elapsed_us`: if it follows.
    /// - `counts`: if it has a sample.
    fn advance(&mut self, elapsed_us: Option<u16>, counts: Option<[i16; 6]>) {
        if let Some(elapsed_us) = elapsed_us {
            let time_us = time_us(&self.words).wrapping_add(elapsed_us.into());
            self.words[1] = self.words[1].wrapping_add(1);
            [self.words[2], self.words[3]] = [time_us as u32, (time_us >> 32) as u32];
        } else {
            self.words[..INERTIAL.start].fill(0);
            self.words[ROTORS].fill(0);
        }
        self.words[INERTIAL].copy_from_slice(&counts.map_or([0; 6], values));
    }

    /// Takes in what the step was.
    fn learn(&mut self, words: &Words) {
        self.words[..INERTIAL.start].copy_from_slice(&words[..INERTIAL.start]);
        self.words[ROTORS].copy_from_slice(&words[ROTORS]);
        self.follows = true;
    }
}

fn time_us(words: &Words) -> u64 {
    u64::from(words[3]) << 32 | u64::from(words[2])
}

/// Puts steps into blocks.
#[derive(Debug)]
pub struct Packer {
    block: Block,
    foreseen: Foreseen,
    /// Of the last step.
    bytes: [u8; STEP_BYTES],
}

impl Packer {
    /// A packer of no steps.
    pub fn new() -> Self {
        Self { block: Block::new(Kind::Steps), foreseen: Foreseen::nothing(), bytes: [0; STEP_BYTES] }
    }

    /// Appends a step, the words of its [`Record`].
    ///
    /// - `full`: takes the block before it, if that has become full.
    pub fn note(&mut self, words: &Words, full: impl FnOnce(&Block)) {
        if !self.block.put(write(words, &mut self.foreseen, &mut self.bytes)) {
            full(&self.block);
            self.block.clear();
            self.foreseen.follows = false;
            // There is room for the longest.
            self.block.put(write(words, &mut self.foreseen, &mut self.bytes));
        }
    }

    /// The block that is not full yet.
    pub fn finish(self) -> Block {
        self.block
    }
}

impl Default for Packer {
    fn default() -> Self {
        Self::new()
    }
}

/// A step that is being written, and how many bytes of it are.
struct Writing<'a> {
    bytes: &'a mut [u8; STEP_BYTES],
    used: usize,
}

impl Writing<'_> {
    /// Appends those words of a group that were not foreseen, if there is one.
    fn put_group(&mut self, words: &[u32], foreseen: &[u32]) -> bool {
        let start = self.used;
        let mut which = 0_u8;
        self.put([0]);
        for (n, (word, seen)) in words.iter().zip(foreseen).enumerate() {
            if word != seen {
                which |= 1 << n;
                self.put(word.to_le_bytes());
            }
        }
        if which == 0 {
            self.used = start;
        } else if let Some(byte) = self.bytes.get_mut(start) {
            *byte = which;
        }
        which != 0
    }

    /// There is room for the longest step.
    #[inline(always)]
    fn put<const N: usize>(&mut self, content: [u8; N]) {
        if let Some(place) = self.bytes.get_mut(self.used..).and_then(|rest| rest.first_chunk_mut()) {
            *place = content;
            self.used += N;
        }
    }
}

/// Writes a step, and what is foreseen of the next one.
fn write<'a>(words: &Words, foreseen: &mut Foreseen, bytes: &'a mut [u8; STEP_BYTES]) -> &'a [u8] {
    let elapsed_us = foreseen.elapsed_us(words);
    let counts = (words[0] & HAS_IMU != 0).then(|| counts(words));
    foreseen.advance(elapsed_us, counts);
    let mut lead = 0;
    let mut writing = Writing { bytes, used: 2 };
    if let Some(elapsed_us) = elapsed_us {
        lead |= FOLLOWS;
        writing.put(elapsed_us.to_le_bytes());
    }
    if let Some(counts) = counts {
        lead |= COUNTED;
        for count in counts {
            writing.put(count.to_le_bytes());
        }
    }
    let slow = words[0] & SLOW != 0;
    for (n, (words, seen)) in words.chunks(GROUP).zip(foreseen.words.chunks(GROUP)).enumerate() {
        if (slow || !SLOW_GROUPS.contains(&n)) && writing.put_group(words, seen) {
            lead |= 1 << n;
        }
    }
    foreseen.learn(words);
    let used = writing.used;
    [bytes[0], bytes[1]] = lead.to_le_bytes();
    bytes.get(..used).unwrap_or_default()
}

/// The counts that are nearest to the inertial sample.
fn counts(words: &Words) -> [i16; 6] {
    core::array::from_fn(|n| {
        // Its last bits are the nearest integer; of what is too large they are anything, which is not the value.
        let near = f32::from_bits(words[INERTIAL.start + n]) * INVERSES[n] + ROUND;
        near.to_bits().wrapping_sub(ROUND.to_bits()) as i16
    })
}

/// The bits of what counts say.
fn values(counts: [i16; 6]) -> [u32; 6] {
    core::array::from_fn(|n| (f32::from(counts[n]) * COUNTS[n]).to_bits())
}

/// A number to which none of the size of a count can be added but it is rounded to an integer.
const ROUND: f32 = 12_582_912.0;

/// What a count is: of the rates, rad/s, and of the specific force, m/s².
pub const COUNT_RAD_S: f32 = RATE_RAD_S / RECORDS as f32;
/// See [`COUNT_RAD_S`].
pub const COUNT_M_S2: f32 = FORCE_M_S2 / RECORDS as f32;
const COUNTS: [f32; 6] = [COUNT_RAD_S, COUNT_RAD_S, COUNT_RAD_S, COUNT_M_S2, COUNT_M_S2, COUNT_M_S2];
const INVERSES: [f32; 6] = {
    let (rate, force) = (1.0 / COUNT_RAD_S, 1.0 / COUNT_M_S2);
    [rate, rate, rate, force, force, force]
};

/// The steps of a block.
#[derive(Clone, Debug)]
pub struct Steps<'a> {
    rest: &'a [u8],
    foreseen: Foreseen,
}

/// A block of steps ends within one: its checksum was right, so its writer was not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepError;

impl<'a> Steps<'a> {
    /// Of a block's content.
    pub fn new(content: &'a [u8]) -> Self {
        Self { rest: content, foreseen: Foreseen::nothing() }
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*taken)
    }

    fn counts(&mut self) -> Option<[i16; 6]> {
        let bytes: [u8; 12] = self.take()?;
        Some(core::array::from_fn(|n| i16::from_le_bytes([bytes[2 * n], bytes[2 * n + 1]])))
    }

    fn step(&mut self) -> Option<Words> {
        let lead = u16::from_le_bytes(self.take()?);
        let elapsed_us = if lead & FOLLOWS != 0 { Some(u16::from_le_bytes(self.take()?)) } else { None };
        if elapsed_us.is_some() && !self.foreseen.follows {
            return None;
        }
        let counts = if lead & COUNTED != 0 { Some(self.counts()?) } else { None };
        self.foreseen.advance(elapsed_us, counts);
        let mut words = self.foreseen.words;
        for (n, group) in words.chunks_mut(GROUP).enumerate().filter(|(n, _)| lead >> n & 1 != 0) {
            let [which] = self.take()?;
            debug_assert!(n < GROUPS);
            for (_, word) in group.iter_mut().enumerate().filter(|(n, _)| which >> n & 1 != 0) {
                *word = u32::from_le_bytes(self.take()?);
            }
        }
        self.foreseen.learn(&words);
        Some(words)
    }
}

impl Iterator for Steps<'_> {
    type Item = Result<Record, StepError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let step = self.step();
        if step.is_none() {
            self.rest = &[];
        }
        Some(step.map(|words| Record::from_words(&words)).ok_or(StepError))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn pack(all: &[Words]) -> Vec<Vec<u8>> {
        let mut packer = Packer::new();
        let mut blocks: Vec<Block> = Vec::new();
        for words in all {
            packer.note(words, |full| blocks.push(full.clone()));
        }
        blocks.push(packer.finish());
        let content = |block: Block| {
            let bytes = block.sealed(0);
            super::super::open(&bytes).expect("sealed").content.to_vec()
        };
        blocks.into_iter().map(content).collect()
    }

    fn unpack(blocks: &[Vec<u8>]) -> Vec<Words> {
        let steps = |block| Steps::new(block).map(|step| step.expect("whole").to_words());
        blocks.iter().flat_map(|block: &Vec<u8>| steps(block)).collect()
    }

    /// A step in flight: commands and counts.
    fn flying(n: u32) -> Words {
        let mut words = [0; WORDS];
        // A sample, running, self-test passed, parameters valid, rotors heard, whose speeds are of coarse steps.
        words[..4].copy_from_slice(&[1 | 1 << 3 | 1 << 5 | 1 << 7 | 1 << 14, n, 500 * n, 0]);
        for (place, word) in words[ROTORS].iter_mut().take(4).enumerate() {
            *word = (900.0 + ((n + place as u32) / 4 % 7) as f32).to_bits();
        }
        words[ROTORS.end - 1] = 500;
        let counts = [0, 1, 2, 3, 4, 5].map(|place| (n * 37 % 4_001) as i16 - 2_000 + place);
        words[INERTIAL].copy_from_slice(&values(counts));
        for (place, word) in words[12..16].iter_mut().enumerate() {
            *word = (0.4 + 1e-3 * ((n + place as u32) % 100) as f32).to_bits();
        }
        words
    }

    #[test]
    fn a_flight_at_2_khz_takes_less_than_90_kilobytes_a_second() {
        let all: Vec<Words> = (1..=2_000).map(flying).collect();
        let blocks = pack(&all);
        assert_eq!(unpack(&blocks), all);
        assert!(super::super::BLOCK_BYTES * blocks.len() < 90_000, "{} blocks", blocks.len());
    }

    #[test]
    fn a_value_that_no_count_gives_is_kept_as_it_is() {
        for odd in [-0.0, 1e-30, f32::NAN, f32::INFINITY, -1e9, 10.0, RATE_RAD_S.next_up()] {
            let mut words = flying(1);
            words[INERTIAL.start + 1] = odd.to_bits();
            assert_eq!(unpack(&pack(&[words, words])), [words, words], "{odd}");
        }
    }

    #[test]
    fn a_step_that_breaks_off_is_an_error_and_ends() {
        let block = pack(&[flying(1)]).remove(0);
        for count in 1..block.len() {
            let steps: Vec<_> = Steps::new(&block[..count]).collect();
            assert_eq!(steps, [Err(StepError)], "{count} bytes");
        }
    }

    proptest! {
        #[test]
        fn any_record_is_read_as_it_was_written(
            all in proptest::collection::vec((any::<u32>(), any::<u32>(), any::<u64>(), any::<[u32; 20]>()), 1..60)
        ) {
            // What a record makes of any words, so that what it leaves out is left out.
            let all: Vec<Words> = all
                .into_iter()
                .map(|(flags, step, time_us, some)| {
                    let mut words: Words = core::array::from_fn(|n| some[n % 20].rotate_left(n as u32));
                    words[..4].copy_from_slice(&[flags, step, time_us as u32, (time_us >> 32) as u32]);
                    Record::from_words(&words).to_words()
                })
                .collect();
            prop_assert_eq!(unpack(&pack(&all)), all);
        }

        #[test]
        fn any_bytes_are_taken(bytes: Vec<u8>) {
            let steps = Steps::new(&bytes).count();
            prop_assert!(steps <= 1 + bytes.len() / 2);
        }
    }
}
