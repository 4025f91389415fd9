//! What the image does without touching hardware: the step of flight, and what bytes from and to devices mean.
//!
//! It is a library apart from the image so that the host tests it. Drivers, interrupts and tasks are in the binary.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod battery;
pub mod crsf;
pub mod dshot;
pub mod flight;
pub mod icm42688;
pub mod pace;
pub mod pilot;
pub mod pulse;
pub mod record;
pub mod report;
