//! Every failsafe and every arming check, flown from the ground on realistic sensors: what is detected, when, what is done, how it ends.
use control_core::arming::Check;
use control_core::failsafe::{Failsafe, TABLE};
use control_core::modes::Mode;
use control_core::set::Member;
use rayon::prelude::*;
use sim_host::chronicle::{Chronicle, Happening};
use sim_host::controllers::ControllerName;
use sim_host::flight::{Cause, Ending, Flight, NumberFormat};
use sim_host::plant::Truth;
use sim_host::scenario::Scenario;
use system_tests::{root, shipped};

/// A sortie that was flown.
struct Sortie {
    name: String,
    happenings: Vec<Happening>,
    ending: Option<Ending>,
    /// Where it was, at 10 Hz.
    path: Vec<(f64, Truth)>,
    /// The checks that failed at each of these times.
    failing: Vec<(f64, Vec<Check>)>,
    armed: bool,
    motors: [f32; 4],
}

impl Sortie {
    fn fly(name: &str) -> Self {
        Self::fly_with(name, 1)
    }

    fn fly_with(name: &str, seed: u64) -> Self {
        let scenario: Scenario = shipped(&format!("sorties/{name}"));
        let flight =
            Flight { scenario: &scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 };
        let (mut chronicle, mut path, mut failing) = (Chronicle::default(), Vec::new(), Vec::new());
        let (mut armed, mut motors) = (false, [0.0; 4]);
        let ending = flight
            .fly(&mut |sample| {
                chronicle.step(sample);
                let command = sample.decision.expect("a sortie").command;
                (armed, motors) = (command.armed, command.motors);
                if sample.tick % 50 == 0 {
                    path.push((sample.t_s, *sample.truth));
                    failing.push((sample.t_s, command.failing.iter().collect()));
                }
            })
            .expect("shipped gains are valid");
        Self {
            name: format!("{name}, seed {seed}"),
            happenings: chronicle.happenings().to_vec(),
            ending,
            path,
            failing,
            armed,
            motors,
        }
    }

    /// When `what` first happens after `from_s`, s.
    fn when(&self, what: &str, from_s: f64) -> f64 {
        let found = self.happenings.iter().find(|happening| happening.t_s >= from_s && happening.what == what);
        found.unwrap_or_else(|| panic!("{}: no `{what}` from {from_s} s on in {:#?}", self.name, self.happenings)).t_s
    }

    /// Asserts that `what` happens from `from_s` to `until_s`.
    fn happens(&self, what: &str, from_s: f64, until_s: f64) {
        let t_s = self.when(what, from_s);
        assert!(t_s <= until_s, "{}: `{what}` at {t_s} s", self.name);
    }

    /// Asserts that it stands on its feet, unbroken, disarmed, with its rotors still; and how far from home, m.
    fn has_landed_within(&self, distance_m: f64) {
        let (_, truth) = self.path.last().expect("flown");
        let from_home_m = truth.position_m.x.hypot(truth.position_m.y);
        assert_eq!(self.ending, None, "{}: {:#?}", self.name, self.happenings);
        assert!(truth.touching && truth.tilt_rad() < 0.1, "{}: {truth:?}", self.name);
        assert!(!self.armed && self.motors == [0.0; 4], "{}: it runs", self.name);
        assert!(from_home_m < distance_m, "{}: {from_home_m} m from home", self.name);
    }

    /// Largest distance from where it was at `from_s` until `until_s`, m.
    fn strays_m(&self, from_s: f64, until_s: f64) -> f64 {
        let mut spans =
            self.path.iter().filter(|(t_s, _)| (from_s..until_s).contains(t_s)).map(|(_, truth)| truth.position_m);
        let start = spans.next().expect("flown until then");
        spans.map(|place| (place - start).norm()).fold(0.0, f64::max)
    }
}

/// How a sortie ends.
enum End {
    /// On its feet, disarmed, within this of home, m.
    Landed(f64),
    /// The rotors were stopped in the air: it fell.
    Fell,
}

/// A failsafe, the sortie that shows it, when its condition begins, how long until it acts, s, and what is flown then.
struct Shown {
    failsafe: Failsafe,
    sortie: &'static str,
    onset_s: f64,
    acts_s: (f64, f64),
    flown: Option<Mode>,
    end: End,
}

