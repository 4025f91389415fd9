//! Counts the instructions of one control tick on a Cortex-M4F, and checks that it computes what the host does.
//!
//! `cargo xtask count` runs this image on QEMU's `mps2-an386` with a tick record of a simulated flight in PSRAM. The
//! image replays every tick, compares the thrusts with the host's bit for bit, then counts the elementary functions.
//! It measures; `xtask` judges. What it prints is one line per fact, `kind key=value key=value`:
//!
//! ```text
//! tick ticks=35000 path=500 worst=700 mean=690.5 worst_at=12 stack=400 rejected=0 differing=0 first_differing=none
//! estimator arrival=gnss path=900 step=9000 stack=900
//! helm flown=1000 act=1500 controller=1400
//! bytes estimator=300 estimator_state=6000 controller=4000 controller_state=800
//! math function=tanh core=40 libm=104 micromath=136
//! ```
//!
//! How an instruction is counted is in `count.rs`, the format of the record in `record.rs`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod count;
#[cfg(target_os = "none")]
mod estimator;
#[cfg(target_os = "none")]
mod helm;
#[cfg(target_os = "none")]
mod image;
#[cfg(target_os = "none")]
mod math;
#[cfg(target_os = "none")]
mod record;
#[cfg(target_os = "none")]
mod stack;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("tick-bench runs on the emulated board: cargo xtask count");
}
