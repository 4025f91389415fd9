//! Figures of one flight, or of the same flight under several controllers: SVG, and PNG made from it.
//!
//! The paper's figures 3 to 5 (trajectories, commands, gains), rotor thrusts, the Lyapunov function, and an overview.
//! Faults are shaded. A curve keeps the extremes of every bucket of points, so that chatter stays visible.
use crate::controllers::ControllerName;
use crate::log::Log;
use plotters::coord::Shift;
use plotters::prelude::*;
use resvg::{tiny_skia, usvg};
use std::error::Error;
use std::ops::Range;

pub mod limits;
mod panels;

use panels::Panel;
pub use panels::{FIGURES, Figure};

/// One curve in every panel.
pub struct Trace<'a> {
    /// Who flew.
    pub controller: ControllerName,
    /// Its log.
    pub log: &'a Log,
}

/// Colours that stay apart for colour-blind readers (Okabe and Ito).
fn colour(controller: ControllerName) -> RGBColor {
    match controller {
        ControllerName::Default => RGBColor(0, 0, 0),
        ControllerName::Oracle => RGBColor(120, 120, 120),
        ControllerName::Pid => RGBColor(213, 94, 0),
        ControllerName::Raw => RGBColor(0, 158, 115),
        ControllerName::Lgs => RGBColor(0, 114, 178),
        ControllerName::LgsIndi => RGBColor(110, 70, 170),
        ControllerName::Indi => RGBColor(230, 159, 0),
        ControllerName::Lqi => RGBColor(204, 121, 167),
        ControllerName::PidOpt => RGBColor(86, 180, 233),
    }
}

const FAULT: RGBColor = RGBColor(253, 224, 190);
/// Room around the fault windows in a close-up, s.
const CLOSE_UP_S: f64 = 5.0;
/// Buckets along a time axis, about one a pixel.
const BUCKETS: usize = 600;
/// Smallest span of a vertical axis: a flat line is drawn flat.
const SPAN_MIN: f64 = 1e-3;

/// The range of `values` with a margin; the spikes of a crash or a chatter beyond the inner 99.8 % are cut.
fn vertical_range(mut values: Vec<f64>) -> Range<f64> {
    values.retain(|x| x.is_finite());
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get(((values.len().max(1) - 1) as f64 * share) as usize).copied();
    let (low, high) = (at(0.001).unwrap_or(0.0), at(0.999).unwrap_or(1.0));
    let margin = (0.08 * (high - low)).max(SPAN_MIN);
    low - margin..high + margin
}

/// The lowest and the highest point of each bucket, in order of time.
fn extremes(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let bucket = points.len().div_ceil(BUCKETS).max(1);
    let mut kept = Vec::with_capacity(2 * BUCKETS);
    for bucket in points.chunks(bucket) {
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let (low, high) = (bucket.iter().min_by(by_height), bucket.iter().max_by(by_height));
        let mut pair: Vec<_> = low.into_iter().chain(high).copied().collect();
        pair.sort_by(|a, b| a.0.total_cmp(&b.0));
        pair.dedup();
        kept.extend(pair);
    }
    kept
}

