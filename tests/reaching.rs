//! What docs/theory.md proves of the reaching law, the error and the ideal gains, under its assumptions.
//!
//! Where a proof is about the law on paper, the recursion is flown here; where it is about the code, the tick.
use control_core::frames::{Attitude, Vec3};
use control_core::{Airframe, Axis, Config, Controller, Input, Law};
use proptest::prelude::*;
use sim_host::controllers::ControllerName;
use sim_host::fault::FaultKind;
use system_tests::symbols::{Flown, Symbols, axes, root};
use system_tests::{fly, metric, shipped};

fn flight() -> Config {
    Config::flight(Law::Lgs, Airframe::paper(2.2))
}

/// The reaching law on paper, one Euler step at a time: α, β, ε and the step h.
#[derive(Clone, Copy, Debug)]
struct Reaching {
    alpha: f64,
    beta: f64,
    eps: f64,
    step_s: f64,
}

impl Reaching {
    fn next(&self, s: f64, disturbance: f64) -> f64 {
        s + self.step_s * (disturbance - self.alpha * s - self.beta * (s / self.eps).tanh())
    }

    /// s̄(D), by the library's tanh, which the recursion here does not share.
    fn bound(&self, most: f64) -> f64 {
        let (mut low, mut high) = (0.0, most / self.alpha);
        for _ in 0..200 {
            let middle = f64::midpoint(low, high);
            let taken = self.alpha * middle + self.beta * (middle / self.eps).tanh();
            if taken < most { low = middle } else { high = middle }
        }
        high
    }
}

/// Any reaching law whose step is short enough for its layer: h (α + β/ε) ≤ 1.
fn reaching() -> impl Strategy<Value = Reaching> {
    (0.1_f64..30.0, 0.01_f64..30.0, 0.01_f64..2.0, 0.01_f64..1.0).prop_map(|(alpha, beta, eps, share)| Reaching {
        alpha,
        beta,
        eps,
        step_s: share / (alpha + beta / eps),
    })
}

proptest! {
    #[test]
    fn s_comes_within_its_bound_at_the_rate_alpha_and_stays(
        law in reaching(), most in 0.0_f64..20.0, start in -50.0_f64..50.0,
        draws in prop::collection::vec(-1.0_f64..1.0, 1..2000), pushes in any::<bool>(),
    ) {
        let bound = law.bound(most);
        let excess = (start.abs() - bound).max(0.0);
        let (mut s, mut envelope) = (start, excess);
        for draw in draws {
            // Half of the flights are pushed outward as hard as they may be, with the sign of s.
            s = law.next(s, most * if pushes { s.signum() } else { draw });
            envelope *= 1.0 - law.step_s * law.alpha;
            prop_assert!(s.abs() <= bound + envelope + 1e-9, "{law:?}: {s}, bound {bound}, envelope {envelope}");
        }
    }

    #[test]
    fn a_constant_disturbance_brings_s_to_its_bound(law in reaching(), most in 0.01_f64..20.0) {
        let steps = (20.0 / (law.step_s * law.alpha)) as usize;
        prop_assume!(steps < 1_000_000);
        let s = (0..steps).fold(0.0, |s, _| law.next(s, most));
        prop_assert!((s / law.bound(most) - 1.0).abs() < 1e-6, "{law:?}: {s}");
    }
}

#[test]
fn far_outside_the_layer_s_falls_hardly_faster_than_at_the_rate_alpha() {
    let law = Reaching { alpha: 4.0, beta: 2.0, eps: 0.25, step_s: 0.002 };
    let s = (0..100).fold(1000.0, |s, _| law.next(s, 0.0));
    let stated = 1000.0 * (1.0 - law.step_s * law.alpha).powi(100);
    assert!(s <= stated && s > 0.998 * stated, "{s} {stated}");
}

#[test]
fn a_step_too_long_for_the_layer_chatters_for_ever() {
    // Table 2's k_p of z, at 1 kHz: h (α + β/ε) = 10.
    let law = Reaching { alpha: 20.0, beta: 10.0, eps: 0.001, step_s: 0.001 };
    let s = (0..100_000).fold(1e-6, |s, _| law.next(s, 0.0));
    let stated = law.step_s * law.beta / (2.0 - law.step_s * law.alpha);
    assert!((s.abs() / stated - 1.0).abs() < 0.01, "{s} {stated}");
    let short = Reaching { step_s: 0.99e-4, ..law };
    assert!((0..100_000).fold(1e-6, |s, _| short.next(s, 0.0)).abs() < 1e-12);
}

