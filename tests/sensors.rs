//! Sensor models: what their data sheets promise, when their samples come, and where they end.
//!
//! Tolerances of statistics are four standard deviations of the estimate, from the number of independent samples.
use control_core::measurement::{Measurements, Stamped};
use nalgebra::{Rotation3, Vector3};
use sim_host::plant::Truth;
use sim_host::sensors::*;
use system_tests::bench::{Bench, G, HZ, all, at_s, deviation, inertial, mean, moving, still};

/// Allan variance of means over `samples` samples.
fn allan_variance(x: &[f64], samples: usize) -> f64 {
    let means: Vec<f64> = x.chunks_exact(samples).map(mean).collect();
    let steps: Vec<f64> = means.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).collect();
    0.5 * mean(&steps)
}

#[test]
fn inertial_noise_and_bias_walk_are_those_of_the_data_sheet() {
    let axes = inertial(&Bench::default(), 3000.0);
    let degree = std::f64::consts::PI / 180.0;
    let gyro = (2.8e-3 * degree, 2e-5, degree / 16.4);
    let accelerometer = (70e-6 * G, 2e-4, G / 2048.0);
    for (sheet, axes) in [(gyro, &axes[..3]), (accelerometer, &axes[3..])] {
        let (density, walk, lsb) = sheet;
        for (span_s, name) in [(1.0, "density"), (30.0, "walk")] {
            // A one-sided density, a walk, and the rounding of the registers, which is nearly white.
            let want = 0.5 * density * density / span_s + walk * walk * span_s / 3.0 + lsb * lsb / 12.0 / (HZ * span_s);
            let samples = (span_s * HZ) as usize;
            let found = mean(&axes.iter().map(|axis| allan_variance(axis, samples)).collect::<Vec<_>>());
            // Neighbouring differences share a mean: their variance is three halves of that of independent ones.
            let count = 3.0 * axes[0].len() as f64 / samples as f64;
            let tolerance = 4.0 * (3.0 / count).sqrt();
            assert!((found / want - 1.0).abs() < tolerance, "{name}: {found:e}, not {want:e} within {tolerance}");
        }
    }
}

#[test]
fn a_calibration_leaves_less_than_what_is_delivered() {
    let biases = |calibrated: bool| {
        let found: Vec<f64> = (0..60)
            .flat_map(|seed| {
                let keys = SensorKeys { calibrated, ..all() };
                let axes = inertial(&Bench { keys, seed, ..Bench::default() }, 2.0);
                axes[..3].iter().map(|axis| mean(axis)).collect::<Vec<_>>()
            })
            .collect();
        deviation(&found).to_degrees()
    };
    // 180 draws: within 4 / √360 = 21 %.
    let (delivered, calibrated) = (biases(false), biases(true));
    assert!((delivered / 0.5 - 1.0).abs() < 0.21, "{delivered} degrees a second");
    assert!((calibrated / 0.05 - 1.0).abs() < 0.21, "{calibrated} degrees a second");
}

