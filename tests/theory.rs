//! Every bound that docs/theory.md states of the code, under the name the page cites, through the tick alone.
use control_core::frames::{Attitude, Vec3};
use control_core::law::{GAIN_RATIO_MAX, GAIN_RATIO_MIN};
use control_core::math::tanh;
use control_core::{Airframe, Axis, Config, Controller, Input, Law, Q16, RotorsConfig, Scalar, State};
use proptest::prelude::*;
use system_tests::symbols::{Flown, Symbols, axes, root};

/// Largest tilt setpoint in flight, rad, and what its approximation adds.
const TILT_RAD_MAX: f32 = 0.5 + 1e-4;
/// A few units in the last place of Q16.16, in which bounds and sums are rounded.
const ROUNDING: f32 = 1e-4;

fn flight() -> Config {
    Config::flight(Law::Lgs, Airframe::paper(2.2))
}

/// Sizes that a sample may have, from denormal to the end of what is plausible.
fn numbers() -> impl Strategy<Value = f32> {
    prop_oneof![
        6 => -1.0_f32..1.0,
        3 => -30.0_f32..30.0,
        1 => -2e4_f32..2e4,
        1 => prop::sample::select(vec![0.0, -0.0, 1e-40, -1e-40, f32::MIN_POSITIVE]),
    ]
}

fn rotation([roll, pitch, yaw]: [f32; 3]) -> Attitude {
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    Attitude {
        rows: [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ],
    }
}

/// f32 between two that are not mirror images: drawn in f64, as proptest's own draw of such a range ends in a failed
/// debug assertion once in some ten million.
fn between(low: f64, high: f64) -> impl Strategy<Value = f32> {
    (low..high).prop_map(|x| x as f32)
}

/// Samples meant to do harm: any size, any attitude, any step of time, one in eight spoilt.
fn hostile() -> impl Strategy<Value = Input> {
    let dt_s = prop_oneof![4 => between(5e-4, 8e-3), 1 => prop::sample::select(vec![0.0, -1.0, 1e-40, 1e3])];
    let spoilt = prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 1e5]);
    let angles = prop::array::uniform3(-3.1_f32..3.1);
    (prop::collection::vec(numbers(), 20), angles, dt_s, prop::option::weighted(0.125, (0_usize..20, spoilt))).prop_map(
        |(mut x, angles, dt_s, spoil)| {
            if let Some((field, value)) = spoil {
                x[field] = value;
            }
            let v = |i: usize| Vec3::new(x[i], x[i + 1], x[i + 2]);
            let mut input = Input::hovering();
            input.dt_s = dt_s;
            input.position_m = v(0);
            input.velocity_m_s = v(3);
            input.rate_rad_s = Vec3::new(x[6], x[7], x[8]);
            input.specific_force_m_s2 = Vec3::new(x[9], x[10], x[11]);
            input.attitude = rotation(angles);
            input.setpoint.position_m = v(12);
            input.setpoint.velocity_m_s = v(15);
            input.setpoint.yaw_rad = x[18].clamp(-3.1, 3.1);
            input.setpoint.yaw_rate_rad_s = x[19];
            input
        },
    )
}

/// Hostile samples, each held for some ticks, so that what grows has the time to.
fn assaults() -> impl Strategy<Value = Vec<Input>> {
    prop::collection::vec((hostile(), 1_usize..80), 1..30)
        .prop_map(|held| held.into_iter().flat_map(|(sample, ticks)| std::iter::repeat_n(sample, ticks)).collect())
}

