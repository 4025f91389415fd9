//! Log flash: a NOR flash of 16 MiB, a W25Q128, in the place of the card. A file on this computer is its content.
//!
//! Programming only clears bits, in one page of 256 bytes, within which addresses wrap; erasing sets those of 64 KiB. Both want the write
//! enable latch, which they clear, and begin when the chip is no longer selected; while it is busy it says no more than that. Where power
//! fails within one, each bit that was to change has or has not, by chance that is the same each time. What it is asked
//! beyond the instructions here, or against the above, ends the run; nothing is refused of what comes after 0xff, which is no instruction.
//!
//! # Source
//! Winbond, "W25Q128JV" revision M, chapters 7.1 "Status Registers", 8.1 "Device ID and Instruction Set Tables", 8.2 "Instruction
//! Descriptions", 9.6 "AC Electrical Characteristics": times.
use super::sd_card::Busy;
use crate::peripheral::flash::Extent;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Manufacturer, kind, and the power of two of its bytes.
const ID: [u8; 3] = [0xef, 0x40, 24];
const BYTES: u64 = 1 << 24;
const PAGE: usize = 256;
const BLOCK: usize = 64 * 1024;
/// What it takes to erase a block, µs, typical.
const ERASE_US: u64 = 150_000;
/// What it takes to program a page, µs: typical, and now and then the longest that is allowed.
const USUAL: Busy = Busy { usual_us: 400, long_us: 3_000, long_every: 100 };

const BUSY: u8 = 1;
const ENABLED: u8 = 2;

/// What it is doing: bytes from a place on, before and after it.
#[derive(Debug)]
struct Work {
    at: u64,
    before: Vec<u8>,
    after: Vec<u8>,
    until: u64,
}

/// The chip.
#[derive(Debug)]
pub(crate) struct LogFlash {
    content: File,
    program: Busy,
    cycles_us: u64,
    selected: bool,
    enabled: bool,
    /// What it has heard since it was selected.
    heard: Vec<u8>,
    work: Option<Work>,
    programmed: u32,
    /// What is not modelled, if something of it was done.
    pub(crate) unknown: Option<String>,
}

impl LogFlash {
    /// A chip whose content is a file of its size.
    pub(crate) fn new(file: &Path, cycles_us: u64) -> io::Result<Self> {
        let content = File::options().read(true).write(true).open(file)?;
        let bytes = content.metadata()?.len();
        if bytes != BYTES {
            return Err(io::Error::other(format!("has {bytes} bytes, must have {BYTES}")));
        }
        Ok(Self {
            content,
            program: USUAL,
            cycles_us,
            selected: false,
            enabled: false,
            heard: Vec::new(),
            work: None,
            programmed: 0,
            unknown: None,
        })
    }

    /// Power fails and comes back.
    pub(crate) fn cut_power(&mut self, now: u64) {
        self.end(now);
        if let Some(Work { at, before, after, .. }) = self.work.take() {
            let words = |bytes: &[u8]| bytes.as_chunks().0.iter().copied().map(u32::from_le_bytes).collect::<Vec<_>>();
            let (before, after) = (words(&before), words(&after));
            let part = Extent::Part(self.programmed);
            let torn = (at as u32..).step_by(4).zip(before.iter().zip(&after));
            let torn: Vec<u8> = torn.flat_map(|(at, (&old, &new))| part.of(at, old, new).to_le_bytes()).collect();
            self.write(at, &torn);
        }
        (self.enabled, self.heard) = (false, Vec::new());
    }

    /// Sets how long it takes to program a page.
    pub(crate) fn set_busy(&mut self, program: Busy) {
        self.program = program;
    }

    /// Its select line.
    pub(crate) fn select(&mut self, low: bool, now: u64) {
        if std::mem::replace(&mut self.selected, low) && !low {
            let heard = std::mem::take(&mut self.heard);
            self.obey(&heard, now);
        }
    }

    /// One byte each way.
    pub(crate) fn exchange(&mut self, byte: u8, now: u64) -> u8 {
        if !self.selected {
            return u8::MAX;
        }
        self.end(now);
        let place = self.heard.len();
        let answer = match self.heard[..] {
            [0x05, ..] => u8::from(self.work.is_some()) * BUSY | u8::from(self.enabled) * ENABLED,
            [0x9f, ..] => ID.get(place - 1).copied().unwrap_or_default(),
            [0x03, a, b, c, ..] => self.read(address(a, b, c) + place as u64 - 4),
            _ => u8::MAX,
        };
        self.heard.push(byte);
        if let [instruction] = self.heard[..]
            && self.work.is_some()
            && instruction != 0x05
        {
            self.refuse(&format!("hears {instruction:#04x} while it is busy"));
        }
        answer
    }

    /// What is done when it is no longer selected.
    fn obey(&mut self, heard: &[u8], now: u64) {
        match *heard {
            // Those that read have been answered, and no instruction is none.
            [] | [0x05 | 0x9f | 0x03 | 0xff, ..] => {}
            [0x06] => self.enabled = true,
            [0x02, a, b, c, ref bytes @ ..] if !bytes.is_empty() => {
                let (page, first) = (address(a, b, c) & !(PAGE as u64 - 1), usize::from(c));
                let mut after = self.read_many(page, PAGE);
                for (place, byte) in (first..).zip(bytes) {
                    after[place % PAGE] &= byte;
                }
                self.programmed += 1;
                let Busy { usual_us, long_us, long_every } = self.program;
                let long = long_every > 0 && self.programmed.is_multiple_of(long_every);
                self.begin(page, after, u64::from(if long { long_us } else { usual_us }), now);
            }
            [0xd8, a, b, c] => {
                self.begin(address(a, b, c) & !(BLOCK as u64 - 1), vec![u8::MAX; BLOCK], ERASE_US, now);
            }
            [instruction, ..] => self.refuse(&format!("instruction {instruction:#04x} is not modelled as it is used")),
        }
    }

