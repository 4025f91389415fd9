//! SD card, of high capacity, in SPI mode: a file on this computer is its content.
//!
//! It wants 74 clocks before it is selected for the first time, a bus of at most 400 kHz until it is up, and time: to come up, to
//! find a block, to program one. It reads single blocks and is written many in a row; where the chip is reset within one it
//! waits for the rest of it. Checksums are off but where they cannot be. A card that is not there answers nothing: its line is pulled
//! high. What it is asked beyond the commands here, or against the above, ends the run.
//!
//! # Source
//! SD Association, "Physical Layer Simplified Specification" 9.00, chapters 5.3.3 "CSD Register (Version 2.0)", 6.4.1.4 (74 clocks) and
//! 7 "SPI Mode".
use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

const BLOCK: usize = 512;
/// Clocks that it wants before it is selected, in bytes.
const WAKE_BYTES: u32 = 74 / 8 + 1;
/// Shortest byte until it is up: at 400 kHz, less what an event may come early, µs.
const SLOW_BYTE_US: u64 = 19;
/// What it takes to come up, and to find a block, µs.
const UP_US: u64 = 120_000;
const FIND_US: u64 = 300;

const IDLE: u8 = 0x01;
const START: u8 = 0xfe;
const START_OF_MANY: u8 = 0xfc;
const STOP: u8 = 0xfd;
const ACCEPTED: u8 = 0xe5;

/// How long it takes to program a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Busy {
    /// As a rule, µs.
    pub usual_us: u32,
    /// Now and then, µs: it tidies up.
    pub long_us: u32,
    /// How often that is: once in so many blocks.
    pub long_every: u32,
}

/// As cards that are sold do.
const USUAL: Busy = Busy { usual_us: 400, long_us: 20_000, long_every: 200 };

#[derive(Debug)]
enum Wants {
    Command,
    /// The start of a block for this place, or the stop; then it.
    Start(u64),
    Block(u64),
}

/// The card, and its slot.
#[derive(Debug)]
pub(crate) struct SdCard {
    content: Option<File>,
    busy: Busy,
    cycles_us: u64,
    selected: bool,
    /// Bytes clocked since power came on with the card not selected.
    woken: u32,
    last_byte_at: u64,
    idle: bool,
    application: bool,
    up_at: Option<u64>,
    wants: Wants,
    heard: Vec<u8>,
    answer: VecDeque<u8>,
    /// When a block that is asked for begins.
    found_at: u64,
    block: VecDeque<u8>,
    busy_until: u64,
    /// Blocks programmed.
    pub(crate) programmed: u32,
    /// What is not modelled, if something of it was done.
    pub(crate) unknown: Option<String>,
}

impl SdCard {
    /// An empty slot.
    pub(crate) fn new(cycles_us: u64) -> Self {
        Self {
            content: None,
            busy: USUAL,
            cycles_us,
            selected: false,
            woken: 0,
            last_byte_at: 0,
            idle: true,
            application: false,
            up_at: None,
            wants: Wants::Command,
            heard: Vec::new(),
            answer: VecDeque::new(),
            found_at: 0,
            block: VecDeque::new(),
            busy_until: 0,
            programmed: 0,
            unknown: None,
        }
    }

    /// Power comes on: what is in the slot starts anew.
    pub(crate) fn power_up(&mut self) {
        let (content, busy) = (self.content.take(), self.busy);
        *self = Self { content, busy, selected: self.selected, ..Self::new(self.cycles_us) };
    }

    /// Puts a card in whose content is a file, or pulls the one that is there.
    pub(crate) fn put(&mut self, file: Option<&Path>) -> io::Result<()> {
        self.power_up();
        self.content = file.map(|file| File::options().read(true).write(true).open(file)).transpose()?;
        Ok(())
    }

    /// Sets how long it takes to program a block.
    pub(crate) fn set_busy(&mut self, busy: Busy) {
        self.busy = busy;
    }

    /// Its select line.
    pub(crate) fn select(&mut self, low: bool) {
        self.selected = low;
    }

    /// One byte each way.
    pub(crate) fn exchange(&mut self, byte: u8, now: u64) -> u8 {
        let took = now - std::mem::replace(&mut self.last_byte_at, now);
        if self.content.is_none() {
            return u8::MAX;
        }
        if !self.selected {
            self.woken += 1;
            return u8::MAX;
        }
        if self.woken < WAKE_BYTES {
            self.unknown = Some(format!("the card is selected after {} bytes of clock", self.woken));
        }
        if self.idle && took < SLOW_BYTE_US * self.cycles_us {
            self.unknown = Some("the card's bus is faster than 400 kHz before it is up".to_owned());
        }
        let answer = self.say(now);
        self.hear(byte, now);
        answer
    }

    fn say(&mut self, now: u64) -> u8 {
        if let Some(byte) = self.answer.pop_front() {
            byte
        } else if now < self.busy_until {
            0
        } else if now >= self.found_at {
            self.block.pop_front().unwrap_or(u8::MAX)
        } else {
            u8::MAX
        }
    }