#[test]
fn white_noise_of_the_other_sensors_is_that_of_their_parts() {
    // Differences of neighbours: twice the variance of the white part, and nearly nothing of what lasts.
    let white = |x: &[f64]| (0.5 * mean(&x.windows(2).map(|w| (w[1] - w[0]).powi(2)).collect::<Vec<_>>())).sqrt();
    let bench = |keys: SensorKeys| Bench { keys, ..Bench::default() };
    let check = |name: &str, x: Vec<f64>, sigma: f64, lsb: f64| {
        let want = (sigma * sigma + lsb * lsb / 12.0).sqrt();
        let tolerance = 4.0 * (0.75 / x.len() as f64).sqrt() + 0.01;
        let found = white(&x);
        assert!((found / want - 1.0).abs() < tolerance, "{name}: {found}, not {want} within {tolerance}");
    };
    // 12 Pa a metre near the sea.
    let pa_m = 12.01;
    for (part, sigma_pa, lsb_pa) in [(BaroPart::Bmp388, 1.0, 0.33), (BaroPart::Dps310, 0.5, 0.06)] {
        let bench = bench(SensorKeys { baro: Some(part), ..SensorKeys::default() });
        let read = bench.take(200.0, |m| m.baro_altitude_m.map(|x| f64::from(x.value) * pa_m));
        check("baro", read.into_iter().map(|(_, x)| x).collect(), sigma_pa, lsb_pa);
    }
    for (part, sigma_ut, lsb_ut) in [(MagPart::Ist8310, 0.3, 0.3), (MagPart::Qmc5883l, 0.2, 1.0 / 30.0)] {
        let bench = bench(SensorKeys { mag: Some(part), ..SensorKeys::default() });
        let read = bench.take(200.0, |m| m.magnetic_ut.map(|x| f64::from(x.value.y)));
        check("mag", read.into_iter().map(|(_, x)| x).collect(), sigma_ut, lsb_ut);
    }
    let bench = bench(all());
    let gnss = bench.take(600.0, |m| m.gnss.map(|x| f64::from(x.value.velocity_m_s.x)));
    // The lasting part adds its change within a tenth of a second: 0.03² (1 − e^(−0.02)).
    check("gnss", gnss.into_iter().map(|(_, x)| x).collect(), (0.04_f64.powi(2) + 1.8e-5).sqrt(), 0.001);
    let vision = bench.take(60.0, |m| m.vision.map(|x| f64::from(x.value.position_m.y)));
    check("vision", vision.into_iter().map(|(_, x)| x).collect(), 0.001, 1e-4);
    let range = bench.take(200.0, |m| m.range_m.map(|x| f64::from(x.value)));
    check("range", range.into_iter().map(|(_, x)| x).collect(), 0.003 + 0.005 * 2.0, 0.001);
}

/// A sensor, the timing of its part, and the largest error of its values when taken at their stamp.
struct Timed {
    name: &'static str,
    rate_hz: f64,
    latency_s: f64,
    jitter_s: f64,
    error_max: f64,
    /// Stamp and error of a sample, if one has arrived.
    of: fn(&Measurements) -> Option<(f64, f64)>,
}

/// Altitude of a machine that moves.
fn up_m(t_s: f64) -> f64 {
    moving(t_s).altitude_m()
}

/// How far north of where it was at its stamp it is said to be, m.
fn north<T>(sample: &Stamped<T>, north_m: f32) -> (f64, f64) {
    (at_s(sample), f64::from(north_m) - moving(at_s(sample)).position_m.x)
}

const TIMED: [Timed; 8] = [
    Timed {
        name: "vision",
        rate_hz: 100.0,
        latency_s: 0.010,
        jitter_s: 2e-4,
        error_max: 5.0 * (0.001 + 2.0 * 2e-4),
        of: |m| m.vision.map(|x| north(&x, x.value.position_m.x)),
    },
    Timed {
        name: "gnss",
        rate_hz: 10.0,
        latency_s: 0.12,
        jitter_s: 1e-3,
        error_max: 2.0,
        of: |m| m.gnss.map(|x| north(&x, x.value.position_m.x)),
    },
    Timed {
        name: "baro",
        rate_hz: 50.0,
        latency_s: 0.010,
        jitter_s: 1e-4,
        error_max: 1.0,
        of: |m| m.baro_altitude_m.map(|x| (at_s(&x), f64::from(x.value) - up_m(at_s(&x)))),
    },
    Timed {
        name: "mag",
        rate_hz: 50.0,
        latency_s: 0.005,
        jitter_s: 1e-4,
        error_max: 0.0,
        of: |m| m.magnetic_ut.map(|x| (at_s(&x), 0.0)),
    },
    Timed {
        name: "range",
        rate_hz: 30.0,
        latency_s: 0.020,
        jitter_s: 1e-4,
        error_max: 0.15,
        of: |m| m.range_m.map(|x| (at_s(&x), f64::from(x.value) - up_m(at_s(&x)))),
    },
    Timed {
        name: "flow",
        rate_hz: 50.0,
        latency_s: 0.012,
        jitter_s: 1e-4,
        error_max: 0.5,
        // One metre a second to the left turns the image about x.
        of: |m| m.flow.map(|x| (at_s(&x), f64::from(x.value.rate_rad_s[0]) - 1.0 / up_m(at_s(&x)))),
    },
    Timed {
        name: "imu",
        rate_hz: HZ,
        latency_s: 0.0,
        jitter_s: 5e-6,
        error_max: 0.02,
        of: |m| m.imu.map(|x| (at_s(&x), f64::from(x.value.rate_rad_s.x))),
    },
    Timed {
        name: "rotor speed",
        rate_hz: HZ,
        latency_s: 0.001,
        jitter_s: 2e-5,
        error_max: 0.0,
        of: |m| m.rotor_rad_s.map(|x| (at_s(&x), 0.0)),
    },
];

