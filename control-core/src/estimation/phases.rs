//! The phases: waiting for rest, the filter, fixed gains, and the filter again.
//!
//! ```text
//! Aligning ── rest, and a north ──────────────► Running ── a covariance or state that cannot be,
//!    │                                             ▲        or half a second without inertial samples
//!    └── no rest for 3 s ──► FallenBack ── 3 s ────┘                    │
//!                                ▲──────────────────────────────────────┘
//! ```
use super::alignment::{self, Rest};
use super::complementary;
use super::filter::{Filter, Start};
use super::quaternion::Quaternion;
use super::sources::Source;
use super::strapdown::Nominal;
use super::{Aided, Due, EARLY_US, Estimator, EstimatorState, GAP_S_MAX, PIECE_S, Phase, STEP_US};
use crate::frames::{Body, Vec3};

/// Samples as far apart as this each close a step of the covariance, s.
const ALONE_S: f32 = (STEP_US - EARLY_US) as f32 * 1e-6;
/// Fixed gains have the attitude again after this long, s.
const RECOVERY_S: f32 = 3.0;

impl Estimator {
    /// Waits for rest; starts the filter.
    pub(super) fn align(&self, state: &mut EstimatorState, &Due { ref imu, dt_s, .. }: &Due) {
        let Some(rest) = state.alignment.add(&imu.value, dt_s.min(PIECE_S)) else { return };
        let Some((rotation, heading_rad)) = self.found(state, &rest) else { return };
        if rest.still {
            let start = Start {
                tilt_rad: 0.005,
                heading_rad,
                velocity_m_s: 0.05,
                position_m: 0.1,
                gyro_bias_rad_s: self.config.inertial.gyro_bias_rad_s,
                levelled_by_accelerometer: true,
            };
            state.filter = Filter::new(&self.config, self.at_rest(rotation, rest.rate_rad_s), &start);
            state.phase = Phase::Running;
        } else if rest.impatient {
            state.filter = Filter::new(&self.config, self.at_rest(rotation, Vec3::zero()), &self.thrown());
            state.phase = Phase::FallenBack;
            state.fallen_s = 0.0;
        }
        state.aided = Aided { heading_us: imu.time_us, ..Aided::default() };
        (state.stepped_us, state.settled_us) = (imu.time_us, imu.time_us);
        state.filter.history.push(imu.time_us, &state.filter.nominal);
    }

    /// Still, with the accelerometer's offset as it is known.
    fn at_rest(&self, rotation: Quaternion, gyro_bias_rad_s: Vec3<Body>) -> Nominal {
        let mut nominal = Nominal::at_rest(rotation, gyro_bias_rad_s);
        nominal.accelerometer_bias_m_s2 = self.config.accelerometer_offset_m_s2;
        nominal
    }

    /// The attitude that a window shows, and how well its heading is known, rad; `None` while something better may come.
    fn found(&self, state: &EstimatorState, rest: &Rest) -> Option<(Quaternion, f32)> {
        let force = rest.force_m_s2 - self.config.accelerometer_offset_m_s2;
        if let Some(vision) = &state.pending.vision {
            let sigma_rad = vision.value.attitude_sigma_rad.max(0.01);
            return alignment::attitude_as_seen(force, &vision.value.attitude).map(|q| (q, sigma_rad));
        }
        if let Some(field) = &state.pending.magnetic_ut {
            return alignment::attitude(force, field.value, self.earth).map(|q| (q, 0.1));
        }
        let any = || alignment::attitude(force, Vec3::new(1.0, 0.0, 0.0), [1.0, 0.0]);
        rest.impatient.then(any).flatten().map(|q| (q, 1.0))
    }

