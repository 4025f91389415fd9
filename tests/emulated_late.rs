//! A core that something steals time from: on the emulator, in the image that is flashed.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_late`.
use system_tests::aloft::{Aloft, ByHand, SAMPLE_HZ};
use system_tests::host::Host;

/// When the core gets slow, and until when it is told to hover, s.
const SLOW_S: f64 = 12.5;
const HELD_S: f64 = 19.5;

/// What a flight saw of it.
struct Told {
    /// Steps that began while it was slow, and how many followed a late one.
    steps: u32,
    late: u32,
    /// When the motors stood, s.
    stood_s: f64,
    /// The most it tilted, rad.
    tilt_rad: f64,
    aloft: Aloft,
    log: String,
}

/// Takes off, is held over the pad by hand in angle mode at 1.5 m, and is landed; from 12.5 s on all that the core does takes so many
/// percent of its cycles. The host decides the same to the bit.
fn fly_slowed(percent: u32) -> Told {
    let (mut aloft, mut pilot, mut host) = (Aloft::on_the_ground(), ByHand::default(), Host::default());
    let (mut slow_step, mut late, mut stood_s, mut tilt_rad, mut log) = (None, 0, f64::MAX, 0.0_f64, String::new());
    while aloft.time_s() < 24.0 {
        let (t_s, truth) = (aloft.time_s(), aloft.truth());
        if t_s >= SLOW_S && slow_step.is_none() {
            aloft.tell(|emulator| emulator.slow_down(percent));
            slow_step = Some(host.last);
        }
        aloft.step(&pilot.hands(t_s, &truth));
        log += &aloft.answer.log;
        if let Some(record) = aloft.answer.record.filter(|record| record.step != host.last) {
            host.follow(&record);
            late += u32::from(record.arrived.late);
        }
        if slow_step.is_some() {
            tilt_rad = tilt_rad.max(truth.tilt_rad());
            if aloft.answer.told == [Some(0); 4] {
                stood_s = stood_s.min(t_s);
            }
        }
    }
    let steps = host.last - slow_step.unwrap_or(0);
    println!("{percent} %: {late} of {steps} steps late, tilt {tilt_rad:.3} rad, stood at {stood_s:.1} s\n{log}");
    Told { steps, late, stood_s, tilt_rad, aloft, log }
}

/// Came down as it should, and nobody has reset it.
fn assert_landed(told: &Told) {
    assert!(!told.log.contains("the watchdog"), "{}", told.log);
    let truth = told.aloft.truth();
    assert!(truth.touching && truth.impact_m_s < 1.5 && told.tilt_rad < 0.2, "{} rad, {truth:?}", told.tilt_rad);
}

#[test]
fn a_core_that_is_late_now_and_then_tells_of_it_and_flies_on() {
    let told = fly_slowed(175);
    assert_landed(&told);
    assert!(told.late > 0 && told.late < told.steps / 4, "{} of {}", told.late, told.steps);
    assert!(told.stood_s > HELD_S, "it does as it is told: {} s", told.stood_s);
    let tells = told.log.lines().rev().find_map(|line| line.split("late ").nth(1)?.split(',').next()?.parse().ok());
    assert!(tells.is_some_and(|late: u32| late > 0 && late <= told.late), "{tells:?}, {}", told.log);
}

#[test]
fn one_that_is_late_at_every_step_lands_by_itself() {
    let told = fly_slowed(400);
    assert_landed(&told);
    let (seconds, per_s) = (24.0 - SLOW_S, f64::from(told.steps) / (24.0 - SLOW_S));
    assert!(
        told.late > told.steps - 10 && per_s < 0.75 * f64::from(SAMPLE_HZ),
        "{} of {} in {seconds} s",
        told.late,
        told.steps
    );
    assert!(told.stood_s < HELD_S, "while it is told to hover: {} s", told.stood_s);
}
