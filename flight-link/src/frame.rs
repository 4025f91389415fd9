//! Frames: a record to bytes on a line, and back from any bytes.
use core::marker::PhantomData;

use crc::{CRC_16_IBM_SDLC, Crc};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Longest frame, with the 0 that ends it.
pub const FRAME_BYTES_MAX: usize = 144;
/// Longest record: a frame has two bytes of checksum more, one of stuffing, and the 0.
const RECORD_BYTES_MAX: usize = FRAME_BYTES_MAX - 4;

static CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_SDLC);

/// A record longer than [`FRAME_BYTES_MAX`], or than the place for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

impl core::fmt::Display for EncodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "a record does not fit into its frame")
    }
}

impl core::error::Error for EncodeError {}

/// The checksum that frames have, of any bytes.
pub fn checksum(bytes: &[u8]) -> u16 {
    CRC.checksum(bytes)
}

/// Writes a record's frame into `place`; returns it.
///
/// # Errors
/// If `place` is too short.
pub fn encode<'a>(record: &impl Serialize, place: &'a mut [u8]) -> Result<&'a [u8], EncodeError> {
    let mut bytes = [0; RECORD_BYTES_MAX + 2];
    let [room @ .., _, _] = &mut bytes;
    // Not in one go with checksum and stuffing: that costs 6 KB of code.
    let count = postcard::to_slice(record, room).map_err(|_| EncodeError)?.len();
    seal(&mut bytes, count, place)
}

/// Appends the checksum to the first `count` bytes and stuffs them into `place`.
fn seal<'a>(
    bytes: &mut [u8; RECORD_BYTES_MAX + 2],
    count: usize,
    place: &'a mut [u8],
) -> Result<&'a [u8], EncodeError> {
    let (record, rest) = bytes.split_at_mut_checked(count).ok_or(EncodeError)?;
    let checksum = checksum(record).to_le_bytes();
    rest.get_mut(..2).ok_or(EncodeError)?.copy_from_slice(&checksum);
    let checked = bytes.get(..count + 2).ok_or(EncodeError)?;
    let stuffed = cobs::try_encode(checked, place).map_err(|_| EncodeError)?;
    // The 0 that ends it.
    let end = place.get_mut(stuffed).ok_or(EncodeError)?;
    *end = 0;
    place.get(..=stuffed).ok_or(EncodeError)
}

/// Finds records of one direction, [`crate::ToBoard`] or [`crate::FromBoard`], in a stream of bytes.
#[derive(Clone, Debug)]
pub struct Decoder<R> {
    /// What has come of a frame.
    bytes: [u8; FRAME_BYTES_MAX],
    count: usize,
    errors: u32,
    of: PhantomData<R>,
}

impl<R: DeserializeOwned> Decoder<R> {
    /// A decoder that has heard nothing.
    pub fn new() -> Self {
        Self { bytes: [0; FRAME_BYTES_MAX], count: 0, errors: 0, of: PhantomData }
    }

    /// Takes in the next byte; returns the record that it completes.
    pub fn push(&mut self, byte: u8) -> Option<R> {
        if byte != 0 {
            // One beyond the longest marks a frame that is too long, however long.
            if let Some(place) = self.bytes.get_mut(self.count) {
                *place = byte;
            }
            self.count = (self.count + 1).min(FRAME_BYTES_MAX + 1);
            return None;
        }
        let count = core::mem::take(&mut self.count);
        let record = self.bytes.get_mut(..count).and_then(decode);
        // Zeros between frames are no frames.
        self.errors = self.errors.saturating_add((record.is_none() && count > 0).into());
        record
    }

    /// Frames that had to be thrown away.
    pub fn errors(&self) -> u32 {
        self.errors
    }
}

impl<R: DeserializeOwned> Default for Decoder<R> {
    fn default() -> Self {
        Self::new()
    }
}

/// The record of a frame without its 0.
fn decode<R: DeserializeOwned>(frame: &mut [u8]) -> Option<R> {
    postcard::from_bytes(unseal(frame)?).ok()
}

