//! NVIC: which exception runs next.
//!
//! Numbers are the vector table's: 3 HardFault, 11 SVCall, 14 PendSV, 15 SysTick, 16 + n the chip's interrupt n.
//!
//! ```text
//! runs next = pending ∧ enabled with the lowest (priority, number), if priority < min(active, BASEPRI, PRIMASK → 0)
//! ```
//!
//! Invariants: an interrupt whose line is still high when its handler returns is pending again (level-sensitive lines);
//! priorities have four bits, all of them preempt (AIRCR.PRIGROUP = 0, anything else is refused).
//!
//! # Source
//! ARMv7-M Architecture Reference Manual (DDI 0403E), B1.5 and B3.4.

/// Exceptions of the chip: 16 of the core, 82 interrupts.
const EXCEPTIONS: u32 = 16 + 82;

/// HardFault.
pub(crate) const HARD_FAULT: u32 = 3;
/// SVCall.
pub(crate) const SV_CALL: u32 = 11;
/// PendSV.
pub(crate) const PEND_SV: u32 = 14;
/// SysTick.
pub(crate) const SYS_TICK: u32 = 15;

/// What masks exceptions in the CPU.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Masks {
    pub(crate) primask: bool,
    pub(crate) faultmask: bool,
    pub(crate) basepri: u8,
}

/// The interrupt controller.
#[derive(Debug)]
pub(crate) struct Nvic {
    enabled: u128,
    pending: u128,
    lines: u128,
    /// Running handlers, the innermost last.
    active: Vec<u32>,
    priorities: [u8; EXCEPTIONS as usize],
    /// The one to run next if nothing masks it; kept so that looking costs nothing.
    candidate: Option<(i16, u32)>,
}

impl Nvic {
    pub(crate) fn new() -> Self {
        Self {
            // Exceptions of the core are always enabled.
            enabled: 0xffff,
            pending: 0,
            lines: 0,
            active: Vec::new(),
            priorities: [0; EXCEPTIONS as usize],
            candidate: None,
        }
    }

    /// Sets the level of a peripheral's interrupt line.
    pub(crate) fn set_line(&mut self, irq: u32, high: bool) {
        let bit = 1_u128 << (16 + irq);
        if high {
            if self.lines & bit == 0 {
                self.lines |= bit;
                self.set_pending(16 + irq);
            }
        } else {
            self.lines &= !bit;
        }
    }

    /// Makes an exception pending.
    pub(crate) fn set_pending(&mut self, exception: u32) {
        self.pending |= 1 << exception;
        self.elect();
    }

    /// The exception that the CPU takes now, if any.
    pub(crate) fn next(&self, masks: Masks) -> Option<u32> {
        let (priority, exception) = self.candidate?;
        let masked = (masks.faultmask && priority >= -1)
            || (masks.primask && priority >= 0)
            || (masks.basepri != 0 && priority >= i16::from(masks.basepri));
        (!masked).then_some(exception)
    }

    /// Whether anything that is enabled waits and could preempt what runs, were it not for the CPU's masks.
    pub(crate) fn is_waiting(&self) -> bool {
        self.candidate.is_some()
    }

    /// The CPU has taken `exception`.
    pub(crate) fn enter(&mut self, exception: u32) {
        self.pending &= !(1 << exception);
        self.active.push(exception);
        self.elect();
    }

    /// The CPU has returned from the innermost handler; returns the one it is back in, or 0.
    pub(crate) fn leave(&mut self) -> u32 {
        if let Some(exception) = self.active.pop() {
            self.pending |= self.lines & (1 << exception);
        }
        self.elect();
        self.running()
    }

    /// The handler that runs, or 0.
    pub(crate) fn running(&self) -> u32 {
        self.active.last().copied().unwrap_or(0)
    }

    /// The priority that a new exception must beat.
    pub(crate) fn active_priority(&self) -> i16 {
        self.active.iter().map(|&exception| self.priority(exception)).min().unwrap_or(i16::MAX)
    }

    fn priority(&self, exception: u32) -> i16 {
        if exception == HARD_FAULT { -1 } else { i16::from(self.priorities[exception as usize]) }
    }

    fn elect(&mut self) {
        let mut waiting = self.pending & self.enabled;
        let mut best = (self.active_priority(), u32::MAX);
        self.candidate = None;
        while waiting != 0 {
            let exception = waiting.trailing_zeros();
            waiting &= waiting - 1;
            if self.priority(exception) < best.0 {
                best = (self.priority(exception), exception);
                self.candidate = Some(best);
            }
        }
    }

