//! The estimator in simulated flights: the sensors that boards carry, wind, and rotors that fail. It listens; the controller flies on truth.
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::estimation::{EstimatorConfig, STATES};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::{Gnss, Imu, Measurements, Stamped, Vision};
use rayon::prelude::*;
use sim_host::controllers::ControllerName;
use sim_host::flight::{Flight, NumberFormat};
use sim_host::plant::Truth;
use sim_host::scenario::Scenario;
use system_tests::estimation::flight;
use system_tests::motion::{Noise, add, to_body, turned};
use system_tests::shipped;

/// What is left of what arrived.
type Pick = fn(&Measurements) -> Measurements;

fn outdoors(m: &Measurements) -> Measurements {
    let Measurements { imu, gnss, baro_altitude_m, magnetic_ut, rotor_rad_s, .. } = *m;
    Measurements { imu, gnss, baro_altitude_m, magnetic_ut, rotor_rad_s, ..Measurements::default() }
}

fn with_vision(m: &Measurements) -> Measurements {
    Measurements { imu: m.imu, vision: m.vision, rotor_rad_s: m.rotor_rad_s, ..Measurements::default() }
}

fn indoors(m: &Measurements) -> Measurements {
    let Measurements { imu, range_m, flow, magnetic_ut, rotor_rad_s, .. } = *m;
    Measurements { imu, range_m, flow, magnetic_ut, rotor_rad_s, ..Measurements::default() }
}

/// What a machine that has just left the ground knows.
fn at_start(truth: &Truth) -> Estimate {
    let (p, v, a) = (truth.position_m, truth.velocity_m_s, truth.attitude);
    Estimate {
        time_us: 1,
        position_m: Vec3::new(p.x as f32, p.y as f32, p.z as f32),
        velocity_m_s: Vec3::new(v.x as f32, v.y as f32, v.z as f32),
        attitude: Attitude { rows: std::array::from_fn(|i| std::array::from_fn(|j| a[(i, j)] as f32)) },
        rate_rad_s: Vec3::zero(),
        specific_force_m_s2: Vec3::zero(),
        gyro_bias_rad_s: Vec3::zero(),
        accelerometer_bias_m_s2: Vec3::zero(),
        sigma: Sigma {
            tilt_rad: 0.01,
            heading_rad: 0.03,
            horizontal_m_s: 0.05,
            vertical_m_s: 0.05,
            horizontal_m: 0.1,
            altitude_m: 0.1,
        },
        health: Health::default(),
    }
}

/// Errors of an estimate: tilt and heading, rad, position, m, and velocity, m/s.
fn errors(estimate: &Estimate, truth: &Truth) -> [f64; 4] {
    let rows = estimate.attitude.rows.map(|row| row.map(f64::from));
    let turn = |i: usize, j: usize| (0..3).map(|k| truth.attitude[(i, k)] * rows[j][k]).sum::<f64>();
    let [x, y, z] = [turn(2, 1) - turn(1, 2), turn(0, 2) - turn(2, 0), turn(1, 0) - turn(0, 1)].map(|x| 0.5 * x);
    let (p, v) = (estimate.position_m, estimate.velocity_m_s);
    let far = |a: nalgebra::Vector3<f64>, [x, y, z]: [f32; 3]| {
        (a - nalgebra::Vector3::new(f64::from(x), f64::from(y), f64::from(z))).norm()
    };
    [x.hypot(y), z, far(truth.position_m, [p.x, p.y, p.z]), far(truth.velocity_m_s, [v.x, v.y, v.z])]
}

