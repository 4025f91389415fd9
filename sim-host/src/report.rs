//! A comparison in words and numbers: terminal table, JSON and, in `html.rs`, the report; many of them in `suite.rs`.
use crate::controllers::{ControllerName, gains_json};
use crate::flight::{Landing, NumberFormat, Touchdown};
use crate::limits::worst_hover;
use crate::metrics::{FirstAlarm, Flown, METRICS, Metric, median_and_worst};
use crate::plant::PlantKind;
use crate::scenario::Scenario;
use comfy_table::{CellAlignment, ContentArrangement, Table, TableStyle, presets};
use control_core::Config;
use serde_json::{Map, Value, json};
use std::fmt::Write;

mod findings;
mod html;
mod suite;

pub use html::Page;
pub(crate) use html::{STYLE, escaped};
pub use suite::Suite;

/// The flights of one controller.
pub struct Entry {
    /// Who flew.
    pub controller: ControllerName,
    /// With what.
    pub config: Config,
    /// One flight a seed.
    pub flights: Vec<Flown>,
}

/// The same flights under several controllers.
pub struct Comparison<'a> {
    /// Name of the scenario: its file's, without folder and ending.
    pub name: String,
    /// What was flown.
    pub scenario: &'a Scenario,
    /// First seed.
    pub seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// The controllers' arithmetic.
    pub format: NumberFormat,
    /// One entry a controller.
    pub entries: Vec<Entry>,
}

impl Entry {
    /// Number of flights that flew to their end.
    pub fn survived(&self) -> usize {
        self.flights.iter().filter(|flown| flown.survived()).count()
    }

    /// Number of flights that a fault brought down in one piece.
    pub fn came_down(&self) -> usize {
        self.flights.iter().filter(|flown| flown.landing.is_some()).count()
    }

    /// Number of flights that never took off.
    pub fn refused(&self) -> usize {
        self.flights.iter().filter(|flown| flown.refusal.is_some()).count()
    }

    fn crashed(&self) -> usize {
        self.flights.iter().filter(|flown| flown.crash.is_some()).count()
    }

    fn metric(&self, name: &str) -> Option<(f64, f64)> {
        median_and_worst(&self.flights, Metric::named(name)?)
    }

    /// `median (worst)` over the flights that survived.
    fn cell(&self, metric: &Metric) -> String {
        match median_and_worst(&self.flights, metric) {
            Some((median, worst)) if short(median) != short(worst) => format!("{} ({})", short(median), short(worst)),
            Some((median, _)) => short(median),
            None => "–".to_owned(),
        }
    }

    fn json(&self) -> Value {
        let mut entry = Map::new();
        entry.insert("gains".to_owned(), gains_json(&self.config));
        entry.insert("flights".to_owned(), json!(self.flights.len()));
        entry.insert("survived".to_owned(), json!(self.survived()));
        entry.insert("came_down".to_owned(), json!(self.came_down()));
        entry.insert("refused".to_owned(), json!(self.refused()));
        for metric in &METRICS {
            let (median, worst) = median_and_worst(&self.flights, metric).unzip();
            entry.insert(metric.name.to_owned(), json!({"median": median, "worst": worst}));
        }
        let crashes: Vec<Value> = self
            .flights
            .iter()
            .filter_map(|flown| {
                let crash = flown.crash?;
                Some(json!({"seed": flown.seed, "t_s": crash.t_s, "cause": crash.cause.to_string()}))
            })
            .collect();
        entry.insert("crashes".to_owned(), Value::Array(crashes));
        let alarms: Vec<Value> = self
            .flights
            .iter()
            .filter_map(|flown| {
                let FirstAlarm { delay_s, rotor, loss } = flown.account.alarm?;
                // Numbered as in scenarios; null if all lost alike.
                let rotor = rotor.map(|index| index + 1);
                Some(json!({"seed": flown.seed, "delay_s": delay_s, "rotor": rotor, "loss": loss}))
            })
            .collect();
        entry.insert("first_alarms".to_owned(), Value::Array(alarms));
        let landings: Vec<Value> = self
            .flights
            .iter()
            .filter_map(|flown| {
                let Landing { t_s, touchdown: Touchdown { speed_m_s, tilt_rad } } = flown.landing?;
                Some(json!({"seed": flown.seed, "t_s": t_s, "speed_m_s": speed_m_s, "tilt_rad": tilt_rad}))
            })
            .collect();
        entry.insert("landings".to_owned(), Value::Array(landings));
        let refusal = |flown: &Flown| Some(json!({"seed": flown.seed, "fault": flown.refusal?.fault.to_string()}));
        entry.insert("refusals".to_owned(), self.flights.iter().filter_map(refusal).collect());
        Value::Object(entry)
    }
}

