//! Scenarios that the flight image can fly: what of one cannot pass through a board's pins is refused.
use super::check::{Check, Wrong, refuse};
use super::{Event, ModeName, Scenario, ScenarioError};
use crate::controllers::ControllerName;
use crate::fault::sensors::{Sensor, SensorFaultKind};
use crate::sensors::ImuPart;
use control_core::Airframe;
use firmware::flight::THRUST_TO_WEIGHT;
use firmware::icm42688::SAMPLE_HZ;
use std::path::Path;

impl Scenario {
    /// The same flight for the image, with a tick at each of its inertial samples; `file` is named in errors.
    ///
    /// # Errors
    /// [`ScenarioError::OutOfRange`] names the first key that cannot pass to the board.
    pub fn for_image(&self, file: &Path) -> Result<Self, ScenarioError> {
        self.check_image().map_err(|Wrong { key, value, allowed }| ScenarioError::OutOfRange {
            file: file.to_owned(),
            key,
            value,
            allowed: format!("{allowed} (--through emulator)"),
        })?;
        // With one step of the plant in each tick, which is shorter than the steps of other flights.
        Ok(Self { control_hz: Some(SAMPLE_HZ.into()), plant_steps: 1, ..self.clone() })
    }

    fn check_image(&self) -> Check {
        let Some(autopilot) = &self.autopilot else {
            return refuse("autopilot", "nothing", "a table: the image begins on the ground");
        };
        let calibrates = |name: &str| ["ACC_", "MAG_"].iter().any(|part| name.starts_with(part));
        if let Some((name, value)) = autopilot.parameters.iter().find(|(name, _)| calibrates(name)) {
            let allowed = "left out: what the image is shown is calibrated";
            return refuse(&format!("autopilot.parameters.{name}"), value, allowed);
        }
        let name = ControllerName::Default;
        if self.controllers.contains_key(&name) {
            return refuse(&format!("controllers.{name}"), "a table", "left out: the image has its own gains");
        }
        if self.vehicle().airframe() != Airframe::paper(THRUST_TO_WEIGHT) {
            let allowed =
                format!("what the image is built for, the airframe `paper` with thrust_to_weight {THRUST_TO_WEIGHT}");
            return refuse("vehicle", "another machine", &allowed);
        }
        if let Some(hz) = self.control_hz {
            return refuse("control_hz", hz, "left out: the image has its own");
        }
        if self.preflight {
            return refuse("preflight", true, "left out: no test of the motors can be asked for over the radio");
        }
        self.check_image_sensors()?;
        self.event.iter().enumerate().try_for_each(|(i, event)| check_event(&format!("event[{i}]"), event))
    }

    fn check_image_sensors(&self) -> Check {
        let Some(keys) = self.sensors.as_ref().filter(|keys| keys.flown) else {
            return refuse("sensors.flown", false, "true: the image is shown no truth");
        };
        if keys.imu != Some(ImuPart::Icm42688p) {
            return refuse("sensors.imu", "another part", "\"icm42688p\", which is on the board");
        }
        if keys.baro.is_none() {
            return refuse("sensors.baro", "nothing", "a part: the board carries one, and does not arm without");
        }
        for (key, there, value, allowed) in [
            ("sensors.imus", keys.imus > 1, "2", "1: there is one on the board"),
            ("sensors.baros", keys.baros > 1, "2", "1: there is one on the board"),
            ("sensors.range", keys.range.is_some(), "a part", "left out: there is none on the board"),
            ("sensors.flow", keys.flow.is_some(), "a part", "left out: there is none on the board"),
        ] {
            if there {
                return refuse(key, value, allowed);
            }
        }
        for (i, fault) in self.sensor_fault.iter().enumerate() {
            let by_itself = matches!(fault.sensor, Sensor::Gyro | Sensor::Accelerometer | Sensor::RotorSpeed);
            if by_itself && matches!(fault.kind, SensorFaultKind::Off | SensorFaultKind::Intermittent { .. }) {
                let allowed = "one of the others: what is emulated of it speaks by itself";
                return refuse(&format!("sensor_fault[{i}].kind"), fault.kind.name().as_str(), allowed);
            }
        }
        Ok(())
    }
}

/// Refuses what the radio cannot say, and what the board decides itself.
fn check_event(key: &str, event: &Event) -> Check {
    let Event { mode, offboard, gyro_calibrated, self_test_passed, parameters_valid, check_wiring, .. } = *event;
    match mode {
        Some(mode @ (ModeName::Rate | ModeName::Offboard | ModeName::Land | ModeName::Descend)) => {
            let allowed = "one that the radio's switches have: angle, altitude_hold, position_hold, take_off, return";
            return refuse(&format!("{key}.mode"), control_core::modes::Mode::from(mode), allowed);
        }
        Some(
            ModeName::Angle | ModeName::AltitudeHold | ModeName::PositionHold | ModeName::TakeOff | ModeName::Return,
        )
        | None => {}
    }
    for (name, fact) in [
        ("offboard", offboard),
        ("gyro_calibrated", gyro_calibrated),
        ("self_test_passed", self_test_passed),
        ("parameters_valid", parameters_valid),
        ("check_wiring", check_wiring),
    ] {
        if let Some(value) = fact {
            return refuse(&format!("{key}.{name}"), value, "left out: the radio does not carry it");
        }
    }
    Ok(())
}
