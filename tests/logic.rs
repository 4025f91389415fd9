//! Flight logic as it is flown: modes, arming and failsafes on a machine with ground under its feet.
use control_core::arming::Check;
use control_core::autopilot::{Autopilot, AutopilotState, Command, Step, System};
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::failsafe::{Failsafe, Reaction, TABLE};
use control_core::frames::Vec3;
use control_core::measurement::Stamped;
use control_core::modes::{Mode, Reason};
use control_core::motor_test::MotorTestOrder;
use control_core::parameters::Parameters;
use control_core::pilot::{PilotInput, Sticks};
use control_core::set::{Member, Set};
use control_core::{Airframe, Config, Input, Setpoint};
use sim_host::plant::Truth;
use system_tests::garbage::Garbage;
use system_tests::rig::{DT_S, HEALTHY, Rig};

/// Comes down, and what it looks like when it has.
fn lands(rig: &mut Rig, seconds: f64) {
    rig.until(seconds, |_, command| !command.armed);
    rig.fly(1.0);
    let truth = rig.truth();
    assert!(truth.touching && truth.tilt_rad() < 0.1 && truth.impact_m_s < 0.8, "{truth:?}");
    assert_eq!(rig.command().motors, [0.0; 4]);
}

fn speed_m_s(truth: &Truth) -> f64 {
    truth.velocity_m_s.x.hypot(truth.velocity_m_s.y)
}

/// What is looked at in a flight.
type Flown = fn(&Truth) -> f64;

const GENTLE: Sticks = Sticks { right: 0.2, ..Sticks::NEUTRAL };
/// A height from which nothing comes down at once.
const HIGH: [(&str, f32); 2] = [("TKO_HEIGHT", 10.0), ("TKO_SPEED", 4.0)];

#[test]
fn takes_off_hovers_lands_and_disarms_for_good() {
    let mut rig = Rig::new();
    rig.take_off();
    let truth = rig.truth();
    assert!((truth.altitude_m() - 2.5).abs() < 0.3 && speed_m_s(&truth) < 0.1, "{truth:?}");
    rig.pilot.mode = Mode::Land;
    lands(&mut rig, 12.0);
    assert_eq!(rig.command().reason, Some(Reason::Disarmed));
    rig.pilot.mode = Mode::TakeOff;
    rig.watch(5.0, &mut |_, command| assert!(!command.armed && command.motors == [0.0; 4], "the switch is still on"));
    rig.pilot.arm = false;
    rig.fly(0.1);
    rig.take_off();
}

#[test]
fn modes_hand_over_without_a_bump() {
    let by_hand = [Mode::Rate, Mode::Angle, Mode::AltitudeHold, Mode::PositionHold];
    for from in by_hand {
        for to in [by_hand.as_slice(), &[Mode::Land, Mode::Descend]].concat() {
            let mut rig = Rig::hovering(from, &HIGH);
            let before = rig.truth();
            rig.pilot.mode = to;
            let (mut tilt_rad, mut drop_m): (f64, f64) = (0.0, 0.0);
            rig.watch(1.0, &mut |truth, command| {
                assert_eq!(command.mode, to);
                tilt_rad = tilt_rad.max(truth.tilt_rad());
                drop_m = drop_m.max((truth.position_m.z - before.position_m.z).abs());
            });
            let moving_m = before.velocity_m_s.z.abs() * 1.0;
            let least_m = if to.comes_down() { 0.7 } else { 0.1 };
            assert!(tilt_rad < 0.06 && drop_m < least_m + moving_m, "{from} to {to}: {tilt_rad} rad, {drop_m} m");
        }
    }
}

