//! UBX: what a u-blox receiver of the ninth or tenth generation is told, and its fixes.
//!
//! Frames from it are found and checked by `ublox`. The receiver is set up in two messages: one that it understands at
//! whatever speed it has, which sets [`BAUD`], and then the rest, which it acknowledges.
//!
//! Only what is asked for is decoded, and a frame that claims to be longer than any of it is none: so after noise no more
//! than one fix is lost.
//!
//! # Source
//! u-blox, "M10 SPG 5.10 interface description": 3.10.5 UBX-CFG-VALSET, 3.15.11 UBX-NAV-PVT, 4.9 for the keys.
use control_core::frames::Vec3;
use control_core::geodesy::{Geodetic, LocalFrame};
use control_core::measurement::Gnss;
use heapless::Vec;
use ublox::nav_pvt::common::NavPvtFlags;
use ublox::nav_pvt::proto33::NavPvtRef;
use ublox::packets::cfg_val::CfgValSet;
use ublox::proto33::{PacketRef, Proto33};
use ublox::{FixedBuffer, GnssFixType, Parser, ParserError, UbxPacket, UbxProtocol};

/// Bits a second on the line, once the receiver is set up.
pub const BAUD: u32 = 115_200;
/// Speeds that receivers are delivered with, the likeliest first.
pub const BAUDS: [u32; 3] = [BAUD, 38_400, 9_600];
/// Time between fixes, ms.
pub const PERIOD_MS: u16 = 100;
/// How old a fix is when its last byte has come, µs: what the receiver takes to work it out (docs/sensors.md), and 100 bytes.
pub const AGE_US: u64 = 120_000 + 1_000_000 * 1_000 / BAUD as u64;

/// Longest message to the receiver.
const MESSAGE_BYTES_MAX: usize = 64;
/// Longest payload that is decoded: NAV-PVT.
const PAYLOAD_BYTES_MAX: u16 = 92;

/// Sync, class and number of UBX-CFG-VALSET.
const HEADER: [u8; 4] = [0xb5, 0x62, 0x06, 0x8a];
/// Version 0, to RAM: the receiver forgets when it is switched off.
const TO_RAM: [u8; 4] = [0, 1, 0, 0];

/// A message to the receiver.
pub type Message = Vec<u8, MESSAGE_BYTES_MAX>;

/// Sets the line's speed to [`BAUD`].
pub fn speed() -> Message {
    // CFG-UART1-BAUDRATE.
    set(&[(0x4052_0001, &BAUD.to_le_bytes())])
}

/// Asks for fixes and nothing else, in UBX, every [`PERIOD_MS`], for what flies; of GPS and Galileo, corrected by SBAS where it reaches.
///
/// As delivered, a receiver of the tenth generation takes BeiDou in as well, and works out 3 fixes a second, not 10 (docs/sensors.md).
pub fn setup() -> Message {
    set(&[
        // CFG-UART1OUTPROT-NMEA, -UBX.
        (0x1074_0002, &[0]),
        (0x1074_0001, &[1]),
        // CFG-RATE-MEAS.
        (0x3021_0001, &PERIOD_MS.to_le_bytes()),
        // CFG-NAVSPG-DYNMODEL: airborne, below 4 g.
        (0x2011_0021, &[8]),
        // CFG-SIGNAL-SBAS_ENA, -BDS_ENA.
        (0x1031_0020, &[1]),
        (0x1031_0022, &[0]),
        // CFG-MSGOUT-UBX_NAV_PVT_UART1: every one.
        (0x2091_0007, &[1]),
    ])
}

/// UBX-CFG-VALSET with these keys and values. Not by `ublox`: its match over all keys is 16 KB of flash.
fn set(values: &[(u32, &[u8])]) -> Message {
    let payload = TO_RAM.len() + values.iter().map(|(_, value)| 4 + value.len()).sum::<usize>();
    let mut message: Message = HEADER.into_iter().chain((payload as u16).to_le_bytes()).chain(TO_RAM).collect();
    for (key, value) in values {
        message.extend(key.to_le_bytes());
        message.extend(value.iter().copied());
    }
    let (a, b) = message[2..].iter().fold((0_u8, 0_u8), |(a, b), byte| {
        let a = a.wrapping_add(*byte);
        (a, b.wrapping_add(a))
    });
    message.extend([a, b]);
    message
}

