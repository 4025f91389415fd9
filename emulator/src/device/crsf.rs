//! A radio receiver: the frames it sends.
//!
//! # Source
//! TBS, "CRSF protocol", frame type 0x16 "RC channels packed payload"; its checksum is CRC-8 with polynomial 0xD5.

/// The frame that tells these channels, eleven bits each.
pub(crate) fn frame(channels: [u16; 16]) -> Vec<u8> {
    // To the flight controller; bytes that follow; type.
    let mut bytes = vec![0xc8, 24, 0x16];
    let (mut held, mut bits) = (0_u32, 0);
    for channel in channels {
        held |= u32::from(channel & 0x7ff) << bits;
        bits += 11;
        while bits >= 8 {
            bytes.push(held as u8);
            held >>= 8;
            bits -= 8;
        }
    }
    bytes.push(checksum(&bytes[2..]));
    bytes
}

fn checksum(bytes: &[u8]) -> u8 {
    let bit = |sum: u8, _: u8| if sum & 0x80 == 0 { sum << 1 } else { sum << 1 ^ 0xd5 };
    bytes.iter().fold(0, |sum, byte| (0..8).fold(sum ^ byte, bit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_26_bytes_with_the_lowest_bits_first() {
        let mut channels = [0; 16];
        (channels[0], channels[1]) = (0x7ff, 0x001);
        let bytes = frame(channels);
        assert_eq!(bytes.len(), 26);
        assert_eq!(bytes[..6], [0xc8, 24, 0x16, 0xff, 0x0f, 0x00]);
        // The check value of CRC-8/DVB-S2.
        assert_eq!(checksum(b"123456789"), 0xbc);
    }
}
