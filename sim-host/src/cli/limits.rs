//! `sim-host limits`: what physics allows, by linear program.
use super::{Failure, say};
use crate::fault::Rotors;
use crate::limits::{CASES, Heading, STUCK_CASES, loss_max, stuck_n};
use crate::scenario::THRUST_TO_WEIGHT;
use crate::vehicle::{AirframeName, Vehicle, VehicleKeys};
use clap::Args;

#[derive(Args)]
pub(super) struct LimitsArgs {
    /// The machine.
    #[arg(value_enum)]
    airframe: AirframeName,
    /// Largest total thrust over weight.
    #[arg(long, default_value_t = VehicleKeys::default().thrust_to_weight)]
    thrust_to_weight: f64,
}

/// Opens the second part of what is printed.
const STUCK_HEAD: &str = "Thrusts at which one rotor may be stuck in a hover, and their shares of its largest:";

pub(super) fn limits(args: &LimitsArgs) -> Result<(), Failure> {
    let thrust_to_weight = args.thrust_to_weight;
    if !(THRUST_TO_WEIGHT.0..=THRUST_TO_WEIGHT.1).contains(&thrust_to_weight) {
        let (low, high) = THRUST_TO_WEIGHT;
        return Err(Failure::bad_input(format!(
            "--thrust-to-weight = {thrust_to_weight}: must be from {low} to {high}"
        )));
    }
    let keys = VehicleKeys { thrust_to_weight, ..VehicleKeys::default() };
    let vehicle = Vehicle::new(args.airframe, &keys);
    let line = |(name, failing, heading): (&str, Rotors, Heading)| {
        let limit = loss_max(&vehicle, failing, heading);
        format!("{name:<30} {}", limit.map_or("cannot hover".to_owned(), |loss| format!("{:5.1} %", 100.0 * loss)))
    };
    let head = format!("Largest loss of thrust in a hover, thrust-to-weight {thrust_to_weight}:");
    let stuck = |(name, heading): (&str, Heading)| {
        let at = |thrust_n: f64| format!("{thrust_n:5.2} N ({:5.1} %)", 100.0 * thrust_n / vehicle.thrust_n_max());
        let span = stuck_n(&vehicle, 0, heading).map(|(low, high)| format!("from {} to {}", at(low), at(high)));
        format!("{name:<30} {}", span.unwrap_or("cannot hover".to_owned()))
    };
    let lines =
        [vec![head], CASES.map(line).into(), vec![STUCK_HEAD.to_owned()], STUCK_CASES.map(stuck).into()].concat();
    say(&(lines.join("\n") + "\n"))
}
