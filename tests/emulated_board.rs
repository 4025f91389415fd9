//! What befalls the board: parts that fail, programs that stop, a supply that drops. On the emulator, in the image that is flashed.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_board`.
use sim_host::emulator::Mishap;
use system_tests::aloft::{Aloft, Hands};

/// What the motors did after a mishap while they idled.
struct After {
    /// How long they were told the same as before it, s.
    held_s: f64,
    /// How long frames let them turn, s.
    turned_s: f64,
    /// Longest time without an inertial sample that was believed, s.
    blind_s: f64,
    log: String,
}

/// Armed on the ground, rotors idling; then `mishap`, and a second.
fn idling_then(mishap: Mishap) -> After {
    let mut aloft = Aloft::on_the_ground();
    while aloft.time_s() < 7.0 {
        aloft.step(&Hands { arm: aloft.time_s() > 6.0, ..Hands::default() });
    }
    let before = aloft.answer.told;
    assert!(before.iter().all(|told| told.is_some_and(|told| told >= 48)), "{before:?}");
    aloft.inflict(mishap);
    let mut after = After { held_s: 0.0, turned_s: 0.0, blind_s: 0.0, log: String::new() };
    let (mut frames, mut sampled_s, mut holds) = (aloft.answer.understood[0], 7.0, true);
    while aloft.time_s() < 8.0 {
        aloft.step(&Hands { arm: true, ..Hands::default() });
        let (answer, now_s) = (&aloft.answer, aloft.time_s());
        after.log += &answer.log;
        if answer.record.is_none_or(|record| record.arrived.measurements.imu.is_some()) {
            sampled_s = now_s;
        }
        after.blind_s = after.blind_s.max(now_s - sampled_s);
        holds &= answer.told == before;
        after.held_s = if holds { now_s - 7.0 } else { after.held_s };
        if answer.understood[0] > frames && answer.told.iter().flatten().any(|&told| told > 0) {
            after.turned_s = now_s - 7.0;
        }
        frames = answer.understood[0];
    }
    println!("{mishap:?}: held {:.4} s, turned {:.4} s, blind {:.4} s", after.held_s, after.turned_s, after.blind_s);
    after
}

#[test]
fn without_its_data_ready_line_the_inertial_unit_is_read_by_time_and_flown_on() {
    let After { turned_s, blind_s, log, .. } = idling_then(Mishap::NoDataReady);
    assert!(turned_s > 0.99, "{turned_s} s");
    assert!(blind_s < 0.003, "{blind_s} s");
    assert!(log.contains("data-ready line: silent true") && !log.contains("watchdog"), "{log}");
}

#[test]
fn an_inertial_unit_that_says_nothing_or_anything_is_not_believed_and_the_motors_stop() {
    for mishap in [Mishap::AllZeros, Mishap::AllOnes, Mishap::Garbage] {
        let After { turned_s, blind_s, log, .. } = idling_then(mishap);
        // They stop when the autopilot has had no rates for 0.1 s.
        assert!(turned_s <= 0.13, "{mishap:?}: {turned_s} s");
        assert!(blind_s > 0.9, "{mishap:?}: {blind_s} s");
        assert!(!log.contains("watchdog"), "{mishap:?}: {log}");
    }
}

#[test]
fn a_panic_cuts_the_motors_at_once_and_its_words_are_reported_after_the_reset() {
    let After { turned_s, log, .. } = idling_then(Mishap::Panic);
    assert!(turned_s <= 0.001, "{turned_s} s");
    let words = "before this start: panicked at injected:1:1:\nindex out of bounds: the len is 4 but the index is 7";
    assert!(log.contains(words) && log.contains("the watchdog has reset the chip"), "{log}");
}

#[test]
fn so_does_one_of_the_hardware_layer_and_who_called_it_is_reported() {
    let After { turned_s, log, .. } = idling_then(Mishap::DefmtPanic);
    assert!(turned_s <= 0.001, "{turned_s} s");
    // Where the emulator calls from, in flash (emulator/src/machine/mishaps.rs).
    let words = "before this start: defmt panic, called from 0x080bffdf";
    assert!(log.contains(words) && log.contains("the watchdog has reset the chip"), "{log}");
}

#[test]
fn a_supply_that_drops_stops_the_motors_and_is_told_of() {
    let After { turned_s, log, .. } = idling_then(Mishap::BrownOut);
    assert!(turned_s <= 0.001, "{turned_s} s");
    assert!(log.contains("the supply was too low") && !log.contains("the watchdog"), "{log}");
}
