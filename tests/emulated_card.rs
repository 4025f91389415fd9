//! The flight log on its card: what a board writes, a PC reads and `sim-host replay` decides again; and what a card that is slow, absent,
//! full, stuck or pulled out does to it, and to nothing else. The flight itself is in `emulated.rs`.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_card`.
use sim_host::emulator::Mishap;
use system_tests::aloft::{Aloft, ByHand, SAMPLE_HZ};
use system_tests::card::Card;
use system_tests::logged::{assert_on_time, read, stand, whole};
use system_tests::sim_host;

/// What the image may be busy, with the log.
const LOAD_MAX: f64 = 0.5;

#[test]
fn a_flight_is_decided_again_from_its_log_to_the_bit() {
    let card = Card::prepared();
    let mut aloft = Aloft::with_card(&card);
    let (mut pilot, mut steps, mut highest_m) = (ByHand::default(), 0, 0.0_f64);
    while aloft.time_s() < 23.5 {
        let (t_s, truth) = (aloft.time_s(), aloft.truth());
        if t_s > 12.5 {
            // A chipped propeller.
            aloft.actuation.drives[1].share = 0.85;
        }
        aloft.step(&pilot.hands(t_s, &truth));
        steps = aloft.answer.record.map_or(steps, |record| record.step);
        highest_m = highest_m.max(truth.altitude_m());
        if !aloft.answer.log.is_empty() {
            println!("{}", aloft.answer.log);
        }
    }
    let load = aloft.answer.busy as f64 / aloft.answer.cycles as f64;
    println!("load {:.1} %, {highest_m:.2} m high, {} bytes of log", 100.0 * load, card.log().len());
    assert!(highest_m > 1.0 && aloft.truth().touching);
    assert!(load <= LOAD_MAX, "{load}");

    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("FLIGHT.LOG");
    std::fs::write(&file, card.log()).expect("written");
    let output = sim_host(&["replay", &file.to_string_lossy(), "--out", &folder.path().to_string_lossy()]);
    let text = String::from_utf8_lossy(&output.stdout);
    println!("{text}");
    assert!(output.status.success() && text.contains("\nno bit differs\n"), "{text}{output:?}");
    for happened in ["armed\n", "in the air\n", "on the ground\n", "disarmed\n"] {
        assert!(text.contains(happened), "{happened}: {text}");
    }
    // All but those of the last block, and of what waited.
    let compared = text.lines().find_map(|line| line.split_once(" commands compared")).expect("it says how many").0;
    let compared: u32 = compared.parse().expect("a number");
    assert!((steps - SAMPLE_HZ / 10..=steps).contains(&compared), "{compared} of {steps}");
}

#[test]
fn each_start_of_the_board_has_a_log_of_its_own_and_a_torn_one_is_read_to_where_it_was_torn() {
    let card = Card::prepared();
    let mut aloft = Aloft::with_card(&card);
    let log = stand(&mut aloft, 1.6);
    assert!(log.contains("the flight log is in FLIGHT.LOG"), "{log}");
    aloft.inflict(Mishap::PowerCut);
    let log = stand(&mut aloft, 4.0);
    assert_on_time(&log, 1);
    // The card may be within a block now, and stays so: the chip alone starts anew.
    aloft.inflict(Mishap::Hang);
    let log = stand(&mut aloft, 6.5);
    assert!(log.contains("the watchdog has reset the chip"), "{log}");
    assert_on_time(&log, 1);
    let log = card.log();
    let all = read(&log);
    assert_eq!(all.len(), 3);
    for (told, seconds) in all.iter().zip([1.6, 2.4, 2.5]) {
        assert_eq!(told.flown.board, "SpeedyBee F405 V4");
        assert_eq!(told.flown.resumed, None);
        // What had not filled a block is lost, and what a block was torn of.
        let steps = told.steps as f64;
        println!("{steps} steps of {seconds} s, {:?}", told.damage);
        assert!((0.9 * seconds..seconds).contains(&(steps / f64::from(SAMPLE_HZ))), "{steps} steps of {seconds} s");
        assert!(told.gaps.is_empty() && told.damage.len() <= 1, "{:?}", told.damage);
    }

    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("FLIGHT.LOG");
    std::fs::write(&file, &log).expect("written");
    for (start, says) in [("1", "start 1 of 3"), ("3", "start 3 of 3")] {
        let arguments =
            ["replay", &file.to_string_lossy(), "--start", start, "--out", &folder.path().to_string_lossy()];
        let output = sim_host(&arguments);
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success() && text.contains(says) && text.contains("no bit differs\n"),
            "{text}{output:?}"
        );
    }
    let csv = std::fs::read_to_string(folder.path().join("log.csv")).expect("written");
    assert!(csv.starts_with("t_s,step,rate_x_rad_s") && csv.lines().count() > 100, "{csv}");
}

