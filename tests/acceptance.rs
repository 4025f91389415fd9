//! The numbers this project promises, each on its shipped scenario.
//!
//! Bounds of the robust law hold for any seed; two far-apart bases are flown here.
use control_core::law::{GAIN_RATIO_MAX, GAIN_RATIO_MIN};
use sim_host::controllers::ControllerName::{Indi, Lgs, LgsIndi, Lqi, Pid, PidOpt, Raw};
use sim_host::fault::Rotors;
use sim_host::flight::{NumberFormat, Sample};
use sim_host::metrics::Flown;
use sim_host::sensors::Noise;
use system_tests::{fly, metric, shipped, trace};

/// First seeds of the flights below.
const BASES: [u64; 2] = [1, 1_000_000];
const SEEDS: u64 = 5;
const DEVIATION: &str = "altitude_deviation_max_m";

/// Largest median altitude deviation of the robust law over both bases.
fn lgs_deviation_m(name: &str) -> f64 {
    let scenario = shipped(name);
    BASES.map(|base| metric(&fly(&scenario, Lgs, base, SEEDS), DEVIATION).0).into_iter().fold(0.0, f64::max)
}

#[test]
fn paper_law_beats_fixed_gains_and_limit_cycles() {
    let scenario = shipped("paper");
    let (pid, raw) = (fly(&scenario, Pid, 1, 1), fly(&scenario, Raw, 1, 1));
    assert!(metric(&pid, DEVIATION).0 > 0.3);
    assert!(metric(&raw, DEVIATION).0 < 0.02);
    assert!(metric(&raw, "lateral_limit_cycle_m").0 >= 0.03);
}

#[test]
fn robust_law_holds_altitude_through_the_fault() {
    let scenario = shipped("flight");
    for base in BASES {
        let flights = fly(&scenario, Lgs, base, SEEDS);
        let (median, worst) = metric(&flights, DEVIATION);
        assert!(median <= 0.018 && worst <= 0.020, "seeds from {base}: {median} {worst}");
        assert!(metric(&flights, "altitude_overshoot_m").1 <= 0.010);
        assert_eq!(metric(&flights, "altitude_recovery_s").1, 0.0, "never leaves 0.1 m");
        let (ratio, _) = metric(&flights, "ki_ratio_z");
        assert!((1.55..=1.75).contains(&ratio), "the gain learns 1/(1 - 0.4): {ratio}");
    }
}

#[test]
fn fixed_gains_deviate_as_the_plant_predicts_and_work_the_motors_as_hard() {
    let scenario = shipped("flight");
    let (pid, lgs) = (fly(&scenario, Pid, 1, SEEDS), fly(&scenario, Lgs, 1, SEEDS));
    let (deviation, _) = metric(&pid, DEVIATION);
    assert!((0.170..=0.205).contains(&deviation), "{deviation}");
    let variation = |flights| metric(flights, "motor_total_variation_n_s").0;
    assert!(variation(&lgs) <= 1.05 * variation(&pid));
}

#[test]
fn paper_law_crashes_once_rotors_saturate() {
    for name in ["flight", "raw_law_limits"] {
        let flights = fly(&shipped(name), Raw, 1, SEEDS);
        assert!(flights.iter().all(|flown| flown.crash.is_some()), "{name}");
    }
}

#[test]
fn robust_law_holds_altitude_in_wind() {
    assert!(lgs_deviation_m("flight_wind") <= 0.023);
}

#[test]
fn robust_law_holds_altitude_with_slow_motors() {
    assert!(lgs_deviation_m("lag_50ms") <= 0.033);
}

#[test]
fn robust_law_holds_altitude_at_half_thrust() {
    assert!(lgs_deviation_m("loss_50") <= 0.054);
}

#[test]
fn robust_law_holds_altitude_with_little_thrust_to_spare() {
    assert!(lgs_deviation_m("low_thrust") <= 0.036);
}

#[test]
fn every_controller_but_raw_survives_a_weak_rotor_and_a_helix() {
    for name in ["single_rotor_40", "single_rotor_60", "helix"] {
        for controller in [Pid, Lgs, LgsIndi, Indi, Lqi, PidOpt] {
            let flights = fly(&shipped(name), controller, 1, SEEDS);
            assert!(flights.iter().all(Flown::survived), "{name} {controller}");
        }
    }
}

