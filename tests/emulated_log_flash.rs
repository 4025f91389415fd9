//! The flight log in a flash chip, where a board has no card: what it writes is decided again by `sim-host replay`; what power that fails, a
//! chip that is slow, full or of somebody else do to it, and to nothing else.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_log_flash`.
use flight_link::{FromBoard, LogRefusal, LogWish, ToBoard};
use sim_host::emulator::{Mishap, Served};
use sim_host::replay::starts;
use system_tests::aloft::{Aloft, ByHand, Hands, SAMPLE_HZ};
use system_tests::card::Card;
use system_tests::log_flash::LogFlash;
use system_tests::logged::{assert_on_time, read, stand, whole};
use system_tests::sim_host;

/// What the image may be busy, with the log.
const LOAD_MAX: f64 = 0.5;

fn on_the_ground(flash: &LogFlash) -> Aloft {
    Aloft::prepared(|emulator| emulator.solder_log_flash(flash.path()))
}

/// Flies by hand until `until_s`; what the image logs meanwhile.
fn fly(aloft: &mut Aloft, until_s: f64) -> String {
    let (mut pilot, mut log) = (ByHand::default(), String::new());
    while aloft.time_s() < until_s {
        aloft.step(&pilot.hands(aloft.time_s(), &aloft.truth()));
        log += &aloft.answer.log;
    }
    log
}

#[test]
fn a_flight_is_decided_again_from_the_chip_and_power_that_fails_aloft_leaves_all_but_the_last_pages() {
    let flash = LogFlash::blank();
    let mut aloft = on_the_ground(&flash);
    let log = aloft.answer.log.clone() + &fly(&mut aloft, 10.0);
    assert!(log.contains("the flight log is in the log flash, block"), "{log}");
    assert_on_time(&log.replace("INFO", "\nINFO"), 8);
    assert!(aloft.truth().altitude_m() > 1.0);
    let load = aloft.answer.busy as f64 / aloft.answer.cycles as f64;
    println!("load {:.1} %", 100.0 * load);
    assert!(load <= LOAD_MAX, "{load}");
    let steps = aloft.answer.record.expect("it has stepped").step;
    aloft.inflict(Mishap::PowerCut);
    let log = stand(&mut aloft, 11.5);
    assert!(log.contains("the flight log is in the log flash, block"), "{log}");
    let all = read(&flash.log());
    let [flown, after] = &all[..] else { panic!("{} logs", all.len()) };
    println!("{} of {steps} steps and {}, {:?}", flown.steps, after.steps, flown.damage);
    println!("{} bytes of log", flash.log().len());
    // What had not filled a block, and what waited.
    assert!((u64::from(steps - SAMPLE_HZ / 10)..=u64::from(steps)).contains(&flown.steps));
    assert!(flown.gaps.is_empty() && flown.damage.len() <= 1 && u64::from(flown.verdict.commands) == flown.steps);
    assert!(whole(after) > u64::from(SAMPLE_HZ));

    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("FLIGHT.LOG");
    std::fs::write(&file, flash.log()).expect("written");
    let [file, out] = [&file, folder.path()].map(|path| path.to_string_lossy().into_owned());
    let output = sim_host(&["replay", &file, "--start", "1", "--out", &out]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("\nno bit differs\n"), "{text}{output:?}");
    assert!(text.contains("in the air\n"), "{text}");
}

#[test]
fn a_chip_that_takes_the_longest_that_is_allowed_for_every_page_costs_no_step_and_nothing_of_the_log() {
    let flash = LogFlash::blank();
    let mut aloft = Aloft::prepared(|emulator| {
        emulator.solder_log_flash(flash.path());
        emulator.set_log_busy(3_000, 0, 0);
    });
    let log = stand(&mut aloft, 4.0);
    assert_on_time(&log, 3);
    let log = flash.log();
    // It may be within the last block.
    let told = read(&log[..log.len() - 512]).remove(0);
    assert!(whole(&told) > u64::from(3 * SAMPLE_HZ));
}

#[test]
fn a_chip_that_is_full_or_somebody_elses_is_told_and_left_as_it_is() {
    // Room for less than a second.
    let mut blocks = vec![0; (16 << 20) - 100 * 512];
    for (full, content) in [
        (true, {
            blocks[..2].copy_from_slice(b"QF");
            &blocks[..]
        }),
        (false, &b"Blackbox"[..]),
    ] {
        let flash = LogFlash::filled(content);
        let log = stand(&mut on_the_ground(&flash), 3.0);
        assert_eq!(log.matches("no flight log: the log flash is full").count(), 1, "{log}");
        assert_on_time(&log, 1);
        assert_eq!(flash.log().len(), if full { 16 << 20 } else { 512 });
        if full {
            whole(&read(&flash.log()[content.len()..])[0]);
        }
    }
}

