//! Parameters on a desk: asked for and set over the station's line, and power that is cut while they are stored. On the emulator, in
//! the image that is flashed.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_parameters`.
use control_core::parameters::{Declaration, TABLE, index_of};
use firmware::stored::PAGE;
use flight_link::{Decoder, FRAME_BYTES_MAX, FromBoard, Outcome, ParameterName, ToBoard, encode};
use sim_host::emulator::{Emulator, Mishap, Motion, Protocol, SECTOR_BYTES, Store};
use std::collections::BTreeSet;
use system_tests::aloft::SAMPLE_HZ;

const REST: Motion = Motion { force_m_s2: [0.0, 0.0, -9.81], rate_rad_s: [0.0; 3] };

fn declared(name: &str) -> &'static Declaration {
    &TABLE[index_of(name).expect("it is declared")]
}

fn padded(name: &str) -> ParameterName {
    std::array::from_fn(|n| name.as_bytes().get(n).copied().unwrap_or(0))
}

/// Sectors after these saves.
fn after(saves: impl IntoIterator<Item = (&'static str, f32)>) -> Store {
    Store::after(saves).expect("it may erase")
}

/// A board on a desk, and a station at its line.
struct Desk {
    emulator: Emulator,
    decoder: Decoder<FromBoard>,
    log: String,
}

impl Desk {
    /// Switched on with these sectors.
    fn with(sectors: &Store) -> Self {
        let mut desk = Self {
            emulator: Emulator::start().expect("emulator and image build"),
            decoder: Decoder::new(),
            log: String::new(),
        };
        desk.emulator.move_body(&REST);
        desk.emulator.fill_store(sectors);
        desk.pass(1);
        desk
    }

    /// Switched off, and on again with these sectors.
    fn restart_with(&mut self, sectors: &Store) {
        self.emulator.fill_store(sectors);
        self.restart();
    }

    fn restart(&mut self) {
        self.emulator.inflict(Mishap::PowerCut);
        // The rest of this period, and the boot.
        self.pass(2);
    }

    /// Lets periods of the inertial unit pass.
    fn pass(&mut self, periods: u32) {
        for _ in 0..periods {
            let answer = self.emulator.period().expect("the image runs");
            if !answer.log.is_empty() {
                self.log += &answer.log;
                self.log.push('\n');
            }
        }
    }

    /// Says something, and waits for an answer, but no longer than a second or until the next start.
    fn ask(&mut self, wish: &ToBoard) -> Option<(f32, Outcome)> {
        let mut place = [0; FRAME_BYTES_MAX];
        self.emulator.send_station(encode(wish, &mut place).expect("it fits"));
        let boots = self.boots();
        for _ in 0..SAMPLE_HZ {
            self.pass(1);
            let (_, heard) = self.emulator.station_heard().expect("the image runs");
            let answer = heard.into_iter().filter_map(|byte| self.decoder.push(byte)).find_map(|record| match record {
                FromBoard::Parameter(_, value, outcome) => Some((value, outcome)),
                _ => None,
            });
            if answer.is_some() {
                return answer;
            }
            if self.boots() > boots {
                self.pass(1);
                break;
            }
        }
        None
    }

    /// Waits until it has loaded its parameters, once more.
    fn pass_boot(&mut self) {
        let boots = self.boots();
        // Erasing takes a second a sector.
        for _ in 0..6 * SAMPLE_HZ {
            self.pass(1);
            if self.boots() > boots {
                // The tasks start.
                return self.pass(20);
            }
        }
        panic!("it does not start: {}", self.log);
    }

    /// How often the log, since it was cleared, says that parameters were loaded.
    fn boots(&self) -> usize {
        self.log.matches("parameters are set").count()
    }

    fn power_cuts(&mut self) -> u32 {
        self.emulator.station_heard().expect("the image runs").0
    }

    fn set(&mut self, name: &str, value: f32) -> Option<Outcome> {
        self.ask(&ToBoard::SetParameter(padded(name), value)).map(|(_, outcome)| outcome)
    }

    fn get(&mut self, name: &str) -> f32 {
        let said = self.ask(&ToBoard::GetParameter(padded(name)));
        said.unwrap_or_else(|| panic!("{name}: no answer; {}", self.log)).0
    }
}

/// What a save must not touch.
const KEPT: (&str, f32) = ("STICK_EXPO", 0.45);
/// What it changes, from and to, and what is saved afterwards.
const SAVED: (&str, [f32; 3]) = ("FS_LINK_S", [0.75, 1.25, 2.5]);

/// Saves a value over and over on the same sectors, power being cut before, or within, one operation of the flash after the
/// other, and looks at what is there after the restart. Returns how many operations a save has, and which values were found.
fn save_with_every_cut(sectors: &Store) -> (u32, BTreeSet<u32>) {
    std::thread::scope(|scope| {
        let flights = [false, true].map(|within| scope.spawn(move || save_with_cuts(sectors, within)));
        let [before, within] = flights.map(|flight| flight.join().expect("what was found is as it must be"));
        assert_eq!(before.0, within.0);
        (before.0, &before.1 | &within.1)
    })
}

fn save_with_cuts(sectors: &Store, within: bool) -> (u32, BTreeSet<u32>) {
    let (name, [before, after, later]) = SAVED;
    let mut desk = Desk::with(sectors);
    let mut found = BTreeSet::new();
    for whole in 0.. {
        let why = format!("cut after {whole} operations, the next {}", if within { "in part" } else { "not at all" });
        desk.restart_with(sectors);
        let cuts = desk.power_cuts();
        desk.log.clear();
        desk.emulator.cut_power_at(whole, within);
        if desk.set(name, after) == Some(Outcome::Restarting) {
            desk.pass_boot();
        }
        if desk.power_cuts() == cuts {
            assert_eq!(desk.get(name), after);
            return (whole, found);
        }
        let value = desk.get(name);
        assert!(value == before || value == after, "{why}: {value}");
        assert_eq!(desk.get(KEPT.0), KEPT.1, "{why}");
        found.insert(value.to_bits());
        // And it goes on working, which takes its time to see.
        if whole % 8 > 0 {
            continue;
        }
        match desk.set(name, later) {
            Some(Outcome::Stored) => {}
            Some(Outcome::Restarting) => desk.pass_boot(),
            other => panic!("{why}: {other:?}; {}", desk.log),
        }
        desk.restart();
        assert_eq!((desk.get(name), desk.get(KEPT.0)), (later, KEPT.1), "{why}");
    }
    unreachable!("a save ends")
}

#[test]
fn power_cut_at_any_operation_of_a_save_leaves_the_old_value_or_the_new_one() {
    let (operations, found) = save_with_every_cut(&after([KEPT, (SAVED.0, SAVED.1[0])]));
    println!("{operations} operations, {found:?} found");
    assert!(operations >= 8, "header, key and value are {operations} words");
    assert_eq!(found, BTreeSet::from([SAVED.1[0].to_bits()]), "until its last word is whole, the old one counts");
}

/// Items of 32 bytes that a page holds, between its two marks.
const ITEMS: usize = (PAGE - 8) / 32;

/// So many saves that change nothing in the end.
fn filling(saves: usize) -> impl Iterator<Item = (&'static str, f32)> {
    (1..=saves).map(move |n| (SAVED.0, if n == saves { SAVED.1[0] } else { 0.5 }))
}

#[test]
fn so_does_power_cut_while_a_full_page_is_left_for_a_sector_with_nothing_in_it() {
    let (operations, found) = save_with_every_cut(&after([KEPT].into_iter().chain(filling(ITEMS - 1))));
    println!("{operations} operations, {found:?} found");
    assert_eq!(operations, 1 + 1 + 3 * 8 + 2, "two marks, two items moved and one written, a seal");
    assert!(found.contains(&SAVED.1[0].to_bits()), "until the seal is whole, the old one counts");
}

#[test]
fn so_does_power_cut_while_the_other_sector_is_erased_first_whatever_is_in_it() {
    // The first save beyond a page leaves three items in the other one.
    let used = after([KEPT].into_iter().chain(filling(ITEMS + ITEMS - 3)));
    let mut strange = after([KEPT].into_iter().chain(filling(ITEMS - 1)));
    for (n, byte) in strange.0[SECTOR_BYTES..].iter_mut().enumerate() {
        *byte = ((n as u32).wrapping_mul(2_654_435_761) >> 13) as u8;
    }
    for sectors in [used, strange] {
        let (operations, found) = save_with_every_cut(&sectors);
        println!("{operations} operations, {found:?} found");
        assert_eq!(operations, 1 + 1 + 1 + 3 * 8 + 2, "a mark, a sector erased, and the rest as before");
        assert!(found.contains(&SAVED.1[0].to_bits()), "until the seal is whole, the old one counts");
    }
}

#[test]
fn sectors_full_of_anything_are_said_to_be_lost_and_work_after_that() {
    let strange = Store((0..2 * SECTOR_BYTES as u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 13) as u8).collect());
    let mut desk = Desk::with(&Store::erased());
    desk.log.clear();
    desk.restart_with(&strange);
    // Two sectors are erased.
    desk.pass(3 * SAMPLE_HZ);
    assert!(desk.log.contains("the stored parameters could not be read: defaults hold"), "{}", desk.log);
    assert_eq!(desk.get(KEPT.0), declared(KEPT.0).default);
    assert_eq!(desk.set(KEPT.0, KEPT.1), Some(Outcome::Stored));
    desk.log.clear();
    desk.restart();
    assert_eq!(desk.get(KEPT.0), KEPT.1);
    assert!(desk.log.contains("1 parameters are set"), "{}", desk.log);
}

