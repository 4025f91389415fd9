//! I2C1 to I2C3: master, seven-bit addresses, by interrupts or DMA.
//!
//! A bit takes `2·CCR` cycles of the peripheral's clock, `3·CCR` in fast mode; a byte is nine of them, a start or a stop
//! condition one. While the program lets it wait the master holds the clock line. A device that holds
//! the clock holds it for good. Nobody else drives the bus: arbitration is never lost.
//!
//! # Source
//! RM0090, chapter 27.3.3 "I2C master mode", 27.3.7 "DMA requests", 27.6 "I2C registers".
use super::{NEVER, Tick, only};

const SB: u32 = 1;
const ADDR: u32 = 1 << 1;
const BTF: u32 = 1 << 2;
const RXNE: u32 = 1 << 6;
const TXE: u32 = 1 << 7;
const AF: u32 = 1 << 10;
/// Flags of SR1 that a zero clears; only the missing acknowledgement is modelled.
const ERRORS: u32 = 0xdf00;
const MSL: u32 = 1;
const BUSY: u32 = 1 << 1;
const TRA: u32 = 1 << 2;
const PE: u32 = 1;
const START: u32 = 1 << 8;
const STOP: u32 = 1 << 9;
const ACK: u32 = 1 << 10;
const SWRST: u32 = 1 << 15;
const ITERREN: u32 = 1 << 8;
const ITEVTEN: u32 = 1 << 9;
const DMAEN: u32 = 1 << 11;
const LAST: u32 = 1 << 12;

/// What is on the bus.
pub(crate) trait Slaves {
    /// An address with its direction; whether anybody acknowledges, or none while somebody holds the clock.
    fn address(&mut self, byte: u8) -> Option<bool>;
    /// A byte to whom was addressed; whether it acknowledges.
    fn write(&mut self, byte: u8) -> bool;
    /// A byte from whom was addressed.
    fn read(&mut self) -> u8;
}

/// How far a transfer is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Line {
    /// No transfer.
    #[default]
    Free,
    /// Started: an address is to follow.
    Started,
    /// To whom was addressed; once the program has seen ADDR.
    Writing,
    /// From whom was addressed; likewise.
    Reading,
    /// Nobody has acknowledged, or the last byte in was not: a stop or a start is to follow.
    Over,
    /// Somebody holds the clock.
    Held,
}

/// What is on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wire {
    Start,
    Address(u8),
    Out(u8),
    In,
    Stop,
}

/// A bus master.
#[derive(Debug, Default)]
pub(crate) struct I2c {
    cr1: u32,
    cr2: u32,
    sr1: u32,
    sr2: u32,
    ccr: u32,
    trise: u32,
    line: Line,
    /// What is on the wire, and when it is through.
    wire: Option<(Wire, u64)>,
    /// A byte that waits to be sent.
    waiting: Option<u8>,
    /// Bytes that wait to be fetched, the second behind the first.
    received: [Option<u8>; 2],
    /// SR1 was read, so that reading SR2 clears ADDR.
    looked: bool,
    /// The byte on the wire is the last that DMA will fetch.
    last: bool,
}