/// What the receiver says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Heard {
    /// It has done what it was told.
    Acknowledged,
    /// Where it is.
    Fix(Gnss),
}

/// The frames that are decoded.
struct Wanted;

impl UbxProtocol for Wanted {
    type PacketRef<'a> = PacketRef<'a>;
    const MAX_PAYLOAD_LEN: u16 = PAYLOAD_BYTES_MAX;

    fn match_packet(class: u8, id: u8, payload: &[u8]) -> Result<PacketRef<'_>, ParserError> {
        match (class, id) {
            // One by one, so that the linker leaves the other decoders out.
            (0x05, 0x01) => Proto33::match_packet(0x05, 0x01, payload),
            (0x01, 0x07) => Proto33::match_packet(0x01, 0x07, payload),
            _ => Err(ParserError::InvalidField { packet: "unwanted", field: "class" }),
        }
    }
}

/// Turns bytes into what the receiver says.
pub struct Receiver {
    parser: Parser<FixedBuffer<256>, Wanted>,
    /// Where home is, once there was a fix.
    home: Option<LocalFrame>,
    errors: u32,
}

impl Receiver {
    /// A receiver that has said nothing; home is where its first fix is.
    pub fn new() -> Self {
        Self::at(None)
    }

    /// The same with a home that is known, or not.
    pub fn at(home: Option<LocalFrame>) -> Self {
        Self { parser: Parser::new(FixedBuffer::new()), home, errors: 0 }
    }

    /// Where home is, once it is known.
    pub fn home(&self) -> Option<&LocalFrame> {
        self.home.as_ref()
    }

    /// Takes in bytes as they come; returns the newest that they complete.
    pub fn push(&mut self, bytes: &[u8]) -> Option<Heard> {
        let mut newest = None;
        let mut packets = self.parser.consume_ubx(bytes);
        while let Some(packet) = packets.next() {
            match packet {
                Ok(UbxPacket::Proto33(PacketRef::AckAck(ack))) if ack.is_ack_for::<CfgValSet>() => {
                    newest = Some(Heard::Acknowledged);
                }
                Ok(UbxPacket::Proto33(PacketRef::NavPvt(fix))) => {
                    newest = gnss(&fix, &mut self.home).map(Heard::Fix).or(newest);
                }
                Ok(_) => {}
                Err(_) => self.errors = self.errors.saturating_add(1),
            }
        }
        newest
    }