#[test]
fn noise_on_the_stations_line_costs_the_frame_it_hits_and_no_more() {
    let mut desk = Desk::with(&Store::erased());
    let noise: Vec<u8> = (0..250_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 21) as u8).collect();
    desk.emulator.send_station(&noise);
    desk.pass(100);
    // What is left of the noise and this are one frame, which is wrong.
    desk.ask(&ToBoard::GetParameter(padded(KEPT.0)));
    assert_eq!(desk.get(KEPT.0), declared(KEPT.0).default);
}

#[test]
fn a_motor_protocol_is_set_over_the_line_and_sent_from_the_next_start_on_and_no_other_is_taken() {
    let mut desk = Desk::with(&Store::erased());
    let sent = |desk: &mut Desk| {
        // The first frame comes some 45 ms after the boot.
        desk.pass(SAMPLE_HZ / 10);
        desk.emulator.period().expect("the image runs").protocol
    };
    assert_eq!(sent(&mut desk), [Some(Protocol::DShot600); 4]);
    for (value, protocol) in [(300.0, Protocol::DShot300), (0.0, Protocol::Pwm), (600.0, Protocol::DShot600)] {
        let before = sent(&mut desk);
        for refused in [150.0, 300.5, -300.0, f32::NAN] {
            assert_eq!(desk.set("MOT_PROTOCOL", refused), Some(Outcome::OutOfRange), "{refused}");
        }
        assert_eq!(desk.set("MOT_PROTOCOL", value), Some(Outcome::Stored));
        assert_eq!(sent(&mut desk), before, "until the next start");
        // Speed controllers, too, must be switched off to listen to something else.
        desk.restart();
        assert_eq!(sent(&mut desk), [Some(protocol); 4]);
    }
}