proptest! {
    #[test]
    fn the_error_comes_within_s_over_lambda_behind_the_filter(
        waves in prop::collection::vec((0.0_f64..0.1, 0.01_f64..30.0, 0.0_f64..6.3), 1..5), offset in -0.2_f64..0.2,
        dt_s in 5e-4_f64..8e-3,
    ) {
        let config = flight();
        let error = |tick: f64| {
            let t_s = tick * dt_s;
            waves.iter().fold(offset, |sum, (height, rate, phase)| sum + height * (rate * t_s + phase).sin())
        };
        let mut flown = Flown::new(&config);
        let filter_s = 1.0 / (core::f64::consts::TAU * f64::from(config.filter_hz));
        let mut most_s = [0.0_f64; 4];
        for tick in 0..1500 {
            let tick = f64::from(tick);
            let (e, rate) = (error(tick), (error(tick) - error(tick - 1.0)) / dt_s);
            let mut input = Input::<f64>::hovering();
            input.dt_s = dt_s;
            (input.setpoint.position_m, input.setpoint.velocity_m_s) = (Vec3::new(e, e, -e), Vec3::new(rate, rate, -rate));
            (input.setpoint.yaw_rad, input.setpoint.yaw_rate_rad_s) = (e, rate);
            flown.tick(&input);
            for (i, (axis, config)) in flown.axes().iter().zip(axes(&config)).enumerate() {
                most_s[i] = most_s[i].max(axis.s.abs());
                let Symbols { lambda, .. } = Symbols::of(&config);
                let stretch = 1.0 + lambda * filter_s;
                // The filter is at rest before the first tick.
                let left = error(-1.0).abs() / stretch * (1.0 + dt_s * lambda / stretch).powf(-tick - 1.0);
                prop_assert!(e.abs() <= most_s[i] / lambda + left + 1e-9, "{i}: {e} {} {left}", most_s[i]);
            }
        }
    }
}

proptest! {
    #[test]
    fn the_slope_of_s_exceeds_the_measured_one_by_the_lag_of_the_filter(
        waves in prop::collection::vec((0.0_f64..0.1, 0.01_f64..30.0, 0.0_f64..6.3), 1..5), dt_s in 5e-4_f64..8e-3,
    ) {
        let config = flight();
        let error = |tick: i32| {
            let t_s = f64::from(tick) * dt_s;
            waves.iter().fold(0.0, |sum, (height, rate, phase)| sum + height * (rate * t_s + phase).sin())
        };
        let rate = |tick| (error(tick) - error(tick - 1)) / dt_s;
        let filter_s = 1.0 / (core::f64::consts::TAU * f64::from(config.filter_hz));
        let mut flown = Flown::new(&config);
        for tick in 0..800 {
            let (e, v, a) = (error(tick), rate(tick), (rate(tick) - rate(tick - 1)) / dt_s);
            let mut input = Input::<f64>::hovering();
            input.dt_s = dt_s;
            let setpoint = &mut input.setpoint;
            setpoint.position_m = Vec3::new(e, e, -e);
            setpoint.velocity_m_s = Vec3::new(v, v, -v);
            setpoint.acceleration_m_s2 = Vec3::new(a, a, -a);
            let before = flown.axes();
            flown.tick(&input);
            // The start of the filters has faded.
            if tick > 600 {
                for (i, config) in axes(&config).iter().enumerate().take(3) {
                    let (now, Symbols { lambda, .. }) = (flown.axes()[i], Symbols::of(config));
                    let slope = (now.s - before[i].s) / dt_s;
                    let accel = now.s_rate - lambda * (now.s - lambda * e);
                    let lag = lambda * filter_s * accel;
                    prop_assert!((slope - now.s_rate - lag).abs() < 1e-5, "{i}: {slope} {} {lag}", now.s_rate);
                }
            }
        }
    }
}

#[test]
fn an_error_that_stays_is_s_over_lambda() {
    let config = flight();
    let mut flown = Flown::new(&config);
    let mut input = Input::<f64>::hovering();
    input.setpoint.position_m.x = 0.1;
    (0..500).for_each(|_| flown.tick(&input));
    let lambda = Symbols::of(&config.gains.x).lambda;
    assert!((flown.axes()[0].s / lambda - 0.1).abs() < 1e-9);
}

