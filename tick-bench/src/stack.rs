//! Stack that calls use: the memory below is painted before them, and the deepest spot that has lost its paint is looked for after.
use core::arch::asm;

/// The paint: no address, no common number.
const PAINT: u32 = 0xA5C3_3C5A;
/// How far is painted, bytes; less than there is.
const DEPTH: u32 = 32 * 1024;
/// What is left alone below the caller: this module's own frames, bytes.
const OWN: u32 = 128;

/// Painted stack.
pub(crate) struct Canvas {
    top: u32,
}

impl Canvas {
    /// Paints what is below the caller.
    #[inline(never)]
    pub(crate) fn paint() -> Self {
        let top = pointer() - OWN;
        for address in (top - DEPTH..top).step_by(4) {
            // SAFETY: the board has 4 MB; nothing lives below the stack pointer, and no interrupt is enabled.
            unsafe { (address as *mut u32).write_volatile(PAINT) };
        }
        Self { top }
    }

    /// How deep calls from there have reached since, bytes.
    #[inline(never)]
    pub(crate) fn depth(&self) -> u32 {
        // SAFETY: as above; it is read as numbers only.
        let painted = |address: &u32| unsafe { (*address as *const u32).read_volatile() } == PAINT;
        let bare = (self.top - DEPTH..self.top).step_by(4).take_while(painted).count() as u32;
        DEPTH - 4 * bare + OWN
    }
}

#[inline(always)]
fn pointer() -> u32 {
    let pointer: u32;
    // SAFETY: reads a register.
    unsafe { asm!("mov {}, sp", out(reg) pointer, options(nomem, nostack, preserves_flags)) };
    pointer
}
