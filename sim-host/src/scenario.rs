//! A scenario: one flight, as data.
//!
//! Unknown keys are errors, and so is any value outside its range: [`Scenario::load`] names file, key, value and what
//! is allowed. `sim-host schema` prints the JSON Schema made from these types.
use crate::controllers::{ControllerKeys, ControllerName};
use crate::fault::Fault;
use crate::fault::sensors::SensorFault;
use crate::plant::PlantKind;
use crate::reference::Reference;
use crate::sensors::{Noise, SensorKeys};
use crate::vehicle::{AirframeName, Vehicle, VehicleKeys};
use crate::wind::Wind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

mod check;
mod event;
mod faults;
mod image;
mod load;
mod sensors;

pub use check::THRUST_TO_WEIGHT;
pub use event::{AutopilotKeys, Event, ModeName};
pub use load::ScenarioError;

/// One flight, as data. Times in seconds from the start; the flight starts hovering above the origin.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// What the flight shows, in one line.
    #[serde(default)]
    pub title: String,
    /// Equations of motion.
    pub plant: PlantKind,
    /// The machine.
    pub airframe: AirframeName,
    /// Length of the flight, s.
    pub duration_s: f64,
    /// Control rate, Hz: 1000 with the plant `paper`, else 500.
    #[serde(default)]
    pub control_hz: Option<f64>,
    /// Runge-Kutta steps in one control period.
    #[serde(default = "plant_steps")]
    pub plant_steps: u32,
    /// Seed of the flight's random numbers, unless the command line gives one.
    #[serde(default = "seed")]
    pub seed: u64,
    /// Altitude of the ground, m; flights start hovering above it. Left out, there is none.
    #[serde(default)]
    pub ground_altitude_m: Option<f64>,
    /// Whether the wiring is checked on the ground before the flight, which is refused if it is wrong.
    #[serde(default)]
    pub preflight: bool,
    /// How late the controller `oracle` learns what the rotors answer, s: what a detection that takes so long would cost.
    #[serde(default)]
    pub oracle_delay_s: f64,
    /// What differs from the named airframe, and the motors.
    #[serde(default)]
    pub vehicle: VehicleKeys,
    /// The setpoint over time: exactly one of the tables `hover`, `step`, `helix`, `weave` and `waypoints`.
    pub reference: Reference,
    /// Sensor noise.
    #[serde(default)]
    pub noise: Noise,
    /// The parts that measure; left out, the controller is shown the truth with noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensors: Option<SensorKeys>,
    /// Wind.
    #[serde(default)]
    pub wind: Wind,
    /// Faults.
    #[serde(default)]
    pub fault: Vec<Fault>,
    /// Faults of the sensors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensor_fault: Vec<SensorFault>,
    /// The whole flight logic, from the ground: only with this do events mean anything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub autopilot: Option<AutopilotKeys>,
    /// What happens to the flight logic from outside, in order of time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub event: Vec<Event>,
    /// What differs from a controller's own gains, by the name that `compare` knows it by.
    #[serde(default)]
    pub controllers: BTreeMap<ControllerName, ControllerKeys>,
    /// The file as it was read, for reports: it may have changed since.
    #[serde(skip)]
    pub text: String,
}

fn plant_steps() -> u32 {
    2
}

fn seed() -> u64 {
    1
}

impl Scenario {
    /// Control rate, Hz.
    pub fn control_hz(&self) -> f64 {
        self.control_hz.unwrap_or(match self.plant {
            PlantKind::Paper => 1000.0,
            PlantKind::Rigid => 500.0,
        })
    }

    /// The machine.
    pub fn vehicle(&self) -> Vehicle {
        Vehicle::new(self.airframe, &self.vehicle)
    }

    /// Spans of time with at least one fault, merged and ascending, s.
    pub fn fault_windows_s(&self) -> Vec<(f64, f64)> {
        let mut spans: Vec<_> =
            self.fault.iter().map(|fault| (fault.from_s, fault.until_s.min(self.duration_s))).collect();
        spans.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut windows: Vec<(f64, f64)> = Vec::new();
        for (from, until) in spans {
            match windows.last_mut() {
                Some(last) if from <= last.1 => last.1 = last.1.max(until),
                _ => windows.push((from, until)),
            }
        }
        windows
    }
}
