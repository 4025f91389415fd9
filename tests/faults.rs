//! Faults as they are flown: how they end a flight, what they draw, and what each does to the shipped machine.
use sim_host::controllers::ControllerName::{Lgs, LgsIndi};
use sim_host::fault::{Fault, FaultKind, Intermittent, Profile, Recurrence, Rotors};
use sim_host::flight::{Cause, NumberFormat, UPRIGHT_RAD_MAX};
use sim_host::metrics::{Flown, Metric};
use sim_host::scenario::Scenario;
use sim_host::vehicle::AirframeName;
use system_tests::{fly, metric, shipped, trace};

const ONE: Rotors = Rotors::new([true, false, false, false]);

/// A hover at 10 m, with one fault from 5 s to 25 s.
fn hover(kind: FaultKind, rotors: Rotors) -> Scenario {
    let mut scenario = shipped("faults/stuck");
    let [fault] = &mut scenario.fault[..] else { panic!("one fault") };
    *fault = Fault { kind, rotors, ..*fault };
    scenario
}

fn one(scenario: &Scenario) -> Flown {
    fly(scenario, Lgs, 1, 1)[0]
}

/// Falls from a height of `fall_m` with 0.96 times its weight.
fn sinking(fall_m: f64) -> Scenario {
    let mut scenario = shipped("faults/infeasible_40_low_thrust");
    scenario.fault[0].until_s = 25.0;
    // The feet reach 0.05 m below the centre of mass.
    scenario.ground_altitude_m = Some(10.0 - 0.05 - fall_m);
    scenario
}

#[test]
fn a_fault_that_brings_the_machine_down_upright_ends_the_flight_without_a_crash() {
    let flown = one(&sinking(0.5));
    let landing = flown.landing.expect("it sinks to the ground");
    assert_eq!(flown.crash, None);
    assert!(!flown.survived(), "nor does it fly on");
    assert!(landing.t_s > 5.0 && landing.t_s < 10.0, "{landing}");
    assert!(landing.touchdown.speed_m_s < 2.0 && landing.touchdown.tilt_rad < UPRIGHT_RAD_MAX, "{landing}");
}

#[test]
fn how_fast_is_a_crash_depends_on_the_airframe() {
    let mut scenario = sinking(8.0);
    let crash = one(&scenario).crash.expect("2 m/s are exceeded");
    let Cause::Ground(touchdown) = crash.cause else { panic!("{crash}") };
    assert!((2.0..3.5).contains(&touchdown.speed_m_s), "{crash}");
    scenario.airframe = AirframeName::Os4;
    let landing = one(&scenario).landing.expect("its legs take 3.5 m/s");
    assert!((2.0..3.5).contains(&landing.touchdown.speed_m_s), "{landing}");
}

#[test]
fn a_healthy_machine_may_touch_the_ground_and_fly_on() {
    let mut scenario = sinking(0.5);
    scenario.fault.clear();
    scenario.ground_altitude_m = Some(10.0 - 0.05);
    let touches = trace(&scenario, Lgs, NumberFormat::F32, |x| x.truth.touching);
    assert!(touches.contains(&true) && touches.contains(&false));
}

/// Survivable faults under the incremental inner loop, and how far each may throw it, m.
#[test]
fn every_shipped_fault_that_needs_no_spin_is_flown_through() {
    for (name, altitude_m, lateral_m) in [
        ("faults/stuck", 0.01, 0.01),
        ("faults/desync", 0.03, 0.05),
        ("faults/command_delay", 0.01, 0.01),
        ("faults/command_jitter", 0.01, 0.01),
        ("faults/prop_damage", 0.01, 0.01),
        ("faults/battery_sag", 0.01, 0.01),
        ("faults/infeasible_40_low_thrust", 5.0, 0.01),
    ] {
        let flights = fly(&shipped(name), LgsIndi, 1, 2);
        let (_, altitude) = metric(&flights, "altitude_deviation_max_m");
        let (_, lateral) = metric(&flights, "horizontal_excursion_max_m");
        assert!(altitude <= altitude_m && lateral <= lateral_m, "{name}: {altitude} {lateral}");
        assert!(metric(&flights, "position_error_end_m").1 < 0.05, "{name}: it comes back");
    }
}

