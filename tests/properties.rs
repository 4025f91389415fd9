//! What holds for any input, not only for the shipped flights. Failures print the seed that repeats them.
use control_core::frames::{Attitude, Vec3};
use control_core::law::{GAIN_RATIO_MAX, GAIN_RATIO_MIN};
use control_core::{Airframe, Allocator, Config, Controller, Demand, Input, Law, Q16, Scalar};
use proptest::prelude::*;
use sim_host::controllers::ControllerName;
use sim_host::fault::{Fault, FaultKind, Profile, PulseTrain, Ramp, Rotors, Sine};
use sim_host::flight::{Flight, NumberFormat};
use system_tests::shipped;

fn airframes() -> impl Strategy<Value = Airframe> {
    (any::<bool>(), any::<bool>(), 1.1_f32..5.0, 0.0_f32..0.1).prop_map(|(os4, x, thrust_to_weight, idle)| {
        let plus = if os4 { Airframe::os4(thrust_to_weight) } else { Airframe::paper(thrust_to_weight) };
        let frame = if x { plus.into_x() } else { plus };
        Airframe { thrust_n_min: idle, ..frame }
    })
}

fn demands() -> impl Strategy<Value = Demand> {
    (-5.0_f32..30.0, -3.0_f32..3.0, -3.0_f32..3.0, -0.5_f32..0.5)
        .prop_map(|(thrust_n, roll_nm, pitch_nm, yaw_nm)| Demand { thrust_n, roll_nm, pitch_nm, yaw_nm })
}

/// Thrust and torques that rotor thrusts make, from the geometry alone.
fn achieved(airframe: &Airframe, thrust_n: [f32; 4]) -> Demand {
    let turns = [1.0, -1.0, 1.0, -1.0];
    let mut sum = Demand { thrust_n: 0.0, roll_nm: 0.0, pitch_nm: 0.0, yaw_nm: 0.0 };
    for ((rotor, f), turn) in airframe.rotors.iter().zip(thrust_n).zip(turns) {
        sum.thrust_n += f;
        sum.roll_nm -= rotor.right_m * f;
        sum.pitch_nm += rotor.forward_m * f;
        sum.yaw_nm += turn * airframe.torque_per_thrust_m * f;
    }
    sum
}

proptest! {
    #[test]
    fn allocation_stays_within_limits_and_reports_what_it_refuses(
        airframe in airframes(), demand in demands(),
    ) {
        let allocator = Allocator::<f32>::try_new(&airframe, true).expect("a valid configuration");
        let result = allocator.allocate(&demand);
        for (rotor, f) in airframe.rotors.iter().zip(result.thrust_n) {
            let slack = 1e-6 * rotor.thrust_n_max;
            prop_assert!((airframe.thrust_n_min - slack..=rotor.thrust_n_max + slack).contains(&f), "{f}");
        }
        let made = achieved(&airframe, result.thrust_n);
        let near = |made: f32, refused: f32, asked: f32, unit: f32| (made + refused - asked).abs() < 2e-5 * unit;
        prop_assert!(near(made.thrust_n, result.refused.thrust_n, demand.thrust_n, 30.0));
        prop_assert!(near(made.roll_nm, result.refused.roll_nm, demand.roll_nm, 10.0));
        prop_assert!(near(made.pitch_nm, result.refused.pitch_nm, demand.pitch_nm, 10.0));
        prop_assert!(near(made.yaw_nm, result.refused.yaw_nm, demand.yaw_nm, 1.0));
    }

    /// Any thrusts inside the limits are found again from what they make, and nothing of it is refused.
    #[test]
    fn allocation_refuses_nothing_that_fits(
        airframe in airframes(), shares in prop::array::uniform4(0.01_f32..0.99),
    ) {
        let allocator = Allocator::<f32>::try_new(&airframe, true).expect("a valid configuration");
        let mut thrust_n = [0.0; 4];
        for ((f, rotor), share) in thrust_n.iter_mut().zip(&airframe.rotors).zip(shares) {
            *f = airframe.thrust_n_min + share * (rotor.thrust_n_max - airframe.thrust_n_min);
        }
        let result = allocator.allocate(&achieved(&airframe, thrust_n));
        for (found, f) in result.thrust_n.iter().zip(thrust_n) {
            prop_assert!((found - f).abs() < 1e-4, "{found} {f}");
        }
        prop_assert_eq!(result.refused.roll_nm, 0.0);
        prop_assert_eq!(result.refused.pitch_nm, 0.0);
        prop_assert!(result.refused.thrust_n.abs() < 1e-5 && result.refused.yaw_nm.abs() < 1e-5);
    }

    /// Roll and pitch are given whatever thrust and yaw ask for; thrust whatever yaw asks for.
    #[test]
    fn allocation_keeps_its_priorities(airframe in airframes(), demand in demands(), other in demands()) {
        let allocator = Allocator::<f32>::try_new(&airframe, true).expect("a valid configuration");
        let refused = |demand| allocator.allocate(&demand).refused;
        let base = refused(demand);
        let thrust = refused(Demand { thrust_n: other.thrust_n, ..demand });
        let yaw = refused(Demand { yaw_nm: other.yaw_nm, ..demand });
        for changed in [thrust, yaw] {
            prop_assert_eq!((changed.roll_nm, changed.pitch_nm), (base.roll_nm, base.pitch_nm));
        }
        prop_assert_eq!(yaw.thrust_n, base.thrust_n);
    }
}

/// Numbers as sensors should never give them.
fn garbage() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -100.0_f32..100.0,
        1 => Just(f32::NAN),
        1 => Just(f32::INFINITY),
        1 => Just(f32::NEG_INFINITY),
        1 => any::<f32>(),
    ]
}

