//! Flight logic as it is flown: modes and arming on a machine with ground under its feet.
use control_core::arming::Check;
use control_core::autopilot::{BenchOrder, BenchTest};
use control_core::estimate::Health;
use control_core::frames::Vec3;
use control_core::modes::{Mode, Reason};
use control_core::motor_test::MotorTestOrder;
use control_core::pilot::Sticks;
use control_core::set::Member;
use sim_host::plant::Truth;
use system_tests::rig::{DT_S, HEALTHY, Rig};

fn speed_m_s(truth: &Truth) -> f64 {
    truth.velocity_m_s.x.hypot(truth.velocity_m_s.y)
}

/// What is looked at in a flight.
type Flown = fn(&Truth) -> f64;

#[test]
fn takes_off_hovers_lands_and_disarms_for_good() {
    let mut rig = Rig::new();
    rig.take_off();
    let truth = rig.truth();
    assert!((truth.altitude_m() - 2.5).abs() < 0.3 && speed_m_s(&truth) < 0.1, "{truth:?}");
    rig.pilot.mode = Mode::Land;
    rig.lands(12.0);
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
            let mut rig = Rig::hovering(from, &Rig::HIGH);
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
        let mut rig = Rig::hovering(mode, &Rig::HIGH);
        rig.fly(1.0);
        rig.pilot.sticks = sticks;
        rig.fly(seconds);
        let got = flown(&rig.truth());
        assert!((got - want).abs() < within, "{mode}: {what} {got}, wanted {want}");
    }
}

#[test]
fn position_hold_stops_and_stays_in_wind() {
    let mut rig = Rig::hovering(Mode::PositionHold, &Rig::HIGH);
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
        let mut rig = Rig::away(Mode::PositionHold);
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
    let rows: [(Check, Spoil); 13] = [
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
            assert!(rig.autopilot.order(&mut rig.state, &BenchOrder::Motors(order)));
        }),
        (Check::Late, |rig| rig.system.late = true),
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

#[test]
fn a_weak_rotor_is_flown_through_by_hand_too() {
    for mode in [Mode::Rate, Mode::Angle, Mode::AltitudeHold, Mode::PositionHold] {
        let mut rig = Rig::hovering(mode, &Rig::HIGH);
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
fn the_bench_turns_rotors_and_finds_their_order() {
    let mut rig = Rig::with(&[("ARM_MOTORS", 1.0)]);
    rig.fly(1.5);
    let all = BenchOrder::Motors(MotorTestOrder { rotor: None, share: 0.1, seconds: 0.5 });
    assert!(rig.autopilot.order(&mut rig.state, &all));
    assert_eq!(rig.state.bench(), Some(BenchTest::Motors));
    let mut turned = Vec::new();
    rig.watch(5.0, &mut |truth, command| {
        let turning = command.motors.iter().position(|&motor| motor > 0.0);
        if turned.last() != Some(&turning) {
            turned.push(turning);
        }
        assert!(truth.touching && !command.armed);
    });
    assert_eq!(turned, [None, Some(0), None, Some(1), None, Some(2), None, Some(3), None]);
    assert!(rig.command().failing.iter().eq([Check::Motors]));
    assert_eq!(rig.state.bench(), None, "it is over");
    assert!(rig.autopilot.order(&mut rig.state, &all));
    rig.fly(0.2);
    assert!(rig.autopilot.order(&mut rig.state, &BenchOrder::Stop));
    rig.watch(1.0, &mut |_, command| assert_eq!(command.motors, [0.0; 4]));
    assert!(rig.autopilot.order(&mut rig.state, &BenchOrder::Wiring));
    rig.fly(3.0);
    assert_eq!(rig.state.wiring(), Some(Ok(())));
    rig.pilot.arm = true;
    rig.fly(0.1);
    assert!(rig.command().armed);
    for order in [all, BenchOrder::Wiring, BenchOrder::Stop] {
        assert!(!rig.autopilot.order(&mut rig.state, &order), "not while armed");
    }
}
