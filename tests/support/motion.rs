//! Synthetic motion and the sensors that ride on it, in f64 and closed form: what the estimator is held against.
//!
//! Position and angles are sums of sines in a time that starts slowly after two seconds of rest; velocity, acceleration and body rates are
//! their derivatives. Nothing here integrates, and nothing is shared with the estimator.
use control_core::estimation::EstimatorConfig;
use control_core::frames::{Attitude, Body, Ned, Vec3};
use control_core::measurement::{Flow, Gnss, Imu, Measurements, Stamped, Vision};

/// Gravity, as the core has it.
const GRAVITY_M_S2: f64 = 9.81;
/// How long every motion starts with rest, s.
pub const REST_S: f64 = 2.0;

/// A generator of noise: 64-bit linear congruence, permuted (PCG), and Box and Muller's normal.
#[derive(Clone, Debug)]
pub struct Noise(u64);

impl Noise {
    /// A stream for a seed.
    pub fn new(seed: u64) -> Self {
        let mut noise = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x2545_f491_4f6c_dd1d);
        noise.bits();
        noise
    }

    /// 32 random bits.
    pub fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (((self.0 >> 18) ^ self.0) >> 27) as u32
    }

    /// Even in 0..1.
    pub fn even(&mut self) -> f64 {
        (f64::from(self.bits()) + 0.5) / 4_294_967_296.0
    }

    /// Normal, of unit variance.
    pub fn normal(&mut self) -> f64 {
        (-2.0 * self.even().ln()).sqrt() * (std::f64::consts::TAU * self.even()).cos()
    }

    /// Three independent ones, scaled.
    pub fn normals(&mut self, sigma: f64) -> [f64; 3] {
        [sigma * self.normal(), sigma * self.normal(), sigma * self.normal()]
    }
}

/// A sum of two sines, and its first two derivatives.
#[derive(Clone, Copy, Debug, Default)]
struct Wave([(f64, f64); 2]);

impl Wave {
    fn random(noise: &mut Noise, amplitude: f64, omega: f64) -> Self {
        let mut one = || (amplitude * (noise.even() - 0.5), omega * (0.3 + noise.even()));
        Self([one(), one()])
    }

    fn at(&self, t: f64) -> [f64; 3] {
        self.0.iter().fold([0.0; 3], |[x, v, a], &(amplitude, w)| {
            let (sin, cos) = (w * t).sin_cos();
            [x + amplitude * sin, v + amplitude * w * cos, a - amplitude * w * w * sin]
        })
    }
}

/// A motion in closed form.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    position_m: [Wave; 3],
    tilt_rad: [Wave; 2],
    yaw_rad: Wave,
    heading_rad: f64,
    /// Turned besides, once it has begun, rad/s.
    pub spin_rad_s: f64,
}

/// A motion at one time.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// NED, m.
    pub position_m: [f64; 3],
    /// NED, m/s.
    pub velocity_m_s: [f64; 3],
    /// NED, m/s².
    pub acceleration_m_s2: [f64; 3],
    /// Body to NED, row-major.
    pub rows: [[f64; 3]; 3],
    /// Body, rad/s.
    pub rate_rad_s: [f64; 3],
}

impl Motion {
    /// Rest for ever.
    pub fn rest(heading_rad: f64) -> Self {
        Self {
            position_m: [Wave::default(); 3],
            tilt_rad: [Wave::default(); 2],
            yaw_rad: Wave::default(),
            heading_rad,
            spin_rad_s: 0.0,
        }
    }

    /// A flight within some 10 m, at up to some 5 m/s and 30 degrees.
    pub fn flight(noise: &mut Noise) -> Self {
        Self {
            position_m: [Wave::random(noise, 12.0, 0.7), Wave::random(noise, 12.0, 0.7), Wave::random(noise, 4.0, 0.7)],
            tilt_rad: [Wave::random(noise, 0.7, 2.0), Wave::random(noise, 0.7, 2.0)],
            yaw_rad: Wave::random(noise, 3.0, 0.5),
            heading_rad: 6.0 * noise.even() - 3.0,
            spin_rad_s: 0.0,
        }
    }

