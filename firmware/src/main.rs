//! The flight image: one control task above everything, radio, slow sensors and log below it.
//!
//! Estimator and autopilot are the core's; what the control task calls between reading and writing is one function that
//! the host flies too (`control_core::flight`). No motor turns unless the autopilot is armed.
//!
//! Only `board/` names pins, timers and interrupts; only tasks and `imu.rs` know time; what needs neither is in the
//! library.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod black_box;
#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod card;
#[cfg(target_os = "none")]
mod fault;
#[cfg(target_os = "none")]
mod gnss;
#[cfg(target_os = "none")]
mod imu;
#[cfg(target_os = "none")]
mod kept;
#[cfg(target_os = "none")]
mod line;
#[cfg(target_os = "none")]
mod log_bus;
#[cfg(target_os = "none")]
mod log_flash;
#[cfg(target_os = "none")]
mod medium;
#[cfg(target_os = "none")]
mod motors;
#[cfg(target_os = "none")]
mod recorder;
#[cfg(target_os = "none")]
mod restart;
#[cfg(target_os = "none")]
mod sensors;
#[cfg(target_os = "none")]
mod station;
#[cfg(target_os = "none")]
mod tasks;
#[cfg(target_os = "none")]
mod usb;
#[cfg(target_os = "none")]
mod vision;

#[cfg(target_os = "none")]
#[embassy_executor::main]
async fn main(spawner: embassy_executor::Spawner) {
    tasks::start(spawner);
}

/// The image does not run here; says what does.
#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!(
        "This is the image for the flight controller. `cargo fw` builds it, `cargo fw-flash` runs it on a board, \
         `cargo run --release` flies the same core in simulation."
    );
    std::process::ExitCode::FAILURE
}
