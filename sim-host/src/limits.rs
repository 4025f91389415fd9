//! How much thrust a hover can lose, by linear program over the true allocation.
//!
//! ```text
//! maximise λ     subject to     Σ F_i = m g,   roll = pitch = 0,   yaw = 0 or left free
//!                               0 ≤ F_i ≤ (1 − λ) F_max on the failing rotors,   0 ≤ F_i ≤ F_max on the others
//! ```
//!
//! This is statics: the thrusts exist. Whether a controller finds them in time is what flights are for. A machine
//! that gives heading up and spins can fly beyond it.
use crate::fault::Rotors;
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use microlp::{ComparisonOp, OptimizationDirection, Problem, SolveOutcome};

/// What must still balance besides weight, roll and pitch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heading {
    /// Yaw torque is zero.
    Held,
    /// Yaw torque is whatever comes.
    GivenUp,
}

/// Largest share of thrust that every rotor of `failing` may lose in a hover; none if it cannot hover at all.
pub fn loss_max(vehicle: &Vehicle, failing: Rotors, heading: Heading) -> Option<f64> {
    let mut problem = Problem::new(OptimizationDirection::Maximize);
    let loss = problem.add_var(1.0, (0.0, 1.0));
    let thrust_n_max = vehicle.thrust_n_max();
    let thrusts: Vec<_> = (0..4).map(|_| problem.add_var(0.0, (0.0, thrust_n_max))).collect();
    for rotor in failing.indices() {
        let thrust = *thrusts.get(rotor)?;
        problem.add_constraint([(thrust, 1.0), (loss, thrust_n_max)], ComparisonOp::Le, thrust_n_max);
    }
    let mut balance = |of: &dyn Fn(usize) -> f64, total: f64| {
        let terms: Vec<_> = thrusts.iter().enumerate().map(|(i, &thrust)| (thrust, of(i))).collect();
        problem.add_constraint(terms, ComparisonOp::Eq, total);
    };
    balance(&|_| 1.0, vehicle.mass_kg * f64::from(GRAVITY_M_S2));
    // Torques of a thrust of 1 N on each rotor.
    let unit = |i: usize| vehicle.torque_n_m(&std::array::from_fn(|j| f64::from(u8::from(i == j))));
    balance(&|i| unit(i).x, 0.0);
    balance(&|i| unit(i).y, 0.0);
    if heading == Heading::Held {
        balance(&|i| unit(i).z, 0.0);
    }
    match problem.solve() {
        Ok(SolveOutcome::Solution(solution)) => Some(solution.var_value(loss)),
        // No time limit is set, so an interruption has the same cause as an error: no such thrusts.
        Ok(SolveOutcome::Interrupted(_)) | Err(_) => None,
    }
}

const ONE: Rotors = Rotors::new([true, false, false, false]);
const FACING: Rotors = Rotors::new([true, false, true, false]);
const NEIGHBOURS: Rotors = Rotors::new([true, true, false, false]);

/// What is asked of an airframe: a name for people, the failing rotors, and what of heading.
pub const CASES: [(&str, Rotors, Heading); 7] = [
    ("all rotors", Rotors::ALL, Heading::Held),
    ("one rotor, heading held", ONE, Heading::Held),
    ("one rotor, heading given up", ONE, Heading::GivenUp),
    ("facing pair, heading held", FACING, Heading::Held),
    ("facing pair, heading given up", FACING, Heading::GivenUp),
    ("neighbours, heading held", NEIGHBOURS, Heading::Held),
    ("neighbours, heading given up", NEIGHBOURS, Heading::GivenUp),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::{AirframeName, Frame, VehicleKeys};

    fn loss(thrust_to_weight: f64, frame: Frame, failing: Rotors, heading: Heading) -> Option<f64> {
        let keys = VehicleKeys { thrust_to_weight, frame, ..VehicleKeys::default() };
        loss_max(&Vehicle::new(AirframeName::Paper, &keys), failing, heading)
    }

    #[test]
    fn limits_are_those_of_the_closed_forms() {
        for r in [1.2_f64, 1.8, 2.2, 3.0] {
            for frame in [Frame::Plus, Frame::X] {
                for (why, failing, heading, want) in [
                    ("all", Rotors::ALL, Heading::Held, 1.0 - 1.0 / r),
                    ("one, heading held", Rotors::new([false, true, false, false]), Heading::Held, 1.0 - 1.0 / r),
                    (
                        "one, heading given up",
                        Rotors::new([false, false, true, false]),
                        Heading::GivenUp,
                        (2.0 - 2.0 / r).min(1.0),
                    ),
                    ("a facing pair shares what one would carry", FACING, Heading::Held, 1.0 - 1.0 / r),
                ] {
                    let found = loss(r, frame, failing, heading).expect("it hovers");
                    assert!((found - want).abs() < 1e-9, "{why} at {r}: {found}, not {want}");
                }
            }
        }
    }

    #[test]
    fn too_heavy_to_hover_has_no_limit() {
        assert_eq!(loss(0.9, Frame::Plus, ONE, Heading::GivenUp), None);
    }
}