/// A label without trailing zeros or a negative zero.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "the shape that plotters wants")]
fn plain(y: &f64) -> String {
    let text = format!("{y:.4}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

type Curve = (ControllerName, Vec<(f64, f64)>);

/// The values that set the scale: in a close-up those of the curves that last, so that a crash does not flatten the rest.
fn scaling(panel: &Panel, curves: &[Curve]) -> Vec<f64> {
    let end_s = |points: &[(f64, f64)]| points.last().map_or(0.0, |p| p.0);
    let longest_s = curves.iter().map(|(_, points)| end_s(points)).fold(0.0, f64::max);
    let lasting = curves.iter().filter(|(_, points)| !panel.close_up || end_s(points) >= longest_s);
    lasting.flat_map(|(_, points)| points.iter().map(|p| p.1)).collect()
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The part of the flight a panel shows, s.
fn time_range(panel: &Panel, traces: &[Trace], windows_s: &[(f64, f64)]) -> Range<f64> {
    let end_s = traces.iter().filter_map(|t| t.log.column("t_s").last().copied()).fold(0.0, f64::max);
    match (windows_s.first(), windows_s.last()) {
        // A flight that crashed before its fault has no close-up.
        (Some(first), Some(last)) if panel.close_up && first.0 < end_s => {
            (first.0 - CLOSE_UP_S).max(0.0)..(last.1 + CLOSE_UP_S).min(end_s)
        }
        _ => 0.0..end_s.max(SPAN_MIN),
    }
}

fn draw_panel(
    area: &Area,
    panel: &Panel,
    traces: &[Trace],
    windows_s: &[(f64, f64)],
    with_legend: bool,
) -> Result<(), Box<dyn Error>> {
    let time_s = time_range(panel, traces, windows_s);
    let points = |log: &Log, values: Vec<f64>| -> Vec<(f64, f64)> {
        let all = log.column("t_s").into_iter().zip(values);
        all.filter(|(t_s, _)| time_s.contains(t_s)).collect()
    };
    let curves: Vec<Curve> =
        traces.iter().map(|trace| (trace.controller, points(trace.log, (panel.of)(trace.log)))).collect();
    let reference = panel.reference.zip(traces.first()).map(|(name, trace)| points(trace.log, trace.log.column(name)));
    let mut values = scaling(panel, &curves);
    values.extend(reference.iter().flatten().map(|point| point.1));
    let range = vertical_range(values);

    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, ("sans-serif", 18))
        .margin(8)
        .x_label_area_size(30)
        .y_label_area_size(58)
        .build_cartesian_2d(time_s.clone(), range.clone())?;
    chart.draw_series(windows_s.iter().map(|&(from_s, until_s)| {
        let [left, right] = [from_s, until_s].map(|t_s| t_s.clamp(time_s.start, time_s.end));
        Rectangle::new([(left, range.start), (right, range.end)], FAULT.filled())
    }))?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .x_desc("time, s")
        .y_desc(panel.unit)
        .x_label_formatter(&|t_s| format!("{t_s:.0}"))
        .y_label_formatter(&plain)
        .label_style(("sans-serif", 13))
        .draw()?;
    if let Some(reference) = reference {
        chart.draw_series(DashedLineSeries::new(reference, 6, 4, BLACK.mix(0.6).into()))?;
    }
    for (controller, points) in &curves {
        let colour = colour(*controller);
        let visible = extremes(points).into_iter().map(|(t_s, y)| (t_s, y.clamp(range.start, range.end)));
        chart
            .draw_series(LineSeries::new(visible, colour.stroke_width(2)))?
            .label(controller.to_string())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(3)));
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

/// Draws a figure. Returns SVG.
pub fn svg(figure: &Figure, traces: &[Trace], windows_s: &[(f64, f64)]) -> Result<String, Box<dyn Error>> {
    const PANEL_HEIGHT: u32 = 320;
    const WIDTH: u32 = 1400;
    let rows = figure.panels.len().div_ceil(figure.columns);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH, PANEL_HEIGHT * rows as u32)).into_drawing_area();
        root.fill(&WHITE)?;
        for (i, (area, panel)) in root.split_evenly((rows, figure.columns)).iter().zip(figure.panels).enumerate() {
            draw_panel(area, panel, traces, windows_s, i == 0)?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// Rasterises an SVG with a font of its own, so that a machine without fonts draws the same.
pub fn png(svg: &str) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut options = usvg::Options::default();
    let fonts = options.fontdb_mut();
    fonts.load_font_data(epaint_default_fonts::UBUNTU_LIGHT.to_vec());
    let family = fonts.faces().next().and_then(|face| face.families.first()).map(|family| family.0.clone());
    if let Some(family) = family {
        fonts.set_sans_serif_family(family);
    }
    let tree = usvg::Tree::from_str(svg, &options)?;
    let size = tree.size().to_int_size();
    let mut image = tiny_skia::Pixmap::new(size.width(), size.height()).ok_or("the picture has no size")?;
    resvg::render(&tree, tiny_skia::Transform::default(), &mut image.as_mut());
    Ok(image.encode_png()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crash_does_not_flatten_the_close_up_of_who_survived() {
        let curves = [
            (ControllerName::Raw, vec![(35.0, 0.0), (36.0, 100.0)]),
            (ControllerName::Lgs, vec![(35.0, 0.0), (36.0, 1.0), (55.0, 0.0)]),
        ];
        let close_up = FIGURES.iter().flat_map(|figure| figure.panels).find(|panel| panel.close_up).expect("one");
        let whole = FIGURES.iter().flat_map(|figure| figure.panels).find(|panel| !panel.close_up).expect("one");
        assert_eq!(scaling(close_up, &curves), [0.0, 1.0, 0.0]);
        assert_eq!(scaling(whole, &curves).len(), 5);
        assert_eq!(scaling(close_up, &curves[..1]), [0.0, 100.0], "alone, a crash is drawn whole");
    }

    #[test]
    fn a_spike_survives_decimation() {
        let mut points: Vec<_> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
        points[54_321].1 = 9.0;
        let kept = extremes(&points);
        assert!(kept.len() <= 2 * BUCKETS);
        assert!(kept.contains(&(54_321.0, 9.0)));
        assert!(kept.is_sorted_by(|a, b| a.0 <= b.0));
    }
}
