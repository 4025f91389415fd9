//! `sim-host suite`: many scenarios, one table.
use super::{Failure, Seeds, Through, With, chosen, fly_seeds, folder, load, name_of, say};
use crate::controllers::ControllerName;
use crate::flight::NumberFormat;
use crate::output::Files;
use crate::report::{Comparison, Entry, Suite};
use crate::scenario::Scenario;
use clap::Args;
use indicatif::ProgressBar;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

#[derive(Args)]
pub(super) struct SuiteArgs {
    /// Scenarios: TOML files, and folders of them.
    #[arg(required = true)]
    scenarios: Vec<PathBuf>,
    #[command(flatten)]
    with: With,
    /// Who flies, separated by commas.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = ControllerName::TOLERANT)]
    controllers: Vec<ControllerName>,
    /// Number of seeds, and so of flights of each scenario under each controller, from the scenario's seed on.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// Where suite.json, suite.html and suite.md go.
    #[arg(long, default_value = "out/suite")]
    out: PathBuf,
    /// Print suite.json instead of the table.
    #[arg(long)]
    json: bool,
}

/// The scenarios that the arguments name: files as given, then those of a folder by name.
fn found(scenarios: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in scenarios {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let refused = |error| Failure::bad_input(format!("{}: cannot be read: {error}", path.display()));
        let entries: Result<Vec<_>, _> = std::fs::read_dir(path).map_err(refused)?.collect();
        let mut here: Vec<_> = entries.map_err(refused)?.into_iter().map(|entry| entry.path()).collect();
        here.retain(|file| file.extension().is_some_and(|ending| ending == "toml"));
        if here.is_empty() {
            return Err(Failure::bad_input(format!("{}: has no scenario, a file that ends in .toml", path.display())));
        }
        here.sort();
        files.extend(here);
    }
    Ok(files)
}

pub(super) fn suite(args: &SuiteArgs) -> Result<(), Failure> {
    let files = found(&args.scenarios)?;
    let folder = folder(Some(&args.out), Path::new(""))?;
    let scenarios: Vec<Scenario> = files.iter().map(|file| load(file, &args.with)).collect::<Result<_, _>>()?;
    let controllers = chosen(&args.controllers);
    let bar = ProgressBar::new(files.len() as u64 * controllers.len() as u64 * args.seeds);
    let fly = |(file, scenario): (&PathBuf, &Scenario), controller: ControllerName| {
        let seeds =
            Seeds { base: scenario.seed, count: args.seeds, format: NumberFormat::F32, through: Through::Native };
        fly_seeds(file, scenario, controller, &seeds, &bar).map(|(entry, _)| entry)
    };
    let comparisons: Result<Vec<_>, Failure> = files
        .par_iter()
        .zip(&scenarios)
        .map(|(file, scenario)| {
            let entries: Result<Vec<Entry>, _> =
                controllers.par_iter().map(|&controller| fly((file, scenario), controller)).collect();
            Ok(Comparison {
                name: name_of(file),
                scenario,
                seed: scenario.seed,
                seeds: args.seeds,
                format: NumberFormat::F32,
                entries: entries?,
            })
        })
        .collect();
    bar.finish_and_clear();
    let suite = Suite(comparisons?);

    let json = format!("{:#}\n", suite.json());
    let mut results = Files::default();
    results.add("suite.json", json.clone());
    results.add("suite.html", suite.html(&command_line(args, &controllers)));
    results.add("suite.md", suite.markdown());
    results.write(&folder).map_err(Failure::writing(&folder))?;
    if args.json {
        return say(&json);
    }
    say(&format!("{}suite.json, suite.html and suite.md are in {}\n", suite.table(), folder.display()))
}

/// The command that flies the same suite again.
fn command_line(args: &SuiteArgs, controllers: &[ControllerName]) -> String {
    let scenarios: Vec<_> = args.scenarios.iter().map(|path| path.display().to_string()).collect();
    let names: Vec<_> = controllers.iter().map(ToString::to_string).collect();
    format!("sim-host suite {} --controllers {} --seeds {}", scenarios.join(" "), names.join(","), args.seeds)
}
