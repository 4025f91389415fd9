//! Failsafes as they are flown: each to its reaction, in its time, from a hover 4 m from home.
use control_core::autopilot::System;
use control_core::failsafe::{Failsafe, Reaction, TABLE};
use control_core::modes::{Mode, Reason};
use system_tests::rig::{DT_S, HEALTHY, Rig};

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

#[test]
fn every_failsafe_is_flown_to_its_reaction() {
    for row in &TABLE {
        let mode = match row.failsafe {
            Failsafe::OffboardStale | Failsafe::NoPosition => Mode::Offboard,
            _ => Mode::PositionHold,
        };
        let mut rig = Rig::away(mode);
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
            Reaction::Terminate => {
                assert!(!noticed.armed, "{}", row.name);
                // At the next sample.
                rig.fly(0.002);
                assert_eq!(rig.command().motors, [0.0; 4], "{}", row.name);
            }
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
                rig.lands(60.0);
                let truth = rig.truth();
                let from_home_m = truth.position_m.x.hypot(truth.position_m.y);
                assert!(row.reaction == Reaction::Land || from_home_m < 0.5, "{}: {from_home_m} m", row.name);
            }
        }
    }
}

#[test]
fn the_pilot_takes_over_after_a_lost_link_only_by_the_switch() {
    let mut rig = Rig::away(Mode::PositionHold);
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
        let mut rig = Rig::away(Mode::PositionHold);
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
    let mut rig = Rig::away(Mode::PositionHold);
    rig.link = false;
    rig.until(2.0, |_, command| command.mode == Mode::Return);
    rig.system.battery_v = Some(12.0);
    rig.until(3.0, |_, command| command.mode == Mode::Land);
    (rig.system, rig.link) = (System { battery_v: Some(16.0), ..System::GOOD }, true);
    rig.fly(1.0);
    assert_eq!(rig.mode(), Mode::Land);
    rig.lands(60.0);
}

#[test]
fn five_seconds_without_external_vision_are_survived_in_every_mode() {
    for mode in [Mode::PositionHold, Mode::Offboard, Mode::Return, Mode::Land] {
        let mut rig = Rig::away(Mode::Offboard);
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
        assert!(rig.speed_m_s() < 6.0 && rig.truth().tilt_rad() < 0.4);
    }
}

#[test]
fn without_a_link_and_without_velocity_it_descends_level() {
    let mut rig = Rig::away(Mode::PositionHold);
    (rig.link, rig.health.position, rig.health.velocity) = (false, false, false);
    rig.fly(1.0);
    assert_eq!((rig.mode(), rig.command().aim), (Mode::Descend, Mode::Return));
    rig.lands(60.0);
}

#[test]
fn a_rotor_lost_in_altitude_hold_is_landed_level_without_a_position() {
    let mut rig = Rig::hovering(Mode::AltitudeHold, &Rig::HIGH);
    rig.health.position = false;
    rig.health.velocity = false;
    rig.shares[0] = 0.0;
    rig.until(3.0, |_, command| command.mode == Mode::Descend);
    rig.lands(60.0);
}

#[test]
fn gentle_sticks_and_the_link_failing_in_them_change_no_attitude_for_long() {
    let mut rig = Rig::hovering(Mode::Angle, &Rig::HIGH);
    rig.pilot.sticks.right = 0.2;
    rig.fly(1.0);
    rig.link = false;
    rig.fly(1.0);
    assert_eq!(rig.mode(), Mode::Return);
    rig.fly(3.0);
    assert!(rig.truth().tilt_rad() < 0.3);
}

#[test]
fn two_facing_rotors_lost_are_landed_as_fast_as_two_can_carry() {
    for pair in [[0, 2], [1, 3]] {
        let mut rig = Rig::away(Mode::PositionHold);
        for rotor in pair {
            rig.shares[rotor] = 0.0;
        }
        rig.until(20.0, |_, command| !command.armed);
        let truth = rig.truth();
        assert!(truth.touching && truth.impact_m_s < 2.0 && truth.tilt_rad() < 0.1, "{truth:?}");
    }
}

#[test]
fn a_failsafe_on_the_ground_disarms() {
    let mut rig = Rig::new();
    rig.pilot.mode = Mode::PositionHold;
    rig.fly(1.5);
    rig.pilot.arm = true;
    rig.fly(1.0);
    assert!(rig.command().armed);
    rig.link = false;
    rig.fly(0.6);
    assert!(!rig.command().armed);
    rig.link = true;
    rig.watch(1.0, &mut |_, command| assert!(!command.armed, "the switch is still on"));
}
