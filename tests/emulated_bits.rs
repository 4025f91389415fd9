//! Image and host, to the bit, where their inputs are others: outdoors, on another inertial unit, on clocks that have run for long, and on
//! values that no sensor should say.
//!
//! As `emulated.rs`: `cargo test --features emulated --test emulated_bits`.
use control_core::fault::Rotors;
use control_core::flight::Command;
use control_core::frames::{Attitude, Vec3};
use control_core::geodesy::Geodetic;
use control_core::measurement::{Gnss, Vision};
use firmware::record::Record;
use sim_host::controllers::ControllerName;
use sim_host::emulator::{Emulator, Motion};
use sim_host::flight::{Flight as Sortie, NumberFormat};
use sim_host::through;
use std::f64::consts::TAU;
use system_tests::aloft::{Aloft, ByHand, Hands, SAMPLE_HZ, channels};
use system_tests::garbage::Garbage;
use system_tests::host::Host;
use system_tests::motion::Noise;
use system_tests::{root, shipped};

#[test]
fn outdoors_on_satellites_and_compass_the_image_decides_as_the_host() {
    let mut scenario = shipped("image/flight_outdoors").for_image(&root()).expect("made for it");
    scenario.duration_s = 11.0;
    scenario.event.retain(|event| event.at_s < scenario.duration_s);
    // That of one rotor, sooner.
    scenario.fault.retain(|fault| fault.rotors != Rotors::ALL);
    for fault in &mut scenario.fault {
        (fault.from_s, fault.until_s) = (8.0, 10.0);
    }
    let sortie =
        Sortie { scenario: &scenario, controller: ControllerName::Default, seed: 1, format: NumberFormat::F32 };
    let (mut fixes, mut fields, mut highest_m) = (0, 0, 0.0_f64);
    let (flown, board) = through::fly_measured(&sortie, &mut |sample| {
        fixes += u32::from(sample.measurements.gnss.is_some());
        fields += u32::from(sample.measurements.magnetic_ut.is_some());
        highest_m = highest_m.max(sample.truth.altitude_m());
    })
    .expect("the image runs to the end");
    println!("{} commands, {fixes} fixes, {fields} fields, {highest_m:.2} m", board.verdict.commands);
    assert_eq!(board.verdict.parting, None);
    assert!(board.verdict.commands > 16 * SAMPLE_HZ, "{}", board.verdict.commands);
    assert!(fixes > 100 && fields > 500, "{fixes} fixes, {fields} fields");
    assert!(flown.survived() && highest_m > 2.0, "{highest_m} m");
}

#[test]
fn on_an_mpu_6000_in_the_place_of_the_other_it_takes_off_and_hovers_as_the_host_would() {
    let (mut aloft, mut host, mut pilot) = (Aloft::with_mpu6000(), Host::default(), ByHand::default());
    let (mut log, mut apart_m_s2) = (aloft.answer.log.clone(), 0.0_f64);
    while aloft.time_s() < 10.5 {
        let (t_s, truth) = (aloft.time_s(), aloft.truth());
        aloft.step(&pilot.hands(t_s, &truth));
        log += &aloft.answer.log;
        let Some(record) = aloft.answer.record.filter(|record| record.step > host.last) else { continue };
        host.follow(&record);
        let measured = record.arrived.measurements.imu.expect("a sample each step").value.specific_force_m_s2;
        let before: [f64; 3] = truth.specific_force_m_s2.into();
        if t_s < 6.0 {
            for (measured, truth) in [measured.x, measured.y, measured.z].into_iter().zip(before) {
                apart_m_s2 = apart_m_s2.max((f64::from(measured) - truth).abs());
            }
        }
    }
    let end = aloft.truth();
    println!(
        "{} steps, up {:.2} m, tilt {:.3} rad; at rest off by {apart_m_s2:.3} m/s²",
        host.last,
        end.altitude_m(),
        end.tilt_rad()
    );
    assert!(log.contains("the inertial unit is an MPU-6000"), "{log}");
    assert!(host.last > 10 * SAMPLE_HZ, "{}", host.last);
    assert!(apart_m_s2 < 0.2, "{apart_m_s2}");
    assert!((1.0..2.2).contains(&end.altitude_m()) && end.tilt_rad() < 0.3, "{end:?}");
}

/// A board whose clock has run for long, and a host that has just been switched on.
struct Aged {
    aloft: Aloft,
    host: Host,
    /// How much later it is by the board's clock than by the host's, µs.
    older_us: Option<u64>,
}

