//! The station's line: what the image says of itself over it, and what may be asked of it. On the emulator.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_station`.
use control_core::arming::Check;
use control_core::set::Member;
use flight_link::{
    FromBoard, Motion, MotorTest, Order, ParameterName, Rotors, Status, ToBoard, VERSION, Verdict, Wiring,
};
use sim_host::emulator::{Mishap, Served};
use system_tests::aloft::{Aloft, Hands};
use system_tests::sim_host as run;

/// What a motor is told that stands.
const STANDS: Option<u16> = Some(0);

/// The machine on the ground, and a station that listens.
struct Ground {
    aloft: Aloft,
    arm: bool,
    /// Whether the station gives signs of life.
    lives: bool,
    heard: Vec<FromBoard>,
}

impl Ground {
    fn new() -> Self {
        Self { aloft: Aloft::on_the_ground(), arm: false, lives: true, heard: Vec::new() }
    }

    /// Lets time pass; returns which motors were let turn on the way, and for how long any did, s.
    fn pass(&mut self, seconds: f64) -> ([bool; 4], f64) {
        let end_s = self.aloft.time_s() + seconds;
        let (mut turned, mut turned_s, mut steps) = ([false; 4], 0.0, 0);
        while self.aloft.time_s() < end_s {
            let before_s = self.aloft.time_s();
            if self.lives && steps % 200 == 0 {
                self.aloft.say(&ToBoard::Hello);
            }
            steps += 1;
            // What was heard is gone once the chip starts anew.
            if steps % 4 == 0 {
                self.heard.extend(self.aloft.heard());
            }
            self.aloft.step(&Hands { arm: self.arm, ..Hands::default() });
            let turns = self.aloft.answer.told.map(|told| told.is_some() && told != STANDS);
            turned = [0, 1, 2, 3].map(|n| turned[n] || turns[n]);
            turned_s += if turns.contains(&true) { self.aloft.time_s() - before_s } else { 0.0 };
        }
        self.heard.extend(self.aloft.heard());
        (turned, turned_s)
    }

    /// Orders something; returns what became of it within 50 ms.
    fn order(&mut self, order: Order) -> Verdict {
        self.heard.clear();
        self.aloft.say(&ToBoard::Order(order));
        self.pass(0.05);
        let mut verdicts = self.heard.iter().filter_map(|record| match record {
            FromBoard::Ordered(verdict) => Some(*verdict),
            _ => None,
        });
        verdicts.next_back().unwrap_or_else(|| panic!("no answer: {:?}", self.heard))
    }

    fn status(&self) -> Status {
        let mut statuses = self.heard.iter().filter_map(|record| match record {
            FromBoard::Status(status) => Some(*status),
            _ => None,
        });
        statuses.next_back().expect("it says how it is")
    }
}

fn motor_test(rotor: Option<u8>, share: f32, seconds: f32) -> Order {
    Order::MotorTest(MotorTest { rotor, share, seconds })
}

#[test]
fn a_motor_test_turns_that_rotor_and_ends_by_itself_by_word_and_when_its_line_falls_silent() {
    let mut ground = Ground::new();
    ground.pass(0.2);
    for (why, order) in [
        ("no such rotor", motor_test(Some(4), 0.1, 1.0)),
        ("too much", motor_test(Some(0), 0.26, 1.0)),
        ("too long", motor_test(Some(0), 0.1, 10.5)),
        ("no number", motor_test(Some(0), f32::NAN, 1.0)),
    ] {
        assert_eq!(ground.order(order), Verdict::OutOfRange, "{why}");
    }
    assert_eq!(ground.pass(0.2).0, [false; 4]);
    for rotor in 0..4 {
        assert_eq!(ground.order(motor_test(Some(rotor), 0.1, 0.3)), Verdict::Done);
        let (turned, turned_s) = ground.pass(0.5);
        assert_eq!(turned, std::array::from_fn(|n| n == usize::from(rotor)));
        // Of its 0.3 s, those since the answer was waited for.
        assert!((0.2..0.3).contains(&turned_s), "{turned_s} s");
    }
    assert_eq!(ground.order(motor_test(None, 0.1, 5.0)), Verdict::Done);
    assert!(ground.pass(0.2).0[0]);
    assert!(ground.status().bench);
    assert_eq!(ground.order(Order::Stop), Verdict::Done);
    assert_eq!(ground.pass(0.2).0, [false; 4]);
    assert!(!ground.status().bench);
    assert_eq!(ground.order(motor_test(Some(1), 0.1, 5.0)), Verdict::Done);
    ground.lives = false;
    let (_, turned_s) = ground.pass(1.0);
    assert!((0.4..0.52).contains(&turned_s), "{turned_s} s after the last word");
}