#[test]
fn the_numbers_of_the_page_follow_from_the_shipped_gains() {
    let page = std::fs::read_to_string(system_tests::root().join("docs/theory.md")).expect("the page");
    let config = flight();
    for (name, unit, g, i) in [("x, y", "m", 1.0, 0), ("z", "m", 1.0 / 0.52, 2), ("ψ", "rad", 1.0 / 0.055_976_96, 3)] {
        let Symbols { rho, scale, alpha, beta, eps, lambda, dead_zone, leak, .. } = Symbols::of(&axes(&config)[i]);
        let s = root(alpha, beta, eps, dead_zone);
        let fastest = rho.into_iter().fold(0.0, f64::max) * scale * scale * g;
        let row = format!(
            "| {name} | {:.3} | {:.4} {unit} | {:.2} | {:.0} s | {:.2} s |",
            s,
            s / lambda,
            alpha * eps + beta * 1.0_f64.tanh(),
            40.0_f64.ln() / leak,
            2.0 / fastest,
        );
        assert!(page.contains(&row), "docs/theory.md lacks {row}");
        assert!(0.032 * (alpha + beta / eps) < 1.0 && 0.032 < 2.0 * (1.0 - 0.032 * leak) / fastest, "late ticks too");
    }
}

/// x of a machine whose command lacks g Σ (k* − k) Π + δ at every tick, level and told how it must accelerate.
struct Matched {
    flown: Flown,
    symbols: Symbols,
    /// The ideal gains over the starting ones.
    ideal: [f64; 3],
    /// g.
    effectiveness: f64,
}

impl Matched {
    fn new(ideal: [f64; 3], effectiveness: f64) -> Self {
        let config = flight();
        Self { flown: Flown::new(&config), symbols: Symbols::of(&config.gains.x), ideal, effectiveness }
    }

    /// Weighted distance of the gains from the ideal ones.
    fn distance(&self, ratios: [f64; 3]) -> f64 {
        let terms = (0..3).map(|j| (ratios[j] - self.ideal[j]).powi(2) / self.symbols.rho[j]);
        terms.sum::<f64>().sqrt()
    }

    /// One tick; returns the distance before and after it.
    fn tick(&mut self, error: f64, rate: f64, disturbance: f64) -> (f64, f64) {
        let mut input = Input::<f64>::hovering();
        (input.setpoint.position_m.x, input.setpoint.velocity_m_s.x) = (error, rate);
        let before = self.flown.axes()[0].gain_ratios;
        // What is missing is affine in the acceleration told: two looks ahead find the one that is meant.
        let mut look = |accel| {
            input.setpoint.acceleration_m_s2.x = accel;
            let axis = self.flown.after(&input)[0];
            (self.symbols.missing(&axis), axis)
        };
        let ((at_zero, axis), (at_one, _)) = (look(0.0), look(1.0));
        let regressor = [error, axis.integral, axis.s - self.symbols.lambda * error];
        let lacks = |j: usize| self.symbols.k0[j] * (self.ideal[j] - before[j]) * regressor[j];
        let meant = self.effectiveness * (lacks(0) + lacks(1) + lacks(2)) + disturbance;
        input.setpoint.acceleration_m_s2.x = (meant - at_zero) / (at_one - at_zero);
        self.flown.tick(&input);
        (self.distance(before), self.distance(self.flown.axes()[0].gain_ratios))
    }
}

proptest! {
    #[test]
    fn gains_never_get_further_from_the_ideal_than_they_were_or_started(
        ideal in prop::array::uniform3(0.4_f64..3.0), effectiveness in 0.05_f64..1.0,
        draws in prop::collection::vec((-1.0_f64..1.0, -3.0_f64..3.0, -1.0_f64..1.0, 1_usize..20), 1..60),
    ) {
        let mut world = Matched::new(ideal, effectiveness);
        let (leak, dead_zone) = (world.symbols.leak, world.symbols.dead_zone);
        let start = world.distance([1.0; 3]);
        for (error, rate, disturbance, ticks) in draws {
            for _ in 0..ticks {
                let (before, after) = world.tick(error, rate, 0.999 * dead_zone * disturbance);
                let kept = 1.0 - leak * world.flown.lesson_s();
                // Another axis' turn moves nothing; in its own turn the page's inequality holds.
                let own = kept * before + (1.0 - kept) * start;
                prop_assert!(after == before || after <= own + 1e-9, "{before} {after} {own}");
            }
        }
    }
}

#[test]
fn gains_come_nearer_the_ideal_and_a_disturbance_beyond_the_dead_zone_can_drive_them_away() {
    let mut world = Matched::new([1.5, 2.0, 1.5], 1.0);
    let mut distances = Vec::new();
    for tick in 0..20_000 {
        distances.push(world.tick(1.0 + 0.5 * (f64::from(tick) * 0.01).sin(), (f64::from(tick) * 0.03).sin(), 0.0).1);
    }
    assert!(distances[19_999] < 0.95 * distances[0], "{} {}", distances[0], distances[19_999]);

    let mut world = Matched::new([1.0; 3], 1.0);
    let away = (0..5000).map(|_| world.tick(0.3, 0.0, 3.0 * world.symbols.dead_zone).1).fold(0.0, f64::max);
    assert!(away > 0.1, "{away}");
}

