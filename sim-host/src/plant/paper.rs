//! The paper's plant: eq 1 with torques over inertias.
//!
//! ```text
//! ẍ = −(u1/m) sin θ        φ̈ = u2 / Ixx
//! ÿ =  (u1/m) cos θ sin φ  θ̈ = u3 / Iyy
//! z̈ =  (u1/m) cos θ cos φ − g        ψ̈ = u4 / Izz
//! ```
//!
//! Wrong in that yaw never turns the thrust (docs/control-law.md, errata) and in that its rotors have neither lag nor
//! limit; kept because the paper's figures are of it.
use super::{Actuation, Plant, Truth, rk4};
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use nalgebra::{Matrix3, SVector, Vector3, vector};

/// Position and velocity as (x, y, altitude), then roll, pitch, heading and their rates.
type State = SVector<f64, 12>;

/// Eq 1 and its state.
pub struct PaperPlant {
    vehicle: Vehicle,
    state: State,
}

impl PaperPlant {
    /// Hovering above the origin.
    pub fn hovering(vehicle: &Vehicle, altitude_m: f64) -> Self {
        let mut state = State::zeros();
        state[2] = altitude_m;
        Self { vehicle: vehicle.clone(), state }
    }

    fn slope(&self, state: &State, thrust_n: &[f64; 4]) -> State {
        let total_n: f64 = thrust_n.iter().sum();
        let [sin_roll, cos_roll] = [libm::sin(state[6]), libm::cos(state[6])];
        let [sin_pitch, cos_pitch] = [libm::sin(state[7]), libm::cos(state[7])];
        let torque = self.vehicle.torque_n_m(thrust_n);
        let [ix, iy, iz] = self.vehicle.inertia_kg_m2;
        let lift = total_n / self.vehicle.mass_kg;
        let mut slope = State::zeros();
        slope.fixed_rows_mut::<3>(0).copy_from(&state.fixed_rows::<3>(3));
        slope.fixed_rows_mut::<3>(3).copy_from(&vector![
            -lift * sin_pitch,
            lift * cos_pitch * sin_roll,
            lift * cos_pitch * cos_roll - f64::from(GRAVITY_M_S2)
        ]);
        slope.fixed_rows_mut::<3>(6).copy_from(&state.fixed_rows::<3>(9));
        slope.fixed_rows_mut::<3>(9).copy_from(&vector![torque.x / ix, torque.y / iy, torque.z / iz]);
        slope
    }

    fn thrust_n(actuation: &Actuation) -> [f64; 4] {
        std::array::from_fn(|i| actuation.drives[i].command_n * actuation.drives[i].share)
    }
}

impl Plant for PaperPlant {
    fn advance(&mut self, actuation: &Actuation, period_s: f64, steps: u32) {
        let thrust_n = Self::thrust_n(actuation);
        for _ in 0..steps {
            self.state = rk4(&self.state, period_s / f64::from(steps), |x| self.slope(x, &thrust_n));
        }
    }

    fn rotor_n(&self, actuation: &Actuation) -> [f64; 4] {
        actuation.drives.map(|drive| drive.command_n)
    }

    fn truth(&self, actuation: &Actuation) -> Truth {
        let x = &self.state;
        let thrust_n = Self::thrust_n(actuation);
        let slope = self.slope(x, &thrust_n);
        let attitude = rotation(x[6], x[7], x[8]);
        let acceleration = vector![slope[3], slope[4], -slope[5]];
        Truth {
            position_m: vector![x[0], x[1], -x[2]],
            velocity_m_s: vector![x[3], x[4], -x[5]],
            attitude,
            rate_rad_s: vector![x[9], x[10], x[11]],
            specific_force_m_s2: attitude.transpose() * (acceleration - Vector3::z() * f64::from(GRAVITY_M_S2)),
            thrust_n,
            impact_m_s: 0.0,
            touching: false,
        }
    }
}

/// Body to NED from ZYX angles.
fn rotation(roll: f64, pitch: f64, yaw: f64) -> Matrix3<f64> {
    let [sr, sp, sy] = [roll, pitch, yaw].map(libm::sin);
    let [cr, cp, cy] = [roll, pitch, yaw].map(libm::cos);
    Matrix3::new(
        cp * cy,
        sr * sp * cy - cr * sy,
        cr * sp * cy + sr * sy,
        cp * sy,
        sr * sp * sy + cr * cy,
        cr * sp * sy - sr * cy,
        -sp,
        sr * cp,
        cr * cp,
    )
}
