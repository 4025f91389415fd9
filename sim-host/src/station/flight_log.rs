//! The flight logs in a board's flash chip: found, fetched and erased over its line.
//!
//! ```text
//! last block: number n of its log ─► that log begins n blocks before ─► the block before that is the last of another log ─► …
//! ```
//!
//! A block that is torn has no number: its log ends before it, and it belongs to that. Parts come in order, as fast as the line takes them;
//! where one is missing when no more come, what is left is asked for again from there on.
use super::{Station, StationError};
use firmware::flight_log::{BLOCK_BYTES, open};
use flight_link::{FromBoard, LogPart, LogRefusal, LogSize, LogWish, PART_BYTES, ToBoard};
use std::ops::Range;
use std::time::{Duration, Instant};

/// How long no part may come before what is missing is asked for again: the board erases nothing meanwhile, and writes for milliseconds.
const SILENCE: Duration = Duration::from_millis(500);
/// How often that may happen in a row without one part that was missing.
const TRIES: u32 = 6;
/// Blocks that are asked for at once.
const AT_ONCE: u32 = 64;
/// How long a sector of the chip may take to be erased, and a board that reads another wish until then.
const ERASING: Duration = Duration::from_secs(4);

type Block = [u8; BLOCK_BYTES];

impl Station {
    /// How much is in the board's flash chip.
    ///
    /// # Errors
    /// If it has none, is armed, or does not answer.
    pub fn log_size(&mut self) -> Result<LogSize, StationError> {
        self.ask(&ToBoard::Log(LogWish::Size), super::PATIENCE, size)?
    }

    /// The logs in it, the oldest first, as blocks from the first to behind the last of each. What belongs to none is left out.
    ///
    /// # Errors
    /// As [`Self::log_size`]; or if the line is too bad.
    pub fn logs(&mut self) -> Result<(LogSize, Vec<Range<u32>>), StationError> {
        let size = self.log_size()?;
        let (mut end, mut last, mut logs) = (size.used, size.used, Vec::new());
        while let Some(block) = last.checked_sub(1) {
            let bytes = self.read_log(block..last, &mut |_| {})?;
            last = block;
            let Some(begin) = bytes.first().and_then(|bytes| open(bytes).ok()).map(|opened| opened.number) else {
                continue;
            };
            let Some(begin) = block.checked_sub(begin) else { continue };
            logs.push(begin..end);
            (end, last) = (begin, begin);
        }
        logs.reverse();
        Ok((size, logs))
    }

    /// Fetches blocks; `progress` is told how many have come.
    ///
    /// # Errors
    /// If the board refuses, or the line is too bad.
    pub fn read_log(&mut self, blocks: Range<u32>, progress: &mut dyn FnMut(u32)) -> Result<Vec<Block>, StationError> {
        let mut fetched = Vec::new();
        let mut next = blocks.start;
        while next < blocks.end {
            let end = blocks.end.min(next + AT_ONCE);
            fetched.extend(self.read_some(next..end)?);
            next = end;
            progress(next - blocks.start);
        }
        Ok(fetched)
    }

    /// Fetches as many blocks as are asked for at once.
    fn read_some(&mut self, blocks: Range<u32>) -> Result<Vec<Block>, StationError> {
        let parts = (BLOCK_BYTES / PART_BYTES) as u32;
        let mut came: Vec<Option<[u8; PART_BYTES]>> = vec![None; (blocks.len() as u32 * parts) as usize];
        let mut tries = 0;
        while let Some(missing) = came.iter().position(Option::is_none) {
            if tries == TRIES {
                return Err(StationError::Silent);
            }
            let first = blocks.start + missing as u32 / parts;
            self.say(&ToBoard::Log(LogWish::Read(first, (blocks.end - first) as u16)))?;
            tries += 1;
            let mut heard = Instant::now();
            while heard.elapsed() < SILENCE && came.iter().any(Option::is_none) {
                match self.listen()? {
                    Some(FromBoard::LogPart(LogPart { number, bytes })) => {
                        heard = Instant::now();
                        let place =
                            number.checked_sub(blocks.start * parts).and_then(|place| came.get_mut(place as usize));
                        let Some(place) = place.filter(|place| place.is_none()) else { continue };
                        *place = bytes.as_flattened().try_into().ok();
                        tries = 0;
                        // After the last there is nothing to wait for.
                        if number + 1 == blocks.end * parts {
                            break;
                        }
                    }
                    Some(FromBoard::LogRefused(refusal)) => return Err(refused(refusal)),
                    _ => {}
                }
            }
        }
        let parts: Vec<u8> = came.into_iter().flatten().flatten().collect();
        Ok(parts.as_chunks().0.to_vec())
    }