#[test]
fn sticks_do_what_the_modes_say() {
    let full = |change: fn(&mut Sticks)| {
        let mut sticks = Sticks::NEUTRAL;
        change(&mut sticks);
        sticks
    };
    let forward = full(|s| s.forward = 1.0);
    let rows: [(Mode, Sticks, f64, Flown, f64, f64, &str); 9] = [
        (Mode::PositionHold, forward, 5.0, speed_m_s, 5.0, 0.3, "speed"),
        (Mode::PositionHold, full(|s| s.right = -1.0), 5.0, |t| -t.velocity_m_s.y, 5.0, 0.3, "speed to the left"),
        (Mode::PositionHold, full(|s| s.throttle = 1.0), 3.0, |t| -t.velocity_m_s.z, 2.0, 0.1, "climb rate"),
        (Mode::PositionHold, full(|s| s.clockwise = 1.0), 3.0, |t| t.rate_rad_s.z, 1.571, 0.1, "yaw rate"),
        (Mode::AltitudeHold, full(|s| s.throttle = 0.0), 3.0, |t| t.velocity_m_s.z, 1.5, 0.1, "sink rate"),
        (Mode::AltitudeHold, forward, 1.5, |t| -t.angles_rad()[1], 0.524, 0.03, "tilt forward"),
        (Mode::Angle, full(|s| s.right = 1.0), 1.5, |t| t.angles_rad()[0], 0.524, 0.03, "tilt to the right"),
        (Mode::Angle, full(|s| s.clockwise = -1.0), 2.0, |t| t.rate_rad_s.z, -1.571, 0.1, "yaw rate"),
        (Mode::Rate, full(|s| s.right = 1.0), 0.25, |t| t.rate_rad_s.x, 2.618, 0.2, "roll rate"),
    ];
    for (mode, sticks, seconds, flown, want, within, what) in rows {
        let mut rig = Rig::hovering(mode, &HIGH);
        rig.fly(1.0);
        rig.pilot.sticks = sticks;
        rig.fly(seconds);
        let got = flown(&rig.truth());
        assert!((got - want).abs() < within, "{mode}: {what} {got}, wanted {want}");
    }
}

#[test]
fn position_hold_stops_and_stays_in_wind() {
    let mut rig = Rig::hovering(Mode::PositionHold, &HIGH);
    rig.wind_m_s = [4.0, -3.0];
    rig.pilot.sticks.forward = 1.0;
    rig.fly(4.0);
    rig.pilot.sticks = Sticks::NEUTRAL;
    rig.fly(8.0);
    let stopped = rig.truth();
    rig.watch(5.0, &mut |truth, _| {
        assert!((truth.position_m - stopped.position_m).norm() < 0.2 && speed_m_s(truth) < 0.1, "{truth:?}");
    });
}

#[test]
fn a_low_throttle_after_take_off_means_nothing_until_it_was_in_its_middle() {
    let mut rig = Rig::new();
    rig.pilot.mode = Mode::TakeOff;
    rig.fly(1.5);
    rig.pilot.arm = true;
    rig.fly(10.0);
    assert!(rig.truth().altitude_m() > 2.0 && rig.mode() == Mode::PositionHold);
    rig.pilot.sticks.throttle = 0.5;
    rig.fly(0.1);
    rig.pilot.sticks.throttle = 0.0;
    rig.until(5.0, |_, command| command.landed);
    rig.fly(2.0);
    assert!(rig.command().armed, "a pilot who lands by hand disarms by hand");
    assert!(rig.command().motors.iter().all(|&motor| motor < 0.1), "the rotors idle");
}

