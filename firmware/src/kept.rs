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
    pub(crate) fn keep(&self, words: [u32; N]) {
        // Without a sum that fits, until all are written: a reset may come between.
        self.sum.store(!sum(words), Ordering::Relaxed);
        compiler_fence(Ordering::SeqCst);
        for (kept, word) in self.words.iter().zip(words) {
            kept.store(word, Ordering::Relaxed);
        }
        compiler_fence(Ordering::SeqCst);
        self.sum.store(sum(words), Ordering::Relaxed);
    }

    /// What was kept, if anything was; it is not kept any more.
    pub(crate) fn take(&self) -> Option<[u32; N]> {
        let words = core::array::from_fn(|n| self.words[n].load(Ordering::Relaxed));
        let fits = self.sum.load(Ordering::Relaxed) == sum(words);
        self.sum.store(!sum(words), Ordering::Relaxed);
        fits.then_some(words)
    }
}

/// FNV-1a by words; not that of zeros alone, which RAM may well hold.
fn sum<const N: usize>(words: [u32; N]) -> u32 {
    words.into_iter().fold(0x811c_9dc5, |sum, word| (sum ^ word).wrapping_mul(0x0100_0193))
}
