//! What the controller knows of the machine it flies.
use crate::GRAVITY_M_S2;

/// Where a rotor sits and how much it can pull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotor {
    /// Distance ahead of the centre of mass, m.
    pub forward_m: f32,
    /// Distance to the right of the centre of mass, m.
    pub right_m: f32,
    /// Largest thrust, N.
    pub thrust_n_max: f32,
}

/// A quadrotor whose rotors 1 and 3 face each other and turn counter-clockwise seen from above, as 2 and 4
/// face each other and turn clockwise. Plus, X and stretched X frames are all of this kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Airframe {
    /// Mass, kg.
    pub mass_kg: f32,
    /// Principal moments of inertia about body x, y, z, kg m².
    pub inertia_kg_m2: [f32; 3],
    /// Rotors 1 to 4. On the plus frame: right, front, left, back.
    pub rotors: [Rotor; 4],
    /// Reaction torque per thrust, m (κ = d/b in docs/control-law.md's erratum to eq 11).
    pub torque_per_thrust_m: f32,
    /// Angular momentum of a rotor per square root of its thrust, N m s/√N: the paper's Jr/√b.
    pub rotor_momentum: f32,
    /// Thrust below which no rotor is commanded, N: 0, or an idle that keeps it turning.
    pub thrust_n_min: f32,
}

/// Arm length of the paper's airframe, m (Table 1).
const ARM_M: f32 = 0.232;
/// Mass of the paper's airframe, kg (Table 1).
const MASS_KG: f32 = 0.52;
/// m l² of the paper's airframe (eq 5), kg m².
const INERTIA_KG_M2: f32 = 0.027_988_48;
/// d / b of Table 1: 7.5e-7 / 3.13e-5, m.
const TORQUE_PER_THRUST_M: f32 = 0.023_961_66;
/// Jr / √b of Table 1: 6e-5 / √3.13e-5, N m s/√N.
const ROTOR_MOMENTUM: f32 = 0.010_724_55;

impl Airframe {
    /// A plus frame with rotors `arm_m` from the centre: 1 right, 2 front, 3 left, 4 back.
    ///
    /// - `inertia_kg_m2`: about body x, y, z.
    /// - `thrust_to_weight`: largest total thrust over weight.
    pub const fn plus(mass_kg: f32, inertia_kg_m2: [f32; 3], arm_m: f32, thrust_to_weight: f32) -> Self {
        let thrust_n_max = thrust_to_weight * mass_kg * GRAVITY_M_S2 / 4.0;
        let ahead = Rotor { forward_m: arm_m, right_m: 0.0, thrust_n_max };
        let right = Rotor { forward_m: 0.0, right_m: arm_m, thrust_n_max };
        let behind = Rotor { forward_m: -arm_m, ..ahead };
        let left = Rotor { right_m: -arm_m, ..right };
        Self {
            mass_kg,
            inertia_kg_m2,
            rotors: [right, ahead, left, behind],
            torque_per_thrust_m: TORQUE_PER_THRUST_M,
            rotor_momentum: ROTOR_MOMENTUM,
            thrust_n_min: 0.0,
        }
    }

    /// The same airframe with its rotors turned by an eighth of a turn: 1 rear right, 2 front right, 3 front
    /// left, 4 rear left.
    #[must_use]
    pub fn into_x(mut self) -> Self {
        let c = core::f32::consts::FRAC_1_SQRT_2;
        for rotor in &mut self.rotors {
            (rotor.forward_m, rotor.right_m) =
                (c * (rotor.forward_m - rotor.right_m), c * (rotor.forward_m + rotor.right_m));
        }
        self
    }

    /// The paper's airframe: Table 1 with its I = m l² about x and y, twice that about z (eq 5).
    pub const fn paper(thrust_to_weight: f32) -> Self {
        let inertia_kg_m2 = [INERTIA_KG_M2, INERTIA_KG_M2, 2.0 * INERTIA_KG_M2];
        Self::plus(MASS_KG, inertia_kg_m2, ARM_M, thrust_to_weight)
    }

    /// The machine whose mass, arms and rotors the paper took, with its measured inertia (docs/control-law.md,
    /// errata): the OS4.
    pub const fn os4(thrust_to_weight: f32) -> Self {
        Self::plus(MASS_KG, [6.228e-3, 6.228e-3, 1.121e-2], ARM_M, thrust_to_weight)
    }

    /// Weight, N.
    pub const fn weight_n(&self) -> f32 {
        self.mass_kg * GRAVITY_M_S2
    }
}
