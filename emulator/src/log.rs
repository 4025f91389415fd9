//! The image's log: read from its RTT buffer as a probe would, decoded by the strings in the ELF.
//!
//! # Source
//! The layout of the control block is that of the crate `defmt-rtt`: a 16-byte name, two counts, then the first channel's
//! name, buffer, size, write index, read index and flags.
use crate::{Failure, Image, Machine};
use defmt_decoder::{DecodeError, Table};

/// What the control block begins with, once the image has set it up.
const NAME: &[u8] = b"SEGGER RTT\0";
/// Offsets in the control block.
const BUFFER: u32 = 28;
const SIZE: u32 = 32;
const WRITE: u32 = 36;
const READ: u32 = 40;

/// Reads and decodes a log.
pub struct Log {
    table: Table,
    control: u32,
    /// Bytes that do not make a whole line yet.
    rest: Vec<u8>,
}

impl Log {
    /// The log of an image.
    ///
    /// # Errors
    /// If it has none.
    pub fn new(image: &Image) -> Result<Self, Failure> {
        let table = Table::parse(&image.elf)
            .map_err(|error| Failure(error.to_string()))?
            .ok_or_else(|| Failure("the image has no defmt strings".to_owned()))?;
        Ok(Self { table, control: image.symbol("_SEGGER_RTT")?, rest: Vec::new() })
    }

    /// The lines written since the last call.
    ///
    /// # Errors
    /// If memory or a line is not as expected.
    pub fn lines(&mut self, machine: &mut Machine) -> Result<Vec<String>, Failure> {
        self.fetch(machine)?;
        let mut decoder = self.table.new_stream_decoder();
        decoder.received(&self.rest);
        let mut lines = Vec::new();
        loop {
            match decoder.decode() {
                Ok(frame) => lines.push(frame.display(false).to_string()),
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) if self.table.encoding().can_recover() => {
                    lines.push("(a line that cannot be read)".to_owned());
                }
                Err(DecodeError::Malformed) => return Err(Failure("the log cannot be read".to_owned())),
            }
        }
        // What the decoder still holds begins after the last end of a frame.
        let whole = self.rest.iter().rposition(|&byte| byte == 0).map_or(0, |end| end + 1);
        self.rest.drain(..whole);
        Ok(lines)
    }

    /// Takes what is in the buffer, and tells the image so.
    fn fetch(&mut self, machine: &mut Machine) -> Result<(), Failure> {
        let [buffer, size, write, read] = [BUFFER, SIZE, WRITE, READ].map(|at| machine.word(self.control + at));
        let (buffer, size, write, read) = (buffer?, size?, write?, read?);
        // Before the image has started, RAM is anything.
        let there = machine.memory(self.control, NAME.len())? == NAME;
        if !there || size == 0 || write == read {
            return Ok(());
        }
        let bytes = machine.memory(buffer, size as usize)?;
        let at = |index: u32| index.min(size) as usize;
        if write > read {
            self.rest.extend_from_slice(&bytes[at(read)..at(write)]);
        } else {
            self.rest.extend_from_slice(&bytes[at(read)..]);
            self.rest.extend_from_slice(&bytes[..at(write)]);
        }
        machine.set_word(self.control + READ, write)
    }
}
