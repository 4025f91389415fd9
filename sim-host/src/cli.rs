//! The command line.
use crate::controllers::ControllerName;
use crate::flight::{Flight, NumberFormat};
use crate::limits::{CASES, loss_max};
use crate::log::{Log, TickRecord};
use crate::metrics::{Flown, METRICS, fly_measured};
use crate::output::Files;
use crate::plots::{Trace, comparison_svg, png};
use crate::report::{Comparison, Entry};
use crate::scenario::{Scenario, THRUST_TO_WEIGHT};
use crate::vehicle::{AirframeName, Vehicle, VehicleKeys};
use clap::{Args, Parser, Subcommand};
use rayon::prelude::*;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Flies quadrotors that lose thrust, and compares the controllers that keep them up.
#[derive(Parser)]
#[command(name = "sim-host", version, after_help = "Without a command: sim-host compare scenarios/paper.toml")]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Fly once: log.csv, and a figure.
    Fly(FlyArgs),
    /// Fly the same flights under each controller: a table, report.md, results.json, and a figure.
    Compare(CompareArgs),
    /// Print the largest loss of thrust that a hover survives, by linear program.
    Limits(LimitsArgs),
    /// Print the JSON Schema of a scenario.
    Schema,
}

#[derive(Args)]
struct FlyArgs {
    /// The scenario, a TOML file.
    scenario: PathBuf,
    /// Who flies.
    #[arg(long, value_enum, default_value_t = ControllerName::Lgs)]
    controller: ControllerName,
    /// Seed of noise and wind; the scenario's if left out.
    #[arg(long)]
    seed: Option<u64>,
    /// Where results go; `out/<scenario>` if left out.
    #[arg(long)]
    out: Option<PathBuf>,
    /// The controller's arithmetic.
    #[arg(long, value_enum, default_value_t = NumberFormat::F32)]
    format: NumberFormat,
    /// Rows of log.csv a second, at most the control rate.
    #[arg(long, default_value_t = LOG_HZ, value_parser = clap::value_parser!(u32).range(1..=8000))]
    log_hz: u32,
    /// Also write every tick's inputs and thrusts to this file, for a board to repeat.
    #[arg(long, value_name = "FILE")]
    ticks: Option<PathBuf>,
}

#[derive(Args)]
struct LimitsArgs {
    /// The machine.
    #[arg(value_enum)]
    airframe: AirframeName,
    /// Largest total thrust over weight.
    #[arg(long, default_value_t = VehicleKeys::default().thrust_to_weight)]
    thrust_to_weight: f64,
}

#[derive(Args)]
struct CompareArgs {
    /// The scenario, a TOML file.
    scenario: PathBuf,
    /// Who flies, separated by commas.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = ControllerName::MAIN)]
    controllers: Vec<ControllerName>,
    /// Number of seeds, and so of flights for each controller; more than one makes no difference without noise and wind.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// First seed; the others follow it. The scenario's if left out.
    #[arg(long, value_name = "BASE")]
    seed: Option<u64>,
    /// Where results go; `out/<scenario>` if left out.
    #[arg(long)]
    out: Option<PathBuf>,
    /// The controllers' arithmetic.
    #[arg(long, value_enum, default_value_t = NumberFormat::F32)]
    format: NumberFormat,
    /// Print results.json instead of the table.
    #[arg(long)]
    json: bool,
}

/// Default rows of a log a second: beyond what a rigid body shows.
const LOG_HZ: u32 = 100;

/// What the main job flies.
const MAIN_SCENARIO: &str = "scenarios/paper.toml";

/// Exit code for input that cannot be used, as clap's.
const BAD_INPUT: u8 = 2;

