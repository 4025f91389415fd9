//! SCB: the core's own registers: vector table, faults, reset request, FPU control.
//!
//! HardFault is the only fault handler: MemManage, BusFault and UsageFault escalate to it, and enabling them is refused.
//!
//! # Source
//! ARMv7-M Architecture Reference Manual, B3.2 "The System Control Block", and C1.6 for DHCSR and DEMCR.
use super::only;

/// Cortex-M4 r0p1.
const CPUID: u32 = 0x410f_c241;
const VECTKEY: u32 = 0x05fa_0000;
const FORCED: u32 = 1 << 30;

/// The system control block.
#[derive(Debug)]
pub(crate) struct Scb {
    /// Address of the vector table.
    pub(crate) vtor: u32,
    scr: u32,
    ccr: u32,
    cfsr: u32,
    hfsr: u32,
    cpacr: u32,
    fpccr: u32,
    demcr: u32,
    /// What a write to ICSR has asked for, exception numbers.
    pub(crate) asked: Vec<u32>,
    /// Whether a reset has been asked for.
    pub(crate) reset: bool,
}

impl Scb {
    pub(crate) fn new(vtor: u32) -> Self {
        Self {
            vtor,
            scr: 0,
            ccr: 0x200,
            cfsr: 0,
            hfsr: 0,
            cpacr: 0,
            fpccr: 0xc000_0000,
            demcr: 0,
            asked: Vec::new(),
            reset: false,
        }
    }

    /// Notes why the CPU goes to HardFault, by the bits of CFSR.
    pub(crate) fn fault(&mut self, cfsr: u32) {
        self.cfsr |= cfsr;
        self.hfsr |= FORCED;
    }

    /// Reads at `offset` of the page 0xE000E000; `running` is the exception being handled.
    pub(crate) fn read(&self, offset: u32, running: u32) -> Option<u32> {
        Some(match offset {
            0xd00 => CPUID,
            0xd04 => running,
            0xd08 => self.vtor,
            0xd0c => 0xfa05_0000,
            0xd10 => self.scr,
            0xd14 => self.ccr,
            0xd24 => 0,
            0xd28 => self.cfsr,
            0xd2c => self.hfsr,
            0xd88 => self.cpacr,
            // No probe.
            0xdf0 => 0,
            0xdfc => self.demcr,
            0xf34 => self.fpccr,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            // PendSV and SysTick may be set; clearing them has no user.
            0xd04 => {
                let value = only(value, 1 << 28 | 1 << 26)?;
                self.asked.extend((value >> 28 & 1 != 0).then_some(crate::nvic::PEND_SV));
                self.asked.extend((value >> 26 & 1 != 0).then_some(crate::nvic::SYS_TICK));
            }
            0xd08 => self.vtor = value,
            // Only the reset request; priority groups are not modelled.
            0xd0c if value & 0xffff_0000 == VECTKEY => self.reset |= only(value & 0xffff, 4)? != 0,
            // SLEEPONEXIT and SEVONPEND are not modelled; SLEEPDEEP would stop clocks.
            0xd10 => self.scr = only(value, 0)?,
            0xd14 => self.ccr = only(value, 0x218)?,
            0xd28 => self.cfsr &= !value,
            0xd2c => self.hfsr &= !value,
            0xd88 => self.cpacr = only(value, 0x00f0_0000)?,
            0xdfc => self.demcr = only(value, 1 << 24)?,
            _ => return None,
        }
        Some(())
    }
}
