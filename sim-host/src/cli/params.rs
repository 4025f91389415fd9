//! `sim-host params`: the parameters of the flight logic, from their one declaration.
use super::{Failure, say};
use clap::{Args, ValueEnum};
use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use control_core::parameters::{Declaration, Parameters};
use serde_json::json;

#[derive(Args)]
pub(super) struct ParamsArgs {
    /// Values to try, checked as the board checks them.
    #[arg(value_name = "NAME=VALUE")]
    set: Vec<String>,
    /// What is printed.
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    /// A table for the terminal.
    Table,
    /// The page docs/parameters.md.
    Markdown,
    /// One object a parameter.
    Json,
}

/// Opens the page.
const HEAD: &str = "\
# Parameters

What may be changed of the flight logic without a compiler. Each is declared once, in `control-core/src/parameters/table.rs`; a value
outside its range is refused. Names are as MAVLink carries them. What they do in flight: [flying.md](flying.md).

This page is made by the command below, and a test holds it to that.

```console
$ cargo run --release -- params --format markdown > docs/parameters.md
```

";

pub(super) fn params(args: &ParamsArgs) -> Result<(), Failure> {
    let mut parameters = Parameters::default();
    for assignment in &args.set {
        set(&mut parameters, assignment)?;
    }
    say(&match args.format {
        Format::Table => format!("{}\n", table(&parameters, presets::UTF8_FULL_CONDENSED)),
        Format::Markdown => format!("{HEAD}{}\n", table(&parameters, presets::ASCII_MARKDOWN)),
        Format::Json => format!("{:#}\n", parameters.iter().map(object).collect::<serde_json::Value>()),
    })
}

fn set(parameters: &mut Parameters, assignment: &str) -> Result<(), Failure> {
    let Some((name, value)) = assignment.split_once('=') else {
        return Err(Failure::bad_input(format!("{assignment}: must be NAME=VALUE")));
    };
    let value = value.trim().parse().map_err(|_| Failure::bad_input(format!("{name} = {value}: must be a number")))?;
    parameters.set(name.trim(), value).map(|_| ()).map_err(|error| Failure::bad_input(format!("{assignment}: {error}")))
}

pub(super) fn table(parameters: &Parameters, style: comfy_table::TableStyle) -> Table {
    let mut table = Table::new();
    let header = ["name", "value", "from", "to", "unit", "what"];
    let rows = parameters.iter().map(|(declaration, value)| {
        let Declaration { name, unit, min, max, text, .. } = *declaration;
        [name.to_owned(), value.to_string(), min.to_string(), max.to_string(), unit.to_owned(), text.to_owned()]
    });
    table.load_style(style).set_content_arrangement(ContentArrangement::Disabled).set_header(header).add_rows(rows);
    for column in table.column_iter_mut().skip(1).take(3) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn object((declaration, value): (&Declaration, f32)) -> serde_json::Value {
    let Declaration { name, unit, min, max, step, default, text } = declaration;
    json!({ "name": name, "value": value, "min": min, "max": max, "step": step, "default": default, "unit": unit, "text": text })
}