    /// Where it is at `t_s`.
    pub fn at(&self, t_s: f64) -> Truth {
        let x = (t_s - REST_S).max(0.0);
        let fading = (-x).exp();
        let (tau, speed, haste) = if t_s < REST_S { (0.0, 0.0, 0.0) } else { (x - 1.0 + fading, 1.0 - fading, fading) };
        let [north, east, down] = self.position_m.map(|wave| {
            let [p, v, a] = wave.at(tau);
            [p, v * speed, a * speed * speed + v * haste]
        });
        let [[roll, roll_s, _], [pitch, pitch_s, _]] = self.tilt_rad.map(|wave| wave.at(tau));
        let [yaw, yaw_s, _] = self.yaw_rad.at(tau);
        let yaw = yaw + self.heading_rad + self.spin_rad_s * tau;
        let [roll_s, pitch_s, yaw_s] = [roll_s * speed, pitch_s * speed, (yaw_s + self.spin_rad_s) * speed];
        let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
        Truth {
            // Down only: it never flies into the ground that it starts from.
            position_m: [north[0], east[0], down[0]],
            velocity_m_s: [north[1], east[1], down[1]],
            acceleration_m_s2: [north[2], east[2], down[2]],
            rows: [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ],
            rate_rad_s: [roll_s - yaw_s * sp, pitch_s * cr + yaw_s * cp * sr, -pitch_s * sr + yaw_s * cp * cr],
        }
    }
}

/// `Rᵀ v`.
pub fn to_body(rows: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|j| (0..3).map(|i| rows[i][j] * v[i]).sum())
}

impl Truth {
    /// What an accelerometer feels, body, m/s².
    pub fn specific_force_m_s2(&self) -> [f64; 3] {
        let [x, y, z] = self.acceleration_m_s2;
        to_body(&self.rows, [x, y, z - GRAVITY_M_S2])
    }
}

fn vec3<F: Copy>([x, y, z]: [f64; 3]) -> Vec3<F> {
    Vec3::new(x as f32, y as f32, z as f32)
}

/// Sums and differences of triples.
pub fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}

/// See [`add`].
pub fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Which sensors ride along.
#[derive(Clone, Copy, Debug, Default)]
#[expect(clippy::struct_excessive_bools, reason = "any subset is meant")]
pub struct Aboard {
    /// 10 Hz, 150 ms late.
    pub gnss: bool,
    /// 50 Hz, 20 ms late.
    pub baro: bool,
    /// 100 Hz, 10 ms late.
    pub mag: bool,
    /// 50 Hz range and 100 Hz flow, 20 ms late.
    pub flow: bool,
    /// 100 Hz, 20 ms late.
    pub vision: bool,
}

/// The ground below where the motion starts, m: flow needs some height.
pub const GROUND_M: f64 = 6.0;

/// A motion with sensors, sampled in step.
#[derive(Clone, Debug)]
pub struct World {
    /// What is flown.
    pub motion: Motion,
    /// What rides along.
    pub aboard: Aboard,
    config: EstimatorConfig,
    noise: Noise,
    sample_us: u64,
    /// The present, µs.
    pub now_us: u64,
    /// True biases: gyro, rad/s, accelerometer, m/s², and the barometer's offset, m.
    pub gyro_bias_rad_s: [f64; 3],
    /// See above.
    pub accelerometer_bias_m_s2: [f64; 3],
    /// See above.
    pub barometer_offset_m: f64,
    /// Where the ground is, m down.
    pub ground_m: f64,
    /// Satellite noise, m and m/s.
    pub gnss_m: f64,
    /// See above.
    pub gnss_m_s: f64,
    /// Stamps measurements with the time of their arrival, as a driver does that does not know its delay.
    pub stamped_late: bool,
}

