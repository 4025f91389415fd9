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
use crate::nvic::{self, Nvic};
use crate::peripheral::adc::Adc;
use crate::peripheral::dbgmcu::Dbgmcu;
use crate::peripheral::dma::{Dma, Request};
use crate::peripheral::dwt::Dwt;
use crate::peripheral::exti::Exti;
use crate::peripheral::flash::Flash;
use crate::peripheral::gpio::{Gpio, Mode};
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

/// Memory as DMA sees it.
pub(crate) trait Memory {
    /// Fills `bytes` from `address`; false where there is no memory.
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> bool;
    /// Stores `bytes` at `address`; false where there is no memory.
    fn write(&mut self, address: u32, bytes: &[u8]) -> bool;
}

/// All peripherals.
pub(crate) struct Chip {
    /// Core cycles since reset.
    pub(crate) now: u64,
    /// When a peripheral next does something by itself.
    pub(crate) deadline: u64,
    deadlines: [u64; UNITS],
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
const PORRSTF: u32 = 1 << 27;

impl Chip {
    /// A chip after power-up.
    pub(crate) fn new() -> Self {
        Self {
            now: 0,
            deadline: NEVER,
            deadlines: [NEVER; UNITS],
            bus_wait: 0,
            failure: None,
            reset: None,
            nvic: Nvic::new(),
            scb: Scb::new(crate::peripheral::flash::FLASH_START),
            flash: Flash::new(),
            gpio: std::array::from_fn(Gpio::new),
            systick: SysTick::default(),
            dwt: Dwt::default(),
            rcc: Rcc::new(board::HSE_HZ, PORRSTF),
            pwr: Pwr::new(),
            exti: Exti::default(),
            syscfg: Syscfg::default(),
            dbgmcu: Dbgmcu::default(),
            rtc: Rtc::default(),
            iwdg: Iwdg::new(),
            timers: TIMERS.map(new_timer),
            spi: Default::default(),
            usart: std::array::from_fn(|_| Usart::new()),
            dma: [Dma::new(1), Dma::new(2)],
            adc: Adc::default(),
            otg: Otg::default(),
            board: Board::new(),
        }
    }

