//! The filter: nominal state, its covariance and its past, moved together.
//!
//! Invariant: whatever moves the nominal state moves the history by the same, so that the past stays comparable.
use super::config::EstimatorConfig;
use super::covariance::{
    ACCELEROMETER_BIAS, ATTITUDE, BARO_OFFSET, Covariance, GROUND, GYRO_BIAS, Observation, POSITION, STATES, VELOCITY,
};
use super::history::{History, Past};
use super::observe::components;
use super::quaternion::Quaternion;
use super::strapdown::Nominal;
use crate::frames::{Attitude, Body, Ned, Vec3};
use crate::measurement::Imu;

/// Largest biases that are followed: of the gyro what no part has that is not broken, of the accelerometer what one is flown with that is.
const GYRO_BIAS_RAD_S_MAX: f32 = 0.2;
const ACCELEROMETER_BIAS_M_S2_MAX: f32 = 10.0;
/// What no accelerometer is off by that is not broken, m/s².
const BROKEN_M_S2: f32 = 1.5;
/// How well the difference of two inertial units is known, rad/s and m/s².
const TRADE_RAD_S: f32 = 0.002;
const TRADE_M_S2: f32 = 0.05;
/// How far biases may be off where the velocity was, rad/s and m/s².
const DOUBT_RAD_S: f32 = 0.01;
const DOUBT_M_S2: f32 = 0.2;
/// Standard deviation of a state that nothing is known of: velocity, m/s, and position, m.
pub(crate) const UNKNOWN_M_S: f32 = 3.0;
pub(crate) const UNKNOWN_M: f32 = 100.0;

/// The state of position down.
const DOWN: usize = POSITION + 2;

/// Everything the filter believes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Filter {
    pub(crate) nominal: Nominal,
    pub(crate) covariance: Covariance,
    pub(crate) history: History,
    pub(crate) barometer_offset_m: f32,
    /// Where range and flow see the ground, m down; `None` until they have.
    pub(crate) ground_m: Option<f32>,
    /// Of the nominal rotation.
    pub(crate) attitude: Attitude,
    /// The same at the last step of the covariance.
    attitude_before: Attitude,
    /// ∫ R f since then, m/s.
    pushed_m_s: Vec3<Ned>,
    /// Mean of R f over the last step of the covariance, m/s².
    pub(crate) force_m_s2: Vec3<Ned>,
    /// Time since the last step of the covariance, s.
    pub(crate) span_s: f32,
    /// Whether the covariance was found not to be positive.
    broken: bool,
}

/// How sure a filter is when it starts, 1 σ.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    pub(crate) tilt_rad: f32,
    pub(crate) heading_rad: f32,
    pub(crate) velocity_m_s: f32,
    pub(crate) position_m: f32,
    pub(crate) gyro_bias_rad_s: f32,
    /// Whether the tilt was read off the accelerometer, whose bias then is in it.
    pub(crate) levelled_by_accelerometer: bool,
}

impl Filter {
    /// A filter that starts from `nominal`.
    pub(crate) fn new(config: &EstimatorConfig, nominal: Nominal, start: &Start) -> Self {
        let Start { tilt_rad, heading_rad, velocity_m_s, position_m, gyro_bias_rad_s, levelled_by_accelerometer } =
            *start;
        let accelerometer = config.inertial.accelerometer_bias_m_s2;
        let mut sigma = [0.0; STATES];
        for (first, value) in [
            (ATTITUDE, tilt_rad),
            (VELOCITY, velocity_m_s),
            (POSITION, position_m),
            (GYRO_BIAS, gyro_bias_rad_s),
            (ACCELEROMETER_BIAS, accelerometer),
        ] {
            sigma[first..first + 3].fill(value);
        }
        sigma[ATTITUDE + 2] = heading_rad;
        sigma[BARO_OFFSET] = config.aiding.barometer_m;
        sigma[GROUND] = config.aiding.range_m;
        let attitude = nominal.rotation.attitude();
        let mut covariance = Covariance::diagonal(sigma);
        if levelled_by_accelerometer {
            // What looks like gravity is gravity less the bias: (θ_x, θ_y) = (R b)_y / g, −(R b)_x / g.
            let g = crate::GRAVITY_M_S2;
            let [north, east, _] = attitude.rows;
            covariance.shear::<ATTITUDE, ACCELEROMETER_BIAS>(&[east.map(|x| x / g), north.map(|x| -x / g), [0.0; 3]]);
        }
        Self {
            nominal,
            covariance,
            history: History::EMPTY,
            barometer_offset_m: 0.0,
            ground_m: None,
            attitude,
            attitude_before: attitude,
            pushed_m_s: Vec3::zero(),
            force_m_s2: Vec3::zero(),
            span_s: 0.0,
            broken: false,
        }
    }

