//! The controller on its own estimate: the faults of truth-fed flights again, with motion capture, on satellites, on optical flow.
//!
//! `cargo test --release -p system-tests --test flown_on_sensors -- --nocapture` prints the tables of docs/flown-on-sensors.md.
use nalgebra::Vector3;
use rayon::prelude::*;
use sim_host::aboard::{Account, Verdict};
use sim_host::controllers::ControllerName;
use sim_host::flight::{Ending, Flight, NumberFormat, Sample};
use sim_host::metrics::Flown;
use sim_host::scenario::Scenario;
use system_tests::{fly, metric, root, shipped};

const SEEDS: u64 = 5;
const KITS: [&str; 3] = ["mocap", "gnss", "flow"];

/// A shipped scenario on the sensors of a kit.
fn on(name: &str, kit: &str) -> Scenario {
    let file = |path: String| root().join("scenarios").join(path);
    Scenario::load_with(&file(format!("{name}.toml")), &[file(format!("kits/{kit}.toml"))])
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Flies and keeps the account of the estimate.
fn judged(scenario: &Scenario, seed: u64, observe: &mut dyn FnMut(&Sample)) -> (Option<Ending>, Verdict) {
    let mut account = Account::new(scenario.control_hz());
    let flight = Flight { scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 };
    let ending = flight.fly(&mut |sample| {
        account.note(sample);
        observe(sample);
    });
    (ending.expect("shipped gains are valid"), account.finish())
}

/// Median and worst, mm.
fn deviation_mm(flights: &[Flown]) -> (f64, f64) {
    let (median, worst) = metric(flights, "altitude_deviation_max_m");
    (1000.0 * median, 1000.0 * worst)
}

#[test]
fn a_weak_rotor_is_flown_through_on_every_kit_and_with_motion_capture_as_if_on_the_truth() {
    for name in ["flight", "single_rotor_40"] {
        let (truth_mm, truth_worst_mm) = deviation_mm(&fly(&shipped(name), ControllerName::Default, 1, SEEDS));
        println!("| `{name}` | truth | {truth_mm:.1} | {truth_worst_mm:.1} |");
        for kit in KITS {
            // Panics, naming the seed, if one does not fly to its end.
            let (median_mm, worst_mm) = deviation_mm(&fly(&on(name, kit), ControllerName::Default, 1, SEEDS));
            println!("| `{name}` | {kit} | {median_mm:.1} | {worst_mm:.1} |");
            if kit == "mocap" {
                assert!(median_mm <= 2.0 * truth_mm, "{name}: {median_mm} mm beside {truth_mm} mm");
            }
        }
    }
}

#[test]
fn a_rotor_that_is_gone_is_flown_without_on_motion_capture_and_on_satellites() {
    let (truth_mm, _) = deviation_mm(&fly(&shipped("single_rotor_100"), ControllerName::Default, 1, SEEDS));
    for kit in ["mocap", "gnss"] {
        let flights = fly(&on("single_rotor_100", kit), ControllerName::Default, 1, SEEDS);
        let (median_mm, worst_mm) = deviation_mm(&flights);
        println!("| `single_rotor_100` | {kit} | {median_mm:.1} | {worst_mm:.1} |");
        if kit == "mocap" {
            assert!(median_mm <= 2.0 * truth_mm, "{median_mm} mm beside {truth_mm} mm");
        }
    }
}

/// What the estimator takes for biases at the end of a flight: gyro, rad/s, and accelerometer, m/s², with their standard deviations.
fn biases(scenario: &Scenario, seed: u64) -> (Verdict, [Vector3<f64>; 2], [Vector3<f64>; 2]) {
    let (mut last, mut sigma) = ([Vector3::zeros(); 2], [Vector3::zeros(); 2]);
    let (ending, verdict) = judged(scenario, seed, &mut |sample| {
        let Some(aboard) = sample.aboard else { return };
        let estimate = aboard.estimate();
        let (gyro, force) = (estimate.gyro_bias_rad_s, estimate.accelerometer_bias_m_s2);
        last = [[gyro.x, gyro.y, gyro.z], [force.x, force.y, force.z]].map(|v| Vector3::from(v.map(f64::from)));
        let p = aboard.covariance();
        sigma = [9, 12].map(|first| Vector3::from_fn(|axis, _| f64::from(p[first + axis][first + axis]).sqrt()));
    });
    assert_eq!(ending, None, "seed {seed}");
    (verdict, last, sigma)
}

/// 15 s into the loss of 40 % of a rotor, in a steady wind that drags with a tenth of the weight, the biases are what they are in a calm
/// without a fault, and they are those of the sensors.
#[test]
fn wind_and_a_weak_rotor_are_not_taken_for_biases() {
    for kit in KITS {
        let mut rough = on("single_rotor_40", kit);
        rough.duration_s = 50.0;
        rough.vehicle.linear_drag_n_s_m = 0.1;
        let mut calm = rough.clone();
        calm.fault.clear();
        rough.wind.mean_ned_m_s = [4.0, 3.0, 0.0];
        let rows: Vec<_> =
            (1..=SEEDS).into_par_iter().map(|seed| (biases(&rough, seed), biases(&calm, seed))).collect();
        for ((verdict, rough, sigma), (_, calm, _)) in &rows {
            for half in 0..2 {
                let moved = (rough[half] - calm[half]).component_div(&sigma[half]).amax();
                let name = ["gyro_bias_sigmas_end", "accelerometer_bias_sigmas_end"][half];
                println!("| {kit} | {} | {moved:.2} | {:.2} |", ["gyro", "accelerometer"][half], verdict.of(name));
            }
        }
    }
}

/// Share of sorted values.
fn share(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(share * values.len() as f64) as usize]
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

/// What the receiver and the compass would give to an estimator without any other error.
#[derive(Default)]
struct Floor {
    horizontal_m: Vec<f64>,
    distance_m: Vec<f64>,
    heading_rad: Vec<f64>,
}

impl Floor {
    fn note(&mut self, sample: &Sample) {
        let measurements = sample.measurements;
        if let Some(fix) = &measurements.gnss {
            let p = fix.value.position_m;
            let off = Vector3::from([p.x, p.y, p.z].map(f64::from)) - sample.truth.position_m;
            self.horizontal_m.push(off.xy().norm());
            self.distance_m.push(off.norm());
        }
        if let Some(field) = &measurements.magnetic_ut {
            let v = field.value;
            let there = sample.truth.attitude * Vector3::from([v.x, v.y, v.z].map(f64::from));
            let off = there.y.atan2(there.x);
            // Noise averages out: a mean over about ten seconds is left.
            let last = self.heading_rad.last().copied().unwrap_or(off);
            self.heading_rad.push(last + (off - last) / 500.0);
        }
    }
}

/// Nothing aboard knows better where it is than the receiver, nor which way is north than the compass.
#[test]
fn half_an_hour_on_satellites_errs_as_receiver_and_compass_do() {
    let scenario = shipped("gnss_30_min");
    let rows: Vec<_> = (1..=SEEDS)
        .into_par_iter()
        .map(|seed| {
            let mut floor = Floor::default();
            let (ending, verdict) = judged(&scenario, seed, &mut |sample| floor.note(sample));
            assert_eq!(ending, None, "seed {seed}");
            (seed, verdict, floor)
        })
        .collect();
    for (seed, verdict, mut floor) in rows {
        let receiver_m = share(&mut floor.horizontal_m, 0.95);
        let receiver_all_m = share(&mut floor.distance_m, 0.95);
        let compass_deg = rms(&floor.heading_rad).to_degrees();
        println!(
            "| {seed} | {:.2} | {receiver_m:.2} | {:.2} | {receiver_all_m:.2} | {:.2} | {:.2} | {compass_deg:.2} |",
            verdict.of("horizontal_distance_95_m"),
            verdict.of("distance_95_m"),
            verdict.of("tilt_rms_deg"),
            verdict.of("heading_rms_deg"),
        );
    }
}
