//! The image that is flashed, flown on the emulator: it must be the host's core to the bit, in time, and the same every time.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated`.
use control_core::flight::Command;
use firmware::record::Record;
use sim_host::controllers::ControllerName;
use sim_host::emulator::{Answer, Emulator, Mishap, Motion};
use sim_host::flight::{Flight as Sortie, NumberFormat};
use sim_host::metrics::{Flown, METRICS, fly_measured};
use sim_host::plant::Truth;
use sim_host::scenario::Scenario;
use sim_host::through::{self, Board};
use std::f32::consts::TAU;
use system_tests::aloft::{Aloft, ByHand, Hands, SAMPLE_HZ};
use system_tests::host::Host;
use system_tests::{root, shipped};

/// How long it is thrown about, s.
const SECONDS: u32 = 4;
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
    let mut emulator = Emulator::start().expect("emulator and image build");
    let mut period = |motion: &Motion| {
        emulator.move_body(motion);
        emulator.period().expect("the image runs")
    };
    let mut motion = thrown_about(0);
    let mut answer = period(&motion);
    while answer.record.is_none() {
        answer = period(&motion);
    }
    for step in 0..seconds * SAMPLE_HZ {
        look(step, &motion, &answer);
        motion = thrown_about(step);
        answer = period(&motion);
    }
}

#[test]
fn it_arms_takes_off_loses_part_of_a_rotor_lands_and_disarms_as_the_host_would() {
    let mut aloft = Aloft::on_the_ground();
    let mut host = Host::default();
    let (mut tilt_rad, mut hover_m, mut ran) = (0.0_f64, Vec::new(), 0);
    let mut pilot = ByHand::default();
    while aloft.time_s() < 23.5 {
        let (t_s, truth) = (aloft.time_s(), aloft.truth());
        let hands = pilot.hands(t_s, &truth);
        if t_s > 12.5 {
            // A chipped propeller.
            aloft.actuation.drives[1].share = 0.85;
        }
        aloft.step(&hands);
        if let Some(record) = aloft.answer.record {
            if record.step > host.last {
                host.follow(&record);
            }
            ran += u32::from(matches!(record.command, Command::Run(_)));
        }
        if !aloft.answer.log.is_empty() {
            println!("{}", aloft.answer.log);
        }
        if t_s < 6.0 {
            assert_eq!(aloft.answer.told.map(|told| told.unwrap_or(0)), [0; 4], "{t_s} s");
        }
        tilt_rad = tilt_rad.max(aloft.truth().tilt_rad());
        if (10.5..16.5).contains(&t_s) {
            hover_m.push(aloft.truth().altitude_m());
        }
    }
    let end = aloft.truth();
    let highest = hover_m.iter().copied().fold(f64::MIN, f64::max);
    let lowest = hover_m.iter().copied().fold(f64::MAX, f64::min);
    println!("hover {lowest:.2} to {highest:.2} m, tilt at most {tilt_rad:.4} rad, {ran} steps with rotors running");
    println!("down at {:?}, impact {:.2} m/s", end.position_m, end.impact_m_s);
    assert!(lowest > 1.0 && highest < 2.2, "{lowest} to {highest} m");
    assert!(tilt_rad < 0.6, "{tilt_rad} rad");
    assert!(end.touching && end.impact_m_s < 1.5, "{end:?}");
    assert_eq!(aloft.answer.told, STOP, "disarmed");
    assert!(ran > 15 * SAMPLE_HZ, "{ran}");
    let load = aloft.answer.busy as f64 / aloft.answer.cycles as f64;
    println!(
        "load {:.1} %; from sample to frame at most {} cycles, {:.1} us",
        100.0 * load,
        aloft.answer.latency_max,
        aloft.answer.latency_max as f64 / CORE_HZ * 1e6
    );
    // Four fifths of a period, of which the frame itself takes 27 µs.
    assert!(aloft.answer.latency_max as f64 <= 0.8 * CORE_HZ / f64::from(SAMPLE_HZ));
    assert!(load <= 0.5, "{load}");
}

/// What `fly --through emulator` makes of the shipped flight, and where it ended.
fn through_emulator(scenario: &Scenario) -> (Flown, Board, Option<(Truth, bool)>) {
    let mut end = None;
    let (flown, board) = through::fly_measured(&sortie(scenario), &mut |sample| {
        end = sample.decision.map(|decision| (*sample.truth, decision.command.armed));
    })
    .expect("the image runs to the end");
    (flown, board, end)
}