#[test]
fn a_flight_is_fetched_over_the_station_line_and_decided_again_and_then_erased() {
    let flash = LogFlash::blank();
    fly(&mut on_the_ground(&flash), 7.5);
    let flown = flash.log();
    let board = Served::start(600, Some(flash.path())).expect("emulator and image build");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("FLIGHT.LOG");
    let [fetched, out] = [&file, folder.path()].map(|path| path.to_string_lossy().into_owned());
    let told = |arguments: &[&str]| {
        let output = sim_host(&[&["station", "--port", &board.line, "log"], arguments].concat());
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{arguments:?}: {text}{output:?}");
        text
    };
    let list = told(&["list"]);
    assert!(
        list.contains("1: 0.") && list.contains("being written\n") && list.contains("of 16.78 MB are written"),
        "{list}"
    );
    println!("{list}{}", told(&["get", "--file", &fetched]));
    // As it is in the chip, but for a block that was torn when power was cut.
    let log = std::fs::read(&file).expect("written");
    assert_eq!(log.len(), flown.len());
    assert!(log == flown || log[..log.len() - 512] == flown[..log.len() - 512]);
    let output = sim_host(&["replay", &fetched, "--out", &out]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("\nno bit differs\n"), "{text}{output:?}");
    assert!(text.contains("in the air\n"), "{text}");

    assert_eq!(told(&["erase"]), "erased; the board has started anew\n");
    let list = told(&["list"]);
    assert!(list.contains("being written\n"), "{list}");
    drop(board);
    let all = read(&flash.log());
    assert_eq!(all.last().expect("a log").gaps, [], "it begins with its first step");
}

#[test]
fn a_log_is_neither_told_nor_erased_while_it_is_armed_nor_one_on_a_card() {
    let ask = |aloft: &mut Aloft, arm: bool, wish: LogWish, until_s: f64| {
        aloft.say(&ToBoard::Log(wish));
        while aloft.time_s() < until_s {
            aloft.step(&Hands { arm, ..Hands::default() });
        }
        let heard = aloft.heard().into_iter();
        heard.filter(|record| matches!(record, FromBoard::LogRefused(_) | FromBoard::LogSize(_))).collect::<Vec<_>>()
    };
    let flash = LogFlash::blank();
    let mut aloft = on_the_ground(&flash);
    let [FromBoard::LogSize(size)] = ask(&mut aloft, false, LogWish::Size, 5.9)[..] else { panic!("no answer") };
    assert_eq!((size.room, size.running), (32_768, 0));
    stand_armed(&mut aloft, 6.5);
    for (wish, until_s) in [(LogWish::Size, 6.6), (LogWish::Read(0, 9), 6.7), (LogWish::Erase, 6.8)] {
        assert_eq!(ask(&mut aloft, true, wish, until_s), [FromBoard::LogRefused(LogRefusal::Armed)], "{wish:?}");
    }
    assert!(flash.log().len() > 6 * 20_000, "nothing was erased");

    let mut aloft = Aloft::with_card(&Card::prepared());
    assert_eq!(ask(&mut aloft, false, LogWish::Size, 2.0), [FromBoard::LogRefused(LogRefusal::Absent)]);
}

/// Stands with motors that idle.
fn stand_armed(aloft: &mut Aloft, until_s: f64) {
    while aloft.time_s() < until_s {
        aloft.step(&Hands { arm: true, ..Hands::default() });
    }
}

#[test]
fn power_that_fails_while_the_chip_is_erased_leaves_older_logs_and_the_next_one_is_whole() {
    const SECTOR: usize = 64 << 10;
    let older = [b"QF", &[7; 510][..]].concat().repeat(3 * SECTOR / 512);
    let flash = LogFlash::filled(&older);
    let mut aloft = on_the_ground(&flash);
    stand(&mut aloft, 1.5);
    aloft.say(&ToBoard::Log(LogWish::Erase));
    // Of four sectors one is erased by then, and a part of the next.
    let log = stand(&mut aloft, 1.75);
    assert!(log.lines().all(|line| !line.contains("no flight log")), "{log}");
    aloft.inflict(Mishap::PowerCut);
    let log = stand(&mut aloft, 4.0);
    assert_on_time(&log, 1);
    let after = flash.log();
    assert!(after[..2 * SECTOR] == older[..2 * SECTOR], "what it had not come to is as it was");
    // What was half erased belongs to no log that can be read; the new one is behind it.
    let newest = starts(&mut &*after).expect("logs").pop().expect("a log");
    let told = read(&after[newest.offset as usize..]).remove(0);
    println!("{} steps, {:?}", told.steps, told.damage);
    assert!(told.steps > u64::from(2 * SAMPLE_HZ) && told.gaps.is_empty());
}
