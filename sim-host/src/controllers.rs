//! Controllers by name, and what a scenario changes of their gains.
use crate::plant::PlantKind;
use crate::scenario::Scenario;
use control_core::law::RawGains;
use control_core::{AttitudeGains, AxisConfig, Cascade, Config, Gains, Law, RotorsConfig};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::fmt;

/// A controller that `fly` and `compare` know.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize, JsonSchema, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum ControllerName {
    /// The robust law on an incremental inner loop that finds out which rotor is weak and flies without it: the one that flies.
    Default,
    /// Fixed gains, those that the adaptive laws start from.
    Pid,
    /// The paper's law exactly as printed, with its Table 2.
    Raw,
    /// The robust Lyapunov-gain-scheduled law.
    Lgs,
    /// The robust law outside, an incremental inner loop inside.
    LgsIndi,
    /// Fixed gains outside, an incremental inner loop inside.
    Indi,
    /// Fixed gains by linear-quadratic regulation with integral action.
    Lqi,
    /// Fixed gains found by optimisation (CMA-ES) on the shipped fault.
    PidOpt,
    /// Fixed gains, told at once how much thrust each rotor makes: in simulation only.
    Oracle,
}

impl fmt::Display for ControllerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Default => "default",
            Self::Pid => "pid",
            Self::Oracle => "oracle",
            Self::Raw => "raw",
            Self::Lgs => "lgs",
            Self::LgsIndi => "lgs-indi",
            Self::Indi => "indi",
            Self::Lqi => "lqi",
            Self::PidOpt => "pid-opt",
        })
    }
}

/// `[controllers.NAME]`: what differs from the controller's own configuration.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControllerKeys {
    /// Gains that differ from the controller's own.
    #[serde(default)]
    pub gains: GainKeys,
}

/// `[controllers.NAME.gains]`: every key may be left out.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GainKeys {
    /// North; commands m/s².
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x: Option<AxisKeys>,
    /// East; commands m/s².
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y: Option<AxisKeys>,
    /// Altitude; commands N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z: Option<AxisKeys>,
    /// Heading; commands N m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psi: Option<AxisKeys>,
    /// Roll; commands N m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phi: Option<AttitudeKeys>,
    /// Pitch; commands N m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub theta: Option<AttitudeKeys>,
}

/// Gains of an outer axis.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AxisKeys {
    /// Starting k_p.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p: Option<f64>,
    /// Starting k_i.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub i: Option<f64>,
    /// Starting k_d.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d: Option<f64>,
    /// `lgs`: adaptation rates of k_p, k_i, k_d; zero switches one off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nu: Option<[f64; 3]>,
    /// `lgs`: proportional reaching rate, 1/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alpha: Option<f64>,
    /// `lgs`: switching gain, in units of s per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beta: Option<f64>,
    /// `lgs`: boundary-layer width, in units of s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eps: Option<f64>,
    /// `lgs`: slope of s = e' + lambda e, 1/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambda: Option<f64>,
    /// `lgs`: half-width of the dead zone, in units of s per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dead_zone: Option<f64>,
    /// `lgs`: leak towards the starting gains, 1/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leak_1_s: Option<f64>,
    /// `lgs`: command scale of the normalisation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// `raw`: the rows of Table 2 for k_p, k_i, k_d.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub raw: Option<[RawRow; 3]>,
}

/// A row of the paper's Table 2, complete.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawRow {
    /// Proportional reaching rate, 1/s.
    pub alpha: f64,
    /// Boundary-layer width.
    pub eps: f64,
    /// Switching gain.
    pub beta: f64,
    /// Adaptation rate.
    pub nu: f64,
    /// Slope of this gain's s, 1/s.
    pub lambda: f64,
}

/// Gains of roll or pitch.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AttitudeKeys {
    /// k_p, N m/rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p: Option<f64>,
    /// k_i, N m/(rad s).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub i: Option<f64>,
    /// k_d, N m s/rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d: Option<f64>,
}

/// Puts a given key in the place of a core value.
fn put(place: &mut f32, key: Option<f64>) {
    if let Some(value) = key {
        *place = value as f32;
    }
}

impl AxisKeys {
    fn apply(&self, axis: &mut AxisConfig) {
        for (place, key) in axis.k0.iter_mut().zip([self.p, self.i, self.d]) {
            put(place, key);
        }
        let lgs = &mut axis.lgs;
        for (place, key) in lgs.nu.iter_mut().zip(self.nu.into_iter().flatten()) {
            put(place, Some(key));
        }
        put(&mut lgs.alpha, self.alpha);
        put(&mut lgs.beta, self.beta);
        put(&mut lgs.eps, self.eps);
        put(&mut lgs.lambda, self.lambda);
        put(&mut lgs.dead_zone, self.dead_zone);
        put(&mut lgs.leak_1_s, self.leak_1_s);
        put(&mut lgs.scale, self.scale);
        for (place, row) in axis.raw.iter_mut().zip(self.raw.into_iter().flatten()) {
            *place = RawGains {
                alpha: row.alpha as f32,
                eps: row.eps as f32,
                beta: row.beta as f32,
                nu: row.nu as f32,
                lambda: row.lambda as f32,
            };
        }
    }
}

impl AttitudeKeys {
    fn apply(&self, gains: &mut AttitudeGains) {
        put(&mut gains.kp, self.p);
        put(&mut gains.ki, self.i);
        put(&mut gains.kd, self.d);
    }
}

