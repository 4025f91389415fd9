//! `sim-host station`: a board's parameters, how it is, and its rotors on the bench.
use super::params::table;
use super::station_log::{LogCommand, log};
use super::{Failure, say};
use crate::station::{LOST, Station, StationError};
use clap::{Args, Subcommand};
use comfy_table::presets;
use control_core::WiringFault;
use control_core::arming::Check;
use control_core::failsafe::Failsafe;
use control_core::modes::Mode;
use control_core::motor_test::{SECONDS_MAX, SHARE_MAX};
use control_core::parameters::{Declaration, ParameterError, Parameters, TABLE, index_of};
use control_core::set::{Member, Set};
use flight_link::{FromBoard, Motion, MotorTest, Order, Rotors, Status, Wiring};
use std::time::{Duration, Instant};

#[derive(Args)]
pub(super) struct StationArgs {
    /// The line: a serial port such as /dev/ttyACM0 or COM3, or tcp:HOST:PORT for the emulator.
    #[arg(long)]
    port: String,
    /// Bits a second of a serial port; USB has no use for it.
    #[arg(long, default_value_t = 115_200)]
    baud: u32,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Print every parameter, with the value that flies from the next start on.
    List,
    /// Print a parameter.
    Get {
        /// Its name.
        name: String,
    },
    /// Set a parameter for good; it flies from the next start on.
    Set {
        /// Its name.
        name: String,
        /// Its value.
        #[arg(allow_negative_numbers = true)]
        value: f32,
    },
    /// Print how it is, every second and when that changes.
    Watch {
        /// For how long, s; until interrupted if left out.
        #[arg(long)]
        seconds: Option<f64>,
    },
    /// Turn rotors for people to look at. TAKE THE PROPELLERS OFF. Ends when this program ends.
    MotorTest {
        /// 1 right, 2 front, 3 left, 4 back; all in turn if left out.
        #[arg(value_parser = clap::value_parser!(u8).range(1..=4))]
        rotor: Option<u8>,
        /// Share of full thrust, %.
        #[arg(long, default_value_t = 5.0)]
        throttle: f32,
        /// How long each turns, s.
        #[arg(long, default_value_t = 2.0)]
        seconds: f32,
    },
    /// Find out which rotor answers to which command: it must stand on its feet, propellers on, nobody near.
    WiringCheck,
    /// List, fetch or erase the flight logs in the board's flash chip.
    #[command(subcommand)]
    Log(LogCommand),
    /// Start the board anew, so that what was set flies.
    Restart,
}

/// What is wrong with a check of a board that did what it was told.
const NOT_RIGHT: u8 = 1;

impl From<StationError> for Failure {
    fn from(error: StationError) -> Self {
        Self { text: error.to_string(), code: 1 }
    }
}

pub(super) fn station(args: &StationArgs) -> Result<(), Failure> {
    let mut station = Station::open(&args.port, args.baud)?;
    match &args.command {
        Command::List => list(&mut station),
        Command::Get { name } => {
            let value = station.get(name)?;
            say(&format!("{}\n", shown(name, value)))
        }
        Command::Set { name, value } => set(&mut station, name, *value),
        Command::Watch { seconds } => watch(&mut station, *seconds),
        Command::MotorTest { rotor, throttle, seconds } => test_motors(&mut station, *rotor, *throttle, *seconds),
        Command::WiringCheck => check_wiring(&mut station),
        Command::Log(command) => log(&mut station, command),
        Command::Restart => {
            station.order(Order::Restart)?;
            station.wait_for_restart()?;
            say("it has started anew\n")
        }
    }
}

fn list(station: &mut Station) -> Result<(), Failure> {
    let mut parameters = Parameters::default();
    for Declaration { name, .. } in &TABLE {
        let value = station.get(name)?;
        parameters.set(name, value).map_err(|error| Failure { text: format!("the board: {error}"), code: 1 })?;
    }
    say(&format!("{}\n", table(&parameters, presets::UTF8_FULL_CONDENSED)))
}

