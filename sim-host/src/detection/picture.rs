//! The ROC as a picture: how many losses are found in time, against how often nothing is found.
use super::roc::{IN_TIME_S, Point, Roc};
use plotters::coord::Shift;
use plotters::prelude::*;
use std::error::Error;
use std::ops::Range;

/// Name of the picture's files.
pub const PICTURE: &str = "roc";

/// Colours that stay apart for colour-blind readers (Okabe and Ito), from the smallest loss to the largest.
const COLOURS: [RGBColor; 6] = [
    RGBColor(213, 94, 0),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(86, 180, 233),
    RGBColor(0, 114, 178),
    RGBColor(0, 0, 0),
];

/// False alarms an hour, for a logarithmic axis: none seen is drawn as half of one.
fn an_hour(point: &Point, hours: f64) -> f64 {
    (point.false_alarms as f64).max(0.5) / hours
}

/// Draws the curves of one time limit.
fn draw_panel(
    area: &DrawingArea<SVGBackend, Shift>,
    roc: &Roc,
    in_time_s: f64,
    with_legend: bool,
) -> Result<(), Box<dyn Error>> {
    let curves: Vec<_> = roc.losses().map(|loss| (loss, roc.curve(loss, in_time_s))).collect();
    let all = curves.iter().flat_map(|(_, curve)| curve).map(|point| an_hour(point, roc.hours));
    let most = all.fold(1.0, f64::max);
    let range: Range<f64> = 0.4 / roc.hours..1.3 * most;
    let mut chart = ChartBuilder::on(area)
        .caption(format!("found, and named right, within {:.0} ms", 1000.0 * in_time_s), ("sans-serif", 18))
        .margin(8)
        .x_label_area_size(36)
        .y_label_area_size(48)
        .build_cartesian_2d(range.log_scale(), -0.02..1.02)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .x_desc("false alarms an hour; leftmost: none seen")
        .y_desc("share of the flights")
        .x_label_formatter(&|x| format!("{x}"))
        .y_label_formatter(&|y| format!("{y:.1}"))
        .label_style(("sans-serif", 13))
        .draw()?;
    for ((loss, curve), colour) in curves.iter().zip(COLOURS.into_iter().cycle()) {
        let at = |point: &Point| (an_hour(point, roc.hours), point.detected);
        chart
            .draw_series(LineSeries::new(curve.iter().map(at), colour.stroke_width(2)))?
            .label(format!("{:.0} % lost", 100.0 * loss))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(3)));
        chart.draw_series(roc.flying(curve).iter().map(|point| Circle::new(at(point), 5, colour.filled())))?;
    }
    if with_legend {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.3))
            .label_font(("sans-serif", 14))
            .draw()?;
    }
    Ok(())
}

/// Draws the ROC. Returns SVG.
pub fn svg(roc: &Roc) -> Result<String, Box<dyn Error>> {
    const SIZE: (u32, u32) = (1200, 440);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        for (i, (area, in_time_s)) in root.split_evenly((1, IN_TIME_S.len())).iter().zip(IN_TIME_S).enumerate() {
            draw_panel(area, roc, in_time_s, i + 1 == IN_TIME_S.len())?;
        }
        root.present()?;
    }
    Ok(svg)
}