/// Flies and listens to what `hear` makes of what arrives; `see` gets every estimate with its time, the truth and its covariance.
fn listen(
    scenario: &Scenario,
    seed: u64,
    mut hear: impl FnMut(&Truth, &Measurements) -> Measurements,
    mut see: impl FnMut(f64, &Truth, &Estimate, &[[f32; STATES]; STATES]),
) {
    let estimator = flight();
    let mut state = estimator.state();
    let flight = Flight { scenario, controller: ControllerName::Default, seed, format: NumberFormat::F32 };
    let ending = flight.fly(&mut |sample| {
        if sample.tick == 0 {
            state = estimator.resume(&at_start(sample.truth));
        }
        let now_us = (sample.t_s * 1e6).round() as u64;
        let measurements = hear(sample.truth, sample.measurements);
        let estimate = *estimator.step(&mut state, &measurements, now_us);
        see(sample.t_s, sample.truth, &estimate, state.covariance());
    });
    assert_eq!(ending.expect("shipped gains are valid"), None);
}

#[test]
fn the_sensors_of_a_board_tell_the_motion_with_any_set_of_them() {
    let scenario = shipped("sensors");
    // Tilt and heading, degrees, position, m, velocity, m/s: rms of the worst of four boards, after ten seconds.
    let rows: [(&str, Pick, [f64; 4]); 3] = [
        ("vision", with_vision, [0.6, 0.6, 0.02, 0.05]),
        ("gnss + baro + mag", outdoors, [0.5, 3.0, 2.5, 0.15]),
        ("range and flow + mag", indoors, [0.8, 4.0, 0.5, 0.15]),
    ];
    for (name, pick, bounds) in rows {
        let boards: Vec<[f64; 4]> = (1..=4_u64)
            .into_par_iter()
            .map(|seed| {
                let (mut sums, mut count) = ([0.0; 4], 0.0);
                listen(
                    &scenario,
                    seed,
                    |_, arrived| pick(arrived),
                    |t_s, truth, estimate, _| {
                        if t_s > 10.0 {
                            for (sum, error) in sums.iter_mut().zip(errors(estimate, truth)) {
                                *sum += error * error;
                            }
                            count += 1.0;
                        }
                    },
                );
                sums.map(|sum: f64| (sum / count).sqrt())
            })
            .collect();
        let [tilt, heading, position_m, velocity_m_s] =
            std::array::from_fn(|i| boards.iter().map(|board| board[i]).fold(0.0, f64::max));
        let worst = [tilt.to_degrees(), heading.to_degrees(), position_m, velocity_m_s];
        println!(
            "{name}: tilt {:.2} deg, heading {:.2} deg, {position_m:.3} m, {velocity_m_s:.3} m/s",
            worst[0], worst[1]
        );
        assert!(worst.iter().zip(bounds).all(|(found, bound)| *found < bound), "{name}: {worst:?} {bounds:?}");
    }
}

/// Biases of the inertial unit below, rad/s and m/s².
const BIASES: [[f64; 3]; 2] = [[1e-3, -1.5e-3, 0.5e-3], [0.08, -0.1, 0.12]];

/// Sensors with noise of the filter's own figures and known biases, and no other error.
struct Plain {
    noise: Noise,
    last: Option<[[f64; 3]; 2]>,
    tick: u64,
    vision: bool,
}

