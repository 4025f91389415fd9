//! The range of every key; those of faults are in `faults.rs`.
use super::Scenario;
use crate::controllers::ControllerKeys;
use crate::plant::PlantKind;
use crate::reference::Reference;
use crate::vehicle::VehicleKeys;

/// A value out of its range.
pub(super) struct Wrong {
    pub(super) key: String,
    pub(super) value: String,
    pub(super) allowed: String,
}

/// Why the plant `paper` refuses a key.
const NOT_IN_PAPER: &str = "left out with the plant `paper`, which knows neither wind, ground nor drag";

pub(super) type Check = Result<(), Wrong>;

/// Refuses a number outside `low..=high`; NaN is outside.
pub(super) fn range(key: &str, value: f64, low: f64, high: f64) -> Check {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Wrong { key: key.to_owned(), value: value.to_string(), allowed: format!("a number from {low} to {high}") })
}

pub(super) fn refuse(key: &str, value: impl std::fmt::Display, allowed: &str) -> Check {
    Err(Wrong { key: key.to_owned(), value: value.to_string(), allowed: allowed.to_owned() })
}

/// Smallest and largest thrust-to-weight ratio that is flown.
pub const THRUST_TO_WEIGHT: (f64, f64) = (1.05, 20.0);
/// Farthest setpoint, m.
const POSITION_M_MAX: f64 = 1000.0;
/// Longest flight: two hours, whose log at 100 rows a second still fits in memory, s.
const DURATION_S_MAX: f64 = 7200.0;
/// Latest news of an oracle, s.
const ORACLE_DELAY_S_MAX: f64 = 10.0;
/// A hundred turns, rad.
const YAW_RAD_MAX: f64 = 628.0;

impl Scenario {
    /// Refuses the first key that is out of its range.
    pub(super) fn check(&self) -> Check {
        range("duration_s", self.duration_s, 0.1, DURATION_S_MAX)?;
        range("control_hz", self.control_hz(), 50.0, 8000.0)?;
        range("plant_steps", f64::from(self.plant_steps), 1.0, 1000.0)?;
        if let Some(altitude_m) = self.ground_altitude_m {
            let highest = self.reference.start_altitude_m() - 0.1;
            range("ground_altitude_m", altitude_m, -POSITION_M_MAX, highest)?;
        }
        range("oracle_delay_s", self.oracle_delay_s, 0.0, ORACLE_DELAY_S_MAX)?;
        self.check_preflight()?;
        self.check_vehicle()?;
        self.check_reference()?;
        self.check_noise_and_wind()?;
        self.check_faults()?;
        self.check_sensors()?;
        self.check_autopilot()?;
        for (name, keys) in &self.controllers {
            check_gains(&format!("controllers.{name}.gains"), keys)?;
        }
        self.check_paper()
    }

    /// The wiring is checked on feet that stand on something.
    fn check_preflight(&self) -> Check {
        if self.preflight && self.plant == PlantKind::Paper {
            return refuse("preflight", true, "false with the plant `paper`, which has no ground to stand on");
        }
        if self.preflight && self.ground_altitude_m.is_none() {
            return refuse("preflight", true, "false without ground_altitude_m: there is nothing to stand on");
        }
        Ok(())
    }

    fn check_vehicle(&self) -> Check {
        let VehicleKeys {
            thrust_to_weight,
            motor_lag_s,
            frame: _,
            mass_kg,
            inertia_kg_m2,
            arm_m,
            rotor_inertia_kg_m2,
            linear_drag_n_s_m,
            yaw_drag_n_m_s,
        } = self.vehicle;
        range("vehicle.thrust_to_weight", thrust_to_weight, THRUST_TO_WEIGHT.0, THRUST_TO_WEIGHT.1)?;
        range("vehicle.motor_lag_s", motor_lag_s, 0.0, 1.0)?;
        if motor_lag_s > 0.0 && motor_lag_s < 0.5 / (self.control_hz() * f64::from(self.plant_steps)) {
            return refuse("vehicle.motor_lag_s", motor_lag_s, "0, or at least half a plant step: raise plant_steps");
        }
        range("vehicle.mass_kg", mass_kg.unwrap_or(1.0), 0.01, 100.0)?;
        for (i, inertia) in inertia_kg_m2.into_iter().flatten().enumerate() {
            range(&format!("vehicle.inertia_kg_m2[{i}]"), inertia, 1e-6, 100.0)?;
        }
        range("vehicle.arm_m", arm_m.unwrap_or(1.0), 0.02, 5.0)?;
        range("vehicle.rotor_inertia_kg_m2", rotor_inertia_kg_m2, 0.0, 0.1)?;
        range("vehicle.linear_drag_n_s_m", linear_drag_n_s_m, 0.0, 100.0)?;
        range("vehicle.yaw_drag_n_m_s", yaw_drag_n_m_s, 0.0, 10.0)
    }