#[test]
fn samples_come_at_their_rate_and_latency_and_are_true_at_their_stamp() {
    let (bench, duration_s) = (Bench { truth: &moving, ..Bench::default() }, 20.0);
    for Timed { name, rate_hz, latency_s, jitter_s, error_max, of } in TIMED {
        let samples = bench.take(duration_s, of);
        let count = samples.len() as f64;
        assert!((count - rate_hz * duration_s).abs() <= 5.0, "{name}: {count} samples");
        for (t_s, (stamp_s, error)) in samples {
            let late_s = t_s - stamp_s - latency_s;
            assert!((-5.0 * jitter_s..1.0 / HZ + 5.0 * jitter_s).contains(&late_s), "{name} at {t_s}: {late_s} s");
            assert!(error.abs() <= error_max, "{name} at {t_s}: {error}");
        }
    }
}

#[test]
fn rate_latency_and_noise_are_the_researchers_to_change() {
    let mut keys = all();
    keys.rate_hz.gnss = Some(5.0);
    keys.latency_s.gnss = Some(0.3);
    keys.noise.gnss = Some(0.0);
    keys.rate_hz.imu = Some(100.0);
    let bench = Bench { keys, truth: &moving, ..Bench::default() };
    let gnss = bench.take(10.0, |m| m.gnss);
    assert!((48..=51).contains(&gnss.len()), "{}", gnss.len());
    for (t_s, fix) in &gnss {
        assert!((t_s - at_s(fix) - 0.3).abs() < 0.007, "{t_s}");
        let north_m = moving(at_s(fix)).position_m.x;
        assert!(
            (f64::from(fix.value.position_m.x) - north_m).abs() < 0.0111 / 2.0 + 2.0 * 0.005,
            "only the stamp errs"
        );
    }
    assert_eq!(bench.take(10.0, |m| m.imu).len(), 1000);
}

#[test]
fn readings_lie_on_the_grids_of_the_registers() {
    let bench = Bench { truth: &moving, rotor_n: [1.2; 4], ..Bench::default() };
    let on_grid = |name: &str, x: f64, lsb: f64, slack: f64| {
        let steps = x / lsb;
        assert!((steps - steps.round()).abs() < slack, "{name}: {x} is {steps} steps");
    };
    bench.run(20.0, |_, m| {
        if let Some(imu) = m.imu {
            on_grid("gyro", f64::from(imu.value.rate_rad_s.y), (1.0 / 16.4_f64).to_radians(), 1e-3);
            on_grid("accelerometer", f64::from(imu.value.specific_force_m_s2.z), G / 2048.0, 1e-3);
        }
        if let Some(field) = m.magnetic_ut {
            on_grid("mag", f64::from(field.value.z), 0.3, 1e-3);
        }
        if let Some(range) = m.range_m {
            on_grid("range", f64::from(range.value), 0.001, 1e-3);
        }
        if let Some(fix) = m.gnss {
            on_grid("gnss", f64::from(fix.value.velocity_m_s.y), 0.001, 1e-3);
            on_grid("gnss", f64::from(fix.value.position_m.x), 0.0111, 1e-2);
        }
        if let Some(battery) = m.battery_v {
            on_grid("battery", f64::from(battery.value), 3.3 * 11.0 / 4096.0, 1e-2);
        }
        if let Some(flow) = m.flow {
            on_grid("flow", f64::from(flow.value.rate_rad_s[1]) * 0.02 * 385.0, 1.0, 1e-3);
        }
        if let Some(altitude) = m.baro_altitude_m {
            let pressure_pa = 101_325.0 * (1.0 - f64::from(altitude.value) * 0.0065 / 288.15).powf(5.255_88);
            // An f32 of 40 m is 4e-6 m: 5e-5 Pa.
            on_grid("baro", pressure_pa, 0.33, 1e-3);
        }
    });
}

