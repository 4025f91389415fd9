//! A rigid body with four rotors.
//!
//! ```text
//! m v̇ = m g + R (−ΣF ẑ) − D (v − w) + f_gust + f_ground
//! I ω̇ = τ − ω × (I ω + h) − c r ẑ + τ_air + τ_ground   h = Jr Σ ∓Ω_i ẑ,  Ω_i = √(F_i / b)
//! Ḟ_i = (sat(F_cmd,i) − F_i) / T_i, |Ḟ_i| ≤ rate_i       thrust made: share_i F_i; backwards if share_i < 0
//! ```
//!
//! Thrust acts along the third column of R, and body axes replace the paper's eq 9 (docs/control-law.md, errata). Attitude is
//! a unit quaternion, normalised after every step.
use super::{Actuation, Plant, Truth, rk4};
use crate::ground::Ground;
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use nalgebra::{Matrix3, Quaternion, SVector, UnitQuaternion, Vector3, Vector4};

/// Position, velocity (NED), quaternion (w, x, y, z), body rates, rotor thrusts before faults.
type State = SVector<f64, 17>;

/// The rigid body and its state.
pub struct RigidPlant {
    vehicle: Vehicle,
    ground: Ground,
    state: State,
    impact_m_s: f64,
    touching: bool,
}

/// Acceleration (NED) and angular acceleration (body).
struct Accelerations {
    linear_m_s2: Vector3<f64>,
    angular_rad_s2: Vector3<f64>,
}

impl RigidPlant {
    /// Hovering above the origin, level, every rotor at a quarter of the weight.
    pub fn hovering(vehicle: &Vehicle, ground: Ground, altitude_m: f64) -> Self {
        let mut state = State::zeros();
        state[2] = -altitude_m;
        state[6] = 1.0;
        let quarter = vehicle.mass_kg * f64::from(GRAVITY_M_S2) / 4.0;
        state.fixed_rows_mut::<4>(13).fill(quarter);
        Self { vehicle: vehicle.clone(), ground, state, impact_m_s: 0.0, touching: false }
    }

    /// Standing on the ground, level, every rotor stopped.
    pub fn standing(vehicle: &Vehicle, ground: Ground, altitude_m: f64) -> Self {
        let mut plant = Self::hovering(vehicle, ground, altitude_m);
        plant.state.fixed_rows_mut::<4>(13).fill(0.0);
        plant.note_contact();
        plant
    }

    fn attitude(state: &State) -> Matrix3<f64> {
        let q = Quaternion::new(state[6], state[7], state[8], state[9]);
        UnitQuaternion::from_quaternion(q).to_rotation_matrix().into_inner()
    }

    /// Thrust made, after the faults.
    fn thrust_n(state: &State, actuation: &Actuation) -> [f64; 4] {
        std::array::from_fn(|i| state[13 + i] * actuation.drives[i].share)
    }

    fn accelerations(&self, state: &State, actuation: &Actuation) -> Accelerations {
        let vehicle = &self.vehicle;
        let position: Vector3<f64> = state.fixed_rows::<3>(0).into();
        let velocity: Vector3<f64> = state.fixed_rows::<3>(3).into();
        let rate: Vector3<f64> = state.fixed_rows::<3>(10).into();
        let attitude = Self::attitude(state);
        let thrust_n = Self::thrust_n(state, actuation);
        let total_n: f64 = thrust_n.iter().sum();
        let contact = self.ground.contact(vehicle, &position, &velocity, &attitude, &rate);

        let force_n = attitude * Vector3::new(0.0, 0.0, -total_n)
            - (velocity - actuation.gust.velocity_m_s) * vehicle.linear_drag_n_s_m
            + actuation.gust.force_n
            + contact.force_n;
        let inertia = Vector3::from(vehicle.inertia_kg_m2);
        let spin = Vector3::new(0.0, 0.0, self.rotor_momentum(&thrust_n));
        let torque_nm = vehicle.torque_n_m(&thrust_n)
            - rate.cross(&(inertia.component_mul(&rate) + spin))
            - Vector3::new(0.0, 0.0, vehicle.yaw_drag_n_m_s * rate.z)
            + actuation.gust.torque_nm
            + contact.torque_nm;
        Accelerations {
            linear_m_s2: force_n / vehicle.mass_kg + Vector3::z() * f64::from(GRAVITY_M_S2),
            angular_rad_s2: torque_nm.component_div(&inertia),
        }
    }