/// Every row of the table.
fn shown() -> [Shown; TABLE.len()] {
    use Failsafe::{
        BatteryCritical, BatteryLow, Fence, LinkLost, NoAltitude, NoPosition, NoRates, NoTilt, NoVelocity,
        OffboardStale, Overrun, RotorLost, Tipped,
    };
    let row = |failsafe, sortie, onset_s, acts_s, flown, end| Shown { failsafe, sortie, onset_s, acts_s, flown, end };
    [
        row(NoRates, "nothing_to_fly_on", 12.0, (0.1, 0.15), None, End::Fell),
        row(NoTilt, "attitude_lost", 12.0, (0.5, 10.0), None, End::Fell),
        row(Tipped, "tilt", 24.8, (0.5, 1.1), None, End::Fell),
        row(BatteryCritical, "battery_critical", 20.0, (2.0, 15.0), Some(Mode::Land), End::Landed(2.0)),
        row(RotorLost, "rotor_lost", 14.0, (1.0, 1.5), Some(Mode::Land), End::Landed(4.0)),
        row(Overrun, "control_loop_late", 12.0, (0.19, 0.22), Some(Mode::Land), End::Landed(2.0)),
        row(BatteryLow, "battery_low", 12.0, (5.0, 20.0), Some(Mode::Return), End::Landed(2.0)),
        row(Fence, "geofence", 12.0, (0.5, 6.0), Some(Mode::Return), End::Landed(2.0)),
        row(LinkLost, "link_lost", 15.0, (0.49, 0.51), Some(Mode::Return), End::Landed(2.0)),
        row(OffboardStale, "offboard_stale", 16.0, (0.49, 0.51), Some(Mode::PositionHold), End::Landed(5.0)),
        row(NoAltitude, "altitude_lost", 12.0, (4.9, 5.5), Some(Mode::Angle), End::Landed(30.0)),
        row(NoVelocity, "vision_lost", 15.0, (4.9, 5.1), Some(Mode::AltitudeHold), End::Landed(2.0)),
        row(NoPosition, "position_lost", 93.0, (0.0, 0.1), Some(Mode::Land), End::Landed(30.0)),
    ]
}

#[test]
fn every_failsafe_acts_in_its_time_and_ends_as_the_table_says() {
    shown().into_par_iter().for_each(|Shown { failsafe, sortie, onset_s, acts_s, flown, end }| {
        let row = failsafe.row();
        let sortie = Sortie::fly(sortie);
        let acts = format!("failsafe: {failsafe}: {}", row.reaction);
        let t_s = sortie.when(&acts, 0.0);
        let after_s = t_s - onset_s;
        assert!((acts_s.0..=acts_s.1).contains(&after_s), "{}: `{acts}` after {after_s} s", sortie.name);
        if let Some(mode) = flown {
            let reason = match row.reaction.mode() {
                Some(_) => format!("failsafe: {failsafe}"),
                None => format!("no {} to fly on", failsafe.to_string().trim_end_matches(" lost")),
            };
            // The mode falls back in the tick in which the level falls, the failsafe is told of it in the next.
            sortie.happens(&format!("{mode}: {reason}"), t_s - 0.005, t_s);
        }
        match end {
            End::Landed(distance_m) => sortie.has_landed_within(distance_m),
            End::Fell => {
                sortie.happens("disarmed", t_s, t_s);
                assert!(!sortie.armed && sortie.motors == [0.0; 4], "{}: stopped for good", sortie.name);
                let hit =
                    matches!(sortie.ending, Some(Ending::Crashed(crash)) if matches!(crash.cause, Cause::Ground(_)));
                assert!(hit, "{}: {:?}", sortie.name, sortie.ending);
            }
        }
    });
}

#[test]
fn no_failsafe_is_without_a_sortie() {
    let shown = shown();
    assert!(TABLE.iter().all(|row| shown.iter().any(|shown| shown.failsafe == row.failsafe)));
}

/// Each check, the sortie in which the arm switch is thrown against it, and when, s.
const REFUSED: [(Check, &str, f64); 13] = [
    (Check::Link, "arming_pilot", 16.0),
    (Check::Throttle, "arming_pilot", 1.5),
    (Check::Mode, "arming_pilot", 2.5),
    (Check::Parameters, "arming_pilot", 3.5),
    (Check::SelfTest, "arming_pilot", 4.5),
    (Check::GyroCalibrated, "arming_pilot", 5.5),
    (Check::GyroStill, "arming_machine", 2.05),
    (Check::Level, "arming_machine", 5.5),
    (Check::Estimate, "arming_machine", 40.0),
    (Check::Battery, "arming_machine", 10.5),
    (Check::Motors, "arming_pilot", 6.5),
    (Check::Bench, "arming_pilot", 7.3),
    (Check::Late, "arming_machine", 12.5),
];