/// What every flight of the comparison had in common.
fn conditions(scenario: &Scenario) -> Value {
    let vehicle = scenario.vehicle();
    let rigid = scenario.plant == PlantKind::Rigid;
    json!({
        "plant": scenario.plant,
        "airframe": scenario.airframe,
        "frame": scenario.vehicle.frame,
        // The plant `paper` has rotors without limit and without lag.
        "thrust_to_weight": rigid.then_some(vehicle.thrust_to_weight),
        "motor_lag_s": rigid.then_some(vehicle.motor_lag_s),
        "mass_kg": vehicle.mass_kg,
        "inertia_kg_m2": vehicle.inertia_kg_m2,
        "control_hz": scenario.control_hz(),
        "duration_s": scenario.duration_s,
        "reference": scenario.reference,
        "preflight": scenario.preflight,
        "noise": scenario.noise,
        "wind": scenario.wind,
        "faults": scenario.fault,
        "hover": worst_hover(scenario).map(|hover| hover.to_string()),
    })
}

/// Three significant digits, without an exponent.
fn short(x: f64) -> String {
    let digits = if x == 0.0 { 0.0 } else { x.abs().log10().floor() };
    let decimals = (2.0 - digits).clamp(0.0, 6.0) as usize;
    format!("{x:.decimals$}")
}

/// A table as text, in one of the styles of `comfy_table`; the columns after the first `names` are of numbers.
fn table(style: TableStyle, header: Vec<String>, rows: Vec<Vec<String>>, names: usize) -> Table {
    let mut table = Table::new();
    table.load_style(style).set_content_arrangement(ContentArrangement::Disabled).set_header(header).add_rows(rows);
    for column in table.column_iter_mut().skip(names) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

impl Comparison<'_> {
    /// The whole comparison, for machines.
    pub fn json(&self) -> Value {
        let controllers: Map<String, Value> =
            self.entries.iter().map(|entry| (entry.controller.to_string(), entry.json())).collect();
        json!({
            "scenario": self.name,
            "seeds": self.seeds,
            "seed": self.seed,
            "format": self.format,
            "conditions": conditions(self.scenario),
            "controllers": controllers,
        })
    }

    /// Rows of the table: a name, then one cell a controller, `median (worst)` over the flights that survived.
    fn rows(&self) -> Vec<Vec<String>> {
        let counts = |name: &str, count: fn(&Entry) -> usize| -> Vec<String> {
            let cells = self.entries.iter().map(|entry| format!("{} of {}", count(entry), entry.flights.len()));
            std::iter::once(name.to_owned()).chain(cells).collect()
        };
        let mut rows = vec![counts("survived", Entry::survived), counts("came down", Entry::came_down)];
        if self.scenario.preflight {
            rows.push(counts("refused", Entry::refused));
        }
        for metric in &METRICS {
            let cells = self.entries.iter().map(|entry| entry.cell(metric));
            rows.push(std::iter::once(metric.name.to_owned()).chain(cells).collect());
        }
        rows
    }

    fn header(&self) -> Vec<String> {
        let first = if self.seeds > 1 { "median (worst)" } else { "" };
        std::iter::once(first.to_owned()).chain(self.entries.iter().map(|entry| entry.controller.to_string())).collect()
    }

    /// The table for the terminal, with what stands out below it.
    pub fn table(&self) -> String {
        let table = table(presets::UTF8_BORDERS_ONLY, self.header(), self.rows(), 1);
        let mut text = format!("{}\n{table}\n", self.scenario.title);
        for finding in self.findings() {
            let _ = writeln!(text, "• {finding}");
        }
        text
    }
}
