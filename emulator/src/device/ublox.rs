//! A u-blox receiver of the tenth generation: its line, the keys that it is set by, and the fixes that it sends.
//!
//! Delivered, it talks at 38,400 bits a second and sends sentences of NMEA. A fix that it is given to send goes out as
//! UBX-NAV-PVT if it was told to send these, and if its period since the last has passed but for a tenth. Working a fix out
//! takes no time here: it is given when it would be sent. What it was told it acknowledges, unless it is to refuse it: then
//! it answers UBX-ACK-NAK and does none of it.
//!
//! # Source
//! u-blox, "M10 SPG 5.10 interface description": 3.3 and 3.4 for frames, 3.9 UBX-ACK, 3.10.5 UBX-CFG-VALSET, 3.15.11 UBX-NAV-PVT, 4.9 for
//! the keys.

/// A fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// Latitude and longitude, 1e-7 degrees.
    pub place_e7: [i32; 2],
    /// Height above the ellipsoid, m; velocity north, east, down, m/s; its own errors horizontal, vertical, m, and of speed,
    /// m/s, 1 σ.
    pub values: [f32; 7],
    /// What kind of fix: 3 in three dimensions, 0 none.
    pub kind: u8,
    /// Satellites.
    pub satellites: u8,
}

/// The receiver.
#[derive(Debug)]
pub(crate) struct Ublox {
    cycles_us: u64,
    /// Bits a second on its line.
    pub(crate) baud: u32,
    /// What has come of a frame.
    frame: Vec<u8>,
    /// Whether it sends fixes in UBX, and sentences of NMEA.
    ubx: bool,
    fixes: bool,
    nmea: bool,
    period_ms: u16,
    sent_at: Option<u64>,
    /// How many more messages it refuses of those that ask for more than a speed.
    pub(crate) refusals: u32,
}

const SYNC: [u8; 2] = [0xb5, 0x62];
const VALSET: [u8; 2] = [0x06, 0x8a];
/// CFG-UART1-BAUDRATE.
const SPEED: u32 = 0x4052_0001;
/// A sentence of NMEA: no fix.
const SENTENCE: &[u8] = b"$GNGGA,,,,,,0,00,99.99,,,,,,*56\r\n";

impl Ublox {
    pub(crate) fn new(cycles_us: u64) -> Self {
        Self {
            cycles_us,
            baud: 38_400,
            frame: Vec::new(),
            ubx: true,
            fixes: false,
            nmea: true,
            period_ms: 1_000,
            sent_at: None,
            refusals: 0,
        }
    }

    /// A byte has come; what it answers.
    ///
    /// # Errors
    /// Names a key or a frame that is not modelled.
    pub(crate) fn hear(&mut self, byte: u8) -> Result<Vec<u8>, String> {
        self.frame.push(byte);
        let frame = &self.frame;
        if !frame.starts_with(&SYNC[..frame.len().min(2)]) {
            self.frame.clear();
            return Ok(Vec::new());
        }
        let length = frame.get(4..6).map(|bytes| usize::from(u16::from_le_bytes([bytes[0], bytes[1]])));
        if length.is_none_or(|length| frame.len() < 8 + length) {
            return Ok(Vec::new());
        }
        let frame = std::mem::take(&mut self.frame);
        let (body, sum) = frame.split_at(frame.len() - 2);
        if sum != checksum(&body[2..]) {
            return Ok(Vec::new());
        }
        if body[2..4] != VALSET {
            return Err(format!("the satellite receiver does not model the message {:02x?}", &body[2..4]));
        }
        if self.refusals > 0 && body.get(10..14) != Some(&SPEED.to_le_bytes()) {
            self.refusals -= 1;
            return Ok(message([0x05, 0x00], &VALSET));
        }
        self.set(&body[6..])?;
        Ok(message([0x05, 0x01], &VALSET))
    }

    /// Takes in keys and values.
    fn set(&mut self, payload: &[u8]) -> Result<(), String> {
        let mut rest = payload.get(4..).unwrap_or(&[]);
        while let Some((key, after)) = rest.split_first_chunk::<4>() {
            let key = u32::from_le_bytes(*key);
            // The key says how many bytes its value has: 1 a bit, 2 one, 3 two, 4 four.
            let bytes = [0, 1, 1, 2, 4][(key >> 28 & 7).min(4) as usize];
            let mut value = [0; 4];
            value[..bytes].copy_from_slice(after.get(..bytes).ok_or("the satellite receiver misses a value")?);
            let value = u32::from_le_bytes(value);
            match key {
                SPEED => self.baud = value,
                0x1074_0001 => self.ubx = value != 0,
                0x1074_0002 => self.nmea = value != 0,
                0x3021_0001 => self.period_ms = value as u16,
                0x2091_0007 => self.fixes = value == 1,
                // Its own model of how it is moved; SBAS on, BeiDou off. The fixes are given.
                _ if [(0x2011_0021, 8), (0x1031_0020, 1), (0x1031_0022, 0)].contains(&(key, value)) => {}
                _ => return Err(format!("the satellite receiver does not model the key {key:#010x} = {value}")),
            }
            rest = &after[bytes..];
        }
        Ok(())
    }