#[test]
fn the_wiring_check_finds_every_rotor_in_its_place() {
    let mut ground = Ground::new();
    ground.pass(1.0);
    assert_eq!(ground.status().wiring, Wiring::Unknown);
    assert_eq!(ground.order(Order::WiringCheck), Verdict::Done);
    assert_eq!(ground.pass(2.5).0, [true; 4]);
    assert_eq!((ground.status().wiring, ground.status().bench), (Wiring::Right, false));
}

#[test]
fn it_says_how_it_is_ten_times_a_second_and_obeys_nothing_while_armed() {
    let mut ground = Ground::new();
    ground.pass(5.9);
    let status = ground.status();
    assert!(!status.armed && status.landed && status.dropped == 0 && status.late == 0, "{status:?}");
    assert_eq!(status.failing, 0, "all is well but the switch");
    assert!((status.battery_v - 16.8).abs() < 0.1, "{} V", status.battery_v);
    assert!((0.1..0.9).contains(&status.load) && (100..500).contains(&status.step_us_max), "{status:?}");
    ground.heard.clear();
    ground.pass(1.0);
    let count = |of: fn(&FromBoard) -> bool| ground.heard.iter().filter(|record| of(record)).count();
    assert!((9..=11).contains(&count(|record| matches!(record, FromBoard::Status(_)))));
    assert!((9..=11).contains(&count(|record| matches!(record, FromBoard::Hello(VERSION)))));
    for record in &ground.heard {
        match record {
            FromBoard::Motion(Motion { attitude_rad: [roll, pitch, _], health, .. }) => {
                assert!(roll.abs() < 0.02 && pitch.abs() < 0.02 && health & 0b11 == 0b11, "{record:?}");
            }
            FromBoard::Rotors(Rotors { speeds, believed, .. }) => {
                assert_eq!((*speeds, *believed), ([0.0; 4], [1.0; 4]));
            }
            _ => {}
        }
    }
    ground.arm = true;
    ground.pass(0.5);
    assert!(ground.status().armed);
    for order in [motor_test(Some(0), 0.1, 1.0), Order::WiringCheck, Order::Stop, Order::Restart] {
        assert_eq!(ground.order(order), Verdict::Armed, "{order:?}");
    }
    ground.arm = false;
    ground.pass(0.5);
    assert!(!ground.status().armed);
    assert_eq!(ground.order(Order::Restart), Verdict::Done);
    ground.heard.clear();
    ground.pass(0.6);
    let status = ground.status();
    assert!(status.steps < 2_000, "it has begun anew: {status:?}");
}

fn padded(name: &str) -> ParameterName {
    std::array::from_fn(|n| name.as_bytes().get(n).copied().unwrap_or(0))
}

/// What a step of the battery's converter is: volts and amperes.
const STEP: [f32; 2] = [3.3 * 11.0 / 4_095.0, 3.3 * 25.0 / 4_095.0];

