//! The preamble: what flew, by name.
//!
//! ```text
//! fact      bytes of the name u8 │ name │ 0, bytes of the text u8, text    or    1, word u32
//! ```
//!
//! Names of parameters are in capitals, all others are not. Numbers are words too, by their bits. The words of `memory` follow each other, one a fact: when
//! the flight went on, µs, low word first, and what it remembered.
use super::{Block, COUNT_M_S2, COUNT_RAD_S, Kind};
use control_core::parameters::Parameters;
use control_core::restart::{Memory, WORDS as MEMORY_WORDS};

use crate::record::WORDS;

/// What is known of a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fact<'a> {
    /// A text.
    Text(&'a str),
    /// A number's bits, or a count.
    Word(u32),
}

/// The name of each word of what a flight went on from.
pub const MEMORY: &str = "memory";
/// Longest fact.
const FACT_BYTES: usize = 96;

/// A flight that went on after a reset in the air, before its first step.
#[derive(Clone, Debug, PartialEq)]
pub struct Resumed {
    /// When, as it was told, µs.
    pub at_us: u64,
    /// What it remembered.
    pub memory: Memory,
}

impl Resumed {
    /// Words of one.
    pub const WORDS: usize = 2 + MEMORY_WORDS;

    /// Of its words, if they are as many.
    pub fn from_words(words: &[u32]) -> Option<Self> {
        let (&[low, high], memory) = words.split_first_chunk()?;
        Some(Self { at_us: u64::from(high) << 32 | u64::from(low), memory: memory.try_into().ok()? })
    }

    fn words(&self) -> impl Iterator<Item = u32> {
        // Not by value: the iterator waits in RAM for its blocks to be written.
        [self.at_us as u32, (self.at_us >> 32) as u32].into_iter().chain(self.memory.iter().copied())
    }
}

/// What flew.
#[derive(Clone, Copy, Debug)]
pub struct Preamble<'a> {
    /// The image's version, and the commit of its sources.
    pub image: [&'a str; 2],
    /// The board.
    pub board: &'a str,
    /// What is flown with.
    pub parameters: &'a Parameters,
    /// What it went on from, if a reset in the air came before the first step.
    pub resumed: Option<&'a Resumed>,
}

impl Preamble<'_> {
    /// Its blocks, as many as it takes.
    pub fn blocks(&self) -> impl Iterator<Item = Block> {
        let [version, commit] = self.image;
        let facts = [
            ("image", Fact::Text(version)),
            ("commit", Fact::Text(commit)),
            ("board", Fact::Text(self.board)),
            ("record_words", Fact::Word(WORDS as u32)),
            ("rate_rad_s", Fact::Word(COUNT_RAD_S.to_bits())),
            ("force_m_s2", Fact::Word(COUNT_M_S2.to_bits())),
        ];
        let parameters = self.parameters.iter().map(|(known, value)| (known.name, Fact::Word(value.to_bits())));
        let memory =
            self.resumed.into_iter().flat_map(|resumed| resumed.words().map(|word| (MEMORY, Fact::Word(word))));
        let mut facts = facts.into_iter().chain(parameters).chain(memory).peekable();
        core::iter::from_fn(move || {
            let mut block = Block::new(Kind::Preamble);
            let mut place = [0; FACT_BYTES];
            while let Some(&(name, fact)) = facts.peek()
                && block.put(write(name, fact, &mut place))
            {
                facts.next();
            }
            (!block.is_empty()).then_some(block)
        })
    }
}

/// A fact's bytes; a text that is too long is cut.
fn write<'a>(name: &str, fact: Fact, place: &'a mut [u8; FACT_BYTES]) -> &'a [u8] {
    let mut at = 0;
    let mut put = |bytes: &[u8]| {
        let count = bytes.len().min(FACT_BYTES - at);
        place[at..at + count].copy_from_slice(&bytes[..count]);
        at += count;
    };
    put(&[name.len() as u8]);
    put(name.as_bytes());
    match fact {
        Fact::Text(text) => {
            // Whatever is longer was not written by this project's build.
            let text = &text.as_bytes()[..text.len().min(FACT_BYTES - 20)];
            put(&[0, text.len() as u8]);
            put(text);
        }
        Fact::Word(word) => {
            put(&[1]);
            put(&word.to_le_bytes());
        }
    }
    &place[..at]
}

