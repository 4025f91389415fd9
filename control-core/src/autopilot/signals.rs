//! What goes into a step of the autopilot and what comes out of it.
use crate::arming::Check;
use crate::controller::Target;
use crate::estimate::{Estimate, Health};
use crate::failsafe::Failsafe;
use crate::frames::{Attitude, Vec3};
use crate::measurement::Stamped;
use crate::modes::{Level, Mode, Reason};
use crate::pilot::{PilotInput, age_s};
use crate::set::Set;
use crate::signals::{Input, Setpoint};

/// What the rest of the system knows of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::struct_excessive_bools, reason = "independent facts, each read by name")]
pub struct System {
    /// Voltage of the battery, if somebody measures it, V.
    pub battery_v: Option<f32>,
    /// Charge taken from it since the machine was switched on, as far as somebody measures it, A s.
    pub used_as: f32,
    /// Whether the gyro's bias is known.
    pub gyro_calibrated: bool,
    /// Whether every self-test has passed.
    pub self_test_passed: bool,
    /// Whether every stored parameter was in its range.
    pub parameters_valid: bool,
    /// Whether this tick came late.
    pub late: bool,
}

impl System {
    /// All is well, and nobody measures the battery.
    pub const GOOD: Self = Self {
        battery_v: None,
        used_as: 0.0,
        gyro_calibrated: true,
        self_test_passed: true,
        parameters_valid: true,
        late: false,
    };
}

/// What one step is given.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Now, µs since boot.
    pub now_us: u64,
    /// Time since the last step, s.
    pub dt_s: f32,
    /// What is believed of the motion.
    pub estimate: &'a Estimate,
    /// The pilot's last frame, if there was one.
    pub pilot: Option<&'a Stamped<PilotInput>>,
    /// The last setpoint from outside, if there was one.
    pub offboard: Option<&'a Stamped<Setpoint>>,
    /// The system.
    pub system: &'a System,
}

/// What one step decides.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::struct_excessive_bools, reason = "independent facts, each read by name")]
pub struct Command {
    /// What each motor was told, share of its largest thrust, 0 to 1, in airframe order.
    pub motors: [f32; 4],
    /// Whether the rotors are let turn.
    pub armed: bool,
    /// The mode aimed at.
    pub aim: Mode,
    /// The mode flown.
    pub mode: Mode,
    /// Why the mode flown is not the one aimed at; or else, why that was taken up.
    pub reason: Option<Reason>,
    /// The failsafes that act.
    pub failsafes: Set<Failsafe>,
    /// The checks that fail; none are made while armed.
    pub failing: Set<Check>,
    /// Whether arming was refused in this step, for what `failing` names.
    pub refused: bool,
    /// Whether it stands on its feet.
    pub landed: bool,
    /// Whether the controller refused the sample, and holds its thrusts.
    pub rejected: bool,
}

/// What the motors do at the next sample.
#[derive(Clone, Copy, Debug)]
pub(super) enum Plan {
    /// These commands.
    Turn([f32; 4]),
    /// What the controller makes of a target, on what of the estimate can be flown on.
    Fly(Target, Level),
}

/// What the motors were told.
#[derive(Clone, Copy, Debug)]
pub(super) struct Acted {
    /// Shares of the largest thrusts.
    pub(super) motors: [f32; 4],
    /// Thrusts, N; zero where the controller has not spoken.
    pub(super) thrust_n: [f32; 4],
    pub(super) rejected: bool,
}

impl Acted {
    pub(super) const NOTHING: Self = Self { motors: [0.0; 4], thrust_n: [0.0; 4], rejected: false };
}

impl Step<'_> {
    /// Age of the last setpoint from outside, s; infinite if there is none, or it is not finite.
    pub(super) fn offboard_age_s(&self) -> f32 {
        let Some(Stamped { time_us, value }) = self.offboard else { return f32::INFINITY };
        let Setpoint { position_m, velocity_m_s, acceleration_m_s2, yaw_rad, yaw_rate_rad_s } = value;
        let sum = position_m.norm_squared() + velocity_m_s.norm_squared() + acceleration_m_s2.norm_squared();
        let finite = (sum + yaw_rad * yaw_rad + yaw_rate_rad_s * yaw_rate_rad_s).is_finite();
        if finite { age_s(self.now_us, *time_us) } else { f32::INFINITY }
    }
}

/// What of the estimate may be believed: what it says of itself, less what is not a number.
pub(super) fn believed(estimate: &Estimate) -> Health {
    let Estimate { position_m, velocity_m_s, attitude, rate_rad_s, specific_force_m_s2, health, .. } = estimate;
    let of = |row: &[f32; 3]| row.iter().sum::<f32>();
    let turned = attitude.rows.iter().map(of).sum::<f32>().is_finite();
    let altitude = (position_m.z + velocity_m_s.z).is_finite();
    Health {
        rates: health.rates && (rate_rad_s.norm_squared() + specific_force_m_s2.norm_squared()).is_finite(),
        tilt: health.tilt && turned,
        heading: health.heading && turned,
        altitude: health.altitude && altitude,
        velocity: health.velocity && velocity_m_s.norm_squared().is_finite(),
        position: health.position && position_m.norm_squared().is_finite(),
    }
}

/// The controller's sample: of what may not be flown on, nothing is passed on.
pub(super) fn sample(estimate: &Estimate, level: Level, dt_s: f32, setpoint: Setpoint) -> Input {
    let (zero, velocity_m_s) = (Vec3::zero(), estimate.velocity_m_s);
    let vertical = |v: Vec3<_>| Vec3::new(0.0, 0.0, v.z);
    let (position_m, velocity_m_s) = match level {
        Level::Nothing | Level::Rates | Level::Tilt => (zero, zero),
        Level::Altitude => (vertical(estimate.position_m), vertical(velocity_m_s)),
        Level::Velocity | Level::Position => (estimate.position_m, velocity_m_s),
    };
    Input {
        dt_s,
        position_m,
        velocity_m_s,
        attitude: if level >= Level::Tilt { estimate.attitude } else { Attitude::level() },
        rate_rad_s: estimate.rate_rad_s,
        specific_force_m_s2: estimate.specific_force_m_s2,
        setpoint,
    }
}