    fn begin(&mut self, at: u64, after: Vec<u8>, us: u64, now: u64) {
        if !std::mem::take(&mut self.enabled) {
            return self.refuse("is written to without being enabled");
        }
        let before = self.read_many(at, after.len());
        self.write(at, &after);
        self.work = Some(Work { at, before, after, until: now + us * self.cycles_us });
    }

    fn end(&mut self, now: u64) {
        self.work.take_if(|work| work.until <= now);
    }

    fn read(&mut self, at: u64) -> u8 {
        self.read_many(at, 1)[0]
    }

    /// Beyond its end it begins anew.
    fn read_many(&mut self, at: u64, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        if let Err(error) = self.content.read_exact_at(&mut bytes, at % BYTES) {
            self.refuse(&error.to_string());
        }
        bytes
    }

    fn write(&mut self, at: u64, bytes: &[u8]) {
        if let Err(error) = self.content.write_all_at(bytes, at) {
            self.refuse(&error.to_string());
        }
    }

    fn refuse(&mut self, what: &str) {
        self.unknown = Some(format!("the log flash: {what}"));
    }
}

fn address(a: u8, b: u8, c: u8) -> u64 {
    u32::from_be_bytes([0, a, b, c]).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: u64 = 168;

    /// A chip with zeros all over its second block, and its file.
    fn chip() -> (LogFlash, File) {
        let file = tempfile::NamedTempFile::new().expect("a file");
        file.as_file().write_all_at(&vec![u8::MAX; BYTES as usize], 0).expect("written");
        file.as_file().write_all_at(&vec![0; BLOCK], BLOCK as u64).expect("written");
        (LogFlash::new(file.path(), US).expect("of its size"), file.into_file())
    }

    /// Says something to it; what it answers.
    fn say(chip: &mut LogFlash, bytes: &[u8], now: u64) -> Vec<u8> {
        chip.select(true, now);
        let answers = bytes.iter().map(|&byte| chip.exchange(byte, now)).collect();
        chip.select(false, now);
        answers
    }

    #[test]
    fn a_page_is_programmed_where_it_was_erased_and_wraps_at_its_end() {
        let (mut chip, _) = chip();
        assert_eq!(say(&mut chip, &[0x9f, 0, 0, 0], 0)[1..], ID);
        say(&mut chip, &[0x06], 0);
        assert_eq!(say(&mut chip, &[0x05, 0], 0)[1], ENABLED);
        say(&mut chip, &[0x02, 0, 1, 0xfe, 0x5a, 0xf0, 0x0f], 0);
        assert_eq!(say(&mut chip, &[0x05, 0], 399 * US)[1], BUSY);
        assert_eq!(say(&mut chip, &[0x05, 0], 400 * US)[1], 0);
        say(&mut chip, &[0x06], 400 * US);
        say(&mut chip, &[0x02, 0, 1, 0xff, 0x33], 400 * US);
        assert_eq!(say(&mut chip, &[0x03, 0, 1, 0xfe, 0, 0, 0], 800 * US)[4..], [0x5a, 0x30, 0xff]);
        assert_eq!(say(&mut chip, &[0x03, 0, 1, 0, 0], 800 * US)[4], 0x0f);
        assert_eq!(chip.unknown, None);
    }

    #[test]
    fn what_is_not_enabled_or_said_while_it_is_busy_ends_the_run() {
        let refused = |said: &[&[u8]]| {
            let (mut chip, _) = chip();
            for bytes in said {
                say(&mut chip, bytes, 0);
            }
            chip.unknown.expect("refused")
        };
        assert!(refused(&[&[0x02, 0, 0, 0, 1]]).contains("without being enabled"));
        assert!(refused(&[&[0x06], &[0xd8, 0, 0, 0], &[0x03, 0, 0, 0, 0]]).contains("while it is busy"));
        assert!(refused(&[&[0xc7]]).contains("0xc7 is not modelled"));
    }

    #[test]
    fn power_that_fails_within_an_erasure_leaves_bits_of_both_sorts_and_other_blocks_alone() {
        let (mut chip, file) = chip();
        say(&mut chip, &[0x06], 0);
        say(&mut chip, &[0xd8, 1, 0x12, 0x34], 0);
        chip.cut_power(ERASE_US * US / 2);
        let mut bytes = vec![0; 3 * BLOCK];
        file.read_exact_at(&mut bytes, 0).expect("read");
        let erased: u32 = bytes[BLOCK..2 * BLOCK].iter().map(|byte| byte.count_ones()).sum();
        assert!((BLOCK as u32..7 * BLOCK as u32).contains(&erased), "{erased} bits");
        assert!(bytes[..BLOCK].iter().chain(&bytes[2 * BLOCK..]).all(|&byte| byte == u8::MAX));
        say(&mut chip, &[0x06], 0);
        say(&mut chip, &[0xd8, 1, 0, 0], 0);
        chip.cut_power(ERASE_US * US);
        file.read_exact_at(&mut bytes, 0).expect("read");
        assert!(bytes.iter().all(|&byte| byte == u8::MAX), "it was done");
    }
}
