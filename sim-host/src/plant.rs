//! The machine and its world, in f64: what the controller does not know.
//!
//! Both plants take rotor thrusts and give a [`Truth`]. World NED, body FRD, SI.
use crate::actuators::Drive;
use crate::ground::Ground;
use crate::vehicle::Vehicle;
use crate::wind::Gust;
use nalgebra::{Matrix3, SVector, Vector3};

mod paper;
mod rigid;

pub use paper::PaperPlant;
pub use rigid::RigidPlant;

/// Everything about the machine at one instant, without error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// NED, m.
    pub position_m: Vector3<f64>,
    /// NED, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Body to NED.
    pub attitude: Matrix3<f64>,
    /// Body rates, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Body, m/s²: acceleration less gravity.
    pub specific_force_m_s2: Vector3<f64>,
    /// Thrust each rotor really makes, N.
    pub thrust_n: [f64; 4],
    /// Vertical speed at the hardest contact with the ground so far, m/s, positive; 0 before any.
    pub impact_m_s: f64,
    /// Whether it is on the ground.
    pub touching: bool,
}

impl Truth {
    /// Roll, pitch and heading (ZYX), rad.
    pub fn angles_rad(&self) -> [f64; 3] {
        let r = &self.attitude;
        [
            libm::atan2(r[(2, 1)], r[(2, 2)]),
            libm::asin((-r[(2, 0)]).clamp(-1.0, 1.0)),
            libm::atan2(r[(1, 0)], r[(0, 0)]),
        ]
    }

    /// Angle between the rotors' axis and the vertical, rad.
    pub fn tilt_rad(&self) -> f64 {
        libm::acos(self.attitude[(2, 2)].clamp(-1.0, 1.0))
    }

    /// Altitude, m, positive up.
    pub fn altitude_m(&self) -> f64 {
        -self.position_m.z
    }
}

/// What acts on the machine during one control period.
#[derive(Clone, Copy, Debug)]
pub struct Actuation {
    /// What each rotor is driven with.
    pub drives: [Drive; 4],
    /// Wind.
    pub gust: Gust,
}

/// A machine that flies.
pub trait Plant {
    /// Moves time on by `period_s` under `actuation`, in `steps` equal Runge-Kutta steps.
    fn advance(&mut self, actuation: &Actuation, period_s: f64, steps: u32);

    /// What each rotor's speed would make in thrust, without a fault, N.
    fn rotor_n(&self, actuation: &Actuation) -> [f64; 4];

    /// The state now, under the forces of `actuation`.
    fn truth(&self, actuation: &Actuation) -> Truth;
}

/// Which equations of motion to fly.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlantKind {
    /// The paper's eq 1 with torques over inertias: rotors without lag or limit, and a thrust that yaw does not turn.
    Paper,
    /// A rigid body: corrected rotation, Euler's equations, motor lag, saturation, drag, ground and wind.
    Rigid,
}

impl PlantKind {
    /// The plant, hovering above the origin with level attitude and the rotors carrying the weight.
    pub fn hovering(self, vehicle: &Vehicle, ground: Ground, altitude_m: f64) -> Box<dyn Plant> {
        match self {
            Self::Paper => Box::new(PaperPlant::hovering(vehicle, altitude_m)),
            Self::Rigid => Box::new(RigidPlant::hovering(vehicle, ground, altitude_m)),
        }
    }
}

/// One classical Runge-Kutta step of fourth order.
fn rk4<const N: usize>(
    x: &SVector<f64, N>,
    dt_s: f64,
    slope: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
) -> SVector<f64, N> {
    let k1 = slope(x);
    let k2 = slope(&(x + k1 * (dt_s / 2.0)));
    let k3 = slope(&(x + k2 * (dt_s / 2.0)));
    let k4 = slope(&(x + k3 * dt_s));
    x + (k1 + (k2 + k3) * 2.0 + k4) * (dt_s / 6.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::vector;

    #[test]
    fn runge_kutta_is_of_fourth_order() {
        let error = |steps: u32| {
            let dt_s = 1.0 / f64::from(steps);
            let end = (0..steps).fold(vector![1.0, 0.0], |x, _| rk4(&x, dt_s, |x| vector![x[1], -x[0]]));
            (end[0] - libm::cos(1.0)).abs()
        };
        let order = (error(10) / error(20)).log2();
        assert!((3.8..4.3).contains(&order), "{order}");
    }
}
