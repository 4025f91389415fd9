//! SPI1 to SPI3: master, full duplex, 8 or 16 bits.
//!
//! A word takes `bits·2^(BR + 1)` cycles of the peripheral's clock. The device on the other end answers when the word is
//! through (`board`).
//!
//! # Source
//! RM0090, chapter 28.5 "SPI and I2S registers".
use super::{NEVER, Tick, only};

const RXNE: u32 = 1;
const TXE: u32 = 1 << 1;
const OVR: u32 = 1 << 6;
const BSY: u32 = 1 << 7;

/// A bus master.
#[derive(Debug, Default)]
pub(crate) struct Spi {
    cr1: u32,
    cr2: u32,
    /// A word that waits to be sent.
    waiting: Option<u16>,
    /// The word on the wire, and when it is through.
    sending: Option<(u16, u64)>,
    received: Option<u16>,
    last: u16,
    overrun: bool,
}

impl Spi {
    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x08 => {
                let flag = |on: bool, bit: u32| if on { bit } else { 0 };
                flag(self.received.is_some(), RXNE)
                    | flag(self.waiting.is_none(), TXE)
                    | flag(self.overrun, OVR)
                    | flag(self.sending.is_some(), BSY)
            }
            0x0c => {
                self.overrun = false;
                self.last = self.received.take().unwrap_or(self.last);
                self.last.into()
            }
            0x1c => 0,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, t: Tick) -> Option<()> {
        match offset {
            // No CRC, no half duplex.
            0x00 => self.cr1 = only(value, 0x0bff)?,
            0x04 => self.cr2 = only(value, 0xe7)?,
            0x0c if self.cr1 & 1 << 6 != 0 => {
                self.waiting = Some(value as u16);
                self.start(t);
            }
            0x1c => {
                only(value, 0)?;
            }
            _ => return None,
        }
        Some(())
    }

    fn start(&mut self, t: Tick) {
        if self.sending.is_none() {
            let bits = if self.cr1 & 1 << 11 == 0 { 8 } else { 16 };
            let cycles = bits * self.bit_cycles(t);
            self.sending = self.waiting.take().map(|word| (word, t.now + cycles));
        }
    }

    /// Core cycles that a bit takes.
    pub(crate) fn bit_cycles(&self, t: Tick) -> u64 {
        (2 << (self.cr1 >> 3 & 7)) * t.clock
    }

    /// When the word on the wire is through.
    pub(crate) fn next(&self) -> u64 {
        self.sending.map_or(NEVER, |(_, done)| done)
    }

    /// The word that is through; [`Self::receive`] must follow.
    pub(crate) fn sent(&self) -> u16 {
        self.sending.map_or(0, |(word, _)| word)
    }

    /// What the device has answered; the next word starts.
    pub(crate) fn receive(&mut self, word: u16, t: Tick) {
        self.overrun |= self.received.is_some();
        self.received.get_or_insert(word);
        self.sending = None;
        self.start(t);
    }

    pub(crate) fn interrupts(&self) -> bool {
        let enabled = |bit: u32| self.cr2 & bit != 0;
        enabled(1 << 6) && self.received.is_some()
            || enabled(1 << 7) && self.waiting.is_none()
            || enabled(1 << 5) && self.overrun
    }

    pub(crate) fn wants_read(&self) -> bool {
        self.cr2 & 1 != 0 && self.received.is_some()
    }

    pub(crate) fn wants_write(&self) -> bool {
        self.cr2 & 2 != 0 && self.cr1 & 1 << 6 != 0 && self.waiting.is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_follow_each_other_and_an_unread_one_overruns() {
        let t = |now| Tick { now, clock: 2 };
        let mut spi = Spi::default();
        assert_eq!(spi.write(0x0c, 1, t(0)), None, "not enabled");
        // Divided by 8.
        spi.write(0x00, 1 << 6 | 2 << 3 | 4, t(0));
        spi.write(0x0c, 0xa5, t(0));
        spi.write(0x0c, 0x5a, t(0));
        assert_eq!(spi.read(0x08), Some(BSY));
        assert_eq!((spi.next(), spi.sent()), (128, 0xa5));
        spi.receive(0x11, t(128));
        assert_eq!(spi.read(0x08), Some(BSY | TXE | RXNE));
        assert_eq!((spi.next(), spi.sent()), (256, 0x5a));
        spi.receive(0x22, t(256));
        assert_eq!(spi.read(0x08), Some(TXE | RXNE | OVR));
        assert_eq!(spi.read(0x0c), Some(0x11));
        assert_eq!(spi.read(0x08), Some(TXE));
    }
}
