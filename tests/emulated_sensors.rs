//! The slow sensors of the flashed image, on the emulator: what they say reaches the estimator as it was true, and what is wrong
//! with one of them costs its own values and nobody's time.
//!
//! Needs cmake and libclang (`cargo xtask setup`): `cargo test --features emulated --test emulated_sensors`.
use control_core::frames::{Attitude, Body, Ned, Vec3};
use control_core::geodesy::{Geodetic, LocalFrame};
use control_core::measurement::{Gnss, Measurements, Stamped, Vision};
use firmware::record::Record;
use sim_host::emulator::{Answer, Emulator, Health, Line, Mishap, Motion, Part};

/// Samples of the inertial unit a second, and the time between two, µs.
const SAMPLE_HZ: u32 = 2_000;
const PERIOD_US: u64 = 500;
/// Samples between two fixes, and between two poses.
const FIX_EVERY: u32 = 200;
const POSE_EVERY: u32 = 20;
/// Sample of the first fix: the receiver has not been set up yet, and sends a sentence at a speed that the image does not expect.
const FIRST_FIX: u32 = 100;
/// How old a pose is when it is sent, µs.
const POSE_AGE_US: u32 = 9_000;
/// What a receiver takes to work a fix out, µs (docs/sensors.md).
const FIX_AGE_US: u64 = 120_000;
const HOME: Geodetic = Geodetic { latitude_e7: 481_234_567, longitude_e7: 115_678_901, altitude_m: 450.0 };
/// Time in which every sensor has been found and set up, samples.
const START: u32 = 2 * SAMPLE_HZ;

/// A board that is lifted at 2 m/s and turned, with all its sensors.
struct Bench {
    emulator: Emulator,
    frame: LocalFrame,
    /// Of the image's clock, when the sample before the next period was ready, µs.
    time_us: u64,
    /// Samples since the first.
    sample: u32,
    /// All steps' measurements.
    seen: Vec<(u64, Measurements)>,
    record: Option<Record>,
    answer: Answer,
    log: String,
}

impl Bench {
    fn new() -> Self {
        Self::with(|_| {})
    }

    /// Switched on after `before`.
    fn with(before: impl Fn(&mut Emulator)) -> Self {
        let mut emulator = Emulator::start().expect("emulator and image build");
        before(&mut emulator);
        emulator.move_body(&at_rest(0));
        let answer = emulator.period().expect("the image boots");
        let frame = LocalFrame::try_new(HOME).expect("a place");
        Self { emulator, frame, time_us: 0, sample: 0, seen: Vec::new(), record: None, answer, log: String::new() }
    }

    /// Altitude, m, at a time of the image's clock.
    fn altitude_m(time_us: u64) -> f64 {
        2.0 * time_us as f64 * 1e-6
    }

    /// Magnetic field, µT: it turns once in ten seconds.
    fn field_ut(time_us: u64) -> Vec3<Body> {
        let (sin, cos) = (time_us as f64 * 1e-7 * std::f64::consts::TAU).sin_cos();
        Vec3::new((20.0 * cos) as f32, (-20.0 * sin) as f32, 43.0)
    }

    fn gnss(time_us: u64) -> Gnss {
        let height_m = Self::altitude_m(time_us) as f32;
        Gnss {
            position_m: Vec3::new(0.5 * height_m, -0.25 * height_m, -height_m),
            velocity_m_s: Vec3::new(1.0, -0.5, -2.0),
            horizontal_m: 1.3,
            vertical_m: 1.9,
            speed_m_s: 0.05,
            fixed: true,
        }
    }

    fn pose(time_us: u64) -> Vision {
        let (sin, cos) = (time_us as f32 * 1e-7).sin_cos();
        Vision {
            position_m: Vec3::new(cos, sin, -Self::altitude_m(time_us) as f32),
            attitude: Attitude { rows: [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]] },
            position_sigma_m: 0.001,
            attitude_sigma_rad: 0.002,
        }
    }

    /// One sample, and what the image made of it. Fixes and poses are sent only if `sends`.
    fn step(&mut self, sends: bool) {
        let now_us = self.time_us + PERIOD_US;
        let pressure_pa = 101_325.0 * (1.0 - 0.0065 / 288.15 * Self::altitude_m(now_us)).powf(5.255_88);
        self.emulator.set_air(pressure_pa as f32, 20.0);
        self.emulator.set_field(Self::field_ut(now_us));
        if sends && self.sample % FIX_EVERY == FIRST_FIX {
            let fix = Self::gnss(now_us.saturating_sub(FIX_AGE_US));
            let place = self.frame.to_geodetic(fix.position_m);
            self.emulator.send_fix(&place, &fix);
        }
        if sends && self.sample.is_multiple_of(POSE_EVERY) {
            self.emulator.send_pose(POSE_AGE_US, &Self::pose(now_us.saturating_sub(POSE_AGE_US.into())));
        }
        self.emulator.move_body(&at_rest(self.sample));
        self.answer = self.emulator.period().expect("the image runs");
        if !self.answer.log.is_empty() {
            println!("{}", self.answer.log);
            self.log += &self.answer.log;
        }
        self.sample += 1;
        self.time_us = now_us;
        if let Some(record) = self.answer.record {
            self.time_us = record.time_us;
            self.seen.push((record.time_us, record.arrived.measurements));
            self.record = Some(record);
        }
    }

    fn run(&mut self, samples: u32) {
        for _ in 0..samples {
            self.step(true);
        }
    }

    /// What arrived of a kind since a time, with when.
    fn arrived<T>(&self, since_us: u64, pick: impl Fn(&Measurements) -> Option<Stamped<T>>) -> Vec<(u64, Stamped<T>)> {
        let late = self.seen.iter().filter(|(time_us, _)| *time_us >= since_us);
        late.filter_map(|(time_us, measurements)| Some((*time_us, pick(measurements)?))).collect()
    }

    /// How many of each kind have arrived in the seconds from `since_us` on: barometer, magnetometer, satellites, vision.
    fn rates(&self, since_us: u64) -> [f64; 4] {
        let seconds = (self.time_us - since_us) as f64 * 1e-6;
        [
            self.arrived(since_us, |m| m.baro_altitude_m).len(),
            self.arrived(since_us, |m| m.magnetic_ut).len(),
            self.arrived(since_us, |m| m.gnss).len(),
            self.arrived(since_us, |m| m.vision).len(),
        ]
        .map(|count| count as f64 / seconds)
    }
}