    fn check_reference(&self) -> Check {
        let point = |key: &str, position_m: [f64; 3], yaw_rad: f64| {
            for (i, x) in position_m.into_iter().enumerate() {
                range(&format!("{key}.position_m[{i}]"), x, -POSITION_M_MAX, POSITION_M_MAX)?;
            }
            range(&format!("{key}.yaw_rad"), yaw_rad, -YAW_RAD_MAX, YAW_RAD_MAX)
        };
        match &self.reference {
            Reference::Hover(hover) => {
                range("reference.hover.altitude_m", hover.altitude_m, -POSITION_M_MAX, POSITION_M_MAX)
            }
            Reference::Step(step) => {
                range("reference.step.at_s", step.at_s, 0.0, self.duration_s)?;
                point("reference.step", step.position_m, step.yaw_rad)
            }
            Reference::Helix(helix) => {
                range("reference.helix.at_s", helix.at_s, 0.0, self.duration_s)?;
                range("reference.helix.radius_m", helix.radius_m, 0.1, POSITION_M_MAX)?;
                range("reference.helix.speed_m_s", helix.speed_m_s, 0.0, 30.0)?;
                range("reference.helix.climb_m_s", helix.climb_m_s, -10.0, 10.0)?;
                range("reference.helix.blend_s", helix.blend_s, 0.1, DURATION_S_MAX)
            }
            Reference::Weave(weave) => {
                range("reference.weave.at_s", weave.at_s, 0.0, self.duration_s)?;
                range("reference.weave.altitude_m", weave.altitude_m, -POSITION_M_MAX, POSITION_M_MAX)?;
                range("reference.weave.tilt_rad", weave.tilt_rad, 0.0, 0.45)?;
                range("reference.weave.frequency_hz", weave.frequency_hz, 0.05, 5.0)?;
                range("reference.weave.direction_rad", weave.direction_rad, -YAW_RAD_MAX, YAW_RAD_MAX)?;
                range("reference.weave.blend_s", weave.blend_s, 0.1, DURATION_S_MAX)
            }
            Reference::Waypoints(points) => {
                let mut earliest_s = 0.0;
                for (i, waypoint) in points.iter().enumerate() {
                    let key = format!("reference.waypoints[{i}]");
                    range(&format!("{key}.at_s"), waypoint.at_s, earliest_s, self.duration_s)?;
                    point(&key, waypoint.position_m, waypoint.yaw_rad)?;
                    earliest_s = waypoint.at_s;
                }
                Ok(())
            }
        }
    }

    fn check_noise_and_wind(&self) -> Check {
        let noise = &self.noise;
        range("noise.position_m", noise.position_m, 0.0, 100.0)?;
        range("noise.velocity_m_s", noise.velocity_m_s, 0.0, 100.0)?;
        range("noise.attitude_rad", noise.attitude_rad, 0.0, 1.0)?;
        range("noise.rate_rad_s", noise.rate_rad_s, 0.0, 100.0)?;
        range("noise.acceleration_m_s2", noise.acceleration_m_s2, 0.0, 100.0)?;
        let wind = &self.wind;
        for (i, mean) in wind.mean_ned_m_s.into_iter().enumerate() {
            range(&format!("wind.mean_ned_m_s[{i}]"), mean, -50.0, 50.0)?;
        }
        range("wind.gust_rms_n", wind.gust_rms_n, 0.0, 100.0)?;
        range("wind.gust_time_constant_s", wind.gust_time_constant_s, 0.01, 1000.0)?;
        range("wind.gust_vertical_share", wind.gust_vertical_share, 0.0, 1.0)?;
        range("wind.torque_rms_nm", wind.torque_rms_nm, 0.0, 100.0)?;
        range("wind.torque_time_constant_s", wind.torque_time_constant_s, 0.01, 1000.0)?;
        if wind.mean_ned_m_s != [0.0; 3] && self.vehicle.linear_drag_n_s_m == 0.0 {
            let value = format!("{:?}", wind.mean_ned_m_s);
            return refuse(
                "wind.mean_ned_m_s",
                value,
                "zero while vehicle.linear_drag_n_s_m is 0: it would do nothing",
            );
        }
        Ok(())
    }

    /// The plant `paper` has no air, no ground and no motors: a key about them would be silently without effect.
    fn check_paper(&self) -> Check {
        if self.plant != PlantKind::Paper {
            return Ok(());
        }
        if self.wind.gust_rms_n != 0.0 {
            return refuse("wind.gust_rms_n", self.wind.gust_rms_n, NOT_IN_PAPER);
        }
        if self.wind.torque_rms_nm != 0.0 {
            return refuse("wind.torque_rms_nm", self.wind.torque_rms_nm, NOT_IN_PAPER);
        }
        if self.vehicle.linear_drag_n_s_m != 0.0 {
            return refuse("vehicle.linear_drag_n_s_m", self.vehicle.linear_drag_n_s_m, NOT_IN_PAPER);
        }
        if let Some(altitude_m) = self.ground_altitude_m {
            return refuse("ground_altitude_m", altitude_m, NOT_IN_PAPER);
        }
        Ok(())
    }
}

/// Gains are positive; the adaptation may be switched off by zeros.
fn check_gains(key: &str, keys: &ControllerKeys) -> Check {
    for (name, value) in keys.gains.values() {
        let low = if name.contains(".nu[") || name.ends_with(".dead_zone") || name.ends_with(".leak_1_s") {
            0.0
        } else {
            1e-4
        };
        range(&format!("{key}.{name}"), value, low, 1e4)?;
    }
    Ok(())
}
