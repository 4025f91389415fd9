//! DShot600, DShot300 and pulses: what speed controllers hear is what was decided, and nothing once the program stops. On the emulator, in
//! the image that is flashed.
//!
//! As `emulated.rs`: `cargo test --features emulated --test emulated_protocols`.
use control_core::flight::Command;
use firmware::dshot::Value;
use firmware::pulse::Pulse;
use sim_host::controllers::ControllerName;
use sim_host::emulator::{Mishap, Protocol, Store};
use sim_host::flight::{Flight as Sortie, NumberFormat};
use sim_host::through::{self, CORE_HZ};
use std::collections::VecDeque;
use system_tests::aloft::{Aloft, ByHand, Hands, SAMPLE_HZ};
use system_tests::host::Host;
use system_tests::{root, shipped};

/// By what, and the value of `MOT_PROTOCOL` that asks for it.
const PROTOCOLS: [(Protocol, f32); 3] =
    [(Protocol::DShot600, 600.0), (Protocol::DShot300, 300.0), (Protocol::Pwm, 0.0)];

fn on_the_ground(value: f32) -> Aloft {
    let store = Store::after([("MOT_PROTOCOL", value)]).expect("there is room");
    Aloft::prepared(|emulator| emulator.fill_store(&store))
}

/// The numbers that carry a command.
fn numbers(protocol: Protocol, command: Command) -> [u16; 4] {
    let (stop, number): (u16, fn(f32) -> u16) = match protocol {
        Protocol::Pwm => (1_000, |share| Pulse::running(share).us()),
        Protocol::DShot300 | Protocol::DShot600 => (0, |share| Value::running(share).get()),
    };
    match command {
        Command::Stop => [stop; 4],
        Command::Run(shares) | Command::Bench(shares) => shares.map(number),
    }
}

/// Flies up and hovers; each speed controller must hear what the image decided, which is what the host decides.
fn hover(protocol: Protocol, value: f32) {
    let (mut aloft, mut host, mut pilot) = (on_the_ground(value), Host::default(), ByHand::default());
    let booted = (aloft.answer.cycles, aloft.answer.busy);
    // A pulse is of the command that held when the one before had had its time.
    let decided_last = if protocol == Protocol::Pwm { 1 + SAMPLE_HZ as usize / 400 } else { 1 };
    let (mut decided, mut heard_speeds, mut compared) = (VecDeque::from([[0; 4]; 1]), 0, 0);
    while aloft.time_s() < 10.5 {
        let (t_s, truth) = (aloft.time_s(), aloft.truth());
        aloft.step(&pilot.hands(t_s, &truth));
        let Some(record) = aloft.answer.record.filter(|record| record.step > host.last) else { continue };
        host.follow(&record);
        heard_speeds += u32::from(record.arrived.measurements.rotor_rad_s.is_some());
        decided.push_front(numbers(protocol, record.command));
        decided.truncate(decided_last);
        if t_s > 0.1 {
            let told = aloft.answer.told.map(|told| told.expect("it was told something"));
            assert!(decided.contains(&told), "{protocol:?}, {t_s} s: {told:?} of {decided:?}");
            assert_eq!(aloft.answer.protocol, [Some(protocol); 4]);
            compared += 1;
        }
    }
    let (end, answer) = (aloft.truth(), &aloft.answer);
    let load = (answer.busy - booted.1) as f64 / (answer.cycles - booted.0) as f64;
    println!(
        "{protocol:?}: {compared} commands heard, up {:.2} m, tilt {:.3} rad; load {:.1} %; sample to frame through at most {:.0} µs; {} steps \
         with rotors' speeds",
        end.altitude_m(),
        end.tilt_rad(),
        100.0 * load,
        1e6 * answer.latency_max as f64 / CORE_HZ,
        heard_speeds,
    );
    assert!(host.last > 10 * SAMPLE_HZ && compared > 10 * SAMPLE_HZ, "{} steps, {compared} compared", host.last);
    assert!((1.0..2.2).contains(&end.altitude_m()) && end.tilt_rad() < 0.3, "{protocol:?}: {end:?}");
    // Frames are through before the next sample, and every rotor answers each; pulses are not answered.
    if protocol == Protocol::Pwm {
        assert_eq!(heard_speeds, 0);
    } else {
        assert!((answer.latency_max as f64) < 250e-6 * CORE_HZ, "{protocol:?}: {} cycles", answer.latency_max);
        assert!(heard_speeds > 10 * SAMPLE_HZ, "{protocol:?}: {heard_speeds}");
    }
    assert!(load < 0.5, "{protocol:?}: {load}");
}