#[test]
fn readings_beyond_the_range_stay_at_its_end() {
    let wild = |_: f64| Truth {
        velocity_m_s: Vector3::new(60.0, 0.0, 0.0),
        rate_rad_s: Vector3::new(0.0, 40.0, 0.0),
        specific_force_m_s2: Vector3::new(0.0, 0.0, -300.0),
        ..still()
    };
    let mut first = None;
    let bench = Bench { truth: &wild, ..Bench::default() };
    bench.run(0.05, |_, m| first = first.or(m.imu));
    let imu = first.expect("a sample at the first tick").value;
    assert!((f64::from(imu.rate_rad_s.y) - 2000.0_f64.to_radians()).abs() < 1e-3, "{}", imu.rate_rad_s.y);
    assert!((f64::from(imu.specific_force_m_s2.z) + 16.0 * G).abs() < 1e-3, "{}", imu.specific_force_m_s2.z);
    let flow = bench.take(0.5, |m| m.flow);
    let (_, last) = flow.last().expect("a sample");
    assert!((last.value.rate_rad_s[1] - 7.4).abs() < 0.07, "{}", last.value.rate_rad_s[1]);
}

/// From rest, turns about a tilted axis at a varying rate while it is shaken about.
fn tumbling(t_s: f64) -> Truth {
    let axis = nalgebra::Unit::new_normalize(Vector3::new(0.5, -0.3, 1.0));
    let (sin, cos) = t_s.sin_cos();
    let attitude = Rotation3::from_axis_angle(&axis, 3.0 * (t_s - sin)).into_inner();
    let way = Vector3::new(2.0, 1.0, -0.5);
    let acceleration = way * (2.0 * sin * cos);
    Truth {
        velocity_m_s: way * (sin * sin),
        attitude,
        rate_rad_s: axis.into_inner() * (3.0 * (1.0 - cos)),
        specific_force_m_s2: attitude.transpose() * (acceleration - Vector3::z() * G),
        ..still()
    }
}

/// What the inertial unit says adds up to where the machine went: nothing is lost between ticks.
#[test]
fn without_noise_inertial_samples_integrate_to_the_truth() {
    let mut keys = all();
    keys.noise.imu = Some(0.0);
    let bench = Bench { keys, truth: &tumbling, ..Bench::default() };
    let (mut attitude, mut velocity, mut end_s) = (tumbling(0.0).attitude, tumbling(0.0).velocity_m_s, 0.0);
    bench.run(20.0, |t_s, m| {
        let imu = m.imu.expect("a sample each tick").value;
        // The first is of no span.
        if t_s > 0.0 {
            let (w, a) = (imu.rate_rad_s, imu.specific_force_m_s2);
            let turn = Vector3::new(w.x, w.y, w.z).map(f64::from) / HZ;
            let half = attitude * Rotation3::new(turn * 0.5).into_inner();
            velocity += (half * Vector3::new(a.x, a.y, a.z).map(f64::from) + Vector3::z() * G) / HZ;
            attitude *= Rotation3::new(turn).into_inner();
        }
        end_s = t_s;
    });
    // A second-order low-pass at 200 Hz, bilinear at 500 Hz, is late by √2 / (2 · 500 Hz · tan 0.4 π).
    let late = tumbling(end_s - 0.46e-3);
    let error_rad = Rotation3::from_matrix_unchecked(attitude.transpose() * late.attitude).angle();
    // 10 000 roundings of a register are 6e-5 rad; an attitude that wrong for 20 s is 12 mm/s.
    assert!(error_rad < 3e-4, "{error_rad} rad");
    let error_m_s = (velocity - late.velocity_m_s).norm();
    assert!(error_m_s < 0.02, "{error_m_s} m/s");
}

