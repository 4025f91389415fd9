//! The faults that were flown beside what physics allows: a bar for each, with the outcome of every controller below.
use super::colour;
use crate::controllers::ControllerName;
use crate::fault::{Fault, FaultKind, in_words};
use crate::limits::{Heading, Hover, loss_max, stuck_n};
use crate::plant::PlantKind;
use crate::scenario::Scenario;
use crate::vehicle::Vehicle;
use plotters::prelude::*;
use std::error::Error;

/// How a controller fared, in words.
pub struct Outcome {
    /// Who flew.
    pub controller: ControllerName,
    /// In one line.
    pub text: String,
}

/// An axis from 0 to 1, the parts of it where a hover exists, and where on it the fault is.
struct Bar {
    title: String,
    /// Each from the end of the one before it to the share given.
    parts: Vec<(f64, Hover)>,
    mark: f64,
}

const WIDTH: i32 = 1400;
const LEFT: i32 = 60;
const RIGHT: i32 = 1340;
const TOP: i32 = 100;
const BAR_HEIGHT: i32 = 40;
const BAR_PITCH: i32 = 130;
const LINE_PITCH: i32 = 28;
/// A part too narrow to be seen is drawn this wide, px.
const NARROW: i32 = 5;
const fn shade(hover: Hover) -> RGBColor {
    match hover {
        Hover::WithHeading => RGBColor(170, 215, 190),
        Hover::WithoutHeading => RGBColor(250, 226, 150),
        Hover::Nowhere => RGBColor(240, 178, 150),
    }
}

const fn name(hover: Hover) -> &'static str {
    match hover {
        Hover::WithHeading => "hover with heading",
        Hover::WithoutHeading => "hover without heading",
        Hover::Nowhere => "no hover: only a spin, if anything",
    }
}

/// The bar of one fault; none for faults that take no thrust.
fn bar(vehicle: &Vehicle, fault: &Fault) -> Option<Bar> {
    let most_n = vehicle.thrust_n_max();
    let stuck = |at_n: f64| {
        let index = fault.rotors.indices().next().filter(|_| fault.rotors.count() == 1)?;
        let share =
            |heading| stuck_n(vehicle, index, heading).map_or((0.0, 0.0), |(low, high)| (low / most_n, high / most_n));
        let (held, given_up) = (share(Heading::Held), share(Heading::GivenUp));
        Some(Bar {
            title: format!("Thrust at which {} is stuck, share of its largest", in_words(fault.rotors)),
            parts: vec![
                (given_up.0, Hover::Nowhere),
                (held.0, Hover::WithoutHeading),
                (held.1, Hover::WithHeading),
                (given_up.1, Hover::WithoutHeading),
                (1.0, Hover::Nowhere),
            ],
            mark: at_n / most_n,
        })
    };
    match fault.kind {
        FaultKind::Stuck { thrust_n } => stuck(thrust_n.unwrap_or(most_n / vehicle.thrust_to_weight)),
        FaultKind::HardOver => stuck(most_n),
        kind => {
            let limit = |heading| loss_max(vehicle, fault.rotors, heading).unwrap_or(0.0);
            Some(Bar {
                title: format!("Loss of thrust on {}", in_words(fault.rotors)),
                parts: vec![
                    (limit(Heading::Held), Hover::WithHeading),
                    (limit(Heading::GivenUp), Hover::WithoutHeading),
                    (1.0, Hover::Nowhere),
                ],
                mark: kind.loss()?,
            })
        }
    }
}

/// The bars of a scenario, each once.
fn bars(scenario: &Scenario) -> Vec<Bar> {
    if scenario.plant == PlantKind::Paper {
        return Vec::new();
    }
    let vehicle = scenario.vehicle();
    let mut bars: Vec<Bar> = Vec::new();
    for bar in scenario.fault.iter().filter_map(|fault| bar(&vehicle, fault)) {
        if !bars.iter().any(|drawn| drawn.title == bar.title && drawn.mark == bar.mark) {
            bars.push(bar);
        }
    }
    bars
}