    /// Erases all; `progress` is told how many blocks are left.
    ///
    /// # Errors
    /// If the board refuses, falls silent, or ends it because a motor may turn.
    pub fn erase_log(&mut self, progress: &mut dyn FnMut(u32)) -> Result<(), StationError> {
        let mut left = self.ask(&ToBoard::Log(LogWish::Erase), ERASING, size)??.used;
        let mut heard = Instant::now();
        while left > 0 {
            if heard.elapsed() > ERASING {
                return Err(StationError::Lost);
            }
            progress(left);
            let Some(said) = self.listen()?.and_then(size) else { continue };
            heard = Instant::now();
            left = said?.used;
        }
        Ok(())
    }
}

/// Finds the answer to what is wished of the log.
fn size(record: FromBoard) -> Option<Result<LogSize, StationError>> {
    match record {
        FromBoard::LogSize(size) => Some(Ok(size)),
        FromBoard::LogRefused(refusal) => Some(Err(refused(refusal))),
        _ => None,
    }
}

/// Why nothing of a log is said, or erased, for people.
fn refused(why: LogRefusal) -> StationError {
    StationError::Log(match why {
        LogRefusal::Armed => "not while it is armed or a rotor turns",
        LogRefusal::Absent => "the board has no flight log in a flash chip; one on a card is read with the card",
    })
}

#[cfg(all(test, unix))]
mod tests {
    use super::super::tests::line;
    use super::*;
    use firmware::flight_log::{Block as Sealing, Kind};
    use flight_link::VERSION;
    use std::sync::atomic::{AtomicU32, Ordering};

    /// Blocks of two logs with a torn one between them, and of a third that is being written.
    fn blocks() -> Vec<Block> {
        let log = |count| (0..count).map(|number| Sealing::new(Kind::Steps).sealed(number));
        log(70).chain([[0x5a; BLOCK_BYTES]]).chain(log(3)).chain(log(2)).collect()
    }

    /// A board with these that loses one part in so many.
    fn board(loses: u32) -> impl Fn(ToBoard) -> Vec<FromBoard> {
        let (blocks, said) = (blocks(), AtomicU32::new(0));
        move |record| match record {
            ToBoard::Hello => vec![FromBoard::Hello(VERSION)],
            ToBoard::Log(LogWish::Size) => {
                let used = blocks.len() as u32;
                vec![FromBoard::LogSize(LogSize { used, room: 99, running: used - 2 })]
            }
            ToBoard::Log(LogWish::Read(first, count)) => {
                let parts = blocks.as_flattened().as_chunks::<PART_BYTES>().0;
                let wished = (first * 4..(first + u32::from(count)) * 4).zip(&parts[first as usize * 4..]);
                let kept = wished.filter(|_| !(said.fetch_add(1, Ordering::Relaxed) + 1).is_multiple_of(loses));
                let rows = |part: &[u8; PART_BYTES]| *part.as_chunks().0.first_chunk().expect("four rows");
                kept.map(|(number, part)| FromBoard::LogPart(LogPart { number, bytes: rows(part) })).collect()
            }
            ToBoard::Log(LogWish::Erase) => {
                [2, 1, 0].map(|used| FromBoard::LogSize(LogSize { used, room: 99, running: used })).to_vec()
            }
            _ => vec![FromBoard::LogRefused(LogRefusal::Absent)],
        }
    }

    #[test]
    fn logs_are_found_and_fetched_whole_over_a_line_that_loses_one_part_in_fifty() {
        let (name, _far) = line(board(50));
        let mut station = Station::open(&name, 115_200).expect("it answers");
        let (size, logs) = station.logs().expect("they are told");
        assert_eq!((size.running, logs), (74, vec![0..71, 71..74, 74..76]));
        let mut told = Vec::new();
        let fetched = station.read_log(0..76, &mut |count| told.push(count)).expect("all comes");
        assert!(fetched == blocks());
        assert_eq!(told, [64, 76]);
        let mut left = Vec::new();
        station.erase_log(&mut |blocks| left.push(blocks)).expect("it is erased");
        assert_eq!((left.first(), left.last()), (Some(&2), Some(&1)));
    }

    #[test]
    fn a_line_that_loses_every_part_is_given_up() {
        let (name, _far) = line(board(1));
        let mut station = Station::open(&name, 115_200).expect("it answers");
        let refused = station.read_log(0..2, &mut |_| {}).expect_err("nothing comes").to_string();
        assert!(refused.starts_with("no answer within"), "{refused}");
    }
}
