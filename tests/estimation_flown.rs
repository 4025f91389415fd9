//! The estimator in simulated flights: the sensors that boards carry, wind, and rotors that fail.
use control_core::estimation::{Estimator, EstimatorConfig};
use control_core::frames::Vec3;
use control_core::measurement::Measurements;
use sim_host::controllers::ControllerName;
use sim_host::flight::{Flight, NumberFormat};
use sim_host::scenario::Scenario;
use system_tests::shipped;

/// What is left of what arrived.
type Pick = fn(&Measurements) -> Measurements;

const SETS: [(&str, Pick); 3] = [
    ("vision", |m| Measurements {
        imu: m.imu,
        vision: m.vision,
        rotor_rad_s: m.rotor_rad_s,
        ..Measurements::default()
    }),
    ("gnss + baro + mag", |m| Measurements {
        imu: m.imu,
        gnss: m.gnss,
        baro_altitude_m: m.baro_altitude_m,
        magnetic_ut: m.magnetic_ut,
        rotor_rad_s: m.rotor_rad_s,
        ..Measurements::default()
    }),
    ("range and flow + mag", |m| Measurements {
        imu: m.imu,
        range_m: m.range_m,
        flow: m.flow,
        magnetic_ut: m.magnetic_ut,
        rotor_rad_s: m.rotor_rad_s,
        ..Measurements::default()
    }),
];

#[test]
fn dbg() {
    let mut scenario = shipped("sensors");
    let estimator = Estimator::try_new(&EstimatorConfig::FLIGHT).expect("flies");
    for name in ["sensors", "single_rotor_40"] {
        if name != "sensors" {
            let s = shipped(name);
            scenario.fault = s.fault;
            scenario.airframe = s.airframe;
            scenario.vehicle = s.vehicle;
        }
        for (name, pick) in SETS {
            let mut state = estimator.state();
            let flight =
                Flight { scenario: &scenario, controller: ControllerName::Default, seed: 1, format: NumberFormat::F32 };
            let (mut tilt, mut head, mut pos, mut vel, mut n) = (0.0, 0.0, 0.0, 0.0, 0.0);
            let ending = flight.fly(&mut |sample| {
            let m = pick(sample.measurements);
            let now_us = (sample.t_s * 1e6).round() as u64;
            if sample.tick == 0 { state = estimator.resume(&known(sample.truth)); }
            let e = *estimator.step(&mut state, &m, now_us);
            let rows = e.attitude.rows.map(|r| r.map(f64::from));
            let a = &sample.truth.attitude;
            let turn = |i: usize, j: usize| (0..3).map(|k| a[(i, k)] * rows[j][k]).sum::<f64>();
            let theta = [turn(2, 1) - turn(1, 2), turn(0, 2) - turn(2, 0), turn(1, 0) - turn(0, 1)].map(|x| 0.5 * x);
            let p = sample.truth.position_m; let v = sample.truth.velocity_m_s;
            let dp = [p.x - f64::from(e.position_m.x), p.y - f64::from(e.position_m.y), p.z - f64::from(e.position_m.z)];
            let dv = [v.x - f64::from(e.velocity_m_s.x), v.y - f64::from(e.velocity_m_s.y), v.z - f64::from(e.velocity_m_s.z)];
            if sample.t_s > 10.0 {
                tilt += theta[0] * theta[0] + theta[1] * theta[1]; head += theta[2] * theta[2]; pos += dp[0]*dp[0]+dp[1]*dp[1]+dp[2]*dp[2]; vel += dv[0]*dv[0]+dv[1]*dv[1]+dv[2]*dv[2]; n += 1.0;
            }
            if sample.tick % 2500 == 2499 {
                println!("{:.0} theta {:.4?} dp {:.3?} dv {:.3?} s {:.4?} bg {:.4?} {:.4?} {:.4?} ba {:.3} {:.3} {:.3}", sample.t_s, theta, dp, dv, e.sigma, e.gyro_bias_rad_s.x,e.gyro_bias_rad_s.y,e.gyro_bias_rad_s.z, e.accelerometer_bias_m_s2.x, e.accelerometer_bias_m_s2.y, e.accelerometer_bias_m_s2.z);
            }
        }).expect("valid");
            let r = |x: f64| (x / n).sqrt();
            println!(
                "== {name}: tilt {:.2} deg heading {:.2} deg pos {:.3} m vel {:.3} m/s; {ending:?}",
                r(tilt).to_degrees(),
                r(head).to_degrees(),
                r(pos),
                r(vel)
            );
            let t = estimator.telemetry(&state, 80_000_000);
            println!("{t:?}");
        }
    }
    let _: Option<Vec3<control_core::frames::Body>> = None;
    let _: Option<Scenario> = None;
}

fn known(truth: &sim_host::plant::Truth) -> control_core::estimate::Estimate {
    use control_core::estimate::*;
    let (p, v, a) = (truth.position_m, truth.velocity_m_s, truth.attitude);
    Estimate {
        time_us: 1,
        position_m: Vec3::new(p.x as f32, p.y as f32, p.z as f32),
        velocity_m_s: Vec3::new(v.x as f32, v.y as f32, v.z as f32),
        attitude: control_core::frames::Attitude {
            rows: std::array::from_fn(|i| std::array::from_fn(|j| a[(i, j)] as f32)),
        },
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
