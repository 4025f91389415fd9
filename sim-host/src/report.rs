//! A comparison in words and numbers: terminal table, JSON and, in `html.rs`, the report.
use crate::controllers::{ControllerName, gains_json};
use crate::fault::{Fault, Rotors};
use crate::flight::{Landing, NumberFormat, Touchdown};
use crate::limits::{Heading, loss_max};
use crate::metrics::{Flown, METRICS, Metric, median_and_worst};
use crate::plant::PlantKind;
use crate::reference::Reference;
use crate::scenario::Scenario;
use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use control_core::Config;
use serde_json::{Map, Value, json};
use std::fmt::Write;

mod html;

pub use html::Page;
pub(crate) use html::{STYLE, escaped};

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

/// Half a peak-to-peak that is called a limit cycle, m: far above what the sensors' noise makes.
const LIMIT_CYCLE_M: f64 = 0.03;

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
    })
}

/// Three significant digits, without an exponent.
fn short(x: f64) -> String {
    let digits = if x == 0.0 { 0.0 } else { x.abs().log10().floor() };
    let decimals = (2.0 - digits).clamp(0.0, 6.0) as usize;
    format!("{x:.decimals$}")
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
            let cells = self.entries.iter().map(|entry| match median_and_worst(&entry.flights, metric) {
                Some((median, worst)) if short(median) != short(worst) => {
                    format!("{} ({})", short(median), short(worst))
                }
                Some((median, _)) => short(median),
                None => "–".to_owned(),
            });
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
        let mut table = Table::new();
        table
            .load_style(presets::UTF8_BORDERS_ONLY)
            .set_content_arrangement(ContentArrangement::Disabled)
            .set_header(self.header())
            .add_rows(self.rows());
        for column in table.column_iter_mut().skip(1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        let mut text = format!("{}\n{table}\n", self.scenario.title);
        for finding in self.findings() {
            let _ = writeln!(text, "• {finding}");
        }
        text
    }

    /// What a reader should not miss, each with its number.
    pub fn findings(&self) -> Vec<String> {
        let mut findings = Vec::new();
        for entry in &self.entries {
            let name = entry.controller;
            let crashed = entry.flights.iter().filter_map(|flown| flown.crash);
            if let Some(first) = crashed.min_by(|a, b| a.t_s.total_cmp(&b.t_s)) {
                let (lost, flights) = (entry.crashed(), entry.flights.len());
                findings.push(format!(
                    "{name} crashed in {lost} of {flights} flights: it {}, first at {} s.",
                    first.cause,
                    short(first.t_s)
                ));
            }
            let landed = entry.flights.iter().filter_map(|flown| flown.landing);
            if let Some(worst) = landed.max_by(|a, b| a.touchdown.speed_m_s.total_cmp(&b.touchdown.speed_m_s)) {
                let (down, flights) = (entry.came_down(), entry.flights.len());
                findings.push(format!(
                    "{name} came down in {down} of {flights} flights, at worst {}, {} s into the flight.",
                    worst.touchdown,
                    short(worst.t_s)
                ));
            }
            if let Some(first) = entry.flights.iter().find_map(|flown| flown.refusal) {
                let (refused, flights) = (entry.refused(), entry.flights.len());
                findings.push(format!("{name} never took off in {refused} of {flights} flights: {}.", first.fault));
            }
            if self.is_calm()
                && let Some((median, _)) = entry.metric("lateral_limit_cycle_m")
                && median >= LIMIT_CYCLE_M
            {
                findings.push(format!(
                    "{name} limit-cycles: ±{} m sideways before any fault, commanded thrust varies by {} N/s.",
                    short(median),
                    short(entry.metric("motor_total_variation_n_s").map_or(f64::NAN, |m| m.0))
                ));
            }
        }
        findings.extend(self.against_pid());
        findings.extend(self.against_physics());
        if self.scenario.plant == PlantKind::Paper {
            findings.push(
                "pid and raw fly the paper's cascade from the same starting gains; lgs flies its own, with the \
                 weight on the integral and thrust limits it never needs here."
                    .to_owned(),
            );
        }
        findings
    }

    /// Whether nothing but the controller itself moves the machine before the fault.
    fn is_calm(&self) -> bool {
        let wind = &self.scenario.wind;
        wind.gust_rms_n == 0.0
            && wind.torque_rms_nm == 0.0
            && !matches!(self.scenario.reference, Reference::Helix(_) | Reference::Weave(_))
    }

    /// Each fault beside the largest that a hover of this machine survives at all.
    fn against_physics(&self) -> Vec<String> {
        if self.scenario.plant == PlantKind::Paper {
            return Vec::new();
        }
        let vehicle = self.scenario.vehicle();
        let percent = |loss: f64| format!("{:.1} %", 100.0 * loss);
        let limit =
            |rotors: Rotors, heading| loss_max(&vehicle, rotors, heading).map_or_else(|| "none".to_owned(), percent);
        let beside = |fault: &Fault| {
            let rotors: Vec<_> = fault.rotors.numbers().map(|number| number.to_string()).collect();
            Some(format!(
                "The fault takes {} of rotor{} {}; a hover survives up to {} with its heading, {} without.",
                percent(fault.kind.loss()?),
                if rotors.len() == 1 { "" } else { "s" },
                rotors.join(", "),
                limit(fault.rotors, Heading::Held),
                limit(fault.rotors, Heading::GivenUp)
            ))
        };
        self.scenario.fault.iter().filter_map(beside).collect()
    }

    /// How much of fixed gains' altitude deviation is left.
    fn against_pid(&self) -> Vec<String> {
        let deviation = |entry: &Entry| entry.metric("altitude_deviation_max_m").map(|m| m.0);
        let pid = self.entries.iter().find(|entry| entry.controller == ControllerName::Pid);
        let Some(fixed) = pid.and_then(deviation) else { return Vec::new() };
        self.entries
            .iter()
            .filter(|entry| entry.controller != ControllerName::Pid)
            .filter_map(|entry| {
                let adaptive = deviation(entry)?;
                let name = entry.controller;
                let ratio = if adaptive < fixed {
                    format!("{} times less", short(fixed / adaptive))
                } else {
                    format!("{} times more", short(adaptive / fixed))
                };
                let (adaptive, fixed) = (short(adaptive), short(fixed));
                Some(format!("{name} is off in altitude by {adaptive} m in the fault, pid by {fixed} m: {ratio}."))
            })
            .collect()
    }
}