impl I2c {
    pub(crate) fn read(&mut self, offset: u32, t: Tick) -> Option<u32> {
        Some(match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x08 | 0x0c => 0,
            0x10 => self.fetch(t).into(),
            0x14 => {
                self.looked = true;
                self.sr1
            }
            0x18 => {
                if std::mem::take(&mut self.looked) && self.sr1 & ADDR != 0 {
                    self.sr1 &= !ADDR;
                    self.sr1 |= if self.line == Line::Writing { TXE } else { 0 };
                    self.go_on(t);
                }
                self.sr2
            }
            0x1c => self.ccr,
            0x20 => self.trise,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, t: Tick) -> Option<()> {
        match offset {
            // No SMBus, no packet error codes, no general call, no slave.
            0x00 => {
                self.cr1 = only(value, PE | START | STOP | ACK | SWRST)?;
                if self.cr1 & SWRST != 0 || self.cr1 & PE == 0 {
                    let Self { cr2, ccr, trise, .. } = *self;
                    *self = Self { cr1: value, cr2, ccr, trise, ..Self::default() };
                } else {
                    self.go_on(t);
                }
            }
            // No ITBUFEN: bytes go by DMA.
            0x04 => self.cr2 = only(value, 0x3f | ITERREN | ITEVTEN | DMAEN | LAST)?,
            0x10 => {
                self.sr1 &= !(SB | TXE | BTF);
                self.waiting = Some(value as u8);
                self.go_on(t);
            }
            0x14 => self.sr1 &= value | !ERRORS,
            0x1c => self.ccr = only(value, 0xcfff)?,
            0x20 => self.trise = only(value, 0x3f)?,
            _ => return None,
        }
        Some(())
    }

    fn fetch(&mut self, t: Tick) -> u8 {
        let [first, second] = self.received;
        self.received = [second, None];
        self.sr1 &= !(BTF | if second.is_none() { RXNE } else { 0 });
        self.go_on(t);
        first.unwrap_or(0)
    }

    /// Puts on the wire what is next, if that is free and nothing is left for the program to do first.
    fn go_on(&mut self, t: Tick) {
        if self.wire.is_some() || self.cr1 & PE == 0 || self.sr1 & ADDR != 0 {
            return;
        }
        let (stops, starts) = (self.cr1 & STOP != 0, self.cr1 & START != 0);
        let next = match (self.line, self.waiting) {
            (Line::Started, Some(byte)) => Some(Wire::Address(byte)),
            (Line::Writing, Some(byte)) => Some(Wire::Out(byte)),
            (Line::Reading, _) => self.received[1].is_none().then_some(Wire::In),
            (Line::Writing | Line::Over, _) if stops => Some(Wire::Stop),
            (Line::Free | Line::Writing | Line::Over, _) if starts => Some(Wire::Start),
            _ => None,
        };
        let Some(next) = next else { return };
        if let Wire::Address(_) | Wire::Out(_) = next {
            self.waiting = None;
            self.sr1 |= if self.line == Line::Writing { TXE } else { 0 };
        }
        let bits = if let Wire::Start | Wire::Stop = next { 1 } else { 9 };
        self.wire = Some((next, t.now + bits * self.bit_cycles(t)));
    }

    fn bit_cycles(&self, t: Tick) -> u64 {
        let parts = match self.ccr >> 14 {
            0b10 => 3,
            0b11 => 25,
            _ => 2,
        };
        parts * u64::from((self.ccr & 0xfff).max(1)) * t.clock
    }

    pub(crate) fn next(&self) -> u64 {
        self.wire.map_or(NEVER, |(_, done)| done)
    }

    /// What was on the wire is through.
    pub(crate) fn event(&mut self, t: Tick, slaves: &mut dyn Slaves) {
        let Some((wire, _)) = self.wire.take() else { return };
        match wire {
            Wire::Start => {
                self.cr1 &= !START;
                (self.sr1, self.sr2) = (self.sr1 & !(TXE | BTF) | SB, MSL | BUSY);
                self.line = Line::Started;
            }
            Wire::Address(byte) => match slaves.address(byte) {
                Some(true) => {
                    self.sr1 |= ADDR;
                    (self.looked, self.last) = (false, false);
                    (self.line, self.sr2) =
                        if byte & 1 == 0 { (Line::Writing, MSL | BUSY | TRA) } else { (Line::Reading, MSL | BUSY) };
                }
                Some(false) => self.refuse(),
                // Nothing goes on until the master is reset.
                None => self.line = Line::Held,
            },
            Wire::Out(byte) if slaves.write(byte) => {
                self.sr1 |= if self.waiting.is_none() { BTF } else { 0 };
            }
            Wire::Out(_) => self.refuse(),
            Wire::In => {
                let place = usize::from(self.received[0].is_some());
                self.received[place] = Some(slaves.read());
                self.sr1 |= RXNE | if place == 1 { BTF } else { 0 };
                if self.cr1 & ACK == 0 || self.cr2 & LAST != 0 && self.last {
                    self.line = Line::Over;
                }
            }
            Wire::Stop => {
                self.cr1 &= !STOP;
                (self.sr1, self.sr2, self.line) = (self.sr1 & !(TXE | BTF), 0, Line::Free);
            }
        }
        self.go_on(t);
    }

    fn refuse(&mut self) {
        self.sr1 |= AF;
        self.line = Line::Over;
    }

    /// DMA has fetched the last byte but one.
    pub(crate) fn one_left(&mut self) {
        self.last = true;
    }

    /// Levels of the interrupts of events and of errors.
    pub(crate) fn interrupts(&self) -> [bool; 2] {
        let on = |enable: u32, flags: u32| self.cr2 & enable != 0 && self.sr1 & flags != 0;
        [on(ITEVTEN, SB | ADDR | BTF), on(ITERREN, AF)]
    }

    pub(crate) fn wants_read(&self) -> bool {
        self.cr2 & DMAEN != 0 && self.sr1 & RXNE != 0
    }

    pub(crate) fn wants_write(&self) -> bool {
        self.cr2 & DMAEN != 0 && self.sr1 & TXE != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers at 0x76, acknowledges two bytes, says 1, 2, 3.
    #[derive(Default)]
    struct Slave {
        heard: Vec<u8>,
        said: u8,
    }

    impl Slaves for Slave {
        fn address(&mut self, byte: u8) -> Option<bool> {
            (byte >> 1 != 0x55).then_some(byte >> 1 == 0x76)
        }

        fn write(&mut self, byte: u8) -> bool {
            self.heard.push(byte);
            self.heard.len() < 3
        }

        fn read(&mut self) -> u8 {
            self.said += 1;
            self.said
        }
    }

    const fn t(now: u64) -> Tick {
        Tick { now, clock: 4 }
    }

    /// A master at 35·3 cycles of 4 a bit, started, with an address on the wire.
    fn addressed(byte: u8, slave: &mut Slave) -> I2c {
        let mut i2c = I2c::default();
        i2c.write(0x1c, 0x8023, t(0));
        i2c.write(0x00, PE | ACK | START, t(0));
        assert_eq!(i2c.next(), 420);
        i2c.event(t(420), slave);
        assert_eq!((i2c.read(0x14, t(420)), i2c.read(0x18, t(420))), (Some(SB), Some(MSL | BUSY)));
        i2c.write(0x10, byte.into(), t(420));
        assert_eq!(i2c.next(), 420 + 9 * 420);
        let now = t(i2c.next());
        i2c.event(now, slave);
        i2c
    }

    fn step(i2c: &mut I2c, slave: &mut Slave) {
        let now = t(i2c.next());
        i2c.event(now, slave);
    }

    #[test]
    fn bytes_out_are_flagged_as_they_leave_and_the_stop_frees_the_bus() {
        let mut slave = Slave::default();
        let mut i2c = addressed(0xec, &mut slave);
        assert_eq!(i2c.next(), NEVER, "the clock is held until ADDR is cleared");
        i2c.write(0x04, ITEVTEN, t(0));
        assert_eq!(i2c.interrupts(), [true, false]);
        i2c.read(0x14, t(5_000));
        assert_eq!(i2c.read(0x18, t(5_000)), Some(MSL | BUSY | TRA));
        assert_eq!(i2c.read(0x14, t(5_000)), Some(TXE));
        i2c.write(0x10, 0x06, t(5_000));
        assert_eq!(i2c.read(0x14, t(5_000)), Some(TXE), "it has gone to the wire");
        i2c.write(0x10, 0x54, t(5_000));
        assert_eq!(i2c.read(0x14, t(5_000)), Some(0));
        step(&mut i2c, &mut slave);
        step(&mut i2c, &mut slave);
        assert_eq!((slave.heard.clone(), i2c.read(0x14, t(9_000))), (vec![0x06, 0x54], Some(TXE | BTF)));
        i2c.write(0x00, PE | STOP, t(20_000));
        step(&mut i2c, &mut slave);
        assert_eq!((i2c.read(0x00, t(0)), i2c.read(0x14, t(0)), i2c.read(0x18, t(0))), (Some(PE), Some(0), Some(0)));
    }

    #[test]
    fn an_address_that_nobody_has_is_not_acknowledged_and_clears_by_a_zero() {
        let mut slave = Slave::default();
        let mut i2c = addressed(0x1a, &mut slave);
        i2c.write(0x04, ITERREN, t(0));
        assert_eq!((i2c.read(0x14, t(0)), i2c.interrupts()), (Some(AF), [false, true]));
        i2c.write(0x14, !AF, t(0));
        assert_eq!(i2c.interrupts(), [false, false]);
        i2c.write(0x00, PE | STOP, t(5_000));
        step(&mut i2c, &mut slave);
        assert_eq!((i2c.read(0x18, t(0)), i2c.next()), (Some(0), NEVER));
    }

    #[test]
    fn bytes_in_go_on_until_dma_has_one_left_or_nobody_fetches() {
        let mut slave = Slave::default();
        let mut i2c = addressed(0xed, &mut slave);
        i2c.write(0x04, DMAEN | LAST, t(0));
        i2c.read(0x14, t(5_000));
        i2c.read(0x18, t(5_000));
        step(&mut i2c, &mut slave);
        step(&mut i2c, &mut slave);
        assert_eq!((i2c.read(0x14, t(0)), i2c.next()), (Some(RXNE | BTF), NEVER), "two wait, the clock is held");
        assert!(i2c.wants_read());
        assert_eq!((i2c.read(0x10, t(20_000)), i2c.read(0x10, t(20_000))), (Some(1), Some(2)));
        i2c.one_left();
        step(&mut i2c, &mut slave);
        assert_eq!((i2c.read(0x10, t(30_000)), i2c.next(), slave.said), (Some(3), NEVER, 3));
    }

    #[test]
    fn a_clock_that_is_held_holds_all_until_the_master_is_reset() {
        let mut slave = Slave::default();
        let mut i2c = addressed(0xaa, &mut slave);
        i2c.write(0x04, ITEVTEN | ITERREN, t(0));
        i2c.write(0x00, PE | STOP, t(5_000));
        assert_eq!((i2c.read(0x14, t(0)), i2c.interrupts(), i2c.next()), (Some(0), [false, false], NEVER));
        i2c.write(0x00, SWRST, t(9_000));
        i2c.write(0x00, PE | START, t(9_000));
        assert_eq!(i2c.next(), 9_420);
    }
}
