//! `[sensors]`: which parts the machine carries, and what a researcher may change about them and their surroundings.
use super::line::Timing;
use super::parts::{BaroPart, FlowPart, GnssPart, ImuPart, MagPart, RangePart, VisionPart};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How rotor speeds are told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RotorSpeedPart {
    /// Bidirectional DShot.
    Dshot,
}

/// `[sensors]`: the parts by name; one that is left out is not there.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SensorKeys {
    /// Whether controllers fly on what an estimator makes of the sensors; else they are shown the truth with `[noise]`.
    pub flown: bool,
    /// Inertial unit.
    pub imu: Option<ImuPart>,
    /// How many of it, 1 or 2.
    pub imus: u8,
    /// Barometer.
    pub baro: Option<BaroPart>,
    /// How many of it, 1 or 2.
    pub baros: u8,
    /// Magnetometer.
    pub mag: Option<MagPart>,
    /// Satellite receiver.
    pub gnss: Option<GnssPart>,
    /// Range sensor, looking along body down.
    pub range: Option<RangePart>,
    /// Optical-flow sensor, looking along body down.
    pub flow: Option<FlowPart>,
    /// Pose from outside.
    pub vision: Option<VisionPart>,
    /// Rotor-speed telemetry.
    pub rotor_speed: Option<RotorSpeedPart>,
    /// Battery, whose voltage is measured.
    pub battery: Option<BatteryKeys>,
    /// Whether the sensors were calibrated, or are as delivered; compass and first accelerometer by the procedure of docs/compass.md.
    pub calibrated: bool,
    /// Samples a second, instead of the part's. An inertial unit has one each tick.
    pub rate_hz: Each,
    /// From when a sample is true to when it is handed over, s, instead of the part's.
    pub latency_s: Each,
    /// What all random errors of a sensor are multiplied by; 1 if left out.
    pub noise: Each,
    /// The earth's magnetic field.
    pub earth: EarthKeys,
    /// What satellite signals meet.
    pub sky: SkyKeys,
    /// Light on the ground, lux: 1000 is a bright room, 100000 the sun.
    pub light_lux: f64,
    /// Share of the ground's image that has texture, 0 to 1.
    pub texture: f64,
    /// Magnetic field of the motor current at the magnetometer, body axes, µT/A.
    pub mag_ut_per_a: [f64; 3],
    /// Current of all motors in a hover, A.
    pub hover_a: f64,
    /// Pressure that the rotors add on the ground, in a hover, Pa; it falls by half every 0.25 m of height.
    pub ground_effect_pa: f64,
    /// What of the dynamic pressure of the air that passes reaches the barometer; negative is suction.
    pub static_port: f64,
    /// Unbalance of each healthy rotor, kg m.
    pub rotor_unbalance_kg_m: f64,
}

impl Default for SensorKeys {
    fn default() -> Self {
        Self {
            flown: false,
            imu: None,
            imus: 1,
            baro: None,
            baros: 1,
            mag: None,
            gnss: None,
            range: None,
            flow: None,
            vision: None,
            rotor_speed: None,
            battery: None,
            calibrated: true,
            rate_hz: Each::default(),
            latency_s: Each::default(),
            noise: Each::default(),
            earth: EarthKeys::default(),
            sky: SkyKeys::default(),
            light_lux: 1000.0,
            texture: 1.0,
            mag_ut_per_a: [0.15, -0.1, 0.3],
            hover_a: 6.0,
            ground_effect_pa: 10.0,
            static_port: -0.2,
            rotor_unbalance_kg_m: 2e-6,
        }
    }
}

/// One number for each sensor; left out, it is the part's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Each {
    /// Inertial unit.
    pub imu: Option<f64>,
    /// Barometer.
    pub baro: Option<f64>,
    /// Magnetometer.
    pub mag: Option<f64>,
    /// Satellite receiver.
    pub gnss: Option<f64>,
    /// Range sensor.
    pub range: Option<f64>,
    /// Optical-flow sensor.
    pub flow: Option<f64>,
    /// Pose from outside.
    pub vision: Option<f64>,
    /// Rotor-speed telemetry.
    pub rotor_speed: Option<f64>,
    /// Battery voltage.
    pub battery: Option<f64>,
}

impl Each {
    /// What is given, by name.
    pub(crate) fn given(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let Self { imu, baro, mag, gnss, range, flow, vision, rotor_speed, battery } = *self;
        [
            ("imu", imu),
            ("baro", baro),
            ("mag", mag),
            ("gnss", gnss),
            ("range", range),
            ("flow", flow),
            ("vision", vision),
            ("rotor_speed", rotor_speed),
            ("battery", battery),
        ]
        .into_iter()
        .filter_map(|(name, value)| Some((name, value?)))
    }
}

/// `[sensors.earth]`: the magnetic field where the flight is; the default is of central Europe, without declination.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EarthKeys {
    /// Strength, µT.
    pub field_ut: f64,
    /// Angle below the horizontal, rad.
    pub inclination_rad: f64,
    /// Angle of magnetic north to the east of true north, rad.
    pub declination_rad: f64,
}

impl Default for EarthKeys {
    fn default() -> Self {
        Self { field_ut: 48.0, inclination_rad: 1.13, declination_rad: 0.0 }
    }
}

/// `[sensors.sky]`: what satellite signals meet.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SkyKeys {
    /// What multipath errors are multiplied by: 1 under an open sky, 5 between houses.
    pub multipath: f64,
    /// Drop-outs a second while there is a fix.
    pub outage_rate_1_s: f64,
    /// Mean length of a drop-out, s.
    pub outage_s: f64,
}

impl Default for SkyKeys {
    fn default() -> Self {
        Self { multipath: 1.0, outage_rate_1_s: 0.0, outage_s: 5.0 }
    }
}

/// `[sensors.battery]`: lithium-polymer cells in series.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BatteryKeys {
    /// Cells in series.
    pub cells: u8,
    /// Charge when full, A h.
    pub capacity_ah: f64,
    /// Share of it that is there at the start, 0 to 1.
    pub charge: f64,
    /// Resistance of all cells and wires, Ω.
    pub resistance_ohm: f64,
}

impl Default for BatteryKeys {
    fn default() -> Self {
        Self { cells: 3, capacity_ah: 2.2, charge: 1.0, resistance_ohm: 0.05 }
    }
}

/// A sensor's timing and noise, as its part and the scenario's keys make them.
pub(super) struct Tuned {
    pub(super) timing: Timing,
    /// What random errors are multiplied by.
    pub(super) noise: f64,
}

impl SensorKeys {
    /// What `pick` picks of the keys, or `timing`.
    pub(super) fn tuned(&self, timing: Timing, pick: impl Fn(&Each) -> Option<f64>) -> Tuned {
        let rate_hz = pick(&self.rate_hz).unwrap_or(timing.rate_hz);
        let latency_s = pick(&self.latency_s).unwrap_or(timing.latency_s);
        Tuned { timing: Timing { rate_hz, latency_s, ..timing }, noise: pick(&self.noise).unwrap_or(1.0) }
    }
}
