//! Flight: what the control task calls between reading and writing. One function, the same on the board and on the host.
//!
//! ```text
//! measurements ─► estimator, every sample ─► autopilot, every fourth ─► command
//! pilot ───────────────────────────────────────┘
//! ```
//!
//! Nothing is decided here: the estimator and the autopilot are the core's. A command is a share of the largest thrust; a speed
//! controller turns its rotor in proportion to what it is told, and thrust grows with the square of the speed, so the share
//! of the speed is its root.
//!
//! Invariant: without an armed autopilot, or one whose bench runs a rotor, the command is [`Command::Stop`].
use control_core::autopilot::{self, Autopilot, AutopilotState, System};
use control_core::estimate::Estimate;
use control_core::estimation::{Estimator, EstimatorConfig, EstimatorState, GyroConfig, Phase};
use control_core::measurement::{Measurements, Stamped};
use control_core::parameters::Parameters;
use control_core::pilot::PilotInput;
use control_core::{Airframe, Config, Scalar};

use crate::icm42688;

/// Thrust over weight of the airframe that is flown.
const THRUST_TO_WEIGHT: f32 = 2.2;
/// Inertial samples in a step of the autopilot, whose gains and watch over the rotors are for 500 steps a second.
pub const SAMPLES_A_STEP: u32 = 4;

/// What the motors do until the next step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// They stand.
    Stop,
    /// They turn, each at a share of its fastest speed, 0 to 1.
    Run([f32; 4]),
}

/// Everything that has arrived since the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Arrived {
    /// From the sensors.
    pub measurements: Measurements,
    /// From the pilot, if there was a frame.
    pub pilot: Option<Stamped<PilotInput>>,
    /// Whether the last step came late.
    pub late: bool,
    /// Whether every part has said that it is there.
    pub self_test_passed: bool,
}

/// What cannot fly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unflyable {
    /// The value's name, and the part it belongs to.
    pub name: [&'static str; 2],
    /// The value.
    pub value: f32,
}

/// Estimator, autopilot, and what changes in them.
#[derive(Debug)]
pub struct Flight {
    estimator: Estimator,
    estimator_state: EstimatorState,
    autopilot: Autopilot,
    autopilot_state: AutopilotState,
    pilot: Option<Stamped<PilotInput>>,
    battery_v: Option<f32>,
    late: bool,
    samples: u32,
    decided_us: Option<u64>,
    decision: Option<autopilot::Command>,
    command: Command,
}

impl Flight {
    /// Just switched on, with these parameters.
    ///
    /// # Errors
    /// Names the first value that cannot fly.
    pub fn try_new(parameters: &Parameters) -> Result<Self, Unflyable> {
        let config = Config::tolerant(Airframe::paper(THRUST_TO_WEIGHT));
        let autopilot = Autopilot::try_new(&config, parameters)
            .map_err(|e| Unflyable { name: [e.part, e.field], value: e.value })?;
        let gyro = GyroConfig { sample_hz: icm42688::SAMPLE_HZ, ..EstimatorConfig::FLIGHT.gyro };
        let estimator = Estimator::try_new(&EstimatorConfig { gyro, ..EstimatorConfig::FLIGHT })
            .map_err(|e| Unflyable { name: ["estimator", e.field], value: e.value })?;
        Ok(Self {
            estimator_state: estimator.state(),
            estimator,
            autopilot_state: autopilot.state(),
            autopilot,
            pilot: None,
            battery_v: None,
            late: false,
            samples: 0,
            decided_us: None,
            decision: None,
            command: Command::Stop,
        })
    }

    /// Decides what the motors do; to be called once an inertial sample, or when one is missed.
    ///
    /// - `now_us`: µs since boot.
    pub fn step(&mut self, now_us: u64, arrived: &Arrived) -> Command {
        let estimate = *self.estimator.step(&mut self.estimator_state, &arrived.measurements, now_us);
        self.pilot = arrived.pilot.or(self.pilot);
        self.battery_v = arrived.measurements.battery_v.map(|battery| battery.value).or(self.battery_v);
        self.late |= arrived.late;
        if self.samples == 0 {
            self.decide(now_us, &estimate, arrived.self_test_passed);
        }
        self.samples = (self.samples + 1) % SAMPLES_A_STEP;
        self.command
    }