/// Runs the command line of this process.
pub fn run() -> ExitCode {
    let command = Cli::parse().command.unwrap_or_else(|| {
        // The defaults of `compare` are declared once, in its arguments.
        let main_job = Cli::parse_from(["sim-host", "compare", MAIN_SCENARIO]);
        main_job.command.unwrap_or(Command::Schema)
    });
    let result = match &command {
        Command::Fly(args) => fly(args),
        Command::Compare(args) => compare(args),
        Command::Limits(args) => limits(args),
        Command::Schema => schema(),
    };
    result.map_or_else(
        |failure| {
            eprintln!("sim-host: {failure}");
            ExitCode::from(failure.code)
        },
        |()| ExitCode::SUCCESS,
    )
}

/// Why a command could not do its work.
#[derive(Debug, thiserror::Error)]
#[error("{text}")]
struct Failure {
    text: String,
    code: u8,
}

impl Failure {
    fn bad_input(error: impl std::fmt::Display) -> Self {
        Self { text: error.to_string(), code: BAD_INPUT }
    }

    fn writing(folder: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |error| Self { text: format!("{}: cannot be written: {error}", folder.display()), code: 1 }
    }

    #[expect(clippy::needless_pass_by_value, reason = "the shape that map_err wants")]
    fn drawing(error: Box<dyn Error>) -> Self {
        Self { text: format!("the figure cannot be drawn: {error}"), code: 1 }
    }
}