#[test]
fn modes_fall_back_to_what_the_estimate_allows_and_come_back() {
    let no = |change: fn(&mut Health)| {
        let mut health = HEALTHY;
        change(&mut health);
        health
    };
    for (aim, health, want) in [
        (Mode::PositionHold, no(|h| h.position = false), Mode::PositionHold),
        (Mode::PositionHold, no(|h| h.velocity = false), Mode::AltitudeHold),
        (Mode::PositionHold, no(|h| h.heading = false), Mode::AltitudeHold),
        (Mode::PositionHold, no(|h| h.altitude = false), Mode::Angle),
        (Mode::Land, no(|h| h.velocity = false), Mode::Descend),
        (Mode::Return, no(|h| h.position = false), Mode::Land),
        (Mode::Return, no(|h| h.altitude = false), Mode::Descend),
    ] {
        let mut rig = hovering_for(Failsafe::NoVelocity);
        rig.pilot.mode = aim;
        rig.fly(0.2);
        let before = rig.truth().altitude_m();
        rig.health = health;
        // What may not be flown on is not: it is garbage.
        rig.spoil = |estimate| {
            let Health { altitude, position, velocity, .. } = estimate.health;
            if !position && !velocity {
                estimate.position_m = Vec3::new(f32::NAN, 1e9, estimate.position_m.z);
                estimate.velocity_m_s = Vec3::new(1e9, f32::NAN, estimate.velocity_m_s.z);
            }
            if !altitude {
                (estimate.position_m.z, estimate.velocity_m_s.z) = (f32::NAN, f32::INFINITY);
            }
        };
        rig.fly(DT_S);
        assert_eq!((rig.mode(), rig.command().aim), (want, aim), "at once");
        assert_eq!(want != aim, matches!(rig.command().reason, Some(Reason::Lacks(_))), "and says why");
        rig.watch(2.0, &mut |truth, _| assert!(truth.tilt_rad() < 0.2, "{aim}: {truth:?}"));
        let sunk_m = before - rig.truth().altitude_m();
        assert!((-0.5..2.5).contains(&sunk_m), "{aim}: {sunk_m} m");
        rig.health = HEALTHY;
        rig.spoil = |_| {};
        rig.fly(0.9);
        assert_eq!(rig.mode(), want, "not at once");
        rig.fly(0.2);
        assert_eq!(rig.mode(), aim);
        rig.watch(1.0, &mut |truth, _| assert!(truth.tilt_rad() < 0.4, "{aim}: {truth:?}"));
    }
}

#[test]
fn every_failing_check_is_named_and_nothing_turns() {
    type Spoil = fn(&mut Rig);
    let rows: [(Check, Spoil); 12] = [
        (Check::Link, |rig| rig.link = false),
        (Check::Throttle, |rig| rig.pilot.sticks.throttle = 0.4),
        (Check::Mode, |rig| rig.pilot.mode = Mode::Return),
        (Check::Parameters, |rig| rig.system.parameters_valid = false),
        (Check::SelfTest, |rig| rig.system.self_test_passed = false),
        (Check::GyroCalibrated, |rig| rig.system.gyro_calibrated = false),
        (Check::GyroStill, |rig| rig.spoil = |estimate| estimate.rate_rad_s.z = 0.3),
        (Check::Level, |rig| rig.spoil = |estimate| estimate.specific_force_m_s2.x = 4.0),
        (Check::Estimate, |rig| rig.health.velocity = false),
        (Check::Battery, |rig| rig.system.battery_v = Some(13.8)),
        (Check::Motors, |rig| *rig = Rig::with(&[("BAT_CELLS", 4.0), ("ARM_MOTORS", 1.0)])),
        (Check::Bench, |rig| {
            let order = MotorTestOrder { rotor: Some(0), share: 0.0, seconds: 9.0 };
            assert!(rig.autopilot.begin_motor_test(&mut rig.state, &order));
        }),
    ];
    assert!(rows.iter().map(|(check, _)| *check).eq(Check::ALL.iter().copied()), "every check is flown");
    for (check, spoil) in rows {
        let mut rig = Rig::with(&[("BAT_CELLS", 4.0)]);
        rig.fly(0.1);
        spoil(&mut rig);
        rig.system.battery_v = rig.system.battery_v.or(Some(16.0));
        if check != Check::Mode {
            rig.pilot.mode = Mode::PositionHold;
        }
        rig.fly(2.0);
        rig.pilot.arm = true;
        let mut refused = false;
        rig.watch(1.0, &mut |_, command| {
            assert!(!command.armed && command.motors == [0.0; 4], "{check}");
            // Where nobody is heard, nobody says that the throttle is low.
            let unheard = (check == Check::Link).then_some(Check::Throttle);
            assert!(command.failing.iter().eq([check].into_iter().chain(unheard)), "{check}: {}", command.failing);
            refused |= command.refused;
        });
        // Nobody hears a switch without a link.
        assert_eq!(refused, check != Check::Link);
    }
}

