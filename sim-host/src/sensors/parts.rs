//! What the data sheets of the parts say, in SI. Every figure and its source is in docs/sensors.md.
use super::line::Timing;
use control_core::GRAVITY_M_S2;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// One degree, rad.
const DEGREE: f64 = PI / 180.0;
/// One g, m/s².
const G: f64 = GRAVITY_M_S2 as f64;

/// Inertial units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImuPart {
    /// TDK ICM-42688-P.
    Icm42688p,
}

/// Barometers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BaroPart {
    /// Bosch BMP388, eight-fold oversampling.
    Bmp388,
    /// Infineon DPS310, sixteen-fold oversampling.
    Dps310,
}

/// Magnetometers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MagPart {
    /// QST QMC5883L at ±8 G.
    Qmc5883l,
    /// iSentek IST8310.
    Ist8310,
}

/// Satellite receivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GnssPart {
    /// u-blox M10, two constellations, of which 10 Hz leaves time for.
    M10,
    /// u-blox ZED-F9P, corrected by what satellites say (SBAS).
    F9p,
    /// The same, corrected by a base station nearby (RTK).
    F9pRtk,
}

/// Optical-flow sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FlowPart {
    /// PixArt PMW3901MB.
    Pmw3901,
}

/// Range sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RangePart {
    /// ST VL53L1X, long-distance mode.
    Vl53l1x,
}

/// Poses from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum VisionPart {
    /// Cameras around the room, over radio.
    Mocap,
}

/// One half of an inertial unit.
pub(super) struct InertialSheet {
    /// White noise, unit/√Hz.
    pub(super) density: f64,
    /// Random walk of the bias, unit/√s.
    pub(super) walk: f64,
    /// Bias as delivered, 1 σ.
    pub(super) offset: f64,
    /// Bias that a calibration leaves, 1 σ.
    pub(super) residual: f64,
    /// Step of the register.
    pub(super) lsb: f64,
    /// Largest reading, either way.
    pub(super) span: f64,
}

/// An inertial unit.
pub(super) struct ImuSheet {
    pub(super) gyro: InertialSheet,
    pub(super) accelerometer: InertialSheet,
    /// Error of scale and cross-axis sensitivity as delivered and soldered, 1 σ.
    pub(super) scale: f64,
    /// The same after calibration.
    pub(super) scale_residual: f64,
    /// Corner of its second-order low-pass, Hz.
    pub(super) corner_hz: f64,
    pub(super) jitter_s: f64,
}

impl ImuPart {
    pub(super) const fn sheet(self) -> ImuSheet {
        match self {
            Self::Icm42688p => ImuSheet {
                gyro: InertialSheet {
                    density: 2.8e-3 * DEGREE,
                    walk: 2e-5,
                    offset: 0.5 * DEGREE,
                    residual: 0.05 * DEGREE,
                    lsb: DEGREE / 16.4,
                    span: 2000.0 * DEGREE,
                },
                accelerometer: InertialSheet {
                    density: 70e-6 * G,
                    walk: 2e-4,
                    offset: 0.020 * G,
                    residual: 0.003 * G,
                    lsb: G / 2048.0,
                    span: 16.0 * G,
                },
                scale: 5e-3,
                scale_residual: 1e-3,
                corner_hz: 200.0,
                jitter_s: 5e-6,
            },
        }
    }
}

/// A barometer.
pub(super) struct BaroSheet {
    pub(super) timing: Timing,
    /// White noise of a sample, 1 σ, Pa.
    pub(super) noise_pa: f64,
    /// Random walk of the offset, weather and warming together, Pa/√s.
    pub(super) walk_pa: f64,
    pub(super) lsb_pa: f64,
    pub(super) span_pa: (f64, f64),
}

impl BaroPart {
    pub(super) const fn sheet(self) -> BaroSheet {
        match self {
            Self::Bmp388 => BaroSheet {
                timing: Timing { rate_hz: 50.0, latency_s: 0.010, jitter_s: 1e-4 },
                noise_pa: 1.0,
                walk_pa: 0.1,
                lsb_pa: 0.33,
                span_pa: (3e4, 12.5e4),
            },
            Self::Dps310 => BaroSheet {
                timing: Timing { rate_hz: 32.0, latency_s: 0.015, jitter_s: 1e-4 },
                noise_pa: 0.5,
                walk_pa: 0.1,
                lsb_pa: 0.06,
                span_pa: (3e4, 12e4),
            },
        }
    }
}

/// A magnetometer.
pub(super) struct MagSheet {
    pub(super) timing: Timing,
    /// White noise of a sample, each axis, 1 σ, µT.
    pub(super) noise_ut: f64,
    /// Random walk of the offset, µT/√s.
    pub(super) walk_ut: f64,
    pub(super) lsb_ut: f64,
    /// Largest reading of each axis, either way, µT.
    pub(super) span_ut: [f64; 3],
}

impl MagPart {
    pub(super) const fn sheet(self) -> MagSheet {
        let timing = Timing { rate_hz: 50.0, latency_s: 0.005, jitter_s: 1e-4 };
        match self {
            Self::Qmc5883l => {
                MagSheet { timing, noise_ut: 0.2, walk_ut: 0.003, lsb_ut: 100.0 / 3000.0, span_ut: [800.0; 3] }
            }
            Self::Ist8310 => {
                MagSheet { timing, noise_ut: 0.3, walk_ut: 0.003, lsb_ut: 0.3, span_ut: [1600.0, 1600.0, 2500.0] }
            }
        }
    }
}

