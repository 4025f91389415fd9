//! The command line.
use crate::controllers::ControllerName;
use crate::figures::{FIGURES, Trace, limits::Outcome, png, svg};
use crate::flight::{Flight, NumberFormat, Sample};
use crate::log::Log;
use crate::output::Files;
use crate::report::{Comparison, Entry, Page};
use crate::scenario::Scenario;
use clap::{Args, Parser, Subcommand, ValueEnum};
use indicatif::ProgressBar;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use through::Through;

mod card;
mod detect;
mod estimate;
mod fly;
mod limits;
mod params;
mod replay;
mod sensors;
mod station;
mod station_log;
mod suite;
mod through;

/// Flies quadrotors that lose thrust, and compares the controllers that keep them up.
#[derive(Parser)]
#[command(name = "sim-host", version, after_help = "Without a command: sim-host compare scenarios/paper.toml")]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Fly once: log.csv, and figures.
    Fly(fly::FlyArgs),
    /// Fly the same flights under each controller: a table, report.html, results.json, logs and figures.
    Compare(CompareArgs),
    /// Fly the detector through silent losses and healthy hours: delays, misses, false alarms and the ROC.
    Detect(detect::DetectArgs),
    /// Fly many scenarios under each controller: one table, suite.json, suite.html and suite.md.
    Suite(suite::SuiteArgs),
    /// Print the largest loss of thrust, and the thrusts of a stuck rotor, that a hover survives, by linear program.
    Limits(limits::LimitsArgs),
    /// Fly once, and print how wrong each sensor was beside the truth.
    Sensors(sensors::SensorsArgs),
    /// Fly on the sensors, and print how wrong the estimate was beside the truth, and whether it knew.
    Estimate(estimate::EstimateArgs),
    /// Make the file on a card that a board fills with its flight logs.
    Card(card::CardArgs),
    /// Decide once more what a board's flight log was decided on, and compare every motor command bit by bit.
    Replay(replay::ReplayArgs),
    /// Print the parameters of the flight logic: names, ranges, values.
    Params(params::ParamsArgs),
    /// Speak with a board over its serial port or USB: parameters, how it is, its rotors on the bench.
    Station(station::StationArgs),
    /// Print the JSON Schema of a scenario.
    Schema,
}

#[derive(Args)]
struct CompareArgs {
    /// The scenario, a TOML file.
    scenario: PathBuf,
    #[command(flatten)]
    with: With,
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
    /// Who decides: the core on this computer, or the image on an emulated board.
    #[arg(long, value_enum, default_value_t = Through::Native)]
    through: Through,
    /// Print results.json instead of the table.
    #[arg(long)]
    json: bool,
}

/// What is put after a scenario.
#[derive(Args)]
struct With {
    /// Files whose tables are added to the scenario, such as the sensors of scenarios/kits; separated by commas.
    #[arg(long, value_name = "FILE", value_delimiter = ',')]
    with: Vec<PathBuf>,
}

/// Default rows of a log a second: beyond what a rigid body shows.
const LOG_HZ: u32 = 100;

/// Losses of the detector's campaign, %.
const LOSSES_PERCENT: [u32; 10] = [10, 20, 30, 40, 50, 60, 70, 80, 90, 100];

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
        Command::Fly(args) => fly::fly(args),
        Command::Compare(args) => compare(args),
        Command::Detect(args) => detect::detect(args),
        Command::Suite(args) => suite::suite(args),
        Command::Limits(args) => limits::limits(args),
        Command::Sensors(args) => sensors::sensors(args),
        Command::Estimate(args) => estimate::estimate(args),
        Command::Card(args) => card::card(args),
        Command::Replay(args) => replay::replay(args),
        Command::Params(args) => params::params(args),
        Command::Station(args) => station::station(args),
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
}

/// The scenario's file name without folder and ending.
fn name_of(scenario: &Path) -> String {
    scenario.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn load(file: &Path, with: &With) -> Result<Scenario, Failure> {
    Scenario::load_with(file, &with.with).map_err(Failure::bad_input)
}

fn refused(scenario: &Path, controller: ControllerName) -> impl FnOnce(control_core::ConfigError) -> Failure {
    move |error| Failure::bad_input(format!("{}: controllers.{controller}: {error}", scenario.display()))
}

/// The folder for results; refused before anything is flown if it is something else.
fn folder(out: Option<&PathBuf>, scenario: &Path) -> Result<PathBuf, Failure> {
    folder_in(out, Path::new("out"), scenario)
}

/// The same, with its default elsewhere.
fn folder_in(out: Option<&PathBuf>, default: &Path, scenario: &Path) -> Result<PathBuf, Failure> {
    let folder = out.cloned().unwrap_or_else(|| default.join(name_of(scenario)));
    if folder.exists() && !folder.is_dir() {
        return Err(Failure::bad_input(format!("--out = {}: is not a folder", folder.display())));
    }
    Ok(folder)
}

/// Prints to standard output; a reader that has seen enough is no error.
fn say(text: &str) -> Result<(), Failure> {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure { text: format!("standard output: {error}"), code: 1 })
        }
        _ => Ok(()),
    }
}

fn undrawn(error: impl std::fmt::Display) -> Failure {
    Failure { text: format!("the figures cannot be drawn: {error}"), code: 1 }
}