    /// Adds one inertial sample, biases taken off: the fast path.
    pub(crate) fn advance(&mut self, rate_rad_s: Vec3<Body>, specific_force_m_s2: Vec3<Body>, dt_s: f32) {
        let pushed_m_s = self.nominal.advance(&self.attitude, rate_rad_s, specific_force_m_s2, dt_s);
        self.pushed_m_s = self.pushed_m_s + pushed_m_s;
        self.span_s += dt_s;
        self.attitude = self.nominal.rotation.attitude();
    }

    /// A sample with its biases taken off.
    pub(crate) fn unbiased(&self, imu: &Imu) -> (Vec3<Body>, Vec3<Body>) {
        (imu.rate_rad_s - self.nominal.gyro_bias_rad_s, imu.specific_force_m_s2 - self.nominal.accelerometer_bias_m_s2)
    }

    /// Closes a step of the path at `time_us`: what the covariance and the history follow.
    pub(crate) fn close_step(&mut self, time_us: u64) -> Span {
        self.nominal.settle();
        self.history.push(time_us, &self.nominal);
        let (a, b) = (&self.attitude_before.rows, &self.attitude.rows);
        let half_s = -0.5 * self.span_s;
        let turn = core::array::from_fn(|i| core::array::from_fn(|j| half_s * (a[i][j] + b[i][j])));
        let span = Span { length_s: self.span_s, minus_attitude_s: turn, pushed_m_s: self.pushed_m_s };
        self.force_m_s2 = self.pushed_m_s * (1.0 / self.span_s.max(1e-6));
        self.attitude_before = self.attitude;
        (self.pushed_m_s, self.span_s) = (Vec3::zero(), 0.0);
        span
    }

    /// Carries the covariance over a step.
    ///
    /// - `rate_rad_s`: about what the body turned at, for the noise of the gyro's scale.
    /// - `gap_s`: what of the step no sample covered.
    pub(crate) fn predict(&mut self, config: &EstimatorConfig, span: &Span, rate_rad_s: Vec3<Body>, gap_s: f32) {
        let u = span.pushed_m_s;
        let p = &mut self.covariance;
        p.shear_evenly::<POSITION, VELOCITY>(span.length_s);
        p.shear::<VELOCITY, ATTITUDE>(&[[0.0, u.z, -u.y], [-u.z, 0.0, u.x], [u.y, -u.x, 0.0]]);
        p.shear::<VELOCITY, ACCELEROMETER_BIAS>(&span.minus_attitude_s);
        p.shear::<ATTITUDE, GYRO_BIAS>(&span.minus_attitude_s);
        p.add_noise(&config.noise(span.length_s, components(self.attitude.to_ned(rate_rad_s)), gap_s));
    }

