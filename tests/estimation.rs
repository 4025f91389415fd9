//! The estimator against motion in closed form: is it right, does it know how right, and does nothing break it.
use control_core::estimate::Estimate;
use control_core::estimation::{Estimator, EstimatorConfig, EstimatorState, STATES};
use control_core::frames::Vec3;
use rayon::prelude::*;
use system_tests::motion::{Aboard, Motion, Noise, Truth, World, sub};

/// Errors of an estimate in the order of the covariance: attitude, velocity, position and biases.
fn errors(estimate: &Estimate, truth: &Truth, world: &World, offset_m: f32) -> [f64; STATES] {
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
    let mut all = [0.0; STATES];
    for (slot, error) in
        all.iter_mut().zip(groups.into_iter().flatten().chain([world.barometer_offset_m - f64::from(offset_m)]))
    {
        *slot = error;
    }
    all
}

/// The lower factor of the correlation matrix, in f64; `None` if that is not positive definite.
fn factor(p: &[[f32; STATES]; STATES]) -> Option<[[f64; STATES]; STATES]> {
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
fn nees(p: &[[f32; STATES]; STATES], error: &[f64; STATES], states: usize) -> f64 {
    let l = factor(p).expect("positive definite");
    let mut y = [0.0; STATES];
    for i in 0..states {
        let rest = error[i] / f64::from(p[i][i]).sqrt() - (0..i).map(|k| l[i][k] * y[k]).sum::<f64>();
        y[i] = rest / l[i][i];
    }
    y[..states].iter().map(|y| y * y).sum()
}

/// A flight, told at every sample.
fn fly(
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
fn honest() -> EstimatorConfig {
    let mut config = EstimatorConfig::FLIGHT;
    config.inertial.gyro_scale = 0.0;
    config.inertial.gyro_bias_rad_s = 3e-4;
    config
}

const SUBSETS: [(&str, Aboard); 7] = {
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

/// χ² quantile by Wilson and Hilferty, for many degrees of freedom.
fn chi_squared(degrees: f64, normal: f64) -> f64 {
    let k = 2.0 / (9.0 * degrees);
    degrees * (1.0 - k + normal * k.sqrt()).powi(3)
}

#[test]
fn the_filter_knows_how_wrong_it_is_with_every_set_of_sensors() {
    const RUNS: u64 = 24;
    const STATES_TESTED: usize = 15;
    let config = honest();
    let estimator = Estimator::try_new(&config).expect("a configuration that flies");
    for (name, aboard) in SUBSETS {
        let runs: Vec<Vec<(f64, [f64; STATES])>> = (0..RUNS)
            .into_par_iter()
            .map(|seed| {
                let mut world = World::new(Motion::flight(&mut Noise::new(seed)), aboard, &config, 1000 + seed);
                let mut found = Vec::new();
                let mut tick = 0_u32;
                fly(&estimator, &mut world, 60.0, |t_s, world, state, estimate| {
                    tick += 1;
                    if t_s > 6.0 && tick % 250 == 0 {
                        let offset_m = estimator.telemetry(state, world.now_us).barometer_offset_m;
                        let error = errors(estimate, &world.truth(), world, offset_m);
                        let mut shares = error;
                        for (i, share) in shares.iter_mut().enumerate() {
                            *share = *share * *share / f64::from(state.covariance()[i][i]);
                        }
                        found.push((nees(state.covariance(), &error, STATES_TESTED), shares));
                    }
                });
                found
            })
            .collect();
        let degrees = (STATES_TESTED as u64 * RUNS) as f64;
        let band = [-1.96, 1.96].map(|normal| chi_squared(degrees, normal) / RUNS as f64);
        let times = runs[0].len();
        let means: Vec<f64> = (0..times).map(|i| runs.iter().map(|run| run[i].0).sum::<f64>() / RUNS as f64).collect();
        let inside = means.iter().filter(|mean| (band[0]..=band[1]).contains(*mean)).count() as f64 / times as f64;
        let mean = means.iter().sum::<f64>() / times as f64;
        let shares: Vec<String> = (0..STATES)
            .map(|s| runs.iter().flatten().map(|(_, shares)| shares[s]).sum::<f64>() / (times as u64 * RUNS) as f64)
            .map(|x| format!("{x:.2}"))
            .collect();
        println!(
            "{name}: NEES {mean:.2} of 15, band {:.2} to {:.2}, inside {:.0} %; per state {}",
            band[0],
            band[1],
            100.0 * inside,
            shares.join(" ")
        );
    }
}
