//! What the image does without touching hardware: pace, synthetic sensors, motor pulses and reports.
//!
//! It is a library apart from the image so that the host tests it. Drivers, interrupts and tasks are in the binary.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod pace;
pub mod pulse;
pub mod report;
pub mod synthetic;
