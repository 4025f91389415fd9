//! What a hover survives, by linear program over the true allocation.
//!
//! ```text
//! which F_i     subject to     Σ F_i = m g,   roll = pitch = 0,   yaw = 0 or left free,   low_i ≤ F_i ≤ high_i
//! ```
//!
//! Faults set the limits: a rotor that lost λ has high = (1 − λ) F_max, one that is stuck has low = high, one that turns
//! backwards has low < 0. Delays, slow motors and drop-outs leave them as they are.
//!
//! This is statics: the thrusts exist. Whether a controller finds them in time is what flights are for, and whether anything
//! can turn the machine back is [`torque_nm`]. A machine that gives heading up and spins can fly beyond it.
use crate::fault::{Fault, FaultKind, Rotors};
use crate::plant::PlantKind;
use crate::scenario::Scenario;
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use microlp::{ComparisonOp, OptimizationDirection, Problem, SolveOutcome, Variable};
use std::array::from_fn;
use std::fmt;

/// What must still balance besides weight, roll and pitch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heading {
    /// Yaw torque is zero.
    Held,
    /// Yaw torque is whatever comes.
    GivenUp,
}

/// What hover there is, the best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Hover {
    /// Heading included.
    WithHeading,
    /// With a yaw torque that nothing balances.
    WithoutHeading,
    /// None: only a machine that spins flies on, if any.
    Nowhere,
}

impl fmt::Display for Hover {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::WithHeading => "with heading",
            Self::WithoutHeading => "heading given up",
            Self::Nowhere => "no hover",
        })
    }
}

/// Least and most thrust that each rotor makes, N.
pub type Thrusts = [(f64, f64); 4];

/// Room that a rotor of fixed thrust is given, N: far below what its noise is, far above rounding.
const SLACK_N: f64 = 1e-6;

/// Weight, N.
fn weight_n(vehicle: &Vehicle) -> f64 {
    vehicle.mass_kg * f64::from(GRAVITY_M_S2)
}

/// What the rotors can make in a hover under all of `faults` at their worst.
///
/// A rotor that is stuck where it is has its quarter of the weight; a battery sags as it does under the weight.
pub fn thrusts_under(vehicle: &Vehicle, faults: &[&Fault]) -> Thrusts {
    let most_n = vehicle.thrust_n_max();
    from_fn(|i| {
        let (mut driven, mut share) = ((0.0, most_n), 1.0);
        for fault in faults.iter().filter(|fault| fault.rotors.has(i)) {
            match fault.kind {
                FaultKind::LossOfEffectiveness { loss } | FaultKind::PropellerDamage { loss, .. } => {
                    share *= 1.0 - loss;
                }
                FaultKind::BatterySag { sag } => {
                    let voltage = 1.0 - sag / vehicle.thrust_to_weight;
                    share *= voltage * voltage;
                }
                FaultKind::Stopped | FaultKind::Floating { .. } => driven = (0.0, 0.0),
                FaultKind::Stuck { thrust_n } => {
                    let stuck_n = thrust_n.unwrap_or(weight_n(vehicle) / 4.0);
                    driven = (stuck_n, stuck_n);
                }
                FaultKind::HardOver => driven = (most_n, most_n),
                FaultKind::Reversed { share: backwards } => driven = (-backwards * most_n, 0.0),
                FaultKind::SlowMotor { .. }
                | FaultKind::CommandDelay { .. }
                | FaultKind::CommandJitter { .. }
                | FaultKind::EscDesync { .. }
                | FaultKind::Swapped => {}
            }
        }
        (share * driven.0, share * driven.1)
    })
}

