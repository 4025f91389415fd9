//! Black box: the record of the last step, in RAM that no reset clears.
use core::sync::atomic::{AtomicU32, Ordering, fence};

use firmware::record::{Record, WORDS};

/// A sequence number, odd while the rest is being written, and the record. A probe finds it by its name.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".uninit.last_step")]
static LAST_STEP: [AtomicU32; 1 + WORDS] = [const { AtomicU32::new(0) }; 1 + WORDS];

/// Keeps a record. Only the control task calls this.
pub(crate) fn keep(record: &Record) {
    let [sequence, words @ ..] = &LAST_STEP;
    let before = sequence.load(Ordering::Relaxed) & !1;
    sequence.store(before.wrapping_add(1), Ordering::Relaxed);
    fence(Ordering::Release);
    for (kept, word) in words.iter().zip(record.to_words()) {
        kept.store(word, Ordering::Relaxed);
    }
    sequence.store(before.wrapping_add(2), Ordering::Release);
}