    /// The covariance, every 4 ms; with the sample after that, all that was let in before it, so that no sample waits for both.
    pub(super) fn correct(&self, state: &mut EstimatorState, due: &Due) {
        let time_us = due.imu.time_us;
        if due.dt_s > GAP_S_MAX {
            self.fall_back(state);
        }
        if time_us.saturating_sub(state.stepped_us) + EARLY_US >= STEP_US {
            state.stepped_us = time_us;
            let span = state.filter.close_step(time_us);
            if state.phase == Phase::Running {
                state.filter.predict(&self.config, &span, due.rate_rad_s, state.gap_s);
                state.units.doubt(&mut state.filter, span.length_s);
            } else {
                self.follow(state, time_us, span.length_s);
                self.settled(state);
            }
            state.gap_s = 0.0;
            // Of samples as slow as that the next one closes a step as well.
            if due.dt_s < ALONE_S {
                return;
            }
        }
        if state.settled_us < state.stepped_us {
            self.fuse_pending(state, state.stepped_us);
            self.settled(state);
        }
    }

    /// What follows from corrections made.
    fn settled(&self, state: &mut EstimatorState) {
        state.settled_us = state.stepped_us;
        if !state.filter.is_sound() {
            self.fall_back(state);
        }
        state.fill_motion();
        state.fill_slow();
    }

    /// A step with fixed gains; tries the filter again when they have had time.
    #[cold]
    #[inline(never)]
    pub(super) fn follow(&self, state: &mut EstimatorState, time_us: u64, span_s: f32) {
        complementary::follow_gravity(&mut state.filter, span_s);
        let pending = core::mem::take(&mut state.pending);
        let mut since_s = |source: Source, sample_us: u64| {
            let watch = &mut state.watches[source as usize];
            let since_us = sample_us.saturating_sub(watch.status.taken_us);
            watch.take(sample_us);
            since_us as f32 * 1e-6
        };
        if let Some(field) = pending.magnetic_ut {
            let since_s = since_s(Source::Magnetometer, field.time_us);
            let measured = state.filter.attitude.to_ned(field.value);
            complementary::follow_field(&mut state.filter, measured, self.earth, since_s);
            state.aided.heading_us = time_us;
        }
        let second = pending.baro_second_altitude_m.map(|altitude| (Source::BarometerSecond, altitude));
        let first = pending.baro_altitude_m.map(|altitude| (Source::Barometer, altitude));
        if let Some((source, altitude)) = first.or(second) {
            let since_s = since_s(source, altitude.time_us);
            if state.barometer_heard.replace(source) != Some(source) {
                state.filter.barometer_offset_m = altitude.value + state.filter.nominal.position_m.z;
            }
            complementary::follow_barometer(&mut state.filter, altitude.value, since_s);
            state.aided.altitude_us = time_us;
        }
        state.fallen_s += span_s;
        if state.fallen_s > RECOVERY_S {
            let (nominal, offset_m) = (state.filter.nominal, state.filter.barometer_offset_m);
            state.filter = Filter::new(&self.config, nominal, &self.thrown());
            state.filter.barometer_offset_m = offset_m;
            state.filter.history.push(time_us, &state.filter.nominal);
            state.phase = Phase::Running;
            self.fuse_pending(state, time_us);
        }
    }

    /// Gives the filter up for fixed gains, from the last estimate that was sound.
    #[cold]
    #[inline(never)]
    pub(super) fn fall_back(&self, state: &mut EstimatorState) {
        let last = &state.estimate;
        let mut nominal = self.at_rest(Quaternion::of(&last.attitude), last.gyro_bias_rad_s);
        (nominal.velocity_m_s, nominal.position_m) = (last.velocity_m_s, last.position_m);
        let offset_m = state.filter.barometer_offset_m;
        state.filter = Filter::new(&self.config, nominal, &self.thrown());
        if offset_m.abs() < 1e4 {
            state.filter.barometer_offset_m = offset_m;
        }
        state.phase = Phase::FallenBack;
        (state.placed, state.levelled) = (false, false);
        state.fallen_s = 0.0;
        state.fallbacks = state.fallbacks.saturating_add(1);
    }
}
