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
/// The words from here on are the rotors' speeds and their age.
const ROTORS: usize = 54;
/// Words of the first groups, and where the last ones begin, of which anything but 0 can be foreseen.
const FIRST: usize = 2 * GROUP;
const LAST: usize = ROTORS / GROUP * GROUP;
/// The words with the inertial sample: rates, specific force.
const INERTIAL: core::ops::Range<usize> = 4..10;

type Words = [u32; WORDS];

/// What of a step the next one's words can be foreseen by.
#[derive(Clone, Copy, Debug)]
struct Lead {
    /// Which parts are there, number, time.
    head: [u32; 4],
    /// The rotors' speeds and their age.
    rotors: [u32; WORDS - ROTORS],
}

impl Lead {
    fn new(words: &Words) -> Self {
        let [a, b, c, d, ..] = *words;
        Self { head: [a, b, c, d], rotors: core::array::from_fn(|n| words[ROTORS + n]) }
    }
}

/// Puts steps into blocks.
#[derive(Debug)]
pub struct Packer {
    block: Block,
    /// Of the last step in the block.
    last: Option<Lead>,
}

impl Packer {
    /// A packer of no steps.
    pub fn new() -> Self {
        Self { block: Block::new(Kind::Steps), last: None }
    }

    /// Appends a step, the words of its [`Record`]; returns the block before it, if that has become full.
    pub fn note(&mut self, words: &Words) -> Option<Block> {
        let full = (!write(words, self.last.as_ref(), &mut self.block)).then(|| {
            let full = core::mem::replace(&mut self.block, Block::new(Kind::Steps));
            // It follows nothing now, and there is room for the longest.
            write(words, None, &mut self.block);
            full
        });
        self.last = Some(Lead::new(words));
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

/// Appends a step; false if there is no room for it, and nothing changes then.
fn write(words: &Words, last: Option<&Lead>, block: &mut Block) -> bool {
    let elapsed_us = last.and_then(|last| elapsed_us(last, words));
    let counts = (words[0] & HAS_IMU != 0).then(|| counts(words));
    let (mut first, mut ends) = ([0; FIRST], [0; WORDS - LAST]);
    if let (Some(last), Some(elapsed_us)) = (last, elapsed_us) {
        first[..4].copy_from_slice(&follow(last, elapsed_us));
        ends[ROTORS - LAST..].copy_from_slice(&last.rotors);
    }
    if let Some(counts) = counts {
        first[INERTIAL].copy_from_slice(&values(counts));
    }
    let mut which = [0_u8; GROUPS];
    for (which, (words, foreseen)) in which.iter_mut().zip(words.chunks(GROUP).zip(first.chunks(GROUP))) {
        *which = differing(words, foreseen);
    }
    // Mostly not there.
    if words[0] & SLOW != 0 {
        for (which, words) in which.iter_mut().zip(words.chunks(GROUP)).take(LAST / GROUP).skip(FIRST / GROUP) {
            *which = differing(words, &[0; GROUP]);
        }
    }
    let last_groups = words[LAST..].chunks(GROUP).zip(ends.chunks(GROUP));
    for (which, (words, foreseen)) in which[LAST / GROUP..].iter_mut().zip(last_groups) {
        *which = differing(words, foreseen);
    }
    let mut lead = if elapsed_us.is_some() { FOLLOWS } else { 0 } | if counts.is_some() { COUNTED } else { 0 };
    for (n, which) in which.iter().enumerate() {
        lead |= u16::from(*which != 0) << n;
    }
    let before = block.used;
    let mut fits = block.put(&lead.to_le_bytes());
    if let Some(elapsed_us) = elapsed_us {
        fits &= block.put(&elapsed_us.to_le_bytes());
    }
    if let Some([a, b, c, d, e, f]) = counts.map(|counts| counts.map(i16::to_le_bytes)) {
        fits &= block.put(&[a[0], a[1], b[0], b[1], c[0], c[1], d[0], d[1], e[0], e[1], f[0], f[1]]);
    }
    for (which, words) in which.into_iter().zip(words.chunks(GROUP)).filter(|&(which, _)| which != 0) {
        fits &= block.put(&[which]);
        for (n, word) in words.iter().enumerate() {
            if which >> n & 1 != 0 {
                fits &= block.put(&word.to_le_bytes());
            }
        }
    }
    if !fits {
        block.used = before;
    }
    fits
}

/// Bits of the words of a group that are not what was foreseen.
fn differing(words: &[u32], foreseen: &[u32]) -> u8 {
    words.iter().zip(foreseen).enumerate().fold(0, |which, (n, (word, seen))| which | u8::from(word != seen) << n)
}

/// Time from a step to the one after it, µs, if the one is that and the time is no longer than two bytes.
fn elapsed_us(last: &Lead, words: &Words) -> Option<u16> {
    let follows = words[1] == last.head[1].wrapping_add(1);
    let [_, _, low, high, ..] = *words;
    time_us(low, high).checked_sub(time_us(last.head[2], last.head[3])).filter(|_| follows)?.try_into().ok()
}

fn time_us(low: u32, high: u32) -> u64 {
    u64::from(high) << 32 | u64::from(low)
}

/// What can be foreseen of a step by the one before it.
fn follow(&Lead { head: [parts, step, low, high], .. }: &Lead, elapsed_us: u16) -> [u32; 4] {
    let time_us = time_us(low, high).wrapping_add(elapsed_us.into());
    [parts, step.wrapping_add(1), time_us as u32, (time_us >> 32) as u32]
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
    last: Option<Lead>,
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
            let last = self.last?;
            words[..4].copy_from_slice(&follow(&last, elapsed_us));
            words[ROTORS..].copy_from_slice(&last.rotors);
        }
        if lead & COUNTED != 0 {
            let bytes: [u8; 12] = self.take()?;
            let counts = core::array::from_fn(|n| i16::from_le_bytes([bytes[2 * n], bytes[2 * n + 1]]));
            words[INERTIAL].copy_from_slice(&values(counts));
        }
        for (n, group) in words.chunks_mut(GROUP).enumerate().filter(|(n, _)| lead >> n & 1 != 0) {
            let [which] = self.take()?;
            debug_assert!(n < GROUPS);
            for (_, word) in group.iter_mut().enumerate().filter(|(n, _)| which >> n & 1 != 0) {
                *word = u32::from_le_bytes(self.take()?);
            }
        }
        self.last = Some(Lead::new(&words));
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
        let mut blocks: Vec<Block> = all.iter().filter_map(|words| packer.note(words)).collect();
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
        // A sample, running, self-test passed, parameters valid, rotors heard, whose speeds are of coarse steps.
        words[..4].copy_from_slice(&[1 | 1 << 3 | 1 << 5 | 1 << 7 | 1 << 14, n, 500 * n, 0]);
        for (place, word) in words[ROTORS..ROTORS + 4].iter_mut().enumerate() {
            *word = (900.0 + ((n + place as u32) / 4 % 7) as f32).to_bits();
        }
        words[WORDS - 1] = 500;
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