/// Where a share stands, px.
fn at(share: f64) -> i32 {
    LEFT + (share.clamp(0.0, 1.0) * f64::from(RIGHT - LEFT)).round() as i32
}

/// Draws the faults of a scenario beside its limits, and the outcomes. Returns SVG; none if no fault has such a limit.
pub fn svg(scenario: &Scenario, outcomes: &[Outcome]) -> Result<Option<String>, Box<dyn Error>> {
    let bars = bars(scenario);
    if bars.is_empty() {
        return Ok(None);
    }
    let below = bars.iter().fold(TOP, |y, _| y + BAR_PITCH);
    let height = outcomes.iter().fold(below + LINE_PITCH, |y, _| y + LINE_PITCH);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH as u32, height as u32)).into_drawing_area();
        root.fill(&WHITE)?;
        let ratio = scenario.vehicle.thrust_to_weight;
        let head =
            format!("What a hover survives at a thrust-to-weight ratio of {ratio}, by statics, and what was flown");
        root.draw(&Text::new(head, (LEFT, 22), ("sans-serif", 22)))?;
        let parts = [Hover::WithHeading, Hover::WithoutHeading, Hover::Nowhere];
        for (hover, left) in parts.into_iter().zip([LEFT, LEFT + 210, LEFT + 440]) {
            root.draw(&Rectangle::new([(left, 58), (left + 28, 72)], shade(hover).filled()))?;
            root.draw(&Text::new(name(hover), (left + 38, 58), ("sans-serif", 16)))?;
        }
        for (row, bar) in (0..).zip(&bars) {
            draw_bar(&root, bar, TOP + BAR_PITCH * row)?;
        }
        for (line, outcome) in (0..).zip(outcomes) {
            let y = below + LINE_PITCH * line;
            let colour = colour(outcome.controller);
            root.draw(&Rectangle::new([(LEFT, y), (LEFT + 18, y + 12)], colour.filled()))?;
            root.draw(&Text::new(outcome.controller.to_string(), (LEFT + 30, y - 2), ("sans-serif", 18)))?;
            root.draw(&Text::new(outcome.text.clone(), (LEFT + 130, y - 2), ("sans-serif", 18)))?;
        }
        root.present()?;
    }
    Ok(Some(svg))
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw_bar(root: &Area, bar: &Bar, top: i32) -> Result<(), Box<dyn Error>> {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    let centred =
        |size: i32, vertical| ("sans-serif", size).into_text_style(root).pos(Pos::new(HPos::Center, vertical));
    let (upper, lower) = (top + 30, top + 30 + BAR_HEIGHT);
    root.draw(&Text::new(bar.title.clone(), (LEFT, top), ("sans-serif", 18)))?;
    let mut from = 0.0;
    for &(until, hover) in &bar.parts {
        let (left, mut right) = (at(from), at(until));
        if hover == Hover::WithHeading {
            right = right.max(left + NARROW);
        }
        if right > left {
            root.draw(&Rectangle::new([(left, upper), (right, lower)], shade(hover).filled()))?;
        }
        from = until.max(from);
    }
    // A part that the next has painted over.
    if let Some(&(until, hover)) = bar.parts.iter().find(|(_, hover)| *hover == Hover::WithHeading) {
        let right = at(until);
        root.draw(&Rectangle::new([(right - NARROW, upper), (right, lower)], shade(hover).filled()))?;
    }
    for tenth in (0..=10).step_by(2) {
        let (x, share) = (at(f64::from(tenth) / 10.0), 10 * tenth);
        root.draw(&PathElement::new([(x, lower), (x, lower + 6)], BLACK.mix(0.5)))?;
        root.draw(&Text::new(format!("{share} %"), (x, lower + 10), centred(14, VPos::Top)))?;
    }
    let x = at(bar.mark);
    root.draw(&PathElement::new([(x, upper - 8), (x, lower + 8)], BLACK.stroke_width(4)))?;
    let label = format!("flown: {:.0} %", 100.0 * bar.mark);
    let aside = x.clamp(LEFT + 50, RIGHT - 50);
    root.draw(&Text::new(label, (aside, upper - 11), centred(16, VPos::Bottom)))?;
    Ok(())
}
