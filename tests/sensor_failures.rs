//! Every kind of sensor fault in a hover under the autopilot, alone and with a rotor that loses 40 % of its thrust: what is detected, what is
//! done, and what comes of it. Printed as the tables of docs/sensor-faults.md:
//!
//! ```text
//! cargo test --release -p system-tests --test sensor_failures -- --nocapture
//! ```
use control_core::estimation::Source;
use rayon::prelude::*;
use sim_host::chronicle::{Chronicle, Happening};
use sim_host::controllers::ControllerName;
use sim_host::fault::sensors::{Sensor, SensorAxis, SensorFault, SensorFaultKind};
use sim_host::fault::{Fault, FaultKind, Profile, Rotors};
use sim_host::flight::{Ending, Flight, NumberFormat};
use sim_host::scenario::Scenario;
use system_tests::shipped;

/// When the sensor fails, s; when the rotor does, if it does; when the pilot lands, s.
const SENSOR_FAILS_S: f64 = 12.0;
const ROTOR_FAILS_S: f64 = 16.0;
const LANDS_S: f64 = 35.0;
/// Each is flown with so many seeds, and the worst counts.
const SEEDS: u64 = 3;

/// Sizes of a sensor's faults, in the unit of its reading, and the age of its delayed readings, s.
struct Sizes {
    sensor: Sensor,
    axis: Option<SensorAxis>,
    bias: f64,
    drift_1_s: f64,
    spike: f64,
    delay_s: f64,
}

const SIZES: [Sizes; 10] = {
    const fn sizes(sensor: Sensor, axis: Option<SensorAxis>, [bias, drift_1_s, spike, delay_s]: [f64; 4]) -> Sizes {
        Sizes { sensor, axis, bias, drift_1_s, spike, delay_s }
    }
    let x = Some(SensorAxis::X);
    [
        sizes(Sensor::Gyro, x, [0.3, 0.05, 5.0, 0.02]),
        sizes(Sensor::Accelerometer, x, [3.0, 0.3, 30.0, 0.02]),
        sizes(Sensor::Baro, None, [5.0, 0.5, 20.0, 0.5]),
        sizes(Sensor::Mag, x, [20.0, 2.0, 50.0, 0.3]),
        sizes(Sensor::Gnss, x, [5.0, 0.5, 20.0, 0.5]),
        sizes(Sensor::Range, None, [1.0, 0.2, 2.0, 0.2]),
        sizes(Sensor::Flow, x, [0.5, 0.1, 3.0, 0.1]),
        sizes(Sensor::Vision, x, [1.0, 0.2, 3.0, 0.1]),
        sizes(Sensor::RotorSpeed, None, [300.0, 50.0, 500.0, 0.05]),
        sizes(Sensor::Battery, None, [-2.0, -0.2, 5.0, 1.0]),
    ]
};

/// Spikes a second, and the share of samples that an intermittent sensor loses.
const SPIKES_1_S: f64 = 5.0;
const LOST: f64 = 0.5;

impl Sizes {
    fn kinds(&self) -> [(SensorFaultKind, Option<SensorAxis>, String); 8] {
        let &Self { axis, bias, drift_1_s, spike, delay_s, .. } = self;
        [
            (SensorFaultKind::Off, None, "off".to_owned()),
            (SensorFaultKind::Stuck, None, "stuck".to_owned()),
            (SensorFaultKind::Bias { offset: bias }, axis, format!("bias {bias}")),
            (SensorFaultKind::Drift { rate: drift_1_s }, axis, format!("drift {drift_1_s}/s")),
            (SensorFaultKind::Garbage, None, "garbage".to_owned()),
            (SensorFaultKind::Spikes { size: spike, rate_1_s: SPIKES_1_S }, axis, format!("spikes {spike}")),
            (SensorFaultKind::Delayed { delay_s }, None, format!("delayed {delay_s} s")),
            (SensorFaultKind::Intermittent { loss: LOST }, None, format!("{:.0} % lost", 100.0 * LOST)),
        ]
    }

