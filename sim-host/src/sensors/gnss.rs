//! A satellite receiver: position and velocity with noise, multipath that lasts a minute, and errors that last hours.
//!
//! ```text
//! p = p_true + (s − s₀) + k e + σ n      v = v_true + k e' + σ' n      s, e, e' Gauss-Markov, k the sky's multipath
//! ```
//!
//! The local frame's origin is where the receiver believed to be when it was switched on, so that of the slow error s only
//! what it has changed since counts. The receiver's own estimate of its error holds all of s, and follows multipath: half
//! from its statistics, half from its size now. In a drop-out fixes go on, marked as none, at the last position.
use super::World;
use super::broken::{Broken, Reading};
use super::chance::{Chance, GaussMarkov, register};
use super::keys::{SensorKeys, SkyKeys};
use super::line::Line;
use super::parts::{GnssPart, GnssSheet};
use super::{narrow, stream};
use crate::fault::Toggle;
use crate::fault::sensors::{Sensor, SensorFault};
use control_core::measurement::{Gnss, Stamped};
use nalgebra::Vector3;

/// What the receiver says of its error without a fix, m and m/s.
const LOST_SIGMA: f32 = 1000.0;
/// Largest readings that garbage makes, m and m/s.
const SPAN: (f64, f64) = (1000.0, 50.0);

/// Position and velocity; offsets are of the position.
#[derive(Clone, Copy)]
struct Fix([f64; 6]);

impl Reading for Fix {
    fn channels(&mut self) -> &mut [f64] {
        &mut self.0[..3]
    }

    fn everything(&mut self) -> &mut [f64] {
        &mut self.0
    }
}

/// A receiver in flight.
pub(super) struct GnssModel {
    sheet: GnssSheet,
    line: Line<Gnss>,
    chance: Chance,
    broken: Broken<Fix>,
    sky: SkyKeys,
    noise: f64,
    period_s: f64,
    slow_m: GaussMarkov,
    /// The slow error when it was switched on, m.
    origin_m: Vector3<f64>,
    multipath_m: GaussMarkov,
    multipath_m_s: GaussMarkov,
    outage: Toggle,
    last: Vector3<f64>,
}

impl GnssModel {
    pub(super) fn new(part: GnssPart, keys: &SensorKeys, faults: &[SensorFault], seed: u64) -> Self {
        let sheet = part.sheet();
        let tuned = keys.tuned(sheet.timing, |each| each.gnss);
        let mut chance = stream(seed, Sensor::Gnss, 1);
        let (noise, sky) = (tuned.noise, keys.sky);
        let wandering = |sigma: [f64; 3], factor: f64, time_s: f64, chance: &mut Chance| {
            GaussMarkov::new(Vector3::from(sigma) * factor, time_s, chance)
        };
        let slow_m = wandering(sheet.slow_m, noise, sheet.slow_time_s, &mut chance);
        let rate_1_s = sky.outage_rate_1_s;
        let first_s = if rate_1_s > 0.0 { chance.wait_s(1.0 / rate_1_s) } else { f64::INFINITY };
        Self {
            line: Line::new(tuned.timing, chance.even()),
            broken: Broken::new(faults, Sensor::Gnss, 1, seed),
            period_s: 1.0 / tuned.timing.rate_hz,
            origin_m: slow_m.value,
            slow_m,
            multipath_m: wandering(sheet.multipath_m, noise * sky.multipath, sheet.multipath_time_s, &mut chance),
            multipath_m_s: wandering(
                sheet.multipath_m_s,
                noise * sky.multipath,
                sheet.multipath_speed_time_s,
                &mut chance,
            ),
            outage: Toggle::off_until(first_s),
            last: Vector3::zeros(),
            sky,
            noise,
            chance,
            sheet,
        }
    }

