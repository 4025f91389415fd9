//! `sim-host sensors`: how wrong each sensor of a flight was, beside the truth.
use super::{Failure, With, load, refused, say};
use crate::controllers::ControllerName;
use crate::flight::{Flight, NumberFormat};
use crate::sensors::Account;
use clap::Args;
use comfy_table::{CellAlignment, Table, presets};
use std::path::PathBuf;

#[derive(Args)]
pub(super) struct SensorsArgs {
    /// The scenario, a TOML file with a table `[sensors]`.
    scenario: PathBuf,
    #[command(flatten)]
    with: With,
    /// Who flies.
    #[arg(long, value_enum, default_value_t = ControllerName::Default)]
    controller: ControllerName,
    /// Seed of noise and wind; the scenario's if left out.
    #[arg(long)]
    seed: Option<u64>,
}

pub(super) fn sensors(args: &SensorsArgs) -> Result<(), Failure> {
    let scenario = load(&args.scenario, &args.with)?;
    let Some(keys) = &scenario.sensors else {
        let file = args.scenario.display();
        return Err(Failure::bad_input(format!("{file}: sensors: nothing: must be a table that names parts")));
    };
    let (controller, seed) = (args.controller, args.seed.unwrap_or(scenario.seed));
    let flight = Flight { scenario: &scenario, controller, seed, format: NumberFormat::F32 };
    let mut account = Account::new(&scenario, keys);
    flight.fly(&mut |sample| account.note(sample)).map_err(refused(&args.scenario, controller))?;
    let mut table = Table::new();
    table.load_style(presets::UTF8_BORDERS_ONLY).set_header(Account::HEADS).add_rows(account.rows());
    for column in table.column_iter_mut().skip(2) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    say(&format!("{table}\n"))
}
