//! Steps: the words of a record, without those that can be foreseen.
//!
//! ```text
//! step      lead u16 │ µs since the last u16, if it follows │ inertial counts 6 × i16, if they are exact
//!           │ for each group of eight words with an unforeseen one: which u8 │ those words u32
//! lead      bits 0 to 13: groups with an unforeseen word; 14: counts; 15: it follows
//! ```
//!
//! Foreseen is 0; for a step that follows the last one in its block, the same first word, a step number one higher and the
//! time that is given; and what the counts say. An inertial value is its count times its scale, as the driver computes it:
//! where this gives the same bits, the count stands for it, where not, the value. A count of −32768 is −0.
//!
//! Invariant: what is read has the bits of what was written, whatever they are.
use super::{Block, Kind, ROOM};
use crate::icm42688::{FORCE_M_S2, RATE_RAD_S};
use crate::record::{Record, WORDS};

const FOLLOWS: u16 = 1 << 15;
const COUNTED: u16 = 1 << 14;
/// Words of a group, and how many groups there are.
const GROUP: usize = 8;
const GROUPS: usize = WORDS.div_ceil(GROUP);
/// Longest step.
const STEP_BYTES: usize = 2 + 2 + 12 + GROUPS + 4 * WORDS;
const _: () = assert!(GROUPS <= 14 && STEP_BYTES <= ROOM);
/// The words with the inertial sample: rates, specific force.
const INERTIAL: core::ops::Range<usize> = 4..10;

type Words = [u32; WORDS];

/// Puts steps into blocks.
#[derive(Debug)]
pub struct Packer {
    block: Block,
    /// The last step in the block.
    last: Option<Words>,
}

impl Packer {
    /// A packer of no steps.
    pub fn new() -> Self {
        Self { block: Block::new(Kind::Steps), last: None }
    }

    /// Appends a step; returns the block before it, if that has become full.
    pub fn note(&mut self, record: &Record) -> Option<Block> {
        let words = record.to_words();
        let mut place = Place::new();
        write(&words, self.last.as_ref(), &mut place);
        let full = (!self.block.put(place.written())).then(|| {
            // It follows nothing now.
            place = Place::new();
            write(&words, None, &mut place);
            let full = core::mem::replace(&mut self.block, Block::new(Kind::Steps));
            self.block.put(place.written());
            full
        });
        self.last = Some(words);
        full
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

/// Where a step is written.
struct Place {
    bytes: [u8; STEP_BYTES],
    count: usize,
}

impl Place {
    fn new() -> Self {
        Self { bytes: [0; STEP_BYTES], count: 0 }
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        // There is room for the longest.
        if let Some(place) = self.bytes.get_mut(self.count..self.count + N) {
            place.copy_from_slice(&bytes);
            self.count += N;
        }
    }

    fn written(&self) -> &[u8] {
        self.bytes.get(..self.count).unwrap_or(&[])
    }
}

fn write(words: &Words, last: Option<&Words>, place: &mut Place) {
    let elapsed_us = last.and_then(|last| elapsed_us(last, words));
    let counts = counts(words);
    let mut foreseen = [0; WORDS];
    if let (Some(last), Some(elapsed_us)) = (last, elapsed_us) {
        follow(last, elapsed_us, &mut foreseen);
    }
    if counts.is_some() {
        foreseen[INERTIAL].copy_from_slice(&words[INERTIAL]);
    }
    let mut which = [0_u8; GROUPS];
    let mut lead = 0;
    let groups = words.chunks(GROUP).zip(foreseen.chunks(GROUP));
    for ((n, which), (words, foreseen)) in (0..).zip(&mut which).zip(groups) {
        let differs = |(n, (word, foreseen)): (u32, (&u32, &u32))| u8::from(word != foreseen) << n;
        *which = (0..).zip(words.iter().zip(foreseen)).map(differs).sum();
        lead |= u16::from(*which != 0) << n;
    }
    lead |= if elapsed_us.is_some() { FOLLOWS } else { 0 } | if counts.is_some() { COUNTED } else { 0 };
    place.put(lead.to_le_bytes());
    if let Some(elapsed_us) = elapsed_us {
        place.put(elapsed_us.to_le_bytes());
    }
    for count in counts.into_iter().flatten() {
        place.put(count.to_le_bytes());
    }
    for (which, words) in which.into_iter().zip(words.chunks(GROUP)).filter(|&(which, _)| which != 0) {
        place.put([which]);
        for (n, word) in words.iter().enumerate() {
            if which >> n & 1 != 0 {
                place.put(word.to_le_bytes());
            }
        }
    }
}

/// Time from a step to the one after it, µs, if the one is that and the time is no longer than two bytes.
fn elapsed_us(last: &Words, words: &Words) -> Option<u16> {
    let follows = words[1] == last[1].wrapping_add(1);
    time_us(words).checked_sub(time_us(last)).filter(|_| follows)?.try_into().ok()
}

fn time_us(words: &Words) -> u64 {
    u64::from(words[3]) << 32 | u64::from(words[2])
}

/// What can be foreseen of a step by the one before it.
fn follow(last: &Words, elapsed_us: u16, foreseen: &mut Words) {
    let time_us = time_us(last).wrapping_add(elapsed_us.into());
    foreseen[..4].copy_from_slice(&[last[0], last[1].wrapping_add(1), time_us as u32, (time_us >> 32) as u32]);
}

/// The counts that stand for the inertial sample, if there is one and they do.
fn counts(words: &Words) -> Option<[i16; 6]> {
    let mut counts = [0; 6];
    for ((count, &word), scale) in counts.iter_mut().zip(&words[INERTIAL]).zip(SCALES) {
        let near = f32::from_bits(word) / scale;
        let half = if near < 0.0 { -0.5 } else { 0.5 };
        // The cast saturates.
        *count = if word == (-0.0_f32).to_bits() { i16::MIN } else { (near + half) as i16 };
        if value(*count, scale) != word {
            return None;
        }
    }
    (counts != [0; 6]).then_some(counts)
}

/// The scales of the counts.
const SCALES: [f32; 6] = [RATE_RAD_S, RATE_RAD_S, RATE_RAD_S, FORCE_M_S2, FORCE_M_S2, FORCE_M_S2];

/// The bits of what a count says.
fn value(count: i16, scale: f32) -> u32 {
    if count == i16::MIN { -0.0 } else { f32::from(count) * scale }.to_bits()
}

/// The steps of a block.
#[derive(Clone, Debug)]
pub struct Steps<'a> {
    rest: &'a [u8],
    last: Option<Words>,
}

/// A block of steps ends within one: its checksum was right, so its writer was not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepError;

impl<'a> Steps<'a> {
    /// Of a block's content.
    pub fn new(content: &'a [u8]) -> Self {
        Self { rest: content, last: None }
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*taken)
    }

