//! Faults that make no sense: by themselves, on this machine, or together.
use super::Scenario;
use super::check::{Check, Wrong, range, refuse};
use crate::fault::{Fault, FaultKind};
use crate::plant::PlantKind;

impl Scenario {
    /// Refuses the first fault that makes no sense.
    pub(super) fn check_faults(&self) -> Check {
        for (i, fault) in self.fault.iter().enumerate() {
            let key = format!("fault[{i}]");
            fault.check().map_err(|wrong| Wrong {
                key: format!("{key}.{}", wrong.key),
                value: wrong.value.to_string(),
                allowed: wrong.allowed.to_string(),
            })?;
            range(&format!("{key}.from_s"), fault.from_s, 0.0, self.duration_s)?;
            self.check_wiring(&key, fault)?;
            self.check_machine(&key, fault)?;
            self.check_takeover(&key, fault, &self.fault[..i])?;
        }
        Ok(())
    }

    /// Wires are not swapped in flight.
    fn check_wiring(&self, key: &str, fault: &Fault) -> Check {
        if fault.kind != FaultKind::Swapped {
            return Ok(());
        }
        if fault.from_s != 0.0 {
            return refuse(&format!("{key}.from_s"), fault.from_s, "0 with the kind `swapped`, which is wiring");
        }
        if fault.until_s < self.duration_s {
            let allowed = "duration_s or later with the kind `swapped`, which is wiring";
            return refuse(&format!("{key}.until_s"), fault.until_s, allowed);
        }
        Ok(())
    }

    /// What this machine's motors can do, and whether it has any.
    fn check_machine(&self, key: &str, fault: &Fault) -> Check {
        if self.plant == PlantKind::Paper && fault.kind.needs_motor() {
            let allowed = "loss_of_effectiveness or swapped with the plant `paper`, which has no motors";
            return refuse(&format!("{key}.kind"), fault.kind.name(), allowed);
        }
        let vehicle = self.vehicle();
        let lag_s = vehicle.motor_lag_s;
        match fault.kind {
            FaultKind::Stuck { thrust_n: Some(thrust_n) } => {
                range(&format!("{key}.thrust_n"), thrust_n, 0.0, vehicle.thrust_n_max())
            }
            FaultKind::Floating { spin_down_s } if spin_down_s < lag_s => {
                let allowed =
                    format!("at least vehicle.motor_lag_s, {lag_s}: a rotor that is not driven is no quicker");
                refuse(&format!("{key}.spin_down_s"), spin_down_s, &allowed)
            }
            FaultKind::SlowMotor { lag_factor, rate_n_s_max: None } if lag_s == 0.0 => {
                let allowed = "left to motors with a lag: vehicle.motor_lag_s is 0; or give rate_n_s_max";
                refuse(&format!("{key}.lag_factor"), lag_factor, allowed)
            }
            FaultKind::CommandDelay { delay_s } => self.check_delay(&format!("{key}.delay_s"), delay_s),
            FaultKind::CommandJitter { delay_s_max } => self.check_delay(&format!("{key}.delay_s_max"), delay_s_max),
            _ => Ok(()),
        }
    }

    /// Delays are in whole control periods: a shorter one would do nothing.
    fn check_delay(&self, key: &str, delay_s: f64) -> Check {
        range(key, delay_s, 1.0 / self.control_hz(), 1.0)
    }

    /// A rotor's thrust is taken over by one fault at a time.
    fn check_takeover(&self, key: &str, fault: &Fault, earlier: &[Fault]) -> Check {
        if !fault.kind.takes_over() {
            return Ok(());
        }
        match earlier.iter().position(|other| other.kind.takes_over() && other.overlaps(fault)) {
            None => Ok(()),
            Some(j) => {
                let other = self.fault[j].kind.name();
                let allowed =
                    format!("on other rotors or at another time than fault[{j}], `{other}`: a rotor does one of them");
                refuse(&format!("{key}.kind"), fault.kind.name(), &allowed)
            }
        }
    }
}
