//! Faults: motors first, then a word to the log, then nothing.
//!
//! No reset: it would hide what happened, and an aircraft that has lost its program must not come back by itself.
//! A line is lost if it interrupts another one half-way; the motors' cut is not.
use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::asm;
use cortex_m::interrupt;
use cortex_m_rt::{ExceptionFrame, exception};

use crate::board;

/// Whether a fault is being handled: one within its own handling must not log again.
static FAULTED: AtomicBool = AtomicBool::new(false);

/// Stops everything that moves; returns whether this is the first fault.
fn stop() -> bool {
    interrupt::disable();
    board::cut_motors();
    // Interrupts are off and there is one core: nothing comes between.
    let first = !FAULTED.load(Ordering::Relaxed);
    FAULTED.store(true, Ordering::Relaxed);
    first
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    if stop() {
        defmt::error!("{}", defmt::Display2Format(info));
    }
    // A probe catches this and shows the call stack; without one, `HardFault` below is the end.
    asm::udf();
}

/// `defmt`'s own assertions have logged already.
#[defmt::panic_handler]
fn defmt_panic() -> ! {
    stop();
    asm::udf();
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    if stop() {
        defmt::error!("hard fault at {=u32:#010x}, called from {=u32:#010x}", frame.pc(), frame.lr());
    }
    halt()
}

/// An interrupt or exception that nobody handles.
#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    if stop() {
        defmt::error!("unexpected interrupt {=i16}", number);
    }
    halt()
}

fn halt() -> ! {
    loop {
        asm::wfi();
    }
}
