//! `[autopilot]` and `[[event]]`: a flight from the ground with the whole flight logic, and what happens to it from outside.
//!
//! Without `[autopilot]` a flight begins in a hover and the controller follows the reference. With it the machine stands on the
//! ground, disarmed, and does what the pilot says; the reference is what a companion computer sends while `offboard` holds.
use super::Scenario;
use super::check::{Check, Wrong, range, refuse};
use crate::plant::PlantKind;
use control_core::modes::Mode;
use control_core::parameters::Parameters;
use control_core::pilot::{PilotInput, Sticks};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// `[autopilot]`.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AutopilotKeys {
    /// Parameters that differ from their defaults, by name: see `sim-host params`.
    pub parameters: BTreeMap<String, f64>,
}

/// Modes by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ModeName {
    /// Sticks are body rates and thrust.
    Rate,
    /// Sticks are tilt, yaw rate and thrust.
    Angle,
    /// Sticks are tilt, yaw rate and climb rate.
    AltitudeHold,
    /// Sticks are velocity and yaw rate.
    PositionHold,
    /// Follows the reference.
    Offboard,
    /// Climbs straight up, then holds.
    TakeOff,
    /// Climbs, flies home, lands.
    Return,
    /// Comes straight down.
    Land,
    /// Comes down level.
    Descend,
}

impl From<ModeName> for Mode {
    fn from(name: ModeName) -> Self {
        match name {
            ModeName::Rate => Self::Rate,
            ModeName::Angle => Self::Angle,
            ModeName::AltitudeHold => Self::AltitudeHold,
            ModeName::PositionHold => Self::PositionHold,
            ModeName::Offboard => Self::Offboard,
            ModeName::TakeOff => Self::TakeOff,
            ModeName::Return => Self::Return,
            ModeName::Land => Self::Land,
            ModeName::Descend => Self::Descend,
        }
    }
}

/// `[[event]]`: what holds from `at_s` on. What is left out stays as it was; at the start the pilot is heard, disarmed in `angle` with
/// the sticks in their middle and the throttle down, and the board is well.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// When, s.
    pub at_s: f64,
    /// The arm switch.
    pub arm: Option<bool>,
    /// The mode switch.
    pub mode: Option<ModeName>,
    /// Stick to the right, −1 to 1.
    pub right: Option<f64>,
    /// Stick forward, −1 to 1.
    pub forward: Option<f64>,
    /// Stick clockwise, −1 to 1.
    pub clockwise: Option<f64>,
    /// Throttle, 0 to 1.
    pub throttle: Option<f64>,
    /// Whether the pilot is heard.
    pub link: Option<bool>,
    /// Whether a companion computer sends the reference.
    pub offboard: Option<bool>,
    /// Whether each control step comes late.
    pub late: Option<bool>,
    /// Whether somebody rocks the machine by hand, to and fro about its forward axis.
    pub rocked: Option<bool>,
    /// Whether the gyro's bias is known.
    pub gyro_calibrated: Option<bool>,
    /// Whether the self-tests have passed.
    pub self_test_passed: Option<bool>,
    /// Whether the stored parameters were in their ranges.
    pub parameters_valid: Option<bool>,
    /// True: the wiring check begins now.
    pub check_wiring: Option<bool>,
}

impl Event {
    /// Takes over what `later` says.
    pub(crate) fn take(&mut self, later: &Self) {
        macro_rules! take {
            ($($key:ident),+) => { $(self.$key = later.$key.or(self.$key);)+ };
        }
        take!(arm, mode, right, forward, clockwise, throttle, link, offboard, late);
        take!(rocked, gyro_calibrated, self_test_passed, parameters_valid);
    }

    /// What the pilot says.
    pub(crate) fn pilot(&self) -> PilotInput {
        let stick = |x: Option<f64>| x.unwrap_or(0.0) as f32;
        let sticks = Sticks {
            right: stick(self.right),
            forward: stick(self.forward),
            clockwise: stick(self.clockwise),
            throttle: stick(self.throttle),
        };
        PilotInput { sticks, arm: self.arm == Some(true), mode: self.mode.map_or(Mode::Angle, Mode::from) }
    }
}

impl AutopilotKeys {
    /// The parameters, or the name, value and range of the first that cannot be.
    pub(crate) fn values(&self) -> Result<Parameters, (String, f64, String)> {
        let mut values = Parameters::default();
        for (name, &value) in &self.parameters {
            values.set(name, value as f32).map_err(|error| (name.clone(), value, error.to_string()))?;
        }
        Ok(values)
    }
}

impl Scenario {
    /// Refuses the first key of the flight logic that makes no sense.
    pub(super) fn check_autopilot(&self) -> Check {
        let Some(keys) = &self.autopilot else {
            return match self.event.first() {
                Some(event) => refuse("event[0].at_s", event.at_s, "left out without a table [autopilot]"),
                None => Ok(()),
            };
        };
        if self.plant == PlantKind::Paper || self.ground_altitude_m.is_none() {
            return refuse(
                "autopilot",
                "a table",
                "left out without ground to start from: plant = \"rigid\", ground_altitude_m",
            );
        }
        keys.values().map_err(|(name, value, allowed)| Wrong {
            key: format!("autopilot.parameters.{name}"),
            value: value.to_string(),
            allowed: format!("a parameter of `sim-host params` in its range ({allowed})"),
        })?;
        for (i, event) in self.event.iter().enumerate() {
            let key = |name: &str| format!("event[{i}].{name}");
            let earliest_s = if i == 0 { 0.0 } else { self.event[i - 1].at_s };
            range(&key("at_s"), event.at_s, earliest_s, self.duration_s)?;
            for (name, stick, low) in [
                ("right", event.right, -1.0),
                ("forward", event.forward, -1.0),
                ("clockwise", event.clockwise, -1.0),
                ("throttle", event.throttle, 0.0),
            ] {
                range(&key(name), stick.unwrap_or(0.0), low, 1.0)?;
            }
        }
        Ok(())
    }
}