impl Aged {
    /// When the host makes the first step, by its clock, µs.
    const FIRST_US: u64 = 777_777;

    fn new(uptime_s: u32) -> Self {
        Self { aloft: Aloft::on_the_ground_after(uptime_s), host: Host::default(), older_us: None }
    }

    /// One sample; what the image has decoded is the host's too, at the time by the host's clock. Returns shares, none before
    /// the rotors run.
    fn step(&mut self, hands: &Hands) -> Option<[f32; 4]> {
        self.aloft.step(hands);
        let record = self.aloft.answer.record?;
        if record.step > self.host.last {
            let older_us = *self.older_us.get_or_insert(record.time_us - Self::FIRST_US);
            self.host.follow(&younger(&record, older_us));
        }
        if let Command::Run(shares) = record.command { Some(shares) } else { None }
    }
}

/// The same step, all times in it so much earlier.
fn younger(record: &Record, by_us: u64) -> Record {
    // The words have the time of the step, and the age of all that has arrived.
    let mut words = record.to_words();
    let time_us = record.time_us - by_us;
    (words[2], words[3]) = (time_us as u32, (time_us >> 32) as u32);
    Record::from_words(&words)
}

#[test]
fn over_the_roll_over_of_the_clock_and_after_ten_hours_the_image_decides_as_a_host_just_switched_on() {
    // 2³² µs are 4,294.97 s: they pass while the rotors turn.
    let mut boards = [4_287, 36_000].map(Aged::new);
    let (mut ran, mut before) = (0, None);
    while boards[0].aloft.time_s() < 10.5 {
        let t_s = boards[0].aloft.time_s();
        let hands = Hands { arm: t_s > 6.0, throttle: if t_s > 8.0 { 0.45 } else { 0.0 }, ..Hands::default() };
        let [over, late] = boards.each_mut().map(|board| board.step(&hands));
        assert_eq!(over.is_some(), late.is_some(), "{t_s} s");
        // Each is the host's to the bit, but what they are given is not the same: to log or to send a time of more bytes takes more
        // cycles, and a slow sensor is heard a microsecond sooner or later; a radio's frame may so be a step's later.
        if let (Some(over), Some(late)) = (over, late) {
            let apart = |a: [f32; 4], b: [f32; 4]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            let (over_before, late_before) = before.unwrap_or((over, late));
            let least = apart(over, late).min(apart(over, late_before)).min(apart(over_before, late));
            assert!(least < 1e-3, "{t_s} s: shares {least} apart");
            before = Some((over, late));
            ran += 1;
        }
    }
    let [over, late] = boards.map(|board| board.aloft.answer.record.expect("it flew").time_us);
    assert!(over > 1 << 32 && late > 36_000_000_000, "{over} {late}");
    assert!(ran > 4 * SAMPLE_HZ, "{ran}");
}

#[test]
#[ignore = "a long job: as many hours of the board's clock as HOURS says, or ten, which take about as long"]
fn for_hours_aloft_the_image_decides_as_the_host() {
    let hours = std::env::var("HOURS").map_or(10.0, |hours| hours.parse().expect("HOURS is a number"));
    let (mut aloft, mut host, mut pilot) = (Aloft::on_the_ground(), Host::default(), ByHand::default());
    let (mut tells, mut strays_m) = (String::new(), [0.0_f64; 2]);
    while aloft.time_s() < hours * 3_600.0 {
        let (t_s, truth) = (aloft.time_s(), aloft.truth());
        // Held at 1.5 m for good, by one who sees where its nose points.
        let hands = pilot.hands(t_s.min(16.0), &truth);
        let (sin, cos) = truth.attitude[(1, 0)].atan2(truth.attitude[(0, 0)]).sin_cos();
        let (roll, pitch) = (hands.roll * cos - hands.pitch * sin, hands.roll * sin + hands.pitch * cos);
        aloft.step(&Hands { roll, pitch, ..hands });
        if let Some(record) = aloft.answer.record.filter(|record| record.step > host.last) {
            host.follow(&record);
        }
        if aloft.answer.log.contains("steps ") {
            tells.clone_from(&aloft.answer.log);
        }
        if t_s > 16.0 {
            let place = truth.position_m;
            strays_m[0] = strays_m[0].max(place.x.hypot(place.y));
            strays_m[1] = strays_m[1].max((truth.altitude_m() - 1.5).abs());
        }
    }
    println!("{hours} h: {} steps, strays {strays_m:.2?} m; {tells}", host.last);
    assert!(f64::from(host.last) > 3_590.0 * hours * f64::from(SAMPLE_HZ), "{} steps", host.last);
    assert!(tells.contains("late 0, blind 0"), "{tells}");
    assert!(strays_m[0] < 2.0 && strays_m[1] < 0.5, "{strays_m:?} m");
}

