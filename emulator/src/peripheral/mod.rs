//! The chip's peripherals, one file each.
//!
//! A peripheral answers `None` for a register, or for a bit of one, that it does not model: the emulator then stops and
//! names it. Nothing is guessed.
//!
//! # Source
//! RM0090 rev 19, the reference manual of the STM32F405; each file names its chapter.
pub(crate) mod adc;
pub(crate) mod dbgmcu;
pub(crate) mod dma;
pub(crate) mod dwt;
pub(crate) mod exti;
pub(crate) mod flash;
pub(crate) mod gpio;
pub(crate) mod i2c;
pub(crate) mod iwdg;
pub(crate) mod otg;
pub(crate) mod pwr;
pub(crate) mod rcc;
pub(crate) mod rtc;
pub(crate) mod scb;
pub(crate) mod spi;
pub(crate) mod syscfg;
pub(crate) mod systick;
pub(crate) mod timer;
pub(crate) mod usart;

/// When an access or an event happens.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tick {
    /// Core cycles since reset.
    pub(crate) now: u64,
    /// Core cycles in one cycle of the peripheral's own clock.
    pub(crate) clock: u64,
}

/// No event is due.
pub(crate) const NEVER: u64 = u64::MAX;

/// Refuses a value with bits outside `known`.
pub(crate) fn only(value: u32, known: u32) -> Option<u32> {
    (value & !known == 0).then_some(value)
}
