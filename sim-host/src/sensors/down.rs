//! What looks along body down: optical flow, and the distance to the ground.
//!
//! ```text
//! d = height / cos(tilt), along body down       flow_x = ω_x − v_y / d       flow_y = ω_y + v_x / d
//! ```
//!
//! v is the velocity in body axes, ω the body rates: above still ground flow equals the rates. The flow sensor counts steps
//! of an angle, and what is left over goes into the next sample; a sample is a mean, stamped half way. Out of its range the
//! range sensor has no sample; without an image flow has samples of quality 0.
use super::World;
use super::broken::Broken;
use super::chance::{Chance, register};
use super::keys::SensorKeys;
use super::line::Line;
use super::parts::{FlowPart, FlowSheet, RangePart, RangeSheet};
use super::stream;
use crate::fault::sensors::{Sensor, SensorFault};
use control_core::measurement::{Flow, Stamped};

/// Cosine of the tilt beyond which nothing below is looked at.
const UPRIGHT_MIN: f64 = 0.2;
/// Image below which there is nothing to track, as a share.
const IMAGE_MIN: f64 = 0.05;

/// Distance to the ground along body down, m; none without ground below.
pub(super) fn distance_m(world: &World, ground_altitude_m: Option<f64>) -> Option<f64> {
    let upright = world.truth.attitude[(2, 2)];
    let height_m = world.truth.altitude_m() - ground_altitude_m?;
    (upright > UPRIGHT_MIN && height_m > 0.0).then(|| height_m / upright)
}

/// A range sensor in flight.
pub(super) struct RangeModel {
    sheet: RangeSheet,
    line: Line<f32>,
    chance: Chance,
    broken: Broken<[f64; 1]>,
    noise: f64,
    offset_m: f64,
    farthest_m: f64,
}

impl RangeModel {
    pub(super) fn new(part: RangePart, keys: &SensorKeys, faults: &[SensorFault], seed: u64) -> Self {
        let sheet = part.sheet();
        let tuned = keys.tuned(sheet.timing, |each| each.range);
        let mut chance = stream(seed, Sensor::Range, 1);
        let (dark_lux, sun_lux) = sheet.light_lux;
        let light = libm::log(keys.light_lux.max(dark_lux) / dark_lux) / libm::log(sun_lux / dark_lux);
        let (dark_m, sun_m) = sheet.farthest_m;
        Self {
            line: Line::new(tuned.timing, chance.even()),
            broken: Broken::new(faults, Sensor::Range, 1, seed),
            noise: tuned.noise,
            offset_m: sheet.offset_m * tuned.noise * chance.normal(),
            farthest_m: dark_m + (sun_m - dark_m) * light.min(1.0),
            chance,
            sheet,
        }
    }

    pub(super) fn sample(&mut self, world: &World, distance_m: Option<f64>) -> Option<Stamped<f32>> {
        if self.line.is_due(world.t_s) {
            let RangeSheet { noise_m: (least_m, share), lsb_m, nearest_m, .. } = self.sheet;
            let white = self.chance.normal() * self.noise;
            let span_m = (nearest_m, self.farthest_m);
            let seen_m = distance_m.filter(|&d| nearest_m <= d && d <= self.farthest_m);
            let there_m = distance_m.map_or(self.farthest_m, |d| d + self.offset_m + (least_m + share * d) * white);
            // Faults are followed while there is no ground, too.
            let [read_m] = self.broken.read(world.t_s, [there_m], |_| span_m);
            let lost = self.broken.is_lost();
            let read_m = register(read_m, lsb_m, span_m) as f32;
            self.line.send(world.t_s, seen_m.filter(|_| !lost).map(|_| read_m), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }
}

/// A flow sensor in flight.
pub(super) struct FlowModel {
    sheet: FlowSheet,
    line: Line<Flow>,
    chance: Chance,
    broken: Broken<[f64; 2]>,
    noise: f64,
    scale: f64,
    /// Share of the image that light and texture leave.
    image: f64,
    /// Turned since the last sample, and not yet counted, rad.
    turned_rad: [f64; 2],
    /// Time since the last sample, s.
    span_s: f64,
    dt_s: f64,
}

impl FlowModel {
    pub(super) fn new(part: FlowPart, keys: &SensorKeys, faults: &[SensorFault], dt_s: f64, seed: u64) -> Self {
        let sheet = part.sheet();
        let tuned = keys.tuned(sheet.timing, |each| each.flow);
        let mut chance = stream(seed, Sensor::Flow, 1);
        let (dark_lux, bright_lux) = sheet.light_lux;
        let light = ((keys.light_lux - dark_lux) / (bright_lux - dark_lux)).clamp(0.0, 1.0);
        Self {
            line: Line::new(tuned.timing, chance.even()),
            broken: Broken::new(faults, Sensor::Flow, 1, seed),
            noise: tuned.noise,
            scale: 1.0 + sheet.scale * tuned.noise * chance.normal(),
            image: light * keys.texture,
            turned_rad: [0.0; 2],
            span_s: 0.0,
            dt_s,
            chance,
            sheet,
        }
    }

    pub(super) fn sample(&mut self, world: &World, distance_m: Option<f64>) -> Option<Stamped<Flow>> {
        self.span_s += self.dt_s;
        let near = distance_m.filter(|&d| d >= self.sheet.nearest_m && self.image >= IMAGE_MIN);
        if let Some(distance_m) = near {
            let velocity = world.truth.attitude.transpose() * world.truth.velocity_m_s;
            let rate = world.truth.rate_rad_s;
            self.turned_rad[0] += self.scale * (rate.x - velocity.y / distance_m) * self.dt_s;
            self.turned_rad[1] += self.scale * (rate.y + velocity.x / distance_m) * self.dt_s;
        } else {
            self.turned_rad = [0.0; 2];
        }
        if self.line.is_due(world.t_s) {
            let span_s = std::mem::take(&mut self.span_s);
            let quality = if near.is_some() { self.image } else { 0.0 };
            let rate_rad_s = self.count(world.t_s, span_s, quality);
            let lost = self.broken.is_lost();
            let flow = Flow { rate_rad_s: rate_rad_s.map(|x| x as f32), quality: quality as f32 };
            self.line.send(world.t_s - 0.5 * span_s, (!lost).then_some(flow), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }

    /// What the counters say of the last `span_s`, rad/s.
    fn count(&mut self, t_s: f64, span_s: f64, quality: f64) -> [f64; 2] {
        let FlowSheet { noise_rad_s, counts_rad, span_rad_s, .. } = self.sheet;
        // Half the image has half the features to average.
        let noise_rad_s = noise_rad_s * self.noise / libm::sqrt(quality.max(IMAGE_MIN));
        let span = (-span_rad_s, span_rad_s);
        let mut there = self.turned_rad;
        for turned_rad in &mut there {
            let white_rad = noise_rad_s * span_s * self.chance.normal();
            if quality > 0.0 {
                *turned_rad += white_rad;
            }
        }
        let read = self.broken.read(t_s, there.map(|turned_rad| turned_rad / span_s), |_| span);
        let counted = read.map(|x| register(x * span_s, 1.0 / counts_rad, (-span_rad_s * span_s, span_rad_s * span_s)));
        for i in 0..2 {
            // Less than a step is left over; what saturation or a fault took is gone.
            let left_rad = there[i] - counted[i];
            self.turned_rad[i] = if left_rad.abs() <= 0.5 / counts_rad { left_rad } else { 0.0 };
        }
        counted.map(|counted_rad| counted_rad / span_s)
    }
}
