//! Restart: what a flight must not forget if the program is stopped in the air, in words, and when it may go on from them.
//!
//! Whoever runs the program keeps a [`Memory`] in RAM that no reset clears, every few steps ([`Flight::remember`]), and after a reset gives
//! it to the new flight ([`Flight::resume`]). Of RAM nothing is believed that was not checked: the keeper has a checksum, and here are the
//! version, the ranges and the age.
//!
//! | the chip was reset by                             | what was kept                             | the new flight |
//! |---------------------------------------------------|-------------------------------------------|----------------|
//! | the watchdog: a hang, or what a fault ended in    | in the air, whole                          | goes on        |
//! | the same                                          | in the air, whole, but it had gone on less than [`SOUND_S`] before | is disarmed |
//! | the same                                          | nothing: it stood, was disarmed, or what is there is not whole | is disarmed |
//! | power, a supply that was too low, the program     | whatever                                  | is disarmed    |
//!
//! A hard fault or a panic is followed by the watchdog and is the first row: motors are off already, what was kept was whole before it,
//! and not to go on is to fall. What made it may come again at once: then the second row ends it. A supply that was too low would be so
//! again with the first thrust.
//!
//! Kept are: time, attitude, velocity, position, biases and how well each is known; mode, home, the pilot's last frame; what the laws have
//! learnt; what is believed of the rotors; the charge used. Not kept, for it is made anew within a second: the covariance, setpoints (the mode begins where
//! the machine is), how long failsafes have waited. For half a second nothing is learnt of the rotors, whose true thrust nobody knows.
//!
//! Invariant: reading what writing has written gives the same values; words that were not written so give nothing.
//!
//! [`Flight::remember`]: crate::flight::Flight::remember
//! [`Flight::resume`]: crate::flight::Flight::resume
use crate::frames::Vec3;
use core::slice::IterMut;

/// Words of a [`Memory`].
pub const WORDS: usize = 91;
/// What is kept.
pub type Memory = [u32; WORDS];
/// First word: what the others mean. To be changed with them.
pub(crate) const VERSION: u32 = 0x666c_7902;
/// How long a flight that has gone on must last to go on once more, s.
pub const SOUND_S: u64 = 10;
/// Largest number that is believed.
pub(crate) const LARGEST: f32 = 1e6;

/// Passes over the words, in or out: each part of the state names what of it is kept once, for both.
pub(crate) struct Tape<'a> {
    words: IterMut<'a, u32>,
    reads: bool,
    sound: bool,
}

impl<'a> Tape<'a> {
    /// Writes what passes.
    pub(crate) fn writing(memory: &'a mut Memory) -> Self {
        Self { words: memory.iter_mut(), reads: false, sound: true }
    }

    /// Overwrites what passes with what was written.
    pub(crate) fn reading(memory: &'a mut Memory) -> Self {
        Self { words: memory.iter_mut(), reads: true, sound: true }
    }

    /// Whether all of it has passed, and nothing that cannot be.
    pub(crate) fn is_sound(&self) -> bool {
        self.sound && self.words.len() == 0
    }

    // Not inlined: there are ninety-one.
    #[inline(never)]
    pub(crate) fn word(&mut self, value: &mut u32) {
        match self.words.next() {
            Some(word) if self.reads => *value = *word,
            Some(word) => *word = *value,
            None => self.sound = false,
        }
    }

    /// A number that must be below `most`.
    pub(crate) fn index(&mut self, value: &mut usize, most: usize) {
        let mut word = *value as u32;
        self.word(&mut word);
        self.sound &= (word as usize) < most;
        *value = word as usize;
    }

    pub(crate) fn time(&mut self, value_us: &mut u64) {
        let [mut low, mut high] = [*value_us as u32, (*value_us >> 32) as u32];
        self.word(&mut low);
        self.word(&mut high);
        *value_us = u64::from(high) << 32 | u64::from(low);
    }

    #[inline(never)]
    pub(crate) fn float(&mut self, value: &mut f32) {
        let mut word = value.to_bits();
        self.word(&mut word);
        *value = f32::from_bits(word);
        // Written so that what is not a number is not believed.
        self.sound &= value.abs() <= LARGEST;
    }

    #[inline(never)]
    pub(crate) fn floats(&mut self, values: &mut [f32]) {
        for value in values {
            self.float(value);
        }
    }

    #[inline(never)]
    pub(crate) fn vector<F>(&mut self, value: &mut Vec3<F>) {
        for value in [&mut value.x, &mut value.y, &mut value.z] {
            self.float(value);
        }
    }

    pub(crate) fn bits<const N: usize>(&mut self, bits: [&mut bool; N]) {
        let mut word = bits.iter().rev().fold(0, |word, bit| word << 1 | u32::from(**bit));
        self.word(&mut word);
        for (n, bit) in bits.into_iter().enumerate() {
            *bit = word >> n & 1 == 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_is_what_was_written() {
        let mut memory = [0; WORDS];
        let (mut time_us, mut place, mut x, mut bits) = (0x1_2345_6789_u64, 3_usize, -1.5_f32, [true, false, true]);
        let pass = |tape: &mut Tape, time_us: &mut u64, place: &mut usize, x: &mut f32, bits: &mut [bool; 3]| {
            tape.time(time_us);
            tape.index(place, 4);
            tape.float(x);
            tape.bits(bits.each_mut());
            tape.sound
        };
        assert!(pass(&mut Tape::writing(&mut memory), &mut time_us, &mut place, &mut x, &mut bits));
        let (mut time_read_us, mut place_read, mut x_read, mut bits_read) = (0, 0, 0.0, [false; 3]);
        let mut tape = Tape::reading(&mut memory);
        assert!(pass(&mut tape, &mut time_read_us, &mut place_read, &mut x_read, &mut bits_read));
        assert_eq!((time_read_us, place_read, x_read, bits_read), (time_us, place, x, bits));
        assert!(!tape.is_sound(), "not all of it has passed");
    }

    #[test]
    fn numbers_that_cannot_be_and_too_many_are_not_sound() {
        for bad in [f32::NAN.to_bits(), f32::INFINITY.to_bits(), 1e7_f32.to_bits()] {
            let mut memory = [bad; WORDS];
            let mut tape = Tape::reading(&mut memory);
            tape.float(&mut 0.0);
            assert!(!tape.sound, "{bad:#x}");
        }
        let mut memory = [4; WORDS];
        let mut tape = Tape::reading(&mut memory);
        tape.index(&mut 0, 4);
        assert!(!tape.sound);
        let mut memory = [0; WORDS];
        let mut tape = Tape::reading(&mut memory);
        (0..WORDS).for_each(|_| tape.word(&mut 0));
        assert!(tape.is_sound());
        tape.word(&mut 0);
        assert!(!tape.is_sound());
    }
}
