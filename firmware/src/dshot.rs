//! DShot: frames to speed controllers, and the timer's compare values that send them.
//!
//! ```text
//! frame = value·2⁵ + telemetry·2⁴ + checksum        checksum = x ⊕ x/16 ⊕ x/256, low 4 bits of x = frame/16
//! ```
//!
//! Sixteen bits, the highest first; a one lasts for three quarters of its time, a zero for three eighths. Value 0 stops a
//! rotor, 1 to 47 are commands that are never sent, 48 to 2047 are speeds.
//!
//! A frame that is to be answered is sent on a line that rests high, bits being low, and with all bits of its checksum turned: by
//! that a speed controller knows that it may answer (`erpm.rs`). The bit for telemetry asks for something else and stays 0.
//!
//! # Source
//! The protocol has no standard; this is as the documentation of the AM32 and Betaflight firmwares describes it.

/// What a motor is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Value(u16);

/// Whether speed controllers may answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialogue {
    /// They only listen.
    OneWay,
    /// Each answers each frame.
    Answered,
}

const SLOWEST: u16 = 48;
const FASTEST: u16 = 2_047;
/// Bits of a frame, and then two of silence, in which the line rests and speed controllers see its end.
pub const BITS: usize = 18;

impl Value {
    /// The rotor stands.
    pub const STOP: Self = Self(0);

    /// A running rotor's speed, as a share of the fastest, 0 to 1; what is not a number stops it.
    pub fn running(share: f32) -> Self {
        if share.is_finite() {
            let span = f32::from(FASTEST - SLOWEST);
            Self(SLOWEST + (share.clamp(0.0, 1.0) * span + 0.5) as u16)
        } else {
            Self::STOP
        }
    }

    /// The number sent.
    pub const fn get(self) -> u16 {
        self.0
    }

    /// The frame's bits.
    pub fn frame(self, dialogue: Dialogue) -> u16 {
        let x = self.0 << 1;
        let sum = x ^ x >> 4 ^ x >> 8;
        let sum = if dialogue == Dialogue::Answered { !sum } else { sum };
        x << 4 | sum & 0xf
    }
}

/// Compare values of the bits of one timer's motors, bit by bit, the motors within each; as wide as the timer. The last two rows are 0.
pub type Waveform<W, const N: usize> = [[W; N]; BITS];

/// Writes frames in place, but for the rows that are 0. An even number of motors: two go in one word.
///
/// - `values`: what each motor is told, in the order of the timer's channels.
/// - `counts`: of the timer in one bit's time.
pub fn write<W: From<u16>, const N: usize>(
    waveform: &mut Waveform<W, N>,
    values: [Value; N],
    dialogue: Dialogue,
    counts: u16,
) {
    const { assert!(N.is_multiple_of(2), "motors come in pairs") };
    // Thirds would do; these are the shares that the field uses.
    let (zero, one) = (u32::from(counts) * 3 / 8, u32::from(counts - counts / 4));
    for (pair, &[a, b]) in values.as_chunks::<2>().0.iter().enumerate() {
        let frames = u32::from(b.frame(dialogue)) << 16 | u32::from(a.frame(dialogue));
        for (row, place) in waveform.iter_mut().zip((0..16).rev()) {
            // Both bits at once: what a one has more than a zero, or nothing, to each half.
            let word = zero * 0x1_0001 + (frames >> place & 0x1_0001) * (one - zero);
            if let Some(place) = row.as_chunks_mut::<2>().0.get_mut(pair) {
                *place = [word as u16, (word >> 16) as u16].map(W::from);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_those_of_the_field() {
        for (value, frame) in [(0, 0x0000), (48, 0x0606), (1046, 0x82c6), (2047, 0xffee)] {
            assert_eq!(Value(value).frame(Dialogue::OneWay), frame, "{value}");
            assert_eq!(Value(value).frame(Dialogue::Answered), frame ^ 0xf, "{value}, to be answered");
        }
    }

    #[test]
    fn no_share_makes_a_command_or_leaves_the_range() {
        for (share, value) in [(-1.0, 48), (0.0, 48), (0.5, 1_048), (1.0, 2_047), (9.0, 2_047)] {
            assert_eq!(Value::running(share).get(), value, "{share}");
        }
        for share in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(Value::running(share), Value::STOP);
        }
    }

    #[test]
    fn a_waveform_has_every_motors_bits_in_turn_and_ends_at_rest() {
        let mut words = [[0_u16; 2]; BITS];
        write(&mut words, [Value::STOP, Value::running(1.0)], Dialogue::OneWay, 140);
        assert_eq!(words[..2], [[52, 105]; 2]);
        // 0xffee: bits 11 and 15 are zeros.
        assert_eq!([words[11], words[14], words[15]], [[52, 52], [52, 105], [52, 52]]);
        assert_eq!(words[16..], [[0; 2]; 2]);
        let mut wide = [[0_u32; 2]; BITS];
        write(&mut wide, [Value::STOP, Value::running(1.0)], Dialogue::OneWay, 140);
        assert_eq!(wide, words.map(|row| row.map(u32::from)), "of a timer with 32 bits");
    }
}