/// The facts of a preamble block.
#[derive(Clone, Debug)]
pub struct Facts<'a>(&'a [u8]);

/// A block of facts ends within one, or holds something else: its checksum was right, so its writer was not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FactsError;

impl<'a> Facts<'a> {
    /// Of a block's content.
    pub fn new(content: &'a [u8]) -> Self {
        Self(content)
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn text(&mut self) -> Option<&'a str> {
        let count = *self.take(1)?.first()?;
        core::str::from_utf8(self.take(count.into())?).ok()
    }

    fn fact(&mut self) -> Option<(&'a str, Fact<'a>)> {
        let name = self.text()?;
        let fact = match self.take(1)? {
            [0] => Fact::Text(self.text()?),
            [1] => Fact::Word(u32::from_le_bytes(self.take(4)?.try_into().ok()?)),
            _ => return None,
        };
        Some((name, fact))
    }
}

impl<'a> Iterator for Facts<'a> {
    type Item = Result<(&'a str, Fact<'a>), FactsError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let fact = self.fact().ok_or(FactsError);
        if fact.is_err() {
            self.0 = &[];
        }
        Some(fact)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Opened, open};
    use super::*;
    use control_core::parameters::TABLE;
    use std::string::{String, ToString};
    use std::vec::Vec;

    #[test]
    fn a_preamble_says_what_flew_and_every_parameter() {
        let mut parameters = Parameters::default();
        parameters.set_at(3, TABLE[3].max).unwrap();
        let resumed = Resumed { at_us: 0x1_0000_0002, memory: core::array::from_fn(|n| 3 * n as u32) };
        let preamble =
            Preamble { image: ["0.1.0", "c0ffee"], board: "a board", parameters: &parameters, resumed: Some(&resumed) };
        let mut facts: Vec<(String, String)> = Vec::new();
        for (number, block) in (0..).zip(preamble.blocks()) {
            let bytes = block.sealed(number);
            let Opened { kind, content, .. } = open(&bytes).unwrap();
            assert_eq!(kind, Kind::Preamble);
            for fact in Facts::new(content) {
                let (name, fact) = fact.unwrap();
                let value = match fact {
                    Fact::Text(text) => text.to_string(),
                    Fact::Word(word) => std::format!("{word:08x}"),
                };
                facts.push((name.to_string(), value));
            }
        }
        let of = |name: &str| facts.iter().find(|(known, _)| known == name).map(|(_, value)| value.clone());
        assert_eq!(of("commit").as_deref(), Some("c0ffee"));
        assert_eq!(of("board").as_deref(), Some("a board"));
        let memory = facts.iter().filter(|(name, _)| name == MEMORY);
        let memory: Vec<u32> = memory.map(|(_, word)| u32::from_str_radix(word, 16).expect("a word")).collect();
        assert_eq!(memory.len(), Resumed::WORDS);
        assert_eq!(Resumed::from_words(&memory), Some(resumed));
        assert_eq!(Resumed::from_words(&memory[1..]), None);
        assert_eq!(of("rate_rad_s"), Some(std::format!("{:08x}", COUNT_RAD_S.to_bits())));
        for (known, value) in parameters.iter() {
            assert_eq!(of(known.name), Some(std::format!("{:08x}", value.to_bits())), "{}", known.name);
        }
    }

    #[test]
    fn facts_that_break_off_are_an_error_and_end() {
        let mut place = [0; FACT_BYTES];
        let whole = write("board", Fact::Text("a board"), &mut place);
        for count in 1..whole.len() {
            let facts: Vec<_> = Facts::new(&whole[..count]).collect();
            assert_eq!(facts, [Err(FactsError)], "{count} bytes");
        }
        assert_eq!(Facts::new(whole).collect::<Vec<_>>(), [Ok(("board", Fact::Text("a board")))]);
    }
}