impl GainKeys {
    fn apply(&self, gains: &mut Gains) {
        for (keys, axis) in
            [(&self.x, &mut gains.x), (&self.y, &mut gains.y), (&self.z, &mut gains.z), (&self.psi, &mut gains.psi)]
        {
            if let Some(keys) = keys {
                keys.apply(axis);
            }
        }
        for (keys, axis) in [(&self.phi, &mut gains.phi), (&self.theta, &mut gains.theta)] {
            if let Some(keys) = keys {
                keys.apply(axis);
            }
        }
    }

    /// Every number that is given, by its path below `gains`; a NaN is NaN.
    pub fn values(&self) -> Vec<(String, f64)> {
        let mut values = Vec::new();
        let tree = serde_json::to_value(self).unwrap_or_default();
        collect_numbers(String::new(), &tree, &mut values);
        values
    }
}

fn collect_numbers(path: String, value: &Value, values: &mut Vec<(String, f64)>) {
    match value {
        Value::Object(map) => {
            for (key, value) in map {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                collect_numbers(path, value, values);
            }
        }
        Value::Array(items) => {
            for (i, value) in items.iter().enumerate() {
                collect_numbers(format!("{path}[{i}]"), value, values);
            }
        }
        // Left-out keys are not in the tree, and JSON has no other word for NaN.
        other => values.push((path, other.as_f64().unwrap_or(f64::NAN))),
    }
}

impl ControllerName {
    /// What the project is about, in the order of tables: what is compared unless the command line says otherwise.
    pub const MAIN: [Self; 4] = [Self::Pid, Self::Raw, Self::Lgs, Self::Default];

    /// Who flies a suite of faults unless the command line says otherwise: the one that flies, one that knows, one that learns only.
    pub const TOLERANT: [Self; 3] = [Self::Default, Self::Oracle, Self::Lgs];

    /// What this controller flies with in `scenario`.
    pub fn config(self, scenario: &Scenario) -> Config {
        let law = match self {
            Self::Pid | Self::Indi | Self::Lqi | Self::PidOpt | Self::Oracle => Law::Pid,
            Self::Raw => Law::Raw,
            Self::Default | Self::Lgs | Self::LgsIndi => Law::Lgs,
        };
        let airframe = scenario.vehicle().airframe();
        let mut config = match scenario.plant {
            // Only these two are the paper's; the others bring their own cascade, with the weight on the integral.
            PlantKind::Paper if matches!(self, Self::Pid | Self::Raw) => Config::paper(law, airframe),
            PlantKind::Paper | PlantKind::Rigid => Config::flight(law, airframe),
        };
        match self {
            Self::Default => config = Config::tolerant(airframe),
            Self::Oracle => config.rotors = Some(RotorsConfig::TOLD),
            Self::Indi | Self::LgsIndi => config.rotors = Some(RotorsConfig::INCREMENTAL),
            Self::Lqi => config.gains = Gains::lqi(&airframe),
            Self::PidOpt => config.gains = Gains::optimised(&airframe),
            Self::Pid | Self::Raw | Self::Lgs => {}
        }
        config.yaw_turns_thrust = scenario.plant == PlantKind::Rigid;
        config.control_hz = scenario.control_hz() as f32;
        if let Some(keys) = scenario.controllers.get(&self) {
            keys.gains.apply(&mut config.gains);
        }
        config
    }
}

/// The gains of a configuration, for reports: what flew, not what was asked for.
pub fn gains_json(config: &Config) -> Value {
    // Shortest decimal that gives the f32 back.
    let f = |x: f32| -> f64 { x.to_string().parse().unwrap_or(f64::NAN) };
    let axis = |axis: &AxisConfig| {
        let [p, i, d] = axis.k0.map(f);
        let mut value = json!({"p": p, "i": i, "d": d});
        let lgs = &axis.lgs;
        match config.law {
            Law::Pid => {}
            Law::Lgs => {
                value["lgs"] = json!({
                    "nu": lgs.nu.map(f), "alpha": f(lgs.alpha), "beta": f(lgs.beta), "eps": f(lgs.eps),
                    "lambda": f(lgs.lambda), "dead_zone": f(lgs.dead_zone), "leak_1_s": f(lgs.leak_1_s),
                    "scale": f(lgs.scale),
                });
            }
            Law::Raw => {
                value["raw"] = axis
                    .raw
                    .iter()
                    .map(|row| {
                        json!({"alpha": f(row.alpha), "eps": f(row.eps), "beta": f(row.beta),
                               "nu": f(row.nu), "lambda": f(row.lambda)})
                    })
                    .collect();
            }
        }
        value
    };
    let attitude = |gains: &AttitudeGains| json!({"p": f(gains.kp), "i": f(gains.ki), "d": f(gains.kd)});
    let gains = &config.gains;
    json!({
        "cascade": match config.cascade { Cascade::Paper => "paper", Cascade::Flight => "flight" },
        "x": axis(&gains.x), "y": axis(&gains.y), "z": axis(&gains.z), "psi": axis(&gains.psi),
        "phi": attitude(&gains.phi), "theta": attitude(&gains.theta),
        "rotors": config.rotors.map(|rotors| json!({"motor_lag_s": f(rotors.motor_lag_s), "filter_hz": f(rotors.filter_hz)})),
    })
}