#[test]
fn arms_in_every_mode_that_takes_off_and_idles() {
    for mode in [Mode::Rate, Mode::Angle, Mode::AltitudeHold, Mode::PositionHold] {
        let mut rig = Rig::new();
        rig.pilot.mode = mode;
        rig.fly(1.5);
        rig.pilot.arm = true;
        rig.fly(2.0);
        let command = rig.command();
        assert!(command.armed && command.landed && command.motors == [0.05; 4], "{command:?}");
        rig.pilot.sticks.throttle = 0.7;
        rig.until(3.0, |truth, _| truth.altitude_m() > 0.5);
        rig.watch(0.5, &mut |truth, _| assert!(truth.tilt_rad() < 0.1, "{mode}"));
    }
}

/// What each row's flight is: what is done to a machine that hovers, and how long until it is noticed.
fn provoke(failsafe: Failsafe, rig: &mut Rig) {
    match failsafe {
        Failsafe::NoRates => rig.spoil = |estimate| estimate.rate_rad_s.x = f32::NAN,
        Failsafe::NoTilt => (rig.health.tilt, rig.link) = (false, false),
        Failsafe::Tipped => {
            rig.spoil = |estimate| estimate.attitude.rows = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
        }
        Failsafe::BatteryCritical => rig.system.battery_v = Some(4.0 * 3.2),
        Failsafe::RotorLost => rig.shares[2] = 0.0,
        Failsafe::Overrun => rig.system.late = true,
        Failsafe::BatteryLow => rig.system.battery_v = Some(4.0 * 3.4),
        Failsafe::Fence => (rig.pilot.sticks.forward, rig.pilot.sticks.right) = (1.0, 0.0),
        Failsafe::LinkLost => rig.link = false,
        Failsafe::OffboardStale => rig.offboard = None,
        Failsafe::NoAltitude => rig.health.altitude = false,
        Failsafe::NoVelocity => rig.health.velocity = false,
        Failsafe::NoPosition => rig.health.position = false,
    }
}

/// A machine that hovers at 10 m, 4 m from home, as the row needs it.
fn hovering_for(failsafe: Failsafe) -> Rig {
    let mode = match failsafe {
        Failsafe::OffboardStale | Failsafe::NoPosition => Mode::Offboard,
        _ => Mode::PositionHold,
    };
    let mut rig = Rig::with(&[HIGH[0], HIGH[1], ("BAT_CELLS", 4.0), ("FENCE_RADIUS", 15.0)]);
    rig.system.battery_v = Some(16.0);
    rig.take_off();
    rig.pilot.sticks.forward = 1.0;
    rig.fly(1.6);
    rig.pilot.sticks = Sticks::NEUTRAL;
    rig.fly(4.0);
    let position_m = Vec3::new(4.0, 0.0, -10.0);
    let zero = Vec3::zero();
    let still = Setpoint { position_m, velocity_m_s: zero, acceleration_m_s2: zero, yaw_rad: 0.0, yaw_rate_rad_s: 0.0 };
    rig.offboard = Some(still);
    rig.pilot.mode = mode;
    rig.fly(2.0);
    assert_eq!(rig.mode(), mode);
    rig
}

