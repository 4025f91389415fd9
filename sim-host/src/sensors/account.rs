//! How wrong the sensors of a flight were: each reading beside the truth at its time stamp.
use super::SensorKeys;
use crate::flight::Sample;
use crate::plant::Truth;
use crate::scenario::Scenario;
use crate::vehicle::Vehicle;
use control_core::frames::Vec3;
use control_core::measurement::{Measurements, Stamped};
use nalgebra::Vector3;
use std::collections::VecDeque;

/// How long the truth is remembered, s: longer than any latency.
const MEMORY_S: f64 = 3.0;

/// All that readings are compared with.
#[derive(Clone, Copy)]
struct Seen {
    t_s: f64,
    truth: Truth,
    rotor_rad_s: [f64; 4],
    field_ut: Vector3<f64>,
    ground_altitude_m: f64,
}

impl Seen {
    fn body_m_s(&self) -> Vector3<f64> {
        self.truth.attitude.transpose() * self.truth.velocity_m_s
    }

    fn distance_m(&self) -> f64 {
        (self.truth.altitude_m() - self.ground_altitude_m) / self.truth.attitude[(2, 2)]
    }
}

/// A stamp and a reading.
type Reading = Option<(u64, f64)>;

/// One number of one sensor.
struct Channel {
    name: &'static str,
    unit: &'static str,
    read: fn(&Measurements) -> Reading,
    truth: fn(&Seen) -> f64,
}

fn scalar(sample: Option<Stamped<f32>>) -> Reading {
    sample.map(|x| (x.time_us, f64::from(x.value)))
}

fn part<T, F: Copy>(sample: Option<Stamped<T>>, of: impl Fn(&T) -> Vec3<F>, axis: usize) -> Reading {
    let sample = sample?;
    let v = of(&sample.value);
    Some((sample.time_us, f64::from([v.x, v.y, v.z][axis])))
}

const CHANNELS: [Channel; 20] = [
    Channel {
        name: "gyro x",
        unit: "rad/s",
        read: |m| part(m.imu, |imu| imu.rate_rad_s, 0),
        truth: |seen| seen.truth.rate_rad_s.x,
    },
    Channel {
        name: "gyro z",
        unit: "rad/s",
        read: |m| part(m.imu, |imu| imu.rate_rad_s, 2),
        truth: |seen| seen.truth.rate_rad_s.z,
    },
    Channel {
        name: "accelerometer x",
        unit: "m/s²",
        read: |m| part(m.imu, |imu| imu.specific_force_m_s2, 0),
        truth: |seen| seen.truth.specific_force_m_s2.x,
    },
    Channel {
        name: "accelerometer z",
        unit: "m/s²",
        read: |m| part(m.imu, |imu| imu.specific_force_m_s2, 2),
        truth: |seen| seen.truth.specific_force_m_s2.z,
    },
    Channel {
        name: "second gyro x",
        unit: "rad/s",
        read: |m| part(m.imu_second, |imu| imu.rate_rad_s, 0),
        truth: |seen| seen.truth.rate_rad_s.x,
    },
    Channel {
        name: "baro altitude",
        unit: "m",
        read: |m| scalar(m.baro_altitude_m),
        truth: |seen| seen.truth.altitude_m(),
    },
    Channel {
        name: "second baro altitude",
        unit: "m",
        read: |m| scalar(m.baro_second_altitude_m),
        truth: |seen| seen.truth.altitude_m(),
    },
    Channel {
        name: "mag x",
        unit: "µT",
        read: |m| part(m.magnetic_ut, |field| *field, 0),
        truth: |seen| (seen.truth.attitude.transpose() * seen.field_ut).x,
    },
    Channel {
        name: "mag y",
        unit: "µT",
        read: |m| part(m.magnetic_ut, |field| *field, 1),
        truth: |seen| (seen.truth.attitude.transpose() * seen.field_ut).y,
    },
    Channel {
        name: "gnss north",
        unit: "m",
        read: |m| part(m.gnss, |fix| fix.position_m, 0),
        truth: |seen| seen.truth.position_m.x,
    },
    Channel {
        name: "gnss down",
        unit: "m",
        read: |m| part(m.gnss, |fix| fix.position_m, 2),
        truth: |seen| seen.truth.position_m.z,
    },
    Channel {
        name: "gnss velocity north",
        unit: "m/s",
        read: |m| part(m.gnss, |fix| fix.velocity_m_s, 0),
        truth: |seen| seen.truth.velocity_m_s.x,
    },
    Channel { name: "range", unit: "m", read: |m| scalar(m.range_m), truth: Seen::distance_m },
    Channel {
        name: "flow x",
        unit: "rad/s",
        read: |m| m.flow.map(|x| (x.time_us, f64::from(x.value.rate_rad_s[0]))),
        truth: |seen| seen.truth.rate_rad_s.x - seen.body_m_s().y / seen.distance_m(),
    },
    Channel {
        name: "flow y",
        unit: "rad/s",
        read: |m| m.flow.map(|x| (x.time_us, f64::from(x.value.rate_rad_s[1]))),
        truth: |seen| seen.truth.rate_rad_s.y + seen.body_m_s().x / seen.distance_m(),
    },
    Channel {
        name: "vision north",
        unit: "m",
        read: |m| part(m.vision, |pose| pose.position_m, 0),
        truth: |seen| seen.truth.position_m.x,
    },
    Channel {
        name: "vision down",
        unit: "m",
        read: |m| part(m.vision, |pose| pose.position_m, 2),
        truth: |seen| seen.truth.position_m.z,
    },
    Channel {
        name: "vision heading",
        unit: "rad",
        read: |m| {
            m.vision.map(|x| {
                let [forward, right] = [x.value.attitude.rows[0][0], x.value.attitude.rows[1][0]];
                (x.time_us, libm::atan2(right.into(), forward.into()))
            })
        },
        truth: |seen| seen.truth.angles_rad()[2],
    },
    Channel {
        name: "speed of rotor 1",
        unit: "rad/s",
        read: |m| m.rotor_rad_s.map(|x| (x.time_us, f64::from(x.value[0]))),
        truth: |seen| seen.rotor_rad_s[0],
    },
    Channel {
        name: "speed of rotor 2",
        unit: "rad/s",
        read: |m| m.rotor_rad_s.map(|x| (x.time_us, f64::from(x.value[1]))),
        truth: |seen| seen.rotor_rad_s[1],
    },
];

