//! USART1 to USART6: eight bits, with DMA and idle line.
//!
//! A byte takes `10·BRR` cycles of the peripheral's clock (11 with parity on top of eight bits). Bytes from the world
//! are put on the line with [`Usart::feed`], each at its sender's speed, and follow each other without a gap; the idle line is
//! seen one byte's time after the last. A byte at another speed than the port's comes as another one, with a framing error.
//!
//! # Source
//! RM0090, chapter 30.6 "USART registers".
use super::{NEVER, Tick, only};
use std::collections::VecDeque;

const FE: u32 = 1 << 1;
const ORE: u32 = 1 << 3;
const IDLE: u32 = 1 << 4;
const RXNE: u32 = 1 << 5;
const TC: u32 = 1 << 6;
const TXE: u32 = 1 << 7;
const UE: u32 = 1 << 13;
const RE: u32 = 1 << 2;
const TE: u32 = 1 << 3;
const DMAR: u32 = 1 << 6;
const DMAT: u32 = 1 << 7;

/// A serial port.
#[derive(Debug)]
pub(crate) struct Usart {
    sr: u32,
    dr: u8,
    brr: u32,
    cr: [u32; 3],
    /// Bytes on their way in with the time of a bit, core cycles, and when the first is through.
    line: VecDeque<(u8, u64)>,
    next_in: u64,
    /// When the line counts as idle.
    idle_at: u64,
    /// Flags seen by the last read of SR, which a read of DR clears.
    looked_at: u32,
    waiting: Option<u8>,
    sending: Option<(u8, u64)>,
    /// Bytes sent since they were last taken.
    pub(crate) sent: Vec<u8>,
}

