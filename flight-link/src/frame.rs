//! Frames: a record to bytes on a line, and back from any bytes.
use crc::{CRC_16_IBM_SDLC, Crc};
use postcard::ser_flavors::{Cobs, Slice, crc::CrcModifier};

use crate::Record;

/// Longest frame, with the 0 that ends it.
pub const FRAME_BYTES_MAX: usize = 128;

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
pub fn encode<'a>(record: &Record, place: &'a mut [u8]) -> Result<&'a [u8], EncodeError> {
    let end = place.len().min(FRAME_BYTES_MAX);
    let stuffed = Cobs::try_new(Slice::new(&mut place[..end])).map_err(|_| EncodeError)?;
    let checked = CrcModifier::new(stuffed, CRC.digest());
    postcard::serialize_with_flavor(record, checked).map(|frame: &'a mut [u8]| &*frame).map_err(|_| EncodeError)
}

/// Finds records in a stream of bytes.
#[derive(Clone, Debug)]
pub struct Decoder {
    /// What has come of a frame.
    bytes: [u8; FRAME_BYTES_MAX],
    count: usize,
    errors: u32,
}

impl Decoder {
    /// A decoder that has heard nothing.
    pub fn new() -> Self {
        Self { bytes: [0; FRAME_BYTES_MAX], count: 0, errors: 0 }
    }

    /// Takes in the next byte; returns the record that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Record> {
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

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// The record of a frame without its 0.
fn decode(frame: &mut [u8]) -> Option<Record> {
    let count = cobs::decode_in_place(frame).ok()?;
    postcard::de_flavors::crc::from_bytes_u16(frame.get(..count)?, CRC.digest()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::VisionPose;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn pose(age_us: u32, x_m: f32) -> Record {
        Record::VisionPose(VisionPose {
            age_us,
            position_m: [x_m, 0.0, -1.0],
            attitude: [1.0, 0.0, 0.0, 0.0],
            position_sigma_m: 0.001,
            attitude_sigma_rad: 0.002,
        })
    }

    fn frame(record: &Record) -> Vec<u8> {
        encode(record, &mut [0; FRAME_BYTES_MAX]).expect("it fits").to_vec()
    }

    fn hear(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Record> {
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