#[test]
fn every_failsafe_is_flown_to_its_reaction() {
    for row in &TABLE {
        let mut rig = hovering_for(row.failsafe);
        provoke(row.failsafe, &mut rig);
        let acts_s = rig.until(9.0, |_, command| command.failsafes.contains(row.failsafe));
        let noticed = *rig.command();
        // Before a row's time runs, an age must be reached, a rotor found, a fence met.
        let before_s = match row.failsafe {
            Failsafe::LinkLost | Failsafe::OffboardStale | Failsafe::RotorLost => 0.52,
            Failsafe::NoTilt => 0.51,
            Failsafe::Fence => 6.0,
            _ => 0.01,
        };
        let after_s = f64::from(row.after_s);
        assert!((after_s - 0.01..after_s + before_s).contains(&acts_s), "{}: {acts_s} s", row.name);
        match row.reaction {
            Reaction::Terminate => assert!(!noticed.armed && noticed.motors == [0.0; 4], "{}", row.name),
            Reaction::FallBack => assert!(noticed.mode != noticed.aim && noticed.armed, "{}", row.name),
            Reaction::Hold => {
                assert_eq!(noticed.mode, Mode::PositionHold, "{}", row.name);
                let held = rig.truth();
                rig.watch(5.0, &mut |truth, _| assert!((truth.position_m - held.position_m).norm() < 0.5));
            }
            Reaction::Return | Reaction::Land => {
                assert_eq!(
                    (Some(noticed.mode), noticed.reason),
                    (row.reaction.mode(), Some(Reason::Failsafe(row.failsafe)))
                );
                lands(&mut rig, 60.0);
                let truth = rig.truth();
                let from_home_m = truth.position_m.x.hypot(truth.position_m.y);
                assert!(row.reaction == Reaction::Land || from_home_m < 0.5, "{}: {from_home_m} m", row.name);
            }
        }
    }
}

#[test]
fn the_pilot_takes_over_after_a_lost_link_only_by_the_switch() {
    let mut rig = hovering_for(Failsafe::LinkLost);
    rig.link = false;
    rig.fly(2.0);
    assert_eq!(rig.mode(), Mode::Return);
    rig.link = true;
    rig.fly(0.5);
    assert_eq!(rig.mode(), Mode::Return, "hearing the pilot is not enough");
    rig.pilot.mode = Mode::AltitudeHold;
    rig.fly(DT_S);
    assert_eq!((rig.mode(), rig.command().reason), (Mode::AltitudeHold, Some(Reason::Chosen)));
}

#[test]
fn the_pilot_may_overrule_a_low_battery_but_not_a_lost_rotor() {
    for (failsafe, want) in [(Failsafe::BatteryLow, Mode::AltitudeHold), (Failsafe::RotorLost, Mode::Land)] {
        let mut rig = hovering_for(failsafe);
        provoke(failsafe, &mut rig);
        rig.until(9.0, |_, command| command.failsafes.contains(failsafe));
        rig.fly(0.1);
        rig.pilot.mode = Mode::AltitudeHold;
        rig.fly(1.0);
        assert_eq!(rig.mode(), want, "{failsafe}");
    }
}

#[test]
fn the_worst_of_many_failsafes_wins_and_no_good_news_brings_a_milder_one() {
    let mut rig = hovering_for(Failsafe::LinkLost);
    rig.link = false;
    rig.until(2.0, |_, command| command.mode == Mode::Return);
    rig.system.battery_v = Some(12.0);
    rig.until(3.0, |_, command| command.mode == Mode::Land);
    (rig.system, rig.link) = (System { battery_v: Some(16.0), ..System::GOOD }, true);
    rig.fly(1.0);
    assert_eq!(rig.mode(), Mode::Land);
    lands(&mut rig, 60.0);
}

#[test]
fn five_seconds_without_external_vision_are_survived_in_every_mode() {
    for mode in [Mode::PositionHold, Mode::Offboard, Mode::Return, Mode::Land] {
        let mut rig = hovering_for(Failsafe::NoPosition);
        rig.wind_m_s = [2.0, 0.0];
        rig.fly(4.0);
        rig.pilot.mode = mode;
        rig.fly(0.5);
        (rig.health.position, rig.health.velocity) = (false, false);
        rig.watch(5.0, &mut |truth, command| {
            let want = if mode.comes_down() { Mode::Descend } else { Mode::AltitudeHold };
            assert_eq!(command.mode, want);
            assert!(truth.tilt_rad() < 0.3 && truth.altitude_m() > 2.0, "{truth:?}");
        });
        rig.health = HEALTHY;
        rig.fly(6.0);
        assert_eq!(rig.mode(), mode);
        assert!(speed_m_s(&rig.truth()) < 6.0 && rig.truth().tilt_rad() < 0.4);
    }
}

