//! Sensors and sensor faults that make no sense: out of range, of parts that are not there, or together.
use super::Scenario;
use super::check::{Check, Wrong, range, refuse};
use crate::aboard::estimator;
use crate::fault::sensors::{Sensor, SensorFault};
use crate::sensors::Calibration;
use crate::sensors::{Each, SensorKeys};
use std::f64::consts::{FRAC_PI_2, PI};

impl Scenario {
    /// Refuses the first key of the sensors, or the first of their faults, that makes no sense.
    pub(super) fn check_sensors(&self) -> Check {
        if let Some(keys) = &self.sensors {
            self.check_sensor_keys(keys)?;
            estimator(keys, self.control_hz(), &Calibration::NONE).map_err(|error| Wrong {
                key: "sensors".to_owned(),
                value: error.to_string(),
                allowed: "what the estimator can fly with".to_owned(),
            })?;
        }
        for (i, fault) in self.sensor_fault.iter().enumerate() {
            let key = format!("sensor_fault[{i}]");
            fault.check().map_err(|wrong| Wrong {
                key: format!("{key}.{}", wrong.key),
                value: wrong.value.to_string(),
                allowed: wrong.allowed.to_string(),
            })?;
            range(&format!("{key}.from_s"), fault.from_s, 0.0, self.duration_s)?;
            self.check_carried(&key, fault)?;
            let earlier = self.sensor_fault[..i].iter().position(|other| other.contends(fault));
            if let Some(j) = earlier {
                let other = self.sensor_fault[j].kind.name().as_str();
                let allowed = format!("at another time or on another axis than sensor_fault[{j}], `{other}`");
                return refuse(&format!("{key}.kind"), fault.kind.name().as_str(), &allowed);
            }
        }
        Ok(())
    }

    fn check_sensor_keys(&self, keys: &SensorKeys) -> Check {
        if keys.flown && keys.imu.is_none() {
            return refuse("sensors.flown", true, "false without an imu: there is nothing to estimate a motion from");
        }
        range("sensors.imus", f64::from(keys.imus), 1.0, 2.0)?;
        range("sensors.baros", f64::from(keys.baros), 1.0, 2.0)?;
        let fastest_hz = self.control_hz();
        for (table, each, low, high) in [
            ("rate_hz", &keys.rate_hz, 0.1, fastest_hz),
            ("latency_s", &keys.latency_s, 0.0, 2.0),
            ("noise", &keys.noise, 0.0, 1000.0),
        ] {
            check_each(table, each, keys, (low, high))?;
        }
        range("sensors.earth.field_ut", keys.earth.field_ut, 1.0, 100.0)?;
        range("sensors.earth.inclination_rad", keys.earth.inclination_rad, -FRAC_PI_2, FRAC_PI_2)?;
        range("sensors.earth.declination_rad", keys.earth.declination_rad, -PI, PI)?;
        range("sensors.sky.multipath", keys.sky.multipath, 0.0, 100.0)?;
        range("sensors.sky.outage_rate_1_s", keys.sky.outage_rate_1_s, 0.0, 10.0)?;
        range("sensors.sky.outage_s", keys.sky.outage_s, 0.01, 3600.0)?;
        range("sensors.light_lux", keys.light_lux, 0.0, 150_000.0)?;
        range("sensors.texture", keys.texture, 0.0, 1.0)?;
        for (i, ut_a) in keys.mag_ut_per_a.into_iter().enumerate() {
            range(&format!("sensors.mag_ut_per_a[{i}]"), ut_a, -100.0, 100.0)?;
        }
        range("sensors.hover_a", keys.hover_a, 0.0, 500.0)?;
        range("sensors.ground_effect_pa", keys.ground_effect_pa, -1000.0, 1000.0)?;
        range("sensors.static_port", keys.static_port, -1.0, 1.0)?;
        range("sensors.rotor_unbalance_kg_m", keys.rotor_unbalance_kg_m, 0.0, 0.01)?;
        if let Some(battery) = keys.battery {
            range("sensors.battery.cells", f64::from(battery.cells), 1.0, 8.0)?;
            range("sensors.battery.capacity_ah", battery.capacity_ah, 0.01, 100.0)?;
            range("sensors.battery.charge", battery.charge, 0.0, 1.0)?;
            range("sensors.battery.resistance_ohm", battery.resistance_ohm, 0.0, 10.0)?;
        }
        Ok(())
    }

    /// A sensor that is not there has no faults.
    fn check_carried(&self, key: &str, fault: &SensorFault) -> Check {
        let allowed = "a sensor that [sensors] names";
        let name = fault.sensor.as_str();
        let Some(keys) = &self.sensors else { return refuse(&format!("{key}.sensor"), name, allowed) };
        let units = keys.units(fault.sensor);
        if units == 0 {
            return refuse(&format!("{key}.sensor"), name, allowed);
        }
        range(&format!("{key}.unit"), f64::from(fault.unit), 1.0, f64::from(units))
    }
}

/// A number for a part that is not there would be silently without effect.
fn check_each(table: &str, each: &Each, keys: &SensorKeys, (low, high): (f64, f64)) -> Check {
    for (name, value) in each.given() {
        let key = format!("sensors.{table}.{name}");
        if !keys.carries(name) {
            return refuse(&key, value, &format!("left out without sensors.{name}"));
        }
        range(&key, value, low, high)?;
    }
    Ok(())
}

impl SensorKeys {
    /// How many of a sensor there are.
    fn units(&self, sensor: Sensor) -> u8 {
        match sensor {
            Sensor::Gyro | Sensor::Accelerometer => self.imu.map_or(0, |_| self.imus),
            Sensor::Baro => self.baro.map_or(0, |_| self.baros),
            other => u8::from(self.carries(other.as_str())),
        }
    }

    /// Whether the key of this name is given.
    fn carries(&self, name: &str) -> bool {
        match name {
            "imu" => self.imu.is_some(),
            "baro" => self.baro.is_some(),
            "mag" => self.mag.is_some(),
            "gnss" => self.gnss.is_some(),
            "range" => self.range.is_some(),
            "flow" => self.flow.is_some(),
            "vision" => self.vision.is_some(),
            "rotor_speed" => self.rotor_speed.is_some(),
            "battery" => self.battery.is_some(),
            _ => false,
        }
    }
}