    /// What the estimator calls it, if it looks at it.
    fn source(&self) -> Option<&'static str> {
        match self.sensor {
            Sensor::Gyro | Sensor::Accelerometer => Some("inertial unit: "),
            Sensor::Baro => Some("barometer: "),
            Sensor::Mag => Some("magnetometer: "),
            Sensor::Gnss => Some("satellite receiver: "),
            Sensor::Range => Some("range: "),
            Sensor::Flow => Some("optical flow: "),
            Sensor::Vision => Some("external vision: "),
            Sensor::RotorSpeed | Sensor::Battery => None,
        }
    }

    /// The machine on which it fails.
    fn sortie(&self) -> &'static str {
        if self.sensor == Sensor::Vision { "sorties/spares_indoors" } else { "sorties/spares_outdoors" }
    }
}

/// What came of one case.
struct Outcome {
    sensor: Sensor,
    fault: String,
    rotor: bool,
    /// When it was first named after its onset, s, and as what.
    detected: Option<(f64, String)>,
    reactions: Vec<String>,
    /// Largest distance from where it hovered until the pilot, or a failsafe, lets it land, m.
    error_m: f64,
    crashes: u64,
}

impl Outcome {
    fn row(&self) -> String {
        let detected =
            self.detected.as_ref().map_or("—".to_owned(), |(after_s, what)| format!("{after_s:.2} s: {what}"));
        let reaction = if self.reactions.is_empty() { "holds on".to_owned() } else { self.reactions.join(", ") };
        let crashed = if self.crashes > 0 { format!("{} of {SEEDS}", self.crashes) } else { "no".to_owned() };
        let sensor = self.sensor.as_str();
        format!("| {sensor} | {} | {detected} | {reaction} | {:.2} | {crashed} |", self.fault, self.error_m)
    }
}

/// Flies one case with every seed.
fn outcome(base: &Scenario, sizes: &Sizes, kind: usize, rotor: bool) -> Outcome {
    let (kind, axis, fault) = sizes.kinds()[kind].clone();
    let mut scenario = base.clone();
    let (from_s, until_s) = (SENSOR_FAILS_S, scenario.duration_s);
    scenario.sensor_fault =
        vec![SensorFault { kind, sensor: sizes.sensor, unit: 1, axis, from_s, until_s, profile: Profile::Step }];
    if rotor {
        let kind = FaultKind::LossOfEffectiveness { loss: 0.4 };
        let (rotors, from_s) = (Rotors::new([true, false, false, false]), ROTOR_FAILS_S);
        scenario.fault = vec![Fault { kind, rotors, from_s, until_s, profile: Profile::Step, reported: false }];
    }
    let mut outcome =
        Outcome { sensor: sizes.sensor, fault, rotor, detected: None, reactions: Vec::new(), error_m: 0.0, crashes: 0 };
    for seed in 1..=SEEDS {
        let flight =
            Flight { scenario: &scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 };
        let mut chronicle = Chronicle::default();
        let mut hovered = None;
        let ending = flight
            .fly(&mut |sample| {
                chronicle.step(sample);
                let command = sample.decision.expect("a sortie").command;
                let up = sample.t_s < LANDS_S && command.armed && !command.mode.comes_down();
                if sample.t_s >= SENSOR_FAILS_S && up {
                    let place = *hovered.get_or_insert(sample.truth.position_m);
                    outcome.error_m = outcome.error_m.max((sample.truth.position_m - place).norm());
                }
            })
            .expect("shipped gains are valid");
        outcome.crashes += u64::from(matches!(ending, Some(Ending::Crashed(_))));
        outcome.tell(sizes, chronicle.happenings());
    }
    outcome
}

