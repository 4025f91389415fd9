//! A campaign in words and numbers: terminal table, JSON and one page.
use super::roc::{IN_TIME_S, Point};
use super::statistics::{percentile, poisson, wilson};
use super::{Campaign, Healthy, ONSET_S, Outcome, READ_S, Results, Step, WATCHED_S};
use crate::report::{STYLE, escaped};
use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use serde_json::{Value, json};

/// What the page is made of besides the results.
pub struct Page<'a> {
    /// Name of the scenario.
    pub name: &'a str,
    /// The command that makes it again.
    pub command: &'a str,
    /// The ROC, if there were healthy hours.
    pub svg: Option<&'a str>,
}

/// A number of flights out of some.
#[derive(Clone, Copy)]
struct Rate {
    count: usize,
    of: usize,
}

impl Rate {
    fn json(self) -> Value {
        let (low, high) = wilson(self.count, self.of);
        json!({"count": self.count, "of": self.of, "low_95": low, "high_95": high})
    }

    /// In percent, with its interval.
    fn text(self) -> String {
        let (low, high) = wilson(self.count, self.of);
        let share = if self.of == 0 { f64::NAN } else { self.count as f64 / self.of as f64 };
        format!("{:.1} ({:.1}–{:.1})", 100.0 * share, 100.0 * low, 100.0 * high)
    }
}

const HEADER: [&str; 9] = [
    "loss %",
    "median ms",
    "95th ms",
    "missed %",
    "wrong rotor %",
    "early %",
    "second alarm %",
    "share error",
    "survived",
];

impl Step {
    fn rate(&self, is: impl Fn(&Outcome) -> bool) -> Rate {
        Rate { count: self.fair().filter(|outcome| is(outcome)).count(), of: self.fair().count() }
    }

    /// Delay that this share of the flights stay within, s: none if too many miss.
    pub fn delay_s(&self, share: f64) -> Option<f64> {
        percentile(self.fair().map(Outcome::delay_s), share)
    }

    /// Flights without any alarm.
    pub fn missed(&self) -> usize {
        self.fair().filter(|outcome| outcome.alarm_s.is_none()).count()
    }

    /// Flights whose first alarm named another rotor, or all.
    pub fn wrong(&self) -> usize {
        self.fair().filter(|outcome| outcome.alarm_s.is_some() && !outcome.right).count()
    }

    fn early(&self) -> Rate {
        Rate { count: self.outcomes.len() - self.fair().count(), of: self.outcomes.len() }
    }

    fn survived(&self) -> usize {
        self.outcomes.iter().filter(|outcome| outcome.survived).count()
    }

    /// Median size of the share's error, of the flights still up by then.
    fn share_error(&self) -> Option<f64> {
        percentile(self.fair().filter_map(|outcome| outcome.share_error.map(|error| Some(error.abs()))), 0.5)
    }

    fn second(&self) -> Rate {
        self.rate(|outcome| outcome.second)
    }

    fn row(&self) -> [String; 9] {
        let ms = |delay_s: Option<f64>| delay_s.map_or("missed".to_owned(), |s| format!("{:.0}", 1000.0 * s));
        [
            format!("{:.0}", 100.0 * self.loss),
            ms(self.delay_s(0.5)),
            ms(self.delay_s(0.95)),
            Rate { count: self.missed(), of: self.fair().count() }.text(),
            Rate { count: self.wrong(), of: self.fair().count() }.text(),
            self.early().text(),
            self.second().text(),
            self.share_error().map_or("–".to_owned(), |error| format!("{error:.3}")),
            format!("{} of {}", self.survived(), self.outcomes.len()),
        ]
    }

    fn json(&self) -> Value {
        let of = self.fair().count();
        json!({
            "loss": self.loss,
            "flights": self.outcomes.len(),
            "delay_median_s": self.delay_s(0.5),
            "delay_95_s": self.delay_s(0.95),
            "missed": Rate { count: self.missed(), of }.json(),
            "wrong_rotor": Rate { count: self.wrong(), of }.json(),
            "early": self.early().json(),
            "second_alarm": self.second().json(),
            "share_error_median": self.share_error(),
            "survived": self.survived(),
        })
    }
}

impl Healthy {
    /// Alarms an hour, and the interval.
    fn per_hour(&self) -> (f64, f64, f64) {
        let (low, high) = poisson(self.alarms);
        (self.alarms as f64 / self.hours, low / self.hours, high / self.hours)
    }

    fn text(&self) -> String {
        if self.hours == 0.0 {
            return "No healthy hours were flown.".to_owned();
        }
        let Self { hours, alarms, nats_max, lost } = self;
        let (rate, low, high) = self.per_hour();
        format!(
            "{alarms} false alarms in {hours:.1} healthy hours: {rate:.2} an hour ({low:.2}–{high:.2}); largest sum \
             {nats_max:.1} nats; {lost} flights ended early."
        )
    }

