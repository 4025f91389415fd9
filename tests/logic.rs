//! Flight logic as it is flown: modes, arming and failsafes on a machine with ground under its feet.
use control_core::autopilot::Command;
use control_core::modes::Mode;
use control_core::pilot::Sticks;
use sim_host::plant::Truth;
use system_tests::rig::Rig;

fn show(n: &mut usize, every: usize, truth: &Truth, command: &Command) {
    *n += 1;
    if *n % every == 0 {
        println!(
            "{:.1} n {:.2} e {:.2} z {:.3} v {:.3} {:.3} {:.3} yaw {:.2} tilt {:.3} {}<-{} {:?} {:.2?} landed {} fs {} fail {}",
            *n as f64 * 0.002,
            truth.position_m.x,
            truth.position_m.y,
            truth.altitude_m(),
            truth.velocity_m_s.x,
            truth.velocity_m_s.y,
            truth.velocity_m_s.z,
            truth.angles_rad()[2],
            truth.tilt_rad(),
            command.mode,
            command.aim,
            command.reason,
            command.motors,
            command.landed,
            command.failsafes,
            command.failing
        );
    }
}

#[test]
fn modes() {
    let mut n = 0;
    let mut rig = Rig::new();
    rig.take_off();
    rig.wind_m_s = [2.0, 0.0];
    for (mode, sticks, s) in [
        (Mode::PositionHold, Sticks { forward: 0.0, ..Sticks::NEUTRAL }, 6.0),
        (Mode::PositionHold, Sticks { forward: 1.0, clockwise: 0.3, ..Sticks::NEUTRAL }, 4.0),
        (Mode::PositionHold, Sticks::NEUTRAL, 4.0),
        (Mode::AltitudeHold, Sticks { right: 0.3, ..Sticks::NEUTRAL }, 3.0),
        (Mode::AltitudeHold, Sticks { throttle: 1.0, ..Sticks::NEUTRAL }, 3.0),
        (Mode::Angle, Sticks { ..Sticks::NEUTRAL }, 3.0),
        (Mode::Angle, Sticks { clockwise: 1.0, right: -0.3, ..Sticks::NEUTRAL }, 3.0),
        (Mode::Rate, Sticks { clockwise: 0.5, ..Sticks::NEUTRAL }, 2.0),
        (Mode::PositionHold, Sticks::NEUTRAL, 5.0),
        (Mode::Return, Sticks::NEUTRAL, 60.0),
    ] {
        println!("--- {mode} {sticks:?}");
        rig.pilot.mode = mode;
        rig.pilot.sticks = sticks;
        rig.watch(s, &mut |truth, command| show(&mut n, if mode == Mode::Return { 500 } else { 250 }, truth, command));
    }
}
#[test]
fn descends() {
    let mut n = 0;
    let mut rig = Rig::new();
    rig.take_off();
    rig.pilot.mode = Mode::Land;
    rig.watch(10.0, &mut |truth, command| show(&mut n, 100, truth, command));
    println!("impact {}", rig.truth().impact_m_s);
    let mut rig = Rig::new();
    rig.take_off();
    rig.wind_m_s = [2.0, 0.0];
    rig.pilot.mode = Mode::Descend;
    rig.watch(12.0, &mut |truth, command| show(&mut n, 100, truth, command));
    println!("impact {}", rig.truth().impact_m_s);
    let mut rig = Rig::new();
    rig.take_off();
    println!("rotor lost");
    rig.shares = [0.0, 1.0, 1.0, 1.0];
    rig.watch(20.0, &mut |truth, command| show(&mut n, 100, truth, command));
    println!("impact {}", rig.truth().impact_m_s);
}
