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

const LINE_BITS: u32 = 4;

/// A fully associative cache of whole lines.
#[derive(Debug)]
struct Cache {
    /// Line numbers, the most recently used last.
    lines: Vec<u32>,
    size: usize,
    on: bool,
}

impl Cache {
    fn new(size: usize) -> Self {
        Self { lines: Vec::with_capacity(size), size, on: false }
    }

    /// Reads a line; whether flash had to be asked.
    fn misses(&mut self, line: u32) -> bool {
        if self.lines.last() == Some(&line) {
            return false;
        }
        if !self.on {
            // What remains is the buffer of the line read last.
            self.lines.clear();
            self.lines.push(line);
            return true;
        }
        if let Some(at) = self.lines.iter().rposition(|&held| held == line) {
            self.lines[at..].rotate_left(1);
            return false;
        }
        if self.lines.len() == self.size {
            self.lines.remove(0);
        }
        self.lines.push(line);
        true
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
        let lines = start >> LINE_BITS..=(end - 1) >> LINE_BITS;
        let missed = lines.filter(|&line| self.instructions.misses(line)).count();
        missed as u64 * self.latency
    }

    /// Wait states to load the constants at these addresses.
    pub(crate) fn load(&mut self, addresses: &[u32]) -> u64 {
        let missed = addresses.iter().filter(|&&address| self.data.misses(address >> LINE_BITS)).count();
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