/// At rest, level, trembling: a part that always says the same is taken for one that is stuck.
fn at_rest(sample: u32) -> Motion {
    let tremble = 0.002 * (sample % 7) as f32;
    Motion { force_m_s2: [tremble, -tremble, -9.81 + tremble], rate_rad_s: [tremble, -tremble, tremble] }
}

/// Difference of times, µs.
fn apart_us(a: u64, b: u64) -> u64 {
    a.abs_diff(b)
}

#[test]
fn what_each_sensor_says_arrives_as_it_was_true_and_as_often_as_it_is_set_up() {
    let mut bench = Bench::new();
    bench.run(START);
    let since_us = bench.time_us;
    bench.run(3 * SAMPLE_HZ);
    let rates = bench.rates(since_us);
    println!("barometer, magnetometer, satellites, vision: {rates:.1?} Hz");
    for (rate, want) in rates.into_iter().zip([32.0, 50.0, 10.0, 100.0]) {
        assert!((rate - want).abs() <= 0.02 * want, "{rates:?}");
    }
    assert!(bench.record.is_some_and(|record| record.arrived.self_test_passed));

    // The first altitude is where all are counted from.
    let baro = bench.arrived(0, |m| m.baro_altitude_m);
    let (_, first) = baro[0];
    let mut worst_m = 0.0_f64;
    for (_, Stamped { time_us, value }) in &baro {
        let want_m = Bench::altitude_m(*time_us) - Bench::altitude_m(first.time_us);
        worst_m = worst_m.max((f64::from(*value) - want_m).abs());
    }
    // A step of the converter is 1 cm; asking for samples every half a millisecond is 1 mm, and f32 3 mm.
    assert!(worst_m < 0.03, "{worst_m} m");
    let mut worst_ut = 0.0_f32;
    for (_, Stamped { time_us, value }) in bench.arrived(since_us, |m| m.magnetic_ut) {
        let want = Bench::field_ut(time_us);
        worst_ut = worst_ut.max((value.x - want.x).abs()).max((value.y - want.y).abs()).max((value.z - want.z).abs());
    }
    // Half a step is 0.017 µT, a millisecond's turn 0.013.
    assert!(worst_ut < 0.04, "{worst_ut} uT");

    let (mut worst_us, mut worst_place_m) = (0, 0.0_f32);
    let origin = bench.arrived(0, |m| m.gnss)[0].1;
    for (_, Stamped { time_us, value }) in bench.arrived(since_us, |m| m.gnss) {
        // The north is 1 m/s times time.
        let told = Bench::gnss(time_us);
        let from = Bench::gnss(origin.time_us);
        let off = value.position_m - (told.position_m - from.position_m);
        worst_place_m = worst_place_m.max(off.x.abs()).max(off.y.abs()).max(off.z.abs());
        assert_eq!(Gnss { position_m: told.position_m, ..value }, told);
    }
    // 11 mm are a step of the place, 2 mm a millisecond.
    assert!(worst_place_m < 0.02, "{worst_place_m} m");
    for (arrived_us, Stamped { time_us, value }) in bench.arrived(since_us, |m| m.vision) {
        let told = Bench::pose(time_us);
        worst_us = worst_us.max(apart_us(arrived_us, time_us + u64::from(POSE_AGE_US)));
        let off = value.position_m - told.position_m;
        assert!(off.x.abs().max(off.y.abs()).max(off.z.abs()) < 1e-3, "{off:?}");
        let turned = value.attitude.rows[1][0] - told.attitude.rows[1][0];
        assert!(turned.abs() < 1e-4, "{turned}");
        assert_eq!((value.position_sigma_m, value.attitude_sigma_rad), (0.001, 0.002));
    }
    println!("worst: {worst_m:.4} m, {worst_ut:.3} uT, {worst_place_m:.3} m; vision {worst_us} us after it was sent");
    assert!(worst_us <= 1_500, "{worst_us} us");
}

