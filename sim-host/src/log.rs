//! The log of a flight: a table of named columns, one row for each logged tick, SI units.
//!
//! CSV opens in PlotJuggler, pandas and any spreadsheet; numbers are the shortest decimals that give the f64 back,
//! so equal flights have equal bytes.
use crate::aboard::{Aboard, Apart};
use crate::controllers::ControllerName;
use crate::flight::Sample;
use control_core::estimate::{Estimate, Health};
use control_core::{Airframe, Alarm, Input};
use std::io::Write;

type Column = (&'static str, fn(&Sample) -> f64);

/// An axis of the telemetry, its gains, s, V, V̇ and the number of gains on a bound.
macro_rules! axis_columns {
    ($i:literal: $kp:literal, $ki:literal, $kd:literal, $s:literal, $v:literal, $rate:literal, $bound:literal) => {
        [
            ($kp, |x: &Sample| x.telemetry.axes[$i].gains[0].into()),
            ($ki, |x: &Sample| x.telemetry.axes[$i].gains[1].into()),
            ($kd, |x: &Sample| x.telemetry.axes[$i].gains[2].into()),
            ($s, |x: &Sample| x.telemetry.axes[$i].s.into()),
            ($v, |x: &Sample| x.telemetry.axes[$i].v().into()),
            ($rate, |x: &Sample| x.telemetry.axes[$i].v_rate().into()),
            ($bound, |x: &Sample| x.telemetry.axes[$i].at_bound().iter().filter(|&&hit| hit).count() as f64),
        ] as [Column; 7]
    };
}

const MOTION: [Column; 18] = [
    ("t_s", |x| x.t_s),
    ("setpoint_north_m", |x| x.target.position_m[0]),
    ("setpoint_east_m", |x| x.target.position_m[1]),
    ("setpoint_altitude_m", |x| x.target.position_m[2]),
    ("setpoint_yaw_rad", |x| x.target.yaw_rad),
    ("north_m", |x| x.truth.position_m.x),
    ("east_m", |x| x.truth.position_m.y),
    ("altitude_m", |x| x.truth.altitude_m()),
    ("velocity_north_m_s", |x| x.truth.velocity_m_s.x),
    ("velocity_east_m_s", |x| x.truth.velocity_m_s.y),
    ("velocity_up_m_s", |x| -x.truth.velocity_m_s.z),
    ("roll_rad", |x| x.truth.angles_rad()[0]),
    ("pitch_rad", |x| x.truth.angles_rad()[1]),
    ("yaw_rad", |x| x.truth.angles_rad()[2]),
    ("rate_x_rad_s", |x| x.truth.rate_rad_s.x),
    ("rate_y_rad_s", |x| x.truth.rate_rad_s.y),
    ("rate_z_rad_s", |x| x.truth.rate_rad_s.z),
    ("yaw_error_rad", |x| x.yaw_error_rad()),
];

const ROTORS: [Column; 16] = [
    ("u1_n", |x| x.commanded[0]),
    ("u2_nm", |x| x.commanded[1]),
    ("u3_nm", |x| x.commanded[2]),
    ("u4_nm", |x| x.commanded[3]),
    ("command_1_n", |x| x.output.thrust_n[0].into()),
    ("command_2_n", |x| x.output.thrust_n[1].into()),
    ("command_3_n", |x| x.output.thrust_n[2].into()),
    ("command_4_n", |x| x.output.thrust_n[3].into()),
    ("thrust_1_n", |x| x.truth.thrust_n[0]),
    ("thrust_2_n", |x| x.truth.thrust_n[1]),
    ("thrust_3_n", |x| x.truth.thrust_n[2]),
    ("thrust_4_n", |x| x.truth.thrust_n[3]),
    ("effectiveness_1", |x| x.effectiveness[0]),
    ("effectiveness_2", |x| x.effectiveness[1]),
    ("effectiveness_3", |x| x.effectiveness[2]),
    ("effectiveness_4", |x| x.effectiveness[3]),
];

const X: [Column; 7] = axis_columns!(0: "kp_x", "ki_x", "kd_x", "s_x", "v_x", "v_rate_x", "gains_at_bound_x");
const Y: [Column; 7] = axis_columns!(1: "kp_y", "ki_y", "kd_y", "s_y", "v_y", "v_rate_y", "gains_at_bound_y");
const Z: [Column; 7] = axis_columns!(2: "kp_z", "ki_z", "kd_z", "s_z", "v_z", "v_rate_z", "gains_at_bound_z");
const PSI: [Column; 7] =
    axis_columns!(3: "kp_psi", "ki_psi", "kd_psi", "s_psi", "v_psi", "v_rate_psi", "gains_at_bound_psi");

/// What the controller believes of the rotors; healthy where it does not watch them.
const BELIEF: [Column; 9] = [
    ("share_1", |x| believed(x, 0)),
    ("share_2", |x| believed(x, 1)),
    ("share_3", |x| believed(x, 2)),
    ("share_4", |x| believed(x, 3)),
    ("motor_lag_s", |x| x.telemetry.rotors.map_or(f64::NAN, |rotors| rotors.lag_s.into())),
    ("alarm_rotor", |x| alarm(x).map_or(0.0, |alarm| alarm.rotor.map_or(5.0, |j| j as f64 + 1.0))),
    ("alarm_loss", |x| alarm(x).map_or(0.0, |alarm| alarm.loss.into())),
    ("alarm_confidence", |x| alarm(x).map_or(0.0, |alarm| alarm.confidence.into())),
    ("spinning_rotor", |x| x.telemetry.rotors.and_then(|rotors| rotors.spinning).map_or(0.0, |j| j as f64 + 1.0)),
];

fn believed(sample: &Sample, rotor: usize) -> f64 {
    sample.telemetry.rotors.map_or(1.0, |rotors| rotors.shares[rotor].into())
}

fn alarm(sample: &Sample) -> Option<Alarm> {
    sample.telemetry.rotors?.alarm
}

const REFUSED: [Column; 8] = [
    ("tilt_setpoint_roll_rad", |x| x.telemetry.tilt_setpoint_rad[0].into()),
    ("tilt_setpoint_pitch_rad", |x| x.telemetry.tilt_setpoint_rad[1].into()),
    ("refused_thrust_n", |x| x.telemetry.refused.thrust_n.into()),
    ("refused_roll_nm", |x| x.telemetry.refused.roll_nm.into()),
    ("refused_pitch_nm", |x| x.telemetry.refused.pitch_nm.into()),
    ("refused_yaw_nm", |x| x.telemetry.refused.yaw_nm.into()),
    ("yaw_guard", |x| f64::from(x.telemetry.yaw_guard)),
    ("sample_rejected", |x| f64::from(x.output.rejected)),
];

/// What the estimator believed and how wrong that was; of a flight on sensors only.
const ESTIMATE: [Column; 16] = [
    ("estimate_north_m", |x| estimate(x, |e, _| e.position_m.x.into())),
    ("estimate_east_m", |x| estimate(x, |e, _| e.position_m.y.into())),
    ("estimate_altitude_m", |x| estimate(x, |e, _| (-e.position_m.z).into())),
    ("estimate_tilt_error_rad", |x| estimate(x, |_, apart| apart.tilt_rad())),
    ("estimate_tilt_sigma_rad", |x| estimate(x, |e, _| e.sigma.tilt_rad.into())),
    ("estimate_heading_error_rad", |x| estimate(x, |_, apart| apart.heading_rad())),
    ("estimate_heading_sigma_rad", |x| estimate(x, |e, _| e.sigma.heading_rad.into())),
    ("estimate_horizontal_error_m_s", |x| estimate(x, |_, apart| apart.velocity_m_s.xy().norm())),
    ("estimate_horizontal_sigma_m_s", |x| estimate(x, |e, _| e.sigma.horizontal_m_s.into())),
    ("estimate_vertical_error_m_s", |x| estimate(x, |_, apart| -apart.velocity_m_s.z)),
    ("estimate_vertical_sigma_m_s", |x| estimate(x, |e, _| e.sigma.vertical_m_s.into())),
    ("estimate_horizontal_error_m", |x| estimate(x, |_, apart| apart.position_m.xy().norm())),
    ("estimate_horizontal_sigma_m", |x| estimate(x, |e, _| e.sigma.horizontal_m.into())),
    ("estimate_altitude_error_m", |x| estimate(x, |_, apart| -apart.position_m.z)),
    ("estimate_altitude_sigma_m", |x| estimate(x, |e, _| e.sigma.altitude_m.into())),
    // How many of the facts of its health hold, each needing the ones before, but for altitude.
    ("estimate_health", |x| {
        estimate(x, |e, _| {
            let Health { rates, tilt, heading, altitude, velocity, position } = e.health;
            [rates, tilt, heading, altitude, velocity, position].into_iter().filter(|&holds| holds).count() as f64
        })
    }),
];

fn estimate(sample: &Sample, of: impl Fn(&Estimate, &Apart) -> f64) -> f64 {
    sample.estimate.map_or(f64::NAN, |estimate| of(estimate, &Apart::of(sample.truth, estimate)))
}

/// Every column, in order; of flights on sensors with what was estimated.
fn columns(estimated: bool) -> impl Iterator<Item = &'static Column> {
    let estimate = if estimated { &ESTIMATE[..] } else { &[] };
    MOTION
        .iter()
        .chain(&ROTORS)
        .chain(&X)
        .chain(&Y)
        .chain(&Z)
        .chain(&PSI)
        .chain(&BELIEF)
        .chain(&REFUSED)
        .chain(estimate)
}

