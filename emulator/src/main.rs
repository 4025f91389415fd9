//! `emulator`: boots an image and prints its log, or flies it in lock-step with another program.
use anyhow::{Context, Result};
use clap::Parser;
use emulator::{Image, Load, Log, Machine, Motors, Task, pipe};
use std::io::{BufReader, BufWriter, stdin, stdout};
use std::path::PathBuf;
use std::time::Instant;

/// How often the log is fetched, s: faster than the image fills its buffer.
const LOOK_S: f64 = 0.01;
/// Radio frames a second.
const RADIO_S: f64 = 0.02;
/// Sticks in their middle, throttle and switches down.
const HANDS_OFF: [u16; 16] = {
    let mut channels = [172; 16];
    (channels[0], channels[1], channels[3]) = (992, 992, 992);
    channels
};
/// At rest, level, m/s².
const AT_REST_M_S2: [f32; 3] = [0.0, 0.0, -9.806_65];
/// How much it trembles, rad/s: a part that always says the same is taken for one that is stuck.
const TREMBLE_RAD_S: f32 = 0.002;

/// Boots the flight image on a model of its board and prints its log.
#[derive(Parser)]
struct Cli {
    /// The ELF that would be flashed.
    image: PathBuf,
    /// How long to run, s of the board's time.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    /// Serve another program over standard input and output instead (docs/emulator.md).
    #[arg(long, conflicts_with = "seconds")]
    pipe: bool,
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    let image = Image::open(&cli.image)?;
    if cli.pipe {
        return Ok(pipe::serve(&image, BufReader::new(stdin().lock()), BufWriter::new(stdout().lock()))?);
    }
    let mut machine = Machine::new(&image)?;
    machine.watch_tasks(Task::all(&cli.image, &image)?);
    let started = Instant::now();
    let result = watch(&mut machine, &image, cli.seconds);
    for fault in machine.faults() {
        println!("fault: {fault}");
    }
    result?;
    report(&machine, cli.seconds / started.elapsed().as_secs_f64())
}

/// Runs the image and prints its log.
fn watch(machine: &mut Machine, image: &Image, seconds: f64) -> Result<()> {
    let mut log = Log::new(image)?;
    let mut looks = 0_u16;
    while f64::from(looks) * LOOK_S < seconds {
        if f64::from(looks) % (RADIO_S / LOOK_S) < 1.0 && machine.next_sample().is_some() {
            machine.send_channels(HANDS_OFF);
        }
        let tremble = TREMBLE_RAD_S * f32::from(looks % 5);
        machine.move_body(AT_REST_M_S2.map(|force| force + tremble), [tremble, -tremble, tremble]);
        let until = machine.now() + (LOOK_S * machine.core_hz() as f64) as u64;
        let result = machine.run_until(until);
        for line in log.lines(machine)? {
            println!("{line}");
        }
        result.with_context(|| format!("after {} cycles", machine.now()))?;
        looks += 1;
    }
    Ok(())
}

fn report(machine: &Machine, speed: f64) -> Result<()> {
    let Load { cycles, busy, instructions } = machine.load();
    let Motors { told, good, bad, latency_max } = machine.motors();
    println!("motors were told {told:?} last; understood {good:?}, not {bad:?}");
    println!("inertial sample ready to motor frame through: at most {latency_max} cycles");
    println!(
        "{cycles} cycles at {} MHz, load {:.2} % (at least {:.2} %), {speed:.2} times real time",
        machine.core_hz() / 1_000_000,
        100.0 * busy as f64 / cycles as f64,
        100.0 * instructions as f64 / cycles as f64,
    );
    let (bytes, used) = machine.stack()?;
    for Task { name, cycles_max, .. } in machine.tasks() {
        println!("task {name}: at most {cycles_max} cycles without a pause");
    }
    println!("stack: {used} of {bytes} bytes were used");
    Ok(())
}
