//! What is promised of the controller that flies when rotors weaken, stick or go: the rows of the issue, each on its flight.
use rayon::prelude::*;
use sim_host::controllers::ControllerName::{self, Default, Lgs, Oracle};
use sim_host::fault::{FaultKind, Rotors};
use sim_host::flight::{Flight, NumberFormat, UPRIGHT_RAD_MAX};
use sim_host::metrics::{Flown, Metric, fly_measured};
use sim_host::reference::{Hover, Reference, Waypoint};
use sim_host::scenario::Scenario;
use sim_host::sensors::Noise;
use sim_host::vehicle::{AirframeName, Frame};
use system_tests::{fly, metric, shipped, trace};

const SEEDS: u64 = 5;
const ALTITUDE: &str = "altitude_deviation_max_m";
const LATERAL: &str = "lateral_deviation_max_m";
/// Control rates: the scenarios' own, and the board's, on which the same tuning flies.
const RATES_HZ: [Option<f64>; 2] = [None, Some(2_000.0)];

#[test]
fn one_weak_rotor_is_held_in_altitude_and_sideways() {
    let bounds =
        [("single_rotor_20", 0.003, 0.004), ("single_rotor_40", 0.006, 0.008), ("single_rotor_60", 0.010, 0.016)];
    for ((name, altitude_m, lateral_m), control_hz) in bounds.into_iter().flat_map(|row| RATES_HZ.map(|hz| (row, hz))) {
        let flights = fly(&Scenario { control_hz, ..shipped(name) }, Default, 1, SEEDS);
        let (altitude, lateral) = (metric(&flights, ALTITUDE).0, metric(&flights, LATERAL).0);
        assert!(altitude <= altitude_m && lateral <= lateral_m, "{name} at {control_hz:?} Hz: {altitude} {lateral}");
        if name != "single_rotor_60" {
            let (yaw, _) = metric(&flights, "yaw_deviation_max_rad");
            assert!(yaw < 0.1, "{name}: heading is held where it can be: {yaw}");
        }
    }
}

#[test]
fn at_40_percent_of_one_rotor_it_is_within_four_times_of_who_knows() {
    let scenario = shipped("single_rotor_40");
    let (found, known) = (fly(&scenario, Default, 1, SEEDS), fly(&scenario, Oracle, 1, SEEDS));
    for (name, oracle_m) in [(ALTITUDE, 0.002), (LATERAL, 0.003)] {
        let (found, known) = (metric(&found, name).0, metric(&known, name).0);
        assert!(known <= oracle_m, "the oracle, {name}: {known}");
        assert!(found <= 4.0 * known, "{name}: {found} against {known}");
    }
}

#[test]
fn the_papers_fault_is_held_with_quick_and_with_slow_motors() {
    let deviation = |name: &str, controller| metric(&fly(&shipped(name), controller, 1, SEEDS), ALTITUDE).0;
    for control_hz in RATES_HZ {
        let quick = metric(&fly(&Scenario { control_hz, ..shipped("flight") }, Default, 1, SEEDS), ALTITUDE).0;
        assert!(quick <= 0.010, "at {control_hz:?} Hz: {quick}");
    }
    let (slow, alone) = (deviation("lag_50ms", Default), deviation("lag_50ms", Lgs));
    assert!(slow <= 0.028 && slow <= alone, "{slow} against {alone}");
}

#[test]
fn what_cannot_be_hovered_with_is_fallen_with_and_recovered_from() {
    let flights = fly(&shipped("faults/infeasible_40_low_thrust"), Default, 1, SEEDS);
    let (_, drop) = metric(&flights, "altitude_drop_max_m");
    assert!((0.5..9.0).contains(&drop), "it drops, and does not reach the ground: {drop}");
    assert!(metric(&flights, "position_error_end_m").1 < 0.05);
}

/// North, east and altitude at every tick.
fn positions(scenario: &Scenario, controller: ControllerName) -> Vec<[f64; 3]> {
    trace(scenario, controller, NumberFormat::F32, |x| {
        [x.truth.position_m.x, x.truth.position_m.y, x.truth.altitude_m()]
    })
}

/// One rotor loses 40 % without noise, after a heading is taken at once and a step is flown to a place and on to a heading 0.5 rad more.
fn with_fault_on(rotor: usize, frame: Frame, yaw_rad: f64) -> Scenario {
    let mut scenario = shipped("single_rotor_40");
    scenario.noise = Noise::default();
    scenario.vehicle.frame = frame;
    scenario.fault[0].rotors = Rotors::new(std::array::from_fn(|i| i + 1 == rotor));
    scenario.reference = Reference::Waypoints(vec![
        Waypoint { at_s: 0.0, position_m: [0.0; 3], yaw_rad },
        Waypoint { at_s: STEP_S, position_m: [0.3, 0.3, 0.2], yaw_rad: yaw_rad + 0.5 },
    ]);
    scenario
}

/// When the step of [`with_fault_on`] begins, s: its heading has been taken.
const STEP_S: f64 = 15.0;

fn turned([north, east]: [f64; 2], by_rad: f64) -> [f64; 2] {
    let (sin, cos) = by_rad.sin_cos();
    [cos * north - sin * east, sin * north + cos * east]
}

