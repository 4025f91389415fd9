//! Counts executed instructions, exactly.
//!
//! Under `-icount shift=10,sleep=off` QEMU lets 2^10 ns pass with every instruction and with nothing else. `SysTick` runs
//! from the 25 MHz system clock, one count every 40 ns, so an instruction is 25.6 counts: two readings differ from
//! the true time by less than one count each, and rounding to the nearest instruction is exact. The 24-bit counter
//! wraps after 655 360 instructions, far beyond anything measured here.
//!
//! QEMU counts instructions, not cycles: on the chip loads, divisions, taken branches and flash wait states cost more
//! than one. That is what makes the number repeatable and a change of one instruction visible.
use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// A `SysTick` count at 25 MHz, and an instruction at `shift=10`.
const NS_PER_COUNT: u32 = 40;
const NS_PER_INSTRUCTION: u32 = 1 << 10;

/// The timer counts down through 24 bits.
const COUNTER_MASK: u32 = 0x00ff_ffff;

/// Counts the instructions of a call.
pub(crate) struct Counter {
    /// What measuring nothing costs.
    overhead: u32,
}

impl Counter {
    /// Starts the timer and measures the cost of measuring.
    pub(crate) fn new(mut systick: SYST) -> Self {
        systick.set_clock_source(SystClkSource::Core);
        systick.set_reload(COUNTER_MASK);
        systick.clear_current();
        systick.enable_counter();
        let mut counter = Self { overhead: 0 };
        counter.overhead = counter.instructions(|| {}).0;
        counter
    }

    /// Runs `call` and returns the instructions it took, and its result.
    ///
    /// Not inlined, so that nothing of the caller's is moved between the two readings.
    #[inline(never)]
    pub(crate) fn instructions<R>(&self, call: impl FnOnce() -> R) -> (u32, R) {
        let start = now();
        let result = call();
        let counts = start.wrapping_sub(now()) & COUNTER_MASK;
        let instructions = (counts * NS_PER_COUNT + NS_PER_INSTRUCTION / 2) / NS_PER_INSTRUCTION;
        (instructions - self.overhead, result)
    }
}

/// The counter, read neither earlier nor later than written.
#[inline]
fn now() -> u32 {
    compiler_fence(Ordering::SeqCst);
    let counts = SYST::get_current();
    compiler_fence(Ordering::SeqCst);
    counts
}
