//! A sortie: from the ground and back with the whole flight logic, as the board runs it.
//!
//! ```text
//! truth ─► sensors ─► estimator ─► autopilot ─► motors ─► plant
//!                                   ▲
//!                        pilot, link, companion, board: [[event]]
//! ```
//!
//! Where the scenario flies no sensors the autopilot is given the truth with `[noise]`, and all of it is healthy.
use crate::aboard::Aboard;
use crate::flight::{Cause, Crash, Ending, Flight, Sample, Stream, Touchdown, UPRIGHT_RAD_MAX, random};
use crate::machine::{Machine, Moment};
use crate::plant::Truth;
use crate::scenario::{AutopilotKeys, Event};
use crate::sensors::Sensors;
use control_core::autopilot::{AutopilotState, BenchOrder, Command};
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::flight::{Arrived, Helm};
use control_core::frames::Vec3;
use control_core::measurement::{Measurements, Stamped};
use control_core::pilot::PilotInput;
use control_core::{Config, ConfigError, Input, Output, Setpoint};
use std::f64::consts::TAU;

/// How often a hand rocks the machine, Hz, and how hard, as a share of what tips it over.
const HAND_HZ: f64 = 3.0;
const HAND_SHARE: f64 = 0.6;

/// What is outside the autopilot.
pub(crate) struct Outside<'a> {
    events: &'a [Event],
    now: Event,
}

impl<'a> Outside<'a> {
    pub(crate) fn new(events: &'a [Event]) -> Self {
        Self { events, now: Event::default() }
    }

    /// Lets happen what happens by `t_s`; what it asks of the bench.
    pub(crate) fn step(&mut self, t_s: f64) -> Option<BenchOrder> {
        let mut check_wiring = false;
        while let Some((event, later)) = self.events.split_first().filter(|(event, _)| event.at_s <= t_s + 1e-9) {
            self.now.take(event);
            check_wiring |= event.check_wiring == Some(true);
            self.events = later;
        }
        check_wiring.then_some(BenchOrder::Wiring)
    }

    /// Whether each control step comes late.
    pub(crate) fn is_late(&self) -> bool {
        self.now.late == Some(true)
    }

    /// What the pilot says, if he is heard.
    pub(crate) fn pilot(&self) -> Option<PilotInput> {
        (self.now.link != Some(false)).then(|| self.now.pilot())
    }

    /// What arrives with the sensors' `measurements`.
    ///
    /// - `setpoint`: what a companion computer would send.
    /// - `bench`: what is asked of the bench.
    fn arrived(
        &self,
        now_us: u64,
        setpoint: Setpoint,
        measurements: &Measurements,
        bench: Option<BenchOrder>,
    ) -> Arrived {
        let now = &self.now;
        Arrived {
            measurements: *measurements,
            pilot: self.pilot().map(|value| Stamped { time_us: now_us, value }),
            offboard: (now.offboard == Some(true)).then_some(Stamped { time_us: now_us, value: setpoint }),
            bench,
            late: self.is_late(),
            self_test_passed: now.self_test_passed != Some(false),
            parameters_valid: now.parameters_valid != Some(false),
        }
    }

    /// Torque of the hand that rocks the machine, N m.
    ///
    /// - `weight_torque_nm`: the weight on its arm, which tips it over.
    pub(crate) fn hand_nm(&self, t_s: f64, weight_torque_nm: f64) -> f64 {
        let rocked = self.now.rocked == Some(true);
        if rocked { HAND_SHARE * weight_torque_nm * libm::sin(TAU * HAND_HZ * t_s) } else { 0.0 }
    }
}

/// What the autopilot believes when it is shown the truth.
fn shown(input: &Input, time_us: u64) -> Estimate {
    let Input { position_m, velocity_m_s, attitude, rate_rad_s, specific_force_m_s2, .. } = *input;
    Estimate {
        time_us,
        position_m,
        velocity_m_s,
        attitude,
        rate_rad_s,
        specific_force_m_s2,
        gyro_bias_rad_s: Vec3::zero(),
        accelerometer_bias_m_s2: Vec3::zero(),
        sigma: Sigma::default(),
        health: Health { rates: true, tilt: true, heading: true, altitude: true, velocity: true, position: true },
    }
}

