//! GPIO: a port of sixteen pins.
//!
//! # Source
//! RM0090, chapter 8.4 "GPIO registers".

/// A port.
#[derive(Debug)]
pub(crate) struct Gpio {
    moder: u32,
    otyper: u32,
    ospeedr: u32,
    pupdr: u32,
    odr: u32,
    afr: [u32; 2],
    /// Levels that the world drives, and the pins on which it does.
    driven: (u32, u32),
}

/// What a pin is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    Input,
    Output,
    /// Belongs to a peripheral, by the number of the alternate function.
    Alternate(u32),
    Analog,
}

impl Gpio {
    /// Port `n`, A being 0, after reset.
    pub(crate) fn new(n: usize) -> Self {
        let (moder, ospeedr, pupdr) = match n {
            0 => (0xa800_0000, 0x0c00_0000, 0x6400_0000),
            1 => (0x0000_0280, 0x0000_00c0, 0x0000_0100),
            _ => (0, 0, 0),
        };
        Self { moder, otyper: 0, ospeedr, pupdr, odr: 0, afr: [0; 2], driven: (0, 0) }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.moder,
            0x04 => self.otyper,
            0x08 => self.ospeedr,
            0x0c => self.pupdr,
            0x10 => (0..16).map(|pin| u32::from(self.level(pin)) << pin).sum(),
            0x14 => self.odr,
            0x18 => 0,
            0x20 => self.afr[0],
            0x24 => self.afr[1],
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 => self.moder = value,
            0x04 => self.otyper = value & 0xffff,
            0x08 => self.ospeedr = value,
            0x0c => self.pupdr = value,
            0x14 => self.odr = value & 0xffff,
            // Set wins over reset.
            0x18 => self.odr = (self.odr & !(value >> 16)) | value & 0xffff,
            0x20 => self.afr[0] = value,
            0x24 => self.afr[1] = value,
            _ => return None,
        }
        Some(())
    }

    /// Drives a pin from outside; returns whether its level changed.
    pub(crate) fn drive(&mut self, pin: u32, high: bool) -> bool {
        let before = self.level(pin);
        self.driven.1 |= 1 << pin;
        self.driven.0 = (self.driven.0 & !(1 << pin)) | u32::from(high) << pin;
        before != self.level(pin)
    }

    /// Drives a pin that is an input from outside, or lets it go.
    pub(crate) fn drive_input(&mut self, pin: u32, level: Option<bool>) {
        let (levels, pins) = &mut self.driven;
        *pins = *pins & !(1 << pin) | u32::from(level.is_some()) << pin;
        *levels = *levels & !(1 << pin) | u32::from(level == Some(true)) << pin;
    }

    /// What the pin is set up as.
    pub(crate) fn mode(&self, pin: u32) -> Mode {
        match self.moder >> (2 * pin) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => Mode::Alternate(self.afr[pin as usize / 8] >> (4 * (pin % 8)) & 0xf),
            _ => Mode::Analog,
        }
    }

    /// The pin's level: what it drives itself, else what is driven, else its pull, else low.
    pub(crate) fn level(&self, pin: u32) -> bool {
        let bit = |word: u32| word >> pin & 1 != 0;
        if self.mode(pin) == Mode::Output && !(bit(self.otyper) && bit(self.odr)) {
            bit(self.odr)
        } else if bit(self.driven.1) {
            bit(self.driven.0)
        } else {
            self.pupdr >> (2 * pin) & 3 == 1
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pin_is_what_drives_it_or_its_pull() {
        let mut port = Gpio::new(2);
        assert!(!port.level(4));
        port.write(0x0c, 1 << 8);
        assert!(port.level(4), "pulled up");
        assert!(port.drive(4, false));
        assert!(!port.level(4), "driven low");
        port.write(0x00, 1 << 8);
        port.write(0x18, 1 << 4);
        assert!(port.level(4), "an output drives itself");
        port.write(0x00, 2 << 8);
        port.write(0x20, 5 << 16);
        assert_eq!(port.mode(4), Mode::Alternate(5));
    }
}
