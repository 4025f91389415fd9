//! Figures of one flight, or of the same flight under several controllers: SVG, and PNG made from it.
use crate::controllers::ControllerName;
use crate::log::Log;
use plotters::coord::Shift;
use plotters::prelude::*;
use resvg::{tiny_skia, usvg};
use std::error::Error;
use std::ops::Range;

/// One curve of a figure.
pub struct Trace<'a> {
    /// Who flew.
    pub controller: ControllerName,
    /// Its log.
    pub log: &'a Log,
}

/// Colours that stay apart for colour-blind readers (Okabe and Ito).
fn colour(controller: ControllerName) -> RGBColor {
    match controller {
        ControllerName::Pid => RGBColor(213, 94, 0),
        ControllerName::Raw => RGBColor(0, 158, 115),
        ControllerName::Lgs => RGBColor(0, 114, 178),
        ControllerName::LgsIndi => RGBColor(0, 0, 0),
        ControllerName::Indi => RGBColor(230, 159, 0),
        ControllerName::Lqi => RGBColor(204, 121, 167),
        ControllerName::PidOpt => RGBColor(86, 180, 233),
    }
}

const SIZE: (u32, u32) = (1400, 1050);
const FAULT: RGBColor = RGBColor(253, 224, 190);
/// Room around the fault windows in the close-up, s.
const CLOSE_UP_S: f64 = 5.0;

/// What a panel shows.
struct Panel {
    title: &'static str,
    unit: &'static str,
    /// Whether only the time around the faults is shown.
    close_up: bool,
    /// The setpoint's column, drawn dashed.
    setpoint: Option<&'static str>,
    of: fn(&Log) -> Vec<f64>,
}

fn difference(log: &Log, a: &str, b: &str) -> Vec<f64> {
    log.column(a).into_iter().zip(log.column(b)).map(|(a, b)| a - b).collect()
}

fn worse_lateral(log: &Log) -> Vec<f64> {
    let north = difference(log, "north_m", "setpoint_north_m");
    let east = difference(log, "east_m", "setpoint_east_m");
    north.into_iter().zip(east).map(|(north, east)| if north.abs() > east.abs() { north } else { east }).collect()
}

fn total_command(log: &Log) -> Vec<f64> {
    let rotors = ["command_1_n", "command_2_n", "command_3_n", "command_4_n"].map(|name| log.column(name));
    (0..rotors[0].len()).map(|i| rotors.iter().map(|rotor| rotor[i]).sum()).collect()
}

fn learnt(log: &Log) -> Vec<f64> {
    let gain = log.column("ki_z");
    let start = gain.first().copied().unwrap_or(1.0);
    gain.into_iter().map(|k| k / start).collect()
}

const PANELS: [Panel; 6] = [
    Panel {
        title: "Altitude",
        unit: "m",
        close_up: false,
        setpoint: Some("setpoint_altitude_m"),
        of: |log| log.column("altitude_m"),
    },
    Panel {
        title: "Altitude error around the fault",
        unit: "m",
        close_up: true,
        setpoint: None,
        of: |log| difference(log, "altitude_m", "setpoint_altitude_m"),
    },
    Panel {
        title: "Worse of north and east error around the fault",
        unit: "m",
        close_up: true,
        setpoint: None,
        of: worse_lateral,
    },
    Panel {
        title: "Heading error around the fault",
        unit: "rad",
        close_up: true,
        setpoint: None,
        of: |log| log.column("yaw_error_rad"),
    },
    Panel { title: "Commanded thrust, sum of rotors", unit: "N", close_up: false, setpoint: None, of: total_command },
    Panel { title: "Integral gain of altitude over its start", unit: "", close_up: false, setpoint: None, of: learnt },
];

/// Smallest span of a vertical axis: a flat line is drawn flat.
const SPAN_MIN: f64 = 1e-3;

/// The range of `values` with a margin; the spikes of a crash or a chatter beyond the inner 99.8 % are cut.
fn vertical_range(values: &mut Vec<f64>) -> Range<f64> {
    values.retain(|x| x.is_finite());
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get(((values.len().max(1) - 1) as f64 * share) as usize).copied();
    let (low, high) = (at(0.001).unwrap_or(0.0), at(0.999).unwrap_or(1.0));
    let margin = (0.08 * (high - low)).max(SPAN_MIN);
    low - margin..high + margin
}

/// A label without trailing zeros or a negative zero.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "the shape that plotters wants")]
fn plain(y: &f64) -> String {
    let text = format!("{y:.4}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn draw_panel(area: &Area, panel: &Panel, traces: &[Trace], windows_s: &[(f64, f64)]) -> Result<(), Box<dyn Error>> {
    let end_s = traces.iter().filter_map(|t| t.log.column("t_s").last().copied()).fold(0.0, f64::max);
    let time_s = match (windows_s.first(), windows_s.last()) {
        // A flight that crashed before its fault has no close-up.
        (Some(first), Some(last)) if panel.close_up && first.0 < end_s => {
            (first.0 - CLOSE_UP_S).max(0.0)..(last.1 + CLOSE_UP_S).min(end_s)
        }
        _ => 0.0..end_s.max(SPAN_MIN),
    };
    let curves: Vec<(ControllerName, Vec<(f64, f64)>)> = traces
        .iter()
        .map(|trace| {
            let points = trace.log.column("t_s").into_iter().zip((panel.of)(trace.log));
            (trace.controller, points.filter(|(t_s, _)| time_s.contains(t_s)).collect())
        })
        .collect();
    let mut heights: Vec<f64> = curves.iter().flat_map(|(_, points)| points.iter().map(|p| p.1)).collect();
    let range = vertical_range(&mut heights);

    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, ("sans-serif", 19))
        .margin(8)
        .x_label_area_size(32)
        .y_label_area_size(64)
        .build_cartesian_2d(time_s.clone(), range.clone())?;
    let shade = windows_s.iter().map(|&(from_s, until_s)| {
        let corners = [
            (from_s.clamp(time_s.start, time_s.end), range.start),
            (until_s.clamp(time_s.start, time_s.end), range.end),
        ];
        Rectangle::new(corners, FAULT.filled())
    });
    chart.draw_series(shade)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .x_desc("time, s")
        .y_desc(panel.unit)
        .x_label_formatter(&|t_s| format!("{t_s:.0}"))
        .y_label_formatter(&plain)
        .label_style(("sans-serif", 14))
        .draw()?;
    if let (Some(name), Some(trace)) = (panel.setpoint, traces.first()) {
        let points: Vec<_> = trace.log.column("t_s").into_iter().zip(trace.log.column(name)).collect();
        chart.draw_series(DashedLineSeries::new(points, 6, 4, BLACK.mix(0.6).into()))?;
    }
    for (controller, points) in curves {
        let colour = colour(controller);
        let visible = points.into_iter().map(|(t_s, y)| (t_s, y.clamp(range.start, range.end)));
        chart
            .draw_series(LineSeries::new(visible, colour.stroke_width(2)))?
            .label(controller.to_string())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(3)));
    }
    if panel.setpoint.is_some() {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.3))
            .label_font(("sans-serif", 15))
            .draw()?;
    }
    Ok(())
}

/// Draws six panels of the same flight under each controller; faults are shaded. Returns SVG.
pub fn comparison_svg(title: &str, traces: &[Trace], windows_s: &[(f64, f64)]) -> Result<String, Box<dyn Error>> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let body = root.titled(title, ("sans-serif", 20))?;
        for (area, panel) in body.split_evenly((3, 2)).iter().zip(&PANELS) {
            draw_panel(area, panel, traces, windows_s)?;
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
