//! Sensor models: what their data sheets promise, when their samples come, what disturbs them, and what faults do to them.
//!
//! Tolerances of statistics are four standard deviations of the estimate, from the number of independent samples.
use control_core::measurement::{Measurements, Stamped};
use nalgebra::{Matrix3, Rotation3, Vector3};
use sim_host::actuators::Vibration;
use sim_host::fault::sensors::{Sensor, SensorAxis, SensorFault, SensorFaultKind};
use sim_host::fault::{Intermittent, Profile, Ramp};
use sim_host::plant::Truth;
use sim_host::scenario::Scenario;
use sim_host::sensors::*;
use sim_host::vehicle::{AirframeName, Vehicle, VehicleKeys};
use sim_host::wind::Gust;
use std::path::Path;

const HZ: f64 = 500.0;
const G: f64 = 9.81;

/// Every part there is.
fn all() -> SensorKeys {
    SensorKeys {
        imu: Some(ImuPart::Icm42688p),
        baro: Some(BaroPart::Bmp388),
        mag: Some(MagPart::Ist8310),
        gnss: Some(GnssPart::M10),
        range: Some(RangePart::Vl53l1x),
        flow: Some(FlowPart::Pmw3901),
        vision: Some(VisionPart::Mocap),
        rotor_speed: Some(RotorSpeedPart::Dshot),
        battery: Some(BatteryKeys::default()),
        ..SensorKeys::default()
    }
}

/// Level and still, 2 m above the origin.
fn still() -> Truth {
    Truth {
        position_m: Vector3::new(0.0, 0.0, -2.0),
        velocity_m_s: Vector3::zeros(),
        attitude: Matrix3::identity(),
        rate_rad_s: Vector3::zeros(),
        specific_force_m_s2: Vector3::new(0.0, 0.0, -G),
        thrust_n: [0.0; 4],
        impact_m_s: 0.0,
        touching: false,
    }
}

fn vehicle() -> Vehicle {
    Vehicle::new(AirframeName::Os4, &VehicleKeys::default())
}

/// What a bench does to the sensors.
struct Bench<'a> {
    keys: SensorKeys,
    faults: &'a [SensorFault],
    seed: u64,
    rotor_n: [f64; 4],
    vibration: &'a dyn Fn(f64) -> Vibration,
    truth: &'a dyn Fn(f64) -> Truth,
}

impl Default for Bench<'_> {
    fn default() -> Self {
        let (vibration, truth) = (&|_: f64| Vibration::default(), &|_: f64| still());
        Bench { keys: all(), faults: &[], seed: 1, rotor_n: [0.0; 4], vibration, truth }
    }
}

impl Bench<'_> {
    /// Runs for `duration_s` above ground at altitude 0; `see` gets the time of each tick and what arrived.
    fn run(&self, duration_s: f64, mut see: impl FnMut(f64, &Measurements)) {
        let vehicle = vehicle();
        let carrier = Carrier { vehicle: &vehicle, ground_altitude_m: Some(0.0), control_hz: HZ, seed: self.seed };
        let mut suite = SensorSuite::new(&self.keys, self.faults, &carrier);
        for tick in 0..(duration_s * HZ) as u32 {
            let t_s = f64::from(tick) / HZ;
            let (truth, vibration) = ((self.truth)(t_s), (self.vibration)(t_s));
            let world =
                World { t_s, truth: &truth, vibration: &vibration, rotor_n: &self.rotor_n, gust: &Gust::default() };
            see(t_s, &suite.sample(&world));
        }
    }

    /// What `pick` picks of all that arrives, with its time of arrival.
    fn take<T>(&self, duration_s: f64, pick: impl Fn(&Measurements) -> Option<T>) -> Vec<(f64, T)> {
        let mut taken = Vec::new();
        self.run(duration_s, |t_s, m| taken.extend(pick(m).map(|x| (t_s, x))));
        taken
    }
}

