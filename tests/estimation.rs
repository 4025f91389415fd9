//! The estimator against motion in closed form: is it right, and does it know how right.
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::estimation::{Estimator, EstimatorConfig, STATES};
use control_core::frames::{Attitude, Vec3};
use rayon::prelude::*;
use system_tests::estimation::{
    ALL, GNSS, SUBSETS, VISION, angle, distance, errors, factor, flight, fly, honest, nees,
};
use system_tests::motion::{Aboard, Motion, Noise, World};

/// χ² quantile by Wilson and Hilferty, for many degrees of freedom.
fn chi_squared(degrees: f64, normal: f64) -> f64 {
    let k = 2.0 / (9.0 * degrees);
    degrees * (1.0 - k + normal * k.sqrt()).powi(3)
}

#[test]
fn the_filter_knows_how_wrong_it_is_with_every_set_of_sensors() {
    const RUNS: u64 = 16;
    const TESTED: usize = 15;
    let config = honest();
    let estimator = Estimator::try_new(&config).expect("a configuration that flies");
    for (name, aboard) in SUBSETS {
        let runs: Vec<Vec<f64>> = (0..RUNS)
            .into_par_iter()
            .map(|seed| {
                let mut world = World::new(Motion::flight(&mut Noise::new(seed)), aboard, &config, 1000 + seed);
                let (mut found, mut tick) = (Vec::new(), 0_u32);
                fly(&estimator, &mut world, 45.0, |t_s, world, state, estimate| {
                    tick += 1;
                    if t_s > 6.0 && tick.is_multiple_of(250) {
                        let telemetry = estimator.telemetry(state, world.now_us);
                        let error = errors(estimate, &world.truth(), world, &telemetry);
                        found.push(nees(state.covariance(), &error, TESTED));
                    }
                });
                found
            })
            .collect();
        let times = runs[0].len();
        let band = [-1.96, 1.96].map(|normal| chi_squared((TESTED as u64 * RUNS) as f64, normal) / RUNS as f64);
        let means = (0..times).map(|i| runs.iter().map(|run| run[i]).sum::<f64>() / RUNS as f64);
        let inside = means.clone().filter(|mean| (band[0]..=band[1]).contains(mean)).count() as f64 / times as f64;
        let mean = means.sum::<f64>() / times as f64;
        println!("{name}: NEES {mean:.2} of {TESTED}, {:.0} % of times inside {band:.2?}", 100.0 * inside);
        assert!((band[0]..=band[1]).contains(&mean), "{name}: {mean} outside {band:?}");
        // Times of one flight are not independent, and the filter is cautious: fewer than 95 % are inside in some sets of flights.
        assert!(inside > 0.7, "{name}: {inside} of the times inside {band:?}");
    }
}

#[test]
fn the_covariance_stays_positive_definite_over_random_flights() {
    let estimator = flight();
    let worst = (0..48_u64)
        .into_par_iter()
        .map(|seed| {
            let mut noise = Noise::new(seed);
            let mut motion = Motion::flight(&mut noise);
            motion.spin_rad_s = if seed % 4 == 0 { 35.0 } else { 0.0 };
            let mut world = World::new(motion, ALL, &EstimatorConfig::FLIGHT, seed);
            let (mut state, mut worst) = (estimator.state(), f64::MAX);
            for tick in 0..30_000_u32 {
                if tick % 1000 == 500 {
                    // Any set of sensors, for two seconds at a time.
                    let bits = noise.bits();
                    let has = |bit: u32| bits >> bit & 1 == 1;
                    world.aboard = Aboard { gnss: has(0), baro: has(1), mag: has(2), flow: has(3), vision: has(4) };
                }
                let measurements = world.step();
                estimator.step(&mut state, &measurements, world.now_us);
                if tick % 25 == 0 {
                    let p = state.covariance();
                    let l = factor(p).unwrap_or_else(|| panic!("seed {seed}, tick {tick}"));
                    assert!((0..STATES).all(|i| (0..i).all(|j| p[i][j] == p[j][i])), "symmetric to the bit");
                    worst = (0..STATES).map(|i| l[i][i] * l[i][i]).fold(worst, f64::min);
                }
            }
            assert_eq!(estimator.telemetry(&state, world.now_us).fallbacks, 0, "seed {seed}");
            worst
        })
        .reduce(|| f64::MAX, f64::min);
    println!("smallest pivot of the correlation matrix {worst:.1e}");
    // Ten times what one rounding of `f32` takes.
    assert!(worst > 6e-7, "{worst:e}");
}