#[test]
fn with_its_rotors_running_thrown_about_and_told_anything_it_decides_as_the_host_would() {
    let (mut emulator, mut host) = (Emulator::start().expect("emulator and image build"), Host::default());
    let (mut noise, mut garbage) = (Noise::new(7), Garbage(7));
    let (mut ran, mut absurd, mut fixes) = (0, 0, 0);
    for step in 0..13 * SAMPLE_HZ {
        let t_s = f64::from(step) / f64::from(SAMPLE_HZ);
        let thrown = t_s > 7.0;
        let sine = |hz: f64| if thrown { (TAU * hz * t_s).sin() } else { 0.0 };
        let mut soil = |good: f64, n: u64| if thrown { garbage.spoil(good as f32, n) } else { good as f32 };
        let [noise_x, noise_y, noise_z] = noise.normals(0.002);
        emulator.move_body(&Motion {
            force_m_s2: [3.0 * sine(0.7) + noise_x, 2.0 * sine(1.1) + noise_y, -9.81 + 4.0 * sine(0.5) + noise_z]
                .map(|force| soil(force, 200)),
            rate_rad_s: [4.0 * sine(2.3) + noise_z, 3.0 * sine(1.9) + noise_x, 2.0 * sine(0.3) + noise_y]
                .map(|rate| soil(rate, 200)),
        });
        emulator.set_air(soil(101_325.0 + 100.0 * sine(0.4) + noise_x, 20), soil(20.0, 20));
        emulator.set_field(Vec3::new(soil(20.0, 20), soil(20.0 * sine(0.3), 20), soil(43.0, 20)));
        let battery_v = soil(11.1, 500);
        emulator.set_battery(battery_v, 0.4 * battery_v);
        if step.is_multiple_of(20) {
            let position_m = Vec3::new(soil(sine(0.2), 8), soil(sine(0.3), 8), soil(-1.0, 8));
            let sigma = [soil(0.01, 30), soil(0.01, 30)];
            let attitude = Attitude {
                rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|row| row.map(|entry| soil(entry, 100))),
            };
            let pose = Vision { position_m, attitude, position_sigma_m: sigma[0], attitude_sigma_rad: sigma[1] };
            emulator.send_pose(soil(10_000.0, 30) as u32, &pose);
        }
        if step.is_multiple_of(200) {
            let place = Geodetic {
                latitude_e7: soil(473_977_000.0, 30) as i32,
                longitude_e7: soil(85_456_000.0, 30) as i32,
                altitude_m: soil(488.0, 30),
            };
            let velocity_m_s = Vec3::new(soil(sine(0.2), 30), soil(0.0, 30), soil(sine(0.3), 30));
            let [horizontal_m, vertical_m, speed_m_s] = [soil(1.3, 30), soil(1.9, 30), soil(0.1, 30)];
            let fixed = soil(1.0, 20) == 1.0;
            let fix =
                Gnss { position_m: Vec3::new(0.0, 0.0, 0.0), velocity_m_s, horizontal_m, vertical_m, speed_m_s, fixed };
            emulator.send_fix(&place, &fix);
        }
        if step.is_multiple_of(40) {
            let hands = Hands {
                roll: 0.5 * sine(0.4),
                pitch: 0.5 * sine(0.6),
                throttle: if t_s > 6.5 { 0.5 } else { 0.0 },
                arm: t_s > 6.0,
            };
            emulator.send_channels(channels(&hands));
        }
        let answer = emulator.period().expect("the image runs");
        let Some(record) = answer.record.filter(|record| record.step > host.last) else { continue };
        host.follow(&record);
        ran += u32::from(matches!(record.command, Command::Run(_)));
        let measured = record.arrived.measurements;
        absurd += u32::from(measured.vision.is_some_and(|pose| {
            let p = pose.value.position_m;
            !(p.x + p.y + p.z).is_finite()
        }));
        fixes += u32::from(measured.gnss.is_some());
    }
    println!("{} steps, {ran} with rotors running, {absurd} poses that are not numbers, {fixes} fixes", host.last);
    assert!(ran > 5 * SAMPLE_HZ && absurd > 20 && fixes > 50, "{ran}, {absurd}, {fixes}");
}