/// Draws every figure, adds each as PNG, and returns their titles and SVGs.
fn draw(files: &mut Files, traces: &[Trace], scenario: &Scenario) -> Result<Vec<(&'static str, String)>, Failure> {
    let windows_s = scenario.fault_windows_s();
    let drawn: Result<Vec<_>, Box<dyn Error + Send + Sync>> = FIGURES
        .par_iter()
        .filter(|figure| traces.iter().any(|trace| figure.is_of(trace.log)))
        .map(|figure| {
            let svg = svg(figure, traces, &windows_s).map_err(|error| error.to_string())?;
            let png = png(&svg).map_err(|error| error.to_string())?;
            Ok((figure, svg, png))
        })
        .collect();
    let mut titled = Vec::new();
    for (figure, svg, png) in drawn.map_err(undrawn)? {
        files.add(format!("{}.png", figure.name), png);
        titled.push((figure.title, svg));
    }
    Ok(titled)
}

/// Draws the faults beside what physics allows, if there is something to draw, and adds it as PNG and SVG.
fn draw_limits(files: &mut Files, comparison: &Comparison) -> Result<Option<(&'static str, String)>, Failure> {
    let outcomes: Vec<Outcome> = comparison.entries.iter().map(Entry::outcome_against_limits).collect();
    let Some(svg) = crate::figures::limits::svg(comparison.scenario, &outcomes).map_err(undrawn)? else {
        return Ok(None);
    };
    files.add("limits.png", png(&svg).map_err(undrawn)?);
    files.add("limits.svg", svg.clone());
    Ok(Some(("The faults beside what physics allows", svg)))
}

fn compare(args: &CompareArgs) -> Result<(), Failure> {
    let scenario = load(&args.scenario, &args.with)?;
    let folder = folder(args.out.as_ref(), &args.scenario)?;
    let controllers = chosen(&args.controllers);
    let scenario = args.through.prepare(&args.scenario, scenario, &controllers, args.format)?;
    let base = args.seed.unwrap_or(scenario.seed);
    // Drawn on a terminal only, on standard error.
    let bar = ProgressBar::new(controllers.len() as u64 * args.seeds);
    let mut entries = Vec::new();
    let mut logs = Vec::new();
    for controller in controllers {
        let seeds = Seeds { base, count: args.seeds, format: args.format, through: args.through };
        let (entry, log) = fly_seeds(&args.scenario, &scenario, controller, &seeds, &bar)?;
        entries.push(entry);
        logs.push((controller, log));
    }
    bar.finish_and_clear();
    let comparison = Comparison {
        name: name_of(&args.scenario),
        scenario: &scenario,
        seed: base,
        seeds: args.seeds,
        format: args.format,
        entries,
    };

    let mut files = Files::default();
    let traces: Vec<_> = logs.iter().map(|(controller, log)| Trace { controller: *controller, log }).collect();
    let mut figures = draw(&mut files, &traces, &scenario)?;
    figures.extend(draw_limits(&mut files, &comparison)?);
    for Trace { controller, log } in &traces {
        files.add(format!("log_{controller}.csv"), log.to_csv().map_err(Failure::writing(&folder))?);
    }
    let page = Page { command: &command_line(args, &comparison), figures: &figures };
    let json = format!("{:#}\n", comparison.json());
    files.add("report.html", comparison.html(&page));
    files.add("results.json", json.clone());
    files.write(&folder).map_err(Failure::writing(&folder))?;
    if args.json {
        return say(&json);
    }
    let where_to =
        format!("report.html, results.json, a log for each controller and the figures are in {}", folder.display());
    say(&format!("{}{where_to}\n", comparison.table()))
}

/// Names without those that were named before.
fn chosen(controllers: &[ControllerName]) -> Vec<ControllerName> {
    let mut named = BTreeSet::new();
    controllers.iter().copied().filter(|&name| named.insert(name)).collect()
}

/// Which flights are flown, and in what arithmetic.
struct Seeds {
    base: u64,
    count: u64,
    format: NumberFormat,
    through: Through,
}

/// Every flight of one controller, and the log of the first.
fn fly_seeds(
    file: &Path,
    scenario: &Scenario,
    controller: ControllerName,
    seeds: &Seeds,
    bar: &ProgressBar,
) -> Result<(Entry, Log), Failure> {
    let fly = |seed: u64, observe: &mut dyn FnMut(&Sample)| {
        let flight = Flight { scenario, controller, seed, format: seeds.format };
        let (flown, board) = seeds.through.fly(file, &flight, observe)?;
        bar.inc(1);
        board.as_ref().map_or(Ok(()), through::judge).map(|()| flown)
    };
    let mut log = Log::at_rate(LOG_HZ.into(), scenario.control_hz());
    let others = |i: u64| fly(seeds.base.wrapping_add(i), &mut |_| {});
    let (first, others): (_, Result<Vec<_>, _>) = rayon::join(
        || fly(seeds.base, &mut |sample| log.note(sample)),
        || (1..seeds.count).into_par_iter().map(others).collect(),
    );
    let mut flights = vec![first?];
    flights.extend(others?);
    Ok((Entry { controller, config: controller.config(scenario), flights }, log))
}

/// The command that makes the same comparison again.
fn command_line(args: &CompareArgs, comparison: &Comparison) -> String {
    let names: Vec<_> = comparison.entries.iter().map(|entry| entry.controller.to_string()).collect();
    let format = args.format.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
    format!(
        "sim-host compare {} --controllers {} --seeds {} --seed {} --format {format}",
        args.scenario.display(),
        names.join(","),
        args.seeds,
        comparison.seed,
    )
}

fn schema() -> Result<(), Failure> {
    let schema = schemars::schema_for!(Scenario);
    let text = serde_json::to_string_pretty(&schema).map_err(Failure::bad_input)?;
    say(&(text + "\n"))
}
