//! Starts: the logs in one file, one after the other, as the board has filled it.
use super::ReplayError;
use firmware::flight_log::{BLOCK_BYTES, Kind, Opened, open};
use std::io::Read;

/// The log of one start of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// Where it begins.
    pub offset: u64,
    /// How long it is.
    pub bytes: u64,
}

/// The logs in a file, until a block of zeros: that part was never written. What comes before the first is part of it.
///
/// # Errors
/// If the file cannot be read, or there is none in it.
pub fn starts(log: &mut impl Read) -> Result<Vec<Start>, ReplayError> {
    let mut all: Vec<Start> = Vec::new();
    let mut offset = 0;
    loop {
        let mut bytes = [0; BLOCK_BYTES];
        let count = super::fill(log, &mut bytes)?;
        if bytes == [0; BLOCK_BYTES] {
            break;
        }
        let begins = matches!(open(&bytes), Ok(Opened { kind: Kind::Preamble, number: 0, .. }));
        match all.last_mut() {
            Some(last) if !begins => last.bytes += count as u64,
            _ => all.push(Start { offset, bytes: count as u64 }),
        }
        offset += count as u64;
    }
    if all.is_empty() { Err(ReplayError::Empty) } else { Ok(all) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::flight_log::Block;

    #[test]
    fn a_file_is_told_apart_into_its_starts_and_ends_where_nothing_was_written() {
        let block = |kind, number| {
            let mut block = Block::new(kind);
            block.put(&[7; 20]);
            block.sealed(number)
        };
        let (begin, step) = (block(Kind::Preamble, 0), block(Kind::Steps, 2));
        let torn = [b'Q'; BLOCK_BYTES];
        let file = [begin, block(Kind::Preamble, 1), step, torn, begin, step, [0; BLOCK_BYTES], step].concat();
        let size = BLOCK_BYTES as u64;
        let [first, second] = [Start { offset: 0, bytes: 4 * size }, Start { offset: 4 * size, bytes: 2 * size }];
        assert_eq!(starts(&mut &*file).unwrap(), [first, second]);
        assert_eq!(starts(&mut &file[..5 * BLOCK_BYTES + 9]).unwrap(), [first, Start { bytes: size + 9, ..second }]);
        for empty in [&[][..], &[0; 2 * BLOCK_BYTES]] {
            assert!(matches!(starts(&mut &*empty), Err(ReplayError::Empty)));
        }
    }
}
