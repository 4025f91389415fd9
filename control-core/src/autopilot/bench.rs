//! On the bench: what the motors do while disarmed, and who may ask for it.
use super::{Autopilot, AutopilotState, Plan, unit};
use crate::WiringCheck;
use crate::arming::Arming;
use crate::estimate::Estimate;
use crate::motor_test::{MotorTest, MotorTestOrder};

/// What has the motors.
#[derive(Clone, Copy, Debug)]
pub(super) enum Bench {
    Nothing,
    Motors(MotorTest),
    Wiring(WiringCheck),
}

/// What is asked of the bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BenchOrder {
    /// That rotors turn one after the other, or one of them.
    Motors(MotorTestOrder),
    /// That the wiring is checked.
    Wiring,
    /// That whatever runs ends now.
    Stop,
}

/// What runs on the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BenchTest {
    /// Rotors, one after the other.
    Motors,
    /// The check of the wiring.
    Wiring,
}

impl Autopilot {
    /// Does what is asked of the bench, in place of what ran there; whether it does, which it does only while disarmed.
    pub fn order(&self, state: &mut AutopilotState, order: &BenchOrder) -> bool {
        let disarmed = state.arming == Arming::Disarmed;
        if disarmed {
            state.plan = Plan::Turn([0.0; 4]);
            state.bench = match order {
                BenchOrder::Motors(order) => Bench::Motors(MotorTest::new(order)),
                BenchOrder::Wiring => Bench::Wiring(WiringCheck::new(&self.airframe)),
                BenchOrder::Stop => Bench::Nothing,
            };
            if *order == BenchOrder::Wiring {
                state.wiring = None;
            }
        }
        disarmed
    }

    /// What the motors do while disarmed: nothing, or what a test asks for.
    pub(super) fn run_bench(&self, state: &mut AutopilotState, estimate: &Estimate, dt_s: f32) -> [f32; 4] {
        let rate = estimate.rate_rad_s;
        match &mut state.bench {
            Bench::Nothing => [0.0; 4],
            Bench::Motors(test) => {
                let motors = test.tick(rate, dt_s);
                if test.is_done() {
                    state.bench = Bench::Nothing;
                }
                motors.map(unit)
            }
            Bench::Wiring(check) => {
                let thrust_n = check.tick(rate, dt_s);
                if let Some(verdict) = check.verdict() {
                    state.wiring = Some(verdict);
                    state.bench = Bench::Nothing;
                    return [0.0; 4];
                }
                self.shares(&thrust_n)
            }
        }
    }
}