    fn json(&self) -> Value {
        let (rate, low, high) = self.per_hour();
        json!({
            "hours": self.hours, "false_alarms": self.alarms, "false_alarms_per_hour": rate, "low_95": low,
            "high_95": high, "nats_max": self.nats_max, "ended_early": self.lost,
        })
    }
}

impl Results {
    /// The table for the terminal.
    pub fn table(&self, campaign: &Campaign) -> String {
        let mut table = Table::new();
        table
            .load_style(presets::UTF8_BORDERS_ONLY)
            .set_content_arrangement(ContentArrangement::Disabled)
            .set_header(HEADER)
            .add_rows(self.steps.iter().map(Step::row));
        for column in table.column_iter_mut() {
            column.set_cell_alignment(CellAlignment::Right);
        }
        format!("{}\n{table}\n{}\n", campaign.scenario.title, self.healthy.text())
    }

    /// Everything, for machines.
    pub fn json(&self, name: &str, campaign: &Campaign) -> Value {
        let scenario = campaign.scenario;
        let detector = &campaign.detector;
        let f = |x: f32| -> f64 { x.to_string().parse().unwrap_or(f64::NAN) };
        let curve = |loss: f64| {
            let points = |in_time_s: f64| -> Vec<Value> {
                let point = |p: &Point| json!({"nats": p.nats, "false_alarms_per_hour": p.false_alarms as f64 / self.roc.hours, "detected": p.detected});
                self.roc.curve(loss, in_time_s).iter().map(point).collect()
            };
            let limits: Vec<_> = IN_TIME_S.iter().map(|&s| json!({"in_time_s": s, "points": points(s)})).collect();
            json!({"loss": loss, "curves": limits})
        };
        json!({
            "scenario": name,
            "seed": campaign.seed,
            "conditions": {
                "airframe": scenario.airframe,
                "vehicle": scenario.vehicle,
                "reference": scenario.reference,
                "noise": scenario.noise,
                "wind": scenario.wind,
                "onset_s": ONSET_S,
                "watched_s": WATCHED_S,
                "share_error_after_s": READ_S,
            },
            "detector": {
                "loss": f(detector.loss),
                "alarm_nats": f(detector.alarm_nats),
                "gyro_noise_rad_s": f(detector.gyro_noise_rad_s),
                "accelerometer_noise_m_s2": f(detector.accelerometer_noise_m_s2),
                "torque_rms_nm": f(detector.torque_rms_nm),
                "force_rms_n": f(detector.force_rms_n),
            },
            "losses": self.steps.iter().map(Step::json).collect::<Vec<_>>(),
            "healthy": if self.healthy.hours > 0.0 { self.healthy.json() } else { Value::Null },
            "roc": if self.healthy.hours > 0.0 { self.roc.losses().map(curve).collect() } else { Value::Null },
        })
    }

    /// The page.
    pub fn html(&self, page: &Page, campaign: &Campaign) -> String {
        let row = |tag: &str, row: &[String]| {
            let cells: Vec<_> = row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect();
            format!("<tr>{}</tr>\n", cells.concat())
        };
        let rows: String = self.steps.iter().map(|step| row("td", &step.row())).collect();
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<title>{name}: detection</title>\n\
             <style>{STYLE}</style>\n<h1>{name}: detection</h1>\n<p>{title}</p>\n<pre>{command}</pre>\n\
             <table>\n{header}{rows}</table>\n<p>{healthy}</p>\n{svg}\n\
             <p>{explained}</p>\n<h2>Scenario</h2>\n<pre>{scenario}</pre>\n</html>\n",
            name = escaped(page.name),
            title = escaped(&campaign.scenario.title),
            command = escaped(page.command),
            header = row("th", &HEADER.map(str::to_owned)),
            healthy = escaped(&self.healthy.text()),
            svg = page.svg.unwrap_or_default(),
            explained = escaped(EXPLAINED),
            scenario = escaped(&campaign.scenario.text),
        )
    }
}

/// What the columns say.
const EXPLAINED: &str = "Delays are from the onset to the first alarm, if it names the rotor; every other flight counts as later than all. \
     Missed: no alarm within 3 s. Wrong rotor: the first alarm names another, or all. Early: an alarm before the onset; such flights count nowhere \
     else. Second alarm: of what was not there, after the right one. Share error: median size of believed less true share 0.5 s after the onset. \
     In parentheses: intervals of 95 % (Wilson; Garwood for alarms an hour). In the picture the discs are at the threshold that flies.";