impl World {
    /// Sensors as noisy as `config` says, their biases drawn at random.
    pub fn new(motion: Motion, aboard: Aboard, config: &EstimatorConfig, seed: u64) -> Self {
        let mut noise = Noise::new(seed);
        let gyro_bias_rad_s = noise.normals(0.01);
        let accelerometer_bias_m_s2 = noise.normals(f64::from(config.inertial.accelerometer_bias_m_s2));
        let barometer_offset_m = f64::from(config.aiding.barometer_m) * noise.normal();
        Self {
            motion,
            aboard,
            config: *config,
            noise,
            sample_us: (1e6 / config.gyro.sample_hz) as u64,
            now_us: 1_000_000,
            gyro_bias_rad_s,
            accelerometer_bias_m_s2,
            barometer_offset_m,
            ground_m: GROUND_M,
            gnss_m: f64::from(config.aiding.gnss_horizontal_m),
            gnss_m_s: f64::from(config.aiding.gnss_m_s),
            stamped_late: false,
        }
    }

    /// The truth now.
    pub fn truth(&self) -> Truth {
        self.truth_at(self.now_us)
    }

    fn truth_at(&self, time_us: u64) -> Truth {
        self.motion.at((time_us as f64 - 1e6) * 1e-6)
    }

    /// Moves on by one inertial sample; what arrives.
    pub fn step(&mut self) -> Measurements {
        let dt_s = self.sample_us as f64 * 1e-6;
        let start_us = self.now_us;
        self.now_us += self.sample_us;
        let inertial = self.config.inertial;
        let walk = |bias: &mut [f64; 3], noise: &mut Noise, density: f32| {
            *bias = add(*bias, noise.normals(f64::from(density) * dt_s.sqrt()));
        };
        walk(&mut self.gyro_bias_rad_s, &mut self.noise, inertial.gyro_walk_rad_s_rt_s);
        walk(&mut self.accelerometer_bias_m_s2, &mut self.noise, inertial.accelerometer_walk_m_s2_rt_s);
        self.barometer_offset_m +=
            f64::from(self.config.aiding.barometer_walk_m_rt_s) * dt_s.sqrt() * self.noise.normal();
        self.ground_m += f64::from(self.config.aiding.ground_walk_m_rt_s) * dt_s.sqrt() * self.noise.normal();
        // Means over the sample, by Simpson's rule on eight intervals.
        let (mut rate, mut force) = ([0.0; 3], [0.0; 3]);
        for (i, weight) in [1.0, 4.0, 2.0, 4.0, 2.0, 4.0, 2.0, 4.0, 1.0].into_iter().enumerate() {
            let t_s = (start_us as f64 - 1e6) * 1e-6 + dt_s * i as f64 / 8.0;
            let truth = self.motion.at(t_s);
            let share = weight / 24.0;
            rate = add(rate, truth.rate_rad_s.map(|x| x * share));
            force = add(force, truth.specific_force_m_s2().map(|x| x * share));
        }
        let root = dt_s.sqrt();
        let gyro_noise = self.noise.normals(f64::from(inertial.gyro_rad_s_rt_hz) / root);
        let force_noise = self.noise.normals(f64::from(inertial.accelerometer_m_s2_rt_hz) / root);
        let imu = Imu {
            rate_rad_s: vec3(add(add(rate, self.gyro_bias_rad_s), gyro_noise)),
            specific_force_m_s2: vec3(add(add(force, self.accelerometer_bias_m_s2), force_noise)),
        };
        let mut m = Measurements { imu: Some(Stamped { time_us: self.now_us, value: imu }), ..Measurements::default() };
        self.add_slow(&mut m);
        m
    }

    /// The time at which a sample of `every_us` was true that arrives now after `delay_us`, if one does.
    fn due(&self, every_us: u64, delay_us: u64) -> Option<u64> {
        let phase = (self.now_us - delay_us) % every_us;
        (phase < self.sample_us).then_some(self.now_us - delay_us)
    }

    fn stamped<T>(&self, time_us: u64, value: T) -> Stamped<T> {
        Stamped { time_us: if self.stamped_late { self.now_us } else { time_us }, value }
    }

