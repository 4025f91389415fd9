//! The check before take-off: what it refuses, what it lets fly, and what it does to the machine and to the flight.
use control_core::WiringFault::{self, AnswersAs, Reversed, Silent, Tipping};
use sim_host::controllers::ControllerName::{self, Lgs};
use sim_host::fault::{Fault, FaultKind, Rotors};
use sim_host::flight::{Ending, Flight, NumberFormat, Refusal};
use sim_host::preflight::check;
use sim_host::scenario::Scenario;
use sim_host::vehicle::{AirframeName, Frame};
use std::path::Path;
use system_tests::{fly, shipped, trace};

/// Every shipped machine, with the thrust it may have, standing without a fault.
fn machines() -> Vec<Scenario> {
    let mut machines = Vec::new();
    for airframe in [AirframeName::Paper, AirframeName::Os4] {
        for frame in [Frame::Plus, Frame::X] {
            for thrust_to_weight in [1.05, 1.6, 2.2, 3.0] {
                for motor_lag_s in [0.0, 0.02, 0.05] {
                    let mut scenario = shipped("faults/swapped");
                    scenario.fault.clear();
                    scenario.airframe = airframe;
                    let vehicle = &mut scenario.vehicle;
                    (vehicle.frame, vehicle.thrust_to_weight, vehicle.motor_lag_s) =
                        (frame, thrust_to_weight, motor_lag_s);
                    vehicle.rotor_inertia_kg_m2 = 6e-5;
                    machines.push(scenario);
                }
            }
        }
    }
    machines
}

fn faulty(machine: &Scenario, kind: FaultKind, rotors: &[usize]) -> Scenario {
    let mut scenario = machine.clone();
    let [fault] = shipped("faults/swapped").fault[..] else { panic!("one fault") };
    let rotors = Rotors::new(std::array::from_fn(|i| rotors.contains(&(i + 1))));
    scenario.fault = vec![Fault { kind, rotors, ..fault }];
    scenario
}

fn verdict(scenario: &Scenario, seed: u64) -> Result<(), WiringFault> {
    check(scenario, seed, &mut |_| {})
}

#[test]
fn healthy_machines_pass_and_stay_on_their_feet() {
    for machine in machines() {
        for seed in 1..=5 {
            let (mut tilt_rad, mut rise_m, mut lowest_m): (f64, f64, f64) = (0.0, 0.0, f64::INFINITY);
            let passed = check(&machine, seed, &mut |truth| {
                assert!(truth.touching, "it never lifts off");
                tilt_rad = tilt_rad.max(truth.tilt_rad());
                lowest_m = lowest_m.min(truth.altitude_m());
                rise_m = rise_m.max(truth.altitude_m() - lowest_m);
            });
            let which = format!("{:?} {:?} seed {seed}", machine.airframe, machine.vehicle);
            assert_eq!(passed, Ok(()), "{which}");
            assert!((0.008..0.0095).contains(&tilt_rad), "{which}: {tilt_rad} rad");
            assert!(rise_m < 0.002, "{which}: {rise_m} m");
        }
    }
}

#[test]
fn every_swap_and_every_reversal_is_refused_by_name() {
    for machine in machines() {
        for told in 1..=4 {
            for answers in told + 1..=4 {
                let swapped = faulty(&machine, FaultKind::Swapped, &[told, answers]);
                assert_eq!(verdict(&swapped, 1), Err(AnswersAs { told, answers }));
                let swapped = faulty(&machine, FaultKind::Swapped, &[answers, told]);
                assert_eq!(verdict(&swapped, 2), Err(AnswersAs { told, answers }), "in either order");
            }
            for share in [0.2, 0.5, 1.0] {
                let reversed = faulty(&machine, FaultKind::Reversed { share }, &[told]);
                assert_eq!(verdict(&reversed, 1), Err(Reversed { rotor: told }), "{share}");
            }
            assert_eq!(verdict(&faulty(&machine, FaultKind::Stopped, &[told]), 1), Err(Silent { rotor: told }));
        }
    }
}

/// The margin: gyro noise that the check takes, in multiples of the 0.01 rad/s it is made for.
#[test]
fn noise_of_ten_times_the_usual_changes_no_verdict() {
    let mut machine = machines().remove(4);
    machine.noise.rate_rad_s = 0.1;
    let swapped = faulty(&machine, FaultKind::Swapped, &[1, 2]);
    for seed in 1..=200 {
        assert_eq!(verdict(&machine, seed), Ok(()), "seed {seed}");
        assert_eq!(verdict(&swapped, seed), Err(AnswersAs { told: 1, answers: 2 }), "seed {seed}");
    }
}

#[test]
fn a_rotor_out_of_control_on_the_ground_is_not_taken_for_a_healthy_one() {
    for machine in machines().iter().filter(|machine| machine.vehicle.thrust_to_weight > 2.0) {
        let Err(Tipping { .. }) = verdict(&faulty(machine, FaultKind::HardOver, &[3]), 1) else {
            panic!("it tips: {:?}", machine.vehicle)
        };
    }
}

#[test]
fn the_shipped_wiring_errors_never_take_off_and_are_not_crashes() {
    let (swapped, reversed) = (AnswersAs { told: 1, answers: 2 }, Reversed { rotor: 1 });
    for (name, fault) in [("faults/swapped", swapped), ("faults/reversed", reversed)] {
        let mut scenario = shipped(name);
        for controller in [ControllerName::Default, Lgs] {
            for flown in fly(&scenario, controller, 1, 5) {
                assert_eq!(flown.refusal, Some(Refusal { fault }), "{name} {controller}");
                assert!(flown.crash.is_none() && flown.landing.is_none() && !flown.survived());
            }
        }
        scenario.preflight = false;
        let unchecked = fly(&scenario, Lgs, 1, 5);
        assert!(unchecked.iter().all(|flown| flown.crash.is_some()), "{name}: without the check it crashes");
    }
}

#[test]
fn a_refused_flight_has_no_ticks() {
    let scenario = shipped("faults/reversed");
    let flight = Flight { scenario: &scenario, controller: Lgs, seed: 1, format: NumberFormat::F32 };
    let ending = flight.fly(&mut |_| panic!("it flies")).expect("shipped gains are valid");
    assert!(matches!(ending, Some(Ending::Refused(_))));
}

#[test]
fn a_flight_that_passes_the_check_is_the_flight_without_it() {
    let mut scenario = shipped("faults/command_jitter");
    scenario.duration_s = 8.0;
    scenario.wind.gust_rms_n = 0.3;
    let bits = |preflight| {
        let scenario = Scenario { preflight, ..scenario.clone() };
        trace(&scenario, Lgs, NumberFormat::F32, |x| (x.output.thrust_n.map(f32::to_bits), x.truth.position_m))
    };
    assert_eq!(bits(true), bits(false));
}

#[test]
fn a_check_needs_ground_to_stand_on() {
    let text = shipped("faults/swapped").text;
    let refusal = |text: &str| Scenario::parse(text, Path::new("x.toml")).expect_err("it is refused").to_string();
    let airborne = text.replace("ground_altitude_m = 0.0\n", "");
    assert!(refusal(&airborne).contains("preflight = true: must be false without ground_altitude_m"));
    let on_paper = airborne.replace("\"rigid\"", "\"paper\"");
    assert!(refusal(&on_paper).contains("preflight = true: must be false with the plant `paper`"));
}
