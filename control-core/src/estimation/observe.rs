//! What each source says of the errors: measured less expected, with the row h of each scalar.
//!
//! Every expectation is of the time of the measurement ([`Past`]), every row of the errors now. `θ × a` has the row `(0, a_z, −a_y)` for
//! its first component and so on round.
//!
//! | source              | expected                          | row                                            |
//! |---------------------|-----------------------------------|------------------------------------------------|
//! | position            | `p`                               | `p − T v`                                      |
//! | velocity            | `v`                               | `v`                                            |
//! | attitude            | `½ Σ r̂ × r` over body axes r is 0 | `θ`                                            |
//! | heading, by field m | angle of `R m` is that of earth's | `θ_z − m_z (m_x θ_x + m_y θ_y) / m_h²`, m of the earth |
//! | barometer           | `b_h − p_z`                       | the same                                       |
//! | range r             | `p_z = ground − r R_33`           | `p_z − d_g + r (θ_x R_23 − θ_y R_13)`          |
//! | flow, distance d    | `v_y = −d (f_x − ω_x)`, `v_x = d (f_y − ω_y)` | `r · v + (r × v) · θ + v' (p_z − d_g) / height` |
//! | gravity             | `R f` has no horizontal part      | `θ × R f − R b_a`                              |
use super::covariance::{ACCELEROMETER_BIAS, ATTITUDE, BARO_OFFSET, GROUND, Observation, POSITION, VELOCITY};
use super::history::Past;
use crate::Scalar;
use crate::frames::{Attitude, Ned, Vec3};
use crate::math::atan2;
use crate::measurement::Flow;

/// Down.
const DOWN: usize = 2;

/// Where the components of a vector are wanted by number.
pub(crate) fn components<F: Copy>(v: Vec3<F>) -> [f32; 3] {
    [v.x, v.y, v.z]
}

/// North and east, measured with the standard deviation `sigma_m`.
pub(crate) fn horizontal(past: &Past, measured_m: Vec3<Ned>, sigma_m: f32) -> [Observation; 2] {
    let off = measured_m - past.position_m;
    [position(past, 0, off.x, sigma_m), position(past, 1, off.y, sigma_m)]
}

/// Position down, measured with the standard deviation `sigma_m`.
pub(crate) fn vertical(past: &Past, measured_m: Vec3<Ned>, sigma_m: f32) -> [Observation; 1] {
    [position(past, DOWN, measured_m.z - past.position_m.z, sigma_m)]
}

fn position(past: &Past, axis: usize, off_m: f32, sigma_m: f32) -> Observation {
    Observation::new(off_m, sigma_m * sigma_m, [(POSITION + axis, 1.0), (VELOCITY + axis, -past.delay_s)])
}

/// Velocity, measured with the standard deviation `sigma_m_s` on each axis.
pub(crate) fn velocity(past: &Past, measured_m_s: Vec3<Ned>, sigma_m_s: f32) -> [Observation; 3] {
    let off = components(measured_m_s - past.velocity_m_s);
    core::array::from_fn(|axis| Observation::new(off[axis], sigma_m_s * sigma_m_s, [(VELOCITY + axis, 1.0)]))
}

/// Attitude, measured with the standard deviation `sigma_rad` about each axis.
pub(crate) fn attitude(past: &Past, measured: &Attitude, sigma_rad: f32) -> [Observation; 3] {
    let expected = past.rotation.attitude();
    let column = |a: &Attitude, i: usize| Vec3::<Ned>::new(a.rows[0][i], a.rows[1][i], a.rows[2][i]);
    let (mut off, mut trace) = (Vec3::zero(), 0.0);
    for i in 0..3 {
        let (expected, measured) = (column(&expected, i), column(measured, i));
        off = off + expected.cross(measured) * 0.5;
        trace += expected.x * measured.x + expected.y * measured.y + expected.z * measured.z;
    }
    // Beyond a right angle the sine falls again: make it large enough for any gate.
    let off = components(if trace < 1.0 { off + Vec3::new(0.0, 0.0, 1e3) } else { off });
    core::array::from_fn(|axis| Observation::new(off[axis], sigma_rad * sigma_rad, [(ATTITUDE + axis, 1.0)]))
}

/// How far the heading of `measured` is from the one expected, rad.
pub(crate) fn heading_apart(past: &Past, measured: &Attitude) -> f32 {
    let expected = past.rotation.attitude();
    // Rows north and east of measured times expected transposed: the turn from one to the other.
    let entry = |i: usize, j: usize| {
        let (a, b) = (measured.rows[i], expected.rows[j]);
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    };
    atan2(entry(1, 0) - entry(0, 1), entry(0, 0) + entry(1, 1))
}