#[test]
fn a_large_error_moves_k_i_at_half_the_stated_speed() {
    // Rotors that never saturate: what is learnt into saturation is thrown away.
    let config = Config::flight(Law::Lgs, Airframe::paper(40.0));
    let symbols = Symbols::of(&config.gains.z);
    let mut flown = Flown::new(&config);
    let mut input = Input::<f64>::hovering();
    // Inside the dead zone, but far enough to fill the integral.
    input.setpoint.position_m.z = -0.006;
    (0..200_000).for_each(|_| flown.tick(&input));
    let z = |flown: &Flown| flown.axes()[Axis::Z as usize];
    assert!(z(&flown).integral > 1.5 && z(&flown).gain_ratios == [1.0; 3], "{:?}", z(&flown));
    (input.setpoint.position_m.z, input.setpoint.velocity_m_s.z) = (-0.9, -6.0);
    let speeds = (0..8).map(|_| {
        let before = z(&flown).gain_ratios[1];
        flown.tick(&input);
        (z(&flown).gain_ratios[1] - before) / flown.lesson_s()
    });
    let speed = speeds.fold(0.0, f64::max);
    let stated = symbols.speed_max(1, 0.0);
    assert!(speed > 0.5 * stated && speed <= stated, "{speed} {stated}");
}

#[test]
fn the_monitor_is_quiet_where_the_law_holds_and_speaks_where_it_cannot() {
    let mut scenario = shipped("flight");
    let shares = |scenario: &_, controller| {
        let flights = fly(scenario, controller, 1, 3);
        ["lyapunov_rising_share", "gain_at_bound_share", "refused_share"].map(|name| metric(&flights, name).0)
    };
    assert_eq!(shares(&scenario, ControllerName::Lgs), [0.0; 3]);
    let [rising, at_bound, refused] = shares(&scenario, ControllerName::Pid);
    assert!((0.02..0.03).contains(&rising), "{rising}");
    assert_eq!((at_bound, refused), (0.0, 0.0));
    // More than the rotors have left: the machine sinks for a second, and comes back.
    scenario.fault[0].kind = FaultKind::LossOfEffectiveness { loss: 0.6 };
    scenario.fault[0].until_s = scenario.fault[0].from_s + 1.0;
    let [rising, _, refused] = shares(&scenario, ControllerName::Lgs);
    assert!(rising > 0.1 && refused > 0.3, "{rising} {refused}");
}

/// Roll torque that the thrusts make, N m, about a machine rolled by `roll_rad` for `ticks`, otherwise at rest.
fn rolled(controller: &Controller<f64>, state: &mut control_core::State<f64>, roll_rad: f64, ticks: usize) -> f64 {
    let (sin, cos) = roll_rad.sin_cos();
    let gravity = f64::from(control_core::GRAVITY_M_S2);
    let mut input = Input::<f64>::hovering();
    input.attitude = Attitude { rows: [[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]] };
    input.specific_force_m_s2 = Vec3::new(0.0, -sin * gravity, -cos * gravity);
    let thrust_n = (0..ticks).fold([0.0; 4], |_, _| controller.tick(state, &input).thrust_n);
    f64::from(Airframe::paper(2.2).rotors[0].right_m) * (thrust_n[2] - thrust_n[0])
}

proptest! {
    #[test]
    fn the_attitude_integral_adds_at_most_a_tenth_of_a_radian_second(
        held in prop::collection::vec((-0.05_f64..0.05, 1_usize..4000), 1..12),
    ) {
        let config = flight();
        let controller = Controller::<f64>::try_new(&config).expect("a valid configuration");
        let mut state = controller.hover_state();
        let (kp, ki) = (f64::from(config.gains.phi.kp), f64::from(config.gains.phi.ki));
        for (roll_rad, ticks) in held {
            let integral = (rolled(&controller, &mut state, roll_rad, ticks) + kp * roll_rad) / ki;
            prop_assert!(integral.abs() <= 0.1 + 1e-3, "{integral}");
        }
        let integral = (rolled(&controller, &mut state, 0.05, 4000) + kp * 0.05) / ki;
        prop_assert!(integral < -0.1 + 1e-3, "and it gets there: {integral}");
    }
}