impl Usart {
    pub(crate) fn new() -> Self {
        Self {
            sr: TXE | TC,
            dr: 0,
            brr: 0,
            cr: [0; 3],
            line: VecDeque::new(),
            next_in: NEVER,
            idle_at: NEVER,
            looked_at: 0,
            waiting: None,
            sending: None,
            sent: Vec::new(),
        }
    }

    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => {
                self.looked_at = self.sr;
                self.sr
            }
            0x04 => {
                self.sr &= !(RXNE | self.looked_at & (FE | ORE | IDLE));
                self.looked_at = 0;
                self.dr.into()
            }
            0x08 => self.brr,
            0x0c..=0x14 => self.cr[(offset as usize - 0x0c) / 4],
            0x18 => 0,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, t: Tick) -> Option<()> {
        match offset {
            // RXNE and TC are cleared by a zero.
            0x00 => self.sr &= value | !(RXNE | TC),
            0x04 => {
                self.waiting = Some(value as u8);
                self.sr &= !(TXE | TC);
                self.start(t);
            }
            0x08 => self.brr = only(value, 0xffff)?,
            0x0c => self.cr[0] = only(value, 0x37fc)?,
            // Stop bits only.
            0x10 => self.cr[1] = only(value, 0x3000)?,
            0x14 => self.cr[2] = only(value, 0x08c1)?,
            _ => return None,
        }
        Some(())
    }

    /// Puts bytes on the line to the receiver, after those that are still on it.
    ///
    /// - `bit`: what a bit takes the sender, core cycles.
    pub(crate) fn feed(&mut self, bytes: &[u8], bit: u64, now: u64) {
        if self.line.is_empty() && !bytes.is_empty() {
            self.next_in = now + self.bits() * bit;
            self.idle_at = NEVER;
        }
        self.line.extend(bytes.iter().map(|&byte| (byte, bit)));
    }

    pub(crate) fn next(&self) -> u64 {
        self.next_in.min(self.idle_at).min(self.sending.map_or(NEVER, |(_, done)| done))
    }

    pub(crate) fn event(&mut self, t: Tick) {
        if t.now >= self.next_in {
            self.arrive(t);
        }
        if t.now >= self.idle_at {
            self.sr |= IDLE;
            self.idle_at = NEVER;
        }
        if let Some((byte, done)) = self.sending
            && t.now >= done
        {
            self.sent.push(byte);
            self.sending = None;
            self.start(t);
            if self.sending.is_none() {
                self.sr |= TC;
            }
        }
    }

    pub(crate) fn interrupts(&self) -> bool {
        let [cr1, _, cr3] = self.cr;
        let on = |enabled: bool, flags: u32| enabled && self.sr & flags != 0;
        on(cr1 & 1 << 4 != 0, IDLE)
            || on(cr1 & 1 << 5 != 0, RXNE | ORE)
            || on(cr1 & 1 << 6 != 0, TC)
            || on(cr1 & 1 << 7 != 0, TXE)
            || on(cr3 & 1 != 0 && cr3 & DMAR != 0, FE | ORE)
    }

    pub(crate) fn wants_read(&self) -> bool {
        self.cr[2] & DMAR != 0 && self.sr & RXNE != 0
    }

    pub(crate) fn wants_write(&self) -> bool {
        self.cr[2] & DMAT != 0 && self.sr & TXE != 0 && self.cr[0] & TE != 0
    }

    /// What a bit takes, core cycles.
    pub(crate) fn bit_cycles(&self, t: Tick) -> u64 {
        u64::from(self.brr.max(1)) * t.clock
    }

    /// Whether this is the port's own speed, to what a receiver stands: a thirtieth.
    pub(crate) fn is_speed(&self, bit: u64, t: Tick) -> bool {
        30 * bit.abs_diff(self.bit_cycles(t)) <= bit
    }

    fn bits(&self) -> u64 {
        if self.cr[0] & 1 << 12 == 0 { 10 } else { 11 }
    }

    fn byte_cycles(&self, t: Tick) -> u64 {
        self.bits() * self.bit_cycles(t)
    }

    fn arrive(&mut self, t: Tick) {
        let Some((byte, bit)) = self.line.pop_front() else { return };
        let listening = self.cr[0] & (UE | RE) == UE | RE;
        if listening && self.sr & RXNE == 0 {
            let clear = self.is_speed(bit, t);
            self.dr = if clear { byte } else { !byte };
            self.sr |= RXNE | if clear { 0 } else { FE };
        } else if listening {
            self.sr |= ORE;
        }
        (self.next_in, self.idle_at) = match self.line.front() {
            Some((_, bit)) => (t.now + self.bits() * bit, NEVER),
            None if listening => (NEVER, t.now + self.byte_cycles(t)),
            None => (NEVER, NEVER),
        };
    }

    fn start(&mut self, t: Tick) {
        if self.sending.is_none() {
            self.sending = self.waiting.take().map(|byte| (byte, t.now + self.byte_cycles(t)));
            self.sr |= TXE;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_arrive_at_their_rate_and_then_the_line_is_idle() {
        let t = |now| Tick { now, clock: 2 };
        let mut usart = Usart::new();
        usart.write(0x08, 200, t(0));
        usart.write(0x0c, UE | RE | 1 << 4, t(0));
        usart.feed(&[7, 8], 400, 0);
        assert_eq!(usart.next(), 4_000);
        usart.event(t(4_000));
        assert_eq!(usart.read(0x00), Some(TXE | TC | RXNE));
        assert_eq!(usart.read(0x04), Some(7));
        usart.event(t(8_000));
        assert!(!usart.interrupts());
        usart.event(t(12_000));
        assert!(usart.interrupts());
        usart.read(0x00);
        assert_eq!(usart.read(0x04), Some(8));
        assert!(!usart.interrupts());
        assert_eq!(usart.next(), NEVER);
    }

    #[test]
    fn a_byte_that_is_not_fetched_is_overrun_by_the_next() {
        let t = |now| Tick { now, clock: 1 };
        let mut usart = Usart::new();
        usart.write(0x08, 1, t(0));
        usart.write(0x0c, UE | RE, t(0));
        usart.feed(&[1, 2], 1, 0);
        usart.event(t(10));
        usart.event(t(20));
        assert_eq!(usart.read(0x00).map(|sr| sr & (ORE | RXNE)), Some(ORE | RXNE));
        assert_eq!(usart.read(0x04), Some(1));
    }
    #[test]
    fn a_byte_at_another_speed_comes_garbled_with_a_framing_error() {
        let t = |now| Tick { now, clock: 1 };
        let mut usart = Usart::new();
        usart.write(0x08, 100, t(0));
        usart.write(0x0c, UE | RE, t(0));
        usart.feed(&[7], 103, 0);
        usart.event(t(1_030));
        assert_eq!((usart.read(0x00), usart.read(0x04)), (Some(TXE | TC | RXNE), Some(7)));
        usart.feed(&[7], 300, 2_000);
        usart.event(t(5_000));
        assert_eq!((usart.read(0x00), usart.read(0x04)), (Some(TXE | TC | RXNE | FE), Some(0xf8)));
        assert_eq!(usart.read(0x00), Some(TXE | TC));
    }
}