/// What hover there is within `thrusts`.
pub fn hover(vehicle: &Vehicle, thrusts: &Thrusts) -> Hover {
    let thrusts = thrusts.map(|(low, high)| if low < high { (low, high) } else { (low - SLACK_N, high + SLACK_N) });
    let exists = |heading| most(vehicle, &thrusts, &balanced(vehicle, heading), [0.0; 4]).is_some();
    match () {
        () if exists(Heading::Held) => Hover::WithHeading,
        () if exists(Heading::GivenUp) => Hover::WithoutHeading,
        () => Hover::Nowhere,
    }
}

/// The faults that are there at `at_s`.
pub fn together(faults: &[Fault], at_s: f64) -> Vec<&Fault> {
    faults.iter().filter(|fault| fault.is_active(at_s)).collect()
}

/// The worst hover of a scenario: of each onset with all faults that are there then. None with the plant `paper`,
/// whose rotors have no limit, and without faults.
pub fn worst_hover(scenario: &Scenario) -> Option<Hover> {
    if scenario.plant == PlantKind::Paper {
        return None;
    }
    let vehicle = scenario.vehicle();
    let at = |onset: &Fault| hover(&vehicle, &thrusts_under(&vehicle, &together(&scenario.fault, onset.from_s)));
    scenario.fault.iter().map(at).max()
}

/// Largest share of thrust that every rotor of `failing` may lose in a hover; none if it cannot hover at all.
pub fn loss_max(vehicle: &Vehicle, failing: Rotors, heading: Heading) -> Option<f64> {
    let mut problem = Problem::new(OptimizationDirection::Maximize);
    let loss = problem.add_var(1.0, (0.0, 1.0));
    let most_n = vehicle.thrust_n_max();
    let thrusts = from_fn(|_| problem.add_var(0.0, (0.0, most_n)));
    for rotor in failing.indices() {
        problem.add_constraint([(*thrusts.get(rotor)?, 1.0), (loss, most_n)], ComparisonOp::Le, most_n);
    }
    carry(&mut problem, vehicle, &thrusts, &balanced(vehicle, heading));
    Some(solved(&problem)?.var_value(loss))
}

/// Least and most thrust, N, at which rotor `index + 1` may be stuck in a hover; none if it cannot hover at all.
pub fn stuck_n(vehicle: &Vehicle, index: usize, heading: Heading) -> Option<(f64, f64)> {
    let healthy = [(0.0, vehicle.thrust_n_max()); 4];
    let only = from_fn(|i| f64::from(u8::from(i == index)));
    span(vehicle, &healthy, &balanced(vehicle, heading), only)
}

/// Least and most torque about an arm, N m, while the rotors carry the weight within `thrusts`; none if they cannot.
///
/// - `arm`: the arm of rotor `arm + 1`. The other arm's torque is balanced, that of yaw is free.
pub fn torque_nm(vehicle: &Vehicle, thrusts: &Thrusts, arm: usize) -> Option<(f64, f64)> {
    span(vehicle, thrusts, &[about(vehicle, (arm + 1) % 4)], about(vehicle, arm))
}

/// Torque about the arm of rotor `arm + 1` per thrust of each rotor, m.
fn about(vehicle: &Vehicle, arm: usize) -> [f64; 4] {
    let [forward, right] = vehicle.arms_m[arm].map(|x| x / vehicle.arm_m);
    from_fn(|i| {
        let torque = torque_of(vehicle, i);
        forward * torque.x + right * torque.y
    })
}

/// Torque of a thrust of 1 N on rotor `index + 1`.
fn torque_of(vehicle: &Vehicle, index: usize) -> nalgebra::Vector3<f64> {
    vehicle.torque_n_m(&from_fn(|i| f64::from(u8::from(i == index))))
}

/// What must sum to zero: roll and pitch, and yaw if heading is held; per thrust of each rotor, m.
fn balanced(vehicle: &Vehicle, heading: Heading) -> Vec<[f64; 4]> {
    let axes = if heading == Heading::Held { 3 } else { 2 };
    (0..axes).map(|axis| from_fn(|i| torque_of(vehicle, i)[axis])).collect()
}