impl Outcome {
    /// Takes from a chronicle when the sensor was named, and what was done between then and the landing that was asked for.
    fn tell(&mut self, sizes: &Sizes, happenings: &[Happening]) {
        let after = happenings.iter().filter(|happening| (SENSOR_FAILS_S..LANDS_S).contains(&happening.t_s));
        for Happening { t_s, what } in after {
            let named = sizes.source().and_then(|source| what.strip_prefix(source));
            let named = named.or(what.strip_prefix("failsafe: battery").map(|_| what.as_str()));
            if let Some(text) = named.filter(|text| *text != "well again") {
                let after_s = t_s - SENSOR_FAILS_S;
                if self.detected.as_ref().is_none_or(|(other_s, _)| after_s < *other_s) {
                    self.detected = Some((after_s, text.to_owned()));
                }
            }
            let flown =
                what.split_once(": ").filter(|(_, why)| why.ends_with("to fly on") || why.starts_with("failsafe"));
            let done = flown.map(|(mode, _)| mode).or(what.strip_prefix("flies on the "));
            if let Some(done) = done.map(str::to_owned).filter(|done| !self.reactions.contains(done)) {
                self.reactions.push(done);
            }
        }
    }
}

/// Every case of `sensors` on its machine, changed by `change`.
fn outcomes(sensors: &[Sensor], change: impl Fn(&mut Scenario) + Sync) -> Vec<Outcome> {
    let chosen: Vec<&Sizes> = SIZES.iter().filter(|sizes| sensors.contains(&sizes.sensor)).collect();
    let cases: Vec<(&Sizes, usize, bool)> = [false, true]
        .into_iter()
        .flat_map(|rotor| chosen.iter().flat_map(move |&sizes| (0..8).map(move |kind| (sizes, kind, rotor))))
        .collect();
    cases
        .into_par_iter()
        .map(|(sizes, kind, rotor)| {
            let mut base = shipped(sizes.sortie());
            change(&mut base);
            outcome(&base, sizes, kind, rotor)
        })
        .collect()
}

fn print(title: &str, outcomes: &[Outcome]) {
    for (rotor, with) in [(false, "alone"), (true, "and rotor 1 loses 40 % at 16 s")] {
        println!("\n{title}, {with}\n");
        println!(
            "| sensor | fault | detected after | reaction | largest error, m | crashed |\n|---|---|---|---|---|---|"
        );
        for outcome in outcomes.iter().filter(|outcome| outcome.rotor == rotor) {
            println!("{}", outcome.row());
        }
    }
}

#[test]
fn no_sensor_fault_crashes_a_machine_with_a_healthy_sensor_of_the_kind_it_needs() {
    let every: Vec<Sensor> = SIZES.iter().map(|sizes| sizes.sensor).collect();
    let outcomes = outcomes(&every, |_| {});
    print("With spares", &outcomes);
    let crashed: Vec<String> = outcomes.iter().filter(|outcome| outcome.crashes > 0).map(Outcome::row).collect();
    assert!(crashed.is_empty(), "{}", crashed.join("\n"));
}

#[test]
fn a_lone_inertial_unit_that_falls_silent_is_named_at_once() {
    let outcomes = outcomes(&[Sensor::Gyro, Sensor::Accelerometer], |scenario| {
        let sensors = scenario.sensors.as_mut().expect("a kit");
        (sensors.imus, sensors.baros) = (1, 1);
    });
    print("With a single inertial unit", &outcomes);
    for outcome in outcomes.iter().filter(|outcome| outcome.fault == "off") {
        let (after_s, _) = outcome.detected.as_ref().unwrap_or_else(|| panic!("{}", outcome.row()));
        assert!(*after_s < 0.03, "{}", outcome.row());
    }
}