fn inputs() -> impl Strategy<Value = Input> {
    prop::collection::vec(garbage(), 33).prop_map(|x| {
        let v = |i: usize| [x[i], x[i + 1], x[i + 2]];
        let [p, vel, rate, force] = [v(1), v(4), v(16), v(19)];
        let mut input = Input::hovering();
        input.dt_s = x[0];
        input.position_m = Vec3::new(p[0], p[1], p[2]);
        input.velocity_m_s = Vec3::new(vel[0], vel[1], vel[2]);
        input.attitude = Attitude { rows: [v(7), v(10), v(13)] };
        input.rate_rad_s = Vec3::new(rate[0], rate[1], rate[2]);
        input.specific_force_m_s2 = Vec3::new(force[0], force[1], force[2]);
        input.setpoint.yaw_rad = x[22];
        input.setpoint.yaw_rate_rad_s = x[23];
        input.setpoint.position_m = Vec3::new(x[24], x[25], x[26]);
        input
    })
}

/// Whether the sample could be true: what the controller may act on.
fn is_finite(input: &Input) -> bool {
    let attitude = input.attitude.rows.as_flattened().iter().all(|x| x.is_finite());
    let vectors = [input.position_m.x, input.position_m.y, input.position_m.z, input.dt_s];
    attitude && vectors.iter().all(|x| x.is_finite())
}

fn survives_garbage<S: Scalar>(law: Law, samples: &[Input]) -> Result<(), TestCaseError> {
    let airframe = Airframe::paper(2.2);
    let controller = Controller::<S>::try_new(&Config::flight(law, airframe)).expect("a valid configuration");
    let mut state = controller.hover_state();
    // A few units in the last place of Q16.16.
    let (lowest, highest) = (-1e-4, airframe.rotors[0].thrust_n_max + 1e-4);
    let mut last = state_thrusts(&controller, &mut state, &Input::hovering());
    for sample in samples {
        let output = controller.tick(&mut state, &sample.cast()).to_f32();
        for f in output.thrust_n {
            prop_assert!((lowest..=highest).contains(&f), "{law:?}: {f} N");
        }
        if output.rejected {
            prop_assert_eq!(output.thrust_n, last, "a rejected sample holds the rotors");
        }
        last = output.thrust_n;
    }
    // And it still flies: good samples bring finite thrusts near hover.
    let after = state_thrusts(&controller, &mut state, &Input::hovering());
    prop_assert!(after.iter().all(|f| f.is_finite()));
    Ok(())
}

fn state_thrusts<S: Scalar>(
    controller: &Controller<S>,
    state: &mut control_core::State<S>,
    sample: &Input,
) -> [f32; 4] {
    controller.tick(state, &sample.cast()).to_f32().thrust_n
}

proptest! {
    #[test]
    fn no_sample_brings_a_thrust_outside_its_limits(samples in prop::collection::vec(inputs(), 1..60)) {
        for law in [Law::Pid, Law::Lgs] {
            survives_garbage::<f32>(law, &samples)?;
            survives_garbage::<f64>(law, &samples)?;
            survives_garbage::<Q16>(law, &samples)?;
        }
    }

    #[test]
    fn samples_that_are_not_finite_are_rejected_and_change_nothing(sample in inputs()) {
        prop_assume!(!is_finite(&sample));
        let controller = Controller::<f32>::try_new(&Config::flight(Law::Lgs, Airframe::paper(2.2))).expect("a valid configuration");
        let mut state = controller.hover_state();
        prop_assert!(controller.tick(&mut state, &sample).rejected);
        let next = controller.tick(&mut state, &Input::hovering()).to_f32();
        let mut fresh = controller.hover_state();
        prop_assert_eq!(format!("{next:?}"), format!("{:?}", controller.tick(&mut fresh, &Input::hovering())));
    }
}

fn profiles() -> impl Strategy<Value = Profile> {
    prop_oneof![
        Just(Profile::Step),
        (0.1_f64..5.0).prop_map(|rise_s| Profile::Ramp(Ramp { rise_s })),
        (0.2_f64..5.0, 0.1_f64..0.9).prop_map(|(period_s, duty)| Profile::PulseTrain(PulseTrain { period_s, duty })),
        (0.2_f64..5.0).prop_map(|period_s| Profile::Sine(Sine { period_s })),
    ]
}

fn faults() -> impl Strategy<Value = Fault> {
    let some = any::<[bool; 4]>().prop_map(Rotors::new).prop_filter("a rotor", |rotors| !rotors.is_empty());
    (some, 0.0_f64..0.5, 2.0_f64..15.0, 0.5_f64..10.0, profiles()).prop_map(
        |(rotors, loss, from_s, lasts_s, profile)| Fault {
            kind: FaultKind::LossOfEffectiveness { loss },
            rotors,
            from_s,
            until_s: from_s + lasts_s,
            profile,
            reported: false,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn gains_stay_in_their_bounds_under_random_faults(
        fault in prop::collection::vec(faults(), 1..4), seed in any::<u64>(), wind_n in 0.0_f64..1.0,
    ) {
        let mut scenario = shipped("flight_wind");
        scenario.duration_s = 20.0;
        scenario.fault = fault;
        scenario.wind.gust_rms_n = wind_n;
        let flight = Flight { scenario: &scenario, controller: ControllerName::Lgs, seed, format: NumberFormat::F32 };
        let mut range = (1.0_f32, 1.0_f32);
        flight.fly(&mut |sample| {
            for axis in &sample.telemetry.axes {
                for ratio in axis.gain_ratios {
                    range = (range.0.min(ratio), range.1.max(ratio));
                }
            }
        }).expect("shipped gains are valid");
        prop_assert!(range.0 >= GAIN_RATIO_MIN && range.1 <= GAIN_RATIO_MAX, "{range:?}");
    }
}