/// The scenario's file name without folder and ending.
fn name_of(scenario: &Path) -> String {
    scenario.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn folder(out: Option<&PathBuf>, scenario: &Path) -> PathBuf {
    out.cloned().unwrap_or_else(|| Path::new("out").join(name_of(scenario)))
}

fn load(file: &Path) -> Result<Scenario, Failure> {
    Scenario::load(file).map_err(Failure::bad_input)
}

fn refused(scenario: &Path, controller: ControllerName) -> impl FnOnce(control_core::ConfigError) -> Failure {
    move |error| Failure::bad_input(format!("{}: controllers.{controller}: {error}", scenario.display()))
}

fn add_figure(
    files: &mut Files,
    stem: &str,
    title: &str,
    traces: &[Trace],
    scenario: &Scenario,
) -> Result<(), Failure> {
    let svg = comparison_svg(title, traces, &scenario.fault_windows_s()).map_err(Failure::drawing)?;
    files.add(format!("{stem}.png"), png(&svg).map_err(Failure::drawing)?);
    files.add(format!("{stem}.svg"), svg);
    Ok(())
}

fn fly(args: &FlyArgs) -> Result<(), Failure> {
    let scenario = load(&args.scenario)?;
    let controller = args.controller;
    let seed = args.seed.unwrap_or(scenario.seed);
    let flight = Flight { scenario: &scenario, controller, seed, format: args.format };
    let mut log = Log::at_rate(args.log_hz.into(), scenario.control_hz());
    let mut ticks = args.ticks.is_some().then(TickRecord::default);
    let flown = fly_measured(&flight, &mut |sample| {
        log.note(sample);
        if let Some(ticks) = &mut ticks {
            ticks.note(sample);
        }
    })
    .map_err(refused(&args.scenario, controller))?;

    let folder = folder(args.out.as_ref(), &args.scenario);
    let mut files = Files::default();
    files.add("log.csv", log.to_csv().map_err(Failure::writing(&folder))?);
    let title = format!("{}: {controller}, seed {seed}", name_of(&args.scenario));
    add_figure(&mut files, "flight", &title, &[Trace { controller, log: &log }], &scenario)?;
    files.write(&folder).map_err(Failure::writing(&folder))?;
    if let (Some(path), Some(ticks)) = (&args.ticks, &ticks) {
        std::fs::File::create(path).and_then(|file| ticks.write(file)).map_err(Failure::writing(path))?;
    }
    print!("{}", summary(&flown));
    println!("log.csv, flight.svg and flight.png are in {}", folder.display());
    Ok(())
}

/// The metrics of one flight, a line each.
fn summary(flown: &Flown) -> String {
    let end = flown.crash.map_or_else(
        || "flew to the end".to_owned(),
        |crash| format!("crashed at {:.3} s: {}", crash.t_s, crash.cause),
    );
    METRICS
        .iter()
        .filter_map(|metric| Some((metric, (metric.of)(&flown.metrics)?)))
        .fold(end + "\n", |text, (metric, value)| format!("{text}{:<28} {value:.6}\n", metric.name))
}

fn compare(args: &CompareArgs) -> Result<(), Failure> {
    let scenario = load(&args.scenario)?;
    let base = args.seed.unwrap_or(scenario.seed);
    let mut entries = Vec::new();
    let mut logs = Vec::new();
    for &controller in &args.controllers {
        let (flights, log) = fly_seeds(args, &scenario, controller, base)?;
        entries.push(Entry { controller, config: controller.config(&scenario), flights });
        logs.push((controller, log));
    }
    let comparison =
        Comparison { name: name_of(&args.scenario), scenario: &scenario, seed: base, seeds: args.seeds, entries };
    let traces: Vec<_> = logs.iter().map(|(controller, log)| Trace { controller: *controller, log }).collect();

    let json = format!("{:#}\n", comparison.json());
    let folder = folder(args.out.as_ref(), &args.scenario);
    let mut files = Files::default();
    files.add("report.md", comparison.markdown(&command_line(args, base)));
    files.add("results.json", json.clone());
    add_figure(&mut files, "comparison", &scenario.title, &traces, &scenario)?;
    files.write(&folder).map_err(Failure::writing(&folder))?;
    if args.json {
        print!("{json}");
    } else {
        print!("{}", comparison.table());
        println!("report.md, results.json, comparison.svg and comparison.png are in {}", folder.display());
    }
    Ok(())
}

/// Every flight of one controller, and the log of the first.
fn fly_seeds(
    args: &CompareArgs,
    scenario: &Scenario,
    controller: ControllerName,
    base: u64,
) -> Result<(Vec<Flown>, Log), Failure> {
    let fly = |seed: u64, log: Option<&mut Log>| {
        let flight = Flight { scenario, controller, seed, format: args.format };
        match log {
            Some(log) => fly_measured(&flight, &mut |sample| log.note(sample)),
            None => fly_measured(&flight, &mut |_| {}),
        }
        .map_err(refused(&args.scenario, controller))
    };
    let mut log = Log::at_rate(LOG_HZ.into(), scenario.control_hz());
    let mut flights = vec![fly(base, Some(&mut log))?];
    let others: Result<Vec<_>, _> = (1..args.seeds).into_par_iter().map(|i| fly(base.wrapping_add(i), None)).collect();
    flights.extend(others?);
    Ok((flights, log))
}

/// The command that makes the same comparison again.
fn command_line(args: &CompareArgs, base: u64) -> String {
    let names: Vec<_> = args.controllers.iter().map(ToString::to_string).collect();
    format!(
        "sim-host compare {} --controllers {} --seeds {} --seed {base}",
        args.scenario.display(),
        names.join(","),
        args.seeds
    )
}

fn limits(args: &LimitsArgs) -> Result<(), Failure> {
    let thrust_to_weight = args.thrust_to_weight;
    if !(THRUST_TO_WEIGHT.0..=THRUST_TO_WEIGHT.1).contains(&thrust_to_weight) {
        let (low, high) = THRUST_TO_WEIGHT;
        return Err(Failure::bad_input(format!(
            "--thrust-to-weight = {thrust_to_weight}: must be from {low} to {high}"
        )));
    }
    let keys = VehicleKeys { thrust_to_weight, ..VehicleKeys::default() };
    let vehicle = Vehicle::new(args.airframe, &keys);
    println!("Largest loss of thrust in a hover, thrust-to-weight {thrust_to_weight}:");
    for (name, failing, heading) in CASES {
        let limit = loss_max(&vehicle, failing, heading);
        println!("{name:<30} {}", limit.map_or("cannot hover".to_owned(), |loss| format!("{:5.1} %", 100.0 * loss)));
    }
    Ok(())
}

fn schema() -> Result<(), Failure> {
    let schema = schemars::schema_for!(Scenario);
    let text = serde_json::to_string_pretty(&schema).map_err(Failure::bad_input)?;
    println!("{text}");
    Ok(())
}