fn stays_bounded<S: Scalar>(config: &Config, samples: &[Input]) -> Result<(), TestCaseError> {
    let controller = Controller::<S>::try_new(config).expect("a valid configuration");
    let mut state = controller.hover_state();
    // The nearest numbers of the format: Q16.16 has no 0.4.
    let nearest = |x| S::from_f32(x).to_f32();
    let bounds = nearest(GAIN_RATIO_MIN)..=nearest(GAIN_RATIO_MAX);
    for sample in samples {
        controller.tick(&mut state, &sample.cast());
        let telemetry = controller.telemetry(&state).to_f32();
        for (axis, config) in telemetry.axes.iter().zip(axes(config)) {
            for ratio in axis.gain_ratios {
                prop_assert!(bounds.contains(&ratio), "{ratio}");
            }
            prop_assert!(axis.integral.abs() <= config.integral_max + ROUNDING, "{}", axis.integral);
        }
        for tilt_rad in telemetry.tilt_setpoint_rad {
            prop_assert!(tilt_rad.abs() <= TILT_RAD_MAX, "{tilt_rad}");
        }
    }
    Ok(())
}

/// Any value that a configuration may hold, each size as likely.
fn allowed() -> impl Strategy<Value = f32> {
    between(-5.99, 3.99).prop_map(|power| 10_f32.powf(power))
}

proptest! {
    #[test]
    fn no_sample_moves_a_gain_an_integral_or_a_tilt_out_of_its_bounds(
        samples in assaults(), thrust_to_weight in between(1.1, 10.0), watching in any::<bool>(),
    ) {
        let rotors = watching.then_some(RotorsConfig::ESTIMATED);
        let config = Config { rotors, ..Config::flight(Law::Lgs, Airframe::paper(thrust_to_weight)) };
        stays_bounded::<f32>(&config, &samples)?;
        stays_bounded::<f64>(&config, &samples)?;
        stays_bounded::<Q16>(&config, &samples)?;
    }

    #[test]
    fn gains_stay_bounded_under_every_configuration_that_is_accepted(
        samples in assaults(), x in prop::collection::vec(allowed(), 12), control_hz in between(50.0, 8000.0), filter_hz in between(1.0, 2000.0),
    ) {
        let mut config = Config { control_hz, filter_hz, ..flight() };
        for axis in [&mut config.gains.x, &mut config.gains.z, &mut config.gains.psi] {
            axis.k0 = [x[0], x[1], x[2]];
            axis.lgs.nu = [x[3], x[4], x[5]];
            (axis.lgs.alpha, axis.lgs.beta, axis.lgs.eps) = (x[6], x[7], x[8]);
            (axis.lgs.lambda, axis.lgs.leak_1_s, axis.lgs.scale) = (x[9], x[10], x[11]);
        }
        let controller = Controller::<f32>::try_new(&config).expect("an accepted configuration");
        let mut state = controller.hover_state();
        for sample in &samples {
            controller.tick(&mut state, sample);
            for ratio in controller.telemetry(&state).axes.iter().flat_map(|axis| axis.gain_ratios) {
                prop_assert!((GAIN_RATIO_MIN..=GAIN_RATIO_MAX).contains(&ratio), "{ratio}");
            }
        }
    }
}

#[test]
fn both_bounds_of_a_gain_and_the_bound_of_an_integral_are_reached() {
    // Rotors that never saturate, which would freeze both.
    let config = Config::flight(Law::Lgs, Airframe::paper(40.0));
    let held = |error_m: f64| {
        let mut flown = Flown::new(&config);
        let mut input = Input::hovering();
        input.setpoint.position_m.z = -error_m;
        let mut range = (1.0_f32, 1.0_f32);
        for _ in 0..10_000 {
            flown.tick(&input);
            let ratio = flown.axes()[Axis::Z as usize].gain_ratios[1] as f32;
            range = (range.0.min(ratio), range.1.max(ratio));
        }
        (range, flown.axes()[Axis::Z as usize].integral)
    };
    let ((_, high), integral) = held(0.4);
    let ((low, _), _) = held(-0.1);
    assert_eq!((low, high), (GAIN_RATIO_MIN, GAIN_RATIO_MAX));
    assert_eq!(integral as f32, config.gains.z.integral_max);
}

