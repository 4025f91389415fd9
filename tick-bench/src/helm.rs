//! Instructions between the estimate and the motors' commands, beside those of the controller alone.
//!
//! A machine that takes off by itself, in a world where all goes as wanted: it rises steadily. What the controller adds where rotors are at
//! fault is counted on the recorded flights.
use crate::count::Counter;
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::flight::{Arrived, Command, Helm};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::Stamped;
use control_core::modes::Mode;
use control_core::parameters::Parameters;
use control_core::pilot::{PilotInput, Sticks};
use control_core::{Airframe, Config, Controller, Input, State};
use core::hint::black_box;
use cortex_m_semihosting::hprintln;

/// Samples of 2 ms, those after which the switch goes on, and those after which it has left the ground.
const SAMPLES: u64 = 3000;
const ARMED: u64 = 500;
const ALOFT: u64 = 1500;

/// Prints one line.
pub(crate) fn print(counter: &Counter) -> Result<(), &'static str> {
    let config = black_box(Config::tolerant(Airframe::paper(2.2)));
    let mut helm = Helm::try_new(&config, &Parameters::default()).map_err(|_| "the helm is refused")?;
    let controller = Controller::try_new(&config).map_err(|_| "the controller is refused")?;
    let mut state = controller.hover_state();
    let (mut helm_worst, mut controller_worst, mut flown) = (0, 0, 0);
    for i in 1..SAMPLES {
        let now_us = i * 2000;
        let estimate = black_box(rising(now_us, i.saturating_sub(ALOFT)));
        let (instructions, _) = counter.instructions(|| act(&mut helm, now_us, &estimate));
        let value =
            PilotInput { sticks: Sticks { throttle: 0.0, ..Sticks::NEUTRAL }, arm: i > ARMED, mode: Mode::TakeOff };
        let pilot = Some(Stamped { time_us: now_us, value });
        let flies = helm.decision().is_some_and(|decision| decision.armed && !decision.landed);
        helm.decide(
            now_us,
            &estimate,
            true,
            &Arrived { pilot, self_test_passed: true, parameters_valid: true, ..Arrived::default() },
        );
        let input = Input {
            dt_s: 0.002,
            position_m: estimate.position_m,
            velocity_m_s: estimate.velocity_m_s,
            rate_rad_s: estimate.rate_rad_s,
            specific_force_m_s2: estimate.specific_force_m_s2,
            ..Input::hovering()
        };
        let (alone, ()) = counter.instructions(|| act_alone(&controller, &mut state, &input));
        controller.reflect(&mut state);
        if flies {
            (helm_worst, controller_worst, flown) =
                (instructions.max(helm_worst), alone.max(controller_worst), flown + 1);
        }
    }
    hprintln!("helm flown={} act={} controller={}", flown, helm_worst, controller_worst);
    Ok(())
}

/// As a task would call it: not inlined, so that the call is counted too.
#[inline(never)]
fn act(helm: &mut Helm, now_us: u64, estimate: &Estimate) -> Command {
    helm.act(now_us, estimate)
}

#[inline(never)]
fn act_alone(controller: &Controller, state: &mut State, input: &Input) {
    black_box(controller.act(state, input));
}

/// What is believed of a machine that has risen at 1 m/s for some samples.
fn rising(time_us: u64, samples: u64) -> Estimate {
    // Never quite at rest, as none is.
    let jitter = (time_us / 2000 % 17) as f32 * 1e-3;
    let climb_m_s = if samples > 0 { 1.0 } else { 0.0 };
    Estimate {
        time_us,
        position_m: Vec3::new(0.0, 0.0, -climb_m_s * samples as f32 * 0.002),
        velocity_m_s: Vec3::new(jitter, 0.0, -climb_m_s),
        attitude: Attitude::level(),
        rate_rad_s: Vec3::new(jitter, -jitter, 0.5 * jitter),
        specific_force_m_s2: Vec3::new(jitter, jitter, jitter - 9.81),
        gyro_bias_rad_s: Vec3::zero(),
        accelerometer_bias_m_s2: Vec3::zero(),
        sigma: Sigma::default(),
        health: Health { rates: true, tilt: true, heading: true, altitude: true, velocity: true, position: true },
    }
}