fn sortie(scenario: &Scenario) -> Sortie<'_> {
    Sortie { scenario, controller: ControllerName::Default, seed: 1, format: NumberFormat::F32 }
}

#[test]
fn the_shipped_flight_is_flown_by_the_image_as_by_the_host_and_twice_the_same() {
    let scenario = shipped("image/flight_on_the_image").for_image(&root()).expect("made for it");
    let ((flown, board, end), (_, again, _)) =
        rayon::join(|| through_emulator(&scenario), || through_emulator(&scenario));
    let Board { emulated_s, wall_s, load, latency_max_s, taken, verdict, log } = &board;
    for [image, host] in &verdict.seconds {
        println!("image {image:08x}, host {host:08x}");
    }
    println!("{emulated_s:.1} s in {wall_s:.1} s, load {load:.3}, worst {:.0} us; {taken:?}", 1e6 * latency_max_s);
    for (task, cycles) in taken.tasks.iter().filter(|(task, _)| task != "embassy_main") {
        // What follows the frames runs without a pause: a step is no longer than both together.
        let before_s = if task == "control" { *latency_max_s } else { 0.0 };
        assert!(before_s + *cycles as f64 / CORE_HZ < 1.0 / f64::from(SAMPLE_HZ), "{task}: {cycles} cycles");
    }
    let (used, bytes) = taken.stack_bytes;
    assert!(10 * used < 9 * bytes, "of the stack's {bytes} bytes {used} are used");
    assert_eq!(verdict.parting, None);
    assert!(verdict.commands > 70 * SAMPLE_HZ, "{}", verdict.commands);
    assert_eq!((&again.verdict, &again.log), (verdict, log), "another flight");
    assert!(*load <= 0.5 && *latency_max_s <= 0.9 / f64::from(SAMPLE_HZ), "{load}, {latency_max_s} s");
    let mut reports = log.lines().filter(|line| line.contains("steps ")).peekable();
    assert!(reports.peek().is_some() && reports.all(|line| line.contains("late 0, blind 0")), "{log}");

    let (truth, armed) = end.expect("it decided");
    assert!(flown.survived() && truth.touching && !armed, "{truth:?}");
    // The same scenario, at the same rate, on the same sensors: what differs is how the parts tell them.
    let native = fly_measured(&sortie(&scenario), &mut |_| {}).expect("it flies");
    for (name, most) in [("altitude_deviation_max_m", 0.03), ("lateral_deviation_max_m", 0.01), ("tilt_max_rad", 0.02)]
    {
        let metric = METRICS.iter().find(|metric| metric.name == name).expect("a metric");
        let [image, native] = [&flown, &native].map(|flown| (metric.of)(&flown.metrics).expect("there is a fault"));
        println!("{name}: {image:.4} on the image, {native:.4} native");
        assert!(image < most && (image - native).abs() < 0.5 * native, "{name}: {image}, native {native}");
    }
}

#[test]
fn each_sample_is_what_the_body_has_done_however_it_is_thrown_about() {
    let mut before = thrown_about(0);
    fly(SECONDS, |_, motion, answer| {
        agrees(&answer.record.expect("it has begun"), &before, motion);
        before = *motion;
    });
}