#[test]
fn every_kind_of_fault_is_felt() {
    let desync =
        FaultKind::EscDesync { dropout_s: 0.1, restart_s: 0.1, recurrence: Recurrence::Period { period_s: 1.0 } };
    let end = |kind, rotors| {
        let mut scenario = hover(kind, rotors);
        scenario.duration_s = 7.0;
        let mut last = Vec::new();
        let flight =
            sim_host::flight::Flight { scenario: &scenario, controller: Lgs, seed: 1, format: NumberFormat::F32 };
        flight.fly(&mut |sample| last = sample.truth.position_m.as_slice().to_vec()).expect("shipped gains are valid");
        last
    };
    let healthy = end(FaultKind::LossOfEffectiveness { loss: 0.0 }, ONE);
    for (kind, rotors) in [
        (FaultKind::LossOfEffectiveness { loss: 0.1 }, ONE),
        (FaultKind::Stopped, ONE),
        (FaultKind::Stuck { thrust_n: None }, ONE),
        (FaultKind::Stuck { thrust_n: Some(0.5) }, ONE),
        (FaultKind::HardOver, ONE),
        (FaultKind::Floating { spin_down_s: 0.2 }, ONE),
        (FaultKind::SlowMotor { lag_factor: 3.0, rate_n_s_max: None }, ONE),
        (FaultKind::SlowMotor { lag_factor: 1.0, rate_n_s_max: Some(0.1) }, ONE),
        (FaultKind::CommandDelay { delay_s: 0.01 }, ONE),
        (FaultKind::CommandJitter { delay_s_max: 0.01 }, ONE),
        (desync, ONE),
        (FaultKind::PropellerDamage { loss: 0.0, unbalance_kg_m: 1e-5 }, ONE),
        (FaultKind::BatterySag { sag: 0.1 }, Rotors::ALL),
        (FaultKind::Reversed { share: 0.5 }, ONE),
        (FaultKind::Swapped, Rotors::new([true, true, false, false])),
    ] {
        assert_ne!(end(kind, rotors), healthy, "{kind:?}");
    }
}

#[test]
fn faults_draw_from_a_stream_of_their_own() {
    let jitter = hover(FaultKind::CommandJitter { delay_s_max: 0.01 }, ONE);
    let mut flicker = hover(FaultKind::LossOfEffectiveness { loss: 0.05 }, ONE);
    flicker.fault[0].profile = Profile::Intermittent(Intermittent { on_mean_s: 0.1, off_mean_s: 0.2 });
    let noise = |scenario: &Scenario| {
        let mut scenario = scenario.clone();
        scenario.duration_s = 8.0;
        trace(&scenario, Lgs, NumberFormat::F64, |x| {
            (f64::from(x.input.position_m.x) - x.truth.position_m.x, x.effectiveness[0])
        })
    };
    let (late, flickering) = (noise(&jitter), noise(&flicker));
    for (one, other) in late.iter().zip(&flickering) {
        assert!((one.0 - other.0).abs() < 1e-6, "the sensors' noise is the same");
    }
    let switches = flickering.windows(2).filter(|pair| pair[0].1 != pair[1].1).count();
    assert!((5..50).contains(&switches), "about ten each way in 3 s: {switches}");
    assert_eq!(flickering, noise(&flicker), "the same seed gives the same flight");
    flicker.seed = 2;
    let times = |trace: &[(f64, f64)]| -> Vec<f64> { trace.iter().map(|x| x.1).collect() };
    assert_ne!(times(&flickering), times(&noise(&flicker)), "another seed another");
}

#[test]
fn torque_of_the_air_shakes_a_hover() {
    let mut scenario = hover(FaultKind::Stopped, ONE);
    scenario.fault.clear();
    scenario.duration_s = 20.0;
    let rates = |scenario: &Scenario| {
        let squares = trace(scenario, LgsIndi, NumberFormat::F32, |x| x.truth.rate_rad_s.norm_squared());
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let calm = rates(&scenario);
    scenario.wind.torque_rms_nm = 0.01;
    let shaken = rates(&scenario);
    assert!(shaken > 1.5 * calm && shaken < 0.5, "rms from {calm} to {shaken} rad/s");
}

#[test]
fn the_controller_is_told_of_reported_faults_only() {
    let mut scenario = hover(FaultKind::LossOfEffectiveness { loss: 0.25 }, ONE);
    scenario.duration_s = 6.0;
    let told = |scenario: &Scenario| trace(scenario, LgsIndi, NumberFormat::F32, |x| (x.t_s, *x.told));
    for (t_s, told) in told(&scenario) {
        assert_eq!(told.reported, [None; 4], "silent");
        assert_eq!(told.truth[0], if t_s < 5.0 { 1.0 } else { 0.75 });
    }
    scenario.fault[0].reported = true;
    for (t_s, told) in told(&scenario) {
        assert_eq!(told.reported, [(t_s >= 5.0).then_some(0.75), None, None, None]);
    }
}

#[test]
fn upsets_are_measured_where_they_happen() {
    // Two rotors are gone, and nothing holds roll: it drifts, turning fast, until it is too far away.
    let flown = one(&shipped("opposite_pair_100"));
    let measured = |name: &str| (Metric::named(name).expect("a metric").of)(&flown.metrics).expect("measured");
    assert_eq!(flown.crash.map(|crash| crash.cause), Some(Cause::Distance));
    assert!((29.9..31.0).contains(&measured("horizontal_excursion_max_m")));
    assert!(measured("position_error_settled_m") >= measured("horizontal_excursion_max_m"));
    assert!(measured("yaw_rate_max_rad_s") > 10.0 && measured("tilt_max_rad") < UPRIGHT_RAD_MAX);
    assert!(measured("altitude_drop_max_m") < 0.5);
}
