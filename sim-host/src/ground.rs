//! Flat ground under four feet, one below each rotor.
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use nalgebra::{Matrix3, Vector3};

/// How far a foot reaches below the centre of mass, m.
const FOOT_M: f64 = 0.05;
/// Depth at which the feet carry the weight, m.
const SAG_M: f64 = 0.005;
/// Damping ratio of a landing: it does not bounce.
const DAMPING: f64 = 1.0;
/// Sliding friction.
const FRICTION: f64 = 0.6;
/// Sliding speed below which friction fades, m/s: it holds a machine at rest without chatter.
const CREEP_M_S: f64 = 0.05;

/// The ground, or none.
#[derive(Clone, Copy, Debug)]
pub struct Ground {
    /// Altitude of its surface, m; none for a flight in empty space.
    pub altitude_m: Option<f64>,
}

/// What the ground does to the machine.
pub struct Contact {
    /// NED, N.
    pub force_n: Vector3<f64>,
    /// Body, N m.
    pub torque_nm: Vector3<f64>,
}

impl Ground {
    /// Altitude of the centre of mass of a machine that stands still, m; none without ground.
    pub fn standing_m(&self) -> Option<f64> {
        self.altitude_m.map(|altitude_m| altitude_m + FOOT_M - SAG_M)
    }

    /// Where each foot is, from the centre of mass, body axes, m.
    fn feet(vehicle: &Vehicle) -> [Vector3<f64>; 4] {
        vehicle.arms_m.map(|[forward, right]| Vector3::new(forward, right, FOOT_M))
    }

    /// Depth of a foot below the surface, m; negative in the air.
    fn depth_m(&self, position: &Vector3<f64>, arm: &Vector3<f64>) -> Option<f64> {
        self.altitude_m.map(|altitude_m| position.z + arm.z + altitude_m)
    }

    /// Whether any foot is on the ground.
    pub fn touches(&self, vehicle: &Vehicle, position: &Vector3<f64>, attitude: &Matrix3<f64>) -> bool {
        Self::feet(vehicle)
            .iter()
            .any(|foot| self.depth_m(position, &(attitude * foot)).is_some_and(|depth| depth > 0.0))
    }

    /// Spring, damper and friction of the feet that are on the ground.
    pub fn contact(
        &self,
        vehicle: &Vehicle,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        attitude: &Matrix3<f64>,
        rate: &Vector3<f64>,
    ) -> Contact {
        let mut contact = Contact { force_n: Vector3::zeros(), torque_nm: Vector3::zeros() };
        let share_kg = vehicle.mass_kg / 4.0;
        let stiffness = share_kg * f64::from(GRAVITY_M_S2) / SAG_M;
        let damping = 2.0 * DAMPING * libm::sqrt(stiffness * share_kg);
        for foot in Self::feet(vehicle) {
            let Some(depth) = self.depth_m(position, &(attitude * foot)) else { continue };
            if depth <= 0.0 {
                continue;
            }
            let slip = velocity + attitude * rate.cross(&foot);
            let normal_n = (stiffness * depth + damping * slip.z).max(0.0);
            let speed = libm::hypot(slip.x, slip.y);
            let drag = FRICTION * normal_n / speed.max(CREEP_M_S);
            let force = Vector3::new(-drag * slip.x, -drag * slip.y, -normal_n);
            contact.force_n += force;
            contact.torque_nm += foot.cross(&(attitude.transpose() * force));
        }
        contact
    }
}
