//! CRSF: the radio receiver's frames to the pilot's channels.
//!
//! ```text
//! position = (ticks − 992) / 820
//! ```
//!
//! Frames are found and checked by `uf-crsf`; one with a bad checksum is dropped and counted. 172 to 1811 ticks are −1 to 1.
//!
//! # Source
//! TBS, "CRSF protocol", frame type 0x16 "RC channels packed payload".
use uf_crsf::CrsfParser;
use uf_crsf::packets::{CrsfPacket, RcChannelsPacked};

/// Bits a second on the line.
pub const BAUD: u32 = 420_000;

/// Sticks and switches, each −1 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channels(pub [f32; 16]);

/// Turns bytes into channels.
#[derive(Debug)]
pub struct Receiver {
    parser: CrsfParser,
    errors: u32,
}

impl Receiver {
    /// A receiver that has heard nothing.
    pub fn new() -> Self {
        Self { parser: CrsfParser::new(), errors: 0 }
    }

    /// Takes in bytes as they come; returns the newest channels that they complete.
    pub fn push(&mut self, mut bytes: &[u8]) -> Option<Channels> {
        let mut newest = None;
        // Of all the kinds of frames only one is decoded: the others' decoders would only take flash.
        while let Some(frame) = self.parser.next_raw_packet(&mut bytes) {
            let Ok(frame) = frame else {
                self.errors = self.errors.saturating_add(1);
                continue;
            };
            if frame.raw_packet_type() == RcChannelsPacked::PACKET_TYPE as u8
                && let Ok(channels) = RcChannelsPacked::from_bytes(frame.payload())
            {
                newest = Some(Channels(channels.0.map(position)));
            }
        }
        newest
    }

    /// Bytes and frames that had to be thrown away.
    pub fn errors(&self) -> u32 {
        self.errors
    }
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

fn position(ticks: u16) -> f32 {
    ((f32::from(ticks) - 992.0) / 820.0).clamp(-1.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// A frame of channels, its checksum by the polynomial 0xD5.
    fn frame(ticks: [u16; 16]) -> Vec<u8> {
        let mut bytes = std::vec![0xc8, 24, 0x16];
        let (mut held, mut bits) = (0_u32, 0);
        for value in ticks {
            held |= u32::from(value) << bits;
            bits += 11;
            while bits >= 8 {
                bytes.push(held as u8);
                held >>= 8;
                bits -= 8;
            }
        }
        let sum = bytes[2..].iter().fold(0_u8, |sum, byte| {
            (0..8).fold(sum ^ byte, |sum, _| if sum & 0x80 == 0 { sum << 1 } else { sum << 1 ^ 0xd5 })
        });
        bytes.push(sum);
        bytes
    }

    #[test]
    fn channels_come_out_as_they_went_in_however_they_are_cut() {
        let mut ticks = [992; 16];
        (ticks[0], ticks[4], ticks[15]) = (172, 1_811, 1_402);
        let bytes = frame(ticks);
        for cut in 0..bytes.len() {
            let mut receiver = Receiver::new();
            let first = receiver.push(&bytes[..cut]);
            let channels = first.or(receiver.push(&bytes[cut..])).unwrap();
            assert!((channels.0[0] + 1.0).abs() < 1e-3 && (channels.0[4] - 0.999).abs() < 1e-3);
            assert!((channels.0[15] - 0.5).abs() < 1e-6 && channels.0[1] == 0.0);
            assert_eq!(receiver.errors(), 0);
        }
    }

    #[test]
    fn a_frame_with_a_wrong_bit_is_dropped_and_the_next_one_heard() {
        let good = frame([992; 16]);
        // But for the first byte, an address, which the checksum leaves out.
        for bit in 8..8 * good.len() {
            let mut receiver = Receiver::new();
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(receiver.push(&bad), None, "bit {bit}");
            // A wrong length may swallow one frame more before the line is understood again.
            let heard: Vec<_> = (0..4).filter_map(|_| receiver.push(&good)).collect();
            assert!(!heard.is_empty(), "bit {bit}");
        }
    }
}