fn at_s<T>(sample: &Stamped<T>) -> f64 {
    sample.time_us as f64 * 1e-6
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len() as f64
}

fn deviation(x: &[f64]) -> f64 {
    let middle = mean(x);
    mean(&x.iter().map(|x| (x - middle) * (x - middle)).collect::<Vec<_>>()).sqrt()
}

/// Allan variance of means over `samples` samples.
fn allan_variance(x: &[f64], samples: usize) -> f64 {
    let means: Vec<f64> = x.chunks_exact(samples).map(mean).collect();
    let steps: Vec<f64> = means.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).collect();
    0.5 * mean(&steps)
}

/// What a bench reads of the inertial unit: three axes of the gyro, then three of the accelerometer.
fn inertial(bench: &Bench, duration_s: f64) -> [Vec<f64>; 6] {
    let mut axes: [Vec<f64>; 6] = Default::default();
    bench.run(duration_s, |_, m| {
        let imu = m.imu.expect("a sample each tick").value;
        let (w, a) = (imu.rate_rad_s, imu.specific_force_m_s2);
        for (axis, x) in axes.iter_mut().zip([w.x, w.y, w.z, a.x, a.y, a.z]) {
            axis.push(f64::from(x));
        }
    });
    axes
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

/// Moves north, east and up at once, without turning.
fn moving(t_s: f64) -> Truth {
    let velocity_m_s = Vector3::new(2.0, -1.0, -0.1);
    Truth { position_m: Vector3::new(0.0, 0.0, -1.0) + velocity_m_s * t_s, velocity_m_s, ..still() }
}

#[test]
fn samples_come_at_their_rate_and_latency_and_are_true_at_their_stamp() {
    let bench = Bench { truth: &moving, ..Bench::default() };
    let duration_s = 20.0;
    /// Arrivals, by stamp, of something with what it should be then.
    struct Seen {
        name: &'static str,
        rate_hz: f64,
        latency_s: f64,
        jitter_s: f64,
        /// Time of arrival, stamp, error of the value.
        rows: Vec<(f64, f64, f64)>,
        error_max: f64,
    }
    let rows = |of: &dyn Fn(&Measurements) -> Option<(f64, f64)>| -> Vec<(f64, f64, f64)> {
        bench.take(duration_s, of).into_iter().map(|(t_s, (stamp_s, error))| (t_s, stamp_s, error)).collect()
    };
    let north = |stamp_s: f64| moving(stamp_s).position_m.x;
    let up = |stamp_s: f64| moving(stamp_s).altitude_m();
    for Seen { name, rate_hz, latency_s, jitter_s, rows, error_max } in [
        Seen {
            name: "vision",
            rate_hz: 100.0,
            latency_s: 0.010,
            jitter_s: 2e-4,
            rows: rows(&|m| m.vision.map(|x| (at_s(&x), f64::from(x.value.position_m.x) - north(at_s(&x))))),
            error_max: 5.0 * (0.001 + 2.0 * 2e-4),
        },
        Seen {
            name: "gnss",
            rate_hz: 10.0,
            latency_s: 0.12,
            jitter_s: 1e-3,
            rows: rows(&|m| m.gnss.map(|x| (at_s(&x), f64::from(x.value.position_m.x) - north(at_s(&x))))),
            error_max: 2.0,
        },
        Seen {
            name: "baro",
            rate_hz: 50.0,
            latency_s: 0.010,
            jitter_s: 1e-4,
            rows: rows(&|m| m.baro_altitude_m.map(|x| (at_s(&x), f64::from(x.value) - up(at_s(&x))))),
            error_max: 1.0,
        },
        Seen {
            name: "mag",
            rate_hz: 50.0,
            latency_s: 0.005,
            jitter_s: 1e-4,
            rows: rows(&|m| m.magnetic_ut.map(|x| (at_s(&x), 0.0))),
            error_max: 0.0,
        },
        Seen {
            name: "range",
            rate_hz: 30.0,
            latency_s: 0.020,
            jitter_s: 1e-4,
            rows: rows(&|m| m.range_m.map(|x| (at_s(&x), f64::from(x.value) - up(at_s(&x))))),
            error_max: 0.15,
        },
        Seen {
            name: "flow",
            rate_hz: 50.0,
            latency_s: 0.012,
            jitter_s: 1e-4,
            rows: rows(&|m| m.flow.map(|x| (at_s(&x), f64::from(x.value.rate_rad_s[0]) - 1.0 / up(at_s(&x))))),
            error_max: 0.5,
        },
        Seen {
            name: "imu",
            rate_hz: HZ,
            latency_s: 0.0,
            jitter_s: 5e-6,
            rows: rows(&|m| m.imu.map(|x| (at_s(&x), f64::from(x.value.rate_rad_s.x)))),
            error_max: 0.02,
        },
        Seen {
            name: "rotor speed",
            rate_hz: HZ,
            latency_s: 0.001,
            jitter_s: 2e-5,
            rows: rows(&|m| m.rotor_rad_s.map(|x| (at_s(&x), 0.0))),
            error_max: 0.0,
        },
    ] {
        let count = rows.len() as f64;
        assert!((count - rate_hz * duration_s).abs() <= 5.0, "{name}: {count} samples");
        for (t_s, stamp_s, error) in rows {
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

#[test]
fn range_and_flow_have_their_limits_of_height_and_light() {
    let at = |height_m: f64, light_lux: f64| {
        let truth = move |_: f64| Truth { position_m: Vector3::new(0.0, 0.0, -height_m), ..still() };
        let bench = Bench { truth: &truth, keys: SensorKeys { light_lux, ..all() }, ..Bench::default() };
        let flow = bench.take(2.0, |m| m.flow);
        (
            bench.take(2.0, |m| m.range_m).len(),
            mean(&flow.iter().map(|(_, x)| f64::from(x.value.quality)).collect::<Vec<_>>()),
        )
    };
    for (why, height_m, light_lux, range, quality) in [
        ("a room", 2.0, 500.0, true, 1.0),
        ("beyond the range", 4.0, 500.0, false, 1.0),
        ("too near for either", 0.03, 500.0, false, 0.0),
        ("the sun shortens the range", 2.0, 1e5, false, 1.0),
        ("but not to nothing", 0.6, 1e5, true, 1.0),
        ("dusk halves the image", 2.0, 130.0, true, 0.5),
        ("in the dark there is none", 2.0, 20.0, true, 0.0),
    ] {
        let (ranges, found) = at(height_m, light_lux);
        assert_eq!(ranges > 50, range, "{why}: {ranges} ranges");
        assert!((found - quality).abs() < 1e-6, "{why}: {found}");
    }
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

fn fault(sensor: Sensor, kind: SensorFaultKind) -> SensorFault {
    SensorFault { kind, sensor, unit: 1, axis: None, from_s: 5.0, until_s: 15.0, profile: Profile::Step }
}

/// Which samples of `name` a fault leaves of 20 s, with the readings of a healthy sensor for each.
fn faulty(faults: &[SensorFault], of: &dyn Fn(&Measurements) -> Option<(u64, f64)>) -> Vec<(f64, f64, f64)> {
    let keys = SensorKeys { imus: 2, ..all() };
    let healthy = Bench { keys: keys.clone(), truth: &moving, ..Bench::default() }.take(20.0, of);
    let faulty = Bench { keys, faults, truth: &moving, ..Bench::default() }.take(20.0, of);
    // Faults draw from streams of their own: stamps are the same, and say which sample is which.
    faulty
        .into_iter()
        .map(|(t_s, (stamp, read))| {
            let same = healthy.iter().find(|(_, (healthy, _))| *healthy == stamp);
            (t_s, read, same.expect("the healthy sensor has it too").1.1)
        })
        .collect()
}

fn baro(m: &Measurements) -> Option<(u64, f64)> {
    m.baro_altitude_m.map(|x| (x.time_us, f64::from(x.value)))
}

fn during(rows: &[(f64, f64, f64)]) -> impl Iterator<Item = &(f64, f64, f64)> {
    rows.iter().filter(|(t_s, ..)| (5.02..15.0).contains(t_s))
}

#[test]
fn each_fault_does_what_it_says_and_ends() {
    use SensorFaultKind::{Bias, Delayed, Drift, Garbage, Intermittent, Off, Spikes, Stuck};
    let rows = |kind| faulty(&[fault(Sensor::Baro, kind)], &baro);
    let untouched = |rows: &[(f64, f64, f64)], why: &str| {
        for (t_s, read, healthy) in rows.iter().filter(|(t_s, ..)| !(5.0..15.02).contains(t_s)) {
            assert_eq!(read, healthy, "{why} at {t_s}");
        }
        assert!(rows.iter().any(|(t_s, ..)| *t_s > 19.9) && rows.iter().any(|(t_s, ..)| *t_s < 0.1), "{why}");
    };

    let off = rows(Off);
    untouched(&off, "off");
    assert_eq!(during(&off).count(), 0);

    let stuck = rows(Stuck);
    untouched(&stuck, "stuck");
    let held: Vec<_> = during(&stuck).map(|(_, read, _)| *read).collect();
    assert!(held.len() > 490 && held.iter().all(|read| *read == held[0]), "freshly stamped, and the same");

    let biased = rows(Bias { offset: 3.0 });
    untouched(&biased, "bias");
    assert!(during(&biased).all(|(_, read, healthy)| (read - healthy - 3.0).abs() < 1e-5));

    let drifting = rows(Drift { rate: 0.5 });
    untouched(&drifting, "drift");
    for (t_s, read, healthy) in during(&drifting) {
        assert!((read - healthy - 0.5 * (t_s - 5.0)).abs() < 0.5 * 0.03, "{t_s}: {}", read - healthy);
    }

    let garbage = rows(Garbage);
    untouched(&garbage, "garbage");
    let read: Vec<_> = during(&garbage).map(|(_, read, _)| *read).collect();
    // Evenly over 300 to 1250 hPa, −1786 m to 9164 m: 500 draws, four standard deviations.
    assert!((mean(&read) - 3689.0).abs() < 4.0 * 3161.0 / 500.0_f64.sqrt(), "{}", mean(&read));
    assert!((deviation(&read) / 3161.0 - 1.0).abs() < 0.1, "{}", deviation(&read));

    let spiky = rows(Spikes { size: 20.0, rate_1_s: 5.0 });
    untouched(&spiky, "spikes");
    let spikes: Vec<_> = during(&spiky).map(|(_, read, healthy)| read - healthy).filter(|x| *x != 0.0).collect();
    assert!(spikes.iter().all(|x| (x.abs() - 20.0).abs() < 1e-5));
    // 48 expected of 50 a second at most: four standard deviations.
    assert!((22..75).contains(&spikes.len()), "{}", spikes.len());
    assert!(spikes.iter().any(|x| *x > 0.0) && spikes.iter().any(|x| *x < 0.0));

    let late = rows(Delayed { delay_s: 0.4 });
    untouched(&late, "delayed");
    for pair in during(&late).collect::<Vec<_>>().windows(21).skip(20) {
        // Twenty samples at 50 Hz are 0.4 s.
        assert_eq!(pair[20].1, pair[0].2, "at {}", pair[20].0);
    }

    let loose = rows(Intermittent { loss: 0.3 });
    untouched(&loose, "intermittent");
    let left = during(&loose).count();
    assert!((left as f64 - 0.7 * 499.0).abs() < 4.0 * (0.21_f64 * 499.0).sqrt(), "{left}");
    assert!(during(&loose).all(|(_, read, healthy)| read == healthy));
}

#[test]
fn every_sensor_can_be_switched_off_alone() {
    let counts = |faults: &[SensorFault]| {
        let mut counts = [0; 11];
        Bench { keys: SensorKeys { imus: 2, baros: 2, ..all() }, faults, ..Bench::default() }.run(20.0, |t_s, m| {
            let there = [
                m.imu.is_some(),
                m.imu_second.is_some(),
                m.baro_altitude_m.is_some(),
                m.baro_second_altitude_m.is_some(),
                m.magnetic_ut.is_some(),
                m.gnss.is_some(),
                m.range_m.is_some(),
                m.flow.is_some(),
                m.vision.is_some(),
                m.rotor_rad_s.is_some(),
                m.battery_v.is_some(),
            ];
            if (5.2..15.0).contains(&t_s) {
                counts.iter_mut().zip(there).for_each(|(count, there)| *count += u32::from(there));
            }
        });
        counts
    };
    let healthy = counts(&[]);
    assert!(healthy.iter().all(|count| *count > 90), "{healthy:?}");
    let off = |sensor, unit| SensorFault { unit, ..fault(sensor, SensorFaultKind::Off) };
    for (place, broken) in [
        (0, off(Sensor::Gyro, 1)),
        (0, off(Sensor::Accelerometer, 1)),
        (1, off(Sensor::Gyro, 2)),
        (2, off(Sensor::Baro, 1)),
        (3, off(Sensor::Baro, 2)),
        (4, off(Sensor::Mag, 1)),
        (5, off(Sensor::Gnss, 1)),
        (6, off(Sensor::Range, 1)),
        (7, off(Sensor::Flow, 1)),
        (8, off(Sensor::Vision, 1)),
        (9, off(Sensor::RotorSpeed, 1)),
        (10, off(Sensor::Battery, 1)),
    ] {
        let mut want = healthy;
        want[place] = 0;
        assert_eq!(counts(&[broken]), want, "{broken:?}");
    }
}

#[test]
fn an_axis_fails_by_itself() {
    let bias = SensorFaultKind::Bias { offset: 0.2 };
    let one = SensorFault { axis: Some(SensorAxis::Z), ..fault(Sensor::Gyro, bias) };
    let rate = |axis: usize| {
        move |m: &Measurements| {
            let w = m.imu?.value.rate_rad_s;
            Some((m.imu?.time_us, f64::from([w.x, w.y, w.z][axis])))
        }
    };
    let shift = |axis| {
        let rows = faulty(&[one], &rate(axis));
        mean(&during(&rows).map(|(_, read, healthy)| read - healthy).collect::<Vec<_>>())
    };
    assert!((shift(2) - 0.2).abs() < 1e-4 && shift(0) == 0.0 && shift(1) == 0.0);
    let force = |m: &Measurements| Some((m.imu?.time_us, f64::from(m.imu?.value.specific_force_m_s2.z)));
    assert!(faulty(&[one], &force).iter().all(|(_, read, healthy)| read == healthy), "nor the accelerometer");
}

#[test]
fn faults_grow_and_flicker_as_their_profiles_say() {
    let bias = fault(Sensor::Baro, SensorFaultKind::Bias { offset: 4.0 });
    let ramp = SensorFault { profile: Profile::Ramp(Ramp { rise_s: 5.0 }), ..bias };
    for (t_s, read, healthy) in during(&faulty(&[ramp], &baro)) {
        let want = 4.0 * ((t_s - 5.0) / 5.0).min(1.0);
        assert!((read - healthy - want).abs() < 4.0 / 5.0 * 0.03, "{t_s}");
    }
    let flicker = Profile::Intermittent(Intermittent { on_mean_s: 0.5, off_mean_s: 0.5 });
    let rows = faulty(&[SensorFault { profile: flicker, ..bias }], &baro);
    let on = during(&rows).filter(|(_, read, healthy)| read != healthy).count();
    assert!((100..400).contains(&on), "{on} of 500");
}

#[test]
fn drop_outs_of_satellites_last_and_return_as_stated_and_say_so() {
    let sky = SkyKeys { outage_rate_1_s: 0.1, outage_s: 5.0, ..SkyKeys::default() };
    let bench = Bench { keys: SensorKeys { sky, ..all() }, truth: &moving, ..Bench::default() };
    let fixes = bench.take(9000.0, |m| m.gnss);
    let lost = fixes.iter().filter(|(_, fix)| !fix.value.fixed).count() as f64 / fixes.len() as f64;
    // 600 cycles of 10 s with and 5 s without: the share is within four times 0.33 √(2/600) · 0.67.
    assert!((lost - 1.0 / 3.0).abs() < 0.05, "{lost}");
    assert!(fixes.iter().all(|(_, fix)| fix.value.fixed == (fix.value.horizontal_m < 10.0)));
}

#[test]
fn the_receiver_knows_how_good_its_fixes_are() {
    let mut last_reported_m = 0.0;
    for multipath in [0.0, 1.0, 5.0] {
        let sky = SkyKeys { multipath, ..SkyKeys::default() };
        let (mut squares, mut reported) = (Vec::new(), Vec::new());
        for seed in 0..12 {
            let bench = Bench { keys: SensorKeys { sky, ..all() }, seed, ..Bench::default() };
            for (_, fix) in bench.take(1200.0, |m| m.gnss) {
                let p = fix.value.position_m;
                squares.push(0.5 * f64::from(p.x * p.x + p.y * p.y));
                reported.push(f64::from(fix.value.horizontal_m).powi(2));
            }
        }
        let (found_m, reported_m) = (mean(&squares).sqrt(), mean(&reported).sqrt());
        // The slow part is known from switch-on, and reported in full: by half an hour, less than reported is found.
        assert!(found_m < reported_m, "{multipath}: {found_m} m found, {reported_m} m reported");
        let path_m = 0.4 * multipath;
        let want_m = (1.2_f64.powi(2) + 0.01 + path_m * path_m).sqrt();
        // 12 flights of 20 time constants, of two axes, of half of it: 5 % of the multipath's share.
        assert!((reported_m / want_m - 1.0).abs() < 0.1, "{multipath}: {reported_m}, not {want_m}");
        assert!(reported_m > last_reported_m);
        last_reported_m = reported_m;
    }
}

#[test]
fn a_damaged_propeller_shakes_the_accelerometer_through_its_low_pass() {
    let at = |frequency_hz: f64| {
        let shaken = move |t_s: f64| Vibration {
            specific_force_m_s2: Vector3::x() * (2.0 * (std::f64::consts::TAU * frequency_hz * t_s).sin()),
            rate_rad_s: Vector3::zeros(),
        };
        let axes = inertial(&Bench { vibration: &shaken, ..Bench::default() }, 20.0);
        deviation(&axes[3]) * 2.0_f64.sqrt()
    };
    // A Butterworth low-pass at 200 Hz, of the bilinear frequencies: 1/√(1 + (tan(π f/500)/tan(0.4π))⁴).
    for (frequency_hz, want) in [(32.0, 2.0), (200.0, 2.0 * 0.5_f64.sqrt()), (235.0, 2.0 * 0.0793)] {
        let found = at(frequency_hz);
        assert!((found / want - 1.0).abs() < 0.03, "{frequency_hz} Hz: {found}, not {want}");
    }
}

#[test]
fn healthy_rotors_shake_at_their_own_frequency() {
    let deviation_of =
        |rotor_n: f64| deviation(&inertial(&Bench { rotor_n: [rotor_n; 4], ..Bench::default() }, 20.0)[3]);
    let (stopped, hover) = (deviation_of(0.0), deviation_of(1.275));
    // Four unbalances of 2e-6 kg m at 202 rad/s, each 0.157 m/s², with phases that chance has set: up to 0.44 rms.
    assert!(stopped < 0.015 && hover > 0.02 && hover < 0.45, "{stopped} {hover}");
}

#[test]
fn current_bends_the_magnetic_field_and_the_battery() {
    let bench = |thrust_n: f64| Bench { rotor_n: [thrust_n; 4], ..Bench::default() };
    let hover_n = vehicle().mass_kg * G / 4.0;
    let field = |thrust_n| {
        let read = bench(thrust_n).take(60.0, |m| m.magnetic_ut.map(|x| f64::from(x.value.z)));
        mean(&read.into_iter().map(|(_, x)| x).collect::<Vec<_>>())
    };
    // 0.3 µT/A at 6 A; 3000 samples of 0.32 µT.
    assert!((field(hover_n) - field(0.0) - 1.8).abs() < 4.0 * 0.32 / 1500.0_f64.sqrt());
    assert!((field(2.0 * hover_n) - field(0.0) - 1.8 * 2.0_f64.powf(1.5)).abs() < 0.04, "current goes with thrust^1.5");
    let volts = |thrust_n: f64, duration_s: f64| {
        let read = bench(thrust_n).take(duration_s, |m| m.battery_v.map(|x| f64::from(x.value)));
        mean(&read[read.len() - 50..].iter().map(|(_, x)| *x).collect::<Vec<_>>())
    };
    assert!((volts(0.0, 2.0) - 12.6).abs() < 0.02);
    assert!((volts(hover_n, 2.0) - (12.6 - 0.3)).abs() < 0.02, "{}", volts(hover_n, 2.0));
    // 600 s at 6 A are 1 Ah of 2.2: charge 0.545.
    assert!((volts(hover_n, 600.0) - (3.0 * 3.847 - 0.3)).abs() < 0.02, "{}", volts(hover_n, 600.0));
}

#[test]
fn the_field_is_that_of_the_place() {
    let earth = EarthKeys { declination_rad: 0.3, ..EarthKeys::default() };
    let [north, east, down] = earth.field_ned_ut();
    assert!((east / north - 0.3_f64.tan()).abs() < 1e-12 && down > 0.0);
    assert!((north.hypot(east).hypot(down) - 48.0).abs() < 1e-9);
    let east_nose = |_: f64| Truth { attitude: Rotation3::from_euler_angles(0.0, 0.0, 0.3).into_inner(), ..still() };
    let bench = Bench { keys: SensorKeys { earth, ..all() }, truth: &east_nose, ..Bench::default() };
    let read = bench.take(20.0, |m| m.magnetic_ut);
    let right = mean(&read.iter().map(|(_, x)| f64::from(x.value.y)).collect::<Vec<_>>());
    // With the nose to magnetic north nothing is to the right but what calibration left: 0.5 µT, and 1 % of 43 µT.
    assert!(right.abs() < 4.0 * 0.5_f64.hypot(0.48), "{right}");
}

#[test]
fn rotors_near_the_ground_and_wind_bend_the_barometer() {
    let hover_n = vehicle().mass_kg * G / 4.0;
    let read = |height_m: f64, speed_m_s: f64| {
        let truth = move |_: f64| Truth {
            position_m: Vector3::new(0.0, 0.0, -height_m),
            velocity_m_s: Vector3::new(speed_m_s, 0.0, 0.0),
            thrust_n: [hover_n; 4],
            ..still()
        };
        let read = Bench { truth: &truth, ..Bench::default() }.take(60.0, |m| m.baro_altitude_m);
        mean(&read.iter().map(|(_, x)| f64::from(x.value)).collect::<Vec<_>>()) - height_m
    };
    // The same seed, so the same errors: they cancel to the rounding of the register.
    let free_m = read(10.0, 0.0);
    assert!((read(0.0, 0.0) - free_m + 10.0 / 12.01).abs() < 0.01, "10 Pa on the ground read as lower");
    assert!((read(0.5, 0.0) - free_m + 2.5 / 12.01).abs() < 0.01);
    assert!((read(10.0, 10.0) - free_m - 0.2 * 0.5 * 1.225 * 100.0 / 12.01).abs() < 0.01, "suction reads as higher");
}

fn parse(text: &str) -> Result<Scenario, String> {
    let base = system_tests::shipped("flight").text;
    Scenario::parse(&format!("{base}\n{text}"), Path::new("x.toml")).map_err(|error| error.to_string())
}

const SENSORS: &str = "[sensors]\nimu = \"icm42688p\"\nbaro = \"bmp388\"\n";

#[test]
fn sensors_and_their_faults_are_read_from_files() {
    let fault = "[[sensor_fault]]\nsensor = \"gyro\"\nkind = \"bias\"\noffset = 0.1\nfrom_s = 1.0\nuntil_s = 2.0\n";
    let scenario = parse(&format!("{SENSORS}[sensors.latency_s]\nbaro = 0.05\n{fault}")).expect("it is sound");
    let keys = scenario.sensors.expect("it has sensors");
    assert_eq!((keys.imu, keys.baro, keys.gnss), (Some(ImuPart::Icm42688p), Some(BaroPart::Bmp388), None));
    assert_eq!(keys.latency_s.baro, Some(0.05));
    assert_eq!(scenario.sensor_fault[0].kind, SensorFaultKind::Bias { offset: 0.1 });
    assert!(system_tests::shipped("flight").sensors.is_none());
}

#[test]
fn senseless_sensors_are_refused_by_key_value_and_what_is_allowed() {
    let fault = |keys: &str| format!("{SENSORS}[[sensor_fault]]\nfrom_s = 1.0\nuntil_s = 2.0\n{keys}\n");
    let twice = "sensor = \"baro\"\nkind = \"stuck\"\n[[sensor_fault]]\nsensor = \"baro\"\nkind = \"off\"\nfrom_s = 1.5\nuntil_s = 9.0";
    for (text, says) in [
        (format!("{SENSORS}gps = \"m10\""), "gps: unknown field"),
        ("[sensors]\nimu = \"mpu6050\"".to_owned(), "unknown variant `mpu6050`, expected `icm42688p`"),
        (format!("{SENSORS}imus = 3"), "sensors.imus = 3: must be a number from 1 to 2"),
        (
            format!("{SENSORS}[sensors.rate_hz]\nbaro = 900.0"),
            "sensors.rate_hz.baro = 900: must be a number from 0.1 to 500",
        ),
        (
            format!("{SENSORS}[sensors.noise]\ngnss = 2.0"),
            "sensors.noise.gnss = 2: must be left out without sensors.gnss",
        ),
        (format!("{SENSORS}[sensors.sky]\noutage_s = 0.0"), "sensors.sky.outage_s = 0: must be a number from 0.01"),
        (
            fault("sensor = \"gnss\"\nkind = \"off\""),
            "sensor_fault[0].sensor = gnss: must be a sensor that [sensors] names",
        ),
        (
            fault("sensor = \"gyro\"\nkind = \"off\"\nunit = 2"),
            "sensor_fault[0].unit = 2: must be a number from 1 to 1",
        ),
        (fault("sensor = \"baro\"\nkind = \"bias\""), "offset = nothing: must be given with the kind `bias`"),
        (fault("sensor = \"baro\"\nkind = \"off\"\nloss = 0.5"), "loss = 0.5: must be left out with the kind `off`"),
        (fault("sensor = \"baro\"\nkind = \"melted\""), "unknown variant `melted`"),
        (
            fault(twice),
            "sensor_fault[1].kind = off: must be at another time or on another axis than sensor_fault[0], `stuck`",
        ),
        (
            "[[sensor_fault]]\nsensor = \"baro\"\nkind = \"off\"\nfrom_s = 1.0\nuntil_s = 2.0".to_owned(),
            "sensor_fault[0].sensor = baro: must be a sensor that [sensors] names",
        ),
    ] {
        let line = parse(&text).expect_err("it makes no sense");
        assert!(line.starts_with("x.toml") && line.contains(says), "`{says}` is not in: {line}");
    }
}