#[test]
fn every_check_refuses_arming_by_name() {
    assert!(Check::ALL.iter().all(|check| REFUSED.iter().any(|(shown, ..)| shown == check)), "every check is shown");
    let sorties = ["arming_pilot", "arming_machine"].map(Sortie::fly);
    for (check, name, t_s) in REFUSED {
        let sortie = sorties.iter().find(|sortie| sortie.name.starts_with(name)).expect("flown");
        let refusal = sortie.happenings.iter().find(|happening| (happening.t_s - t_s).abs() < 1e-6);
        if let Some(happening) = refusal {
            let texts =
                happening.what.strip_prefix("arming refused: ").unwrap_or_else(|| panic!("{check}: {happening:?}"));
            assert!(texts.split("; ").any(|text| text == check.to_string()), "{check}: {texts}");
        } else {
            // A switch that is not heard is not refused: nothing happens, and the list of what fails says why.
            let (_, failing) = sortie.failing.iter().find(|(at_s, _)| *at_s >= t_s + 0.1).expect("flown");
            assert!(check == Check::Link && failing.contains(&check), "{check}: {failing:?}");
        }
    }
}

#[test]
fn what_was_refused_arms_when_all_is_well_and_not_before() {
    let sortie = Sortie::fly("arming_pilot");
    let armed: Vec<f64> = sortie.happenings.iter().filter(|h| h.what == "armed").map(|h| h.t_s).collect();
    assert_eq!(armed, [19.0]);
    let machine = Sortie::fly("arming_machine");
    assert!(machine.happenings.iter().all(|happening| happening.what != "armed"), "{:#?}", machine.happenings);
    assert!(machine.strays_m(0.0, 60.0) < 0.02, "rocked, not moved");
}

#[test]
fn external_vision_lost_for_five_seconds_is_flown_by_dead_reckoning_and_comes_back() {
    (1..=5).into_par_iter().for_each(|seed| {
        let sortie = Sortie::fly_with("vision_lost", seed);
        sortie.happens("external vision: it says nothing", 15.0, 15.25);
        // Position hold for as long as dead reckoning is believed, then the best mode that is left.
        let lost_s = sortie.when("altitude hold: no velocity to fly on", 15.0);
        assert!((19.9..20.1).contains(&lost_s), "{}: {lost_s}", sortie.name);
        sortie.happens("position hold: arrived", lost_s, 22.0);
        let strayed_m = sortie.strays_m(14.9, 22.0);
        assert!(strayed_m < 1.5, "{}: {strayed_m} m", sortie.name);
        println!("{}: strays {strayed_m:.2} m", sortie.name);
        sortie.has_landed_within(1.5);
    });
}

#[test]
fn the_stale_companion_is_not_followed_again_before_the_pilot_says_so() {
    let sortie = Sortie::fly("offboard_stale");
    let stale_s = sortie.when("failsafe: offboard setpoint stale: hold", 16.0);
    assert!(sortie.strays_m(stale_s, 24.0) < 0.5, "it holds: {} m", sortie.strays_m(stale_s, 24.0));
    sortie.happens("offboard: as the pilot chose", 24.5, 24.51);
}

#[test]
fn a_pilot_overrules_the_low_battery_and_not_the_lost_link() {
    let sortie = Sortie::fly("battery_critical");
    let low_s = sortie.when("return: failsafe: battery low", 0.0);
    sortie.happens("altitude hold: as the pilot chose", low_s, low_s + 5.0);
    sortie.happens("land: failsafe: battery critical", low_s + 1.0, low_s + 10.0);
}

#[test]
fn every_shipped_sortie_is_flown_here() {
    let shown = shown();
    for file in std::fs::read_dir(root().join("scenarios/sorties")).expect("shipped") {
        let path = file.expect("readable").path();
        let name = path.file_stem().expect("a name").to_string_lossy().into_owned();
        let failsafe = shown.iter().any(|shown| shown.sortie == name);
        let spare = ["spares_outdoors", "spares_indoors"].contains(&name.as_str());
        assert!(failsafe || spare || REFUSED.iter().any(|(_, sortie, _)| *sortie == name), "{name}");
        assert!(!shipped(&format!("sorties/{name}")).title.is_empty(), "{name}: no title");
    }
}
