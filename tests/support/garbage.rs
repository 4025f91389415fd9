//! Values that no sensor should say, and that the autopilot must survive.
use control_core::frames::{Attitude, Vec3};

/// Random numbers from a seed: 64-bit xorshift.
pub struct Garbage(pub u64);

impl Garbage {
    /// The next bits.
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// Once in `n`.
    pub fn once_in(&mut self, n: u64) -> bool {
        (self.bits() >> 20).is_multiple_of(n)
    }

    /// `good`, or once in `n` something else: zero, not finite, huge, tiny, or any bits at all.
    pub fn spoil(&mut self, good: f32, n: u64) -> f32 {
        if !self.once_in(n) {
            return good;
        }
        match (self.bits() >> 30) % 9 {
            0 => f32::NAN,
            1 => f32::INFINITY,
            2 => f32::NEG_INFINITY,
            3 => f32::MAX,
            4 => f32::MIN_POSITIVE,
            5 => -good,
            6 => good * 1e3,
            7 => 0.0,
            _ => f32::from_bits((self.bits() >> 16) as u32),
        }
    }

    /// The same of each component.
    pub fn spoil_vector<F: Copy>(&mut self, good: Vec3<F>, n: u64) -> Vec3<F> {
        Vec3::new(self.spoil(good.x, n), self.spoil(good.y, n), self.spoil(good.z, n))
    }

    /// The same of each entry.
    pub fn spoil_attitude(&mut self, good: &Attitude, n: u64) -> Attitude {
        Attitude { rows: good.rows.map(|row| row.map(|entry| self.spoil(entry, n))) }
    }
}