    fn hear(&mut self, byte: u8, now: u64) {
        match self.wants {
            Wants::Command if self.heard.is_empty() && byte == u8::MAX => {}
            Wants::Command => {
                self.heard.push(byte);
                if self.heard.len() == 6 {
                    let command = std::mem::take(&mut self.heard);
                    self.obey(&command, now);
                }
            }
            Wants::Start(_) if !matches!(byte, START_OF_MANY | STOP) => {}
            Wants::Start(_) if now < self.busy_until => {
                self.refuse("the card is sent a block while it is busy".to_owned());
            }
            Wants::Start(_) if byte == STOP => {
                self.wants = Wants::Command;
                // A byte passes before it is busy.
                self.answer.push_back(u8::MAX);
                self.busy_until = now + u64::from(self.busy.usual_us) * self.cycles_us;
            }
            Wants::Start(at) => self.wants = Wants::Block(at),
            Wants::Block(at) => {
                self.heard.push(byte);
                if self.heard.len() == BLOCK + 2 {
                    let block = std::mem::take(&mut self.heard);
                    self.wants = Wants::Start(at + 1);
                    self.program(at, &block[..BLOCK], now);
                }
            }
        }
    }

    fn obey(&mut self, command: &[u8], now: u64) {
        let &[code, a, b, c, d, checksum] = command else { return };
        let (number, argument) = (code & 0x3f, u32::from_be_bytes([a, b, c, d]));
        if code >> 6 != 1 || now < self.busy_until {
            return self.refuse(format!("the card hears {code:#04x} where a command is due, or while it is busy"));
        }
        if matches!(number, 0 | 8) && crc7(&command[..5]) << 1 | 1 != checksum {
            return self.refuse(format!("the checksum of the card's command {number} is wrong"));
        }
        let application = std::mem::take(&mut self.application);
        let state = if self.idle { IDLE } else { 0 };
        // A byte passes before it answers.
        self.answer.push_back(u8::MAX);
        match (application, number) {
            (false, 0) => {
                (self.idle, self.up_at) = (true, None);
                self.answer.push_back(IDLE);
            }
            (false, 8) => self.answer.extend([state, 0, 0, (argument >> 8) as u8 & 0xf, argument as u8]),
            (false, 55) => {
                self.application = true;
                self.answer.push_back(state);
            }
            (true, 41) => {
                let up_at = *self.up_at.get_or_insert(now + UP_US * self.cycles_us);
                self.idle = now < up_at;
                self.answer.push_back(if self.idle { IDLE } else { 0 });
            }
            // Powered up, of high capacity, 2.7 to 3.6 V.
            (false, 58) => self.answer.extend([state, 0xc0, 0xff, 0x80, 0]),
            (false, 17) if !self.idle => self.fetch(argument, now),
            (false, 25) if !self.idle => {
                self.wants = Wants::Start(u64::from(argument));
                self.answer.push_back(0);
            }
            _ => self.refuse(format!("the card's command {number} is not modelled as it is used")),
        }
    }

    fn refuse(&mut self, what: String) {
        self.unknown = Some(what);
    }

    fn fetch(&mut self, place: u32, now: u64) {
        let mut bytes = [0; BLOCK];
        let read = self.content.as_ref().map(|file| file.read_exact_at(&mut bytes, BLOCK as u64 * u64::from(place)));
        if !matches!(read, Some(Ok(()))) {
            return self.refuse(format!("the card has no block {place}"));
        }
        self.answer.push_back(0);
        self.found_at = now + FIND_US * self.cycles_us;
        self.block = [START].into_iter().chain(bytes).chain(crc16(&bytes).to_be_bytes()).collect();
    }

    fn program(&mut self, place: u64, bytes: &[u8], now: u64) {
        let written = self.content.as_ref().map(|file| file.write_all_at(bytes, BLOCK as u64 * place));
        if !matches!(written, Some(Ok(()))) {
            return self.refuse(format!("the card has no block {place}"));
        }
        self.programmed += 1;
        let Busy { usual_us, long_us, long_every } = self.busy;
        let long = long_every > 0 && self.programmed.is_multiple_of(long_every);
        self.busy_until = now + u64::from(if long { long_us } else { usual_us }) * self.cycles_us;
        self.answer.push_back(ACCEPTED);
    }
}

/// Of commands: x⁷ + x³ + 1.
fn crc7(bytes: &[u8]) -> u8 {
    let bits = bytes.iter().flat_map(|byte| (0..8).rev().map(move |n| byte >> n & 1));
    bits.fold(0, |crc, bit| (crc << 1 & 0x7f) ^ if crc >> 6 ^ bit != 0 { 0x09 } else { 0 })
}

/// Of blocks: x¹⁶ + x¹² + x⁵ + 1.
fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| crc << 1 ^ if crc >> 15 != 0 { 0x1021 } else { 0 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_the_specifications() {
        // Chapter 4.5: CMD0, CMD17, and a block of ones.
        assert_eq!(crc7(&[0x40, 0, 0, 0, 0]), 0x4a);
        assert_eq!(crc7(&[0x51, 0, 0, 0, 0]), 0x2a);
        assert_eq!(crc16(&[0xff; BLOCK]), 0x7fa1);
    }
}
