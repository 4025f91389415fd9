//! Records between the machine and its surroundings, framed for a serial line.
//!
//! ```text
//! record ─ postcard ─► bytes ─ CRC-16 appended ─► COBS ─► no byte of it is 0 ─► 0 ends the frame
//! ```
//!
//! Whoever joins in the middle, or hears noise, understands again after the next 0. Nothing is allocated.
//!
//! Invariants: a frame is at most [`FRAME_BYTES_MAX`] long; no frame with a wrong bit is taken for a record, but one in
//! 65,536 of those with many.
//!
//! # Source
//! Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7 (1999); CRC-16/IBM-SDLC
//! as ITU-T V.42 has it; <https://postcard.jamesmunns.com/wire-format> for the bytes of a record.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod frame;
mod log;
mod record;
mod telemetry;

pub use frame::{Decoder, EncodeError, FRAME_BYTES_MAX, checksum, encode};
pub use log::{LogPart, LogRefusal, LogSize, LogWish, PART_BYTES};
pub use record::{FromBoard, MotorTest, Order, Outcome, ParameterName, ToBoard, VERSION, Verdict, VisionPose};
pub use telemetry::{Motion, Rotors, Status, Wiring};
