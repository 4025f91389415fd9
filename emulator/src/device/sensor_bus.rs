//! The bus of the slow sensors: who is addressed, and at which of its registers a transfer is.
//!
//! The first byte after an address to write is a register's; what follows goes to it and those after it. Both sensors do so.
use super::Registers;
use super::dps310::{self, Dps310};
use super::qmc5883l::{self, Qmc5883l};
use crate::peripheral::i2c::Slaves;

/// How a part does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// It does not answer.
    Silent,
    /// It works.
    Well,
    /// It holds the clock line, and so the bus.
    HoldsClock,
}

/// The bus.
#[derive(Debug)]
pub(crate) struct SensorBus {
    pub(crate) barometer: Dps310,
    pub(crate) magnetometer: Qmc5883l,
    /// How the barometer and the magnetometer do.
    pub(crate) health: [Health; 2],
    /// Who is addressed, and each one's register.
    addressed: Option<usize>,
    registers: [u8; 2],
    /// Whether the next byte is a register's.
    opened: bool,
    now: u64,
    /// What was used that is not modelled.
    pub(crate) unknown: Option<String>,
}

impl SensorBus {
    pub(crate) fn new(cycles_us: u64) -> Self {
        Self {
            barometer: Dps310::new(cycles_us),
            magnetometer: Qmc5883l::new(cycles_us),
            health: [Health::Well; 2],
            addressed: None,
            registers: [0; 2],
            opened: false,
            now: 0,
            unknown: None,
        }
    }

    /// The bus at a time, core cycles.
    pub(crate) fn at(&mut self, now: u64) -> &mut Self {
        self.now = now;
        self
    }

    fn device(&mut self, which: usize) -> &mut dyn Registers {
        if which == 0 { &mut self.barometer } else { &mut self.magnetometer }
    }

    fn unmodelled<T: Default>(&mut self, which: usize, register: u8, result: Option<T>) -> T {
        let name = ["barometer", "magnetometer"][which];
        if result.is_none() {
            self.unknown = Some(format!("the {name}'s register {register:#04x} is not modelled as it is used"));
        }
        result.unwrap_or_default()
    }
}

impl Slaves for SensorBus {
    fn address(&mut self, byte: u8) -> Option<bool> {
        if self.health.contains(&Health::HoldsClock) {
            return None;
        }
        let place = [dps310::ADDRESS, qmc5883l::ADDRESS].iter().position(|&address| address == byte >> 1);
        self.addressed = place.filter(|&which| self.health[which] == Health::Well);
        self.opened = byte & 1 == 0;
        Some(self.addressed.is_some())
    }

    fn write(&mut self, byte: u8) -> bool {
        let Some(which) = self.addressed.filter(|&which| self.health[which] == Health::Well) else { return false };
        if std::mem::take(&mut self.opened) {
            self.registers[which] = byte;
        } else {
            let (register, now) = (self.registers[which], self.now);
            let done = self.device(which).write(register, byte, now);
            self.unmodelled(which, register, done);
            self.registers[which] = register.wrapping_add(1);
        }
        true
    }

    fn read(&mut self) -> u8 {
        // Nobody pulls the line down.
        let Some(which) = self.addressed.filter(|&which| self.health[which] == Health::Well) else { return u8::MAX };
        let (register, now) = (self.registers[which], self.now);
        let value = self.device(which).read(register, now);
        self.registers[which] = register.wrapping_add(1);
        self.unmodelled(which, register, value)
    }
}