/// The log of one flight.
pub struct Log {
    every: usize,
    /// Whether the flight is flown on sensors.
    estimated: bool,
    rows: Vec<Vec<f64>>,
}

impl Log {
    /// An empty log of every `every`-th tick.
    pub fn new(every: usize) -> Self {
        Self { every: every.max(1), estimated: false, rows: Vec::new() }
    }

    /// An empty log of about `log_hz` rows a second, at most one a tick.
    pub fn at_rate(log_hz: f64, control_hz: f64) -> Self {
        Self::new((control_hz / log_hz).round() as usize)
    }

    /// Takes a tick, if it is to be logged.
    pub fn note(&mut self, sample: &Sample) {
        if sample.tick.is_multiple_of(self.every) {
            self.estimated = sample.estimator.is_some() && sample.aboard.is_none_or(Aboard::is_flown);
            self.rows.push(columns(self.estimated).map(|(_, of)| of(sample)).collect());
        }
    }

    /// The values of a column; empty if there is none of that name.
    pub fn column(&self, name: &str) -> Vec<f64> {
        columns(self.estimated)
            .position(|(column, _)| *column == name)
            .map(|i| self.rows.iter().map(|row| row[i]).collect())
            .unwrap_or_default()
    }

    /// The log as CSV, a header line first.
    pub fn to_csv(&self) -> std::io::Result<Vec<u8>> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(columns(self.estimated).map(|(name, _)| *name))?;
        for row in &self.rows {
            writer.write_record(row.iter().map(ToString::to_string))?;
        }
        writer.into_inner().map_err(csv::IntoInnerError::into_error)
    }
}