    fn add_slow(&mut self, m: &mut Measurements) {
        let aiding = self.config.aiding;
        if let (true, Some(time_us)) = (self.aboard.gnss, self.due(100_000, 150_000)) {
            let truth = self.truth_at(time_us);
            let vertical_m = self.gnss_m * f64::from(aiding.gnss_vertical_m / aiding.gnss_horizontal_m);
            let [x, y, z] = self.noise.normals(1.0);
            let off = [x * self.gnss_m, y * self.gnss_m, z * vertical_m];
            let value = Gnss {
                position_m: vec3(add(truth.position_m, off)),
                velocity_m_s: vec3(add(truth.velocity_m_s, self.noise.normals(self.gnss_m_s))),
                horizontal_m: self.gnss_m as f32,
                vertical_m: vertical_m as f32,
                speed_m_s: self.gnss_m_s as f32,
                fixed: true,
            };
            m.gnss = Some(self.stamped(time_us, value));
        }
        if let (true, Some(time_us)) = (self.aboard.baro, self.due(20_000, 20_000)) {
            let truth = self.truth_at(time_us);
            let off = self.barometer_offset_m + f64::from(aiding.barometer_m) * self.noise.normal();
            m.baro_altitude_m = Some(self.stamped(time_us, (off - truth.position_m[2]) as f32));
        }
        if let (true, Some(time_us)) = (self.aboard.mag, self.due(10_000, 10_000)) {
            let truth = self.truth_at(time_us);
            let Vec3 { x, y, z, .. } = self.config.earth_field_ut;
            let field = to_body(&truth.rows, [x, y, z].map(f64::from));
            let off = self.noise.normals(f64::from(aiding.magnetic_ut));
            m.magnetic_ut = Some(self.stamped(time_us, vec3::<Body>(add(field, off))));
        }
        if let (true, Some(time_us)) = (self.aboard.flow, self.due(20_000, 20_000)) {
            let truth = self.truth_at(time_us);
            let range_m = (self.ground_m - truth.position_m[2]) / truth.rows[2][2];
            let sigma_m = f64::from(aiding.range_m) + 0.02 * range_m;
            let off_m = sigma_m * self.noise.normal();
            m.range_m = Some(self.stamped(time_us, (range_m + off_m) as f32));
        }
        if let (true, Some(time_us)) = (self.aboard.flow, self.due(10_000, 20_000)) {
            let truth = self.truth_at(time_us);
            let distance_m = (self.ground_m - truth.position_m[2]) / truth.rows[2][2];
            let [x, y, _] = to_body(&truth.rows, truth.velocity_m_s);
            let [p, q, _] = truth.rate_rad_s;
            let mut off = || f64::from(aiding.flow_rad_s) * self.noise.normal();
            let rate = [p - y / distance_m + off(), q + x / distance_m + off()];
            m.flow = Some(self.stamped(time_us, Flow { rate_rad_s: rate.map(|x| x as f32), quality: 1.0 }));
        }
        if let (true, Some(time_us)) = (self.aboard.vision, self.due(10_000, 20_000)) {
            let truth = self.truth_at(time_us);
            let (sigma_m, sigma_rad) = (f64::from(aiding.vision_m), f64::from(aiding.vision_rad));
            let value = Vision {
                position_m: vec3::<Ned>(add(truth.position_m, self.noise.normals(sigma_m))),
                attitude: Attitude { rows: turned(self.noise.normals(sigma_rad), &truth.rows) },
                position_sigma_m: sigma_m as f32,
                attitude_sigma_rad: sigma_rad as f32,
            };
            m.vision = Some(self.stamped(time_us, value));
        }
    }
}

/// `exp(θ) R` for a small θ, made a rotation by its second-order term.
pub fn turned(theta: [f64; 3], rows: &[[f64; 3]; 3]) -> [[f32; 3]; 3] {
    let [x, y, z] = theta;
    let cross = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
    let second = |i: usize, j: usize| (0..3).map(|k| cross[i][k] * cross[k][j]).sum::<f64>() / 2.0;
    let exp: [[f64; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)) + cross[i][j] + second(i, j)));
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| exp[i][k] * rows[k][j]).sum::<f64>() as f32))
}