    /// Frames that had to be thrown away.
    pub fn errors(&self) -> u32 {
        self.errors
    }
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

/// A fix as the estimator wants it; home is where the first one is, and before it there is none.
fn gnss(fix: &NavPvtRef<'_>, home: &mut Option<LocalFrame>) -> Option<Gnss> {
    let milli = |value: i32| value as f32 / 1_000.0;
    let fixed = fix.fix_type() == GnssFixType::Fix3D && fix.flags().contains(NavPvtFlags::GPS_FIX_OK);
    let place = Geodetic {
        latitude_e7: fix.latitude_raw(),
        longitude_e7: fix.longitude_raw(),
        altitude_m: milli(fix.height_above_ellipsoid_raw()),
    };
    if home.is_none() && fixed {
        *home = LocalFrame::try_new(place).ok();
    }
    Some(Gnss {
        position_m: (*home)?.to_ned(&place).ok()?,
        velocity_m_s: Vec3::new(milli(fix.vel_north_raw()), milli(fix.vel_east_raw()), milli(fix.vel_down_raw())),
        horizontal_m: fix.horizontal_accuracy_raw() as f32 / 1_000.0,
        vertical_m: fix.vertical_accuracy_raw() as f32 / 1_000.0,
        speed_m_s: fix.speed_accuracy_raw() as f32 / 1_000.0,
        fixed,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame around a payload, its checksum by Fletcher.
    fn frame(class: u8, id: u8, payload: &[u8]) -> std::vec::Vec<u8> {
        let mut bytes = std::vec![0xb5, 0x62, class, id, payload.len() as u8, 0];
        bytes.extend(payload);
        let (a, b) = bytes[2..].iter().fold((0_u8, 0_u8), |(a, b), byte| {
            let a = a.wrapping_add(*byte);
            (a, b.wrapping_add(a))
        });
        bytes.extend([a, b]);
        bytes
    }

    /// NAV-PVT, `north_e7` north of a place in Bavaria.
    fn fix(north_e7: i32, kind: u8) -> std::vec::Vec<u8> {
        let mut payload = [0; 92];
        (payload[20], payload[21], payload[23]) = (kind, 1, 14);
        for (at, value) in [
            (24, 115_678_901),
            (28, 481_234_567 + north_e7),
            (32, 450_000),
            (40, 1_300),
            (44, 1_900),
            (48, 250),
            (52, -500),
            (56, 125),
            (68, 50),
        ] {
            payload[at..at + 4].copy_from_slice(&i32::to_le_bytes(value));
        }
        frame(0x01, 0x07, &payload)
    }

    fn hear(receiver: &mut Receiver, bytes: &[u8]) -> Option<Gnss> {
        receiver.push(bytes).map(|heard| if let Heard::Fix(fix) = heard { fix } else { panic!("{heard:?}") })
    }

    #[test]
    fn the_messages_are_the_manuals_bytes() {
        let head = [0x00, 0x01, 0x00, 0x00];
        let speed = [&head[..], &[0x01, 0x00, 0x52, 0x40, 0x00, 0xc2, 0x01, 0x00]].concat();
        assert_eq!(super::speed()[..], frame(0x06, 0x8a, &speed));
        let setup = [
            &head[..],
            &[0x02, 0x00, 0x74, 0x10, 0],
            &[0x01, 0x00, 0x74, 0x10, 1],
            &[0x01, 0x00, 0x21, 0x30, 100, 0],
            &[0x21, 0x00, 0x11, 0x20, 8],
            &[0x20, 0x00, 0x31, 0x10, 1],
            &[0x22, 0x00, 0x31, 0x10, 0],
            &[0x07, 0x00, 0x91, 0x20, 1],
        ];
        assert_eq!(super::setup()[..], frame(0x06, 0x8a, &setup.concat()));
    }

    #[test]
    fn an_acknowledgement_of_this_message_and_no_other_counts() {
        let mut receiver = Receiver::new();
        assert_eq!(receiver.push(&frame(0x05, 0x01, &[0x06, 0x8a])), Some(Heard::Acknowledged));
        assert_eq!(receiver.push(&frame(0x05, 0x01, &[0x06, 0x01])), None);
        assert_eq!(receiver.push(&frame(0x05, 0x00, &[0x06, 0x8a])), None);
    }

    #[test]
    fn the_first_fix_is_home_and_the_next_is_seen_from_there_however_it_is_cut() {
        let second = fix(1_000, 3);
        for cut in 0..second.len() {
            let mut receiver = Receiver::new();
            assert_eq!(hear(&mut receiver, &fix(0, 2)), None, "no home yet");
            assert_eq!(hear(&mut receiver, &fix(0, 3)).unwrap().position_m, Vec3::zero());
            let first = hear(&mut receiver, &second[..cut]);
            let gnss = first.or(hear(&mut receiver, &second[cut..])).unwrap();
            assert!((gnss.position_m.x - 11.12).abs() < 0.01 && gnss.position_m.y == 0.0, "{gnss:?}");
            assert_eq!(gnss.velocity_m_s, Vec3::new(0.25, -0.5, 0.125));
            assert_eq!([gnss.horizontal_m, gnss.vertical_m, gnss.speed_m_s], [1.3, 1.9, 0.05]);
            assert!(gnss.fixed);
            assert!(!hear(&mut receiver, &fix(2_000, 0)).unwrap().fixed);
            assert_eq!(receiver.errors(), 0);
        }
    }

    #[test]
    fn a_frame_with_a_wrong_bit_is_dropped_and_the_next_but_one_heard() {
        let good = fix(0, 3);
        for bit in 0..8 * good.len() {
            let mut receiver = Receiver::new();
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(receiver.push(&bad), None, "bit {bit}");
            let heard = [receiver.push(&good), receiver.push(&good)];
            assert!(heard[1].is_some(), "bit {bit}");
        }
    }

    #[test]
    fn sentences_of_another_protocol_and_noise_are_passed_over() {
        let mut receiver = Receiver::new();
        assert_eq!(receiver.push(b"$GNGGA,,,,,,0,00,99.99,,,,,,*56\r\n\xb5\xb5\x62\x01\x07\xff\xff"), None);
        assert!(hear(&mut receiver, &fix(0, 3)).is_some());
    }
}