impl Flight<'_> {
    /// Flies the autopilot through the events.
    pub(crate) fn fly_sortie(
        &self,
        keys: &AutopilotKeys,
        config: &Config,
        observe: &mut dyn FnMut(&Sample),
    ) -> Result<Option<Ending>, ConfigError> {
        let scenario = self.scenario;
        // The scenario's check has set them before.
        let mut helm = Helm::try_new(config, &keys.values().unwrap_or_default())?;
        let mut machine = Machine::standing(self);
        let mut sensors = Sensors::new(scenario.noise, random(self.seed, Stream::Noise));
        let mut aboard = machine.aboard();
        let mut outside = Outside::new(&scenario.event);
        let weight_torque_nm = machine.vehicle.weight_torque_nm();
        let nothing = Measurements::default();
        for tick in 0..machine.ticks() {
            let moment = machine.look(tick);
            let &Moment { t_s, ref truth, ref effectiveness, .. } = &moment;
            let target = scenario.reference.target(t_s);
            let mut input = sensors.sample(truth, machine.vibration(), &target, machine.dt_s);
            let mut now_us = libm::round(t_s * 1e6) as u64;
            let mut estimate = shown(&input, now_us);
            if let Some(aboard) = &mut aboard {
                aboard.sample(&machine.world(&moment));
                if aboard.is_flown() {
                    (now_us, estimate) = (aboard.clock_us(t_s), *aboard.estimate());
                }
            }
            let told = machine.told();
            helm.report(told.reported);
            helm.act(now_us, &estimate);
            if let Some(aboard) = &mut aboard {
                aboard.settle(t_s);
                if aboard.is_flown() {
                    (estimate, input) = (*aboard.estimate(), aboard.input(target.setpoint()));
                }
            }
            let measurements = aboard.as_ref().map_or(&nothing, Aboard::measurements);
            let bench = outside.step(t_s);
            let arrived = outside.arrived(now_us, target.setpoint(), measurements, bench);
            helm.decide(now_us, &estimate, outside.now.gyro_calibrated != Some(false), &arrived);
            // Each step decides.
            let Some(command) = helm.decision() else { continue };
            let command_n = command.motors.map(|motor| f64::from(motor) * machine.vehicle.thrust_n_max());
            let torque = machine.vehicle.torque_n_m(&command_n);
            observe(&Sample {
                commanded: &[command_n.iter().sum(), torque.x, torque.y, torque.z],
                tick,
                t_s,
                target: &target,
                truth,
                input: &input,
                measurements,
                clock_s: now_us as f64 * 1e-6,
                estimate: Some(&estimate),
                aboard: aboard.as_ref(),
                estimator: aboard.as_ref().map(|aboard| aboard.telemetry(t_s)).as_ref(),
                decision: Some(&Decision { command, state: helm.state() }),
                output: &Output { thrust_n: command_n.map(|n| n as f32), rejected: command.rejected },
                telemetry: &helm.controller().telemetry(&helm.state().controller),
                effectiveness,
                told: &told,
            });
            let ending = self.broken(t_s, truth);
            if ending.is_some() {
                return Ok(ending);
            }
            if let Some(aboard) = &mut aboard {
                aboard.hear(&command_n);
            }
            machine.act(command_n, outside.hand_nm(t_s, weight_torque_nm));
        }
        Ok(None)
    }

    /// The end of the flight, if the machine is broken. How far it is from a setpoint says nothing here, and a pilot may fly
    /// upside down.
    pub(crate) fn broken(&self, t_s: f64, truth: &Truth) -> Option<Ending> {
        let touchdown = Touchdown { speed_m_s: truth.impact_m_s, tilt_rad: truth.tilt_rad() };
        let fast = touchdown.speed_m_s > self.scenario.airframe.impact_m_s_max();
        let cause = if !(truth.position_m.norm() + truth.velocity_m_s.norm() + truth.rate_rad_s.norm()).is_finite() {
            Cause::NotFinite
        } else if fast || (truth.touching && touchdown.tilt_rad > UPRIGHT_RAD_MAX) {
            Cause::Ground(touchdown)
        } else {
            return None;
        };
        Some(Ending::Crashed(Crash { t_s, cause }))
    }
}

/// What the autopilot decided in a tick.
#[derive(Clone, Copy)]
pub struct Decision<'a> {
    /// The command.
    pub command: &'a Command,
    /// The state it left.
    pub state: &'a AutopilotState,
}
