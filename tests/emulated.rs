//! The image that is flashed, flown on the emulator: it must be the host's core to the bit, in time, and the same every time.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated`.
use firmware::flight::{Command, Flight};
use firmware::record::Record;
use std::f32::consts::TAU;
use system_tests::emulator::{Answer, Emulator, Motion};

/// Samples of the inertial unit a second.
const SAMPLE_HZ: u32 = 2_000;
/// How long is flown, s.
const SECONDS: u32 = 60;
/// Core clock, Hz.
const CORE_HZ: f64 = 168e6;
const STOP: [Option<u16>; 4] = [Some(0); 4];

/// The motion of a machine that is thrown about: every axis by a sine of its own, and a blow each second that no sensor's
/// range holds.
fn thrown_about(step: u32) -> Motion {
    let time_s = step as f32 / SAMPLE_HZ as f32;
    let sine = |hz: f32| (TAU * (hz * time_s).fract()).sin();
    let blow = if step % SAMPLE_HZ < 4 { 10.0 } else { 1.0 };
    Motion {
        force_m_s2: [3.0 * sine(0.7) * blow, 2.0 * sine(1.1), -9.81 + 4.0 * sine(0.5) * blow],
        rate_rad_s: [4.0 * sine(2.3) * blow, 3.0 * sine(1.9), 2.0 * sine(0.3)],
    }
}

/// Flies `seconds` and gives every answer to `look`, from the image's first step on.
fn fly(seconds: u32, mut look: impl FnMut(u32, &Motion, &Answer)) {
    let mut emulator = Emulator::start();
    let mut motion = thrown_about(0);
    let mut answer = emulator.step(&motion);
    while answer.record.is_none() {
        answer = emulator.step(&motion);
    }
    for step in 0..seconds * SAMPLE_HZ {
        look(step, &motion, &answer);
        motion = thrown_about(step);
        answer = emulator.step(&motion);
    }
}

fn bits(thrust_n: [f32; 4]) -> [u32; 4] {
    thrust_n.map(f32::to_bits)
}

/// FNV-1a of thrusts, as the image's log has it.
fn hash(before: u32, thrust_n: [f32; 4]) -> u32 {
    bits(thrust_n).into_iter().fold(before, |hash, word| (hash ^ word).wrapping_mul(0x0100_0193))
}

#[test]
fn the_image_decides_what_the_host_decides_to_the_bit_for_a_minute() {
    let mut host = Flight::try_new().expect("the shipped configuration");
    let (mut last, mut logged) = (0, 0);
    let mut hashes = [0x811c_9dc5_u32; 2];
    fly(SECONDS, |_, motion, answer| {
        let record = answer.record.expect("it has begun");
        assert_eq!(record.step, last + 1, "one step a sample");
        last = record.step;
        let imu = record.imu.expect("a sample each step");
        agrees(&record, motion);
        assert!(imu.rate_rad_s.x.is_finite());

        let step = host.step(record.time_us, &record.measurements());
        hashes = [hash(hashes[0], record.thrust_n), hash(hashes[1], step.output.thrust_n)];
        assert_eq!(
            (bits(record.thrust_n), record.rejected, record.command),
            (bits(step.output.thrust_n), step.output.rejected, step.command),
            "step {}, image and host differ: {record:?}",
            record.step
        );
        if record.step % SAMPLE_HZ == 0 {
            println!("second {}: image {:08x}, host {:08x}", record.step / SAMPLE_HZ, hashes[0], hashes[1]);
        }
        logged += answer.log.matches("late 0, rejected 0, blind 0").count();
    });
    assert!(logged + 2 >= SECONDS as usize, "a good report each second, {logged} of them");
}

/// The sample must be what the body does, to half a count of the part's scales, or the end of its range.
fn agrees(record: &Record, motion: &Motion) {
    let imu = record.imu.expect("a sample");
    let (rate, force) = (imu.rate_rad_s, imu.specific_force_m_s2);
    let half_count = [2_000_f32.to_radians() / 65_536.0, 16.0 * 9.81 / 65_536.0];
    // The part's g is 9.80665 m/s², the core's 9.81.
    let scale = [0.0, 4e-4];
    for (got, told, kind) in [
        (rate.x, motion.rate_rad_s[0], 0),
        (rate.y, motion.rate_rad_s[1], 0),
        (rate.z, motion.rate_rad_s[2], 0),
        (force.x, motion.force_m_s2[0], 1),
        (force.y, motion.force_m_s2[1], 1),
        (force.z, motion.force_m_s2[2], 1),
    ] {
        let range = half_count[kind] * 65_534.0;
        let error = (got - told.clamp(-range, range)).abs();
        assert!(error <= 1.01 * half_count[kind] + scale[kind] * told.abs(), "{got}, told {told}");
    }
}

#[test]
fn two_runs_are_the_same_to_the_cycle_and_the_letter() {
    let run = || {
        let mut answers = Vec::new();
        fly(3, |_, _, answer| answers.push(answer.clone()));
        answers
    };
    let (first, second) = (run(), run());
    let differing = first.iter().zip(&second).position(|(a, b)| a != b);
    assert_eq!((differing, first.len()), (None, second.len()));
}

#[test]
fn motor_frames_follow_samples_in_time_and_no_motor_turns() {
    let mut end = None;
    fly(3, |step, _, answer| {
        let record = answer.record.expect("it has begun");
        assert_eq!(record.command, Command::Stop);
        assert_eq!(answer.told, STOP, "step {step}");
        end = Some(answer.clone());
    });
    let end = end.expect("it flew");
    let load = end.busy as f64 / end.cycles as f64;
    println!(
        "load {:.1} %; from sample to frame at most {} cycles, {:.1} us",
        100.0 * load,
        end.latency_max,
        end.latency_max as f64 / CORE_HZ * 1e6
    );
    // A quarter of the period, of which the frame itself takes 27 µs.
    assert!(end.latency_max as f64 <= 0.25 * CORE_HZ / f64::from(SAMPLE_HZ), "{} cycles", end.latency_max);
    assert!(load <= 0.5, "{load}");
    assert!(end.understood.iter().all(|&frames| frames >= 3 * SAMPLE_HZ), "{:?}", end.understood);
}

#[test]
fn the_pilots_sticks_arrive() {
    let mut emulator = Emulator::start();
    let mut channels = [992; 16];
    (channels[0], channels[2]) = (1_811, 172);
    let mut heard = String::new();
    for step in 0..3 * SAMPLE_HZ {
        // 50 frames a second.
        if step % 40 == 0 {
            emulator.send_channels(channels);
        }
        heard += &emulator.step(&thrown_about(step)).log;
    }
    assert!(heard.contains("pilot 0.998") && heard.contains(" 0.0 -1.0 0.0, arm 0.0"), "{heard}");
}
