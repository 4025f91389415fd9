//! What each figure shows.
use crate::log::Log;

/// One diagram over time.
pub struct Panel {
    pub(super) title: &'static str,
    pub(super) unit: &'static str,
    /// Whether only the time around the faults is shown.
    pub(super) close_up: bool,
    /// Column of the reference, drawn dashed.
    pub(super) reference: Option<&'static str>,
    pub(super) of: fn(&Log) -> Vec<f64>,
}

/// Several diagrams in one picture.
pub struct Figure {
    /// File name without ending.
    pub name: &'static str,
    /// What it shows.
    pub title: &'static str,
    /// The diagrams, row by row.
    pub panels: &'static [Panel],
    /// How many stand in a row.
    pub columns: usize,
}

impl Figure {
    /// Whether a flight has anything of it: a flight that is shown the truth estimates nothing.
    pub fn is_of(&self, log: &Log) -> bool {
        self.panels.iter().any(|panel| !(panel.of)(log).is_empty())
    }
}

/// A column as it is.
macro_rules! column {
    ($title:literal, $unit:literal, $column:literal) => {
        Panel { title: $title, unit: $unit, close_up: false, reference: None, of: |log| log.column($column) }
    };
    ($title:literal, $unit:literal, $column:literal, $reference:literal) => {
        Panel {
            title: $title,
            unit: $unit,
            close_up: false,
            reference: Some($reference),
            of: |log| log.column($column),
        }
    };
}

/// Around the faults only.
macro_rules! close_up {
    ($title:literal, $unit:literal, $of:expr) => {
        Panel { title: $title, unit: $unit, close_up: true, reference: None, of: $of }
    };
}

fn difference(log: &Log, a: &str, b: &str) -> Vec<f64> {
    log.column(a).into_iter().zip(log.column(b)).map(|(a, b)| a - b).collect()
}

fn worse_lateral(log: &Log) -> Vec<f64> {
    let north = difference(log, "north_m", "setpoint_north_m");
    let east = difference(log, "east_m", "setpoint_east_m");
    let pairs = north.into_iter().zip(east);
    pairs.map(|(north, east)| if north.abs() > east.abs() { north } else { east }).collect()
}

fn learnt(log: &Log) -> Vec<f64> {
    let gain = log.column("ki_z");
    let start = gain.first().copied().unwrap_or(1.0);
    gain.into_iter().map(|k| k / start).collect()
}

const OVERVIEW: [Panel; 6] = [
    column!("Altitude", "m", "altitude_m", "setpoint_altitude_m"),
    close_up!("Altitude error around the fault", "m", |log| difference(log, "altitude_m", "setpoint_altitude_m")),
    close_up!("Worse of north and east error around the fault", "m", worse_lateral),
    close_up!("Heading error around the fault", "rad", |log| log.column("yaw_error_rad")),
    column!("Commanded thrust, sum of rotors", "N", "u1_n"),
    Panel { title: "Integral gain of altitude over its start", unit: "", close_up: false, reference: None, of: learnt },
];

const TRAJECTORIES: [Panel; 4] = [
    column!("x, north", "m", "north_m", "setpoint_north_m"),
    column!("y, east", "m", "east_m", "setpoint_east_m"),
    column!("z, altitude", "m", "altitude_m", "setpoint_altitude_m"),
    column!("Heading", "rad", "yaw_rad", "setpoint_yaw_rad"),
];

const COMMANDS: [Panel; 4] = [
    column!("u1, thrust", "N", "u1_n"),
    column!("u2, roll", "N m", "u2_nm"),
    column!("u3, pitch", "N m", "u3_nm"),
    column!("u4, yaw", "N m", "u4_nm"),
];

