//! Software in the loop: plants, sensors, faults, scenarios and comparisons around the flight core.
//!
//! This crate stands in for the airframe and the weather. It holds no control logic: every flight calls
//! [`control_core::Controller::tick`], as the board does. Here alone random numbers are drawn.
pub mod aboard;
pub mod actuators;
pub mod chronicle;
pub mod cli;
pub mod controllers;
pub mod detection;
pub mod emulator;
pub mod fault;
pub mod figures;
pub mod flight;
pub mod ground;
pub mod limits;
pub mod log;
mod machine;
pub mod metrics;
pub mod output;
pub mod plant;
pub mod preflight;
pub mod reference;
pub mod replay;
pub mod report;
pub mod scenario;
pub mod sensors;
pub mod sortie;
pub mod station;
pub mod through;
pub mod vehicle;
pub mod wind;
