//! The physical machine: what the plant flies, and what the controller is told of it.
use control_core::{Airframe, GRAVITY_M_S2};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Named airframes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum AirframeName {
    /// The paper's Table 1 and its I = m l².
    Paper,
    /// The same machine with its measured inertia, 4.5 times smaller.
    Os4,
}

impl AirframeName {
    /// Fastest touchdown that is not a crash, vertical, m/s.
    pub fn impact_m_s_max(self) -> f64 {
        match self {
            Self::Paper => 2.0,
            Self::Os4 => 3.5,
        }
    }
}

/// How the arms lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Frame {
    /// Rotors right, front, left, back.
    #[default]
    Plus,
    /// The same turned by 45 degrees: rear right, front right, front left, rear left.
    X,
}

/// `[vehicle]`: what differs from the named airframe, and the motors. Left-out keys take the airframe's values.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VehicleKeys {
    /// Largest total thrust over weight. The plant `paper` has no such limit.
    pub thrust_to_weight: f64,
    /// First-order time constant of a rotor's thrust, s. The plant `paper` has none.
    pub motor_lag_s: f64,
    /// Arrangement of the arms.
    pub frame: Frame,
    /// Mass, kg.
    pub mass_kg: Option<f64>,
    /// Moments of inertia about body x, y, z, kg m².
    pub inertia_kg_m2: Option<[f64; 3]>,
    /// Distance from the centre of mass to each rotor, m.
    pub arm_m: Option<f64>,
    /// Moment of inertia of a rotor, kg m² (the paper's Jr).
    pub rotor_inertia_kg_m2: f64,
    /// Drag force per speed through the air, N s/m.
    pub linear_drag_n_s_m: f64,
    /// Drag torque per yaw rate, N m s/rad.
    pub yaw_drag_n_m_s: f64,
}

impl Default for VehicleKeys {
    fn default() -> Self {
        Self {
            thrust_to_weight: 2.2,
            motor_lag_s: 0.02,
            frame: Frame::default(),
            mass_kg: None,
            inertia_kg_m2: None,
            arm_m: None,
            rotor_inertia_kg_m2: 6e-5,
            linear_drag_n_s_m: 0.0,
            yaw_drag_n_m_s: 2.75e-3,
        }
    }
}

/// Thrust per squared rotor speed, N s² (the paper's b).
const THRUST_COEFFICIENT_N_S2: f64 = 3.13e-5;
/// Torque per squared rotor speed, N m s² (the paper's d).
const TORQUE_COEFFICIENT_N_M_S2: f64 = 7.5e-7;
/// The paper's mass, kg.
const MASS_KG: f64 = 0.52;
/// The paper's arm, m.
const ARM_M: f64 = 0.232;

/// The machine as the plant knows it, f64.
#[derive(Clone, Debug)]
pub struct Vehicle {
    /// kg.
    pub mass_kg: f64,
    /// About body x, y, z, kg m².
    pub inertia_kg_m2: [f64; 3],
    /// Distance from the centre of mass to each rotor, m.
    pub arm_m: f64,
    /// Arrangement of the arms.
    pub frame: Frame,
    /// Forward and right offset of each rotor, m.
    pub arms_m: [[f64; 2]; 4],
    /// κ = d/b, m.
    pub torque_per_thrust_m: f64,
    /// b, N s².
    pub thrust_coefficient_n_s2: f64,
    /// Largest total thrust over weight.
    pub thrust_to_weight: f64,
    /// Time constant of a rotor's thrust, s; 0 for none.
    pub motor_lag_s: f64,
    /// Jr, kg m².
    pub rotor_inertia_kg_m2: f64,
    /// N s/m.
    pub linear_drag_n_s_m: f64,
    /// N m s/rad.
    pub yaw_drag_n_m_s: f64,
}

