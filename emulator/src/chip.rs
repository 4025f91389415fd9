//! The chip: its peripherals on their buses, their interrupt lines, and time.
//!
//! Time is counted in core cycles since reset. Every peripheral says when it next does something by itself; the earliest
//! of these is [`Chip::deadline`], and until then only the program can change anything. Lines and DMA follow at once from
//! every access and every event.
//!
//! An access to the peripheral buses costs the core two cycles of the bus on top of its own: the manual gives no figure.
//!
//! # Source
//! RM0090, table 1 "STM32F4xx register boundary addresses", table 62 "Vector table".
use crate::board::{self, Board};
use crate::nvic::Nvic;
use crate::peripheral::adc::Adc;
use crate::peripheral::dbgmcu::Dbgmcu;
use crate::peripheral::dma::Dma;
use crate::peripheral::dwt::Dwt;
use crate::peripheral::exti::Exti;
use crate::peripheral::flash::{Extent, Flash, Operation};
use crate::peripheral::gpio::Gpio;
use crate::peripheral::i2c::I2c;
use crate::peripheral::iwdg::Iwdg;
use crate::peripheral::otg::Otg;
use crate::peripheral::pwr::Pwr;
use crate::peripheral::rcc::{Bus, Rcc};
use crate::peripheral::rtc::Rtc;
use crate::peripheral::scb::Scb;
use crate::peripheral::spi::Spi;
use crate::peripheral::syscfg::Syscfg;
use crate::peripheral::systick::SysTick;
use crate::peripheral::timer::Timer;
use crate::peripheral::usart::Usart;
use crate::peripheral::{NEVER, Tick};
use crate::unit::{UNITS, Unit, locate};

mod events;
mod transfers;

/// Memory as DMA sees it.
pub(crate) trait Memory {
    /// Fills `bytes` from `address`; false where there is no memory.
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> bool;
    /// Stores `bytes` at `address`; false where there is no memory.
    fn write(&mut self, address: u32, bytes: &[u8]) -> bool;
    /// Erases flash, as far as power allows.
    fn erase(&mut self, address: u32, bytes: u32, extent: Extent);
}

/// All peripherals.
pub(crate) struct Chip {
    /// Core cycles since reset.
    pub(crate) now: u64,
    /// When a peripheral next does something by itself.
    pub(crate) deadline: u64,
    deadlines: [u64; UNITS],
    /// By place.
    units: Vec<Unit>,
    /// Cycles that the core has waited for buses since they were last taken.
    pub(crate) bus_wait: u64,
    /// What went wrong first, if anything has.
    pub(crate) failure: Option<String>,
    /// Whether the chip is to be reset, and the flags of RCC_CSR that say why.
    pub(crate) reset: Option<u32>,
    pub(crate) nvic: Nvic,
    pub(crate) scb: Scb,
    pub(crate) flash: Flash,
    pub(crate) gpio: [Gpio; 9],
    systick: SysTick,
    dwt: Dwt,
    rcc: Rcc,
    pwr: Pwr,
    exti: Exti,
    syscfg: Syscfg,
    dbgmcu: Dbgmcu,
    rtc: Rtc,
    iwdg: Iwdg,
    pub(crate) timers: [Timer; 6],
    spi: [Spi; 3],
    pub(crate) usart: [Usart; 6],
    i2c: [I2c; 3],
    dma: [Dma; 2],
    adc: Adc,
    otg: Otg,
    pub(crate) board: Board,
}

/// Numbers of the timers that are modelled.
pub(crate) const TIMERS: [usize; 6] = [1, 2, 3, 4, 5, 8];
/// RCC_CSR: the independent watchdog, the software, and power have reset the chip.
const IWDGRSTF: u32 = 1 << 29;
const SFTRSTF: u32 = 1 << 28;
pub(crate) const PORRSTF: u32 = 1 << 27;
/// The supply has been too low.
pub(crate) const BORRSTF: u32 = 1 << 25;