/// What is kept of one channel.
#[derive(Clone, Copy, Default)]
struct Track {
    samples: f64,
    sum: f64,
    squares: f64,
    largest: f64,
    late_s: f64,
    last_s: f64,
    gap_s: f64,
}

/// The account of one flight.
pub struct Account {
    vehicle: Vehicle,
    field_ut: Vector3<f64>,
    ground_altitude_m: f64,
    past: VecDeque<Seen>,
    tracks: [Track; CHANNELS.len()],
    end_s: f64,
}

impl Account {
    /// An account of a flight of `scenario` with the sensors `keys`.
    pub fn new(scenario: &Scenario, keys: &SensorKeys) -> Self {
        Self {
            vehicle: scenario.vehicle(),
            field_ut: keys.earth.field_ned_ut().into(),
            ground_altitude_m: scenario.ground_altitude_m.unwrap_or(f64::NEG_INFINITY),
            past: VecDeque::new(),
            tracks: [Track::default(); CHANNELS.len()],
            end_s: 0.0,
        }
    }

    /// Notes one tick.
    pub fn note(&mut self, sample: &Sample) {
        let (t_s, truth) = (sample.clock_s, *sample.truth);
        let rotor_rad_s = std::array::from_fn(|i| {
            let share = sample.effectiveness[i];
            let rotor_n = if share == 0.0 { 0.0 } else { truth.thrust_n[i] / share };
            libm::sqrt(rotor_n.max(0.0) / self.vehicle.thrust_coefficient_n_s2)
        });
        let Self { field_ut, ground_altitude_m, .. } = *self;
        self.past.push_back(Seen { t_s, truth, rotor_rad_s, field_ut, ground_altitude_m });
        while self.past.front().is_some_and(|seen| seen.t_s < t_s - MEMORY_S) {
            self.past.pop_front();
        }
        self.end_s = t_s;
        for (channel, track) in CHANNELS.iter().zip(&mut self.tracks) {
            let Some((time_us, read)) = (channel.read)(sample.measurements) else { continue };
            let stamp_s = time_us as f64 * 1e-6;
            let error = read - at(&self.past, stamp_s, channel.truth);
            track.samples += 1.0;
            track.sum += error;
            track.squares += error * error;
            track.largest = track.largest.max(error.abs());
            track.late_s += t_s - stamp_s;
            track.gap_s = track.gap_s.max(t_s - track.last_s);
            track.last_s = t_s;
        }
    }

    /// One row for each channel that had a sample: name, unit, samples a second, mean lateness and longest gap in ms, then
    /// mean, standard deviation and largest size of the error.
    pub fn rows(&self) -> Vec<[String; 8]> {
        let had = CHANNELS.iter().zip(&self.tracks).filter(|(_, track)| track.samples > 0.0);
        had.map(|(channel, track)| {
            let mean = track.sum / track.samples;
            let deviation = libm::sqrt((track.squares / track.samples - mean * mean).max(0.0));
            let gap_s = track.gap_s.max(self.end_s - track.last_s);
            [
                channel.name.to_owned(),
                channel.unit.to_owned(),
                format!("{:.1}", track.samples / self.end_s),
                format!("{:.1}", 1e3 * track.late_s.max(0.0) / track.samples),
                format!("{:.0}", 1e3 * gap_s),
                format!("{mean:.4}"),
                format!("{deviation:.4}"),
                format!("{:.4}", track.largest),
            ]
        })
        .collect()
    }

    /// The heads of [`Self::rows`].
    pub const HEADS: [&str; 8] =
        ["reading", "unit", "rate Hz", "late ms", "gap ms", "mean error", "deviation", "largest"];
}

/// What `of` was at `t_s`, between the ticks before and after it.
fn at(past: &VecDeque<Seen>, t_s: f64, of: fn(&Seen) -> f64) -> f64 {
    let after = past.partition_point(|seen| seen.t_s < t_s).clamp(1, past.len().max(2) - 1);
    match (past.get(after - 1), past.get(after)) {
        (Some(before), Some(after)) => {
            let share = ((t_s - before.t_s) / (after.t_s - before.t_s)).clamp(0.0, 1.0);
            of(before) + (of(after) - of(before)) * share
        }
        (only, _) => only.map_or(f64::NAN, of),
    }
}
