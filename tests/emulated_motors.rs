//! What speed controllers answer, what the motors are told when the inertial unit fails, and what the buzzer says. On the emulator, in the image that is flashed.
//!
//! Needs cmake and libclang (`cargo xtask setup`), and so a feature: `cargo test --features emulated --test emulated_motors`.
use sim_host::emulator::{Mishap, Telemetry};
use system_tests::aloft::{Aloft, Hands, SAMPLE_HZ};

/// What became of the rotors' speeds.
struct Speeds {
    /// Largest error of each rotor's, rad/s, while it turned evenly.
    off_rad_s: [f32; 4],
    /// Steps in which it was told a speed above 0, and in which the image was told anything.
    turning: [u32; 4],
    told: u32,
    /// Steps in which the motors were told to stand.
    stood: u32,
    log: String,
}

/// Armed on the ground, rotors idling, and from then on speed controllers that answer like this, for long enough that a whole second of it is
/// logged; all but the first second counts.
fn idling_with(telemetry: [Telemetry; 4]) -> Speeds {
    let mut aloft = Aloft::on_the_ground();
    let mut told = Speeds { off_rad_s: [0.0; 4], turning: [0; 4], told: 0, stood: 0, log: String::new() };
    while aloft.time_s() < 9.8 {
        if aloft.time_s() == 7.0 {
            (0..).zip(telemetry).for_each(|(motor, telemetry)| aloft.set_telemetry(motor, telemetry));
        }
        aloft.step(&Hands { arm: aloft.time_s() > 6.0, ..Hands::default() });
        if aloft.time_s() < 7.0 {
            continue;
        }
        told.log += &aloft.answer.log;
        if aloft.time_s() < 8.0 {
            continue;
        }
        told.stood += u32::from(aloft.answer.told.contains(&Some(0)));
        let record = aloft.answer.record.expect("a step was made");
        let Some(speeds) = record.arrived.measurements.rotor_rad_s else { continue };
        told.told += 1;
        assert!(
            (400..1_500).contains(&(record.time_us - speeds.time_us)),
            "{} us old",
            record.time_us - speeds.time_us
        );
        for (motor, (speed, truth)) in speeds.value.into_iter().zip(aloft.rotor_rad_s).enumerate() {
            if speed > 0.0 {
                told.turning[motor] += 1;
                told.off_rad_s[motor] = told.off_rad_s[motor].max((speed - truth).abs());
            }
        }
    }
    println!("{telemetry:?}: {:?} rad/s off, {:?} of {} told", told.off_rad_s, told.turning, told.told);
    told
}

/// Steps that count.
const COUNTED: u32 = 9 * SAMPLE_HZ / 5;

#[test]
fn rotor_speeds_are_told_by_every_speed_controller_to_every_frame() {
    let Speeds { off_rad_s, turning, told, stood, log } = idling_with([Telemetry::Well; 4]);
    assert!(told >= COUNTED - 1 && turning == [told; 4], "{turning:?} of {told}");
    // Steps of its period of 1 in 256 at the coarsest.
    assert!(off_rad_s.iter().all(|&off| off < 0.5), "{off_rad_s:?}");
    assert!(stood == 0 && !log.contains("were answered"), "{log}");
}

#[test]
fn a_speed_controller_that_falls_silent_costs_its_own_speed_and_one_that_garbles_as_well() {
    for lost in [Telemetry::Silent, Telemetry::Garbled] {
        let mut telemetry = [Telemetry::Well; 4];
        telemetry[2] = lost;
        let Speeds { turning, told, stood, log, .. } = idling_with(telemetry);
        assert!(told >= COUNTED - 1, "{told}");
        assert_eq!(turning, [told, told, 0, told], "{lost:?}: after a tenth of a second it is as if it stood");
        assert_eq!(stood, 0, "the motors turn on");
        let garbled = if lost == Telemetry::Garbled { 2_000 } else { 0 };
        let said = format!("motor 3: of 2000 frames 0 were answered, {garbled} not understood");
        assert!(log.contains(&said) && !log.contains("motor 1: of"), "{log}");
    }
}