#[test]
fn without_a_link_and_without_velocity_it_descends_level() {
    let mut rig = hovering_for(Failsafe::LinkLost);
    (rig.link, rig.health.position, rig.health.velocity) = (false, false, false);
    rig.fly(1.0);
    assert_eq!((rig.mode(), rig.command().aim), (Mode::Descend, Mode::Return));
    lands(&mut rig, 60.0);
}

#[test]
fn a_weak_rotor_is_flown_through_by_hand_too() {
    for mode in [Mode::Rate, Mode::Angle, Mode::AltitudeHold, Mode::PositionHold] {
        let mut rig = Rig::hovering(mode, &HIGH);
        rig.shares[1] = 0.6;
        let before = rig.truth();
        let mut tilt_rad: f64 = 0.0;
        rig.watch(3.0, &mut |truth, _| tilt_rad = tilt_rad.max(truth.tilt_rad()));
        let sunk_m = before.altitude_m() - rig.truth().altitude_m();
        assert!(tilt_rad < 0.25, "{mode}: {tilt_rad} rad");
        assert!(mode.throttle_is_thrust() || sunk_m.abs() < 0.1, "{mode}: {sunk_m} m");
    }
}

#[test]
fn a_rotor_lost_in_altitude_hold_is_landed_level_without_a_position() {
    let mut rig = Rig::hovering(Mode::AltitudeHold, &HIGH);
    rig.health.position = false;
    rig.health.velocity = false;
    rig.shares[0] = 0.0;
    rig.until(3.0, |_, command| command.mode == Mode::Descend);
    lands(&mut rig, 60.0);
}

#[test]
fn the_bench_turns_rotors_and_finds_their_order() {
    let mut rig = Rig::with(&[("ARM_MOTORS", 1.0)]);
    rig.fly(1.5);
    assert!(rig.autopilot.begin_motor_test(&mut rig.state, &MotorTestOrder { rotor: None, share: 0.1, seconds: 0.5 }));
    let mut turned = Vec::new();
    rig.watch(5.0, &mut |truth, command| {
        let turning = command.motors.iter().position(|&motor| motor > 0.0);
        if turned.last() != Some(&turning) {
            turned.push(turning);
        }
        assert!(truth.touching && !command.armed);
    });
    assert_eq!(turned, [Some(0), None, Some(1), None, Some(2), None, Some(3), None]);
    assert!(rig.command().failing.iter().eq([Check::Motors]));
    assert!(rig.autopilot.begin_wiring_check(&mut rig.state));
    rig.fly(3.0);
    assert_eq!(rig.state.wiring(), Some(Ok(())));
    rig.pilot.arm = true;
    rig.fly(0.1);
    assert!(rig.command().armed);
    assert!(!rig.autopilot.begin_wiring_check(&mut rig.state), "not while armed");
}

#[test]
fn gentle_sticks_and_the_link_failing_in_them_change_no_attitude_for_long() {
    let mut rig = Rig::hovering(Mode::Angle, &HIGH);
    rig.pilot.sticks = GENTLE;
    rig.fly(1.0);
    rig.link = false;
    rig.fly(1.0);
    assert_eq!(rig.mode(), Mode::Return);
    rig.fly(3.0);
    assert!(rig.truth().tilt_rad() < 0.3);
}

/// Steps that begin on the ground, take off, and end in garbage.
const BATCH: u64 = 2000;

