//! A program that is stopped in the air: on the emulator, in the image that is flashed.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_restart`.
use sim_host::emulator::Mishap;
use system_tests::aloft::{Aloft, Hands, SAMPLE_HZ};
use system_tests::host::Host;

/// When the mishap comes, s.
const MISHAP_S: f64 = 12.5;
/// What the watchdog waits, s (firmware/src/board/mod.rs).
const WATCHDOG_S: f64 = 0.02;

/// What a flight saw of its mishap.
struct Told {
    /// From the mishap to the first frame after it that let a motor turn, s; none if there was none in a second.
    stood_s: Option<f64>,
    /// Lowest and highest altitude, and the most it tilted, in the 3.5 seconds after it, m and rad.
    altitude_m: [f64; 2],
    tilt_rad: f64,
    /// Steps since the last start that the host has decided too.
    decided: u32,
    log: String,
    aloft: Aloft,
}

/// Takes off, is held over the pad by hand in angle mode at 1.5 m, and is landed; `mishaps` come at their times. The host decides the
/// same to the bit, before and after, with what it has kept itself.
fn fly_by_hand(seconds: f64, stops_unheard: bool, mishaps: &[(f64, Mishap)]) -> Told {
    let mut aloft = Aloft::on_the_ground();
    aloft.stops_unheard = stops_unheard;
    let mut told = (None, [f64::MAX, f64::MIN], 0.0_f64, String::new());
    let (mut host, mut by_watchdog) = (Host::default(), true);
    let (mut climb, mut frames, mut pending) = (0.0, 0, mishaps.iter().peekable());
    while aloft.time_s() < seconds {
        let (t_s, truth) = (aloft.time_s(), aloft.truth());
        if pending.next_if(|(at_s, _)| t_s >= *at_s).is_some_and(|(_, mishap)| {
            aloft.inflict(*mishap);
            by_watchdog = *mishap != Mishap::BrownOut;
            true
        }) {
            frames = aloft.answer.understood[0] + 1;
        }
        let wanted_m = (0.6 * (t_s - 6.5)).clamp(0.0, 1.5).min(0.5 * (19.5 - t_s));
        let (error_m, sink_m_s) = (wanted_m - truth.altitude_m(), truth.velocity_m_s.z);
        climb = (climb + 0.0001 * error_m).clamp(0.0, 0.2);
        let lean = |position_m: f64, velocity_m_s: f64| (-0.10 * position_m - 0.15 * velocity_m_s).clamp(-0.4, 0.4);
        let flies = (6.5..20.5).contains(&t_s);
        aloft.step(&Hands {
            roll: lean(truth.position_m.y, truth.velocity_m_s.y),
            pitch: lean(truth.position_m.x, truth.velocity_m_s.x),
            throttle: if flies { (0.42 + climb + 0.25 * error_m + 0.15 * sink_m_s).clamp(0.0, 0.9) } else { 0.0 },
            arm: (6.0..22.0).contains(&t_s),
        });
        told.3 += &aloft.answer.log;
        if let Some(record) = aloft.answer.record.filter(|record| record.step != host.last) {
            if record.step < host.last {
                host.reset(by_watchdog, &record);
            }
            host.follow(&record);
        }
        let turn = aloft.answer.told.iter().any(|told| told.is_some_and(|told| told > 0));
        let since_s = t_s - mishaps[0].0;
        if (0.0005..1.0).contains(&since_s) && told.0.is_none() && aloft.answer.understood[0] > frames && turn {
            told.0 = Some(since_s);
        }
        if (0.0..3.5).contains(&since_s) {
            let (altitude_m, tilt_rad) = (aloft.truth().altitude_m(), aloft.truth().tilt_rad());
            told.1 = [told.1[0].min(altitude_m), told.1[1].max(altitude_m)];
            told.2 = told.2.max(tilt_rad);
        }
    }
    let (stood_s, altitude_m, tilt_rad, log) = told;
    println!("{mishaps:?}: stood {stood_s:?} s, {altitude_m:.2?} m, tilt {tilt_rad:.3} rad\n{log}");
    Told { stood_s, altitude_m, tilt_rad, decided: host.last, log, aloft }
}

/// Flew on after the mishap, landed and stands.
fn assert_flown_on(told: &Told) {
    let stood_s = told.stood_s.expect("it goes on");
    assert!(stood_s - WATCHDOG_S <= 0.1, "{stood_s} s after the mishap");
    assert!(told.log.contains("the watchdog has reset the chip"), "{}", told.log);
    assert!(told.log.contains("the flight goes on"), "{}", told.log);
    assert!(told.decided > 10 * SAMPLE_HZ, "{} steps since", told.decided);
    let ([lowest_m, highest_m], truth) = (told.altitude_m, told.aloft.truth());
    assert!(
        lowest_m > 1.3 && highest_m < 1.7 && told.tilt_rad < 0.3,
        "{lowest_m} to {highest_m} m, {} rad",
        told.tilt_rad
    );
    assert!(truth.touching && truth.impact_m_s < 1.5, "{truth:?}");
    assert_eq!(told.aloft.answer.told, [Some(0); 4], "disarmed by the switch");
}

#[test]
fn a_program_that_hangs_in_the_air_flies_on_within_a_tenth_of_a_second_of_the_reset_and_lands() {
    assert_flown_on(&fly_by_hand(23.5, true, &[(MISHAP_S, Mishap::Hang)]));
}

#[test]
fn so_does_one_that_panics_and_whose_speed_controllers_go_on_meanwhile() {
    let told = fly_by_hand(23.5, false, &[(MISHAP_S, Mishap::Panic)]);
    assert_flown_on(&told);
    assert!(told.log.contains("before this start: panicked"), "{}", told.log);
}

#[test]
fn one_that_hangs_again_within_ten_seconds_or_whose_supply_drops_stays_disarmed() {
    let told = fly_by_hand(17.5, true, &[(MISHAP_S, Mishap::Hang), (MISHAP_S + 3.0, Mishap::Hang)]);
    assert!(told.stood_s.is_some() && told.log.matches("the flight goes on").count() == 1, "{}", told.log);
    assert_eq!(told.log.matches("the watchdog has reset the chip").count(), 2, "{}", told.log);
    assert!(told.aloft.truth().impact_m_s > 2.0, "{:?}", told.aloft.truth());
    let told = fly_by_hand(14.0, true, &[(MISHAP_S, Mishap::BrownOut)]);
    assert_eq!(told.stood_s, None);
    assert!(!told.log.contains("the flight goes on"), "{}", told.log);
}