fn set(station: &mut Station, name: &str, value: f32) -> Result<(), Failure> {
    let restarted = station.set(name, value).map_err(|error| match (error, index_of(name)) {
        // It keeps no texts; the range is declared once, for both.
        (StationError::OutOfRange(_), Some(index)) => {
            let declaration = &TABLE[index];
            Failure::bad_input(format!("refused: {}", ParameterError::OutOfRange { declaration, value }))
        }
        (error, _) => error.into(),
    })?;
    let when = if restarted { "; the board has started anew for it" } else { ", from the next start on" };
    say(&format!("{}{when}\n", shown(name, value)))
}

/// A parameter with its unit.
fn shown(name: &str, value: f32) -> String {
    let unit = index_of(name).map_or("", |index| TABLE[index].unit);
    format!("{name} = {value}{}{unit}", if unit.is_empty() { "" } else { " " })
}

fn test_motors(station: &mut Station, rotor: Option<u8>, percent: f32, seconds: f32) -> Result<(), Failure> {
    let within = |name: &str, value: f32, most: f32, unit: &str| {
        let fits = value > 0.0 && value <= most;
        if fits {
            Ok(())
        } else {
            Err(Failure::bad_input(format!("{name} = {value}: must be above 0 and at most {most} {unit}")))
        }
    };
    within("--throttle", percent, 100.0 * SHARE_MAX, "%")?;
    within("--seconds", seconds, SECONDS_MAX, "s")?;
    let test = MotorTest { rotor: rotor.map(|rotor| rotor - 1), share: percent / 100.0, seconds };
    station.order(Order::MotorTest(test))?;
    let mut turning = None;
    let mut printed = Ok(());
    station.accompany(|record| {
        let FromBoard::Rotors(Rotors { speeds, .. }) = record else { return };
        let now = speeds.iter().position(|&speed| speed > 0.0);
        if now != turning
            && let Some(rotor) = now
        {
            printed =
                say(&format!("rotor {} turns at {:.0} % of its fastest speed\n", rotor + 1, 100.0 * speeds[rotor]));
        }
        turning = now;
    })?;
    printed?;
    say("over\n")
}

fn check_wiring(station: &mut Station) -> Result<(), Failure> {
    station.order(Order::WiringCheck)?;
    let mut found = Wiring::Unknown;
    station.accompany(|record| {
        if let FromBoard::Status(status) = record {
            found = status.wiring;
        }
    })?;
    match verdict(found) {
        Some(Ok(())) => say("every rotor answers to its own command\n"),
        Some(Err(fault)) => Err(Failure { text: fault.to_string(), code: NOT_RIGHT }),
        None => Err(Failure { text: "the check has ended without a verdict".to_owned(), code: NOT_RIGHT }),
    }
}

/// What a wiring check has found, as the core says it.
fn verdict(wiring: Wiring) -> Option<Result<(), WiringFault>> {
    let fault = match wiring {
        Wiring::Unknown => return None,
        Wiring::Right => return Some(Ok(())),
        Wiring::AnswersAs { told, answers } => WiringFault::AnswersAs { told: told.into(), answers: answers.into() },
        Wiring::Reversed(rotor) => WiringFault::Reversed { rotor: rotor.into() },
        Wiring::Silent(rotor) => WiringFault::Silent { rotor: rotor.into() },
        Wiring::Tipping(rotor) => WiringFault::Tipping { rotor: rotor.into() },
        Wiring::BadSample(rotor) => WiringFault::BadSample { rotor: rotor.into() },
    };
    Some(Err(fault))
}

/// What is shown at once when it changes.
#[derive(Clone, Debug, PartialEq, Default)]
struct Words(Vec<String>);

/// The newest of each record.
#[derive(Default)]
struct Seen {
    status: Option<Status>,
    motion: Option<Motion>,
    rotors: Option<Rotors>,
}