    /// Takes a group of observations in, if all are within the gate.
    ///
    /// - `lasting`: what the source is off by for long. Noise averages out, this does not: what is known better already follows it slowly,
    ///   and is known no better for that.
    pub(crate) fn fuse(&mut self, observations: &[Observation], gate_sigma: f32, lasting: Lasting) -> Fusion {
        let bias = lasting.sigma;
        let (mut ratio, mut within, mut known) = (0.0_f32, true, true);
        for observation in observations {
            let seen = self.covariance.seen(observation);
            let total = gate_sigma * gate_sigma * (seen + observation.variance);
            let own = observation.innovation * observation.innovation / total;
            // Written so that what is not a number is outside.
            within &= own <= 1.0;
            known &= seen < bias * bias;
            ratio = ratio.max(own);
        }
        if !within {
            return Fusion { ratio, taken: false };
        }
        let mut error = [0.0; STATES];
        if known {
            if let Some(samples) = lasting.samples {
                let variance = samples * bias * bias;
                for o in observations {
                    self.covariance.follow(o, variance.max(o.variance), &mut error);
                }
                self.correct(&error);
            }
            return Fusion { ratio, taken: true };
        }
        if !observations.iter().all(|o| self.covariance.observe(o, &mut error)) {
            self.broken = true;
        }
        self.correct(&error);
        Fusion { ratio, taken: true }
    }

    /// Moves everything by an error.
    fn correct(&mut self, error: &[f32; STATES]) {
        let [tx, ty, tz, vx, vy, vz, px, py, pz, gx, gy, gz, ax, ay, az, offset, ground] = *error;
        self.turn(Vec3::new(tx, ty, tz));
        self.shift(Vec3::new(vx, vy, vz), Vec3::new(px, py, pz));
        let held = |v: Vec3<Body>, max: f32| v.map(|x| x.clamp(-max, max));
        let nominal = &mut self.nominal;
        nominal.gyro_bias_rad_s = held(nominal.gyro_bias_rad_s + Vec3::new(gx, gy, gz), GYRO_BIAS_RAD_S_MAX);
        nominal.accelerometer_bias_m_s2 =
            held(nominal.accelerometer_bias_m_s2 + Vec3::new(ax, ay, az), ACCELEROMETER_BIAS_M_S2_MAX);
        self.barometer_offset_m += offset;
        self.ground_m = self.ground_m.map(|ground_m| ground_m + ground);
    }

    /// Turns past and present by a vector in NED.
    pub(crate) fn turn(&mut self, angle_rad: Vec3<Ned>) {
        let turn = Quaternion::exp(angle_rad);
        self.nominal.rotation = turn.after(self.nominal.rotation);
        self.attitude = self.nominal.rotation.attitude();
        self.attitude_before = self.attitude;
        self.history.correct(turn, Vec3::zero(), Vec3::zero());
    }

    /// Shifts past and present.
    pub(crate) fn shift(&mut self, velocity_m_s: Vec3<Ned>, position_m: Vec3<Ned>) {
        self.nominal.velocity_m_s = self.nominal.velocity_m_s + velocity_m_s;
        self.nominal.position_m = self.nominal.position_m + position_m;
        self.history.correct(Quaternion::IDENTITY, velocity_m_s, position_m);
    }

    /// Takes the horizontal position from a measurement and forgets what was believed of it.
    pub(crate) fn place(&mut self, past: &Past, measured_m: Vec3<Ned>, sigma_m: f32) {
        let mut jump = measured_m - past.position_m;
        jump.z = 0.0;
        self.shift(Vec3::zero(), jump);
        self.forget_position(0, past, sigma_m);
        self.forget_position(1, past, sigma_m);
    }

    /// Makes the position along an axis what a measurement says of it: known then, and since then as well as the velocity.
    fn forget_position(&mut self, axis: usize, past: &Past, sigma_m: f32) {
        self.covariance.reset(POSITION + axis, sigma_m * sigma_m);
        self.covariance.add_multiple(VELOCITY + axis, POSITION + axis, past.delay_s);
    }

    /// Takes the altitude from a measurement that is absolute; the barometer's offset and the ground move with it.
    pub(crate) fn level_absolutely(
        &mut self,
        past: &Past,
        measured_m: Vec3<Ned>,
        sigma_m: f32,
        config: &EstimatorConfig,
    ) {
        let jump_m = measured_m.z - past.position_m.z;
        self.shift(Vec3::zero(), Vec3::new(0.0, 0.0, jump_m));
        self.barometer_offset_m += jump_m;
        self.ground_m = self.ground_m.map(|ground_m| ground_m + jump_m);
        let (barometer_m, range_m) = (config.aiding.barometer_m, config.aiding.range_m);
        self.forget_position(2, past, sigma_m);
        self.covariance.copy(DOWN, BARO_OFFSET, barometer_m * barometer_m);
        self.covariance.copy(DOWN, GROUND, range_m * range_m);
    }

