//! Flight control without hardware: laws, allocation and one tick, shared to the bit by board and host.
//!
//! [`Controller::tick`] is the whole interface: sensors, setpoint and elapsed time in; rotor thrusts and
//! telemetry out. A [`Controller`] is immutable after [`Controller::try_new`]; everything that changes in
//! flight is in [`State`]. The code is written once over [`Scalar`], and flies in `f32` (the board), `f64`
//! (the reference) and, with feature `fixed`, Q16.16.
//!
//! ```
//! use control_core::{Airframe, Config, Controller, Input, Law, State};
//!
//! let airframe = Airframe::paper(2.2);
//! let controller = Controller::<f32>::try_new(&Config::flight(Law::Lgs, airframe))?;
//! let mut state = controller.hover_state();
//! let output = controller.tick(&mut state, &Input::hovering());
//! let weight_n = airframe.mass_kg * control_core::GRAVITY_M_S2;
//! let thrust_n: f32 = output.thrust_n.iter().sum();
//! assert!((thrust_n - weight_n).abs() < 1e-4 * weight_n);
//! # Ok::<(), control_core::ConfigError>(())
//! ```
//!
//! Nothing here knows a clock, an allocator, a logger or an executor, and nothing panics in flight.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(any(test, feature = "schema"))]
extern crate std;

mod airframe;
mod allocation;
pub mod arming;
mod attitude;
pub mod autopilot;
pub mod battery;
pub mod compass;
mod config;
mod controller;
pub mod estimate;
pub mod estimation;
pub mod failsafe;
pub mod fault;
mod filter;
pub mod flight;
pub mod frames;
pub mod geodesy;
mod guidance;
pub mod law;
pub mod math;
pub mod measurement;
pub mod modes;
pub mod motor_test;
pub mod parameters;
pub mod pilot;
pub mod restart;
mod rotors;
mod scalar;
pub mod set;
mod signals;
mod spin;
pub mod wiring;
mod yaw_guard;

pub use airframe::{Airframe, Rotor};
pub use allocation::{Allocation, Allocator, Demand};
pub use attitude::AttitudeGains;
pub use config::{AxisConfig, Cascade, Config, ConfigError, Gains};
pub use controller::{Controller, Lift, State, Target};
pub use law::{AxisTelemetry, Law};
pub use rotors::{Alarm, DetectorConfig, HYPOTHESES, Knowledge, RotorsConfig, RotorsTelemetry};
#[cfg(feature = "fixed")]
pub use scalar::fixed::Q16;
pub use scalar::{Mask, Scalar};
pub use signals::{Axis, Input, Output, Setpoint, Telemetry};
pub use spin::{Regulators, SpinConfig};
pub use wiring::{WiringCheck, WiringFault};

/// Gravitational acceleration, m/s² (the paper's Table 1).
pub const GRAVITY_M_S2: f32 = 9.81;
