//! `sim-host estimate`: how wrong the estimate was that was flown on, beside the truth, and whether it knew.
use super::{Failure, With, load, name_of, refused, say};
use crate::aboard::{Account, Consistency, Lost, QUANTITIES, Quantity, Verdict, consistency};
use crate::controllers::ControllerName;
use crate::flight::{Ending, Flight, NumberFormat};
use crate::scenario::Scenario;
use clap::Args;
use comfy_table::{CellAlignment, Table, presets};
use indicatif::ProgressBar;
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::path::PathBuf;

#[derive(Args)]
pub(super) struct EstimateArgs {
    /// The scenario, a TOML file that is flown on its sensors.
    scenario: PathBuf,
    #[command(flatten)]
    with: With,
    /// Who flies.
    #[arg(long, value_enum, default_value_t = ControllerName::Default)]
    controller: ControllerName,
    /// Number of seeds, and so of flights.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// First seed; the others follow it. The scenario's if left out.
    #[arg(long, value_name = "BASE")]
    seed: Option<u64>,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
}

/// One flight and what its estimate was worth.
struct Judged {
    seed: u64,
    ending: Option<Ending>,
    verdict: Verdict,
}

fn judge(args: &EstimateArgs, scenario: &Scenario, seed: u64) -> Result<Judged, Failure> {
    let flight = Flight { scenario, controller: args.controller, seed, format: NumberFormat::F32 };
    let mut account = Account::new(scenario.control_hz());
    let flown = flight.fly(&mut |sample| account.note(sample));
    let ending = flown.map_err(refused(&args.scenario, args.controller))?;
    Ok(Judged { seed, ending, verdict: account.finish() })
}

pub(super) fn estimate(args: &EstimateArgs) -> Result<(), Failure> {
    let scenario = load(&args.scenario, &args.with)?;
    if !scenario.sensors.as_ref().is_some_and(|sensors| sensors.flown) {
        let file = args.scenario.display();
        let text = format!("{file}: sensors.flown: nothing: must be true; --with scenarios/kits/gnss.toml makes it so");
        return Err(Failure::bad_input(text));
    }
    let base = args.seed.unwrap_or(scenario.seed);
    let bar = ProgressBar::new(args.seeds);
    let flights: Vec<Judged> = (0..args.seeds)
        .into_par_iter()
        .map(|i| judge(args, &scenario, base.wrapping_add(i)).inspect(|_| bar.inc(1)))
        .collect::<Result<_, _>>()?;
    bar.finish_and_clear();
    let nees: Vec<&[f64]> = flights.iter().map(|flight| flight.verdict.nees.as_slice()).collect();
    let consistency = consistency(&nees);
    if args.json {
        return say(&format!("{:#}\n", in_json(args, base, &flights, consistency)));
    }
    say(&(in_words(&flights, consistency)))
}

/// Median and worst of a quantity. The worst of a share is the least.
fn median_and_worst(flights: &[Judged], quantity: &Quantity) -> (f64, f64) {
    let mut values: Vec<f64> = flights.iter().map(|flight| (quantity.of)(&flight.verdict)).collect();
    values.sort_by(f64::total_cmp);
    let (low, high) = ((values.len() - 1) / 2, values.len() / 2);
    let worst = if quantity.name.ends_with("_share") { values[0] } else { values[values.len() - 1] };
    (f64::midpoint(values[low], values[high]), worst)
}

fn ended(ending: &Ending) -> String {
    match ending {
        Ending::Crashed(crash) => crash.to_string(),
        Ending::CameDown(landing) => landing.to_string(),
        Ending::Refused(refusal) => refusal.to_string(),
    }
}

/// What happened to one flight, if something did.
fn remarks(flight: &Judged) -> Vec<String> {
    let lost = |Lost { fact, from_s, for_s }: &Lost| format!("{fact} lost for {for_s:.2} s from {from_s:.2} s on");
    flight.ending.iter().map(ended).chain(flight.verdict.lost.iter().map(lost)).collect()
}

fn in_words(flights: &[Judged], consistency: Option<Consistency>) -> String {
    let mut table = Table::new();
    table.load_style(presets::UTF8_BORDERS_ONLY).set_header(["quantity", "median", "worst", "what it is"]);
    for quantity in &QUANTITIES {
        let (median, worst) = median_and_worst(flights, quantity);
        table.add_row([quantity.name, &format!("{median:.4}"), &format!("{worst:.4}"), quantity.title]);
    }
    for column in table.column_iter_mut().skip(1).take(2) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    let mut text = format!("{table}\n");
    if let Some(Consistency { mean, band: (low, high), inside }) = consistency {
        text += &format!(
            "NEES, mean of {} flights: {mean:.2} over their time; at one time 95 % should be from {low:.2} to {high:.2}, and {:.0} % are\n",
            flights.len(),
            100.0 * inside,
        );
    }
    for flight in flights {
        let remarks = remarks(flight);
        if !remarks.is_empty() {
            text += &format!("seed {}: {}\n", flight.seed, remarks.join("; "));
        }
    }
    text
}

fn in_json(args: &EstimateArgs, base: u64, flights: &[Judged], consistency: Option<Consistency>) -> Value {
    let quantities: Map<String, Value> = QUANTITIES
        .iter()
        .map(|quantity| {
            let (median, worst) = median_and_worst(flights, quantity);
            (quantity.name.to_owned(), json!({"median": median, "worst": worst}))
        })
        .collect();
    let each: Vec<Value> = flights
        .iter()
        .map(|flight| {
            let figures = QUANTITIES.iter().map(|q| (q.name.to_owned(), json!((q.of)(&flight.verdict))));
            let mut entry = Map::from_iter([("seed".to_owned(), json!(flight.seed))]);
            entry.extend(figures);
            entry.insert("remarks".to_owned(), json!(remarks(flight)));
            Value::Object(entry)
        })
        .collect();
    json!({
        "scenario": name_of(&args.scenario),
        "controller": args.controller.to_string(),
        "seed": base,
        "quantities": quantities,
        "nees": consistency.map(|c| json!({"mean": c.mean, "band": [c.band.0, c.band.1], "inside_share": c.inside})),
        "flights": each,
    })
}