fn watch(station: &mut Station, seconds: Option<f64>) -> Result<(), Failure> {
    let end = seconds.map(|seconds| Instant::now() + Duration::from_secs_f64(seconds.clamp(0.0, 1e9)));
    let (mut seen, mut words, mut second) = (Seen::default(), Words::default(), None);
    let mut heard = Instant::now();
    while end.is_none_or(|end| Instant::now() < end) {
        let Some(record) = station.listen()? else {
            if heard.elapsed() > LOST {
                return Err(StationError::Lost.into());
            }
            continue;
        };
        heard = Instant::now();
        match record {
            FromBoard::Status(status) => seen.status = Some(status),
            FromBoard::Motion(motion) => seen.motion = Some(motion),
            FromBoard::Rotors(rotors) => seen.rotors = Some(rotors),
            _ => continue,
        }
        let Seen { status: Some(status), motion: Some(motion), rotors: Some(rotors) } = &seen else { continue };
        let now = Words::of(status, rotors);
        for word in now.0.iter().filter(|word| !words.0.contains(word)) {
            say(&format!("{:9.1} s  {word}\n", status.time_us as f64 * 1e-6))?;
        }
        words = now;
        if second != Some(status.time_us / 1_000_000) {
            second = Some(status.time_us / 1_000_000);
            say(&line(status, motion, rotors))?;
        }
    }
    Ok(())
}

impl Words {
    fn of(status: &Status, rotors: &Rotors) -> Self {
        let mode =
            |place: u8| Mode::ALL.get(usize::from(place)).map_or_else(|| format!("mode {place}"), Mode::to_string);
        let mut words = vec![match (status.armed, status.aim == status.mode) {
            (false, _) => "disarmed".to_owned(),
            (true, true) => format!("armed, {}", mode(status.mode)),
            (true, false) => format!("armed, {} in place of {}", mode(status.mode), mode(status.aim)),
        }];
        words.extend(members::<Failsafe>(status.failsafes).iter().map(|failsafe| format!("failsafe: {failsafe}")));
        words.extend(members::<Check>(status.failing).iter().map(|check| format!("arming would be refused: {check}")));
        words.extend(status.bench.then(|| "a test on the bench runs".to_owned()));
        let weak = (1..).zip(rotors.believed).filter(|(_, share)| *share < 0.995);
        words.extend(
            weak.map(|(rotor, share)| {
                format!("rotor {rotor} is believed to make {:.0} % of its thrust", 100.0 * share)
            }),
        );
        Self(words)
    }
}

/// The members that these bits are.
fn members<T: Member>(bits: u32) -> Set<T> {
    T::ALL.iter().copied().filter(|member| bits & 1 << member.index() != 0).collect()
}

/// One line of figures.
fn line(status: &Status, motion: &Motion, rotors: &Rotors) -> String {
    let [roll, pitch, heading] = motion.attitude_rad.map(f32::to_degrees);
    // What is not to be flown on is not shown.
    let known = |bit: u8, value: f32| if motion.health >> bit & 1 == 1 { value } else { f32::NAN };
    let ([north, east, down], [v_north, v_east, v_down]) = (motion.position_m, motion.velocity_m_s);
    let (north, east, up) = (known(5, north), known(5, east), known(3, -down));
    let (v_north, v_east, v_up) = (known(4, v_north), known(4, v_east), known(3, -v_down));
    let [m1, m2, m3, m4] = rotors.speeds.map(|speed| 100.0 * speed);
    let Status { time_us, battery_v, battery_a, used_as, load, step_us_max, late, dropped, .. } = status;
    format!(
        "{:9.1} s  roll {roll:6.1} pitch {pitch:6.1} heading {heading:6.1} deg  north {north:6.2} east {east:6.2} up {up:6.2} m  \
         {v_north:5.2} {v_east:5.2} {v_up:5.2} m/s  rotors {m1:3.0} {m2:3.0} {m3:3.0} {m4:3.0} %  {battery_v:5.2} V {battery_a:5.1} A {:5.0} mAh  load {:2.0} %, \
         longest step {step_us_max} us, late {late}, dropped {dropped}\n",
        *time_us as f64 * 1e-6,
        used_as / 3.6,
        100.0 * load,
    )
}