#[test]
fn a_satellite_receiver_that_refuses_its_setup_is_told_again_and_set_up_once_it_takes_it() {
    let mut bench = Bench::with(|emulator| emulator.inflict(Mishap::GnssRefuses));
    // Half a second each, and one in which its speed is guessed wrong.
    bench.run(START + SAMPLE_HZ);
    let since_us = bench.time_us;
    bench.run(SAMPLE_HZ);
    let [_, _, gnss, _] = bench.rates(since_us);
    // It takes its speed each time, and says so.
    assert_eq!(bench.log.matches("the satellite receiver is set up").count(), 1, "{}", bench.log);
    assert!(!bench.log.contains("the satellite receiver is silent"), "{}", bench.log);
    assert!((gnss - 10.0).abs() <= 1.0, "{gnss} Hz");
}

#[test]
fn noise_on_a_line_costs_what_it_hits_and_no_more() {
    let mut bench = Bench::new();
    bench.run(START);
    let since_us = bench.time_us;
    let mut random = 1_u32;
    for _ in 0..4 {
        for line in [Line::Gnss, Line::Vision, Line::Radio] {
            let noise: Vec<u8> = (0..200)
                .map(|_| {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (random >> 24) as u8
                })
                .collect();
            bench.emulator.send_bytes(line, &noise);
        }
        bench.run(SAMPLE_HZ);
    }
    let [_, _, gnss, vision] = bench.rates(since_us);
    println!("with a burst a second: satellites {gnss:.1} Hz, vision {vision:.1} Hz");
    // Of ten fixes a second one may be lost and of a hundred poses two.
    assert!(gnss >= 9.0 && vision >= 98.0, "{gnss} {vision}");
    let wild = bench.arrived(since_us, |m| m.vision);
    let near = |p: Vec3<Ned>| p.x.abs().max(p.y.abs()).max(p.z.abs()) < 100.0;
    assert!(wild.iter().all(|(_, pose)| near(pose.value.position_m)), "no noise is a pose");
}

/// Runs the bench with a barometer or magnetometer that does badly from `sick_s` to `well_s`; returns rates while it did, and
/// from a second and a half after it, and the longest time from sample to frame, cycles.
fn sick(part: Part, health: Health) -> ([f64; 4], [f64; 4], u64) {
    let mut bench = Bench::new();
    bench.run(START);
    bench.emulator.set_health(part, health);
    bench.run(SAMPLE_HZ / 10);
    let since_us = bench.time_us;
    bench.run(SAMPLE_HZ);
    let during = bench.rates(since_us);
    bench.emulator.set_health(part, Health::Well);
    // It is looked for every second, and what hung is opened anew after one.
    bench.run(5 * SAMPLE_HZ / 2);
    let since_us = bench.time_us;
    bench.run(SAMPLE_HZ);
    (during, bench.rates(since_us), bench.answer.latency_max)
}

#[test]
fn a_part_that_falls_silent_or_holds_the_bus_delays_nobody_and_comes_back() {
    let well = {
        let mut bench = Bench::new();
        bench.run(START + 4 * SAMPLE_HZ);
        bench.answer.latency_max
    };
    for (part, health, kept) in [
        (Part::Barometer, Health::Silent, [false, true]),
        (Part::Magnetometer, Health::Silent, [true, false]),
        (Part::Magnetometer, Health::HoldsBus, [false, false]),
    ] {
        let (during, after, latency) = sick(part, health);
        println!(
            "{part:?} {health:?}: {during:.0?} Hz, then {after:.0?}; sample to frame {latency}, well {well} cycles"
        );
        for ((rate, whole), kept) in
            during.into_iter().zip([32.0, 50.0, 10.0, 100.0]).zip([kept[0], kept[1], true, true])
        {
            let want = if kept { whole } else { 0.0 };
            assert!((rate - want).abs() <= 0.11 * whole, "{part:?} {health:?}: {during:?}");
        }
        for (rate, want) in after.into_iter().zip([32.0, 50.0, 10.0, 100.0]) {
            assert!((rate - want).abs() <= 0.11 * want, "{part:?} {health:?}: then {after:?}");
        }
        // Interrupts of the lines come when they come: a few hundred cycles.
        assert!(latency <= well + 1_500, "{latency} cycles, {well} when all are well");
    }
}

#[test]
fn a_board_whose_barometer_never_answers_is_not_armed_and_one_without_the_rest_is() {
    for (absent, passed) in [(Part::Barometer, false), (Part::Magnetometer, true)] {
        let mut bench = Bench::with(|emulator| emulator.set_health(absent, Health::Silent));
        for _ in 0..START {
            bench.step(false);
        }
        let record = bench.record.expect("it has begun");
        assert_eq!(record.arrived.self_test_passed, passed, "{absent:?} absent");
        let [_, _, gnss, vision] = bench.rates(0);
        assert_eq!([gnss, vision], [0.0, 0.0], "nobody has said anything");
    }
}