/// What a random step is made of, spoilt once in `n` a value.
fn random_step(garbage: &mut Garbage, autopilot: &Autopilot, state: &mut AutopilotState, tick: u64, n: u64) -> Command {
    let now_us = 1_000_000 + 2000 * tick;
    let mut stamp = |garbage: &mut Garbage| if garbage.once_in(n) { garbage.bits() } else { now_us };
    let hover = Input::hovering();
    let mut healthy = |garbage: &mut Garbage| !garbage.once_in(20 * n);
    let estimate = Estimate {
        time_us: stamp(garbage),
        position_m: garbage.spoil_vector(Vec3::new(0.0, 0.0, -1.0), n),
        velocity_m_s: garbage.spoil_vector(hover.velocity_m_s, n),
        attitude: garbage.spoil_attitude(&hover.attitude, n),
        rate_rad_s: garbage.spoil_vector(hover.rate_rad_s, n),
        specific_force_m_s2: garbage.spoil_vector(hover.specific_force_m_s2, n),
        gyro_bias_rad_s: Vec3::zero(),
        accelerometer_bias_m_s2: Vec3::zero(),
        sigma: Sigma::default(),
        health: Health {
            rates: healthy(garbage),
            tilt: healthy(garbage),
            heading: healthy(garbage),
            altitude: healthy(garbage),
            velocity: healthy(garbage),
            position: healthy(garbage),
        },
    };
    let (batch, phase) = (tick / BATCH, tick % BATCH);
    let mode = if phase < BATCH / 2 { Mode::TakeOff } else { Mode::ALL[(batch % 10) as usize] };
    let sticks = Sticks {
        right: garbage.spoil(0.1, n),
        forward: garbage.spoil(0.5, n),
        clockwise: garbage.spoil(-0.2, n),
        throttle: garbage.spoil(0.6, n),
    };
    let pilot = Stamped { time_us: stamp(garbage), value: PilotInput { sticks, arm: phase > BATCH * 3 / 10, mode } };
    let offboard = Stamped {
        time_us: stamp(garbage),
        value: Setpoint { position_m: garbage.spoil_vector(Vec3::new(1.0, 0.0, -2.0), n), ..hover.setpoint },
    };
    let battery_v = Some(garbage.spoil(16.0, n));
    let system = System { battery_v, late: garbage.once_in(n), ..System::GOOD };
    let step = Step {
        now_us: stamp(garbage),
        dt_s: garbage.spoil(0.002, n),
        estimate: &estimate,
        pilot: (!garbage.once_in(n)).then_some(&pilot),
        offboard: (!garbage.once_in(n)).then_some(&offboard),
        system: &system,
    };
    autopilot.step(state, &step)
}

#[test]
fn a_million_random_samples_leave_motors_within_0_and_1_and_the_state_finite() {
    let mut parameters = Parameters::default();
    parameters.set("BAT_CELLS", 4.0).expect("in its range");
    let config = Config::tolerant(Airframe::paper(2.2));
    let autopilot = Autopilot::try_new(&config, &parameters).expect("shipped gains");
    let (mut garbage, mut state) = (Garbage(7), autopilot.state());
    let (mut seen, mut armed, mut rejected, mut failsafes) = (Vec::new(), 0, 0, Set::<Failsafe>::EMPTY);
    for tick in 0..2_400_000 {
        // The first half of a batch is good, so that it takes off; then one value in 10, 100 or 1000 is not.
        let (batch, phase) = (tick / BATCH, tick % BATCH);
        let n = if phase < BATCH / 2 { u64::MAX } else { [10, 100, 1000][(batch % 3) as usize] };
        let command = random_step(&mut garbage, &autopilot, &mut state, tick, n);
        assert!(command.motors.iter().all(|motor| (0.0..=1.0).contains(motor)), "tick {tick}: {command:?}");
        assert!(command.armed || command.motors == [0.0; 4], "tick {tick}: {command:?}");
        let flown = command.armed && phase >= BATCH / 2;
        (armed, rejected) = (armed + u32::from(flown), rejected + u32::from(command.rejected));
        command.failsafes.iter().for_each(|failsafe| failsafes.put(failsafe, true));
        if !seen.contains(&command.mode) {
            seen.push(command.mode);
        }
        if phase == BATCH - 1 {
            let text = format!("{state:?}").replace("information", "");
            assert!(!text.contains("NaN") && !text.contains("inf"), "tick {tick}: {text}");
        }
    }
    assert!(armed > 50_000 && rejected > 1000, "garbage was flown on: {armed} steps, {rejected} rejected");
    assert!(seen.len() >= 9, "{seen:?}");
    assert!(failsafes.iter().count() >= 8, "{failsafes}");
}
