//! Small sets of named things: failing checks, failsafes that act. One bit each; iterated in the order of their declaration.
use core::fmt;
use core::marker::PhantomData;

/// Something of which there are at most 32.
pub trait Member: Copy + 'static {
    /// All of them, in order.
    const ALL: &'static [Self];

    /// Its place in [`Self::ALL`].
    fn index(self) -> usize;
}

/// A set of `T`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Set<T> {
    bits: u32,
    of: PhantomData<T>,
}

impl<T: Member> Set<T> {
    /// Nothing.
    pub const EMPTY: Self = Self { bits: 0, of: PhantomData };

    /// Puts `member` in if `wanted`, or takes it out.
    pub fn put(&mut self, member: T, wanted: bool) {
        let bit = 1 << member.index();
        self.bits = if wanted { self.bits | bit } else { self.bits & !bit };
    }

    /// Whether `member` is in it.
    pub fn contains(&self, member: T) -> bool {
        self.bits & 1 << member.index() != 0
    }

    /// Whether nothing is in it.
    pub fn is_empty(&self) -> bool {
        self.bits == 0
    }

    /// One bit a member, the first the least: for telemetry.
    pub fn bits(&self) -> u32 {
        self.bits
    }

    /// The first that is in it.
    pub fn first(&self) -> Option<T> {
        T::ALL.get(self.bits.trailing_zeros() as usize).copied()
    }

    /// What is in it, in order.
    pub fn iter(&self) -> impl Iterator<Item = T> + use<T> {
        let set = *self;
        T::ALL.iter().copied().filter(move |&member| set.contains(member))
    }
}

impl<T: Member> FromIterator<T> for Set<T> {
    fn from_iter<I: IntoIterator<Item = T>>(members: I) -> Self {
        let mut set = Self::EMPTY;
        for member in members {
            set.put(member, true);
        }
        set
    }
}

impl<T: Member + fmt::Debug> fmt::Debug for Set<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.iter()).finish()
    }
}

impl<T: Member + fmt::Display> fmt::Display for Set<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, member) in self.iter().enumerate() {
            write!(f, "{}{member}", if i > 0 { "; " } else { "" })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arming::Check;
    use std::string::ToString;

    #[test]
    fn members_come_out_in_order_once_and_as_text() {
        let mut set: Set<Check> = [Check::Battery, Check::Link, Check::Link].into_iter().collect();
        assert!(set.iter().eq([Check::Link, Check::Battery]));
        assert_eq!(set.to_string(), "the pilot is not heard; the battery is low, or not measured");
        set.put(Check::Link, false);
        assert!(!set.contains(Check::Link) && set.contains(Check::Battery) && !set.is_empty());
        assert_eq!((set.first(), Set::<Check>::EMPTY.first()), (Some(Check::Battery), None));
        assert_eq!(set.bits().count_ones(), 1);
        assert_eq!(Set::<Check>::EMPTY.to_string(), "");
    }
}