impl Chip {
    /// A chip after power-up.
    pub(crate) fn new() -> Self {
        Self {
            now: 0,
            deadline: NEVER,
            deadlines: [NEVER; UNITS],
            units: Unit::all().collect(),
            bus_wait: 0,
            failure: None,
            reset: None,
            nvic: Nvic::new(),
            scb: Scb::new(crate::peripheral::flash::FLASH_START),
            flash: Flash::new(),
            gpio: std::array::from_fn(Gpio::new),
            systick: SysTick::default(),
            dwt: Dwt::default(),
            rcc: Rcc::new(board::HSE_HZ, PORRSTF | BORRSTF),
            pwr: Pwr::new(),
            exti: Exti::default(),
            syscfg: Syscfg::default(),
            dbgmcu: Dbgmcu::default(),
            rtc: Rtc::default(),
            iwdg: Iwdg::new(),
            timers: TIMERS.map(new_timer),
            spi: Default::default(),
            usart: std::array::from_fn(|_| Usart::new()),
            i2c: Default::default(),
            dma: [Dma::new(1), Dma::new(2)],
            adc: Adc::default(),
            otg: Otg::new(),
            board: Board::new(),
        }
    }

    /// Starts everything anew but time, what lives in the backup domain, and the board; `causes` are flags of RCC_CSR.
    pub(crate) fn restart(&mut self, causes: u32) {
        let (now, mut rtc) = (self.now, self.rtc.clone());
        let mut board = std::mem::replace(&mut self.board, Board::new());
        if causes & PORRSTF != 0 {
            rtc = Rtc::default();
            board.cut_power(now);
        }
        // What is on its way to others is out.
        let sent = self.usart.each_mut().map(|port| std::mem::take(&mut port.sent));
        let cut = self.flash.cut.filter(|_| causes & PORRSTF == 0);
        *self = Self { now, rtc, board, rcc: Rcc::new(board::HSE_HZ, causes), ..Self::new() };
        self.flash.cut = cut;
        for (port, sent) in self.usart.iter_mut().zip(sent) {
            port.sent = sent;
        }
        self.refresh(Unit::Board);
    }

    /// Frequency of the core, Hz.
    pub(crate) fn core_hz(&self) -> u64 {
        self.rcc.core_hz()
    }

    /// Notes what went wrong, if nothing has before.
    pub(crate) fn fail(&mut self, what: String) {
        self.failure.get_or_insert(what);
    }

    /// The core reads.
    pub(crate) fn read(&mut self, address: u32, bytes: usize, memory: &mut dyn Memory) -> u32 {
        let Some((unit, offset)) = self.reach(address, "read") else { return 0 };
        self.bus_wait += self.wait(unit);
        let value = self.read_register(unit, offset & !3);
        self.settle(unit, memory);
        let Some(value) = value else {
            self.fail(format!("{unit} has no register at offset {offset:#05x} to read ({address:#010x})"));
            return 0;
        };
        let shifted = value >> (8 * (address & 3));
        if bytes < 4 { shifted & ((1 << (8 * bytes)) - 1) } else { shifted }
    }

    /// The core writes.
    pub(crate) fn write(&mut self, address: u32, bytes: usize, value: u32, memory: &mut dyn Memory) {
        let Some((unit, offset)) = self.reach(address, "write") else { return };
        self.bus_wait += self.wait(unit);
        if self.write_register(unit, offset, bytes, value).is_none() {
            self.fail(format!("{unit} does not model {value:#010x} written at offset {offset:#05x} ({address:#010x})"));
        }
        self.settle(unit, memory);
    }

    /// The unit at an address, if there is one and its clock runs.
    fn reach(&mut self, address: u32, to: &str) -> Option<(Unit, u32)> {
        let Some((unit, offset)) = locate(address) else {
            self.fail(format!("nothing is modelled at {address:#010x}, {to}"));
            return None;
        };
        if let Some((register, bit)) = unit.clock_enable()
            && !self.rcc.is_enabled(register, bit)
        {
            self.fail(format!("{unit} is accessed while its clock is off ({address:#010x}, {to})"));
            return None;
        }
        Some((unit, offset))
    }

