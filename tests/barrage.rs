//! The autopilot under values that no sensor should say.
use control_core::autopilot::{Autopilot, AutopilotState, Command, Step, System};
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::failsafe::Failsafe;
use control_core::frames::Vec3;
use control_core::measurement::Stamped;
use control_core::modes::Mode;
use control_core::parameters::Parameters;
use control_core::pilot::{PilotInput, Sticks};
use control_core::set::Set;
use control_core::{Airframe, Config, Input, Setpoint};
use system_tests::garbage::Garbage;

/// Steps that begin on the ground, take off, and end in garbage.
const BATCH: u64 = 2000;

/// What a random step is made of, spoilt once in `n` a value.
fn random_step(garbage: &mut Garbage, autopilot: &Autopilot, state: &mut AutopilotState, tick: u64, n: u64) -> Command {
    let now_us = 1_000_000 + 2000 * tick;
    let stamp = |garbage: &mut Garbage| if garbage.once_in(n) { garbage.bits() } else { now_us };
    let hover = Input::hovering();
    let healthy = |garbage: &mut Garbage| !garbage.once_in(n.saturating_mul(20));
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
    let mut was_armed = false;
    let (mut seen, mut armed, mut rejected, mut failsafes) = (Vec::new(), 0, 0, Set::<Failsafe>::EMPTY);
    for tick in 0..2_400_000 {
        // The first half of a batch is good, so that it takes off; then one value in 10, 100 or 1000 is not.
        let (batch, phase) = (tick / BATCH, tick % BATCH);
        let n = if phase < BATCH / 2 { u64::MAX } else { [10, 100, 1000][(batch % 3) as usize] };
        let command = random_step(&mut garbage, &autopilot, &mut state, tick, n);
        assert!(command.motors.iter().all(|motor| (0.0..=1.0).contains(motor)), "tick {tick}: {command:?}");
        assert!(was_armed || command.motors == [0.0; 4], "tick {tick}: {command:?}");
        was_armed = command.armed;
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