#[test]
fn the_battery_is_said_to_a_step_of_its_converter_and_what_cannot_be_read_is_not() {
    let mut ground = Ground::new();
    ground.pass(0.1);
    for (name, value) in [("BAT_CELLS", 4.0), ("BAT_USE_MAX", 10.0)] {
        ground.aloft.say(&ToBoard::SetParameter(padded(name), value));
        ground.pass(0.1);
    }
    assert_eq!(ground.order(Order::Restart), Verdict::Done);
    ground.pass(0.6);
    // Voltage and current that are there; those that are said; whether arming is refused for it.
    let table = [
        ("in the middle", [16.1, 21.7], [Some(16.1), Some(21.7)], false),
        ("at the ends that can be", [35.8, 0.0], [Some(35.8), Some(0.0)], false),
        ("low", [13.9, 1.5], [Some(13.9), Some(1.5)], true),
        ("both lines torn off", [0.0, 0.0], [None, Some(0.0)], true),
        ("both at the supply", [99.0, 999.0], [None, None], true),
        ("back", [16.1, 5.0], [Some(16.1), Some(5.0)], false),
    ];
    for (why, there, said, refused) in table {
        ground.aloft.tell(|emulator| emulator.set_battery(there[0], there[1]));
        ground.pass(if said.contains(&None) { 1.3 } else { 0.35 });
        let status = ground.status();
        for ((read, said), step) in [status.battery_v, status.battery_a].into_iter().zip(said).zip(STEP) {
            let good = said.map_or(read.is_nan(), |said| (read - said).abs() <= 0.51 * step);
            assert!(good, "{why}: {status:?}");
        }
        let battery = status.failing & 1 << Check::Battery.index() != 0;
        assert_eq!(battery, refused, "{why}: {status:?}");
    }

    ground.aloft.tell(|emulator| emulator.inflict(Mishap::ConverterHangs));
    ground.pass(1.5);
    let hung = ground.status();
    assert!(hung.battery_v.is_nan() && hung.battery_a.is_nan() && hung.late == 0, "{hung:?}");
    ground.pass(0.9);
    let before = ground.status();
    assert_eq!((before.battery_v.is_nan(), before.battery_a.is_nan()), (false, false), "{before:?}");
    ground.aloft.tell(|emulator| emulator.set_battery(16.1, 30.0));
    ground.pass(1.0);
    let after = ground.status();
    let used_as = after.used_as - before.used_as;
    // A reading more or less than ten, and the first of them but half.
    assert!((25.0..34.0).contains(&used_as), "{used_as} A s of 30");
    assert!(after.used_as > 36.0 && after.failing & 1 << Check::Battery.index() != 0, "10 mAh are used: {after:?}");
}

/// What `sim-host station` says, and whether it was content.
fn station(board: &Served, arguments: &[&str]) -> (String, bool) {
    let output = run(&[&["station", "--port", &board.line], arguments].concat());
    let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("text"));
    (said.concat(), output.status.success())
}

#[test]
fn the_host_tool_lists_sets_watches_and_turns_rotors() {
    let board = Served::start(600, None).expect("emulator and image build");
    let content = |arguments: &[&str]| {
        let (said, content) = station(&board, arguments);
        assert!(content, "{arguments:?}: {said}");
        said
    };
    let refused = |arguments: &[&str]| {
        let (said, content) = station(&board, arguments);
        assert!(!content, "{arguments:?}: {said}");
        said
    };
    assert_eq!(content(&["get", "BAT_CELLS"]), "BAT_CELLS = 0\n");
    let too_many = refused(&["set", "BAT_CELLS", "40"]);
    assert_eq!(too_many, "sim-host: refused: BAT_CELLS = 40: must be from 0 to 14\n");
    assert_eq!(content(&["set", "BAT_CELLS", "4"]), "BAT_CELLS = 4, from the next start on\n");
    assert_eq!(content(&["restart"]), "it has started anew\n");
    assert_eq!(content(&["get", "BAT_CELLS"]), "BAT_CELLS = 4\n");
    let watched = content(&["watch", "--seconds", "3"]);
    for part in ["disarmed\n", "  roll ", "  16.8"] {
        assert!(watched.contains(part), "{part}: {watched}");
    }
    let turned = content(&["motor-test", "2", "--throttle", "9", "--seconds", "0.5"]);
    assert_eq!(turned, "rotor 2 turns at 30 % of its fastest speed\nover\n");
    let too_much = refused(&["motor-test", "--throttle", "30"]);
    assert_eq!(too_much, "sim-host: --throttle = 30: must be above 0 and at most 25 %\n");
    // Nothing moves this board.
    assert_eq!(refused(&["wiring-check"]), "sim-host: rotor 1 does not answer\n");
}