/// Adds that the thrusts carry the weight, and that each row of `balanced` sums to zero.
fn carry(problem: &mut Problem, vehicle: &Vehicle, thrusts: &[Variable; 4], balanced: &[[f64; 4]]) {
    let mut sum = |of: &[f64; 4], total: f64| {
        let terms: Vec<_> = thrusts.iter().copied().zip(of.iter().copied()).collect();
        problem.add_constraint(terms, ComparisonOp::Eq, total);
    };
    sum(&[1.0; 4], weight_n(vehicle));
    for row in balanced {
        sum(row, 0.0);
    }
}

fn solved(problem: &Problem) -> Option<microlp::Solution> {
    match problem.solve() {
        Ok(SolveOutcome::Solution(solution)) => Some(solution),
        // No time limit is set, so an interruption has the same cause as an error: no such thrusts.
        Ok(SolveOutcome::Interrupted(_)) | Err(_) => None,
    }
}

/// Largest Σ prize_i F_i.
fn most(vehicle: &Vehicle, thrusts: &Thrusts, balanced: &[[f64; 4]], prize: [f64; 4]) -> Option<f64> {
    let mut problem = Problem::new(OptimizationDirection::Maximize);
    let variables = from_fn(|i| problem.add_var(prize[i], thrusts[i]));
    carry(&mut problem, vehicle, &variables, balanced);
    Some(solved(&problem)?.objective())
}