/// Largest difference in altitude, and in the plane once `b` is turned back by `turned_rad`, m.
fn apart_m(a: &[[f64; 3]], b: &[[f64; 3]], turned_rad: f64) -> (f64, f64) {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold((0.0, 0.0), |(up, plane), (a, b)| {
        let [north, east] = turned([b[0], b[1]], -turned_rad);
        let apart = (a[0] - north).hypot(a[1] - east);
        (f64::max(up, (a[2] - b[2]).abs()), f64::max(plane, apart))
    })
}

/// The machine is the same after a quarter turn, but for the rotors' sense: the flights are mirror images in heading, and the
/// same in altitude. Rotors 1 and 3 turn alike, so between these the plane is the same as well, turned by a half.
#[test]
fn whichever_rotor_weakens_the_flight_is_the_same() {
    for controller in [Default, Lgs] {
        let mut hover = with_fault_on(1, Frame::Plus, 0.0);
        hover.reference = Reference::Hover(Hover { altitude_m: 0.0 });
        let positions = |rotor: usize| {
            let mut scenario = hover.clone();
            scenario.fault[0].rotors = Rotors::new(std::array::from_fn(|i| i + 1 == rotor));
            positions(&scenario, controller)
        };
        let first = positions(1);
        for rotor in 2..=4 {
            // Rotor 2 is a quarter turn to the left of rotor 1, and so on.
            let by_rad = -std::f64::consts::FRAC_PI_2 * (rotor - 1) as f64;
            let other = positions(rotor);
            let (up, plane) = apart_m(&first, &other, by_rad);
            assert!(up <= 1e-4, "{controller}, rotor {rotor}: {up} m in altitude");
            assert!(rotor != 3 || plane <= 1e-4, "{controller}, rotor {rotor}: {plane} m in the plane");
        }
    }
}

/// An X frame is a plus frame whose rotors stand 45 degrees farther to the right: with its nose as much to the left, rotor stands on
/// rotor. Flights start with heading zero, so the X frame first turns, and is compared from then on, through step and fault.
///
/// What is bounded axis by axis is bounded differently along a diagonal, so the flight stays within: a step that does not ask for the
/// largest tilt, and for `lgs` a loss whose roll the integral of roll (0.1 N m at most) can hold: 20 %, where 40 % on an arm asks for 0.12.
#[test]
fn an_x_frame_flown_45_degrees_yawed_flies_as_a_plus_frame() {
    for (controller, loss) in [(Default, 0.4), (Lgs, 0.2)] {
        for rotor in 1..=4 {
            let fly = |frame, yaw_rad| {
                let mut scenario = with_fault_on(rotor, frame, yaw_rad);
                scenario.fault[0].kind = FaultKind::LossOfEffectiveness { loss };
                positions(&scenario, controller)
            };
            let (plus, x) = (fly(Frame::Plus, 0.0), fly(Frame::X, -std::f64::consts::FRAC_PI_4));
            let from = (500.0 * STEP_S) as usize;
            let (up, plane) = apart_m(&plus[from..], &x[from..], 0.0);
            let apart = format!("{controller}, rotor {rotor}: {up} m in altitude, {plane} m in the plane");
            assert!(up <= 1e-3 && plane <= 1e-3, "{apart}");
        }
    }
}

/// One flight of the matrix of lost rotors.
#[derive(Clone, Copy, Debug)]
struct Lost {
    loss: f64,
    airframe: AirframeName,
    yaw_drag_n_m_s: f64,
    thrust_to_weight: f64,
    gust_rms_n: f64,
    seed: u64,
}

impl Lost {
    /// Every combination that is promised at this thrust-to-weight ratio.
    fn every(thrust_to_weight: f64) -> Vec<Self> {
        let mut flights = Vec::new();
        for loss in [0.8, 1.0] {
            for (airframe, drags) in
                [(AirframeName::Paper, &[0.0, 2.75e-3, 1e-2][..]), (AirframeName::Os4, &[0.0, 2.75e-3][..])]
            {
                for &yaw_drag_n_m_s in drags {
                    for gust_rms_n in [0.0, 0.3] {
                        for seed in 1..=SEEDS {
                            flights.push(Self { loss, airframe, yaw_drag_n_m_s, thrust_to_weight, gust_rms_n, seed });
                        }
                    }
                }
            }
        }
        flights
    }

    fn fly(self) -> (Self, Flown) {
        let mut scenario = shipped("single_rotor_100");
        scenario.fault[0].kind = FaultKind::LossOfEffectiveness { loss: self.loss };
        scenario.airframe = self.airframe;
        scenario.vehicle.yaw_drag_n_m_s = self.yaw_drag_n_m_s;
        scenario.vehicle.thrust_to_weight = self.thrust_to_weight;
        scenario.wind.gust_rms_n = self.gust_rms_n;
        // Until 20 s after the fault's end, when the return is looked at.
        scenario.duration_s = 45.1;
        let flight = Flight { scenario: &scenario, controller: Default, seed: self.seed, format: NumberFormat::F32 };
        (self, fly_measured(&flight, &mut |_| {}).expect("shipped gains are valid"))
    }
}