/// Root mean square of position error over ten flights.
fn position_rms_m(aboard: Aboard, late: bool) -> f64 {
    let config = honest();
    let estimator = Estimator::try_new(&config).expect("a configuration that flies");
    let runs: Vec<(f64, f64)> = (0..10_u64)
        .into_par_iter()
        .map(|seed| {
            let mut world = World::new(Motion::flight(&mut Noise::new(seed)), aboard, &config, seed);
            world.stamped_late = late;
            let (mut sum, mut count) = (0.0, 0.0);
            fly(&estimator, &mut world, 40.0, |t_s, world, state, estimate| {
                if t_s > 10.0 {
                    let error = errors(estimate, &world.truth(), world, &estimator.telemetry(state, world.now_us));
                    (sum, count) = (sum + distance(&error).powi(2), count + 1.0);
                }
            });
            (sum, count)
        })
        .collect();
    let (sum, count) = runs.into_iter().fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
    (sum / count).sqrt()
}

#[test]
fn a_measurement_fused_at_its_own_time_beats_one_fused_late() {
    for (name, aboard, better) in [("gnss + baro + mag, 150 ms", GNSS, 1.3), ("vision, 20 ms", VISION, 5.0)] {
        let (timely, late) = (position_rms_m(aboard, false), position_rms_m(aboard, true));
        println!("{name}: position error {timely:.4} m rms at its time, {late:.4} m late");
        assert!(late > better * timely, "{name}: {timely} {late}");
    }
}

#[test]
fn attitude_on_satellites_barometer_and_magnetometer_is_right_to_half_a_degree() {
    let config = honest();
    let estimator = Estimator::try_new(&config).expect("a configuration that flies");
    let runs: Vec<(f64, f64)> = (0..10_u64)
        .into_par_iter()
        .map(|seed| {
            let mut world = World::new(Motion::flight(&mut Noise::new(seed)), GNSS, &config, seed);
            let (mut sum, mut count) = (0.0, 0.0);
            fly(&estimator, &mut world, 90.0, |t_s, world, state, estimate| {
                if t_s > 30.0 {
                    let error = errors(estimate, &world.truth(), world, &estimator.telemetry(state, world.now_us));
                    (sum, count) = (sum + angle(&error).powi(2), count + 1.0);
                }
            });
            (sum, count)
        })
        .collect();
    let rms_deg = runs.iter().map(|(sum, count)| (sum / count).sqrt().to_degrees());
    let worst = rms_deg.clone().fold(0.0, f64::max);
    println!("attitude error, rms: {:.3} deg, worst flight {worst:.3}", rms_deg.sum::<f64>() / runs.len() as f64);
    assert!(worst < 0.5, "{worst}");
}

#[test]
fn a_spin_of_35_rad_s_is_integrated_right_at_every_rate_of_sampling() {
    for (sample_hz, bound_rad) in [(500.0, 2e-3), (1000.0, 2e-3), (2000.0, 2e-3)] {
        let mut config = EstimatorConfig::FLIGHT;
        config.gyro.sample_hz = sample_hz;
        (config.inertial.gyro_rad_s_rt_hz, config.inertial.gyro_walk_rad_s_rt_s) = (1e-6, 1e-8);
        let estimator = Estimator::try_new(&config).expect("a configuration that flies");
        let mut noise = Noise::new(3);
        let mut motion = Motion::flight(&mut noise);
        motion.spin_rad_s = 35.0;
        let mut world = World::new(motion, Aboard::default(), &config, 3);
        (world.gyro_bias_rad_s, world.accelerometer_bias_m_s2) = ([0.0; 3], [0.0; 3]);
        let mut state = estimator.resume(&exactly(&world));
        let mut worst = 0.0_f64;
        for _ in 0..(10.0 * sample_hz) as u32 {
            let measurements = world.step();
            let estimate = *estimator.step(&mut state, &measurements, world.now_us);
            let error = errors(&estimate, &world.truth(), &world, &estimator.telemetry(&state, world.now_us));
            worst = worst.max(angle(&error));
        }
        println!("{sample_hz} Hz: {worst:.1e} rad after 10 s unaided");
        assert!(worst < bound_rad, "{sample_hz} Hz: {worst}");
    }
}

/// The truth as an estimate, as sure as that.
fn exactly(world: &World) -> Estimate {
    let truth = world.truth();
    let vec3 = |[x, y, z]: [f64; 3]| Vec3::new(x as f32, y as f32, z as f32);
    Estimate {
        time_us: world.now_us,
        position_m: vec3(truth.position_m),
        velocity_m_s: vec3(truth.velocity_m_s),
        attitude: Attitude { rows: truth.rows.map(|row| row.map(|x| x as f32)) },
        rate_rad_s: Vec3::zero(),
        specific_force_m_s2: Vec3::zero(),
        gyro_bias_rad_s: Vec3::zero(),
        accelerometer_bias_m_s2: Vec3::zero(),
        sigma: Sigma {
            tilt_rad: 1e-3,
            heading_rad: 1e-3,
            horizontal_m_s: 0.01,
            vertical_m_s: 0.01,
            horizontal_m: 0.01,
            altitude_m: 0.01,
        },
        health: Health::default(),
    }
}
