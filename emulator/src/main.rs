//! `emulator`: boots an image and prints its log, serves its station's line, or flies it in lock-step with another program.
use anyhow::{Context, Result};
use clap::Parser;
use emulator::{Image, Load, Log, Machine, Motors, Task, pipe};
use std::io::{BufReader, BufWriter, ErrorKind, Read, Write, stdin, stdout};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// How long to run, s.
const SECONDS: f64 = 3.0;
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
    /// How long to run, s of the board's time; 3, or with a station until interrupted.
    #[arg(long)]
    seconds: Option<f64>,
    /// Serve the station's line at this TCP port of this computer, any free one if 0, and run no faster than time passes.
    #[arg(long, value_name = "PORT")]
    station: Option<u16>,
    /// Put a log flash in the place of the card's slot, whose content is this file of 16 MiB.
    #[arg(long, value_name = "FILE")]
    log_flash: Option<PathBuf>,
    /// Serve another program over standard input and output instead (docs/emulator.md).
    #[arg(long, conflicts_with_all = ["seconds", "station", "log_flash"])]
    pipe: bool,
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    let image = Image::open(&cli.image)?;
    let tasks = Task::all(&cli.image, &image)?;
    if cli.pipe {
        return Ok(pipe::serve(&image, &tasks, BufReader::new(stdin().lock()), BufWriter::new(stdout().lock()))?);
    }
    let mut machine = Machine::new(&image)?.watching(&tasks);
    if let Some(file) = &cli.log_flash {
        machine.solder_log_flash(file)?;
    }
    let started = Instant::now();
    let mut station = cli.station.map(Station::bind).transpose()?;
    let seconds = cli.seconds.unwrap_or(if station.is_some() { f64::INFINITY } else { SECONDS });
    let result = watch(&mut machine, &image, seconds, station.as_mut());
    for fault in machine.faults() {
        println!("fault: {fault}");
    }
    result?;
    report(&machine, seconds / started.elapsed().as_secs_f64())
}

/// Runs the image and prints its log.
fn watch(machine: &mut Machine, image: &Image, seconds: f64, mut station: Option<&mut Station>) -> Result<()> {
    let mut log = Log::new(image)?;
    let started = Instant::now();
    let mut looks = 0_u32;
    while f64::from(looks) * LOOK_S < seconds {
        if f64::from(looks) % (RADIO_S / LOOK_S) < 1.0 && machine.next_sample().is_some() {
            machine.send_channels(HANDS_OFF);
        }
        let tremble = TREMBLE_RAD_S * (looks % 5) as f32;
        machine.move_body(AT_REST_M_S2.map(|force| force + tremble), [tremble, -tremble, tremble]);
        let until = machine.now() + (LOOK_S * machine.core_hz() as f64) as u64;
        let result = machine.run_until(until);
        for line in log.lines(machine)? {
            println!("{line}");
        }
        result.with_context(|| format!("after {} cycles", machine.now()))?;
        looks += 1;
        if let Some(station) = &mut station {
            station.exchange(machine);
            sleep(Duration::from_secs_f64(f64::from(looks) * LOOK_S).saturating_sub(started.elapsed()));
        }
    }
    Ok(())
}

/// The other end of the station's line: one program at a time.
struct Station {
    listener: TcpListener,
    caller: Option<TcpStream>,
}

impl Station {
    fn bind(port: u16) -> Result<Self> {
        let bound = TcpListener::bind((Ipv4Addr::LOCALHOST, port));
        let listener = bound.with_context(|| format!("--station = {port}: cannot be served"))?;
        listener.set_nonblocking(true)?;
        println!("the station's line is at tcp:{}", listener.local_addr()?);
        Ok(Self { listener, caller: None })
    }

    /// Passes on what either side has said. A caller who has gone, or does not read, is hung up on.
    fn exchange(&mut self, machine: &mut Machine) {
        if let Ok((caller, _)) = self.listener.accept() {
            self.caller = caller.set_nonblocking(true).is_ok().then_some(caller);
        }
        let told = machine.told_station();
        let Some(caller) = &mut self.caller else { return };
        let mut bytes = [0; 256];
        let alive = match caller.read(&mut bytes) {
            Ok(0) => false,
            Ok(count) => {
                machine.hear_station(&bytes[..count]);
                true
            }
            Err(error) => error.kind() == ErrorKind::WouldBlock,
        };
        if !alive || caller.write_all(&told).is_err() {
            self.caller = None;
        }
    }
}

fn report(machine: &Machine, speed: f64) -> Result<()> {
    let Load { cycles, busy, instructions } = machine.load();
    let Motors { told, protocol, good, bad, latency_max } = machine.motors();
    println!("motors were told {told:?} last by {protocol:?}; understood {good:?}, not {bad:?}");
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