impl Vehicle {
    /// The named airframe with `keys` put in its place.
    pub fn new(name: AirframeName, keys: &VehicleKeys) -> Self {
        let mass_kg = keys.mass_kg.unwrap_or(MASS_KG);
        let arm_m = keys.arm_m.unwrap_or(ARM_M);
        let named_inertia = match name {
            AirframeName::Paper => {
                let inertia = mass_kg * arm_m * arm_m;
                [inertia, inertia, 2.0 * inertia]
            }
            AirframeName::Os4 => [6.228e-3, 6.228e-3, 1.121e-2],
        };
        let plus = [[0.0, arm_m], [arm_m, 0.0], [0.0, -arm_m], [-arm_m, 0.0]];
        let half = std::f64::consts::FRAC_1_SQRT_2;
        Self {
            mass_kg,
            inertia_kg_m2: keys.inertia_kg_m2.unwrap_or(named_inertia),
            arm_m,
            frame: keys.frame,
            arms_m: match keys.frame {
                Frame::Plus => plus,
                Frame::X => plus.map(|[forward, right]| [half * (forward - right), half * (forward + right)]),
            },
            torque_per_thrust_m: TORQUE_COEFFICIENT_N_M_S2 / THRUST_COEFFICIENT_N_S2,
            thrust_coefficient_n_s2: THRUST_COEFFICIENT_N_S2,
            thrust_to_weight: keys.thrust_to_weight,
            motor_lag_s: keys.motor_lag_s,
            rotor_inertia_kg_m2: keys.rotor_inertia_kg_m2,
            linear_drag_n_s_m: keys.linear_drag_n_s_m,
            yaw_drag_n_m_s: keys.yaw_drag_n_m_s,
        }
    }

    /// Largest thrust of one rotor, N.
    pub fn thrust_n_max(&self) -> f64 {
        self.thrust_to_weight * self.mass_kg * f64::from(GRAVITY_M_S2) / 4.0
    }

    /// Torque of the weight on the longest arm to the side, which tips it over its feet, N m.
    pub fn weight_torque_nm(&self) -> f64 {
        let arm_m = self.arms_m.iter().fold(0.0, |most: f64, [_, right]| most.max(right.abs()));
        self.mass_kg * f64::from(GRAVITY_M_S2) * arm_m
    }

    /// Torque of the rotors on the body, N m (paper eq 11 to 13, with κ for d).
    pub fn torque_n_m(&self, thrust_n: &[f64; 4]) -> Vector3<f64> {
        let [f1, f2, f3, f4] = *thrust_n;
        let arms = self.arms_m.iter().zip(thrust_n);
        let (roll, pitch) =
            arms.fold((0.0, 0.0), |(roll, pitch), (&[forward, right], f)| (roll - right * f, pitch + forward * f));
        Vector3::new(roll, pitch, self.torque_per_thrust_m * (f1 - f2 + f3 - f4))
    }

    /// What the controller is told, f32: to the bit what a board computes from the same numbers.
    pub fn airframe(&self) -> Airframe {
        let plus = Airframe::plus(
            self.mass_kg as f32,
            self.inertia_kg_m2.map(|i| i as f32),
            self.arm_m as f32,
            self.thrust_to_weight as f32,
        );
        let rotor_momentum = self.rotor_inertia_kg_m2 / libm::sqrt(self.thrust_coefficient_n_s2);
        let plus = Airframe { rotor_momentum: rotor_momentum as f32, ..plus };
        match self.frame {
            Frame::Plus => plus,
            Frame::X => plus.into_x(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_named_airframes_are_those_of_the_core_to_the_bit() {
        for (name, core) in [(AirframeName::Paper, Airframe::paper(2.2)), (AirframeName::Os4, Airframe::os4(2.2))] {
            for (frame, core) in [(Frame::Plus, core), (Frame::X, core.into_x())] {
                let keys = VehicleKeys { frame, ..VehicleKeys::default() };
                let vehicle = Vehicle::new(name, &keys);
                assert_eq!(vehicle.airframe(), core);
                for (arm, rotor) in vehicle.arms_m.iter().zip(&core.rotors) {
                    assert!((arm[0] as f32 - rotor.forward_m).abs() < 1e-7);
                    assert!((arm[1] as f32 - rotor.right_m).abs() < 1e-7);
                }
            }
        }
    }

    #[test]
    fn torques_have_the_papers_signs() {
        let vehicle = Vehicle::new(AirframeName::Paper, &VehicleKeys::default());
        let torque = |f| vehicle.torque_n_m(&f);
        assert!(torque([0.0, 0.0, 1.0, 0.0]).x > 0.0, "left rotor rolls right");
        assert!(torque([0.0, 1.0, 0.0, 0.0]).y > 0.0, "front rotor pitches up");
        assert!(torque([1.0, 0.0, 1.0, 0.0]).z > 0.0, "counter-clockwise rotors yaw right");
    }
}