#[test]
fn seeds_repeat_to_the_bit_and_differ_from_each_other() {
    let bits = |seed: u64| {
        let mut rows = Vec::new();
        Bench { seed, ..Bench::default() }.run(5.0, |_, m| rows.push(format!("{m:?}")));
        rows
    };
    assert_eq!(bits(7), bits(7));
    assert_ne!(bits(7), bits(8));
}

#[test]
fn one_sensor_more_leaves_the_others_as_they_were() {
    let alone = SensorKeys { imu: Some(ImuPart::Icm42688p), gnss: Some(GnssPart::M10), ..SensorKeys::default() };
    let both = SensorKeys { imus: 2, baros: 2, ..all() };
    let read = |keys: SensorKeys| Bench { keys, ..Bench::default() }.take(5.0, |m| Some((m.imu, m.gnss)));
    assert_eq!(read(alone), read(both));
}

#[test]
fn a_second_unit_errs_by_itself() {
    let bench = Bench { keys: SensorKeys { imus: 2, baros: 2, ..all() }, ..Bench::default() };
    let pairs = bench.take(20.0, |m| Some((m.imu?.value.rate_rad_s, m.imu_second?.value.rate_rad_s)));
    assert_eq!(pairs.len(), 10_000);
    let differ = pairs.iter().filter(|(_, (a, b))| a != b).count();
    assert!(differ > 9_000, "{differ}");
    assert!(bench.take(20.0, |m| m.baro_second_altitude_m).len() >= 999);
    assert!(Bench::default().take(1.0, |m| m.imu_second).is_empty(), "one unit unless told");
}

#[test]
fn the_command_prints_how_wrong_each_sensor_of_a_flight_was() {
    let result = system_tests::sim_host(&["sensors", "scenarios/sensors.toml"]);
    let table = String::from_utf8(result.stdout).expect("text");
    let row = |name: &str| -> Vec<f64> {
        let line = table.lines().find(|line| line.contains(&format!(" {name} "))).expect("a row");
        line.split_whitespace().filter_map(|cell| cell.parse().ok()).collect()
    };
    let [rate_hz, late_ms, gap_ms, mean, deviation, _] = row("vision north")[..] else { panic!("{table}") };
    assert!((rate_hz - 100.0).abs() < 0.1 && (late_ms - 10.0).abs() < 2.0 && gap_ms < 20.0, "{table}");
    assert!(mean.abs() < 1e-4 && (deviation - 0.001).abs() < 1e-4, "a millimetre of noise: {table}");
    assert_eq!(table.lines().filter(|line| line.contains("rad/s")).count(), 7, "{table}");

    let without = system_tests::sim_host(&["sensors", "scenarios/flight.toml"]);
    let line = String::from_utf8(without.stderr).expect("text");
    assert_eq!(without.status.code(), Some(2));
    assert!(line.contains("scenarios/flight.toml: sensors: nothing: must be a table that names parts"), "{line}");
}

#[test]
fn the_page_and_the_schema_have_every_part() {
    let page = std::fs::read_to_string(system_tests::root().join("docs/sensors.md")).expect("the page");
    let schema = system_tests::sim_host(&["schema"]);
    let schema = String::from_utf8(schema.stdout).expect("text");
    for part in [
        "icm42688p",
        "bmp388",
        "dps310",
        "qmc5883l",
        "ist8310",
        "m10",
        "f9p",
        "f9p_rtk",
        "pmw3901",
        "vl53l1x",
        "mocap",
        "dshot",
    ] {
        assert!(page.contains(&format!("`{part}`")) && schema.contains(&format!("\"{part}\"")), "{part}");
    }
}