    /// Angular momentum of the rotors about body z, N m s: rotors 1 and 3 turn counter-clockwise seen from above, and
    /// one that thrusts downwards the other way.
    fn rotor_momentum(&self, thrust_n: &[f64; 4]) -> f64 {
        let vehicle = &self.vehicle;
        let speed = |i: usize| {
            let thrust_n = thrust_n[i];
            libm::sqrt(thrust_n.abs() / vehicle.thrust_coefficient_n_s2).copysign(thrust_n)
        };
        vehicle.rotor_inertia_kg_m2 * (speed(1) + speed(3) - speed(0) - speed(2))
    }

    fn slope(&self, state: &State, actuation: &Actuation) -> State {
        let Accelerations { linear_m_s2, angular_rad_s2 } = self.accelerations(state, actuation);
        let q = Quaternion::new(state[6], state[7], state[8], state[9]);
        let rate = Quaternion::new(0.0, state[10], state[11], state[12]);
        let turn = (q * rate) * 0.5;
        let mut slope = State::zeros();
        slope.fixed_rows_mut::<3>(0).copy_from(&state.fixed_rows::<3>(3));
        slope.fixed_rows_mut::<3>(3).copy_from(&linear_m_s2);
        slope.fixed_rows_mut::<4>(6).copy_from(&Vector4::new(turn.w, turn.i, turn.j, turn.k));
        slope.fixed_rows_mut::<3>(10).copy_from(&angular_rad_s2);
        for (i, drive) in actuation.drives.iter().enumerate().filter(|(_, drive)| drive.lag_s > 0.0) {
            let wanted = drive.command_n.clamp(0.0, self.vehicle.thrust_n_max());
            slope[13 + i] = ((wanted - state[13 + i]) / drive.lag_s).clamp(-drive.rate_n_s_max, drive.rate_n_s_max);
        }
        slope
    }

    /// Rotors without lag follow their command at once, as far as their rate lets them in a period.
    fn follow_at_once(&mut self, actuation: &Actuation, period_s: f64) {
        for (i, drive) in actuation.drives.iter().enumerate().filter(|(_, drive)| drive.lag_s == 0.0) {
            let (now, reach) = (self.state[13 + i], drive.rate_n_s_max * period_s);
            let wanted = drive.command_n.clamp(0.0, self.vehicle.thrust_n_max());
            self.state[13 + i] = wanted.clamp(now - reach, now + reach);
        }
    }

    /// Remembers the vertical speed with which the ground was met.
    fn note_contact(&mut self) {
        let position: Vector3<f64> = self.state.fixed_rows::<3>(0).into();
        let touching = self.ground.touches(&self.vehicle, &position, &Self::attitude(&self.state));
        if touching && !self.touching {
            self.impact_m_s = self.impact_m_s.max(self.state[5]);
        }
        self.touching = touching;
    }
}

impl Plant for RigidPlant {
    fn advance(&mut self, actuation: &Actuation, period_s: f64, steps: u32) {
        self.follow_at_once(actuation, period_s);
        for _ in 0..steps {
            let mut next = rk4(&self.state, period_s / f64::from(steps), |x| self.slope(x, actuation));
            let norm = next.fixed_rows::<4>(6).norm();
            next.fixed_rows_mut::<4>(6).scale_mut(1.0 / norm);
            self.state = next;
            self.note_contact();
        }
    }

    fn rotor_n(&self, _: &Actuation) -> [f64; 4] {
        self.state.fixed_rows::<4>(13).into_owned().into()
    }

