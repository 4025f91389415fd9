//! RCC: clocks and resets.
//!
//! Oscillators and PLLs are ready as soon as they are on. Clocks are as the registers say; the core's frequency is what
//! the PLL gives, and peripherals know their own as core cycles a tick. AHB prescalers other than 1 are not modelled.
//!
//! # Source
//! RM0090, chapter 7 "Reset and clock control for STM32F405xx".
use super::only;

/// Frequency of the internal oscillator, Hz.
const HSI_HZ: u64 = 16_000_000;

/// A peripheral bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Bus {
    Ahb,
    Apb1,
    Apb2,
}

/// The clock controller.
#[derive(Debug)]
pub(crate) struct Rcc {
    cr: u32,
    pllcfgr: u32,
    cfgr: u32,
    cir: u32,
    /// AHB1, AHB2, AHB3, -, APB1, APB2.
    enable: [u32; 6],
    reset: [u32; 6],
    low_power: [u32; 6],
    bdcr: u32,
    csr: u32,
    sscgr: u32,
    plli2scfgr: u32,
    /// Frequency of the board's crystal, Hz.
    hse_hz: u64,
}

/// On bits of CR; the ready bit of each is the next one.
const ON_BITS: u32 = 1 | 1 << 16 | 1 << 24 | 1 << 26;

impl Rcc {
    /// The state after a reset whose flags in CSR are `causes`.
    pub(crate) fn new(hse_hz: u64, causes: u32) -> Self {
        Self {
            cr: 0x83,
            pllcfgr: 0x2400_3010,
            cfgr: 0,
            cir: 0,
            enable: [0x0010_0000, 0, 0, 0, 0, 0],
            reset: [0; 6],
            low_power: [0x7e67_91ff, 0xf1, 1, 0, 0x36fe_c9ff, 0x0007_5f33],
            bdcr: 0,
            csr: causes,
            sscgr: 0,
            plli2scfgr: 0x2000_3000,
            hse_hz,
        }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => (self.cr & !(ON_BITS << 1)) | (self.cr & ON_BITS) << 1,
            0x04 => self.pllcfgr,
            0x08 => (self.cfgr & !0xc) | (self.cfgr & 3) << 2,
            0x0c => self.cir,
            0x10..=0x24 => self.reset[(offset as usize - 0x10) / 4],
            0x30..=0x44 => self.enable[(offset as usize - 0x30) / 4],
            0x50..=0x64 => self.low_power[(offset as usize - 0x50) / 4],
            // The low-speed oscillator is ready when on.
            0x70 => (self.bdcr & !2) | (self.bdcr & 1) << 1,
            0x74 => (self.csr & !2) | (self.csr & 1) << 1,
            0x80 => self.sscgr,
            0x84 => self.plli2scfgr,
            // DCKCFGR of larger chips, which libraries for the family look at; reserved here.
            0x8c => 0,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 => self.cr = value & !(ON_BITS << 1),
            0x04 => self.pllcfgr = value,
            // HPRE must stay 1; clock outputs are not modelled.
            0x08 => self.cfgr = only(value, 0x001f_fc0f)? & !0xc,
            0x0c => self.cir = only(value, 0)?,
            0x10..=0x24 => self.reset[(offset as usize - 0x10) / 4] = value,
            0x30..=0x44 => self.enable[(offset as usize - 0x30) / 4] = value,
            0x50..=0x64 => self.low_power[(offset as usize - 0x50) / 4] = value,
            0x70 => self.bdcr = value & !2,
            // RMVF clears the causes of the last reset.
            0x74 if value & 1 << 24 != 0 => self.csr = value & 1,
            0x74 => self.csr = (self.csr & !1) | value & 1,
            0x84 => self.plli2scfgr = value,
            0x8c => {
                only(value, 0)?;
            }
            _ => return None,
        }
        Some(())
    }

    /// Whether the clock at `bit` of the enable register at `offset` runs.
    pub(crate) fn is_enabled(&self, offset: u32, bit: u32) -> bool {
        self.enable[(offset as usize - 0x30) / 4] >> bit & 1 != 0
    }

    /// Frequency of the core, Hz.
    pub(crate) fn core_hz(&self) -> u64 {
        let field = |shift: u32, bits: u32| u64::from(self.pllcfgr >> shift & ((1 << bits) - 1));
        match self.cfgr & 3 {
            0 => HSI_HZ,
            1 => self.hse_hz,
            _ => {
                let source = if self.pllcfgr >> 22 & 1 == 1 { self.hse_hz } else { HSI_HZ };
                source * field(6, 9) / field(0, 6).max(1) / (2 * (field(16, 2) + 1))
            }
        }
    }

    /// Core cycles in a cycle of this bus.
    pub(crate) fn bus_cycles(&self, bus: Bus) -> u64 {
        let divider = |field: u32| if field & 4 == 0 { 1 } else { 2 << (field & 3) };
        match bus {
            Bus::Ahb => 1,
            Bus::Apb1 => divider(self.cfgr >> 10 & 7),
            Bus::Apb2 => divider(self.cfgr >> 13 & 7),
        }
    }

    /// Core cycles in a cycle of this bus's timers, which run at twice its clock where it is divided.
    pub(crate) fn timer_cycles(&self, bus: Bus) -> u64 {
        (self.bus_cycles(bus) / 2).max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_setting_gives_168_mhz_and_its_timers_84() {
        let mut rcc = Rcc::new(8_000_000, 0);
        assert_eq!(rcc.core_hz(), 16_000_000);
        // HSE, M = 4, N = 168, P = 2.
        rcc.write(0x04, 1 << 22 | 7 << 24 | 168 << 6 | 4);
        rcc.write(0x08, 0b100 << 13 | 0b101 << 10 | 2);
        assert_eq!(rcc.core_hz(), 168_000_000);
        assert_eq!((rcc.bus_cycles(Bus::Apb1), rcc.timer_cycles(Bus::Apb1)), (4, 2));
        assert_eq!((rcc.bus_cycles(Bus::Apb2), rcc.timer_cycles(Bus::Apb2)), (2, 1));
        assert_eq!(rcc.read(0x08).map(|cfgr| cfgr >> 2 & 3), Some(2));
    }
}