    /// Takes the barometer's offset from the altitude, which is believed.
    pub(crate) fn tare_barometer(&mut self, past: &Past, altitude_m: f32, sigma_m: f32) {
        self.barometer_offset_m = altitude_m + past.position_m.z;
        self.covariance.copy(DOWN, BARO_OFFSET, sigma_m * sigma_m);
    }

    /// Takes the altitude from the barometer, whose offset is believed.
    pub(crate) fn level_by_barometer(&mut self, past: &Past, altitude_m: f32, sigma_m: f32) {
        let jump_m = self.barometer_offset_m - altitude_m - past.position_m.z;
        self.shift(Vec3::zero(), Vec3::new(0.0, 0.0, jump_m));
        self.covariance.copy(BARO_OFFSET, DOWN, sigma_m * sigma_m);
        self.covariance.add_multiple(VELOCITY + 2, DOWN, past.delay_s);
    }

    /// Takes the ground from a range of `height_m` above it, of standard deviation `sigma_m`.
    pub(crate) fn find_ground(&mut self, past: &Past, height_m: f32, sigma_m: f32) {
        self.ground_m = Some(past.position_m.z + height_m);
        self.covariance.copy(DOWN, GROUND, sigma_m * sigma_m);
    }

    /// Takes the velocity from a measurement and forgets what was believed of it.
    ///
    /// What led it astray is doubted as well: biases, and the tilt by `tilt_rad`.
    pub(crate) fn launch(&mut self, past: &Past, measured_m_s: Vec3<Ned>, sigma_m_s: f32, tilt_rad: f32) {
        self.shift(measured_m_s - past.velocity_m_s, Vec3::zero());
        for axis in 0..3 {
            self.covariance.reset(VELOCITY + axis, sigma_m_s * sigma_m_s);
        }
        self.covariance.add_noise(&spread([
            (ATTITUDE, tilt_rad),
            (GYRO_BIAS, DOUBT_RAD_S),
            (ACCELEROMETER_BIAS, DOUBT_M_S2),
        ]));
    }

    /// Turns the heading by an angle and forgets what was believed of it.
    pub(crate) fn head(&mut self, by_rad: f32, sigma_rad: f32) {
        // In thirds: the exponential is a series.
        for _ in 0..3 {
            self.turn(Vec3::new(0.0, 0.0, by_rad / 3.0));
        }
        self.covariance.reset(ATTITUDE + 2, sigma_rad * sigma_rad);
    }

    /// Goes on with another inertial unit, which reads above the last by `rate_rad_s` and `force_m_s2`.
    pub(crate) fn trade_biases(&mut self, rate_rad_s: Vec3<Body>, force_m_s2: Vec3<Body>) {
        let nominal = &mut self.nominal;
        nominal.gyro_bias_rad_s = nominal.gyro_bias_rad_s + rate_rad_s;
        nominal.accelerometer_bias_m_s2 = nominal.accelerometer_bias_m_s2 + force_m_s2;
        self.covariance.add_noise(&spread([(GYRO_BIAS, TRADE_RAD_S), (ACCELEROMETER_BIAS, TRADE_M_S2)]));
    }

    /// Variances of the bias of gyro, (rad/s)², for `half` 0, and of accelerometer, (m/s²)², for 1.
    pub(crate) fn bias_variances(&self, half: usize) -> [f32; 3] {
        core::array::from_fn(|axis| self.covariance.variance(GYRO_BIAS + 3 * half + axis))
    }

