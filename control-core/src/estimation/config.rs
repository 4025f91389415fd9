//! What the estimator is built from, and the checks it must pass.
//!
//! Densities are one-sided, per square root of hertz. Where each number comes from is in docs/estimation.md.
use super::gyro::GyroConfig;
use crate::compass::Compass;
use crate::frames::{Body, Ned, Vec3};
use core::fmt;

/// Noise of the inertial unit, as it flies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialNoise {
    /// Gyroscope, rad/s/√Hz.
    pub gyro_rad_s_rt_hz: f32,
    /// Accelerometer, m/s²/√Hz.
    pub accelerometer_m_s2_rt_hz: f32,
    /// Random walk of the gyro's bias, rad/s/√s.
    pub gyro_walk_rad_s_rt_s: f32,
    /// Random walk of the accelerometer's bias, m/s²/√s.
    pub accelerometer_walk_m_s2_rt_s: f32,
    /// Share of a rate that the gyro's scale and axes may be off by.
    pub gyro_scale: f32,
    /// Gyro bias at power-on, 1 σ, rad/s, once its mean at rest is taken off.
    pub gyro_bias_rad_s: f32,
    /// Accelerometer bias at power-on, 1 σ, m/s².
    pub accelerometer_bias_m_s2: f32,
}

/// Noise of everything else; where a sample brings its own, the least that is believed of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AidingNoise {
    /// Satellite position, horizontal, least, m.
    pub gnss_horizontal_m: f32,
    /// Satellite position, vertical, least, m.
    pub gnss_vertical_m: f32,
    /// Satellite velocity, least, m/s.
    pub gnss_m_s: f32,
    /// What a satellite position may be off by for minutes, m: multipath and the sky's delays.
    pub gnss_bias_m: f32,
    /// Barometric altitude, m.
    pub barometer_m: f32,
    /// Random walk of the barometer's offset, m/√s.
    pub barometer_walk_m_rt_s: f32,
    /// Magnetic field, each axis, µT.
    pub magnetic_ut: f32,
    /// What iron and currents leave of the field for long, each axis, µT.
    pub magnetic_bias_ut: f32,
    /// Range, m.
    pub range_m: f32,
    /// Random walk of the ground's height below a flight, m/√s.
    pub ground_walk_m_rt_s: f32,
    /// Optical flow, rad/s.
    pub flow_rad_s: f32,
    /// Position by external vision, least, m.
    pub vision_m: f32,
    /// Attitude by external vision, least, rad.
    pub vision_rad: f32,
    /// Lasting error of that attitude, by how the markers sit, rad.
    pub vision_askew_rad: f32,
}

/// Largest standard deviations, and longest time without a source, with which an estimate is flown on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HealthLimits {
    /// Roll and pitch, rad.
    pub tilt_rad: f32,
    /// Heading, rad.
    pub heading_rad: f32,
    /// Horizontal and vertical velocity, m/s.
    pub velocity_m_s: f32,
    /// Horizontal position, m.
    pub position_m: f32,
    /// Altitude, m.
    pub altitude_m: f32,
    /// Longest dead reckoning, s.
    pub dead_reckoning_s: f32,
}

/// Everything the estimator is told before it flies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorConfig {
    /// Inertial unit.
    pub inertial: InertialNoise,
    /// Other sources.
    pub aiding: AidingNoise,
    /// What may be flown on.
    pub limits: HealthLimits,
    /// Filters of the rates that are flown on.
    pub gyro: GyroConfig,
    /// What is known of the compass, taken off what it says.
    pub compass: Compass,
    /// What the first accelerometer is known to read too much, m/s².
    pub accelerometer_offset_m_s2: Vec3<Body>,
    /// The earth's field where it flies, µT; north is true north, so that the declination is in it.
    pub earth_field_ut: Vec3<Ned>,
    /// Innovations beyond this many standard deviations are refused.
    pub gate_sigma: f32,
}

impl EstimatorConfig {
    /// A board that carries the parts of docs/estimation.md, with margins for vibration, in central Europe.
    pub const FLIGHT: Self = Self {
        inertial: InertialNoise {
            gyro_rad_s_rt_hz: 1.5e-4,
            accelerometer_m_s2_rt_hz: 5e-3,
            gyro_walk_rad_s_rt_s: 2e-5,
            accelerometer_walk_m_s2_rt_s: 3e-4,
            gyro_scale: 5e-3,
            gyro_bias_rad_s: 2e-3,
            accelerometer_bias_m_s2: 0.15,
        },
        aiding: AidingNoise {
            gnss_horizontal_m: 0.5,
            gnss_vertical_m: 0.8,
            gnss_m_s: 0.3,
            gnss_bias_m: 0.6,
            barometer_m: 0.3,
            barometer_walk_m_rt_s: 0.02,
            magnetic_ut: 1.0,
            magnetic_bias_ut: 0.25,
            range_m: 0.03,
            ground_walk_m_rt_s: 0.02,
            flow_rad_s: 0.05,
            vision_m: 0.002,
            vision_rad: 0.002,
            vision_askew_rad: 0.004,
        },
        limits: HealthLimits {
            tilt_rad: 0.1,
            heading_rad: 0.35,
            velocity_m_s: 1.0,
            position_m: 5.0,
            altitude_m: 3.0,
            dead_reckoning_s: 5.0,
        },
        gyro: GyroConfig::FLIGHT,
        compass: Compass::AS_BUILT,
        accelerometer_offset_m_s2: Vec3::zero(),
        earth_field_ut: Vec3::new(20.5, 0.0, 43.4),
        gate_sigma: 5.0,
    };

