//! Faults: motors first, then a word to the log and one to RAM that no reset clears, then nothing until the watchdog resets.
//!
//! What was kept is logged at the next start. On the ground that starts disarmed; what becomes of a flight in the air says `control_core::restart`.
use core::arch::naked_asm;
use core::fmt::{self, Write};
use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use cortex_m::asm;
use cortex_m::interrupt;
use cortex_m_rt::{ExceptionFrame, exception};

use crate::board;

/// Whether a fault is being handled: one within its own handling must not log again.
static FAULTED: AtomicBool = AtomicBool::new(false);

/// Bytes of a message that are kept.
const KEPT: usize = 120;
/// What marks a message that was kept; RAM is random at power-up.
const MARK: u32 = 0x6661_756c;

#[unsafe(link_section = ".uninit.fault_mark")]
static MARKED: AtomicU32 = AtomicU32::new(0);
#[unsafe(link_section = ".uninit.fault_message")]
static MESSAGE: [AtomicU8; KEPT] = [const { AtomicU8::new(0) }; KEPT];

/// Writes a message where no reset clears it; what does not fit is cut off.
struct Kept(usize);

impl Write for Kept {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for (place, byte) in MESSAGE.iter().skip(self.0).zip(text.bytes()) {
            place.store(byte, Ordering::Relaxed);
            self.0 += 1;
        }
        Ok(())
    }
}

/// Keeps a message for the next start. Once in flash, as [`stop`] is: a copy in each of their callers would be 1.7 KB.
#[inline(never)]
fn keep(message: fmt::Arguments) {
    for place in &MESSAGE {
        place.store(0, Ordering::Relaxed);
    }
    // Writing cannot fail.
    let _ = Kept(0).write_fmt(message);
    MARKED.store(MARK, Ordering::Release);
}

/// Logs what was kept before this start, once.
pub(crate) fn report() {
    if MARKED.swap(0, Ordering::Relaxed) != MARK {
        return;
    }
    let bytes: [u8; KEPT] = core::array::from_fn(|n| MESSAGE[n].load(Ordering::Relaxed));
    let length = bytes.iter().position(|&byte| byte == 0).unwrap_or(KEPT);
    // Text that was cut within a character ends before it.
    let text = bytes[..length].utf8_chunks().next().map_or("", |chunk| chunk.valid());
    defmt::error!("before this start: {=str}", text);
}

/// Stops everything that moves; returns whether this is the first fault.
#[inline(never)]
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
        keep(format_args!("{info}"));
    }
    // A probe catches this and shows the call stack; without one, `HardFault` below is the end.
    asm::udf();
}

/// `defmt`'s own assertions, and the hardware layer's, have logged already: who failed one is kept.
#[defmt::panic_handler]
fn defmt_panic() -> ! {
    let caller: u32;
    // SAFETY: reads a register and nothing else. Nothing has been called yet that would have written it.
    unsafe { core::arch::asm!("mov {}, lr", out(reg) caller, options(nomem, nostack, preserves_flags)) };
    if stop() {
        keep(format_args!("defmt panic, called from {caller:#010x}"));
    }
    asm::udf();
}

/// Goes to [`hard_fault`] on a stack that is there: after an overflow the running one is not, and a fault within this handler
/// would lock the core up before the motors are cut. Where less than 1 KiB is left, the stack begins anew.
///
/// - r0: where the core has left the program's registers; 0 where it could not.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!(
        "mrs  r0, msp",
        "movw r1, #:lower16:_stack_end",
        "movt r1, #:upper16:_stack_end",
        "add  r2, r1, #1024",
        "cmp  r0, r2",
        "bhs  2f",
        "movw r2, #:lower16:_stack_start",
        "movt r2, #:upper16:_stack_start",
        "msr  msp, r2",
        "cmp  r0, r1",
        "bhs  2f",
        "movs r0, #0",
        "2:",
        "b    {}",
        sym hard_fault,
    )
}

extern "C" fn hard_fault(frame: Option<&ExceptionFrame>) -> ! {
    if stop() {
        if let Some(frame) = frame {
            defmt::error!("hard fault at {=u32:#010x}, called from {=u32:#010x}", frame.pc(), frame.lr());
            keep(format_args!("hard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr()));
        } else {
            defmt::error!("hard fault: the stack has overflowed");
            keep(format_args!("hard fault: the stack has overflowed"));
        }
    }
    halt()
}

/// An interrupt or exception that nobody handles.
#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    if stop() {
        defmt::error!("unexpected interrupt {=i16}", number);
        keep(format_args!("unexpected interrupt {number}"));
    }
    halt()
}

fn halt() -> ! {
    loop {
        asm::wfi();
    }
}