/// What of a flight is not as promised.
fn broken(flown: &Flown, bounds: &[(&str, f64)]) -> Vec<String> {
    let measure = |name: &str| (Metric::named(name).expect("a metric").of)(&flown.metrics).unwrap_or(f64::NAN);
    let beyond = |&(name, most): &(&str, f64)| {
        let value = measure(name);
        // Not a number is beyond, too.
        let within = value <= most;
        (!within).then(|| format!("{name} {value:.3} of {most}"))
    };
    bounds.iter().filter_map(beyond).collect()
}

/// The bounds of a flight that goes on.
fn promised(lost: Lost) -> [(&'static str, f64); 5] {
    let settled_m = if lost.gust_rms_n > 0.0 { 1.2 } else { 0.5 };
    let drop_m = if lost.airframe == AirframeName::Paper { 0.5 } else { 2.0 };
    [
        ("position_error_settled_m", settled_m),
        ("position_error_end_m", settled_m),
        ("altitude_drop_max_m", drop_m),
        ("horizontal_excursion_max_m", 6.0),
        ("yaw_rate_max_rad_s", 34.9),
    ]
}

/// Flies them all, and lists what `wrong` says of each.
fn failures(flights: Vec<Lost>, wrong: impl Fn(Lost, &Flown) -> Vec<String> + Sync) -> Vec<String> {
    let flown: Vec<_> = flights.into_par_iter().map(Lost::fly).collect();
    let failed = flown.iter().filter_map(|(lost, flown)| {
        let wrong = wrong(*lost, flown);
        (!wrong.is_empty()).then(|| format!("{lost:?}: {}", wrong.join(", ")))
    });
    failed.collect()
}

#[test]
fn one_rotor_all_but_gone_is_flown_without() {
    let failed = failures(Lost::every(3.0), |lost, flown| {
        let ended = flown.crash.map(|crash| crash.to_string()).or(flown.landing.map(|landing| landing.to_string()));
        ended.into_iter().chain(broken(flown, &promised(lost))).collect()
    });
    assert!(failed.is_empty(), "{} flights:\n{}", failed.len(), failed.join("\n"));
}

#[test]
fn one_rotor_all_but_gone_with_little_thrust_is_flown_without_or_landed_upright() {
    let failed = failures(Lost::every(2.2), |_, flown| match (flown.crash, flown.landing) {
        (Some(crash), _) => vec![crash.to_string()],
        // How fast is a crash depends on the airframe, and is one already.
        (None, Some(landing)) if landing.touchdown.tilt_rad < UPRIGHT_RAD_MAX => Vec::new(),
        (None, Some(landing)) => vec![landing.to_string()],
        (None, None) => broken(flown, &[("yaw_rate_max_rad_s", 34.9)]),
    });
    assert!(failed.is_empty(), "{} flights:\n{}", failed.len(), failed.join("\n"));
}

/// Only the turning tells them from a loss of all alike.
#[test]
fn two_facing_rotors_lost_silently_are_known_and_the_machine_is_landed() {
    for (airframe, first) in
        [(AirframeName::Paper, 0), (AirframeName::Paper, 1), (AirframeName::Os4, 0), (AirframeName::Os4, 1)]
    {
        let mut scenario = shipped("opposite_pair_100");
        scenario.airframe = airframe;
        scenario.fault[0].rotors = Rotors::new(std::array::from_fn(|i| i % 2 == first));
        for flown in fly(&scenario, Default, 1, SEEDS) {
            assert!(!scenario.fault[0].reported, "nobody says so");
            let landing = flown.landing.expect("it is led down to the ground");
            let led = flown.account.led_down.expect("it is known why");
            assert!(landing.touchdown.tilt_rad < UPRIGHT_RAD_MAX && landing.touchdown.speed_m_s < 2.0, "{landing}");
            assert!(led.rotor == first && led.delay_s < 0.3, "{led:?}");
        }
    }
}

/// How late a rotor's loss is known decides how far it falls and strays at little thrust, not whether it flies.
#[test]
fn however_late_a_lost_rotor_is_known_little_thrust_flies_on() {
    for airframe in [AirframeName::Paper, AirframeName::Os4] {
        for oracle_delay_s in [0.0, 0.03, 0.06, 0.1, 0.2, 0.5] {
            let mut scenario = shipped("single_rotor_100");
            scenario.airframe = airframe;
            scenario.vehicle.thrust_to_weight = 2.2;
            scenario.oracle_delay_s = oracle_delay_s;
            let flights = fly(&scenario, Oracle, 1, SEEDS);
            assert!(flights.iter().all(Flown::survived), "{airframe:?}, {oracle_delay_s} s late");
            let worst = |name| metric(&flights, name).1;
            println!(
                "| {airframe:?} | {:.0} | {:.2} | {:.1} | {:.2} |",
                1000.0 * oracle_delay_s,
                worst("altitude_drop_max_m"),
                worst("horizontal_excursion_max_m"),
                worst("tilt_max_rad")
            );
        }
    }
}