proptest! {
    #[test]
    fn gains_move_no_faster_than_the_page_says(samples in assaults()) {
        let config = flight();
        let mut flown = Flown::new(&config);
        let (mut accel, mut turn) = ([0.0_f64; 3], 0.0_f64);
        for sample in &samples {
            let before = flown.axes();
            let input = sample.cast::<f64>();
            if flown.controller.tick(&mut flown.state.clone(), &input).rejected {
                flown.tick(&input);
                prop_assert_eq!(format!("{:?}", flown.axes()), format!("{before:?}"));
                continue;
            }
            flown.tick(&input);
            let felt = input.attitude.to_ned(input.specific_force_m_s2);
            for (most, a) in accel.iter_mut().zip([felt.x, felt.y, felt.z + f64::from(control_core::GRAVITY_M_S2)]) {
                *most = most.max(a.abs());
            }
            turn = turn.max((input.setpoint.yaw_rate_rad_s - input.rate_rad_s.z).abs());
            // A filtered slope is at most its corner times the span of what it filters.
            let heading = 2.0 * core::f64::consts::TAU * f64::from(config.filter_hz) * turn;
            let [x, y, z] = accel;
            for (i, (axis, accel)) in axes(&config).iter().zip([x, y, z, heading]).enumerate() {
                let (symbols, now) = (Symbols::of(axis), &flown.axes()[i]);
                for j in 0..3 {
                    let speed = (now.gain_ratios[j] - before[i].gain_ratios[j]).abs() / flown.lesson_s();
                    let by_residual = symbols.rho[j] * symbols.scale * symbols.residual(now).abs() / 2.0 + 2.0 * symbols.leak;
                    prop_assert!(speed <= 1.00001 * by_residual + 1e-9, "{i} {j}: {speed} {by_residual}");
                    prop_assert!(speed <= 1.00001 * symbols.speed_max(j, accel), "{i} {j}: {speed} {accel}");
                }
            }
        }
    }

    /// Exactly, in f64; f32 stalls where a step is below half a unit in the last place.
    #[test]
    fn without_a_residual_gains_return_at_the_leak(
        taught in prop::array::uniform4(-0.4_f32..0.4), dt_s in between(5e-4, 8e-3), rounds in 1_i32..2000,
    ) {
        let config = flight();
        let mut flown = Flown::new(&config);
        let mut input = Input::hovering();
        let [x, y, z, yaw] = taught;
        (input.setpoint.position_m, input.setpoint.yaw_rad) = (Vec3::new(x, y, z), yaw);
        (0..1000).for_each(|_| flown.tick(&input.cast()));
        input = Input { dt_s, ..Input::hovering() };
        // Until the filters are at rest.
        (0..400).for_each(|_| flown.tick(&input.cast()));
        let before = flown.axes();
        (0..4 * rounds).for_each(|_| flown.tick(&input.cast()));
        let lesson_s = 4.0 * f64::from(dt_s);
        for (i, axis) in axes(&config).iter().enumerate() {
            let leak = Symbols::of(axis).leak;
            for (now, then) in flown.axes()[i].gain_ratios.into_iter().zip(before[i].gain_ratios) {
                let left = (then - 1.0) * (1.0 - leak * lesson_s).powi(rounds);
                prop_assert!((now - 1.0 - left).abs() < 1e-9, "{i}: {now} {left}");
                let envelope = (then - 1.0).abs() * (-leak * lesson_s * f64::from(rounds)).exp();
                prop_assert!((now - 1.0).abs() <= envelope + 1e-12);
            }
        }
    }

    #[test]
    fn noise_inside_the_dead_zone_teaches_nothing(
        shares in prop::array::uniform3(0.0_f64..1.0), draws in prop::collection::vec(prop::array::uniform12(-1.0_f64..1.0), 1..300),
    ) {
        let config = flight();
        let all = axes(&config).map(|axis| Symbols::of(&axis));
        let mut flown = Flown::new(&config);
        let corner = core::f64::consts::TAU * f64::from(config.filter_hz);
        // Amplitudes of e, ė and ë in the drawn proportion, such that the page's sum is just below d.
        let amplitudes: [[f64; 3]; 4] = core::array::from_fn(|i| {
            let Symbols { alpha, beta, eps, lambda, dead_zone, .. } = all[i];
            let [e, v, a] = shares;
            let a = if i == Axis::Psi as usize { 2.0 * corner * v } else { a };
            let layer = alpha + beta / eps;
            let sum = a + lambda * v + layer * (v + lambda * e);
            [e, v, a].map(|share| 0.999 * dead_zone * share / sum.max(1e-9))
        });
        for draw in draws {
            let noise = |i: usize, kind: usize| amplitudes[i][kind] * draw[3 * i + kind];
            let vector = |kind| Vec3::new(noise(0, kind), noise(1, kind), noise(2, kind));
            let mut input = Input::<f64>::hovering();
            let setpoint = &mut input.setpoint;
            (setpoint.position_m, setpoint.velocity_m_s, setpoint.acceleration_m_s2) = (vector(0), vector(1), vector(2));
            (setpoint.yaw_rad, setpoint.yaw_rate_rad_s) = (noise(3, 0), noise(3, 1));
            flown.tick(&input);
            for axis in flown.axes() {
                prop_assert_eq!(axis.gain_ratios, [1.0; 3]);
            }
        }
    }

    #[test]
    fn a_v_that_rises_outside_the_layer_means_more_is_missing_than_the_law_takes(samples in assaults()) {
        let config = flight();
        let mut flown = Flown::new(&config);
        for sample in &samples {
            flown.tick(&sample.cast());
            for (axis, config) in flown.axes().iter().zip(axes(&config)) {
                let symbols = Symbols::of(&config);
                let takes = symbols.alpha * symbols.eps + symbols.beta * tanh(1.0);
                prop_assert!(!axis.v_rises() || symbols.missing(axis) * axis.s.signum() > 0.999_999 * takes, "{axis:?}");
            }
        }
    }
}