    /// Starts everything anew but time, what lives in the backup domain, and the board; `causes` are flags of RCC_CSR.
    pub(crate) fn restart(&mut self, causes: u32) {
        let (now, rtc) = (self.now, self.rtc.clone());
        let board = std::mem::replace(&mut self.board, Board::new());
        *self = Self { now, rtc, board, rcc: Rcc::new(board::HSE_HZ, causes), ..Self::new() };
        self.refresh(Unit::Board);
        self.find_deadline();
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
            Unit::Gpio(n) => self.gpio[n].read(offset),
            Unit::Exti => self.exti.read(offset),
            Unit::Syscfg => self.syscfg.read(offset),
            Unit::Dbgmcu => self.dbgmcu.read(offset),
            Unit::Rtc => self.rtc.read(offset),
            Unit::Iwdg => self.iwdg.read(offset),
            Unit::Timer(n) => self.timers[n].read(offset, t),
            Unit::Spi(n) => self.spi[n].read(offset),
            Unit::Usart(n) => self.usart[n].read(offset),
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
            Unit::Dma(n) => self.dma[n].write(offset, value),
            Unit::Adc => self.adc.write(offset, value, t),
            Unit::Otg => self.otg.write(offset, value),
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
                Unit::Dma(n) => self.dma[n] = Dma::new(n + 1),
                Unit::Adc => self.adc = Adc::default(),
                Unit::Syscfg => self.syscfg = Syscfg::default(),
                Unit::Pwr => self.pwr = Pwr::new(),
                Unit::Otg => self.otg = Otg::default(),
                _ => continue,
            }
            self.refresh(unit);
        }
    }

    /// After anything has happened to `unit`: its lines, its next event, and the DMA it may ask for.
    fn settle(&mut self, unit: Unit, memory: &mut dyn Memory) {
        self.refresh(unit);
        if matches!(unit, Unit::Spi(_) | Unit::Usart(_) | Unit::Timer(_) | Unit::Adc | Unit::Dma(_)) {
            self.run_dma(memory);
        }
        if unit == Unit::Core {
            for exception in std::mem::take(&mut self.scb.asked) {
                self.nvic.set_pending(exception);
            }
            if std::mem::take(&mut self.scb.reset) {
                self.reset = Some(SFTRSTF);
            }
        }
        self.find_deadline();
    }

    fn find_deadline(&mut self) {
        self.deadline = self.deadlines.into_iter().min().unwrap_or(NEVER);
    }

    /// Brings the interrupt lines of a unit and the time of its next event up to date.
    fn refresh(&mut self, unit: Unit) {
        let t = self.tick(unit);
        let mut next = NEVER;
        match unit {
            Unit::Core => next = self.systick.next(),
            Unit::Exti => {
                for (irq, high) in self.exti.interrupts() {
                    self.nvic.set_line(irq, high);
                }
            }
            Unit::Iwdg => next = self.iwdg.next(),
            Unit::Timer(n) => {
                let high = self.timers[n].interrupts();
                for &irq in timer_interrupts(TIMERS[n]) {
                    self.nvic.set_line(irq, high);
                }
                next = self.timers[n].next(t);
                self.pass_pulses(n);
            }
            Unit::Spi(n) => {
                self.nvic.set_line([35, 36, 51][n], self.spi[n].interrupts());
                next = self.spi[n].next();
            }
            Unit::Usart(n) => {
                self.nvic.set_line([37, 38, 39, 52, 53, 71][n], self.usart[n].interrupts());
                next = self.usart[n].next();
            }
            Unit::Dma(n) => {
                for (irq, high) in self.dma[n].interrupts() {
                    self.nvic.set_line(irq, high);
                }
            }
            Unit::Adc => {
                self.nvic.set_line(18, self.adc.interrupts());
                next = self.adc.next();
            }
            Unit::Board => next = self.board.imu.next(),
            _ => {}
        }
        self.deadlines[unit.index()] = next;
    }

    /// Lets time pass until `to`; everything due on the way happens in order.
    pub(crate) fn advance(&mut self, to: u64, memory: &mut dyn Memory) {
        while self.deadline <= to {
            self.now = self.now.max(self.deadline);
            for unit in Unit::all() {
                if self.deadlines[unit.index()] <= self.now {
                    self.event(unit);
                    self.settle(unit, memory);
                }
            }
        }
        self.now = self.now.max(to);
    }

    fn event(&mut self, unit: Unit) {
        let t = self.tick(unit);
        match unit {
            Unit::Core => {
                let interrupts = self.systick.event();
                if interrupts {
                    self.nvic.set_pending(nvic::SYS_TICK);
                }
            }
            Unit::Iwdg => {
                self.reset = Some(IWDGRSTF);
                self.iwdg = Iwdg::new();
            }
            Unit::Timer(n) => self.timers[n].catch_up(t),
            Unit::Spi(n) => {
                let answer = self.board.exchange(n, self.spi[n].sent(), t.now);
                self.spi[n].receive(answer, t);
                if let Some(register) = self.board.imu.unknown.take() {
                    self.fail(format!("the inertial unit's register {register:#04x} is not modelled as it is used"));
                }
                // It may have been switched on or off.
                self.refresh(Unit::Board);
            }
            Unit::Usart(n) => self.usart[n].event(t),
            Unit::Adc => {
                let value = self.board.convert(self.adc.due());
                self.adc.converted(value, t);
            }
            Unit::Board => {
                if let Some(high) = self.board.event(t.now) {
                    self.drive(board::IMU_READY, high);
                }
            }
            _ => {}
        }
    }

    /// A device drives a pin of the chip.
    fn drive(&mut self, (port, pin): (usize, u32), high: bool) {
        if self.gpio[port].drive(pin, high) && self.syscfg.port_of(pin) == port {
            self.exti.edge(pin, high);
            self.refresh(Unit::Exti);
        }
    }

    /// The chip drives the pins of a port: select lines.
    fn drive_devices(&mut self, port: usize) {
        let (select_port, pin) = board::IMU_SELECT;
        if port == select_port {
            let low = !self.gpio[port].level(pin);
            self.board.imu.select(low);
        }
    }

    /// Gives the pulses of a timer to the speed controllers whose pins it has.
    fn pass_pulses(&mut self, n: usize) {
        for pulse in std::mem::take(&mut self.timers[n].pulses) {
            let here = |&(timer, channel, (port, pin)): &(usize, usize, (usize, u32))| {
                let mine = self.gpio[port].mode(pin) == Mode::Alternate(board::MOTOR_FUNCTION);
                (timer, channel) == (TIMERS[n], pulse.channel) && mine
            };
            if let Some(motor) = board::MOTORS.iter().position(here) {
                self.board.pulse(motor, pulse);
            }
        }
    }

    /// The radio receiver sends these bytes.
    pub(crate) fn hear_radio(&mut self, bytes: &[u8]) {
        let unit = Unit::Usart(board::RADIO);
        let t = self.tick(unit);
        self.usart[board::RADIO].feed(bytes, t);
        self.refresh(unit);
        self.find_deadline();
    }

    /// Moves beats until nobody asks for one.
    fn run_dma(&mut self, memory: &mut dyn Memory) {
        for n in 0..2 {
            if !self.dma[n].is_on() {
                continue;
            }
            for stream in 0..8 {
                while let Some(request) = self.dma[n].request(stream)
                    && self.wants(request)
                {
                    self.beat(n, stream, memory);
                }
            }
        }
    }

    fn wants(&self, request: Request) -> bool {
        match request {
            Request::SpiRx(n) => self.spi[n - 1].wants_read(),
            Request::SpiTx(n) => self.spi[n - 1].wants_write(),
            Request::UsartRx(n) => self.usart[n - 1].wants_read(),
            Request::UsartTx(n) => self.usart[n - 1].wants_write(),
            Request::I2cRx(_) | Request::I2cTx(_) => false,
            Request::TimerUpdate(n) => {
                TIMERS.iter().position(|&number| number == n).is_some_and(|n| self.timers[n].wants_dma())
            }
            Request::Adc(_) => self.adc.wants_read(),
        }
    }

    fn beat(&mut self, dma: usize, stream: usize, memory: &mut dyn Memory) {
        let beat = self.dma[dma].take(stream);
        let Some((unit, offset)) = locate(beat.peripheral) else {
            return self.fail(format!("DMA{} stream {stream} moves to or from {:#010x}", dma + 1, beat.peripheral));
        };
        let mut word = [0; 4];
        let done = if beat.to_peripheral {
            memory.read(beat.memory, &mut word[..beat.bytes])
                && self.write_register(unit, offset, beat.bytes, u32::from_le_bytes(word)).is_some()
        } else {
            let value = self.read_register(unit, offset);
            word = value.unwrap_or(0).to_le_bytes();
            value.is_some() && memory.write(beat.memory, &word[..beat.bytes])
        };
        if !done {
            self.fail(format!("DMA{} cannot do {beat:x?}", dma + 1));
        }
        self.refresh(unit);
        self.refresh(Unit::Dma(dma));
    }
}

fn new_timer(number: usize) -> Timer {
    Timer::new(matches!(number, 2 | 5), matches!(number, 1 | 8))
}

/// Interrupts of a timer; those of the advanced ones for update and compare.
fn timer_interrupts(number: usize) -> &'static [u32] {
    match number {
        1 => &[25, 27],
        2 => &[28],
        3 => &[29],
        4 => &[30],
        5 => &[50],
        _ => &[44, 46],
    }
}

/// The bus of a unit's registers, for its clock.
impl Unit {
    fn bus(self) -> Bus {
        match self {
            Unit::Timer(n) if matches!(TIMERS[n], 1 | 8) => Bus::Apb2,
            Unit::Timer(_) | Unit::Rtc | Unit::Iwdg | Unit::Pwr => Bus::Apb1,
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