/// The sample must be what the body has done since the last one, in which time it moved evenly from `before` to `motion`: the mean of four
/// records, to half a count of the part's scales, or the end of its range.
fn agrees(record: &Record, before: &Motion, motion: &Motion) {
    let imu = record.arrived.measurements.imu.expect("a sample each step").value;
    let (rate, force) = (imu.rate_rad_s, imu.specific_force_m_s2);
    let half_count = [2_000_f32.to_radians() / 65_536.0, 16.0 * 9.81 / 65_536.0];
    // The part's g is 9.80665 m/s², the core's 9.81.
    let scale = [0.0, 4e-4];
    for (n, (rate, force)) in [(rate.x, force.x), (rate.y, force.y), (rate.z, force.z)].into_iter().enumerate() {
        let kinds = [(rate, before.rate_rad_s, motion.rate_rad_s), (force, before.force_m_s2, motion.force_m_s2)];
        for ((got, before, now), (half_count, scale)) in kinds.into_iter().zip(half_count.into_iter().zip(scale)) {
            let range = half_count * 65_534.0;
            let at = |quarter: f32| (before[n] + (now[n] - before[n]) * quarter / 4.0).clamp(-range, range);
            let told = [1.0, 2.0, 3.0, 4.0].map(at).iter().sum::<f32>() / 4.0;
            let error = (got - told).abs();
            assert!(error <= 1.01 * half_count + scale * told.abs(), "{got}, told {told}");
        }
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
fn the_log_says_why_arming_is_refused() {
    let mut aloft = Aloft::on_the_ground();
    let mut log = String::new();
    while aloft.time_s() < 2.1 {
        let t_s = aloft.time_s();
        aloft.step(&Hands { throttle: 0.3, arm: t_s > 0.5, ..Hands::default() });
        log += &aloft.answer.log;
    }
    assert_eq!(aloft.answer.told, STOP);
    for why in ["the throttle is not low", "the gyro is not calibrated"] {
        assert_eq!(log.matches(&format!("arming is refused: {why}")).count(), 1, "{log}");
    }
}

#[test]
fn speed_controllers_understand_every_frame_and_no_motor_turns_unarmed() {
    let mut end = None;
    fly(3, |step, _, answer| {
        assert_eq!(answer.record.expect("it has begun").command, Command::Stop);
        assert_eq!(answer.told, STOP, "step {step}");
        end = Some(answer.clone());
    });
    let end = end.expect("it flew");
    assert!(end.understood.iter().all(|&frames| frames >= 3 * SAMPLE_HZ), "{:?}", end.understood);
}

/// Armed on the ground, rotors idling; then `mishap`. Returns how long frames that let a motor turn were still sent, s, and
/// what the image logged in the second after.
fn idling_then(mishap: Mishap) -> (f64, String, Aloft) {
    let hands = Hands { arm: true, ..Hands::default() };
    let mut aloft = Aloft::on_the_ground();
    while aloft.time_s() < 7.0 {
        aloft.step(&Hands { arm: aloft.time_s() > 6.0, ..hands });
    }
    assert!(aloft.answer.told.iter().all(|told| told.is_some_and(|told| told >= 48)), "{:?}", aloft.answer.told);
    aloft.inflict(mishap);
    let (mut log, mut turned_s, mut frames) = (String::new(), 0.0, aloft.answer.understood[0]);
    while aloft.time_s() < 8.5 {
        aloft.step(&hands);
        log += &aloft.answer.log;
        let new = aloft.answer.understood[0] > frames;
        frames = aloft.answer.understood[0];
        if new && aloft.answer.told.iter().any(|told| told.is_some_and(|told| told > 0)) {
            turned_s = aloft.time_s() - 7.0;
        }
    }
    (turned_s, log, aloft)
}

#[test]
fn a_hard_fault_cuts_the_motors_at_once_and_is_reported_after_the_reset() {
    let (turned_s, log, aloft) = idling_then(Mishap::HardFault);
    println!("{log}");
    assert!(turned_s <= 0.001, "{turned_s} s");
    assert!(log.contains("before this start: hard fault at 0x60000000"), "{log}");
    assert!(log.contains("the watchdog has reset the chip"), "{log}");
    let before = log.split("the last step before this start: ").nth(1).expect("it is told");
    assert!(before.lines().nth(1).is_some_and(|line| line.contains("rates")), "{before}");
    assert!(before.lines().nth(2).is_some_and(|line| line.contains("motors 0.")), "{before}");
    // The switch is still on, but it has not gone on.
    assert_eq!(aloft.answer.told, STOP);
}

#[test]
fn a_stack_that_overflows_is_a_fault_that_cuts_the_motors_and_is_reported_after_the_reset() {
    let (turned_s, log, aloft) = idling_then(Mishap::StackOverflow);
    assert!(turned_s <= 0.001, "{turned_s} s");
    assert!(log.contains("before this start: hard fault: the stack has overflowed"), "{log}");
    assert_eq!(aloft.answer.told, STOP);
}

#[test]
fn a_program_that_hangs_is_reset_and_stays_disarmed() {
    let (turned_s, log, aloft) = idling_then(Mishap::Hang);
    assert!(turned_s <= 0.001, "{turned_s} s");
    assert!(log.contains("the watchdog has reset the chip"), "{log}");
    assert_eq!(aloft.answer.told, STOP);
}

#[test]
fn a_hang_below_control_costs_the_link_and_control_flies_on() {
    let (turned_s, log, aloft) = idling_then(Mishap::HangBelow);
    // Until the link is lost, half a second later, and the failsafe acts.
    assert!((0.4..0.6).contains(&turned_s), "{turned_s} s");
    assert!(log.is_empty(), "nobody logs any more: {log}");
    assert_eq!(aloft.answer.told, STOP);
}