#[test]
fn an_error_just_outside_the_dead_zone_teaches() {
    let config = flight();
    for (inside, share) in [(true, 0.99), (false, 1.02)] {
        let mut flown = Flown::new(&config);
        let [x, y, z, yaw] = axes(&config).map(|axis| {
            let Symbols { alpha, beta, eps, lambda, dead_zone, .. } = Symbols::of(&axis);
            share * root(alpha, beta, eps, dead_zone) / lambda
        });
        let mut input = Input::<f64>::hovering();
        (input.setpoint.position_m, input.setpoint.yaw_rad) = (Vec3::new(x, y, -z), yaw);
        (0..2000).for_each(|_| flown.tick(&input));
        for axis in flown.axes() {
            assert_eq!(axis.gain_ratios == [1.0; 3], inside, "{axis:?}");
        }
    }
}

#[test]
fn in_f32_the_leak_ends_within_a_thousandth_of_the_start() {
    let controller = Controller::<f32>::try_new(&flight()).expect("a valid configuration");
    let mut state = controller.hover_state();
    let mut input = Input::<f32>::hovering();
    input.setpoint.position_m = Vec3::new(0.3, 0.3, -0.1);
    (0..500).for_each(|_| _ = controller.tick(&mut state, &input));
    let furthest = |state: &State| {
        let ratios = controller.telemetry(state).axes.map(|axis| axis.gain_ratios);
        ratios.as_flattened().iter().map(|ratio| (ratio - 1.0).abs()).fold(0.0, f32::max)
    };
    assert!(furthest(&state) > 0.1);
    // 1600 s: sixteen time constants of the slowest leak.
    (0..800_000).for_each(|_| _ = controller.tick(&mut state, &Input::hovering()));
    assert!(furthest(&state) < 1e-3, "{}", furthest(&state));
}