    /// Adds to them.
    pub(crate) fn doubt_bias(&mut self, half: usize, variance: f32) {
        let mut variances = [0.0; STATES];
        variances[GYRO_BIAS + 3 * half..][..3].fill(variance);
        self.covariance.add_noise(&variances);
    }

    /// Whether the accelerometer, whose offset is known to be `offset_m_s2`, is off by more than a part that is not broken.
    pub(crate) fn is_broken(&self, offset_m_s2: Vec3<Body>) -> bool {
        (self.nominal.accelerometer_bias_m_s2 - offset_m_s2).norm_squared() > BROKEN_M_S2 * BROKEN_M_S2
    }

    /// Whether it may be believed at all.
    pub(crate) fn is_sound(&self) -> bool {
        let sum = self.nominal.velocity_m_s.norm_squared()
            + self.nominal.position_m.norm_squared() * 1e-6
            + self.nominal.gyro_bias_rad_s.norm_squared()
            + self.nominal.accelerometer_bias_m_s2.norm_squared();
        self.nominal.rotation.is_sound() && sum < 1e6 && !self.broken && self.covariance.is_sound()
    }
}

/// Variances of three states each, from standard deviations.
fn spread<const N: usize>(blocks: [(usize, f32); N]) -> [f32; STATES] {
    let mut variances = [0.0; STATES];
    for (first, sigma) in blocks {
        variances[first..first + 3].fill(sigma * sigma);
    }
    variances
}

/// What a source is off by for long.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lasting {
    /// Standard deviation, in the unit of the observation.
    pub(crate) sigma: f32,
    /// In how many samples what is known as well follows it; `None` where it had better not.
    pub(crate) samples: Option<f32>,
}

impl Lasting {
    /// White noise alone.
    pub(crate) const NOTHING: Self = Self { sigma: 0.0, samples: None };
}

/// What happened to a group of observations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fusion {
    /// Largest squared innovation over that of the gate.
    pub(crate) ratio: f32,
    pub(crate) taken: bool,
}

/// What the inertial unit did over a step of the covariance.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "the unit")]
pub(crate) struct Span {
    pub(crate) length_s: f32,
    /// −∫ R, s: by the mean of both ends, 0.2 % off where 35 rad/s turn in 4 ms.
    minus_attitude_s: [[f32; 3]; 3],
    pushed_m_s: Vec3<Ned>,
}

/// How much the rates may have changed unseen in a gap: 1 rad/s and 5 m/s².
const GAP_RAD_S: f32 = 1.0;
const GAP_M_S2: f32 = 5.0;
/// How long a scale error keeps its sign, as the body's rates change, s.
const SCALE_S: f32 = 0.1;

impl EstimatorConfig {
    /// Variances that a step adds.
    fn noise(&self, span_s: f32, rate_ned_rad_s: [f32; 3], gap_s: f32) -> [f32; STATES] {
        let i = &self.inertial;
        let square = |x: f32| x * x;
        let (gyro, force) = (square(i.gyro_rad_s_rt_hz) * span_s, square(i.accelerometer_m_s2_rt_hz) * span_s);
        let (gyro_gap, force_gap) = (square(GAP_RAD_S * gap_s), square(GAP_M_S2 * gap_s));
        let (gyro_walk, force_walk) =
            (square(i.gyro_walk_rad_s_rt_s) * span_s, square(i.accelerometer_walk_m_s2_rt_s) * span_s);
        let scale = square(i.gyro_scale) * SCALE_S * span_s;
        let mut noise = [0.0; STATES];
        for axis in 0..3 {
            noise[ATTITUDE + axis] = gyro + scale * square(rate_ned_rad_s[axis]) + gyro_gap;
            noise[VELOCITY + axis] = force + force_gap;
            noise[GYRO_BIAS + axis] = gyro_walk;
            noise[ACCELEROMETER_BIAS + axis] = force_walk;
        }
        noise[BARO_OFFSET] = square(self.aiding.barometer_walk_m_rt_s) * span_s;
        noise[GROUND] = square(self.aiding.ground_walk_m_rt_s) * span_s;
        noise
    }
}
