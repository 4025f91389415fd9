//! Units: the peripherals by name, address and clock.
//!
//! # Source
//! RM0090, table 1 "STM32F4xx register boundary addresses", and the enable registers of chapter 7.3.
use std::fmt;

/// A peripheral, with its index where there are several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unit {
    /// NVIC, SCB and SysTick.
    Core,
    Dwt,
    Rcc,
    Pwr,
    Flash,
    Exti,
    Syscfg,
    Dbgmcu,
    Rtc,
    Iwdg,
    Adc,
    Otg,
    /// What is soldered to the chip.
    Board,
    Dma(usize),
    Spi(usize),
    Usart(usize),
    I2c(usize),
    Timer(usize),
    Gpio(usize),
}

/// How many there are.
pub(crate) const UNITS: usize = 42;

const SINGLE: [Unit; 13] = [
    Unit::Core,
    Unit::Dwt,
    Unit::Rcc,
    Unit::Pwr,
    Unit::Flash,
    Unit::Exti,
    Unit::Syscfg,
    Unit::Dbgmcu,
    Unit::Rtc,
    Unit::Iwdg,
    Unit::Adc,
    Unit::Otg,
    Unit::Board,
];

impl Unit {
    /// Its place among all units.
    pub(crate) fn index(self) -> usize {
        match self {
            Self::Dma(n) => 13 + n,
            Self::Spi(n) => 15 + n,
            Self::Usart(n) => 18 + n,
            Self::Timer(n) => 24 + n,
            Self::Gpio(n) => 30 + n,
            Self::I2c(n) => 39 + n,
            single => SINGLE.iter().position(|&unit| unit == single).unwrap_or(0),
        }
    }

    /// Every unit, in the order of [`Self::index`].
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        let several = |count: usize, unit: fn(usize) -> Self| (0..count).map(unit);
        SINGLE
            .into_iter()
            .chain(several(2, Self::Dma))
            .chain(several(3, Self::Spi))
            .chain(several(6, Self::Usart))
            .chain(several(6, Self::Timer))
            .chain(several(9, Self::Gpio))
            .chain(several(3, Self::I2c))
    }

    /// Offset of the enable register in RCC and the bit in it, where the unit has one. That of its reset is 0x20 less.
    pub(crate) fn clock_enable(self) -> Option<(u32, u32)> {
        const AHB1: u32 = 0x30;
        const AHB2: u32 = 0x34;
        const APB1: u32 = 0x40;
        const APB2: u32 = 0x44;
        Some(match self {
            Self::Gpio(n) => (AHB1, n as u32),
            Self::Dma(n) => (AHB1, 21 + n as u32),
            Self::Otg => (AHB2, 7),
            Self::Timer(n) => [(APB2, 0), (APB1, 0), (APB1, 1), (APB1, 2), (APB1, 3), (APB2, 1)][n],
            Self::Spi(n) => [(APB2, 12), (APB1, 14), (APB1, 15)][n],
            Self::Usart(n) => [(APB2, 4), (APB1, 17), (APB1, 18), (APB1, 19), (APB1, 20), (APB2, 5)][n],
            Self::I2c(n) => (APB1, 21 + n as u32),
            Self::Pwr => (APB1, 28),
            Self::Adc => (APB2, 8),
            Self::Syscfg => (APB2, 14),
            _ => return None,
        })
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Dma(n) => write!(f, "DMA{}", n + 1),
            Self::Spi(n) => write!(f, "SPI{}", n + 1),
            Self::Usart(n) => write!(f, "USART{}", n + 1),
            Self::I2c(n) => write!(f, "I2C{}", n + 1),
            Self::Timer(n) => write!(f, "TIM{}", crate::chip::TIMERS[n]),
            Self::Gpio(n) => write!(f, "GPIO{}", char::from(b'A' + n as u8)),
            single => write!(f, "{}", format!("{single:?}").to_uppercase()),
        }
    }
}

/// The unit at an address, and the offset in it.
pub(crate) fn locate(address: u32) -> Option<(Unit, u32)> {
    let (base, unit) = match address {
        0xe000_e000..=0xe000_efff => (0xe000_e000, Unit::Core),
        0xe000_1000..=0xe000_1fff => (0xe000_1000, Unit::Dwt),
        0xe004_2000..=0xe004_200f => (0xe004_2000, Unit::Dbgmcu),
        0x4000_0000..=0x4000_0fff => (address & !0x3ff, Unit::Timer(1 + (address >> 10 & 3) as usize)),
        0x4000_2800..=0x4000_2bff => (0x4000_2800, Unit::Rtc),
        0x4000_3000..=0x4000_33ff => (0x4000_3000, Unit::Iwdg),
        0x4000_3800..=0x4000_3fff => (address & !0x3ff, Unit::Spi(1 + (address >> 10 & 1) as usize)),
        0x4000_4400..=0x4000_53ff => (address & !0x3ff, Unit::Usart((address >> 10 & 7) as usize)),
        0x4000_5400..=0x4000_5fff => (address & !0x3ff, Unit::I2c((address >> 10 & 3) as usize - 1)),
        0x4000_7000..=0x4000_73ff => (0x4000_7000, Unit::Pwr),
        0x4001_0000..=0x4001_03ff => (0x4001_0000, Unit::Timer(0)),
        0x4001_0400..=0x4001_07ff => (0x4001_0400, Unit::Timer(5)),
        0x4001_1000..=0x4001_13ff => (0x4001_1000, Unit::Usart(0)),
        0x4001_1400..=0x4001_17ff => (0x4001_1400, Unit::Usart(5)),
        0x4001_2000..=0x4001_23ff => (0x4001_2000, Unit::Adc),
        0x4001_3000..=0x4001_33ff => (0x4001_3000, Unit::Spi(0)),
        0x4001_3800..=0x4001_3bff => (0x4001_3800, Unit::Syscfg),
        0x4001_3c00..=0x4001_3fff => (0x4001_3c00, Unit::Exti),
        0x4002_0000..=0x4002_23ff => (address & !0x3ff, Unit::Gpio((address >> 10 & 0xf) as usize)),
        0x4002_3800..=0x4002_3bff => (0x4002_3800, Unit::Rcc),
        0x4002_3c00..=0x4002_3fff => (0x4002_3c00, Unit::Flash),
        0x4002_6000..=0x4002_67ff => (address & !0x3ff, Unit::Dma((address >> 10 & 1) as usize)),
        0x5000_0000..=0x5003_ffff => (0x5000_0000, Unit::Otg),
        _ => return None,
    };
    Some((unit, address - base))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_unit_has_a_place_of_its_own() {
        let places: Vec<usize> = Unit::all().map(Unit::index).collect();
        assert_eq!(places, (0..UNITS).collect::<Vec<_>>());
    }

    #[test]
    fn addresses_are_the_manuals() {
        for (address, name, offset) in [
            (0x4000_0c24, "TIM5", 0x24),
            (0x4000_4404, "USART2", 4),
            (0x4000_5000, "USART5", 0),
            (0x4000_5410, "I2C1", 0x10),
            (0x4000_5c00, "I2C3", 0),
            (0x4001_1404, "USART6", 4),
            (0x4000_3c0c, "SPI3", 0xc),
            (0x4002_0414, "GPIOB", 0x14),
            (0x4002_6410, "DMA2", 0x10),
            (0xe000_ed08, "CORE", 0xd08),
        ] {
            let (unit, at) = locate(address).expect(name);
            assert_eq!((unit.to_string().as_str(), at), (name, offset));
        }
        assert_eq!(locate(0x4000_6400), None, "CAN1");
    }
}