    pub(super) fn sample(&mut self, world: &World) -> Option<Stamped<Gnss>> {
        if self.line.is_due(world.t_s) {
            let fix = self.fix(world);
            let lost = self.broken.is_lost();
            self.line.send(world.t_s, (!lost).then_some(fix), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }

    fn fix(&mut self, world: &World) -> Gnss {
        let Self { sheet, chance, sky, noise, period_s, .. } = self;
        let slow_m = self.slow_m.step(*period_s, chance) - self.origin_m;
        let multipath_m = self.multipath_m.step(*period_s, chance);
        let multipath_m_s = self.multipath_m_s.step(*period_s, chance);
        let white_m = Vector3::from(sheet.noise_m).component_mul(&chance.normals()) * *noise;
        let white_m_s = Vector3::from(sheet.noise_m_s).component_mul(&chance.normals()) * *noise;
        if sky.outage_rate_1_s > 0.0 {
            self.outage
                .advance(world.t_s, |out| chance.wait_s(if out { sky.outage_s } else { 1.0 / sky.outage_rate_1_s }));
        }
        let fixed = !self.outage.on;
        if fixed {
            self.last = world.truth.position_m + slow_m + multipath_m + white_m;
        }
        let p = self.last;
        let v = if fixed { world.truth.velocity_m_s + multipath_m_s + white_m_s } else { Vector3::zeros() };
        let span = |i: usize| if i < 3 { (-SPAN.0, SPAN.0) } else { (-SPAN.1, SPAN.1) };
        let Fix(read) = self.broken.read(world.t_s, Fix([p.x, p.y, p.z, v.x, v.y, v.z]), span);
        let lsb = |i: usize| if i < 3 { sheet.lsb_m[i] } else { sheet.lsb_m_s };
        let [x, y, z, vx, vy, vz] = std::array::from_fn(|i| register(read[i], lsb(i), (f64::MIN, f64::MAX)));

        let believed = |white: f64, slow: f64, path: f64, now: f64| {
            let path = path * sky.multipath * *noise;
            let rest = (white * white + slow * slow) * *noise * *noise;
            libm::sqrt(rest + 0.5 * (path * path + now * now)) as f32
        };
        let level_m = libm::sqrt(0.5 * (multipath_m.x * multipath_m.x + multipath_m.y * multipath_m.y));
        let speed_m_s = libm::sqrt(multipath_m_s.norm_squared() / 3.0);
        let sigma = |believed: f32| if fixed { believed } else { LOST_SIGMA };
        Gnss {
            position_m: narrow(&Vector3::new(x, y, z)),
            velocity_m_s: narrow(&Vector3::new(vx, vy, vz)),
            horizontal_m: sigma(believed(sheet.noise_m[0], sheet.slow_m[0], sheet.multipath_m[0], level_m)),
            vertical_m: sigma(believed(sheet.noise_m[2], sheet.slow_m[2], sheet.multipath_m[2], multipath_m.z)),
            speed_m_s: sigma(believed(sheet.noise_m_s[2], 0.0, sheet.multipath_m_s[2], speed_m_s)),
            fixed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, SVector};

    #[test]
    fn a_receivers_errors_add_up_to_what_its_sheet_says_of_half_the_time() {
        for (part, cep_m) in [(GnssPart::M10, 1.5), (GnssPart::F9p, 1.0), (GnssPart::F9pRtk, 0.01)] {
            let sheet = part.sheet();
            let axis_m =
                [sheet.noise_m, sheet.slow_m, sheet.multipath_m].map(|m| m[0] * m[0]).iter().sum::<f64>().sqrt();
            // Half of a circular Gaussian is within √(2 ln 2) σ.
            let found_m = (2.0 * std::f64::consts::LN_2).sqrt() * axis_m;
            assert!((found_m / cep_m - 1.0).abs() < 0.02, "{part:?}: {found_m} m, not {cep_m} m");
        }
    }

    /// Horizontal distances that 95 % of half an hour is within, m: of the slow error alone, of it with multipath, and of the slow one along north.
    fn half_an_hour(seed: u64) -> [f64; 3] {
        let sheet = GnssPart::M10.sheet();
        let mut chance = stream(seed, Sensor::Gnss, 1);
        let mut slow_m = GaussMarkov::new(sheet.slow_m.into(), sheet.slow_time_s, &mut chance);
        let mut multipath_m = GaussMarkov::new(sheet.multipath_m.into(), sheet.multipath_time_s, &mut chance);
        let origin_m = slow_m.value;
        let mut found = [const { Vec::new() }; 3];
        for _ in 0..1800 {
            let slow_m = slow_m.step(1.0, &mut chance) - origin_m;
            let all_m = slow_m + multipath_m.step(1.0, &mut chance);
            for (found, m) in found.iter_mut().zip([slow_m.xy().norm(), all_m.xy().norm(), slow_m.x.abs()]) {
                found.push(m);
            }
        }
        found.map(|mut found: Vec<f64>| {
            found.sort_by(f64::total_cmp);
            found[found.len() * 95 / 100]
        })
    }

    /// `cargo test --release -p sim-host --lib lasts_for_hours -- --nocapture` prints the bound of docs/estimation.md.
    #[test]
    fn what_lasts_for_hours_takes_a_fifth_of_hovers_beyond_a_metre_and_a_half_by_itself() {
        let flights: Vec<[f64; 3]> = (0..1000).map(half_an_hour).collect();
        let [slow, all, north] = [0, 1, 2].map(|i| {
            let mut found: Vec<f64> = flights.iter().map(|flight| flight[i]).collect();
            found.sort_by(f64::total_cmp);
            let beyond = found.iter().filter(|&&m| m > 1.5).count() as f64 / found.len() as f64;
            (found[found.len() / 2], beyond)
        });
        for (what, (median_m, beyond)) in [("slow", slow), ("with multipath", all), ("slow, one axis", north)] {
            println!(
                "receiver, {what}: {median_m:.2} m in the median, beyond 1.5 m in {:.0} % of flights",
                100.0 * beyond
            );
        }
        assert!((0.15..0.25).contains(&slow.1) && all.1 > 0.4 && north.1 < 0.12, "{slow:?} {all:?} {north:?}");
    }

    /// Errors of one axis, for the best estimator there can be: dead reckoning's position and velocity, what its acceleration is off by, and what the
    /// receiver is off by in velocity, by multipath and slowly.
    type Errors = SVector<f64, 6>;

    const SECOND: f64 = 1.0;
    const HALF_AN_HOUR: usize = 1800;
    /// Bias of a horizontal acceleration, once tilt and accelerometer have settled, 1 σ, and its walk: as the inertial unit's.
    const BIAS_M_S2: f64 = 0.005;
    const BIAS_WALK: f64 = 2e-4;

    /// A linear system that is known to the last digit, and the gains of its Kalman filter, second by second.
    struct Best {
        advance: SMatrix<f64, 6, 6>,
        /// Deviation of what comes in each second.
        noise: Errors,
        start: Errors,
        look: SMatrix<f64, 2, 6>,
        look_noise: SVector<f64, 2>,
        gains: Vec<SMatrix<f64, 6, 2>>,
    }

    impl Best {
        fn new(sheet: &GnssSheet) -> Self {
            let keep = |time_s: f64| libm::exp(-SECOND / time_s);
            let kept = [keep(sheet.multipath_speed_time_s), keep(sheet.multipath_time_s), keep(sheet.slow_time_s)];
            let mut advance = SMatrix::<f64, 6, 6>::identity();
            advance[(0, 1)] = SECOND;
            advance[(0, 2)] = -0.5 * SECOND * SECOND;
            advance[(1, 2)] = -SECOND;
            for (i, kept) in kept.into_iter().enumerate() {
                advance[(3 + i, 3 + i)] = kept;
            }
            let sigmas = [sheet.multipath_m_s[0], sheet.multipath_m[0], sheet.slow_m[0]];
            let kick = |i: usize| sigmas[i] * libm::sqrt(1.0 - kept[i] * kept[i]);
            let noise = Errors::new(0.0, 0.0, BIAS_WALK * libm::sqrt(SECOND), kick(0), kick(1), kick(2));
            // The origin is where the receiver was: the slow error begins with nothing.
            let start = Errors::new(0.0, 0.0, BIAS_M_S2, sigmas[0], sigmas[1], 0.0);
            let look =
                SMatrix::<f64, 2, 6>::from_row_slice(&[1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
            let fixes = libm::sqrt(sheet.timing.rate_hz * SECOND);
            let look_noise = SVector::<f64, 2>::new(sheet.noise_m[0] / fixes, sheet.noise_m_s[0] / fixes);
            let square = |v: &Errors| SMatrix::from_diagonal(&v.component_mul(v));
            let mut p = square(&start);
            let gains = (0..HALF_AN_HOUR).map(|_| {
                p = advance * p * advance.transpose() + square(&noise);
                let s = look * p * look.transpose() + SMatrix::from_diagonal(&look_noise.component_mul(&look_noise));
                let gain = p * look.transpose() * s.try_inverse().expect("noise is not nothing");
                p -= gain * look * p;
                gain
            });
            Self { gains: gains.collect(), advance, noise, start, look, look_noise }
        }

        /// What it is off by in position, second by second.
        fn fly(&self, chance: &mut Chance) -> Vec<f64> {
            let mut draw = |sigma: &Errors| sigma.map(|sigma| sigma * chance.normal());
            let (mut there, mut believed) = (draw(&self.start), Errors::zeros());
            let mut off_m = Vec::new();
            for gain in &self.gains {
                there = self.advance * there + draw(&self.noise);
                believed = self.advance * believed;
                let scatter = draw(&Errors::repeat(1.0)).fixed_rows::<2>(0).component_mul(&self.look_noise);
                let seen = self.look * there + scatter;
                believed += gain * (seen - self.look * believed);
                off_m.push(there[0] - believed[0]);
            }
            off_m
        }
    }

    /// What the best estimator makes of a receiver: the distance that 95 % of half an hour is within, m, in the median and in one of ten, and the
    /// share of half hours in which it is beyond 1.5 m.
    fn best_of(part: GnssPart) -> [f64; 3] {
        let best = Best::new(&part.sheet());
        let mut chance = stream(1, Sensor::Gnss, 1);
        let mut distances_m: Vec<f64> = (0..1000)
            .map(|_| {
                let [north, east] = [(); 2].map(|()| best.fly(&mut chance));
                let mut off_m: Vec<f64> = north.iter().zip(&east).map(|(n, e)| libm::hypot(*n, *e)).collect();
                off_m.sort_by(f64::total_cmp);
                off_m[off_m.len() * 95 / 100]
            })
            .collect();
        distances_m.sort_by(f64::total_cmp);
        let beyond = distances_m.iter().filter(|&&m| m > 1.5).count() as f64 / distances_m.len() as f64;
        let [median_m, tenth_m] = [500, 900].map(|i| distances_m[i]);
        println!(
            "{part:?}, best estimator: {median_m:.2} m in the median, {tenth_m:.2} m in one of ten, beyond 1.5 m in {:.0} % of flights",
            100.0 * beyond
        );
        [median_m, tenth_m, beyond]
    }

    /// `cargo test --release -p sim-host --lib best_estimator -- --nocapture` prints the bounds of docs/estimation.md.
    #[test]
    fn the_best_estimator_there_can_be_is_hardly_better_than_its_receiver() {
        let [median_m, _, beyond] = best_of(GnssPart::M10);
        assert!((1.0..1.5).contains(&median_m) && beyond > 0.2, "{median_m} {beyond}");
        let [_, tenth_m, beyond] = best_of(GnssPart::F9p);
        assert!(tenth_m > 1.4 && (0.02..0.2).contains(&beyond), "{tenth_m} {beyond}");
        let [_, tenth_m, beyond] = best_of(GnssPart::F9pRtk);
        assert!(tenth_m < 0.05 && beyond == 0.0, "{tenth_m} {beyond}");
    }
}
