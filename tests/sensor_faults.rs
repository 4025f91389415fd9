//! Sensor faults: what each does to the readings, and which are refused in files.
use control_core::measurement::Measurements;
use proptest::prelude::*;
use sim_host::fault::sensors::{Sensor, SensorAxis, SensorFault, SensorFaultKind};
use sim_host::fault::{Intermittent, Profile, Ramp};
use sim_host::scenario::Scenario;
use sim_host::sensors::*;
use std::path::Path;
use system_tests::bench::{Bench, all, deviation, mean, moving};

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
    let flicker = Profile::Intermittent(Intermittent { on_mean_s: 0.1, off_mean_s: 0.1 });
    let rows = faulty(&[SensorFault { profile: flicker, ..bias }], &baro);
    let on = during(&rows).filter(|(_, read, healthy)| read != healthy).count();
    // Half of the time in 50 cycles: four standard deviations.
    assert!((150..350).contains(&on), "{on} of 500");
}

#[test]
fn an_offset_of_position_leaves_velocity_and_garbage_does_not() {
    let velocity = |m: &Measurements| m.gnss.map(|x| (x.time_us, f64::from(x.value.velocity_m_s.x)));
    let north = |m: &Measurements| m.gnss.map(|x| (x.time_us, f64::from(x.value.position_m.x)));
    let bias = [fault(Sensor::Gnss, SensorFaultKind::Bias { offset: 111.0 })];
    assert!(
        during(&faulty(&bias, &north))
            .filter(|(t_s, ..)| *t_s > 5.3)
            .all(|(_, read, was)| (read - was - 111.0).abs() < 0.01)
    );
    assert!(faulty(&bias, &velocity).iter().all(|(_, read, was)| read == was));
    let garbage = faulty(&[fault(Sensor::Gnss, SensorFaultKind::Garbage)], &velocity);
    assert!(during(&garbage).any(|(_, read, _)| read.abs() > 30.0));
}

/// Any kind of fault with parameters within its ranges.
fn any_kind() -> impl Strategy<Value = SensorFaultKind> {
    use SensorFaultKind::{Bias, Delayed, Drift, Garbage, Intermittent, Off, Spikes, Stuck};
    prop_oneof![
        Just(Off),
        Just(Stuck),
        Just(Garbage),
        (-1e5..1e5).prop_map(|offset| Bias { offset }),
        (-1e5..1e5).prop_map(|rate| Drift { rate }),
        (-1e5..1e5, 0.001..1e4).prop_map(|(size, rate_1_s)| Spikes { size, rate_1_s }),
        (1e-4..10.0).prop_map(|delay_s| Delayed { delay_s }),
        (0.0..=1.0).prop_map(|loss| Intermittent { loss }),
    ]
}

/// Any sound fault within the first second.
fn any_fault() -> impl Strategy<Value = SensorFault> {
    use Sensor::{Accelerometer, Baro, Battery, Flow, Gnss, Gyro, Mag, Range, RotorSpeed, Vision};
    let sensors = [Gyro, Accelerometer, Baro, Mag, Gnss, Range, Flow, Vision, RotorSpeed, Battery];
    let axis = prop::option::of(prop::sample::select(vec![SensorAxis::X, SensorAxis::Y, SensorAxis::Z]));
    let flicker = Profile::Intermittent(Intermittent { on_mean_s: 0.1, off_mean_s: 0.1 });
    let profile = prop::sample::select(vec![Profile::Step, Profile::Ramp(Ramp { rise_s: 0.5 }), flicker]);
    let times = (0.0..0.5, 0.5..1.5);
    let all = (any_kind(), prop::sample::select(sensors.to_vec()), 1..=2_u8, axis, times, profile);
    all.prop_map(|(kind, sensor, unit, axis, (from_s, until_s), profile)| SensorFault {
        kind,
        sensor,
        unit,
        axis,
        from_s,
        until_s,
        profile,
    })
    .prop_filter("sound", |fault| fault.check().is_ok())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever breaks, registers hold numbers, and stamps are of the flight.
    #[test]
    fn no_fault_makes_a_reading_that_is_not_a_number(
        faults in prop::collection::vec(any_fault(), 0..5),
        seed in any::<u64>(),
    ) {
        let keys = SensorKeys { imus: 2, baros: 2, ..all() };
        let mut wrong = None;
        Bench { keys, faults: &faults, seed, truth: &moving, ..Bench::default() }.run(1.0, |t_s, m| {
            let text = format!("{m:?}");
            let late = m.imu.is_some_and(|x| x.time_us as f64 > 1e6 * t_s + 100.0);
            if text.contains("NaN") || text.contains("inf") || late {
                wrong.get_or_insert((t_s, text));
            }
        });
        prop_assert!(wrong.is_none(), "{wrong:?}");
    }
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
