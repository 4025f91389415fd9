//! Outer to inner: commanded acceleration and vertical force in, tilt setpoints and thrust out.
//!
//! ```text
//! a_f =  cos ψ u_x + sin ψ u_y        φ_d = asin(a_r / g)
//! a_r = −sin ψ u_x + cos ψ u_y        θ_d = −asin(a_f / (g cos φ_d))
//! ```
//!
//! In flight the divisor is gravity, never the commanded thrust, which a loss inflates by 1/(1 − loss), and the thrust is
//! u_z over the body's vertical share. The paper's set-up divides by the commanded thrust and adds the weight to u_z.
//! For its plant (eq 1), which never turns the thrust with yaw, ψ is taken as 0.
//!
//! Source: docs/control-law.md, "Guidance, allocation, yaw guard" and, for the paper's set-up, "raw".
use crate::config::Cascade;
use crate::frames::Attitude;
use crate::math::{SINE_MAX, asin_and_cos, atan2};
use crate::{GRAVITY_M_S2, Scalar};

/// Sine of the largest tilt setpoint in flight, 0.5 rad.
const SIN_TILT_MAX: f32 = 0.479_425_54;
/// Sine of the largest tilt setpoint of the paper's set-up, 1.2 rad.
const PAPER_SIN_TILT_MAX: f32 = 0.932_039_1;
/// Carries the sine of roll beyond its limit when the body is upside down, unless it is exactly so.
const UPSIDE_DOWN: f32 = 1e3;
/// Smallest share of the thrust taken to point up.
const UPRIGHT_MIN: f32 = 0.5;
/// Smallest thrust over weight by which the paper's set-up divides.
const PAPER_LOAD_MIN: f32 = 0.3;

/// Attitude as the laws use it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Angles<S> {
    pub(crate) roll_rad: S,
    pub(crate) pitch_rad: S,
    pub(crate) yaw_rad: S,
    cos_yaw: S,
    sin_yaw: S,
    /// Cosine of the tilt, R33.
    upright: S,
}

impl<S: Scalar> Angles<S> {
    /// ZYX angles of `attitude`, a rotation. Roll beyond 72 degrees is held there, upside down too: what is asked of the
    /// body is then the same, all the torque back. At 90 degrees of pitch roll and heading lose their meaning.
    pub(crate) fn of(attitude: &Attitude<S>) -> Self {
        let [[r11, ..], [r21, ..], [r31, r32, r33]] = attitude.rows;
        let (pitch_rad, cos_pitch) = asin_and_cos(-r31);
        let inverse = S::ONE / cos_pitch;
        let (cos_yaw, sin_yaw) = (r11 * inverse, r21 * inverse);
        let sin_roll = r32 * inverse;
        let beyond = sin_roll * S::from_f32(UPSIDE_DOWN);
        let limit = S::from_f32(SINE_MAX);
        let (roll_rad, _) = asin_and_cos(S::select(r33.lt(S::ZERO), beyond, sin_roll).clamp_abs(limit));
        Self { roll_rad, pitch_rad, yaw_rad: atan2(sin_yaw, cos_yaw), cos_yaw, sin_yaw, upright: r33 }
    }
}

/// Commands of the outer axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outer<S> {
    pub(crate) north_m_s2: S,
    pub(crate) east_m_s2: S,
    pub(crate) up_n: S,
}

/// Setpoints of the inner loop, and what the tilt limit refused of the outer commands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inner<S> {
    pub(crate) roll_rad: S,
    pub(crate) pitch_rad: S,
    pub(crate) thrust_n: S,
    pub(crate) refused_north_m_s2: S,
    pub(crate) refused_east_m_s2: S,
}

/// The conversion, configured.
#[derive(Clone, Debug)]
pub(crate) struct Guidance<S> {
    cascade: Cascade,
    yaw_turns_thrust: bool,
    mass_kg: S,
    weight_n: S,
    sin_tilt_max: S,
}

impl<S: Scalar> Guidance<S> {
    pub(crate) fn new(cascade: Cascade, yaw_turns_thrust: bool, mass_kg: f32) -> Self {
        let sin_tilt_max = match cascade {
            Cascade::Flight => SIN_TILT_MAX,
            Cascade::Paper => PAPER_SIN_TILT_MAX,
        };
        Self {
            cascade,
            yaw_turns_thrust,
            mass_kg: S::from_f32(mass_kg),
            weight_n: S::from_f32(mass_kg * GRAVITY_M_S2),
            sin_tilt_max: S::from_f32(sin_tilt_max),
        }
    }

    /// Setpoints for the inner loop.
    pub(crate) fn convert(&self, outer: &Outer<S>, angles: &Angles<S>) -> Inner<S> {
        let gravity = S::from_f32(GRAVITY_M_S2);
        match self.cascade {
            Cascade::Flight => {
                let upright = angles.upright.max(S::from_f32(UPRIGHT_MIN));
                self.tilt(outer, angles, gravity, outer.up_n / upright)
            }
            Cascade::Paper => {
                let thrust = self.weight_n + outer.up_n;
                let floor = S::from_f32(PAPER_LOAD_MIN) * gravity;
                let per_mass = (thrust / self.mass_kg).max(floor);
                self.tilt(outer, angles, per_mass, thrust)
            }
        }
    }

    /// Tilt that pushes `outer` with `per_mass_m_s2` of thrust per mass, held within the tilt limit.
    fn tilt(&self, outer: &Outer<S>, angles: &Angles<S>, per_mass_m_s2: S, thrust_n: S) -> Inner<S> {
        let (cos, sin) = if self.yaw_turns_thrust { (angles.cos_yaw, angles.sin_yaw) } else { (S::ONE, S::ZERO) };
        let right = cos * outer.east_m_s2 - sin * outer.north_m_s2;
        let forward = cos * outer.north_m_s2 + sin * outer.east_m_s2;

        let limit = self.sin_tilt_max;
        let wanted = right / per_mass_m_s2;
        let sin_roll = wanted.clamp_abs(limit);
        let refused_right = (wanted - sin_roll) * per_mass_m_s2;

        // Away from zero: |sin_roll| is at most the sine of the tilt limit.
        let (roll_rad, cos_roll) = asin_and_cos(sin_roll);
        let reach = per_mass_m_s2 * cos_roll;
        let wanted = forward / reach;
        let sin_pitch = wanted.clamp_abs(limit);
        let refused_forward = (wanted - sin_pitch) * reach;

        Inner {
            roll_rad,
            pitch_rad: -asin_and_cos(sin_pitch).0,
            thrust_n,
            refused_north_m_s2: cos * refused_forward - sin * refused_right,
            refused_east_m_s2: sin * refused_forward + cos * refused_right,
        }
    }
}
