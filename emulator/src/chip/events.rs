//! What the chip does when something has happened: interrupt lines, events that are due, and the devices at its pins.
use super::{Chip, IWDGRSTF, TIMERS};
use crate::board;
use crate::nvic;
use crate::peripheral::NEVER;
use crate::peripheral::gpio::Mode;
use crate::peripheral::iwdg::Iwdg;
use crate::unit::Unit;

impl Chip {
    /// Brings the interrupt lines of a unit and the time of its next event up to date.
    pub(super) fn refresh(&mut self, unit: Unit) {
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
            Unit::I2c(n) => {
                let [events, errors] = self.i2c[n].interrupts();
                let (first, second) = [(31, 32), (33, 34), (72, 73)][n];
                self.nvic.set_line(first, events);
                self.nvic.set_line(second, errors);
                next = self.i2c[n].next();
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
            Unit::Otg => {
                self.nvic.set_line(67, self.otg.interrupts());
                next = self.otg.next();
            }
            Unit::Board => next = self.board.imu.next(),
            _ => {}
        }
        let before = std::mem::replace(&mut self.deadlines[unit.index()], next);
        if next <= self.deadline {
            self.deadline = next;
        } else if before == self.deadline {
            self.deadline = self.deadlines.into_iter().min().unwrap_or(NEVER);
        }
    }

    /// Something is due in a unit.
    pub(super) fn event(&mut self, unit: Unit) {
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
                let muxed =
                    |(port, pin): (usize, u32)| self.gpio[port].mode(pin) == Mode::Alternate(board::CARD_FUNCTION);
                if n == board::CARD && !board::CARD_PINS.into_iter().all(muxed) {
                    self.fail("the card's bus is used without its pins".to_owned());
                }
                let (hz, hz_max) = (self.core_hz() / self.spi[n].bit_cycles(t), self.board.spi_hz_max(n));
                if hz > hz_max {
                    self.fail(format!("{unit} runs at {hz} Hz, what is on it can take {hz_max} Hz"));
                }
                let answer = self.board.exchange(n, self.spi[n].sent(), t.now);
                if let Some(what) = self.board.unknown_of_log() {
                    self.fail(what);
                }
                self.spi[n].receive(answer, t);
                if let Some(register) = self.board.imu.unknown.take() {
                    self.fail(format!("the inertial unit's register {register:#04x} is not modelled as it is used"));
                }
                // It may have been switched on or off.
                self.refresh(Unit::Board);
            }
            Unit::Usart(n) => {
                self.usart[n].event(t);
                if n == board::GNSS {
                    let sent = std::mem::take(&mut self.usart[n].sent);
                    if self.usart[n].is_speed(board::bit_cycles(self.board.gnss.baud), t) {
                        self.tell_receiver(&sent);
                    }
                }
            }
            Unit::I2c(n) if n == board::SENSORS => {
                let connected = board::SENSOR_PINS
                    .iter()
                    .all(|&(port, pin)| self.gpio[port].mode(pin) == Mode::Alternate(board::SENSOR_FUNCTION));
                if !connected {
                    self.fail("the sensors' bus is used without its pins".to_owned());
                }
                self.i2c[n].event(t, self.board.sensors.at(t.now));
                if let Some(what) = self.board.sensors.unknown.take() {
                    self.fail(what);
                }
            }
            Unit::Adc if self.board.conversions_lost > 0 => {
                self.board.conversions_lost -= 1;
                self.adc.lose();
            }
            Unit::Adc => {
                let channel = self.adc.due();
                let read = self.board.convert(channel);
                match read.filter(|&((port, pin), _)| self.gpio[port].mode(pin) == Mode::Analog) {
                    Some((_, value)) => self.adc.converted(value, t),
                    None => self.fail(format!("{unit} reads channel {channel}, which has no line or no analog pin")),
                }
            }
            Unit::Otg => self.otg.event(),
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

    /// What speed controllers make of their lines, as the chip looks at a port.
    pub(super) fn feel_lines(&mut self, n: usize) {
        for (esc, (_, _, (port, pin))) in self.board.escs.iter().zip(board::MOTORS) {
            if port == n {
                self.gpio[port].drive_input(pin, esc.level(self.now));
            }
        }
    }

    /// The chip drives the pins of a port: select lines.
    pub(super) fn drive_devices(&mut self, port: usize) {
        let (select_port, pin) = board::IMU_SELECT;
        if port == select_port {
            let low = !self.gpio[port].level(pin);
            self.board.imu.select(low);
        }
        let (select_port, pin) = board::CARD_SELECT;
        if port == select_port {
            let low = !self.gpio[port].level(pin);
            self.board.select_log(low, self.now);
        }
    }

    /// Gives the pulses of a timer to the speed controllers whose pins it has.
    fn pass_pulses(&mut self, n: usize) {
        for pulse in std::mem::take(&mut self.timers[n].pulses) {
            let here = |&(timer, channel, (port, pin)): &(usize, usize, (usize, u32))| {
                let mine = self.gpio[port].mode(pin) == Mode::Alternate(board::MOTOR_FUNCTION);
                (timer, channel) == (TIMERS[n], pulse.channel) && mine
            };
            if let Some(motor) = board::MOTORS.iter().position(here)
                && let Err(what) = self.board.pulse(motor, pulse)
            {
                self.fail(what);
            }
        }
    }

    /// These bytes come to a serial port, at this many bits a second.
    pub(crate) fn hear(&mut self, port: usize, bytes: &[u8], baud: u32) {
        self.usart[port].feed(bytes, board::bit_cycles(baud), self.now);
        self.refresh(Unit::Usart(port));
    }

    /// The satellite receiver is told these bytes, and answers at the speed that it has then.
    fn tell_receiver(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            match self.board.gnss.hear(byte) {
                Ok(answer) => self.hear(board::GNSS, &answer, self.board.gnss.baud),
                Err(what) => self.fail(what),
            }
        }
    }
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
