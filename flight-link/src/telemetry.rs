//! Telemetry: what the machine says of itself while it is switched on.
//!
//! Modes, failsafes and checks are said by their place in the core's lists, where their texts are too: a number is a
//! byte, and whoever shows it has the core at hand.
use serde::{Deserialize, Serialize};

/// How it is; ten times a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Time since boot, µs.
    pub time_us: u64,
    /// Whether the rotors are let turn.
    pub armed: bool,
    /// Whether it stands on its feet.
    pub landed: bool,
    /// Place in the core's list of the mode aimed at.
    pub aim: u8,
    /// The same of the mode flown.
    pub mode: u8,
    /// The failsafes in force, one bit each, the worst first.
    pub failsafes: u32,
    /// The checks for which arming would be refused, one bit each; none are made while armed.
    pub failing: u32,
    /// What the last wiring check has found.
    pub wiring: Wiring,
    /// Whether a test on the bench runs.
    pub bench: bool,
    /// Voltage of the battery, V; NaN if nobody has measured it lately.
    pub battery_v: f32,
    /// Current out of it, A; NaN if nobody has measured it lately.
    pub battery_a: f32,
    /// Charge taken from it since the board's start, or that of a flight which went on after a reset, A s.
    pub used_as: f32,
    /// Steps of the control loop since boot.
    pub steps: u32,
    /// Of these, how many ended when the next one was already due.
    pub late: u32,
    /// Share of the time since the last status that steps took, from data ready to their ends.
    pub load: f32,
    /// The longest of them, µs.
    pub step_us_max: u32,
    /// Records that this line had no room for since boot.
    pub dropped: u32,
}

/// What a wiring check has found, of rotors 1 to 4.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wiring {
    /// None has ended yet.
    Unknown,
    /// Every rotor answers to its own command.
    Right,
    /// The machine tilts as if another rotor pulled.
    AnswersAs {
        /// The rotor that was told to pull.
        told: u8,
        /// The rotor that seems to.
        answers: u8,
    },
    /// The rotor pushes down.
    Reversed(u8),
    /// The machine does not tilt under the rotor.
    Silent(u8),
    /// The machine tips under the rotor.
    Tipping(u8),
    /// The gyro fails during the rotor's turn.
    BadSample(u8),
}

/// How it moves; ten times a second. Body is forward, right, down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// When this was so, since boot, µs.
    pub time_us: u64,
    /// Roll, pitch, and heading from the north, rad.
    pub attitude_rad: [f32; 3],
    /// Body rates, rad/s.
    pub rate_rad_s: [f32; 3],
    /// Position north, east, down, m.
    pub position_m: [f32; 3],
    /// Velocity north, east, down, m/s.
    pub velocity_m_s: [f32; 3],
    /// What of this may be flown on, one bit each: rates, tilt, heading, altitude, velocity, position.
    pub health: u8,
}

/// What its rotors do; ten times a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rotors {
    /// When this was so, since boot, µs.
    pub time_us: u64,
    /// What each is told, share of its fastest speed; 0 if it stands.
    pub speeds: [f32; 4],
    /// Share of its thrust that each is believed to make: below 1 it is weak, at 0 lost.
    pub believed: [f32; 4],
}