/// A satellite receiver. Errors are 1 σ of each axis; vertical ones are in the third place.
pub(super) struct GnssSheet {
    pub(super) timing: Timing,
    /// Noise of a fix, m.
    pub(super) noise_m: [f64; 3],
    /// Of orbits, clocks and ionosphere, m.
    pub(super) slow_m: [f64; 3],
    pub(super) slow_time_s: f64,
    /// Multipath under an open sky, m.
    pub(super) multipath_m: [f64; 3],
    pub(super) multipath_time_s: f64,
    /// Noise of the velocity, m/s.
    pub(super) noise_m_s: [f64; 3],
    /// What of it lasts, m/s.
    pub(super) multipath_m_s: [f64; 3],
    pub(super) multipath_speed_time_s: f64,
    /// Steps of the message: latitude and longitude, altitude, speed.
    pub(super) lsb_m: [f64; 3],
    pub(super) lsb_m_s: f64,
}

impl GnssPart {
    pub(super) const fn sheet(self) -> GnssSheet {
        let m10 = GnssSheet {
            timing: Timing { rate_hz: 10.0, latency_s: 0.12, jitter_s: 1e-3 },
            noise_m: [0.1, 0.1, 0.15],
            slow_m: [1.2, 1.2, 1.8],
            slow_time_s: 7200.0,
            multipath_m: [0.4, 0.4, 0.6],
            multipath_time_s: 60.0,
            noise_m_s: [0.04, 0.04, 0.06],
            multipath_m_s: [0.03, 0.03, 0.045],
            multipath_speed_time_s: 5.0,
            lsb_m: [0.0111, 0.0111, 0.001],
            lsb_m_s: 0.001,
        };
        match self {
            Self::M10 => m10,
            Self::F9p => GnssSheet { slow_m: [0.74, 0.74, 2.1], ..m10 },
            Self::F9pRtk => GnssSheet {
                noise_m: [0.005, 0.005, 0.008],
                slow_m: [0.003, 0.003, 0.005],
                multipath_m: [0.006, 0.006, 0.011],
                ..m10
            },
        }
    }
}

/// An optical-flow sensor.
pub(super) struct FlowSheet {
    pub(super) timing: Timing,
    /// Noise of a full image, rad/s.
    pub(super) noise_rad_s: f64,
    /// Error of scale, 1 σ.
    pub(super) scale: f64,
    /// Steps of its counter a radian.
    pub(super) counts_rad: f64,
    pub(super) span_rad_s: f64,
    /// Nearest ground that is in focus, m.
    pub(super) nearest_m: f64,
    /// Light below which nothing is tracked, and above which the image is full, lux.
    pub(super) light_lux: (f64, f64),
}

impl FlowPart {
    pub(super) const fn sheet(self) -> FlowSheet {
        match self {
            Self::Pmw3901 => FlowSheet {
                timing: Timing { rate_hz: 50.0, latency_s: 0.012, jitter_s: 1e-4 },
                noise_rad_s: 0.05,
                scale: 0.02,
                counts_rad: 385.0,
                span_rad_s: 7.4,
                nearest_m: 0.08,
                light_lux: (60.0, 200.0),
            },
        }
    }
}

/// A range sensor.
pub(super) struct RangeSheet {
    pub(super) timing: Timing,
    /// Error that stays, 1 σ, m.
    pub(super) offset_m: f64,
    /// Noise of a sample, m, and what distance adds to it, m/m.
    pub(super) noise_m: (f64, f64),
    pub(super) lsb_m: f64,
    pub(super) nearest_m: f64,
    /// Farthest in the dark and under the sun, m, and the light of either, lux; between them it falls with the
    /// logarithm of light.
    pub(super) farthest_m: (f64, f64),
    pub(super) light_lux: (f64, f64),
}

impl RangePart {
    pub(super) const fn sheet(self) -> RangeSheet {
        match self {
            Self::Vl53l1x => RangeSheet {
                timing: Timing { rate_hz: 30.0, latency_s: 0.020, jitter_s: 1e-4 },
                offset_m: 0.010,
                noise_m: (0.003, 0.005),
                lsb_m: 0.001,
                nearest_m: 0.04,
                farthest_m: (3.6, 0.7),
                light_lux: (500.0, 1e5),
            },
        }
    }
}

/// A pose from outside.
pub(super) struct VisionSheet {
    pub(super) timing: Timing,
    /// Noise of a position, m.
    pub(super) noise_m: f64,
    /// Noise of an attitude, rad.
    pub(super) noise_rad: f64,
    /// Error of alignment between markers and body, 1 σ, rad.
    pub(super) alignment_rad: f64,
    pub(super) lsb_m: f64,
    /// Half of the volume it sees, m.
    pub(super) span_m: f64,
}

impl VisionPart {
    pub(super) const fn sheet(self) -> VisionSheet {
        match self {
            Self::Mocap => VisionSheet {
                timing: Timing { rate_hz: 100.0, latency_s: 0.010, jitter_s: 2e-4 },
                noise_m: 0.001,
                noise_rad: 0.002,
                alignment_rad: 0.003,
                lsb_m: 1e-4,
                span_m: 100.0,
            },
        }
    }
}