    fn wait(&self, unit: Unit) -> u64 {
        match unit {
            Unit::Core | Unit::Dwt => 0,
            _ => 2 * self.rcc.bus_cycles(unit.bus()),
        }
    }

    fn tick(&self, unit: Unit) -> Tick {
        let clock = match unit {
            Unit::Timer(_) => self.rcc.timer_cycles(unit.bus()),
            _ => self.rcc.bus_cycles(unit.bus()),
        };
        Tick { now: self.now, clock }
    }

    fn read_register(&mut self, unit: Unit, offset: u32) -> Option<u32> {
        let (now, t) = (self.now, self.tick(unit));
        match unit {
            Unit::Core => {
                let running = self.nvic.running();
                self.nvic
                    .read(offset)
                    .or_else(|| self.scb.read(offset, running))
                    .or_else(|| self.systick.read(offset, now))
            }
            Unit::Dwt => self.dwt.read(offset, now),
            Unit::Rcc => self.rcc.read(offset),
            Unit::Pwr => self.pwr.read(offset),
            Unit::Flash => self.flash.read(offset, now),
            Unit::Gpio(n) => {
                self.feel_lines(n);
                self.gpio[n].read(offset)
            }
            Unit::Exti => self.exti.read(offset),
            Unit::Syscfg => self.syscfg.read(offset),
            Unit::Dbgmcu => self.dbgmcu.read(offset),
            Unit::Rtc => self.rtc.read(offset),
            Unit::Iwdg => self.iwdg.read(offset),
            Unit::Timer(n) => self.timers[n].read(offset, t),
            Unit::Spi(n) => self.spi[n].read(offset),
            Unit::Usart(n) => self.usart[n].read(offset),
            Unit::I2c(n) => self.i2c[n].read(offset, t),
            Unit::Dma(n) => self.dma[n].read(offset),
            Unit::Adc => self.adc.read(offset),
            Unit::Otg => self.otg.read(offset),
            Unit::Board => None,
        }
    }

    fn write_register(&mut self, unit: Unit, offset: u32, bytes: usize, value: u32) -> Option<()> {
        let (now, t, core_hz) = (self.now, self.tick(unit), self.core_hz());
        // Only the core's own registers have meaningful bytes within a word.
        if unit != Unit::Core && offset & 3 != 0 {
            return None;
        }
        match unit {
            Unit::Core => self
                .nvic
                .write(offset, bytes, value)
                .or_else(|| self.scb.write(offset, value))
                .or_else(|| self.systick.write(offset, value, now)),
            Unit::Dwt => self.dwt.write(offset, value, now),
            Unit::Rcc => {
                self.rcc.write(offset, value)?;
                self.reset_units(offset, value);
                Some(())
            }
            Unit::Pwr => self.pwr.write(offset, value),
            Unit::Flash => self.flash.write(offset, value, now, core_hz),
            Unit::Gpio(n) => {
                self.gpio[n].write(offset, value)?;
                self.drive_devices(n);
                Some(())
            }
            Unit::Exti => self.exti.write(offset, value),
            Unit::Syscfg => self.syscfg.write(offset, value),
            Unit::Dbgmcu => self.dbgmcu.write(offset, value),
            Unit::Rtc => self.rtc.write(offset, value, self.pwr.unlocks_backup()),
            Unit::Iwdg => self.iwdg.write(offset, value, now, core_hz),
            Unit::Timer(n) => self.timers[n].write(offset, value, t),
            Unit::Spi(n) => self.spi[n].write(offset, value, t),
            Unit::Usart(n) => self.usart[n].write(offset, value, t),
            Unit::I2c(n) => self.i2c[n].write(offset, value, t),
            Unit::Dma(n) => self.dma[n].write(offset, value),
            Unit::Adc => self.adc.write(offset, value, t),
            Unit::Otg => self.otg.write(offset, value, t),
            Unit::Board => None,
        }
    }