#[test]
fn a_flight_that_goes_on_after_a_reset_in_the_air_has_a_log_of_its_own_and_is_decided_again() {
    let card = Card::prepared();
    let mut aloft = Aloft::with_card(&card);
    let (mut pilot, mut log, mut hung) = (ByHand::default(), String::new(), false);
    while aloft.time_s() < 12.5 {
        if aloft.time_s() > 9.0 && !hung {
            aloft.inflict(Mishap::Hang);
            hung = true;
        }
        aloft.step(&pilot.hands(aloft.time_s(), &aloft.truth()));
        log += &aloft.answer.log;
    }
    assert!(log.contains("the flight goes on") && aloft.truth().altitude_m() > 1.0, "{log}");
    let all = read(&card.log());
    let [before, after] = &all[..] else { panic!("{} logs", all.len()) };
    println!("{} and {} steps", before.steps, after.steps);
    for (told, resumed, seconds) in [(before, false, 8), (after, true, 3)] {
        assert_eq!(told.flown.resumed.is_some(), resumed);
        // The reset may tear a block, and what had not filled one is lost.
        assert!(told.gaps.is_empty() && told.damage.len() <= 1, "{:?}, {:?}", told.gaps, told.damage);
        assert!(told.steps > u64::from(seconds * SAMPLE_HZ), "{} steps", told.steps);
    }
    // It goes on from what the log says that it remembered.
    for told in [before, after] {
        assert_eq!(u64::from(told.verdict.commands), told.steps);
    }
}

#[test]
fn a_card_that_takes_a_quarter_of_a_second_now_and_then_costs_no_step_and_nothing_of_the_log() {
    let card = Card::prepared();
    let mut aloft = Aloft::prepared(|emulator| {
        emulator.put_card(Some(card.path()));
        emulator.set_log_busy(1_000, 250_000, 90);
    });
    let log = stand(&mut aloft, 5.0);
    assert_on_time(&log, 4);
    let told = read(&card.log()).remove(0);
    assert!(whole(&told) > u64::from(4 * SAMPLE_HZ), "{} steps", told.steps);
}

#[test]
fn a_card_that_is_slower_than_the_flight_costs_what_is_told_and_no_step() {
    let card = Card::prepared();
    let mut aloft = Aloft::prepared(|emulator| {
        emulator.put_card(Some(card.path()));
        emulator.set_log_busy(25_000, 0, 0);
    });
    let log = stand(&mut aloft, 8.0);
    assert_on_time(&log, 7);
    assert!(log.contains(" blocks of the flight log are lost"), "{log}");
    let told = read(&card.log()).remove(0);
    let missing: u32 = told.gaps.iter().map(|gap| gap.before.0 - gap.after.0 - 1).sum();
    assert!(missing > SAMPLE_HZ && told.damage.is_empty(), "{missing} of {:?}", told.gaps);
}

#[test]
fn no_card_an_empty_one_a_full_one_and_one_that_hangs_or_is_pulled_out_are_told_and_harm_nothing() {
    let mut aloft = Aloft::prepared(|_| {});
    let empty = aloft.answer.log.clone() + &stand(&mut aloft, 2.5);
    assert_eq!(empty.matches("no flight log: there is no card").count(), 1, "{empty}");
    assert_on_time(&empty, 1);

    let log = stand(&mut Aloft::with_card(&Card::formatted()), 2.5);
    assert_eq!(log.matches("no flight log: the card has no FLIGHT.LOG").count(), 1, "{log}");
    assert_on_time(&log, 1);

    let full = Card::with_room_for(40_000);
    let log = stand(&mut Aloft::with_card(&full), 3.0);
    assert_eq!(log.matches("no flight log: FLIGHT.LOG is full").count(), 1, "{log}");
    assert_on_time(&log, 1);
    assert_eq!(full.log().len(), 40_000 / 512 * 512);
    whole(&read(&full.log())[0]);

    let card = Card::prepared();
    let mut aloft = Aloft::with_card(&card);
    let mut log = stand(&mut aloft, 1.5);
    aloft.tell(|emulator| emulator.set_log_busy(3_000_000, 0, 0));
    log += &stand(&mut aloft, 3.5);
    assert!(log.contains("no flight log: the card fails"), "{log}");
    aloft.tell(|emulator| emulator.set_log_busy(400, 0, 0));
    log += &stand(&mut aloft, 7.0);
    aloft.tell(|emulator| emulator.put_card(None));
    log += &stand(&mut aloft, 9.0);
    assert!(log.contains("no flight log: there is no card"), "{log}");
    aloft.tell(|emulator| emulator.put_card(Some(card.path())));
    log += &stand(&mut aloft, 11.5);
    assert_on_time(&log, 9);
    assert_eq!(log.matches("the flight log is in FLIGHT.LOG").count(), 3, "{log}");
    let all = read(&card.log());
    assert_eq!(all.len(), 3);
    for told in &all[1..] {
        assert!(told.gaps[0].after.0 == 0 && told.verdict.commands == 0, "it begins in the middle: {:?}", told.gaps);
    }
}