/// First bytes of a tick record.
const TICK_RECORD_MAGIC: &[u8; 8] = b"TICKREC2";

/// Every input of the controller and the thrusts it answered with: what a board needs to repeat the flight to the bit.
///
/// Little-endian: magic, number of ticks (u32), which controller (u32), the airframe's 19 numbers, then 33 inputs and 4 thrusts a tick (f32).
pub struct TickRecord {
    controller: u32,
    airframe: Airframe,
    ticks: u32,
    bytes: Vec<u8>,
}

impl TickRecord {
    /// An empty record; none for a controller that the board does not know.
    pub fn new(controller: ControllerName, airframe: Airframe) -> Option<Self> {
        let controller = match controller {
            ControllerName::Lgs => 0,
            ControllerName::Default => 1,
            _ => return None,
        };
        Some(Self { controller, airframe, ticks: 0, bytes: Vec::new() })
    }

    /// Takes a tick.
    pub fn note(&mut self, sample: &Sample) {
        self.ticks += 1;
        let Input { dt_s, position_m, velocity_m_s, attitude, rate_rad_s, specific_force_m_s2, setpoint } =
            sample.input;
        let [p, v, sp, sv, sa] =
            [position_m, velocity_m_s, &setpoint.position_m, &setpoint.velocity_m_s, &setpoint.acceleration_m_s2]
                .map(|v| [v.x, v.y, v.z]);
        let [rate, force] = [rate_rad_s, specific_force_m_s2].map(|v| [v.x, v.y, v.z]);
        let numbers = std::iter::once(*dt_s)
            .chain(p)
            .chain(v)
            .chain(attitude.rows.into_iter().flatten())
            .chain(rate)
            .chain(force)
            .chain(sp)
            .chain(sv)
            .chain(sa)
            .chain([setpoint.yaw_rad, setpoint.yaw_rate_rad_s])
            .chain(sample.output.thrust_n);
        for number in numbers {
            self.bytes.extend(number.to_le_bytes());
        }
    }

    /// Writes the record.
    pub fn write(&self, mut out: impl Write) -> std::io::Result<()> {
        out.write_all(TICK_RECORD_MAGIC)?;
        out.write_all(&self.ticks.to_le_bytes())?;
        out.write_all(&self.controller.to_le_bytes())?;
        let Airframe { mass_kg, inertia_kg_m2, rotors, torque_per_thrust_m, rotor_momentum, thrust_n_min } =
            self.airframe;
        let numbers = std::iter::once(mass_kg)
            .chain(inertia_kg_m2)
            .chain(rotors.into_iter().flat_map(|rotor| [rotor.forward_m, rotor.right_m, rotor.thrust_n_max]))
            .chain([torque_per_thrust_m, rotor_momentum, thrust_n_min]);
        for number in numbers {
            out.write_all(&number.to_le_bytes())?;
        }
        out.write_all(&self.bytes)
    }
}
