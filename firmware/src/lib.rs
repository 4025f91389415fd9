//! What the image does without touching hardware: the step of flight, and what bytes from and to devices mean.
//!
//! It is a library apart from the image so that the host tests it. Drivers, interrupts and tasks are in the binary.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod atmosphere;
pub mod battery;
pub mod buzzer;
pub mod crsf;
pub mod dps310;
pub mod dshot;
pub mod erpm;
pub mod flight;
pub mod flight_log;
pub mod icm42688;
pub mod log_file;
pub mod mpu6000;
pub mod pilot;
pub mod pose;
pub mod pulse;
pub mod qmc5883l;
pub mod record;
pub mod report;
pub mod stored;
pub mod telemetry;
pub mod ubx;
