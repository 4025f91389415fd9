//! What goes into a tick and what comes out of it.
use crate::allocation::Demand;
use crate::frames::{Attitude, Body, Ned, Vec3};
use crate::law::AxisTelemetry;
use crate::rotors::RotorsTelemetry;
use crate::{GRAVITY_M_S2, Mask, Scalar};

/// Where to be and how to move there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint<S = f32> {
    /// Position, m.
    pub position_m: Vec3<Ned, S>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<Ned, S>,
    /// Acceleration, m/s².
    pub acceleration_m_s2: Vec3<Ned, S>,
    /// Heading, rad in −π..=π.
    pub yaw_rad: S,
    /// Heading rate, rad/s.
    pub yaw_rate_rad_s: S,
}

/// One sample of everything a tick needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Input<S = f32> {
    /// Time since the last tick, s; held within a quarter and four times the nominal period.
    pub dt_s: S,
    /// Position, m.
    pub position_m: Vec3<Ned, S>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<Ned, S>,
    /// Body to NED.
    pub attitude: Attitude<S>,
    /// Body rates, rad/s.
    pub rate_rad_s: Vec3<Body, S>,
    /// Specific force, what an accelerometer reads, m/s².
    pub specific_force_m_s2: Vec3<Body, S>,
    /// Where to be.
    pub setpoint: Setpoint<S>,
}

impl<S: Scalar> Input<S> {
    /// Level and still at the origin, told to stay there, at 500 Hz.
    pub fn hovering() -> Self {
        let setpoint = Setpoint {
            position_m: Vec3::zero(),
            velocity_m_s: Vec3::zero(),
            acceleration_m_s2: Vec3::zero(),
            yaw_rad: S::ZERO,
            yaw_rate_rad_s: S::ZERO,
        };
        Self {
            dt_s: S::from_f32(0.002),
            position_m: Vec3::zero(),
            velocity_m_s: Vec3::zero(),
            attitude: Attitude::level(),
            rate_rad_s: Vec3::zero(),
            specific_force_m_s2: Vec3::new(S::ZERO, S::ZERO, S::from_f32(-GRAVITY_M_S2)),
            setpoint,
        }
    }

    /// The same sample in another number format.
    pub fn cast<T: Scalar>(&self) -> Input<T> {
        let t = |x: S| T::from_f32(x.to_f32());
        let setpoint = &self.setpoint;
        Input {
            dt_s: t(self.dt_s),
            position_m: self.position_m.map(t),
            velocity_m_s: self.velocity_m_s.map(t),
            attitude: Attitude { rows: self.attitude.rows.map(|row| row.map(t)) },
            rate_rad_s: self.rate_rad_s.map(t),
            specific_force_m_s2: self.specific_force_m_s2.map(t),
            setpoint: Setpoint {
                position_m: setpoint.position_m.map(t),
                velocity_m_s: setpoint.velocity_m_s.map(t),
                acceleration_m_s2: setpoint.acceleration_m_s2.map(t),
                yaw_rad: t(setpoint.yaw_rad),
                yaw_rate_rad_s: t(setpoint.yaw_rate_rad_s),
            },
        }
    }
}

/// The axes an adaptive law commands, in the order of [`Telemetry::axes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// North.
    X,
    /// East.
    Y,
    /// Altitude, positive up.
    Z,
    /// Heading.
    Psi,
}

/// What the last tick thought, for logs.
#[derive(Clone, Copy, Debug)]
pub struct Telemetry<S: Scalar = f32> {
    /// Commands, gains and s of x, y, z and psi: see [`Axis`].
    pub axes: [AxisTelemetry<S>; 4],
    /// Setpoints of roll and pitch, rad.
    pub tilt_setpoint_rad: [S; 2],
    /// What the allocation refused.
    pub refused: Demand<S>,
    /// Whether the yaw guard only brakes.
    pub yaw_guard: S::Mask,
    /// What is believed of the rotors, if they are watched.
    pub rotors: Option<RotorsTelemetry<S>>,
}

impl<S: Scalar> Telemetry<S> {
    /// The same in the format of logs.
    pub fn to_f32(&self) -> Telemetry {
        let f = S::to_f32;
        Telemetry {
            axes: self.axes.map(|axis| axis.to_f32()),
            tilt_setpoint_rad: self.tilt_setpoint_rad.map(f),
            refused: self.refused.map(f),
            yaw_guard: self.yaw_guard.all(),
            rotors: self.rotors.map(RotorsTelemetry::to_f32),
        }
    }
}

/// Result of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output<S = f32> {
    /// Thrust of each rotor, N, in airframe order.
    pub thrust_n: [S; 4],
    /// Whether the sample was refused as implausible, and the thrusts are those of the last good one.
    pub rejected: bool,
}

impl<S: Scalar> Output<S> {
    /// The same in the format of logs.
    pub fn to_f32(&self) -> Output {
        Output { thrust_n: self.thrust_n.map(S::to_f32), rejected: self.rejected }
    }
}
