//! The report as one file that opens offline.
use super::Comparison;
use crate::metrics::METRICS;

pub(crate) const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:1400px;margin:2rem auto;padding:0 1rem;color:#222}\
table{border-collapse:collapse}td,th{padding:.2rem .9rem;border-bottom:1px solid #ddd;text-align:right}\
td:first-child,th:first-child{text-align:left;font-family:ui-monospace,monospace}\
pre{background:#f5f5f3;padding:1rem;overflow-x:auto}svg{width:100%;height:auto}";

/// Text as HTML shows it.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// What the report is made of besides the comparison.
pub struct Page<'a> {
    /// The command that makes it again.
    pub command: &'a str,
    /// What each figure shows, and its SVG.
    pub figures: &'a [(&'static str, String)],
}

/// A table; every cell is text.
pub(super) fn table(header: &[String], rows: &[Vec<String>]) -> String {
    let cells = |tag: &str, row: &[String]| -> String {
        let cells: Vec<_> = row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect();
        format!("<tr>{}</tr>\n", cells.concat())
    };
    let rows: String = rows.iter().map(|row| cells("td", row)).collect();
    format!("<table>\n{}{rows}</table>\n", cells("th", header))
}

/// A page that opens offline, around `body`, which is HTML.
pub(super) fn whole(name: &str, body: &str) -> String {
    let name = escaped(name);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<title>{name}</title>\n<style>{STYLE}</style>\n\
         <h1>{name}</h1>\n{body}</html>\n"
    )
}

impl Comparison<'_> {
    /// The report: table, findings, figures, conditions, and the scenario and command that reproduce it.
    pub fn html(&self, page: &Page) -> String {
        let items = |lines: Vec<String>| -> String {
            lines.iter().map(|line| format!("<li>{}</li>\n", escaped(line))).collect::<Vec<_>>().concat()
        };
        let section = |(title, svg): &(&str, String)| format!("<h2>{}</h2>\n{svg}\n", escaped(title));
        let figures = page.figures.iter().map(section).collect::<Vec<_>>().concat();
        let metrics = METRICS.iter().map(|metric| format!("{}: {}", metric.name, metric.title)).collect();
        let body = format!(
            "<p>{title}</p>\n<pre>{command}</pre>\n{table}<ul>\n{findings}</ul>\n\
             <p>Figures are of seed {seed}; faults are shaded; spikes beyond the inner 99.8 % are cut.</p>\n{figures}\
             <h2>What the metrics say</h2>\n<ul>\n{metrics}</ul>\n\
             <p>Median and worst are over the flights that flew to their end. The true state is measured, at the control rate; \
             thrusts are the commanded ones. Conditions, gains and every number: results.json.</p>\n\
             <h2>Scenario</h2>\n<pre>{scenario}</pre>\n",
            title = escaped(&self.scenario.title),
            command = escaped(page.command),
            table = table(&self.header(), &self.rows()),
            findings = items(self.findings()),
            seed = self.seed,
            metrics = items(metrics),
            scenario = escaped(&self.scenario.text),
        );
        whole(&self.name, &body)
    }
}
