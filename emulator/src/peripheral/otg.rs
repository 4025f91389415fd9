//! USB OTG FS: a port whose cable leads nowhere. The core may set it up as a device and connect itself; then nobody is on the bus,
//! which counts as suspended after 3 ms: the one interrupt that comes.
//!
//! What only a computer at the other end would have the core touch, endpoints and FIFOs, is not modelled, and refused.
//!
//! # Source
//! RM0090, chapter 34.16 "OTG_FS control and status registers"; USB 2.0, chapter 7.1.7.6 for the 3 ms.
use super::{NEVER, Tick, only};
use crate::board::CYCLES_US;

const GAHBCFG: u32 = 0x008;
const GUSBCFG: u32 = 0x00c;
const GINTMSK: u32 = 0x018;
const GCCFG: u32 = 0x038;
const DCFG: u32 = 0x800;
const DCTL: u32 = 0x804;
const DIEPMSK: u32 = 0x810;
const DOEPMSK: u32 = 0x814;
/// Registers that keep what is written, and the bits that they may be given.
const KEPT: [(u32, u32); 8] = [
    // The mask of all interrupts.
    (GAHBCFG, 1),
    // Device mode, embedded PHY.
    (GUSBCFG, 1 << 30 | 1 << 6),
    // Any interrupt but those of host mode.
    (GINTMSK, 0xf03c_fcfe),
    // Transceiver on, no sensing of the cable's supply.
    (GCCFG, 1 << 16 | 1 << 21),
    // Full speed, address 0.
    (DCFG, 0x3),
    // Soft disconnect.
    (DCTL, SDIS),
    (DIEPMSK, 0x7f),
    (DOEPMSK, 0x7f),
];
/// DCTL: not connected.
const SDIS: u32 = 1 << 1;
/// GINTSTS: the bus is suspended.
const USBSUSP: u32 = 1 << 11;
/// How long a bus is idle before it counts as suspended, core cycles.
const IDLE: u64 = 3_000 * CYCLES_US;

/// The port.
#[derive(Debug)]
pub(crate) struct Otg {
    kept: [u32; KEPT.len()],
    raised: u32,
    suspends_at: u64,
}

impl Otg {
    pub(crate) fn new() -> Self {
        let mut otg = Self { kept: [0; KEPT.len()], raised: 0, suspends_at: NEVER };
        // As it comes out of reset, but that it is not connected.
        otg.kept[5] = SDIS;
        otg
    }

    fn kept(&self, offset: u32) -> Option<u32> {
        KEPT.iter().position(|&(known, _)| known == offset).map(|n| self.kept[n])
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            // GRSTCTL: idle.
            0x010 => Some(1 << 31),
            // GINTSTS: device mode.
            0x014 => Some(self.raised),
            // The core's number, and what it was made with: a PHY of its own.
            0x03c => Some(0x1200),
            0x050 => Some(0),
            // DIEPCTL and DOEPCTL: no endpoint is enabled.
            0x900 | 0x920 | 0x940 | 0x960 | 0xb00 | 0xb20 | 0xb40 | 0xb60 => Some(0),
            _ => self.kept(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, t: Tick) -> Option<()> {
        if offset == 0x014 {
            self.raised &= !value;
            return Some(());
        }
        let n = KEPT.iter().position(|&(known, _)| known == offset)?;
        let was = std::mem::replace(&mut self.kept[n], only(value, KEPT[n].1)?);
        if offset == DCTL {
            self.suspends_at = match (was & SDIS != 0, value & SDIS != 0) {
                (true, false) => t.now + IDLE,
                (_, true) => NEVER,
                _ => self.suspends_at,
            };
        }
        Some(())
    }

    pub(crate) fn next(&self) -> u64 {
        self.suspends_at
    }

    pub(crate) fn event(&mut self) {
        self.raised |= USBSUSP;
        self.suspends_at = NEVER;
    }

    pub(crate) fn interrupts(&self) -> bool {
        let on = |offset| self.kept(offset).unwrap_or(0);
        on(GAHBCFG) & 1 != 0 && on(GINTMSK) & self.raised != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_connects_finds_its_bus_suspended_once_and_refuses_what_needs_a_computer() {
        let t = |now| Tick { now, clock: 1 };
        let mut otg = Otg::new();
        for (offset, value) in [(GAHBCFG, 1), (GINTMSK, USBSUSP), (DCTL, SDIS)] {
            assert_eq!(otg.write(offset, value, t(0)), Some(()));
        }
        assert_eq!(otg.next(), NEVER);
        otg.write(DCTL, 0, t(1_000)).expect("it connects");
        assert_eq!(otg.next(), 1_000 + 504_000);
        otg.event();
        assert!(otg.interrupts() && otg.next() == NEVER);
        otg.write(0x014, USBSUSP, t(600_000)).expect("it is seen");
        assert!(!otg.interrupts());
        assert_eq!(otg.read(0x920), Some(0));
        // An endpoint's control, a FIFO, and interrupts that FIFOs raise.
        for (offset, value) in [(0x920, 1 << 15), (0x1000, 0), (GAHBCFG, 1 << 7 | 1)] {
            assert_eq!(otg.write(offset, value, t(0)), None);
        }
    }
}
