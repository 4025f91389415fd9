//! Flight: what the control task calls between reading and writing. One function, the same on the board and on the host.
//!
//! Until there is an estimator and an autopilot, [`Flight::step`] gives the core the measured rates and specific force, and
//! the pose of a machine that sways (`synthetic`); nothing arms, so every command is to stop.
use control_core::measurement::Measurements;
use control_core::{Airframe, Axis, Config, ConfigError, Controller, Input, Law, Output, State};

use crate::icm42688;
use crate::synthetic;

/// Thrust over weight of the airframe that is flown.
const THRUST_TO_WEIGHT: f32 = 2.2;

/// What the motors do until the next step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// They stand.
    Stop,
    /// They turn, each at a share of its fastest speed, 0 to 1.
    Run([f32; 4]),
}

/// What a step has decided, and why, for the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// What the motors do.
    pub command: Command,
    /// What the core was given.
    pub input: Input,
    /// What it gave.
    pub output: Output,
}

/// The core and what it flies.
#[derive(Debug)]
pub struct Flight {
    /// The machine.
    pub airframe: Airframe,
    controller: Controller,
    state: State,
    /// When the last step was, µs since boot.
    last_us: Option<u64>,
}

impl Flight {
    /// At rest, on the ground.
    ///
    /// # Errors
    /// Names the first value of the configuration that cannot fly.
    pub fn try_new() -> Result<Self, ConfigError> {
        let airframe = Airframe::paper(THRUST_TO_WEIGHT);
        // Not `Config::tolerant`: the pose does not answer the rotors, and it would find them all at fault.
        let config = Config { control_hz: icm42688::SAMPLE_HZ, ..Config::flight(Law::Lgs, airframe) };
        let controller = Controller::try_new(&config)?;
        let state = controller.hover_state();
        Ok(Self { airframe, controller, state, last_us: None })
    }

    /// Decides what the motors do.
    ///
    /// - `now_us`: when the measurements were taken, µs since boot.
    pub fn step(&mut self, now_us: u64, measurements: &Measurements) -> Step {
        let elapsed_us = now_us.saturating_sub(self.last_us.unwrap_or(now_us));
        self.last_us = Some(now_us);
        let mut input = synthetic::sample(now_us, elapsed_us as f32 * 1e-6);
        if let Some(imu) = &measurements.imu {
            input.rate_rad_s = imu.value.rate_rad_s;
            input.specific_force_m_s2 = imu.value.specific_force_m_s2;
        }
        let output = self.tick(&input);
        Step { command: Command::Stop, input, output }
    }

    /// Gains of the altitude axis.
    pub fn altitude_gains(&self) -> [f32; 3] {
        self.controller.telemetry(&self.state).axes[Axis::Z as usize].gains
    }

    /// Not inlined, so that a profile shows what the core takes.
    #[inline(never)]
    fn tick(&mut self, input: &Input) -> Output {
        *self.controller.tick(&mut self.state, input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control_core::frames::Vec3;
    use control_core::measurement::{Imu, Stamped};

    #[test]
    fn the_core_sees_what_the_imu_measures_and_no_motor_turns() {
        let mut flight = Flight::try_new().unwrap();
        let value = Imu { rate_rad_s: Vec3::new(0.1, 0.2, 0.3), specific_force_m_s2: Vec3::new(0.0, 0.0, -9.7) };
        for n in 0..2_000 {
            let now_us = 500 * n;
            let measurements =
                Measurements { imu: Some(Stamped { time_us: now_us, value }), ..Measurements::default() };
            let step = flight.step(now_us, &measurements);
            assert_eq!(step.input.rate_rad_s, value.rate_rad_s);
            assert_eq!(step.input.specific_force_m_s2, value.specific_force_m_s2);
            assert_eq!(step.command, Command::Stop);
            assert!(!step.output.rejected);
        }
    }

    #[test]
    fn a_step_without_an_inertial_sample_is_no_step_of_nan() {
        let mut flight = Flight::try_new().unwrap();
        let step = flight.step(500, &Measurements::default());
        assert!(step.output.thrust_n.iter().all(|thrust| thrust.is_finite()));
    }
}
