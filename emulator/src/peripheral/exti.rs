//! EXTI: edges on pins to interrupts.
//!
//! # Source
//! RM0090, chapter 12.3 "EXTI registers".
use super::only;

/// Lines 0 to 22.
const LINES: u32 = 0x007f_ffff;

/// The edge detector.
#[derive(Debug, Default)]
pub(crate) struct Exti {
    imr: u32,
    emr: u32,
    rtsr: u32,
    ftsr: u32,
    pr: u32,
}

impl Exti {
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.imr,
            0x04 => self.emr,
            0x08 => self.rtsr,
            0x0c => self.ftsr,
            0x10 => 0,
            0x14 => self.pr,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 => self.imr = only(value, LINES)?,
            // Events without interrupts wake the core only; nobody uses them here.
            0x04 => self.emr = only(value, 0)?,
            0x08 => self.rtsr = only(value, LINES)?,
            0x0c => self.ftsr = only(value, LINES)?,
            0x10 => self.pr |= value & self.imr,
            0x14 => self.pr &= !value,
            _ => return None,
        }
        Some(())
    }

    /// A pin that is routed to `line` has changed.
    pub(crate) fn edge(&mut self, line: u32, rising: bool) {
        let wanted = if rising { self.rtsr } else { self.ftsr };
        self.pr |= wanted & 1 << line;
    }

    /// Level of each interrupt of the chip that belongs to this peripheral.
    pub(crate) fn interrupts(&self) -> [(u32, bool); 7] {
        let active = self.pr & self.imr;
        let any = |lines: u32| active & lines != 0;
        [(6, any(1)), (7, any(2)), (8, any(4)), (9, any(8)), (10, any(16)), (23, any(0x03e0)), (40, any(0xfc00))]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_chosen_edge_of_an_unmasked_line_interrupts_until_cleared() {
        let mut exti = Exti::default();
        exti.write(0x08, 1 << 4);
        exti.edge(4, true);
        assert!(exti.interrupts().iter().all(|&(_, high)| !high), "masked");
        exti.write(0x00, 1 << 4);
        assert!(exti.interrupts().contains(&(10, true)), "pending from before");
        exti.write(0x14, 1 << 4);
        exti.edge(4, false);
        assert!(exti.interrupts().contains(&(10, false)));
    }
}