    fn step(&mut self) -> Option<Words> {
        let lead = u16::from_le_bytes(self.take()?);
        let mut words = [0; WORDS];
        if lead & FOLLOWS != 0 {
            let elapsed_us = u16::from_le_bytes(self.take()?);
            follow(self.last.as_ref()?, elapsed_us, &mut words);
        }
        if lead & COUNTED != 0 {
            for (word, scale) in words[INERTIAL].iter_mut().zip(SCALES) {
                *word = value(i16::from_le_bytes(self.take()?), scale);
            }
        }
        for (n, group) in words.chunks_mut(GROUP).enumerate().filter(|(n, _)| lead >> n & 1 != 0) {
            let [which] = self.take()?;
            debug_assert!(n < GROUPS);
            for (_, word) in group.iter_mut().enumerate().filter(|(n, _)| which >> n & 1 != 0) {
                *word = u32::from_le_bytes(self.take()?);
            }
        }
        self.last = Some(words);
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
        let mut blocks: Vec<Block> = all.iter().filter_map(|words| packer.note(&Record::from_words(words))).collect();
        blocks.push(packer.finish());
        let content = |mut block: Block| {
            let bytes = *block.seal(0);
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
        // A sample, running, self-test passed, parameters valid.
        words[..4].copy_from_slice(&[1 | 1 << 3 | 1 << 5 | 1 << 7, n, 500 * n, 0]);
        for ((place, word), scale) in (0_i16..).zip(&mut words[INERTIAL]).zip(SCALES) {
            *word = value((n * 37 % 4_001) as i16 - 2_000 + place, scale);
        }
        for (place, word) in words[12..16].iter_mut().enumerate() {
            *word = (0.4 + 1e-3 * ((n + place as u32) % 100) as f32).to_bits();
        }
        words
    }

    #[test]
    fn a_flight_at_2_khz_takes_less_than_75_kilobytes_a_second() {
        let all: Vec<Words> = (1..=2_000).map(flying).collect();
        let blocks = pack(&all);
        assert_eq!(unpack(&blocks), all);
        assert!(super::super::BLOCK_BYTES * blocks.len() < 75_000, "{} blocks", blocks.len());
    }

    #[test]
    fn a_value_that_no_count_gives_is_kept_as_it_is() {
        for odd in [-0.0, 1e-30, f32::NAN, f32::INFINITY, -1e9, RATE_RAD_S.next_up()] {
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
