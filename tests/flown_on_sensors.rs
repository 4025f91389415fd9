//! The controller on its own estimate: the faults of truth-fed flights again, with motion capture, on satellites, on optical flow.
//!
//! `cargo test --release -p system-tests --test flown_on_sensors -- --nocapture` prints the tables of docs/estimation.md.
use control_core::modes::Mode;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use sim_host::aboard::{Account, Consistency, Verdict, consistency};
use sim_host::controllers::ControllerName;
use sim_host::flight::{Ending, Flight, NumberFormat, Sample};
use sim_host::metrics::Flown;
use sim_host::scenario::Scenario;
use sim_host::sensors::GnssPart;
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
    let (truth_mm, truth_worst_mm) =
        deviation_mm(&fly(&shipped("single_rotor_100"), ControllerName::Default, 1, SEEDS));
    println!("| `single_rotor_100` | truth | {truth_mm:.1} | {truth_worst_mm:.1} |");
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

/// 15 s into the loss of 40 % of a rotor, and in a steady wind that drags with a tenth of the weight, the estimator's biases are beside
/// those of a calm flight of the same sensors without a fault.
#[test]
fn wind_and_a_weak_rotor_are_not_taken_for_biases() {
    for kit in KITS {
        let mut weak = on("single_rotor_40", kit);
        weak.duration_s = 50.0;
        weak.vehicle.linear_drag_n_s_m = 0.1;
        let mut calm = weak.clone();
        calm.fault.clear();
        let mut windy = weak.clone();
        windy.wind.mean_ned_m_s = [4.0, 3.0, 0.0];
        let rows: Vec<_> = (1..=SEEDS)
            .into_par_iter()
            .map(|seed| [&calm, &weak, &windy].map(|scenario| biases(scenario, seed)))
            .collect();
        for (seed, [(_, calm, _), (_, weak, sigma), (verdict, windy, windy_sigma)]) in (1..).zip(rows) {
            let moved = |half: usize, to: &[Vector3<f64>; 2], sigma: &[Vector3<f64>; 2]| {
                (to[half] - calm[half]).component_div(&sigma[half]).amax()
            };
            let fault = [0, 1].map(|half| moved(half, &weak, &sigma));
            let wind = [0, 1].map(|half| moved(half, &windy, &windy_sigma));
            let wrong = ["gyro_bias_sigmas_end", "accelerometer_bias_sigmas_end"].map(|name| verdict.of(name));
            let moved_m_s2 = (windy[1] - calm[1]).norm();
            let wrong_m_s2 = verdict.of("accelerometer_bias_error_end_m_s2");
            let said = format!(
                "{kit}, seed {seed}: fault {fault:.2?} σ, wind {wind:.2?} σ, {moved_m_s2:.3} m/s²; from the truth {wrong:.2?} σ, {wrong_m_s2:.3} m/s²"
            );
            println!("{said}");
            assert!(fault[0] < 1.0 && fault[1] < 1.0, "{said}");
            assert!(wrong[0] < 3.0, "{said}");
            // Of the wind's 1 m/s².
            assert!(moved_m_s2 < 0.08, "{said}");
            // Markers that are askew tilt gravity: three times 3 mrad of it.
            let right = if kit == "mocap" { wrong_m_s2 < 0.09 } else { wrong[1] < 3.0 };
            assert!(right, "{said}");
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

/// Flies `sorties/altitude_lost` climbing until `climbs_until_s` and all after that as much later; gives the height from which it descends
/// without altitude, m, and the speed at which it meets the ground, m/s.
fn blind_descent(climbs_until_s: f64, seed: u64) -> (f64, f64) {
    let mut scenario = shipped("sorties/altitude_lost");
    let later_s = climbs_until_s - scenario.event[3].at_s;
    for event in &mut scenario.event[3..] {
        event.at_s += later_s;
    }
    scenario.sensor_fault[0].from_s += later_s;
    scenario.sensor_fault[0].until_s += later_s;
    scenario.duration_s += later_s;
    let (mut height_m, mut speed_m_s) = (None, 0.0);
    let (ending, _) = judged(&scenario, seed, &mut |sample| {
        let command = sample.decision.expect("a sortie").command;
        if command.armed && command.mode == Mode::Descend {
            height_m = height_m.or(Some(sample.truth.altitude_m()));
            // Just above its feet.
            if sample.truth.altitude_m() > 0.06 {
                speed_m_s = sample.truth.velocity_m_s.z;
            }
        }
    });
    assert_eq!(ending, None, "seed {seed}");
    (height_m.expect("it descends"), speed_m_s)
}

#[test]
fn a_descent_without_altitude_meets_the_ground_slower_than_its_feet_bear() {
    for climbs_until_s in [7.6, 14.0] {
        let flown: Vec<_> = (1..=2 * SEEDS).into_par_iter().map(|seed| blind_descent(climbs_until_s, seed)).collect();
        let height_m = flown.iter().map(|(height_m, _)| height_m).sum::<f64>() / flown.len() as f64;
        let (least_m_s, most_m_s) =
            flown.iter().fold((f64::MAX, f64::MIN), |(low, high), &(_, m_s)| (low.min(m_s), high.max(m_s)));
        println!("| {height_m:.1} | {least_m_s:.2} | {most_m_s:.2} |");
        assert!(most_m_s < 2.0, "from {height_m} m at {most_m_s} m/s");
    }
}

/// What the receiver and the compass would give to an estimator without any other error.
#[derive(Default)]
struct Floor {
    horizontal_m: Vec<f64>,
    /// How far the machine is from its setpoint, each axis.
    strayed_m: [Vec<f64>; 3],
    heading_rad: Vec<f64>,
    /// The same by a compass that is levelled by the estimate.
    levelled_rad: Vec<f64>,
}

/// Adds to `means` the mean of an angle over about ten seconds: noise averages out.
fn averaged(means: &mut Vec<f64>, angle_rad: f64) {
    let last = means.last().copied().unwrap_or(angle_rad);
    means.push(last + (angle_rad - last) / 500.0);
}

impl Floor {
    fn note(&mut self, sample: &Sample) {
        let measurements = sample.measurements;
        if let Some(fix) = &measurements.gnss {
            let p = fix.value.position_m;
            let off = Vector3::from([p.x, p.y, p.z].map(f64::from)) - sample.truth.position_m;
            self.horizontal_m.push(off.xy().norm());
            let [north_m, east_m, altitude_m] = sample.target.position_m;
            let strayed = sample.truth.position_m - Vector3::new(north_m, east_m, -altitude_m);
            for (all, m) in self.strayed_m.iter_mut().zip(strayed.iter()) {
                all.push(m.abs());
            }
        }
        if let Some(field) = &measurements.magnetic_ut {
            let v = field.value;
            let measured = Vector3::from([v.x, v.y, v.z].map(f64::from));
            let north_of = |attitude: &Matrix3<f64>| {
                let there = attitude * measured;
                there.y.atan2(there.x)
            };
            averaged(&mut self.heading_rad, north_of(&sample.truth.attitude));
            let rows = sample.estimate.expect("it flies on one").attitude.rows;
            let believed = Matrix3::from_fn(|i, j| f64::from(rows[i][j]));
            let turned = believed * sample.truth.attitude.transpose();
            let heading_error = (turned[(1, 0)] - turned[(0, 1)]).atan2(turned[(0, 0)] + turned[(1, 1)]);
            averaged(&mut self.levelled_rad, north_of(&believed) - heading_error);
        }
    }
}

/// Half an hour in the wind, one flight a seed, on a receiver: what was flown, and what the sensors err by themselves.
fn half_hours_on(part: GnssPart) -> Vec<(u64, Verdict, Floor)> {
    let mut scenario = shipped("gnss_30_min");
    scenario.sensors.as_mut().expect("it has sensors").gnss = Some(part);
    (1..=SEEDS)
        .into_par_iter()
        .map(|seed| {
            let mut floor = Floor::default();
            let (ending, verdict) = judged(&scenario, seed, &mut |sample| floor.note(sample));
            assert_eq!(ending, None, "{part:?}, seed {seed}");
            (seed, verdict, floor)
        })
        .collect()
}

/// Nothing aboard knows better where it is than the receiver, nor which way is north than the compass; a calibrated one is good for half a degree.
#[test]
fn half_an_hour_on_satellites_errs_as_receiver_and_compass_do() {
    for (part, beyond_max) in [(GnssPart::M10, 4), (GnssPart::F9p, 2), (GnssPart::F9pRtk, 0)] {
        println!("{part:?}");
        let rows = half_hours_on(part);
        let nees: Vec<&[f64]> = rows.iter().map(|(_, verdict, _)| verdict.nees.as_slice()).collect();
        let Consistency { mean, band, inside } = consistency(&nees).expect("they flew");
        let mut beyond = 0;
        for (seed, verdict, mut floor) in rows {
            let receiver_m = share(&mut floor.horizontal_m, 0.95);
            let [north_m, east_m, altitude_m] = floor.strayed_m.each_mut().map(|strayed_m| share(strayed_m, 0.95));
            let axis_m = north_m.max(east_m);
            let compass_deg = rms(&floor.heading_rad).to_degrees();
            let levelled_deg = rms(&floor.levelled_rad).to_degrees();
            let hover_m = verdict.of("horizontal_distance_95_m");
            println!(
                "| {seed} | {hover_m:.2} | {receiver_m:.2} | {axis_m:.2} | {altitude_m:.2} | {:.2} | {:.2} | {:.2} | {levelled_deg:.2} | {compass_deg:.2} | {:.1} |",
                verdict.of("tilt_rms_deg"),
                verdict.of("heading_rms_deg"),
                verdict.of("attitude_rms_deg"),
                verdict.of("nees_mean"),
            );
            beyond += u32::from(hover_m > 1.5);
            assert!(verdict.lost.is_empty(), "{part:?}, seed {seed}: {:?}", verdict.lost);
            assert!(hover_m < receiver_m + if part == GnssPart::F9pRtk { 0.9 } else { 0.35 }, "{part:?}, seed {seed}");
            assert!(verdict.of("attitude_rms_deg") < 0.5, "{part:?}, seed {seed}");
            assert!(verdict.of("heading_rms_deg") < levelled_deg + 0.3, "{part:?}, seed {seed}");
        }
        println!("NEES {mean:.1}, {:.1} to {:.1} at {:.0} % of the times", band.0, band.1, 100.0 * inside);
        assert!(beyond <= beyond_max, "{part:?}: {beyond} beyond 1.5 m");
        // An RTK receiver is better than it is taken for.
        assert!(part == GnssPart::F9pRtk || (band.0..band.1).contains(&mean), "{part:?}: NEES {mean}");
    }
}
