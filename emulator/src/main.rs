//! `emulator`: boots an image and prints its log.
use anyhow::{Context, Result};
use clap::Parser;
use emulator::{Image, Load, Log, Machine};
use std::path::PathBuf;
use std::time::Instant;

/// How often the log is fetched, s: faster than the image fills its buffer.
const LOOK_S: f64 = 0.01;

/// Boots the flight image on a model of its board and prints its log.
#[derive(Parser)]
struct Cli {
    /// The ELF that would be flashed.
    image: PathBuf,
    /// How long to run, s of the board's time.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    let image = Image::open(&cli.image)?;
    let mut machine = Machine::new(&image)?;
    let mut log = Log::new(&image)?;
    let started = Instant::now();
    let mut time_s = 0.0;
    while time_s < cli.seconds {
        let until = machine.now() + (LOOK_S * machine.core_hz() as f64) as u64;
        let result = machine.run_until(until);
        for line in log.lines(&mut machine)? {
            println!("{line}");
        }
        result.with_context(|| format!("after {} cycles", machine.now()))?;
        time_s += LOOK_S;
    }
    for fault in machine.faults() {
        println!("fault: {fault}");
    }
    let Load { cycles, busy, instructions } = machine.load();
    println!(
        "{:.3} s of {} MHz: load {:.2} % (at least {:.2} %), {:.2} times real time",
        time_s,
        machine.core_hz() / 1_000_000,
        100.0 * busy as f64 / cycles as f64,
        100.0 * instructions as f64 / cycles as f64,
        time_s / started.elapsed().as_secs_f64()
    );
    Ok(())
}
