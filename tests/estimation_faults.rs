//! The estimator with sensors that fail, and with input that is none.
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::estimation::{EstimatorConfig, Phase, Source, SourceFault};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::{Flow, Gnss, Imu, Measurements, Stamped, Vision};
use rayon::prelude::*;
use system_tests::estimation::{ALL, GNSS, VISION, angle, errors, flight, fly};
use system_tests::motion::{Aboard, Motion, Noise, World};

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
                if wild && noise.bits().is_multiple_of(4) {
                    m = garbage(&mut noise, world.now_us);
                }
                if wild && noise.bits().is_multiple_of(64) {
                    now_us = u64::from(noise.bits()) << (noise.bits() % 33);
                }
                if wild && noise.bits().is_multiple_of(2000) {
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

#[test]
fn health_is_withdrawn_in_order_when_vision_is_lost_and_given_back() {
    let estimator = flight();
    let mut world = World::new(Motion::flight(&mut Noise::new(5)), VISION, &EstimatorConfig::FLIGHT, 5);
    let lost_s = f64::from(EstimatorConfig::FLIGHT.limits.dead_reckoning_s);
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
                s.time_us = now_us + 2_000;
            }
        }),
        ("a range that is silent", Source::Range, SourceFault::Silent, |m, _| m.range_m = None),
    ];
    for (why, source, fault, breaks) in rows {
        let estimator = flight();
        let mut world = World::new(Motion::flight(&mut Noise::new(8)), ALL, &EstimatorConfig::FLIGHT, 8);
        // Vision would hide what the others do.
        world.aboard.vision = source == Source::Vision;
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
