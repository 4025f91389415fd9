//! `sim-host fly`: one flight, what happened in it, and what is measured of it.
use super::through::{self, Through};
use super::{Failure, LOG_HZ, With, draw, folder, load, say};
use crate::chronicle::{Chronicle, Happening};
use crate::controllers::ControllerName;
use crate::figures::Trace;
use crate::flight::{Flight, NumberFormat};
use crate::log::{Log, TickRecord};
use crate::metrics::{Flown, METRICS};
use crate::output::Files;
use clap::Args;
use std::path::PathBuf;

#[derive(Args)]
pub(super) struct FlyArgs {
    /// The scenario, a TOML file.
    scenario: PathBuf,
    #[command(flatten)]
    with: With,
    /// Who flies.
    #[arg(long, value_enum, default_value_t = ControllerName::Default)]
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
    /// Who decides: the core on this computer, or the image on an emulated board.
    #[arg(long, value_enum, default_value_t = Through::Native)]
    through: Through,
    /// Rows of log.csv a second, at most the control rate.
    #[arg(long, default_value_t = LOG_HZ, value_parser = clap::value_parser!(u32).range(1..=8000))]
    log_hz: u32,
    /// Also write every tick's inputs and thrusts to this file, for a board to repeat.
    #[arg(long, value_name = "FILE")]
    ticks: Option<PathBuf>,
}

pub(super) fn fly(args: &FlyArgs) -> Result<(), Failure> {
    let scenario = load(&args.scenario, &args.with)?;
    let scenario = args.through.prepare(&args.scenario, scenario, &[args.controller], args.format)?;
    let folder = folder(args.out.as_ref(), &args.scenario)?;
    let controller = args.controller;
    let seed = args.seed.unwrap_or(scenario.seed);
    let flight = Flight { scenario: &scenario, controller, seed, format: args.format };
    let mut log = Log::at_rate(args.log_hz.into(), scenario.control_hz());
    let mut ticks = match &args.ticks {
        None => None,
        Some(path) => Some(TickRecord::new(controller, scenario.vehicle().airframe()).ok_or_else(|| {
            Failure::bad_input(format!("--ticks {}: only lgs and default are known to the board", path.display()))
        })?),
    };
    let mut chronicle = Chronicle::default();
    let (flown, board) = args.through.fly(&args.scenario, &flight, &mut |sample| {
        log.note(sample);
        chronicle.step(sample);
        if let Some(ticks) = &mut ticks {
            ticks.note(sample);
        }
    })?;

    let mut files = Files::default();
    files.add("log.csv", log.to_csv().map_err(Failure::writing(&folder))?);
    draw(&mut files, &[Trace { controller, log: &log }], &scenario)?;
    if let Some(board) = &board {
        files.add("image.log", board.log.clone());
    }
    if let (Some(path), Some(ticks)) = (&args.ticks, &ticks) {
        std::fs::File::create(path).and_then(|file| ticks.write(file)).map_err(Failure::writing(path))?;
    }
    files.write(&folder).map_err(Failure::writing(&folder))?;
    for Happening { t_s, what } in chronicle.happenings() {
        say(&format!("{t_s:9.3} s  {what}\n"))?;
    }
    say(&format!("{}log.csv and the figures are in {}\n", summary(&flown), folder.display()))?;
    board.as_ref().map_or(Ok(()), |board| say(&through::summary(board)).and_then(|()| through::judge(board)))
}

/// The metrics of one flight, a line each.
fn summary(flown: &Flown) -> String {
    let end = match flown {
        Flown { crash: Some(crash), .. } => crash.to_string(),
        Flown { landing: Some(landing), .. } => landing.to_string(),
        Flown { refusal: Some(refusal), .. } => refusal.to_string(),
        _ => "flew to the end".to_owned(),
    };
    METRICS
        .iter()
        .filter_map(|metric| Some((metric, (metric.of)(&flown.metrics)?)))
        .fold(end + "\n", |text, (metric, value)| format!("{text}{:<28} {value:.6}\n", metric.name))
}
