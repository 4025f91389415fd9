//! Black box: the record of the last step, in RAM that no reset clears. It is logged after a reset, before the next step overwrites it.
use core::sync::atomic::{AtomicU32, Ordering, fence};

use control_core::flight::Command;
use control_core::measurement::{Imu, Stamped};
use firmware::record::{Record, WORDS};

/// A sequence number, odd while the rest is being written, and the record. A probe finds it by its name.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".uninit.last_step")]
static LAST_STEP: [AtomicU32; 1 + WORDS] = [const { AtomicU32::new(0) }; 1 + WORDS];

/// Keeps the words of a record. Only the control task calls this.
pub(crate) fn keep(record: &[u32; WORDS]) {
    let [sequence, words @ ..] = &LAST_STEP;
    let before = sequence.load(Ordering::Relaxed) & !1;
    sequence.store(before.wrapping_add(1), Ordering::Relaxed);
    fence(Ordering::Release);
    // Eight at a time, for half of the cycles.
    let (eights, rest) = words.as_chunks::<8>();
    let (new_eights, new_rest) = record.as_chunks::<8>();
    for ([a, b, c, d, e, f, g, h], new) in eights.iter().zip(new_eights) {
        a.store(new[0], Ordering::Relaxed);
        b.store(new[1], Ordering::Relaxed);
        c.store(new[2], Ordering::Relaxed);
        d.store(new[3], Ordering::Relaxed);
        e.store(new[4], Ordering::Relaxed);
        f.store(new[5], Ordering::Relaxed);
        g.store(new[6], Ordering::Relaxed);
        h.store(new[7], Ordering::Relaxed);
    }
    for (kept, word) in rest.iter().zip(new_rest) {
        kept.store(*word, Ordering::Relaxed);
    }
    sequence.store(before.wrapping_add(2), Ordering::Release);
}

/// Logs the last step before a reset that has left RAM as it was.
pub(crate) fn report() {
    let [sequence, words @ ..] = &LAST_STEP;
    if !sequence.load(Ordering::Acquire).is_multiple_of(2) {
        defmt::warn!("the last step was being written");
        return;
    }
    let words = core::array::from_fn(|n| words[n].load(Ordering::Relaxed));
    let Record { step, time_us, arrived, command } = Record::from_words(&words);
    defmt::warn!("the last step before this start: {=u32}, {=u64} us after the one before", step, time_us);
    if let Some(Stamped { value: Imu { rate_rad_s: r, specific_force_m_s2: f }, .. }) = arrived.measurements.imu {
        defmt::warn!("rates {=f32} {=f32} {=f32} rad/s, force {=f32} {=f32} {=f32} m/s2", r.x, r.y, r.z, f.x, f.y, f.z);
    }
    match command {
        Command::Stop => defmt::warn!("motors stood"),
        Command::Run([m1, m2, m3, m4]) | Command::Bench([m1, m2, m3, m4]) => {
            defmt::warn!("motors {=f32} {=f32} {=f32} {=f32}", m1, m2, m3, m4);
        }
    }
}
