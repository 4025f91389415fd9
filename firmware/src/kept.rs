//! Kept: words in RAM that no reset clears, with a checksum, for what RAM holds at power-up is anything.
//!
//! Each is a `static` in a section that begins with `.uninit`. Invariant: [`Kept::take`] returns what [`Kept::keep`] was given,
//! or nothing.
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

/// `N` words.
pub(crate) struct Kept<const N: usize> {
    sum: AtomicU32,
    words: [AtomicU32; N],
}

impl<const N: usize> Kept<N> {
    /// For a `static`; what is given here is not what RAM holds.
    pub(crate) const fn uninit() -> Self {
        Self { sum: AtomicU32::new(0), words: [const { AtomicU32::new(0) }; N] }
    }

    /// Keeps these words.
    pub(crate) fn keep(&self, words: &[u32; N]) {
        keep(&self.sum, &self.words, words);
    }

    /// Keeps nothing.
    pub(crate) fn forget(&self) {
        self.sum.store(!sum(&self.words), Ordering::Relaxed);
    }

    /// What was kept, if anything was; it is not kept any more.
    pub(crate) fn take(&self) -> Option<[u32; N]> {
        let fits = self.sum.load(Ordering::Relaxed) == sum(&self.words);
        self.forget();
        let mut words = [0; N];
        for (word, kept) in words.iter_mut().zip(&self.words) {
            *word = kept.load(Ordering::Relaxed);
        }
        fits.then_some(words)
    }
}

// Over slices, for all sizes alike.
#[inline(never)]
fn keep(place: &AtomicU32, kept: &[AtomicU32], words: &[u32]) {
    // Without a sum that fits, until all are written: a reset may come between.
    place.store(!sum(kept), Ordering::Relaxed);
    compiler_fence(Ordering::SeqCst);
    for (kept, word) in kept.iter().zip(words) {
        kept.store(*word, Ordering::Relaxed);
    }
    compiler_fence(Ordering::SeqCst);
    place.store(sum(kept), Ordering::Relaxed);
}

/// FNV-1a by words; not that of zeros alone, which RAM may well hold.
#[inline(never)]
fn sum(words: &[AtomicU32]) -> u32 {
    words.iter().fold(0x811c_9dc5, |sum, word| (sum ^ word.load(Ordering::Relaxed)).wrapping_mul(0x0100_0193))
}