impl Plain {
    fn sample(&mut self, truth: &Truth) -> Measurements {
        let time_us = self.tick * 2000;
        self.tick += 1;
        let EstimatorConfig { inertial, aiding, earth_field_ut, .. } = EstimatorConfig::FLIGHT;
        let (w, f, p, v) = (truth.rate_rad_s, truth.specific_force_m_s2, truth.position_m, truth.velocity_m_s);
        let now = [[w.x, w.y, w.z], [f.x, f.y, f.z]];
        let before = self.last.replace(now).unwrap_or(now);
        let root = 500.0_f64.sqrt();
        let sigma = [inertial.gyro_rad_s_rt_hz, inertial.accelerometer_m_s2_rt_hz].map(|x| f64::from(x) * root);
        let [rate, force] = std::array::from_fn(|i| {
            let mean = add(before[i], now[i]).map(|x| 0.5 * x);
            add(add(mean, BIASES[i]), self.noise.normals(sigma[i]))
        });
        let imu = Imu { rate_rad_s: vec3(rate), specific_force_m_s2: vec3(force) };
        let mut m = Measurements { imu: Some(Stamped { time_us, value: imu }), ..Measurements::default() };
        let rows: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| truth.attitude[(i, j)]));
        if self.vision && self.tick.is_multiple_of(5) {
            let (sigma_m, sigma_rad) = (f64::from(aiding.vision_m), f64::from(aiding.vision_rad));
            let value = Vision {
                position_m: vec3(add([p.x, p.y, p.z], self.noise.normals(sigma_m))),
                attitude: Attitude { rows: turned(self.noise.normals(sigma_rad), &rows) },
                position_sigma_m: aiding.vision_m,
                attitude_sigma_rad: aiding.vision_rad,
            };
            m.vision = Some(Stamped { time_us, value });
        }
        if !self.vision && self.tick.is_multiple_of(50) {
            let value = Gnss {
                position_m: vec3(add([p.x, p.y, p.z], self.noise.normals(f64::from(aiding.gnss_vertical_m)))),
                velocity_m_s: vec3(add([v.x, v.y, v.z], self.noise.normals(f64::from(aiding.gnss_m_s)))),
                horizontal_m: aiding.gnss_vertical_m,
                vertical_m: aiding.gnss_vertical_m,
                speed_m_s: aiding.gnss_m_s,
                fixed: true,
            };
            m.gnss = Some(Stamped { time_us, value });
        }
        if !self.vision && self.tick.is_multiple_of(10) {
            let field = to_body(&rows, [earth_field_ut.x, earth_field_ut.y, earth_field_ut.z].map(f64::from));
            let value = vec3(add(field, self.noise.normals(f64::from(aiding.magnetic_ut))));
            m.magnetic_ut = Some(Stamped { time_us, value });
        }
        m
    }
}

fn vec3<F: Copy>([x, y, z]: [f64; 3]) -> Vec3<F> {
    Vec3::new(x as f32, y as f32, z as f32)
}

#[test]
fn wind_and_a_weak_or_lost_rotor_are_not_taken_for_bias() {
    for (name, vision) in [
        ("single_rotor_40", true),
        ("single_rotor_40", false),
        ("single_rotor_100_low_thrust", true),
        ("single_rotor_100_low_thrust", false),
    ] {
        let mut scenario = shipped(name);
        let windy = shipped("sensors");
        (scenario.wind, scenario.vehicle.linear_drag_n_s_m) = (windy.wind, windy.vehicle.linear_drag_n_s_m);
        let mut plain = Plain { noise: Noise::new(7), last: None, tick: 0, vision };
        let (mut worst, mut apart, mut fastest) = ([0.0_f64; 2], [0.0_f64; 2], 0.0_f64);
        listen(
            &scenario,
            3,
            |truth, _| plain.sample(truth),
            |t_s, truth, estimate, p| {
                fastest = fastest.max(truth.rate_rad_s.z.abs());
                if t_s < 20.0 {
                    return;
                }
                let (b, a) = (estimate.gyro_bias_rad_s, estimate.accelerometer_bias_m_s2);
                for (kind, found) in [[b.x, b.y, b.z], [a.x, a.y, a.z]].into_iter().enumerate() {
                    for (axis, found) in found.into_iter().enumerate() {
                        let state = 9 + 3 * kind + axis;
                        let off = (f64::from(found) - BIASES[kind][axis]).abs();
                        apart[kind] = apart[kind].max(off);
                        worst[kind] = worst[kind].max(off / f64::from(p[state][state]).sqrt());
                    }
                }
            },
        );
        println!(
            "{name}, {}: gyro bias within {:.2} sigma, {:.1e} rad/s; accelerometer bias within {:.2} sigma, {:.3} m/s^2; yaw to {fastest:.0} rad/s",
            if vision { "vision" } else { "gnss + mag" },
            worst[0],
            apart[0],
            worst[1],
            apart[1]
        );
        assert!(worst[0] < 3.0 && worst[1] < 3.0, "{name}, {vision}: {worst:?} sigma");
    }
}