/// A lone unit that is silent for `lasts_s` in the gusts of a hover, with rotor 1 weak or not.
fn silent_for(lasts_s: f64, rotor: bool, seed: u64) -> Flown {
    let mut scenario = shipped("sorties/spares_outdoors");
    let keys = scenario.sensors.as_mut().expect("a kit");
    (keys.imus, keys.baros) = (1, 1);
    scenario.duration_s = SENSOR_FAILS_S + 10.0;
    let silent = |sensor| SensorFault {
        kind: SensorFaultKind::Off,
        sensor,
        unit: 1,
        axis: None,
        from_s: SENSOR_FAILS_S,
        until_s: SENSOR_FAILS_S + lasts_s,
        profile: Profile::Step,
    };
    scenario.sensor_fault = vec![silent(Sensor::Gyro), silent(Sensor::Accelerometer)];
    if rotor {
        let kind = FaultKind::LossOfEffectiveness { loss: 0.4 };
        let (rotors, from_s, until_s) = (Rotors::new([true, false, false, false]), 8.0, scenario.duration_s);
        scenario.fault = vec![Fault { kind, rotors, from_s, until_s, profile: Profile::Step, reported: false }];
    }
    let flight = Flight { scenario: &scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 };
    let (mut place, mut flown) = (None, Flown::default());
    let ending = flight.fly(&mut |sample| {
        let decision = sample.decision.expect("a sortie");
        let [a, b, c, d] = decision.command.motors;
        if sample.t_s >= SENSOR_FAILS_S {
            let hovered = *place.get_or_insert(sample.truth.position_m);
            flown.error_m = flown.error_m.max((sample.truth.position_m - hovered).norm());
            flown.terminated |= !decision.command.armed;
        }
        if (SENSOR_FAILS_S + 0.02..SENSOR_FAILS_S + lasts_s).contains(&sample.t_s) {
            let share = if rotor { 0.6 } else { 1.0 };
            flown.uneven = flown.uneven.max((share * a - c).abs() + (b - d).abs());
        }
    });
    flown.crashed = matches!(ending.expect("shipped gains are valid"), Some(Ending::Crashed(_)));
    flown
}

#[derive(Debug, Default)]
struct Flown {
    error_m: f64,
    /// Largest difference of what facing rotors make while nobody knows how it turns, shares of the largest thrust.
    uneven: f32,
    terminated: bool,
    crashed: bool,
}

#[test]
fn a_lone_inertial_unit_may_be_silent_for_80_ms_and_then_it_is_flown_on() {
    for (lasts_s, rotor) in [(0.03, false), (0.08, false), (0.03, true), (0.08, true)] {
        for seed in 1..=3 {
            let flown = silent_for(lasts_s, rotor, seed);
            println!("{lasts_s} s, rotor {rotor}, seed {seed}: {flown:?}");
            assert!(
                !flown.terminated && !flown.crashed && flown.error_m < 1.0,
                "{lasts_s} s, {rotor}, {seed}: {flown:?}"
            );
            assert!(flown.uneven < if rotor { 0.1 } else { 0.01 }, "{lasts_s} s, {rotor}, {seed}: {flown:?}");
        }
    }
    // Beyond the failsafe's patience the rotors are stopped.
    assert!(silent_for(0.3, false, 1).terminated);
}

/// With nothing to compare it with it is satellites and flow, or satellites and height, that tell.
#[test]
fn a_lone_accelerometer_that_drifts_is_flown_on_and_named_if_it_drifts_fast() {
    let mut base = shipped("sorties/spares_outdoors");
    let keys = base.sensors.as_mut().expect("a kit");
    (keys.imus, keys.baros) = (1, 1);
    let axes = [SensorAxis::X, SensorAxis::Y, SensorAxis::Z];
    let cases: Vec<(SensorAxis, f64)> =
        axes.into_iter().flat_map(|axis| [-0.3, -0.1, 0.1, 0.3].map(|rate| (axis, rate))).collect();
    println!("| axis | drift, m/s³ | named after, s | largest error, m |\n|---|--:|--:|--:|");
    for (axis, rate) in cases {
        let mut scenario = base.clone();
        let (kind, from_s, until_s) = (SensorFaultKind::Drift { rate }, SENSOR_FAILS_S, scenario.duration_s);
        scenario.sensor_fault = vec![SensorFault {
            kind,
            sensor: Sensor::Accelerometer,
            unit: 1,
            axis: Some(axis),
            from_s,
            until_s,
            profile: Profile::Step,
        }];
        let flown: Vec<(f64, f64)> = (1..=10).into_par_iter().map(|seed| drifts(&scenario, seed)).collect();
        let worst = |of: fn(&(f64, f64)) -> f64| flown.iter().map(of).fold(0.0, f64::max);
        let (named_s, error_m) = (worst(|flown| flown.0), worst(|flown| flown.1));
        let named = if named_s.is_finite() { format!("{named_s:.1}") } else { "not always".to_owned() };
        println!("| {axis:?} | {rate} | {named} | {error_m:.2} |");
        assert!(error_m < 2.0, "{axis:?}, {rate}: {error_m} m");
        // 1.5 m/s², which no sound part is off by, and until it is believed. Of a slow drift a part is taken for tilt.
        assert!(named_s < 8.0 || rate.abs() < 0.2, "{axis:?}, {rate}: {named_s} s");
    }
}