/// The bytes of a frame's record, if its checksum is right.
fn unseal(frame: &mut [u8]) -> Option<&[u8]> {
    let count = cobs::decode_in_place(frame).ok()?;
    let (record, checksum) = frame.get(..count)?.split_last_chunk()?;
    (self::checksum(record).to_le_bytes() == *checksum).then_some(record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FromBoard, LogPart, Motion, Rotors, Status, ToBoard, VisionPose, Wiring};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn pose(age_us: u32, x_m: f32) -> ToBoard {
        ToBoard::VisionPose(VisionPose {
            age_us,
            position_m: [x_m, 0.0, -1.0],
            attitude: [1.0, 0.0, 0.0, 0.0],
            position_sigma_m: 0.001,
            attitude_sigma_rad: 0.002,
        })
    }

    fn frame(record: &ToBoard) -> Vec<u8> {
        encode(record, &mut [0; FRAME_BYTES_MAX]).expect("it fits").to_vec()
    }

    fn hear(decoder: &mut Decoder<ToBoard>, bytes: &[u8]) -> Vec<ToBoard> {
        bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
    }

    #[test]
    fn a_frame_has_one_zero_at_its_end_and_four_bytes_more_than_its_record() {
        let record = pose(10_000, 1.5);
        let bytes = frame(&record);
        assert_eq!(bytes.iter().position(|&byte| byte == 0), Some(bytes.len() - 1));
        // Its kind, two bytes of age, nine numbers; two of checksum, one of stuffing, and the zero.
        assert_eq!(bytes.len(), 1 + 2 + 36 + 4);
        assert_eq!(hear(&mut Decoder::new(), &bytes), [record]);
    }

    #[test]
    fn a_record_that_does_not_fit_is_refused() {
        for room in 0..43 {
            assert_eq!(encode(&pose(10_000, 1.5), &mut [0; 43][..room]), Err(EncodeError), "{room} bytes");
        }
    }

    #[test]
    fn a_frame_with_a_wrong_bit_is_dropped_and_the_next_one_heard() {
        let good = frame(&pose(1, 2.0));
        // But for the zero at the end, without which two frames are one.
        for bit in 0..8 * (good.len() - 1) {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            bad.extend(&good);
            let mut decoder = Decoder::new();
            assert_eq!(hear(&mut decoder, &bad), [pose(1, 2.0)], "bit {bit}");
            assert!(decoder.errors() >= 1, "bit {bit}");
        }
    }

    #[test]
    fn the_longest_records_fit_and_are_read_as_they_were_said() {
        let status = Status {
            time_us: u64::MAX,
            armed: true,
            landed: true,
            aim: 9,
            mode: 9,
            failsafes: u32::MAX,
            failing: u32::MAX,
            wiring: Wiring::AnswersAs { told: 3, answers: 4 },
            bench: true,
            battery_v: 16.8,
            battery_a: 21.5,
            used_as: 1_800.0,
            steps: u32::MAX,
            late: u32::MAX,
            load: 0.5,
            step_us_max: u32::MAX,
            dropped: u32::MAX,
        };
        let motion = Motion {
            time_us: u64::MAX,
            attitude_rad: [1.0; 3],
            rate_rad_s: [2.0; 3],
            position_m: [3.0; 3],
            velocity_m_s: [4.0; 3],
            health: 0x3f,
        };
        let rotors = Rotors { time_us: u64::MAX, speeds: [0.5; 4], believed: [0.25; 4] };
        let part = FromBoard::LogPart(LogPart { number: u32::MAX, bytes: [[0xa5; 32]; 4] });
        for record in [FromBoard::Status(status), FromBoard::Motion(motion), FromBoard::Rotors(rotors), part] {
            let mut decoder = Decoder::new();
            let bytes = encode(&record, &mut [0; FRAME_BYTES_MAX]).expect("it fits").to_vec();
            let heard: Vec<FromBoard> = bytes.iter().filter_map(|&byte| decoder.push(byte)).collect();
            assert_eq!(heard, [record]);
        }
    }

    proptest! {
        #[test]
        fn after_any_noise_and_a_zero_records_are_heard(noise: Vec<u8>, age_us: u32, x_m: f32) {
            prop_assume!(!x_m.is_nan());
            let record = pose(age_us, x_m);
            let mut bytes = noise;
            bytes.push(0);
            bytes.extend(frame(&record));
            let heard = hear(&mut Decoder::new(), &bytes);
            prop_assert_eq!(heard.last(), Some(&record));
        }
    }
}
