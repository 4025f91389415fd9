//! On the bench: what the motors do while disarmed.
use super::{Autopilot, AutopilotState, unit};
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

impl Autopilot {
    /// Begins a motor test; whether it does, which it does only while disarmed.
    pub fn begin_motor_test(&self, state: &mut AutopilotState, order: &MotorTestOrder) -> bool {
        let disarmed = state.arming == Arming::Disarmed;
        if disarmed {
            state.bench = Bench::Motors(MotorTest::new(order));
        }
        disarmed
    }

    /// Begins the wiring check; whether it does, which it does only while disarmed.
    pub fn begin_wiring_check(&self, state: &mut AutopilotState) -> bool {
        let disarmed = state.arming == Arming::Disarmed;
        if disarmed {
            state.bench = Bench::Wiring(WiringCheck::new(&self.airframe));
            state.wiring = None;
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
