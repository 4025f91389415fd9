//! The fall-back: fixed gains instead of a covariance, for when the filter cannot be believed.
//!
//! ```text
//! tilt       θ ← k_t (up × f) / |f|       while |f| is within a tenth of gravity
//! heading    θ_z ← k_h ψ                  by each sample of the magnetometer
//! vertical   p_z ← p_z + 2ζω T e          v_z ← v_z + ω² T e       by each sample of the barometer
//! horizontal v ← v − k_v v                nothing is known of it
//! ```
//!
//! It turns the same dead reckoning as the filter does. Bounded for any input that is finite: no gain depends on a state.
//! Source: Mahony, Hamel and Pflimlin, Nonlinear complementary filters on the special orthogonal group (2008), without the bias.
use super::filter::Filter;
use super::observe::heading;
use crate::frames::{Ned, Vec3};
use crate::{GRAVITY_M_S2, Scalar};

/// Time in which tilt and heading follow, s.
const TILT_S: f32 = 2.0;
const HEADING_S: f32 = 2.0;
/// What the specific force may differ from gravity to say what is down, m/s².
const QUIET_M_S2: f32 = 0.1 * GRAVITY_M_S2;
/// Natural frequency, rad/s, and twice the damping of the vertical.
const VERTICAL_RAD_S: f32 = 0.7;
const VERTICAL_DAMPING_2: f32 = 1.4;
/// Time in which horizontal velocity is forgotten, s.
const FORGET_S: f32 = 1.0;
/// Longest step that a gain is made for, s.
const STEP_S_MAX: f32 = 0.1;

/// Pulls tilt to the specific force, over a step of `span_s`.
pub(crate) fn follow_gravity(filter: &mut Filter, span_s: f32) {
    let f = filter.force_m_s2;
    let length = Scalar::sqrt(f.norm_squared());
    if (length - GRAVITY_M_S2).abs() < QUIET_M_S2 {
        let gain = span_s.min(STEP_S_MAX) / (TILT_S * length);
        // (f × up) with up = (0, 0, −1): the turn that brings f upright.
        filter.turn(Vec3::<Ned>::new(-f.y, f.x, 0.0) * gain);
    }
    let v = filter.nominal.velocity_m_s;
    let forget = -span_s.min(STEP_S_MAX) / FORGET_S;
    filter.shift(Vec3::new(v.x * forget, v.y * forget, 0.0), Vec3::zero());
}

/// Pulls the heading to the field `measured_ut`, NED, after `since_s` without.
pub(crate) fn follow_field(filter: &mut Filter, measured_ut: Vec3<Ned>, earth: [f32; 2], since_s: f32) {
    if let Some([observation]) = heading(measured_ut, earth, 0.0, 1.0) {
        let gain = since_s.min(STEP_S_MAX) / HEADING_S;
        filter.turn(Vec3::new(0.0, 0.0, observation.innovation * gain));
    }
}

/// Pulls the vertical to the barometer, after `since_s` without.
pub(crate) fn follow_barometer(filter: &mut Filter, altitude_m: f32, since_s: f32) {
    let off_m = filter.barometer_offset_m - altitude_m - filter.nominal.position_m.z;
    let step = off_m.clamp(-20.0, 20.0) * since_s.min(STEP_S_MAX);
    filter.shift(
        Vec3::new(0.0, 0.0, step * VERTICAL_RAD_S * VERTICAL_RAD_S),
        Vec3::new(0.0, 0.0, step * VERTICAL_DAMPING_2 * VERTICAL_RAD_S),
    );
}