#[test]
fn all_speed_controllers_silent_cost_the_notches_and_the_motors_turn_on() {
    for lost in [Telemetry::Silent, Telemetry::Garbled] {
        let Speeds { told, stood, log, .. } = idling_with([lost; 4]);
        assert_eq!((told, stood), (0, 0), "{lost:?}");
        for motor in 1..=4 {
            assert!(log.contains(&format!("motor {motor}: of 2000 frames 0 were answered")), "{log}");
        }
    }
}

#[test]
fn the_buzzer_says_that_arming_was_refused_that_it_is_armed_and_that_it_is_not_any_more() {
    let mut aloft = Aloft::on_the_ground();
    // Whether arm is on, until when, and how often it sounds, for how many tenths of a second. At first the gyro is not calibrated.
    for (arm, until_s, sounds, tenths) in
        [(false, 1.0, 0, 0), (true, 2.0, 3, 3), (false, 6.0, 0, 0), (true, 7.0, 1, 4), (false, 8.0, 1, 2)]
    {
        let (mut heard, mut samples, mut before) = (0, 0, false);
        while aloft.time_s() < until_s {
            aloft.step(&Hands { arm, ..Hands::default() });
            let now = aloft.buzzer_sounds();
            heard += u32::from(now && !before);
            samples += u32::from(now);
            before = now;
        }
        assert_eq!(heard, sounds, "arm {arm} until {until_s} s");
        assert_eq!((samples + SAMPLE_HZ / 20) / (SAMPLE_HZ / 10), tenths, "arm {arm} until {until_s} s: {samples}");
    }
}

#[test]
fn an_inertial_unit_that_fails_as_it_rolls_takes_the_torque_away_within_20_ms_and_then_the_motors() {
    for mishap in [Mishap::AllZeros, Mishap::AllOnes, Mishap::Garbage] {
        let mut aloft = Aloft::on_the_ground();
        // The stick pulls it over just then: its rotors are told to turn it.
        while aloft.time_s() < 10.0 {
            let (t_s, truth) = (aloft.time_s(), aloft.truth());
            let (error_m, sink_m_s) = (0.6 * (t_s - 6.5) - truth.altitude_m(), truth.velocity_m_s.z);
            let throttle = if t_s > 6.5 { (0.42 + 0.25 * error_m + 0.15 * sink_m_s).clamp(0.0, 0.9) } else { 0.0 };
            let roll = if t_s > 9.93 { 0.8 } else { 0.0 };
            aloft.step(&Hands { arm: t_s > 6.0, throttle, roll, ..Hands::default() });
        }
        let apart = |aloft: &Aloft| {
            let told = aloft.answer.told.map(|told| told.expect("it turns"));
            told.iter().max().expect("four") - told.iter().min().expect("four")
        };
        assert!(aloft.truth().altitude_m() > 0.3 && apart(&aloft) > 50, "{mishap:?}: {:?}", aloft.answer.told);
        aloft.inflict(mishap);
        let (mut torque_s, mut turned_s) = (0.0, 0.0);
        while aloft.time_s() < 10.2 {
            aloft.step(&Hands { arm: true, throttle: 0.5, roll: 0.8, ..Hands::default() });
            let since_s = aloft.time_s() - 10.0;
            if aloft.answer.told.iter().flatten().any(|&told| told > 0) {
                (torque_s, turned_s) = (if apart(&aloft) > 1 { since_s } else { torque_s }, since_s);
            }
        }
        println!("{mishap:?}: torque for {torque_s:.4} s, turned for {turned_s:.4} s");
        assert!(torque_s <= 0.02 && turned_s <= 0.13, "{mishap:?}: torque {torque_s} s, turned {turned_s} s");
    }
}
