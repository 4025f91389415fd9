//! Flies the board's own image without the board.
//!
//! [`Machine`] is an STM32F405: a Cortex-M4F executed by Unicorn, and around it models of the chip's peripherals. It boots
//! the ELF that is flashed, unchanged. Time is virtual and counted in core cycles; two runs are equal to the bit.
//!
//! | file             | what                                                        |
//! |------------------|-------------------------------------------------------------|
//! | `machine`        | runs code, takes exceptions, sleeps                         |
//! | `exception`      | entry to and return from handlers, with the FPU's state     |
//! | `block`          | cycles of a block of code, by class of instruction          |
//! | `flash_cache`    | wait states of flash                                        |
//! | `nvic`           | which exception runs next                                   |
//! | `chip`, `unit`   | peripherals on their buses, lines, DMA, time                |
//! | `peripheral/`    | one file a peripheral                                       |
//! | `board`, `device/` | what is soldered to the chip, one file a device           |
//! | `image`, `log`   | the ELF; its decoded log                                    |
//! | `pipe`           | lock-step with another program                              |
//!
//! It fails loudly: a register, or a bit of one, that is not modelled ends the run with its name and the program counter.
//!
//! Unicorn is GPL-2.0, and so is this crate. Nothing in the workspace links it: others spawn its executable.
#![forbid(unsafe_code)]
// In a map of registers every register has a line of its own, and bits are named as the manual names them.
#![allow(clippy::match_same_arms, clippy::precedence, clippy::verbose_bit_mask, clippy::unreadable_literal)]

mod block;
mod board;
mod chip;
mod device;
mod exception;
mod flash_cache;
mod image;
mod log;
mod machine;
mod nvic;
mod peripheral;
pub mod pipe;
mod tasks;
mod unit;

pub use device::esc::{Protocol, Telemetry};
pub use device::inertial_unit::Inertial;
pub use device::sd_card::Busy;
pub use device::sensor_bus::Health;
pub use device::ublox::Fix;
pub use image::Image;
pub use log::Log;
pub use machine::{Line, Load, Machine, Motors, Part};
pub use tasks::Task;

/// Why a run ended: what the image did that the board, or this model of it, does not do.
#[derive(Debug)]
pub struct Failure(pub String);

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Failure {}