    /// A reset register of RCC was written: the units of its bits start anew.
    fn reset_units(&mut self, offset: u32, value: u32) {
        for unit in Unit::all() {
            let Some((enable, bit)) = unit.clock_enable() else { continue };
            if enable != offset + 0x20 || value >> bit & 1 == 0 {
                continue;
            }
            match unit {
                Unit::Gpio(n) => self.gpio[n] = Gpio::new(n),
                Unit::Timer(n) => self.timers[n] = new_timer(TIMERS[n]),
                Unit::Spi(n) => self.spi[n] = Spi::default(),
                Unit::Usart(n) => self.usart[n] = Usart::new(),
                Unit::I2c(n) => self.i2c[n] = I2c::default(),
                Unit::Dma(n) => self.dma[n] = Dma::new(n + 1),
                Unit::Adc => self.adc = Adc::default(),
                Unit::Syscfg => self.syscfg = Syscfg::default(),
                Unit::Pwr => self.pwr = Pwr::new(),
                Unit::Otg => self.otg = Otg::new(),
                _ => continue,
            }
            self.refresh(unit);
        }
    }

    /// After anything has happened to `unit`: its lines, its next event, and the DMA it may ask for.
    fn settle(&mut self, unit: Unit, memory: &mut dyn Memory) {
        self.refresh(unit);
        if matches!(unit, Unit::Spi(_) | Unit::Usart(_) | Unit::I2c(_) | Unit::Timer(_) | Unit::Adc | Unit::Dma(_)) {
            self.run_dma(memory);
        }
        if let Some(Operation::Erase { start, length, extent }) = self.flash.started.take() {
            memory.erase(start, length, extent);
            self.wait_for_flash();
        }
        if unit == Unit::Core {
            for exception in std::mem::take(&mut self.scb.asked) {
                self.nvic.set_pending(exception);
            }
            if std::mem::take(&mut self.scb.reset) {
                self.reset = Some(SFTRSTF);
            }
        }
    }

    /// The core stands still until the flash is ready, or has lost power.
    pub(crate) fn wait_for_flash(&mut self) {
        if self.flash.powerless {
            self.reset = Some(PORRSTF | BORRSTF);
        } else {
            self.bus_wait += self.flash.stall(self.now);
        }
    }

    /// Lets time pass until `to`; everything due on the way happens in order.
    pub(crate) fn advance(&mut self, to: u64, memory: &mut dyn Memory) {
        while self.deadline <= to {
            self.now = self.now.max(self.deadline);
            // In the order of their places, so that two runs do the same.
            for place in 0..UNITS {
                if self.deadlines[place] <= self.now {
                    let unit = self.units[place];
                    self.event(unit);
                    self.settle(unit, memory);
                }
            }
        }
        self.now = self.now.max(to);
    }
}

fn new_timer(number: usize) -> Timer {
    Timer::new(matches!(number, 2 | 5), matches!(number, 1 | 8))
}

/// The bus of a unit's registers, for its clock.
impl Unit {
    fn bus(self) -> Bus {
        match self {
            Unit::Timer(n) if matches!(TIMERS[n], 1 | 8) => Bus::Apb2,
            Unit::Timer(_) | Unit::I2c(_) | Unit::Rtc | Unit::Iwdg | Unit::Pwr => Bus::Apb1,
            Unit::Spi(n) => {
                if n == 0 {
                    Bus::Apb2
                } else {
                    Bus::Apb1
                }
            }
            Unit::Usart(n) => {
                if n == 0 || n == 5 {
                    Bus::Apb2
                } else {
                    Bus::Apb1
                }
            }
            Unit::Adc | Unit::Exti | Unit::Syscfg => Bus::Apb2,
            _ => Bus::Ahb,
        }
    }
}