    /// What it sends, given a fix at `now`.
    pub(crate) fn send(&mut self, fix: &Fix, now: u64) -> Vec<u8> {
        let period = u64::from(self.period_ms) * 1_000 * self.cycles_us;
        if self.sent_at.is_some_and(|before| now - before < period - period / 10) {
            return Vec::new();
        }
        self.sent_at = Some(now);
        let mut bytes = if self.nmea { SENTENCE.to_vec() } else { Vec::new() };
        if self.ubx && self.fixes {
            bytes.extend(message([0x01, 0x07], &self.nav_pvt(fix, now)));
        }
        bytes
    }

    fn nav_pvt(&self, fix: &Fix, now: u64) -> [u8; 92] {
        let milli = |value: f32| (f64::from(value) * 1e3).round() as i32;
        let [latitude, longitude] = fix.place_e7;
        let [height, north, east, down, horizontal, vertical, speed] = fix.values.map(milli);
        let ground = f64::from(fix.values[1]).hypot(fix.values[2].into()) * 1e3;
        let mut payload = [0; 92];
        let itow_ms = now / self.cycles_us / 1_000;
        (payload[20], payload[21], payload[23]) = (fix.kind, u8::from(fix.kind >= 2), fix.satellites);
        for (at, value) in [
            (0, itow_ms as i32),
            (24, longitude),
            (28, latitude),
            (32, height),
            (36, height),
            (40, horizontal),
            (44, vertical),
            (48, north),
            (52, east),
            (56, down),
            (60, ground.round() as i32),
            (68, speed),
        ] {
            payload[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        payload
    }
}

fn message(kind: [u8; 2], payload: &[u8]) -> Vec<u8> {
    let mut bytes = [&SYNC[..], &kind, &(payload.len() as u16).to_le_bytes(), payload].concat();
    bytes.extend(checksum(&bytes[2..]));
    bytes
}

fn checksum(bytes: &[u8]) -> [u8; 2] {
    bytes.iter().fold([0, 0], |[a, b]: [u8; 2], byte| {
        let a = a.wrapping_add(*byte);
        [a, b.wrapping_add(a)]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIX: Fix = Fix {
        place_e7: [481_234_567, 115_678_901],
        values: [450.0, 0.25, -0.5, 0.125, 1.3, 1.9, 0.05],
        kind: 3,
        satellites: 14,
    };

    fn tell(receiver: &mut Ublox, keys: &[u8]) -> Result<Vec<u8>, String> {
        let bytes = message(VALSET, &[&[0, 1, 0, 0], keys].concat());
        bytes
            .into_iter()
            .map(|byte| receiver.hear(byte))
            .try_fold(Vec::new(), |all, answer| Ok([all, answer?].concat()))
    }

    #[test]
    fn it_acknowledges_what_it_is_told_and_then_sends_fixes_as_often() {
        let mut receiver = Ublox::new(1);
        assert_eq!(receiver.send(&FIX, 0), SENTENCE);
        let keys = [0x02, 0, 0x74, 0x10, 0, 0x01, 0, 0x21, 0x30, 100, 0, 0x07, 0, 0x91, 0x20, 1];
        assert_eq!(tell(&mut receiver, &keys), Ok(vec![0xb5, 0x62, 5, 1, 2, 0, 0x06, 0x8a, 0x98, 0xc1]));
        let frame = receiver.send(&FIX, 100_000);
        assert_eq!((frame.len(), &frame[..6]), (100, &[0xb5, 0x62, 1, 7, 92, 0][..]));
        assert_eq!(frame[6 + 28..6 + 32], 481_234_567_i32.to_le_bytes());
        assert_eq!(frame[6 + 52..6 + 56], (-500_i32).to_le_bytes());
        assert!(receiver.send(&FIX, 180_000).is_empty(), "too soon");
        assert_eq!(receiver.send(&FIX, 195_000).len(), 100);
    }

    #[test]
    fn what_it_refuses_it_does_not_do_and_its_speed_it_always_takes() {
        let mut receiver = Ublox::new(1);
        receiver.refusals = 1;
        assert_eq!(tell(&mut receiver, &[0x01, 0, 0x52, 0x40, 0, 0xc2, 0x01, 0]).map(|answer| answer[3]), Ok(1));
        let no_sentences = [0x02, 0, 0x74, 0x10, 0];
        assert_eq!(tell(&mut receiver, &no_sentences).map(|answer| answer[3]), Ok(0));
        assert_eq!((receiver.baud, receiver.nmea), (115_200, true));
        assert_eq!(tell(&mut receiver, &no_sentences).map(|answer| answer[3]), Ok(1));
        assert!(!receiver.nmea);
    }

    #[test]
    fn a_key_that_is_not_modelled_is_named_and_noise_is_not_heard() {
        let mut receiver = Ublox::new(1);
        for byte in [0xb5, 0x00, 0x62, 0xff] {
            assert_eq!(receiver.hear(byte), Ok(Vec::new()));
        }
        let error = tell(&mut receiver, &[0x09, 0, 0x91, 0x20, 1]).expect_err("no such key");
        assert!(error.contains("0x20910009 = 1"), "{error}");
    }
}