#[test]
fn heading_returns_after_a_rotor_was_too_weak_for_yaw() {
    let mut scenario = shipped("single_rotor_60");
    let heal_s = scenario.fault[0].until_s;
    for seed in BASES.into_iter().flat_map(|base| base..base + SEEDS) {
        scenario.seed = seed;
        let errors = trace(&scenario, Lgs, NumberFormat::F32, |x| (x.t_s, x.yaw_error_rad().abs()));
        let turned = errors.iter().any(|&(_, error)| error > 3.0);
        assert!(turned, "the fault is beyond what yaw can hold, seed {seed}");
        let late: Vec<_> = errors.iter().filter(|(t_s, _)| *t_s >= heal_s + 10.0).map(|&(_, error)| error).collect();
        assert!(late.len() > 1000);
        let worst = late.into_iter().fold(0.0, f64::max);
        assert!(worst < 0.1, "seed {seed}: {worst}");
    }
}

#[test]
fn nine_faults_leave_the_gains_where_one_does() {
    let scenario = shipped("nine_faults");
    let (mut ticks, mut at_bound) = (0.0, 0.0);
    let mut deviations = [0.0_f64; 9];
    let samples = trace(&scenario, Lgs, NumberFormat::F32, |x| {
        let axes = x.telemetry.axes;
        let hits = axes.iter().any(|axis| axis.at_bound().contains(&true));
        (x.t_s, x.altitude_error_m().abs(), hits, axes.map(|axis| axis.gain_ratios))
    });
    for (t_s, error, hits, ratios) in &samples {
        ticks += 1.0;
        at_bound += f64::from(*hits);
        for ratio in ratios.as_flattened() {
            assert!((GAIN_RATIO_MIN..=GAIN_RATIO_MAX).contains(ratio), "{ratio} at {t_s} s");
        }
        if let Some(i) = scenario.fault.iter().position(|fault| fault.is_active(*t_s)) {
            deviations[i] = deviations[i].max(*error);
        }
    }
    assert!(at_bound / ticks < 0.01, "{at_bound} of {ticks} ticks");
    let [first, .., ninth] = deviations;
    assert!((ninth / first - 1.0).abs() <= 0.1, "{deviations:?}");
}

#[test]
fn incremental_inner_loop_takes_the_push_of_a_single_weak_rotor() {
    for (name, altitude_m, lateral_m) in [("single_rotor_40", 0.006, 0.008), ("single_rotor_60", 0.010, 0.016)] {
        let scenario = shipped(name);
        let flights = fly(&scenario, LgsIndi, 1, SEEDS);
        assert!(metric(&flights, DEVIATION).0 <= altitude_m, "{name}");
        assert!(metric(&flights, "lateral_deviation_max_m").0 <= lateral_m, "{name}");
        let passive = fly(&scenario, Lgs, 1, SEEDS);
        assert!(metric(&passive, "lateral_deviation_max_m").0 > 10.0 * lateral_m, "the push is there: {name}");
    }
}

#[test]
fn linear_baselines_deviate_as_they_were_tuned() {
    let scenario = shipped("flight");
    for (controller, low_m, high_m) in [(Lqi, 0.09, 0.11), (PidOpt, 0.04, 0.055)] {
        let (deviation, _) = metric(&fly(&scenario, controller, 1, SEEDS), DEVIATION);
        assert!((low_m..=high_m).contains(&deviation), "{controller}: {deviation}");
    }
}

/// Largest distance between two flights, m.
fn apart_m(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn number_formats_fly_the_same_flight() {
    let scenario = shipped("flight");
    let fly = |format| trace(&scenario, Lgs, format, |x| x.truth.position_m.into());
    let (single, double, fixed) = (fly(NumberFormat::F32), fly(NumberFormat::F64), fly(NumberFormat::Q16));
    let rounding_m = apart_m(&single, &double);
    assert!(rounding_m > 0.0 && rounding_m <= 1e-4, "{rounding_m}");
    let fixed_m = apart_m(&single, &fixed);
    assert!(fixed_m <= 0.010, "{fixed_m}");
}

#[test]
fn any_failing_rotor_gives_the_same_altitude() {
    let altitudes = |rotor: usize| {
        let mut scenario = shipped("single_rotor_40");
        scenario.noise = Noise::default();
        scenario.fault[0].rotors = Rotors::new(std::array::from_fn(|i| i + 1 == rotor));
        trace(&scenario, Lgs, NumberFormat::F32, |x: &Sample| [x.truth.altitude_m(); 3])
    };
    let first = altitudes(1);
    for rotor in 2..=4 {
        let apart = apart_m(&first, &altitudes(rotor));
        assert!(apart <= 1e-4, "rotor {rotor}: {apart} m");
    }
}

#[test]
fn same_seed_same_flight_and_other_seed_another() {
    let mut scenario = shipped("flight_wind");
    scenario.duration_s = 10.0;
    let fly = |seed| {
        let mut scenario = scenario.clone();
        scenario.seed = seed;
        trace(&scenario, Lgs, NumberFormat::F32, |x| x.output.thrust_n.map(f32::to_bits))
    };
    assert_eq!(fly(3), fly(3));
    assert_ne!(fly(3), fly(4));
}
