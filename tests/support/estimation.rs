//! What tests of the estimator share: its errors, whether they are what its covariance says, and flights of it.
use crate::motion::{Aboard, Truth, World, sub};
use control_core::estimate::Estimate;
use control_core::estimation::{Estimator, EstimatorConfig, EstimatorState, EstimatorTelemetry, STATES};
use control_core::frames::Vec3;

/// Errors of an estimate in the order of the covariance: attitude, velocity, position and biases.
pub fn errors(estimate: &Estimate, truth: &Truth, world: &World, telemetry: &EstimatorTelemetry) -> [f64; STATES] {
    let triple = |v: [f32; 3]| v.map(f64::from);
    let rows = estimate.attitude.rows.map(triple);
    // R R̂ᵀ less its transpose, halved.
    let turn = |i: usize, j: usize| (0..3).map(|k| truth.rows[i][k] * rows[j][k]).sum::<f64>();
    let theta = [turn(2, 1) - turn(1, 2), turn(0, 2) - turn(2, 0), turn(1, 0) - turn(0, 1)].map(|x| 0.5 * x);
    let of = |Vec3 { x, y, z, .. }: Vec3<_>| triple([x, y, z]);
    let body = |Vec3 { x, y, z, .. }: Vec3<control_core::frames::Body>| triple([x, y, z]);
    let groups = [
        theta,
        sub(truth.velocity_m_s, of(estimate.velocity_m_s)),
        sub(truth.position_m, of(estimate.position_m)),
        sub(world.gyro_bias_rad_s, body(estimate.gyro_bias_rad_s)),
        sub(world.accelerometer_bias_m_s2, body(estimate.accelerometer_bias_m_s2)),
    ];
    let offset_m = world.barometer_offset_m - f64::from(telemetry.barometer_offset_m);
    let ground_m = world.ground_m - telemetry.ground_m.map_or(world.ground_m, f64::from);
    let mut all = [0.0; STATES];
    for (slot, error) in all.iter_mut().zip(groups.into_iter().flatten().chain([offset_m, ground_m])) {
        *slot = error;
    }
    all
}

/// The lower factor of the correlation matrix, in f64; `None` if that is not positive definite.
pub fn factor(p: &[[f32; STATES]; STATES]) -> Option<[[f64; STATES]; STATES]> {
    let mut l = [[0.0; STATES]; STATES];
    for i in 0..STATES {
        for j in 0..=i {
            let scale = (f64::from(p[i][i]) * f64::from(p[j][j])).sqrt();
            let rest = f64::from(p[i][j]) / scale - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if i == j { rest.sqrt() } else { rest / l[j][j] };
            if !(l[i][j].is_finite() && (i != j || rest > 0.0)) {
                return None;
            }
        }
    }
    Some(l)
}

/// Normalised squared error of the first `states` states.
pub fn nees(p: &[[f32; STATES]; STATES], error: &[f64; STATES], states: usize) -> f64 {
    let l = factor(p).expect("positive definite");
    let mut y = [0.0; STATES];
    for i in 0..states {
        let rest = error[i] / f64::from(p[i][i]).sqrt() - (0..i).map(|k| l[i][k] * y[k]).sum::<f64>();
        y[i] = rest / l[i][i];
    }
    y[..states].iter().map(|y| y * y).sum()
}

/// A flight, told at every sample.
pub fn fly(
    estimator: &Estimator,
    world: &mut World,
    seconds: f64,
    mut look: impl FnMut(f64, &World, &EstimatorState, &Estimate),
) -> EstimatorState {
    let mut state = estimator.state();
    let start_us = world.now_us;
    loop {
        let measurements = world.step();
        let estimate = *estimator.step(&mut state, &measurements, world.now_us);
        let t_s = (world.now_us - start_us) as f64 * 1e-6;
        look(t_s, world, &state, &estimate);
        if t_s >= seconds {
            return state;
        }
    }
}

/// A configuration that says the truth of the sensors of [`World`].
pub fn honest() -> EstimatorConfig {
    let mut config = EstimatorConfig::FLIGHT;
    config.inertial.gyro_scale = 0.0;
    config.inertial.gyro_bias_rad_s = 3e-4;
    (config.aiding.gnss_bias_m, config.aiding.magnetic_bias_ut) = (0.0, 0.0);
    config
}

/// Sets of sensors that are flown with.
pub const SUBSETS: [(&str, Aboard); 7] = {
    const NONE: Aboard = Aboard { gnss: false, baro: false, mag: false, flow: false, vision: false };
    [
        ("vision", Aboard { vision: true, ..NONE }),
        ("gnss + baro + mag", Aboard { gnss: true, baro: true, mag: true, ..NONE }),
        ("gnss + mag", Aboard { gnss: true, mag: true, ..NONE }),
        ("range and flow + mag", Aboard { flow: true, mag: true, ..NONE }),
        ("range and flow + baro + mag", Aboard { flow: true, mag: true, baro: true, ..NONE }),
        ("vision + baro", Aboard { vision: true, baro: true, ..NONE }),
        ("all", Aboard { gnss: true, baro: true, mag: true, flow: true, vision: true }),
    ]
};

/// Attitude error as an angle, rad.
pub fn angle(error: &[f64; STATES]) -> f64 {
    error[..3].iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Distance between estimated and true position, m.
pub fn distance(error: &[f64; STATES]) -> f64 {
    error[6..9].iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The estimator as it flies.
pub fn flight() -> Estimator {
    Estimator::try_new(&EstimatorConfig::FLIGHT).expect("a configuration that flies")
}

/// Satellites, barometer and magnetometer.
pub const GNSS: Aboard = SUBSETS[1].1;
/// External vision alone.
pub const VISION: Aboard = SUBSETS[0].1;
/// Everything.
pub const ALL: Aboard = SUBSETS[6].1;