/// Heading by the magnetic field `measured_ut` in NED, as the attitude then has it.
///
/// The row is of the earth's field, not of the measured one: its noise is that of the innovation, and their product has a mean, which
/// pulls the tilt.
///
/// - `earth`: unit vector north and east of the earth's field; `steep`: its part down over its horizontal part.
/// - Returns `None` where the horizontal part is too weak.
pub(crate) fn heading(measured_ut: Vec3<Ned>, earth: [f32; 2], steep: f32, sigma_ut: f32) -> Option<[Observation; 1]> {
    let Vec3 { x, y, .. } = measured_ut;
    let square = x * x + y * y;
    if square < 4.0 * sigma_ut * sigma_ut {
        return None;
    }
    let length = Scalar::sqrt(square);
    let (x, y) = (x / length, y / length);
    let off_rad = atan2(x * earth[1] - y * earth[0], x * earth[0] + y * earth[1]);
    let sigma_rad = sigma_ut / length;
    let terms = [(ATTITUDE, -steep * earth[0]), (ATTITUDE + 1, -steep * earth[1]), (ATTITUDE + 2, 1.0)];
    Some([Observation::new(off_rad, sigma_rad * sigma_rad, terms)])
}

/// Barometric altitude.
pub(crate) fn barometer(past: &Past, altitude_m: f32, offset_m: f32, sigma_m: f32) -> [Observation; 1] {
    let off_m = altitude_m + past.position_m.z - offset_m;
    let terms = [(POSITION + DOWN, -1.0), (VELOCITY + DOWN, past.delay_s), (BARO_OFFSET, 1.0)];
    [Observation::new(off_m, sigma_m * sigma_m, terms)]
}

/// Distance to level ground at `ground_m` down.
pub(crate) fn range(past: &Past, range_m: f32, ground_m: f32, sigma_m: f32) -> [Observation; 1] {
    let rows = past.rotation.attitude().rows;
    let off_m = ground_m - range_m * rows[2][2] - past.position_m.z;
    let terms = [
        (POSITION + DOWN, 1.0),
        (VELOCITY + DOWN, -past.delay_s),
        (GROUND, -1.0),
        (ATTITUDE, range_m * rows[1][2]),
        (ATTITUDE + 1, -range_m * rows[0][2]),
    ];
    [Observation::new(off_m, sigma_m * sigma_m, terms)]
}

/// Flow over level ground `height_m` below, as velocity along body x and y; `None` where the tilt leaves no ground to see.
///
/// The row of the height is made of the velocity expected, for the reason given at [`heading`]: that of the measured one pulled the
/// height by 0.3 m/s where no range held it.
pub(crate) fn flow(past: &Past, flow: &Flow, height_m: f32, sigma_rad_s: f32) -> Option<[Observation; 2]> {
    let rows = past.rotation.attitude().rows;
    if !(rows[2][2] > 0.5 && height_m > 0.05) {
        return None;
    }
    let distance_m = height_m / rows[2][2];
    let measured_m_s =
        [distance_m * (flow.rate_rad_s[1] - past.rate_rad_s.y), -distance_m * (flow.rate_rad_s[0] - past.rate_rad_s.x)];
    let sigma_m_s = sigma_rad_s * distance_m;
    Some(core::array::from_fn(|axis| {
        let r = Vec3::<Ned>::new(rows[0][axis], rows[1][axis], rows[2][axis]);
        let v = past.velocity_m_s;
        let turned = r.cross(v);
        let expected_m_s = r.x * v.x + r.y * v.y + r.z * v.z;
        let off_m_s = measured_m_s[axis] - expected_m_s;
        let terms = [
            (VELOCITY, r.x),
            (VELOCITY + 1, r.y),
            (VELOCITY + 2, r.z),
            (ATTITUDE, turned.x),
            (ATTITUDE + 1, turned.y),
            (ATTITUDE + 2, turned.z),
            (POSITION + DOWN, expected_m_s / height_m),
            (GROUND, -expected_m_s / height_m),
        ];
        Observation::new(off_m_s, sigma_m_s * sigma_m_s, terms)
    }))
}

/// That the horizontal acceleration is nothing but noise of `sigma_m_s2`.
pub(crate) fn gravity(attitude: &Attitude, force_m_s2: Vec3<Ned>, sigma_m_s2: f32) -> [Observation; 2] {
    let (f, variance) = (force_m_s2, sigma_m_s2 * sigma_m_s2);
    let row = |axis: usize, off: f32, tilts: [(usize, f32); 2]| {
        let [a, b, c] = attitude.rows[axis];
        let [first, second] = tilts;
        let terms =
            [first, second, (ACCELEROMETER_BIAS, -a), (ACCELEROMETER_BIAS + 1, -b), (ACCELEROMETER_BIAS + 2, -c)];
        Observation::new(off, variance, terms)
    };
    [row(0, -f.x, [(ATTITUDE + 1, f.z), (ATTITUDE + 2, -f.y)]), row(1, -f.y, [(ATTITUDE + 2, f.x), (ATTITUDE, -f.z)])]
}

/// That one component of velocity is nothing but noise of `sigma_m_s`.
pub(crate) fn standstill(axis: usize, velocity_m_s: f32, sigma_m_s: f32) -> [Observation; 1] {
    [Observation::new(-velocity_m_s, sigma_m_s * sigma_m_s, [(VELOCITY + axis, 1.0)])]
}