    /// Reads a register at `offset` of the page 0xE000E000, if it is the controller's.
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        let word = |bits: u128, base: u32| (bits >> (16 + 8 * (offset - base))) as u32;
        Some(match offset {
            0x100..=0x108 => word(self.enabled, 0x100),
            0x180..=0x188 => word(self.enabled, 0x180),
            0x200..=0x208 => word(self.pending, 0x200),
            0x280..=0x288 => word(self.pending, 0x280),
            0x400..=0x451 => self.read_priorities(16 + offset - 0x400),
            0xd18 | 0xd1c | 0xd20 => self.read_priorities(4 + offset - 0xd18),
            _ => return None,
        })
    }

    /// Writes `bytes` bytes of a register at `offset` of the page, if it is the controller's.
    pub(crate) fn write(&mut self, offset: u32, bytes: usize, value: u32) -> Option<()> {
        let word = |base: u32| u128::from(value) << (16 + 8 * (offset - base));
        match offset {
            0x100..=0x108 => self.enabled |= word(0x100),
            0x180..=0x188 => self.enabled &= !word(0x180),
            0x200..=0x208 => self.pending |= word(0x200),
            // A line that is high makes its interrupt pending again at once.
            0x280..=0x288 => self.pending &= !(word(0x280) & !self.lines),
            0x400..=0x451 => self.write_priorities(16 + offset - 0x400, bytes, value),
            0xd18..=0xd23 => self.write_priorities(4 + offset - 0xd18, bytes, value),
            0xf00 => self.pending |= 1 << (16 + (value & 0x7f)),
            _ => return None,
        }
        self.elect();
        Some(())
    }

    fn read_priorities(&self, first: u32) -> u32 {
        let byte = |n: u32| self.priorities.get((first + n) as usize).copied().unwrap_or(0);
        u32::from_le_bytes([byte(0), byte(1), byte(2), byte(3)])
    }

    fn write_priorities(&mut self, first: u32, bytes: usize, value: u32) {
        for (n, byte) in value.to_le_bytes().into_iter().take(bytes).enumerate() {
            if let Some(priority) = self.priorities.get_mut(first as usize + n) {
                *priority = byte & 0xf0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPEN: Masks = Masks { primask: false, faultmask: false, basepri: 0 };

    fn with(priorities: &[(u32, u8)]) -> Nvic {
        let mut nvic = Nvic::new();
        for &(irq, priority) in priorities {
            nvic.write(0x100 + irq / 32 * 4, 4, 1 << (irq % 32));
            nvic.write(0x400 + irq, 1, priority.into());
        }
        nvic
    }

    #[test]
    fn the_lowest_priority_number_runs_first_and_is_not_interrupted_by_its_equal() {
        let mut nvic = with(&[(50, 0x10), (48, 0x20), (10, 0x10)]);
        for irq in [48, 50, 10] {
            nvic.set_line(irq, true);
        }
        assert_eq!(nvic.next(OPEN), Some(16 + 10));
        nvic.enter(16 + 10);
        nvic.set_line(10, false);
        assert_eq!(nvic.next(OPEN), None);
        assert_eq!(nvic.leave(), 0);
        assert_eq!(nvic.next(OPEN), Some(16 + 50));
    }

    #[test]
    fn masks_hold_back_interrupts_but_not_a_hard_fault() {
        let mut nvic = with(&[(48, 0x20)]);
        nvic.set_line(48, true);
        assert_eq!(nvic.next(Masks { basepri: 0x20, ..OPEN }), None);
        assert_eq!(nvic.next(Masks { basepri: 0x30, ..OPEN }), Some(64));
        assert_eq!(nvic.next(Masks { primask: true, ..OPEN }), None);
        nvic.set_pending(HARD_FAULT);
        assert_eq!(nvic.next(Masks { primask: true, ..OPEN }), Some(HARD_FAULT));
    }

    #[test]
    fn a_line_still_high_at_return_runs_its_handler_again() {
        let mut nvic = with(&[(5, 0)]);
        nvic.set_line(5, true);
        nvic.enter(21);
        assert_eq!(nvic.next(OPEN), None);
        nvic.leave();
        assert_eq!(nvic.next(OPEN), Some(21));
        nvic.enter(21);
        nvic.set_line(5, false);
        nvic.leave();
        assert_eq!(nvic.next(OPEN), None);
    }
}