/// Smallest and largest Σ prize_i F_i.
fn span(vehicle: &Vehicle, thrusts: &Thrusts, balanced: &[[f64; 4]], prize: [f64; 4]) -> Option<(f64, f64)> {
    let low = most(vehicle, thrusts, balanced, prize.map(|x| -x))?;
    Some((-low, most(vehicle, thrusts, balanced, prize)?))
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

/// The same of a rotor that is stuck.
pub const STUCK_CASES: [(&str, Heading); 2] =
    [("stuck, heading held", Heading::Held), ("stuck, heading given up", Heading::GivenUp)];

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

    const FAULT: Fault = Fault {
        kind: FaultKind::HardOver,
        rotors: ONE,
        from_s: 5.0,
        until_s: 25.0,
        profile: crate::fault::Profile::Step,
        reported: false,
    };

    fn vehicle(thrust_to_weight: f64, frame: Frame) -> Vehicle {
        Vehicle::new(AirframeName::Paper, &VehicleKeys { thrust_to_weight, frame, ..VehicleKeys::default() })
    }

    #[test]
    fn a_stuck_rotor_is_survived_within_the_closed_forms() {
        for r in [1.2_f64, 1.8, 2.2, 3.0] {
            for frame in [Frame::Plus, Frame::X] {
                let vehicle = vehicle(r, frame);
                let (weight_n, most_n) = (weight_n(&vehicle), vehicle.thrust_n_max());
                for rotor in 0..4 {
                    let (low, high) = stuck_n(&vehicle, rotor, Heading::Held).expect("it hovers");
                    assert!(
                        (low - weight_n / 4.0).abs() < 1e-9 && (high - weight_n / 4.0).abs() < 1e-9,
                        "{low} {high}"
                    );
                    let (low, high) = stuck_n(&vehicle, rotor, Heading::GivenUp).expect("it hovers");
                    assert!((low - (weight_n / 2.0 - most_n).max(0.0)).abs() < 1e-9, "{low} at {r}");
                    assert!((high - most_n.min(weight_n / 2.0)).abs() < 1e-9, "{high} at {r}");
                }
            }
        }
    }

    #[test]
    fn every_kind_of_fault_has_its_verdict() {
        use FaultKind::{
            BatterySag, CommandDelay, Floating, HardOver, LossOfEffectiveness, PropellerDamage, Reversed, Stopped,
            Stuck,
        };
        use Hover::{Nowhere, WithHeading, WithoutHeading};
        for (why, r, kind, rotors, want) in [
            ("within 1 − 1/R", 2.2, LossOfEffectiveness { loss: 0.54 }, ONE, WithHeading),
            ("beyond 1 − 1/R", 2.2, LossOfEffectiveness { loss: 0.55 }, ONE, WithoutHeading),
            ("beyond 2 − 2/R", 1.8, PropellerDamage { loss: 0.9, unbalance_kg_m: 0.0 }, ONE, Nowhere),
            ("the other pair lifts it", 2.2, Stopped, ONE, WithoutHeading),
            ("the other pair does not", 1.8, Floating { spin_down_s: 0.2 }, ONE, Nowhere),
            ("where it hovers", 2.2, Stuck { thrust_n: None }, ONE, WithHeading),
            ("elsewhere", 2.2, Stuck { thrust_n: Some(1.0) }, ONE, WithoutHeading),
            ("a pair alone is too strong beyond 2", 2.2, HardOver, ONE, Nowhere),
            ("and not below", 1.8, HardOver, ONE, WithoutHeading),
            ("two that pull down", 2.2, Reversed { share: 0.5 }, FACING, WithoutHeading),
            ("one that pulls down alone cannot be faced", 1.8, Reversed { share: 0.5 }, ONE, Nowhere),
            ("a voltage of 1 − 0.2/2.2", 2.2, BatterySag { sag: 0.2 }, Rotors::ALL, WithHeading),
            ("late is not weak", 2.2, CommandDelay { delay_s: 0.1 }, Rotors::ALL, WithHeading),
        ] {
            for frame in [Frame::Plus, Frame::X] {
                let vehicle = vehicle(r, frame);
                let fault = Fault { kind, rotors, ..FAULT };
                assert_eq!(hover(&vehicle, &thrusts_under(&vehicle, &[&fault])), want, "{why}, {frame:?}");
            }
        }
    }

    #[test]
    fn faults_that_are_there_together_are_judged_together() {
        let vehicle = vehicle(2.2, Frame::Plus);
        let loss = |loss, rotors| Fault { kind: FaultKind::LossOfEffectiveness { loss }, rotors, ..FAULT };
        let (all, one) = (loss(0.5, Rotors::ALL), loss(0.1, ONE));
        let verdict = |faults: &[&Fault]| hover(&vehicle, &thrusts_under(&vehicle, faults));
        assert_eq!((verdict(&[&all]), verdict(&[&one])), (Hover::WithHeading, Hover::WithHeading));
        // Of 1.1 weights two pairs alike have 0.99 left, the weak pair and the whole of the other 1.045.
        assert_eq!(verdict(&[&all, &one]), Hover::WithoutHeading, "shares multiply");
        assert_eq!(verdict(&[&all, &all]), Hover::Nowhere);
    }

    #[test]
    fn what_is_gone_cannot_turn_the_machine_back() {
        for frame in [Frame::Plus, Frame::X] {
            let vehicle = vehicle(3.0, frame);
            let most_n = vehicle.thrust_n_max();
            let torque = |gone: Rotors, arm| {
                let thrusts = from_fn(|i| (0.0, if gone.has(i) { 0.0 } else { most_n }));
                torque_nm(&vehicle, &thrusts, arm).expect("it is carried")
            };
            let (low, high) = torque(ONE, 1);
            // The facing rotor takes what the pair leaves free, up to its largest thrust.
            assert!(low.abs() < 1e-9 && (high - vehicle.arm_m * most_n).abs() < 1e-9, "one-sided: {low} {high}");
            let (low, high) = torque(FACING, 1);
            assert!(low.abs() < 1e-9 && high.abs() < 1e-9, "nothing at all: {low} {high}");
            let (low, high) = torque(Rotors::default(), 1);
            assert!(low < -0.1 && (low + high).abs() < 1e-9, "both ways: {low} {high}");
        }
    }
}