#[test]
fn by_dshot600_a_hover_is_heard_as_decided_and_every_rotor_answers() {
    hover(PROTOCOLS[0].0, PROTOCOLS[0].1);
}

#[test]
fn by_dshot300_a_hover_is_heard_as_decided_and_every_rotor_answers() {
    hover(PROTOCOLS[1].0, PROTOCOLS[1].1);
}

#[test]
fn by_pulses_a_hover_is_heard_as_decided_and_no_rotor_answers() {
    hover(PROTOCOLS[2].0, PROTOCOLS[2].1);
}

#[test]
fn a_scenario_sets_the_protocol_that_it_is_flown_by_through_the_emulator() {
    let mut scenario = shipped("image/hop_by_hand");
    scenario.duration_s = 4.0;
    scenario.event.retain(|event| event.at_s < scenario.duration_s);
    scenario.fault.clear();
    let [frames, pulses] = [None, Some(0.0)].map(|value| {
        let keys = scenario.autopilot.as_mut().expect("it has one");
        keys.parameters = value.map(|value| ("MOT_PROTOCOL".to_owned(), value)).into_iter().collect();
        let scenario = scenario.for_image(&root()).expect("made for it");
        let sortie =
            Sortie { scenario: &scenario, controller: ControllerName::Default, seed: 1, format: NumberFormat::F32 };
        let (flown, board) = through::fly_measured(&sortie, &mut |_| {}).expect("the image runs to the end");
        assert!(flown.survived() && board.verdict.parting.is_none(), "{value:?}: {:?}", board.verdict.parting);
        board.latency_max_s
    });
    assert!(frames > 1e-4 && pulses == 0.0, "only frames are timed: {frames} s, {pulses} s");
}

#[test]
fn by_any_protocol_a_hang_a_fault_and_a_panic_end_what_turns_a_motor_within_20_ms() {
    for (protocol, value) in PROTOCOLS {
        for (mishap, within_s) in [
            (Mishap::Hang, if protocol == Protocol::Pwm { 0.02 } else { 0.001 }),
            (Mishap::HardFault, 0.001),
            (Mishap::Panic, 0.001),
        ] {
            let mut aloft = on_the_ground(value);
            while aloft.time_s() < 6.5 {
                aloft.step(&Hands { arm: aloft.time_s() > 6.0, ..Hands::default() });
            }
            assert!(aloft.answer.speeds().iter().all(|&speed| speed > 0.04), "{protocol:?}: {:?}", aloft.answer.told);
            aloft.inflict(mishap);
            let (mut turned_s, mut understood) = (0.0, aloft.answer.understood[0]);
            while aloft.time_s() < 6.7 {
                aloft.step(&Hands { arm: true, ..Hands::default() });
                let new = aloft.answer.understood[0] > understood;
                understood = aloft.answer.understood[0];
                if new && aloft.answer.speeds().iter().any(|&speed| speed > 0.0) {
                    turned_s = aloft.time_s() - 6.5;
                }
            }
            println!("{protocol:?}, {mishap:?}: turned for {turned_s:.4} s");
            assert!(turned_s <= within_s, "{protocol:?}, {mishap:?}: {turned_s} s");
            assert_eq!(aloft.answer.speeds(), [0.0; 4], "{protocol:?}, {mishap:?}: it stays disarmed");
        }
    }
}