    fn decide(&mut self, now_us: u64, estimate: &Estimate, self_test_passed: bool) {
        let elapsed_us = now_us.saturating_sub(self.decided_us.unwrap_or(now_us));
        self.decided_us = Some(now_us);
        let phase = self.estimator.telemetry(&self.estimator_state, now_us).phase;
        let system = System {
            battery_v: self.battery_v,
            gyro_calibrated: phase != Phase::Aligning,
            self_test_passed,
            parameters_valid: true,
            late: core::mem::take(&mut self.late),
        };
        let step = autopilot::Step {
            now_us,
            dt_s: elapsed_us as f32 * 1e-6,
            estimate,
            pilot: self.pilot.as_ref(),
            offboard: None,
            system: &system,
        };
        let decision = self.autopilot.step(&mut self.autopilot_state, &step);
        let stands = !decision.armed && decision.motors == [0.0; 4];
        self.command = if stands { Command::Stop } else { Command::Run(decision.motors.map(speed)) };
        self.decision = Some(decision);
    }

    /// The autopilot's last decision, once it has made one.
    pub fn decision(&self) -> Option<&autopilot::Command> {
        self.decision.as_ref()
    }
}

/// Share of the fastest speed that makes a share of the largest thrust.
fn speed(thrust: f32) -> f32 {
    Scalar::sqrt(thrust.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use control_core::frames::Vec3;
    use control_core::measurement::Imu;
    use control_core::modes::Mode;
    use control_core::pilot::Sticks;

    const PERIOD_US: u64 = 500;

    /// A machine at rest on the ground whose arm switch goes on after `armed_s`; returns the last command.
    fn rest(seconds: f32, armed_s: f32, self_test_passed: bool) -> (Command, Flight) {
        let mut flight = Flight::try_new(&Parameters::default()).unwrap();
        let mut command = Command::Stop;
        for n in 0..(seconds * icm42688::SAMPLE_HZ) as u64 {
            let now_us = PERIOD_US * (n + 1);
            // A part that always says the same is taken for one that is stuck.
            let noise = (n % 7) as f32 * 1e-3;
            let rate_rad_s = Vec3::new(noise, -noise, noise);
            let value = Imu { rate_rad_s, specific_force_m_s2: Vec3::new(noise, noise, -9.81 - noise) };
            let sticks = Sticks { throttle: 0.0, ..Sticks::NEUTRAL };
            let arm = now_us as f32 > 1e6 * armed_s;
            let pilot = PilotInput { sticks, arm, mode: Mode::Angle };
            command = flight.step(
                now_us,
                &Arrived {
                    measurements: Measurements {
                        imu: Some(Stamped { time_us: now_us, value }),
                        ..Measurements::default()
                    },
                    pilot: Some(Stamped { time_us: now_us, value: pilot }),
                    late: false,
                    self_test_passed,
                },
            );
        }
        (command, flight)
    }

    #[test]
    fn a_machine_at_rest_arms_when_the_switch_goes_on_and_idles() {
        let (command, flight) = rest(5.0, 4.5, true);
        let Command::Run(shares) = command else { panic!("{:?}", flight.decision()) };
        assert!(shares.iter().all(|&share| (0.05..0.6).contains(&share)), "{shares:?}");
    }

    #[test]
    fn no_motor_turns_before_the_switch_nor_with_a_part_that_is_not_there() {
        for (why, armed_s, self_test_passed) in [("not armed", 9.0, true), ("a part is gone", 4.5, false)] {
            assert_eq!(rest(5.0, armed_s, self_test_passed).0, Command::Stop, "{why}");
        }
        let (command, flight) = rest(2.0, 1.0, true);
        assert_eq!(command, Command::Stop, "the gyro's bias is not known yet: {:?}", flight.decision());
    }
}