/// When the lone unit was named after it began to drift, s, and how far the machine strayed until it landed, m.
fn drifts(scenario: &Scenario, seed: u64) -> (f64, f64) {
    let flight = Flight { scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 };
    let (mut named_s, mut hovered, mut error_m) = (f64::INFINITY, None, 0.0_f64);
    let ending = flight.fly(&mut |sample| {
        if sample.t_s < SENSOR_FAILS_S {
            return;
        }
        let place = *hovered.get_or_insert(sample.truth.position_m);
        if sample.t_s < LANDS_S {
            error_m = error_m.max((sample.truth.position_m - place).norm());
        }
        let fault = sample.estimator.expect("sensors").sources[Source::Inertial as usize].fault;
        if fault.is_some() {
            named_s = named_s.min(sample.t_s - SENSOR_FAILS_S);
        }
    });
    assert!(!matches!(ending.expect("shipped gains are valid"), Some(Ending::Crashed(_))), "seed {seed}");
    (named_s, error_m)
}

/// Of two inertial units that drift apart it is their biases that tell which is right.
#[test]
fn of_two_inertial_units_the_one_that_drifts_is_gone_by_in_nineteen_of_twenty_flights() {
    const FLIGHTS: u64 = 20;
    let base = shipped("sorties/spares_outdoors");
    let cases: Vec<_> = [(Sensor::Gyro, 0.05), (Sensor::Accelerometer, 0.3)]
        .into_iter()
        .flat_map(|(sensor, rate)| [SensorAxis::X, SensorAxis::Z].map(|axis| (sensor, rate, axis)))
        .flat_map(|(sensor, rate, axis)| [1, 2].map(|unit| (sensor, rate, axis, unit)))
        .collect();
    for (sensor, rate, axis, unit) in cases {
        let mut scenario = base.clone();
        scenario.duration_s = SENSOR_FAILS_S + 12.0;
        let (kind, from_s, until_s) = (SensorFaultKind::Drift { rate }, SENSOR_FAILS_S, scenario.duration_s);
        scenario.sensor_fault =
            vec![SensorFault { kind, sensor, unit, axis: Some(axis), from_s, until_s, profile: Profile::Step }];
        let right = (1..=FLIGHTS).into_par_iter().filter(|&seed| {
            let flight =
                Flight { scenario: &scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 };
            let mut used = Source::Inertial;
            let ending = flight.fly(&mut |sample| used = sample.estimator.expect("sensors").inertial);
            assert!(ending.is_ok(), "shipped gains are valid");
            (used == Source::Inertial) == (unit == 2)
        });
        let right = right.count() as u64;
        println!("| {} of unit {unit}, {axis:?} | {right} of {FLIGHTS} |", sensor.as_str());
        assert!(20 * right >= 19 * FLIGHTS, "{} of unit {unit}, {axis:?}: {right} of {FLIGHTS}", sensor.as_str());
    }
}
