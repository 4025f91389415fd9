//! The flight image for the STM32F405: one control task above everything, one log task below it.
//!
//! **No motor can turn.** There are no sensors yet and no arming: the core flies on synthetic sensors, the pulses its
//! thrusts would give are computed and logged, and the motor outputs send the stop pulse from power-up on. The board
//! has no function that sends another ([`board::Motors`]).
//!
//! Only `board/` names pins, timers and interrupts; only `tasks.rs` knows time; what needs neither is in the library.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod fault;
#[cfg(target_os = "none")]
mod tasks;

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
