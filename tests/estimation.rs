//! The estimator against motion in closed form: is it right, does it know how right, and does nothing break it.
use control_core::estimate::Estimate;
use control_core::estimate::{Health, Sigma};
use control_core::estimation::{
    Estimator, EstimatorConfig, EstimatorState, EstimatorTelemetry, Phase, STATES, Source, SourceFault,
};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::{Flow, Gnss, Imu, Measurements, Stamped, Vision};
use rayon::prelude::*;
use system_tests::motion::{Aboard, Motion, Noise, Truth, World, sub};

/// Errors of an estimate in the order of the covariance: attitude, velocity, position and biases.
fn errors(estimate: &Estimate, truth: &Truth, world: &World, telemetry: &EstimatorTelemetry) -> [f64; STATES] {
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

/// Attitude error as an angle, rad.
fn angle(error: &[f64; STATES]) -> f64 {
    error[..3].iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Distance between estimated and true position, m.
fn distance(error: &[f64; STATES]) -> f64 {
    error[6..9].iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn flight() -> Estimator {
    Estimator::try_new(&EstimatorConfig::FLIGHT).expect("a configuration that flies")
}

const GNSS: Aboard = SUBSETS[1].1;
const VISION: Aboard = SUBSETS[0].1;
const ALL: Aboard = SUBSETS[6].1;

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
        // Times of one flight are not independent: fewer than 95 % are inside in some sets of flights.
        assert!(inside > 0.75, "{name}: {inside} of the times inside {band:?}");
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

/// Any `f32`, from sensible to not a number.
fn any(noise: &mut Noise) -> f32 {
    match noise.bits() % 16 {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 => f32::NEG_INFINITY,
        3 => f32::from_bits(noise.bits()),
        4 => 0.0,
        5 => 1e30,
        6..=9 => (noise.normal() * 100.0) as f32,
        _ => noise.normal() as f32,
    }
}

#[test]
fn a_million_samples_of_anything_neither_panic_nor_put_out_what_is_not_a_number() {
    let estimator = flight();
    let finite = |e: &Estimate| {
        let vectors = [e.position_m.x, e.position_m.y, e.position_m.z, e.velocity_m_s.x, e.velocity_m_s.y];
        let body = [e.rate_rad_s, e.specific_force_m_s2, e.gyro_bias_rad_s, e.accelerometer_bias_m_s2];
        let Sigma { tilt_rad, heading_rad, horizontal_m_s, vertical_m_s, horizontal_m, altitude_m } = e.sigma;
        let sigma = [tilt_rad, heading_rad, horizontal_m_s, vertical_m_s, horizontal_m, altitude_m];
        let body = body.iter().flat_map(|v| [v.x, v.y, v.z]);
        vectors.into_iter().chain(body).chain(sigma).chain(e.attitude.rows.into_iter().flatten()).all(f32::is_finite)
            && e.velocity_m_s.z.is_finite()
    };
    let runs: Vec<(u32, u32)> = (0..10_u64)
        .into_par_iter()
        .map(|seed| {
            let mut noise = Noise::new(seed);
            let mut world = World::new(Motion::flight(&mut noise), ALL, &EstimatorConfig::FLIGHT, seed);
            let (mut state, mut phases) = (estimator.state(), [0_u32; 3]);
            for tick in 0..100_000_u32 {
                // True samples for a while, then some of any kind at any time, so that every phase meets them.
                let mut m = world.step();
                let mut now_us = world.now_us;
                let wild = tick % 20_000 > 4_000;
                if wild && noise.bits() % 4 == 0 {
                    m = garbage(&mut noise, world.now_us);
                }
                if wild && noise.bits() % 64 == 0 {
                    now_us = u64::from(noise.bits()) << (noise.bits() % 33);
                }
                if wild && noise.bits() % 2000 == 0 {
                    world.now_us += u64::from(noise.bits() % 2_000_000);
                }
                let estimate = estimator.step(&mut state, &m, now_us);
                assert!(finite(estimate), "seed {seed}, tick {tick}: {estimate:?}");
                let up = estimate.attitude.rows[2].iter().map(|x| x * x).sum::<f32>();
                assert!((up - 1.0).abs() < 1e-2, "seed {seed}, tick {tick}: {up}");
                phases[estimator.telemetry(&state, now_us).phase as usize] += 1;
            }
            (phases[1], phases[2])
        })
        .collect();
    println!("samples in the filter and in the fall-back, by run: {runs:?}");
    assert!(runs.iter().all(|&(running, _)| running > 10_000) && runs.iter().any(|&(_, fallen)| fallen > 1000));
}

/// A sample of anything.
fn garbage(noise: &mut Noise, now_us: u64) -> Measurements {
    fn vec3<F: Copy>(noise: &mut Noise) -> Vec3<F> {
        Vec3::new(any(noise), any(noise), any(noise))
    }
    let time_us = |noise: &mut Noise| match noise.bits() % 8 {
        0 => u64::MAX,
        1 => 0,
        2 => now_us + u64::from(noise.bits() % 100_000),
        _ => now_us.saturating_sub(u64::from(noise.bits() % 300_000)),
    };
    let mut m = Measurements::default();
    let bits = noise.bits();
    if bits & 1 == 0 {
        let value = Imu { rate_rad_s: vec3(noise), specific_force_m_s2: vec3(noise) };
        m.imu = Some(Stamped { time_us: time_us(noise), value });
        m.imu_second = Some(Stamped { time_us: time_us(noise), value });
    }
    if bits & 2 == 0 {
        m.baro_altitude_m = Some(Stamped { time_us: time_us(noise), value: any(noise) });
        m.magnetic_ut = Some(Stamped { time_us: time_us(noise), value: vec3(noise) });
    }
    if bits & 4 == 0 {
        let value = Gnss {
            position_m: vec3(noise),
            velocity_m_s: vec3(noise),
            horizontal_m: any(noise),
            vertical_m: any(noise),
            speed_m_s: any(noise),
            fixed: true,
        };
        m.gnss = Some(Stamped { time_us: time_us(noise), value });
    }
    if bits & 8 == 0 {
        m.range_m = Some(Stamped { time_us: time_us(noise), value: any(noise) });
        let value = Flow { rate_rad_s: [any(noise), any(noise)], quality: any(noise) };
        m.flow = Some(Stamped { time_us: time_us(noise), value });
    }
    if bits & 16 == 0 {
        let mut attitude = Attitude::level();
        attitude.rows[(bits >> 8) as usize % 3][(bits >> 12) as usize % 3] = any(noise);
        let value =
            Vision { position_m: vec3(noise), attitude, position_sigma_m: any(noise), attitude_sigma_rad: any(noise) };
        m.vision = Some(Stamped { time_us: time_us(noise), value });
    }
    m.rotor_rad_s = Some(Stamped { time_us: now_us, value: [any(noise), any(noise), any(noise), any(noise)] });
    m
}

/// Root mean square of position error over ten flights.
fn position_rms_m(aboard: Aboard, late: bool) -> f64 {
    let estimator = flight();
    let runs: Vec<(f64, f64)> = (0..10_u64)
        .into_par_iter()
        .map(|seed| {
            let mut world = World::new(Motion::flight(&mut Noise::new(seed)), aboard, &EstimatorConfig::FLIGHT, seed);
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
    let estimator = flight();
    let runs: Vec<(f64, f64)> = (0..10_u64)
        .into_par_iter()
        .map(|seed| {
            let mut world = World::new(Motion::flight(&mut Noise::new(seed)), GNSS, &EstimatorConfig::FLIGHT, seed);
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

#[test]
fn health_is_withdrawn_in_order_when_vision_is_lost_and_given_back() {
    let estimator = flight();
    let mut world = World::new(Motion::flight(&mut Noise::new(5)), VISION, &EstimatorConfig::FLIGHT, 5);
    let lost_s = EstimatorConfig::FLIGHT.limits.dead_reckoning_s as f64;
    let mut last = Health::default();
    let mut seen = Vec::new();
    let mut state = estimator.state();
    for tick in 1..=25_000_u32 {
        let t_s = f64::from(tick) * 0.002;
        world.aboard.vision = !(20.0..40.0).contains(&t_s);
        let measurements = world.step();
        let estimate = estimator.step(&mut state, &measurements, world.now_us);
        if estimate.health != last {
            last = estimate.health;
            seen.push((t_s, last));
        }
        if (20.5..20.0 + lost_s - 0.5).contains(&t_s) {
            assert!(last.tilt && last.heading, "{t_s}: {last:?}");
        }
        if (20.0 + lost_s + 0.1..40.0).contains(&t_s) {
            assert!(last.tilt && !last.velocity && !last.position && !last.altitude, "{t_s}: {last:?}");
        }
        if t_s > 41.0 {
            assert!(last.position && last.altitude, "{t_s}: {last:?}");
        }
    }
    println!("{seen:?}");
    let telemetry = estimator.telemetry(&state, world.now_us);
    assert_eq!(telemetry.sources[Source::Vision as usize].fault, None);
}

type Break = fn(&mut Measurements, u64);

#[test]
fn a_faulty_source_is_named_and_the_others_carry_on() {
    let rows: [(&str, Source, SourceFault, Break); 8] = [
        ("GNSS stuck", Source::Gnss, SourceFault::Stuck, |m, _| {
            if let Some(s) = &mut m.gnss {
                s.value.position_m = Vec3::zero();
                s.value.velocity_m_s = Vec3::zero();
            }
        }),
        ("GNSS beside the truth", Source::Gnss, SourceFault::Disagrees, |m, _| {
            if let Some(s) = &mut m.gnss {
                s.value.position_m.x += 30.0;
            }
        }),
        ("GNSS without a fix", Source::Gnss, SourceFault::OutOfRange, |m, _| {
            if let Some(s) = &mut m.gnss {
                s.value.fixed = false;
            }
        }),
        ("a barometer of NaN", Source::Barometer, SourceFault::NotFinite, |m, _| {
            if let Some(s) = &mut m.baro_altitude_m {
                s.value = f32::NAN;
            }
        }),
        ("a magnet", Source::Magnetometer, SourceFault::OutOfRange, |m, _| {
            if let Some(s) = &mut m.magnetic_ut {
                s.value.x += 300.0;
            }
        }),
        ("vision that jumps", Source::Vision, SourceFault::Disagrees, |m, _| {
            if let Some(s) = &mut m.vision {
                s.value.position_m.y += 5.0;
            }
        }),
        ("flow from the future", Source::Flow, SourceFault::FromTheFuture, |m, now_us| {
            if let Some(s) = &mut m.flow {
                s.time_us = now_us + 1;
            }
        }),
        ("a range that is silent", Source::Range, SourceFault::Silent, |m, _| m.range_m = None),
    ];
    for (why, source, fault, breaks) in rows {
        let estimator = flight();
        let mut world = World::new(Motion::flight(&mut Noise::new(8)), ALL, &EstimatorConfig::FLIGHT, 8);
        // Vision would hide what the others do.
        world.aboard.vision = source == Source::Vision;
        world.aboard.gnss = source != Source::Flow && source != Source::Range;
        let (mut state, mut worst) = (estimator.state(), 0.0_f64);
        for tick in 0..12_500_u32 {
            let mut measurements = world.step();
            if tick > 7_500 {
                breaks(&mut measurements, world.now_us);
            }
            let estimate = *estimator.step(&mut state, &measurements, world.now_us);
            let telemetry = estimator.telemetry(&state, world.now_us);
            let error = errors(&estimate, &world.truth(), &world, &telemetry);
            if tick > 8_500 {
                assert_eq!(telemetry.sources[source as usize].fault, Some(fault), "{why} {tick}");
                worst = worst.max(angle(&error).to_degrees());
            }
            let health = estimate.health;
            assert!(tick < 7_500 || (health.heading && health.altitude && health.velocity), "{why}: {health:?}");
        }
        println!("{why}: attitude error at most {worst:.2} deg");
        assert!(worst < 2.0, "{why}: {worst}");
    }
}

#[test]
fn a_second_inertial_unit_stands_in_with_biases_of_its_own() {
    let estimator = flight();
    for (why, fault) in
        [("stuck", SourceFault::Stuck), ("NaN", SourceFault::NotFinite), ("silent", SourceFault::Silent)]
    {
        let mut world = World::new(Motion::flight(&mut Noise::new(9)), GNSS, &EstimatorConfig::FLIGHT, 9);
        let (mut state, mut worst, mut stuck) = (estimator.state(), 0.0_f64, None);
        for tick in 0..20_000_u32 {
            let mut m = world.step();
            m.imu_second = m.imu.map(|mut s| {
                s.value.rate_rad_s.x += 0.02;
                s.value.specific_force_m_s2.z -= 0.3;
                s
            });
            if tick >= 15_000 {
                let value = stuck.get_or_insert(m.imu.expect("a sample").value);
                match fault {
                    SourceFault::Stuck => m.imu.iter_mut().for_each(|s| s.value = *value),
                    SourceFault::NotFinite => m.imu.iter_mut().for_each(|s| s.value.rate_rad_s.y = f32::NAN),
                    _ => m.imu = None,
                }
            }
            let estimate = *estimator.step(&mut state, &m, world.now_us);
            let telemetry = estimator.telemetry(&state, world.now_us);
            let error = errors(&estimate, &world.truth(), &world, &telemetry);
            if tick > 10_000 {
                worst = worst.max(angle(&error).to_degrees());
                assert!(estimate.health.position, "{why} {tick}: {:?}", estimate.health);
            }
            if tick > 15_050 {
                assert_eq!(
                    (telemetry.inertial, telemetry.sources[0].fault),
                    (Source::InertialSecond, Some(fault)),
                    "{why}"
                );
            }
        }
        println!("{why}: attitude error at most {worst:.2} deg");
        assert!(worst < 3.0, "{why}: {worst}");
    }
}

#[test]
fn after_a_second_without_inertial_samples_fixed_gains_bring_the_filter_back() {
    let estimator = flight();
    let mut world = World::new(Motion::rest(0.7), GNSS, &EstimatorConfig::FLIGHT, 12);
    let (mut state, mut phases) = (estimator.state(), Vec::new());
    for tick in 0..15_000_u32 {
        let mut m = world.step();
        if (5_000..5_500).contains(&tick) {
            m.imu = None;
        }
        let estimate = *estimator.step(&mut state, &m, world.now_us);
        let telemetry = estimator.telemetry(&state, world.now_us);
        if phases.last() != Some(&telemetry.phase) {
            phases.push(telemetry.phase);
        }
        if (5_011..5_500).contains(&tick) {
            assert_eq!(estimate.health, Health::default());
        }
        if tick > 14_000 {
            let error = errors(&estimate, &world.truth(), &world, &telemetry);
            assert!(
                angle(&error) < 0.06 && estimate.health.position,
                "{tick}: {} {:?}",
                angle(&error),
                estimate.health
            );
        }
    }
    assert_eq!(phases, [Phase::Aligning, Phase::Running, Phase::FallenBack, Phase::Running]);
}

#[test]
fn without_any_velocity_tilt_is_held_and_nothing_that_is_unknown_is_claimed() {
    let estimator = flight();
    let aboard = Aboard { baro: true, mag: true, ..Aboard::default() };
    let mut world = World::new(Motion::flight(&mut Noise::new(2)), aboard, &EstimatorConfig::FLIGHT, 2);
    let mut worst = 0.0_f64;
    fly(&estimator, &mut world, 300.0, |t_s, world, state, estimate| {
        if t_s > 20.0 {
            let error = errors(estimate, &world.truth(), world, &estimator.telemetry(state, world.now_us));
            worst = worst.max(error[0].hypot(error[1]).to_degrees());
            let health = estimate.health;
            assert!(health.tilt && health.heading && health.altitude && !health.velocity, "{t_s}: {health:?}");
        }
    });
    println!("tilt error at most {worst:.2} deg in five minutes without velocity");
    assert!(worst < 8.0, "{worst}");
}
