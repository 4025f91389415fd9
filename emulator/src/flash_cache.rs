//! Flash wait states: what the chip's flash accelerator leaves of them.
//!
//! Flash is read in lines of 16 bytes. A line that is not cached costs `latency` cycles; a cached one, or the one read
//! last, none. The instruction cache has 64 lines, the data cache 8, both least recently used first out.
//!
//! Constants loaded relative to the program counter go through the data cache; tables read through a pointer are not
//! seen and taken as cached. The prefetch is not modelled and must be off.
//!
//! # Source
//! RM0090 rev 19, 3.5.2 "Adaptive real-time memory accelerator".

use crate::peripheral::flash::FLASH_START;

const LINE_BITS: u32 = 4;
/// Lines of the largest flash of the family.
const LINES: usize = 1024 * 1024 >> LINE_BITS;
/// No line.
const NOWHERE: u32 = u32::MAX;

/// A fully associative cache of whole lines.
///
/// The places are a ring in the order of their last use. The place before the first is the one used longest ago, so to put a line there and
/// call it the first is to replace it.
#[derive(Debug)]
struct Cache {
    places: Vec<Place>,
    /// The place used last.
    first: u8,
    /// By line of flash, one more than the place that holds it, or 0.
    held: Vec<u8>,
    last: u32,
    on: bool,
}

/// A line that is held, and its neighbours in the ring: used next after it, and next before it.
#[derive(Clone, Debug)]
struct Place {
    line: u32,
    newer: u8,
    older: u8,
}

impl Cache {
    fn new(size: u8) -> Self {
        let place = |n: u8| Place { line: NOWHERE, newer: (n + size - 1) % size, older: (n + 1) % size };
        Self { places: (0..size).map(place).collect(), first: 0, held: vec![0; LINES], last: NOWHERE, on: false }
    }

    /// Reads a line; whether flash had to be asked.
    fn misses(&mut self, line: u32) -> bool {
        // The buffer of the line read last, which is there without a cache too.
        if line == self.last {
            return false;
        }
        self.last = line;
        let Some(&held) = self.held.get(line as usize).filter(|_| self.on) else { return true };
        if held > 0 {
            self.bring_forward(held - 1);
            return false;
        }
        self.replace(line);
        true
    }

    /// Makes a place the one used last.
    fn bring_forward(&mut self, place: u8) {
        if place == self.first {
            return;
        }
        let Place { newer, older, .. } = self.places[usize::from(place)];
        (self.places[usize::from(newer)].older, self.places[usize::from(older)].newer) = (older, newer);
        let oldest = self.places[usize::from(self.first)].newer;
        (self.places[usize::from(oldest)].older, self.places[usize::from(self.first)].newer) = (place, place);
        (self.places[usize::from(place)].newer, self.places[usize::from(place)].older) = (oldest, self.first);
        self.first = place;
    }

    fn replace(&mut self, line: u32) {
        let oldest = self.places[usize::from(self.first)].newer;
        let dropped = std::mem::replace(&mut self.places[usize::from(oldest)].line, line);
        if let Some(held) = self.held.get_mut(dropped as usize) {
            *held = 0;
        }
        self.held[line as usize] = oldest + 1;
        self.first = oldest;
    }
}

/// Both caches, and what a miss costs.
#[derive(Debug)]
pub(crate) struct FlashCache {
    instructions: Cache,
    data: Cache,
    latency: u64,
}

impl FlashCache {
    pub(crate) fn new() -> Self {
        Self { instructions: Cache::new(64), data: Cache::new(8), latency: 0 }
    }

    /// Takes over FLASH_ACR: wait states, and which caches are on.
    pub(crate) fn configure(&mut self, latency: u64, instructions: bool, data: bool) {
        self.latency = latency;
        self.instructions.on = instructions;
        self.data.on = data;
    }

    /// Wait states to fetch the code from `start` to `end`.
    pub(crate) fn fetch(&mut self, start: u32, end: u32) -> u64 {
        let line = |address: u32| address.wrapping_sub(FLASH_START) >> LINE_BITS;
        let lines = line(start)..=line(end - 1);
        let missed = lines.filter(|&line| self.instructions.misses(line)).count();
        missed as u64 * self.latency
    }

    /// Wait states to load the constants at these addresses.
    pub(crate) fn load(&mut self, addresses: &[u32]) -> u64 {
        let missed = addresses
            .iter()
            .filter(|&&address| self.data.misses(address.wrapping_sub(FLASH_START) >> LINE_BITS))
            .count();
        missed as u64 * self.latency
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_that_fits_is_free_and_one_line_more_always_misses() {
        for (lines, second_round) in [(64, 0), (65, 65 * 5)] {
            let mut cache = FlashCache::new();
            cache.configure(5, true, true);
            let end = 0x0800_0000 + 16 * lines;
            assert_eq!(cache.fetch(0x0800_0000, end), u64::from(lines) * 5);
            assert_eq!(cache.fetch(0x0800_0000, end), second_round);
        }
    }

    #[test]
    fn without_caches_only_the_line_read_last_is_free() {
        let mut cache = FlashCache::new();
        cache.configure(5, false, false);
        assert_eq!(cache.fetch(0x0800_0000, 0x0800_0010), 5);
        assert_eq!(cache.fetch(0x0800_0004, 0x0800_0008), 0);
        assert_eq!(cache.fetch(0x0800_0010, 0x0800_0020), 5);
        assert_eq!(cache.fetch(0x0800_0000, 0x0800_0010), 5);
        assert_eq!(cache.load(&[0x0800_1000, 0x0800_1004, 0x0800_1010]), 10);
    }
}