    fn truth(&self, actuation: &Actuation) -> Truth {
        let state = &self.state;
        let attitude = Self::attitude(state);
        let acceleration = self.accelerations(state, actuation).linear_m_s2;
        Truth {
            position_m: state.fixed_rows::<3>(0).into(),
            velocity_m_s: state.fixed_rows::<3>(3).into(),
            attitude,
            rate_rad_s: state.fixed_rows::<3>(10).into(),
            specific_force_m_s2: attitude.transpose() * (acceleration - Vector3::z() * f64::from(GRAVITY_M_S2)),
            thrust_n: Self::thrust_n(state, actuation),
            impact_m_s: self.impact_m_s,
            touching: self.touching,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actuators::Drive;
    use crate::vehicle::{AirframeName, VehicleKeys};
    use crate::wind::Gust;

    fn plant(motor_lag_s: f64) -> (Vehicle, RigidPlant) {
        let keys = VehicleKeys { motor_lag_s, ..VehicleKeys::default() };
        let vehicle = Vehicle::new(AirframeName::Paper, &keys);
        let plant = RigidPlant::hovering(&vehicle, Ground { altitude_m: None }, 0.0);
        (vehicle, plant)
    }

    fn driven(first: Drive) -> Actuation {
        let other = Drive { command_n: 1.0, lag_s: 0.02, rate_n_s_max: f64::INFINITY, share: 1.0 };
        Actuation { drives: [first, other, other, other], gust: Gust::default() }
    }

    #[test]
    fn a_rotor_changes_no_faster_than_its_rate() {
        for lag_s in [0.0, 0.02] {
            let (vehicle, mut plant) = plant(lag_s);
            let actuation = driven(Drive { command_n: 2.0, lag_s, rate_n_s_max: 1.5, share: 1.0 });
            let before = plant.rotor_n(&actuation)[0];
            for _ in 0..100 {
                plant.advance(&actuation, 0.002, 2);
            }
            let change_n = plant.rotor_n(&actuation)[0] - before;
            assert!((change_n - 1.5 * 0.2).abs() < 1e-9, "{change_n} with a lag of {lag_s} s");
            assert!(vehicle.thrust_n_max() > 2.0);
        }
    }

    #[test]
    fn a_reversed_rotor_pushes_down_and_turns_the_other_way() {
        let (_, plant) = plant(0.02);
        let truth = |share| {
            let actuation = driven(Drive { command_n: 1.0, lag_s: 0.02, rate_n_s_max: f64::INFINITY, share });
            (plant.truth(&actuation).thrust_n[0], plant.accelerations(&plant.state, &actuation).angular_rad_s2)
        };
        let ((up_n, straight), (down_n, reversed), (_, none)) = (truth(1.0), truth(-0.5), truth(0.0));
        assert!((down_n + 0.5 * up_n).abs() < 1e-12);
        for axis in [0, 2] {
            let (with, against) = (straight[axis] - none[axis], reversed[axis] - none[axis]);
            assert!(with != 0.0 && (against + 0.5 * with).abs() < 1e-9, "about axis {axis}");
        }
        let momentum = |first_n| plant.rotor_momentum(&[first_n, 0.0, 0.0, 0.0]);
        assert!(momentum(-1.0) == -momentum(1.0) && momentum(1.0) < 0.0);
    }

    #[test]
    fn torque_of_the_air_turns_the_body() {
        let (vehicle, plant) = plant(0.02);
        let mut actuation = driven(Drive { command_n: 1.0, lag_s: 0.02, rate_n_s_max: f64::INFINITY, share: 1.0 });
        let still = plant.accelerations(&plant.state, &actuation).angular_rad_s2;
        actuation.gust.torque_nm = Vector3::new(0.01, 0.0, -0.02);
        let turned = plant.accelerations(&plant.state, &actuation).angular_rad_s2 - still;
        assert!((turned.x - 0.01 / vehicle.inertia_kg_m2[0]).abs() < 1e-12);
        assert!((turned.z + 0.02 / vehicle.inertia_kg_m2[2]).abs() < 1e-12);
    }
}
