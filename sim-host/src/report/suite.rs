//! Many comparisons in one table: a row for each scenario and controller.
use super::findings::length;
use super::{Comparison, Entry, html, table};
use crate::figures::limits::Outcome;
use crate::limits::worst_hover;
use crate::metrics::FirstAlarm;
use comfy_table::presets;
use control_core::Knowledge;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The scenarios of a suite, each flown under the same controllers.
pub struct Suite<'a>(pub Vec<Comparison<'a>>);

/// A column of numbers.
struct Column {
    metric: &'static str,
    head: &'static str,
    /// From the metric's unit to the column's.
    scale: f64,
}

const fn millimetres(metric: &'static str, head: &'static str) -> Column {
    Column { metric, head, scale: 1000.0 }
}

const COLUMNS: [Column; 8] = [
    millimetres("altitude_deviation_max_m", "altitude"),
    millimetres("lateral_deviation_max_m", "lateral"),
    millimetres("horizontal_excursion_max_m", "horizontal"),
    millimetres("altitude_drop_max_m", "drop"),
    millimetres("position_error_settled_m", "settled"),
    millimetres("position_error_end_m", "after 20 s"),
    Column { metric: "tilt_max_rad", head: "tilt", scale: 1.0 },
    Column { metric: "yaw_rate_max_rad_s", head: "yaw rate", scale: 1.0 },
];

/// Two digits, or the whole number.
fn brief(x: f64) -> String {
    let decimals = [0.0995, 0.995, 9.95].into_iter().filter(|&least| x < least).count();
    format!("{x:.decimals$}")
}

/// What the heads of the columns mean.
const LEGEND: &str = "Median (worst) over the flights that survived, in mm, rad and rad/s. Altitude, lateral (the larger of north and east), horizontal and drop: \
     largest deviations during the faults; settled: largest distance from the setpoint from 5 s after an onset on; after 20 s: distance 20 s \
     after the last fault. Alarm: the rotor that the detector named first, the loss it found, and the median delay; – for who has no detector. Hover: what \
     statics allow under the worst of the faults.";

impl Entry {
    fn brief_cell(&self, column: &Column) -> String {
        let scaled = |(median, worst)| (brief(column.scale * median), brief(column.scale * worst));
        match self.metric(column.metric).map(scaled) {
            Some((median, worst)) if median != worst => format!("{median} ({worst})"),
            Some((median, _)) => median,
            None => "–".to_owned(),
        }
    }

    /// How many survived, and what became of the others.
    fn outcome(&self) -> String {
        let mut text = format!("{} of {}", self.survived(), self.flights.len());
        if self.refused() > 0 {
            let _ = write!(text, ", {} refused to take off", self.refused());
        }
        if self.crashed() > 0 {
            let _ = write!(text, ", {} crashed", self.crashed());
        }
        let speeds = self.flights.iter().filter_map(|flown| Some(flown.landing?.touchdown.speed_m_s));
        if let Some(fastest) = speeds.max_by(f64::total_cmp) {
            let _ = write!(text, ", {} came down at {fastest:.1} m/s", self.came_down());
        }
        text
    }

    /// How it fared, for the figure of limits.
    pub fn outcome_against_limits(&self) -> Outcome {
        let say = |(name, what): (&str, &str)| {
            let (median, _) = self.metric(name)?;
            Some(format!(", {what} {}", length(median)))
        };
        let off = [("altitude_deviation_max_m", "off in altitude by"), ("lateral_deviation_max_m", "sideways by")];
        let text =
            off.into_iter().filter_map(say).fold(format!("survived {}", self.outcome()), |text, part| text + &part);
        Outcome { controller: self.controller, text }
    }

    /// What the detector said first.
    fn alarm(&self) -> String {
        let detects = |rotors: control_core::RotorsConfig| matches!(rotors.knowledge, Knowledge::Estimated(_));
        if !self.config.rotors.is_some_and(detects) {
            return "–".to_owned();
        }
        let mut by_rotor: BTreeMap<Option<usize>, Vec<FirstAlarm>> = BTreeMap::new();
        for alarm in self.flights.iter().filter_map(|flown| flown.account.alarm) {
            by_rotor.entry(alarm.rotor).or_default().push(alarm);
        }
        let say = |(rotor, mut alarms): (Option<usize>, Vec<FirstAlarm>)| {
            alarms.sort_by(|a, b| a.delay_s.total_cmp(&b.delay_s));
            let FirstAlarm { delay_s, loss, .. } = alarms[alarms.len() / 2];
            let who = rotor.map_or_else(|| "all".to_owned(), |index| format!("rotor {}", index + 1));
            let part = if alarms.len() == self.flights.len() {
                String::new()
            } else {
                format!(" ({} of {})", alarms.len(), self.flights.len())
            };
            format!("{who}, {:.0} %, {:.0} ms{part}", 100.0 * loss, 1000.0 * delay_s)
        };
        let said: Vec<_> = by_rotor.into_iter().map(say).collect();
        if said.is_empty() { "none".to_owned() } else { said.join("; ") }
    }
}

impl Suite<'_> {
    fn header() -> Vec<String> {
        let columns = COLUMNS.iter().map(|column| column.head);
        let heads = ["scenario", "controller", "survived"].into_iter().chain(columns).chain(["alarm", "hover"]);
        heads.map(str::to_owned).collect()
    }

    fn rows(&self) -> Vec<Vec<String>> {
        let row = |comparison: &Comparison, entry: &Entry| {
            let cells = COLUMNS.iter().map(|column| entry.brief_cell(column));
            let hover = worst_hover(comparison.scenario).map_or_else(|| "–".to_owned(), |hover| hover.to_string());
            [comparison.name.clone(), entry.controller.to_string(), entry.outcome()]
                .into_iter()
                .chain(cells)
                .chain([entry.alarm(), hover])
                .collect()
        };
        self.0
            .iter()
            .flat_map(|comparison| comparison.entries.iter().map(move |entry| row(comparison, entry)))
            .collect()
    }

    /// The table for the terminal.
    pub fn table(&self) -> String {
        format!("{}\n{LEGEND}\n", table(presets::UTF8_BORDERS_ONLY, Self::header(), self.rows(), 3))
    }

    /// The table to paste into a page.
    pub fn markdown(&self) -> String {
        format!("{}\n\n{LEGEND}\n", table(presets::ASCII_MARKDOWN, Self::header(), self.rows(), 3))
    }

    /// The table as a page, below the command that makes it again.
    pub fn html(&self, command: &str) -> String {
        let body = format!(
            "<pre>{}</pre>\n{}<p>{}</p>\n",
            html::escaped(command),
            html::table(&Self::header(), &self.rows()),
            html::escaped(LEGEND)
        );
        html::whole("suite", &body)
    }

    /// Every comparison, for machines.
    pub fn json(&self) -> Value {
        json!(self.0.iter().map(Comparison::json).collect::<Vec<_>>())
    }
}