const GAINS: [Panel; 12] = [
    column!("k_p of x", "1/s²", "kp_x"),
    column!("k_i of x", "1/s³", "ki_x"),
    column!("k_d of x", "1/s", "kd_x"),
    column!("k_p of y", "1/s²", "kp_y"),
    column!("k_i of y", "1/s³", "ki_y"),
    column!("k_d of y", "1/s", "kd_y"),
    column!("k_p of z", "N/m", "kp_z"),
    column!("k_i of z", "N/(m s)", "ki_z"),
    column!("k_d of z", "N s/m", "kd_z"),
    column!("k_p of heading", "N m/rad", "kp_psi"),
    column!("k_i of heading", "N m/(rad s)", "ki_psi"),
    column!("k_d of heading", "N m s/rad", "kd_psi"),
];

const THRUSTS: [Panel; 4] = [
    column!("Thrust of rotor 1", "N", "thrust_1_n"),
    column!("Thrust of rotor 2", "N", "thrust_2_n"),
    column!("Thrust of rotor 3", "N", "thrust_3_n"),
    column!("Thrust of rotor 4", "N", "thrust_4_n"),
];

const ESTIMATE: [Panel; 6] = [
    column!("Tilt; dashed: 1 σ of an axis", "rad", "estimate_tilt_error_rad", "estimate_tilt_sigma_rad"),
    column!("Heading; dashed: 1 σ", "rad", "estimate_heading_error_rad", "estimate_heading_sigma_rad"),
    column!(
        "Horizontal velocity; dashed: 1 σ of an axis",
        "m/s",
        "estimate_horizontal_error_m_s",
        "estimate_horizontal_sigma_m_s"
    ),
    column!("Climb rate; dashed: 1 σ", "m/s", "estimate_vertical_error_m_s", "estimate_vertical_sigma_m_s"),
    column!(
        "Horizontal position; dashed: 1 σ of an axis",
        "m",
        "estimate_horizontal_error_m",
        "estimate_horizontal_sigma_m"
    ),
    column!("Altitude; dashed: 1 σ", "m", "estimate_altitude_error_m", "estimate_altitude_sigma_m"),
];

const LYAPUNOV: [Panel; 8] = [
    close_up!("V of x around the fault", "m²/s²", |log| log.column("v_x")),
    close_up!("Slope of V of x", "m²/s³", |log| log.column("v_rate_x")),
    close_up!("V of y around the fault", "m²/s²", |log| log.column("v_y")),
    close_up!("Slope of V of y", "m²/s³", |log| log.column("v_rate_y")),
    close_up!("V of z around the fault", "m²/s²", |log| log.column("v_z")),
    close_up!("Slope of V of z", "m²/s³", |log| log.column("v_rate_z")),
    close_up!("V of heading around the fault", "rad²/s²", |log| log.column("v_psi")),
    close_up!("Slope of V of heading", "rad²/s³", |log| log.column("v_rate_psi")),
];

/// Every figure of a report, in order.
pub const FIGURES: [Figure; 7] = [
    Figure { name: "overview", title: "Overview", panels: &OVERVIEW, columns: 2 },
    Figure {
        name: "trajectories",
        title: "Positions and heading against the reference, dashed (the paper's Fig. 3)",
        panels: &TRAJECTORIES,
        columns: 2,
    },
    Figure { name: "commands", title: "Commands u1 to u4 (the paper's Fig. 4)", panels: &COMMANDS, columns: 2 },
    Figure { name: "gains", title: "Gains (the paper's Fig. 5)", panels: &GAINS, columns: 3 },
    Figure { name: "thrusts", title: "Thrust each rotor really makes", panels: &THRUSTS, columns: 2 },
    Figure {
        name: "lyapunov",
        title: "Lyapunov function V = s²/2 and its slope V̇ = s ṡ; scaled to those who survived",
        panels: &LYAPUNOV,
        columns: 2,
    },
    Figure {
        name: "estimate",
        title: "The estimate against the truth: how wrong it is, and how wrong it says it is",
        panels: &ESTIMATE,
        columns: 2,
    },
];