    /// The same with a compass, and an accelerometer's offset, that have been measured. How sure of that the filter is stays as it was: an
    /// accelerometer that fails would else be believed for too long.
    #[must_use]
    pub fn calibrated(self, compass: Compass, accelerometer_offset_m_s2: Vec3<Body>) -> Self {
        Self { compass, accelerometer_offset_m_s2, ..self }
    }

    /// Refuses a configuration with a number that cannot be meant.
    pub(crate) fn check(&self) -> Result<(), EstimatorConfigError> {
        let Self {
            inertial: i,
            aiding: a,
            limits: l,
            gate_sigma,
            earth_field_ut: field,
            gyro,
            accelerometer_offset_m_s2,
            compass: _,
        } = self;
        for (field, value, range) in [
            ("inertial.gyro_rad_s_rt_hz", i.gyro_rad_s_rt_hz, (1e-6, 0.1)),
            ("inertial.accelerometer_m_s2_rt_hz", i.accelerometer_m_s2_rt_hz, (1e-5, 10.0)),
            ("inertial.gyro_walk_rad_s_rt_s", i.gyro_walk_rad_s_rt_s, (1e-8, 0.01)),
            ("inertial.accelerometer_walk_m_s2_rt_s", i.accelerometer_walk_m_s2_rt_s, (1e-7, 0.1)),
            ("inertial.gyro_scale", i.gyro_scale, (0.0, 0.1)),
            ("inertial.gyro_bias_rad_s", i.gyro_bias_rad_s, (1e-5, 0.2)),
            ("inertial.accelerometer_bias_m_s2", i.accelerometer_bias_m_s2, (1e-4, 2.0)),
            ("aiding.gnss_horizontal_m", a.gnss_horizontal_m, (0.001, 100.0)),
            ("aiding.gnss_vertical_m", a.gnss_vertical_m, (0.001, 100.0)),
            ("aiding.gnss_m_s", a.gnss_m_s, (0.001, 10.0)),
            ("aiding.gnss_bias_m", a.gnss_bias_m, (0.0, 100.0)),
            ("aiding.barometer_m", a.barometer_m, (0.01, 100.0)),
            ("aiding.barometer_walk_m_rt_s", a.barometer_walk_m_rt_s, (1e-5, 10.0)),
            ("aiding.magnetic_ut", a.magnetic_ut, (0.01, 20.0)),
            ("aiding.magnetic_bias_ut", a.magnetic_bias_ut, (0.0, 20.0)),
            ("aiding.range_m", a.range_m, (0.001, 10.0)),
            ("aiding.ground_walk_m_rt_s", a.ground_walk_m_rt_s, (1e-5, 10.0)),
            ("aiding.flow_rad_s", a.flow_rad_s, (0.001, 10.0)),
            ("aiding.vision_m", a.vision_m, (0.0005, 10.0)),
            ("aiding.vision_rad", a.vision_rad, (0.0005, 1.0)),
            ("aiding.vision_askew_rad", a.vision_askew_rad, (0.0, 1.0)),
            ("limits.tilt_rad", l.tilt_rad, (0.01, 1.0)),
            ("limits.heading_rad", l.heading_rad, (0.01, 3.0)),
            ("limits.velocity_m_s", l.velocity_m_s, (0.01, 20.0)),
            ("limits.position_m", l.position_m, (0.01, 1000.0)),
            ("limits.altitude_m", l.altitude_m, (0.01, 1000.0)),
            ("limits.dead_reckoning_s", l.dead_reckoning_s, (0.1, 600.0)),
            ("gyro.low_pass_hz", gyro.low_pass_hz, (10.0, 500.0)),
            ("gyro.notch_width_hz", gyro.notch_width_hz, (1.0, 100.0)),
            ("gyro.notch_hz_min", gyro.notch_hz_min, (20.0, 500.0)),
            ("accelerometer_offset_m_s2, squared", accelerometer_offset_m_s2.norm_squared(), (0.0, 3.0)),
            ("gate_sigma", *gate_sigma, (2.0, 20.0)),
            // A horizontal field too weak for a heading, or beyond the earth's.
            ("earth_field_ut, horizontal, squared", field.x * field.x + field.y * field.y, (25.0, 4900.0)),
            ("earth_field_ut.z", field.z, (-70.0, 70.0)),
        ] {
            if !(range.0..=range.1).contains(&value) {
                return Err(EstimatorConfigError { field, value, range });
            }
        }
        Ok(())
    }
}

/// A number that the estimator cannot fly with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorConfigError {
    /// Which.
    pub field: &'static str,
    /// Its value.
    pub value: f32,
    /// What is allowed.
    pub range: (f32, f32),
}

impl fmt::Display for EstimatorConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, range: (low, high) } = self;
        write!(f, "estimator.{field} = {value}: must be from {low} to {high}")
    }
}

impl core::error::Error for EstimatorConfigError {}
