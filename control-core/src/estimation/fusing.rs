//! What is done with each sample that was let in: compared with its time, gated, fused; and what is done when filter and source disagree for good.
//!
//! A source that is refused alone for [`RESET_US`], and keeps to what it says, has no other to contradict it: what it measures is set anew
//! from it. Of satellites, flow and dead reckoning, `rivals.rs` says which yields. Vision outranks the magnetometer while it lives, as its frame may not be north's.
use super::covariance::{BARO_OFFSET, GROUND, Observation, POSITION, VELOCITY};
use super::filter::Lasting;
use super::history::Past;
use super::observe;
use super::rivals::Blame;
use super::sources::{Source, SourceFault};
use super::{Estimator, EstimatorState};
use crate::frames::{Ned, Vec3};
use crate::measurement::{Flow, Gnss, Measurements, Stamped, Vision};

/// Disagreement with the only source of a quantity after which the filter yields, µs.
const RESET_US: u64 = 2_000_000;
/// How far the tilt may be off then, rad: too far to fly on.
const ASTRAY_RAD: f32 = 0.1;
/// The same where flow that drifts has led it, rad.
const LED_RAD: f32 = 0.03;
/// Time of disagreement of position while another source vouches for the velocity, µs.
const POSITION_RESET_US: u64 = 10_000_000;
/// Time of disagreement of heading, which disturbances of the magnetic field last longer than, µs.
const HEADING_RESET_US: u64 = 5_000_000;
/// Time after which an absent source of velocity is made up for, µs.
const UNAIDED_US: u64 = 1_000_000;
/// Steps between two assumptions made up: 80 ms.
const UNAIDED_STEPS: u8 = 20;
/// Horizontal acceleration that an unaided flight may have, over those steps, m/s².
const ROAMING_M_S2: f32 = 3.0;
/// Velocity and position errors beyond which an unaided filter does not count, m/s and m.
const ROAMING_M_S: f32 = 10.0;
const ROAMING_M: f32 = 1000.0;
/// Samples refused in a row after which a source must keep to what it says.
const DOUBTED: u32 = 5;
/// In how many samples the heading follows a compass, and the position a receiver, that are off for long: ten seconds, in which noise
/// averages out, and half a minute, in which the velocity is summed as well as multipath lasts.
const HEADING_SAMPLES: f32 = 500.0;
const PLACE_SAMPLES: f32 = 300.0;
/// Error of a range proportional to it.
const RANGE_SHARE: f32 = 0.02;

/// What became of the groups of one sample.
struct Verdict {
    ratio: f32,
    taken: bool,
    refused: bool,
    /// Whether its source is refused whatever it says.
    doubted: bool,
}

/// A measured position.
struct Position {
    measured_m: Vec3<Ned>,
    /// Standard deviations, horizontal and vertical.
    sigma_m: (f32, f32),
    place: [Observation; 2],
    level: [Observation; 1],
    /// What it is off by for long, horizontal; half as much again vertical.
    lasting_m: Lasting,
    /// Whether the source keeps to what it says.
    steady: bool,
}

impl Position {
    fn new(past: &Past, measured_m: Vec3<Ned>, sigma_m: (f32, f32), lasting_m: Lasting) -> Self {
        let place = observe::horizontal(past, measured_m, sigma_m.0);
        let level = observe::vertical(past, measured_m, sigma_m.1);
        Self { measured_m, sigma_m, place, level, lasting_m, steady: false }
    }

    fn observations(&self) -> impl Iterator<Item = &Observation> {
        self.place.iter().chain(&self.level)
    }
}

impl EstimatorState {
    fn past(&self, time_us: u64, now_us: u64) -> Option<Past> {
        self.filter.history.at(time_us, now_us)
    }

    /// Records what became of a sample.
    fn record(&mut self, source: Source, time_us: u64, verdict: Option<&Verdict>) {
        let watch = &mut self.watches[source as usize];
        let Some(verdict) = verdict else { return watch.refuse(SourceFault::TooLate) };
        watch.status.ratio = verdict.ratio;
        if verdict.taken {
            watch.take(time_us);
        }
        if verdict.refused {
            watch.refuse(SourceFault::Disagrees);
        }
    }

    /// Whether what was last observed at `time_us` has been without a source for so long that the filter yields.
    fn yields(&mut self, time_us: u64, now_us: u64, patience_us: u64) -> bool {
        let yields = now_us.saturating_sub(time_us) > patience_us;
        self.resets = self.resets.saturating_add(u32::from(yields));
        yields
    }
}

impl Verdict {
    const NONE: Self = Self { ratio: 0.0, taken: false, refused: false, doubted: false };
}

impl Estimator {
    /// Fuses what was let in, with the step of the covariance at `now_us` of the inertial unit: one pose or fix, or all of the small ones.
    ///
    /// Each is compared with its own time, so that one that waits its turn loses nothing; the steps are many enough for all.
    pub(super) fn fuse_pending(&self, state: &mut EstimatorState, now_us: u64) {
        let Measurements { vision, gnss, baro_altitude_m, baro_second_altitude_m, magnetic_ut, range_m, flow, .. } =
            state.pending;
        let baro = baro_altitude_m.is_some() || baro_second_altitude_m.is_some();
        let small = baro || magnetic_ut.is_some() || range_m.is_some() || flow.is_some();
        let large = vision.is_some() || gnss.is_some();
        state.large_last = large && !(small && state.large_last);
        if !state.large_last {
            state.pending = Measurements { gnss, vision, ..Measurements::default() };
            baro_altitude_m.inspect(|altitude| self.fuse_barometer(state, Source::Barometer, altitude, now_us));
            baro_second_altitude_m
                .inspect(|altitude| self.fuse_barometer(state, Source::BarometerSecond, altitude, now_us));
            range_m.inspect(|range| self.fuse_range(state, range, now_us));
            flow.inspect(|flow| self.fuse_flow(state, flow, now_us));
            magnetic_ut.inspect(|field| self.fuse_field(state, field, now_us));
        } else if let Some(vision) = &vision {
            state.pending.vision = None;
            self.fuse_vision(state, vision, now_us);
        } else if let Some(gnss) = &gnss {
            state.pending.gnss = None;
            self.fuse_gnss(state, gnss, now_us);
        }
        state.unaided_steps = (state.unaided_steps + 1) % UNAIDED_STEPS;
        if state.unaided_steps == 0 {
            state.hold_together(now_us);
        }
    }

    /// Fuses one group; whether it was taken.
    fn group(
        &self,
        state: &mut EstimatorState,
        verdict: &mut Verdict,
        observations: &[Observation],
        lasting: Lasting,
    ) -> bool {
        if verdict.doubted {
            verdict.refused = true;
            return false;
        }
        let fusion = state.filter.fuse(observations, self.config.gate_sigma, lasting);
        verdict.ratio = verdict.ratio.max(fusion.ratio);
        verdict.taken |= fusion.taken;
        verdict.refused |= !fusion.taken;
        fusion.taken
    }

    /// Whether `source` keeps to what it says. One that does not, and has been refused again and again, is refused whatever it says: of
    /// garbage, too, some is near enough.
    fn is_steady<'a>(
        &self,
        state: &mut EstimatorState,
        source: Source,
        verdict: &mut Verdict,
        observations: impl IntoIterator<Item = &'a Observation>,
    ) -> bool {
        let watch = &mut state.watches[source as usize];
        let steady = watch.is_steady(observations, self.config.gate_sigma);
        verdict.doubted = !steady && watch.status.refused_in_a_row >= DOUBTED;
        steady
    }

    fn fuse_gnss(&self, state: &mut EstimatorState, gnss: &Stamped<Gnss>, now_us: u64) {
        let Some(past) = state.past(gnss.time_us, now_us) else {
            return state.record(Source::Gnss, gnss.time_us, None);
        };
        let (aiding, fix, mut verdict) = (&self.config.aiding, &gnss.value, Verdict::NONE);
        let sigma_m = (fix.horizontal_m.max(aiding.gnss_horizontal_m), fix.vertical_m.max(aiding.gnss_vertical_m));
        let mut fixed = Position::new(
            &past,
            fix.position_m,
            sigma_m,
            Lasting { sigma: aiding.gnss_bias_m, samples: Some(PLACE_SAMPLES) },
        );
        let speed_m_s = fix.speed_m_s.max(aiding.gnss_m_s);
        let moved = observe::velocity(&past, fix.velocity_m_s, speed_m_s);
        fixed.steady = self.is_steady(state, Source::Gnss, &mut verdict, fixed.observations().chain(&moved));
        let led = state.watches[Source::Flow as usize].is_alive(Source::Flow, now_us);
        let broken = state.filter.is_broken(self.config.accelerometer_offset_m_s2);
        let blame = state.rivals.hear_fix(&moved, past.velocity_m_s, (led, fixed.steady, broken), now_us);
        // Of two units the one at fault is known by the other.
        let (_, spare) = state.units.sources();
        if let Blame::Accelerometer(m_s2) = blame
            && !state.watches[spare as usize].is_heard(spare, now_us)
        {
            state.filter.doubt_bias(1, m_s2 * m_s2);
        }
        if blame == Blame::Flow {
            state.filter.launch(&past, fix.velocity_m_s, speed_m_s, LED_RAD);
            state.resets = state.resets.saturating_add(1);
            state.aided.velocity_us = now_us;
        } else if self.group(state, &mut verdict, &moved, Lasting::NOTHING) {
            state.aided.velocity_us = now_us;
        } else if fixed.steady && state.yields(state.aided.velocity_us, now_us, RESET_US) {
            state.filter.launch(&past, fix.velocity_m_s, speed_m_s, ASTRAY_RAD);
            state.aided.velocity_us = now_us;
        }
        self.fuse_position(state, &past, &fixed, now_us, &mut verdict);
        state.record(Source::Gnss, gnss.time_us, Some(&verdict));
    }

    fn fuse_vision(&self, state: &mut EstimatorState, vision: &Stamped<Vision>, now_us: u64) {
        let Some(past) = state.past(vision.time_us, now_us) else {
            return state.record(Source::Vision, vision.time_us, None);
        };
        let (aiding, pose, mut verdict) = (&self.config.aiding, &vision.value, Verdict::NONE);
        let sigma_rad = pose.attitude_sigma_rad.max(aiding.vision_rad);
        let attitude = observe::attitude(&past, &pose.attitude, sigma_rad);
        let sigma_m = pose.position_sigma_m.max(aiding.vision_m);
        let mut seen = Position::new(&past, pose.position_m, (sigma_m, sigma_m), Lasting::NOTHING);
        seen.steady = self.is_steady(state, Source::Vision, &mut verdict, seen.observations().chain(&attitude));
        // Gravity tells the tilt as well as the markers do.
        let askew = Lasting { sigma: aiding.vision_askew_rad, samples: None };
        if self.group(state, &mut verdict, &attitude, askew) {
            (state.aided.heading_us, state.aided.seen_us) = (now_us, now_us);
        } else if seen.steady && state.yields(state.aided.seen_us, now_us, RESET_US) {
            state.filter.head(observe::heading_apart(&past, &pose.attitude), sigma_rad);
            (state.aided.heading_us, state.aided.seen_us) = (now_us, now_us);
        }
        if self.fuse_position(state, &past, &seen, now_us, &mut verdict) {
            state.aided.velocity_us = now_us;
        }
        state.record(Source::Vision, vision.time_us, Some(&verdict));
    }

    /// Fuses a position; whether the horizontal part was taken.
    fn fuse_position(
        &self,
        state: &mut EstimatorState,
        past: &Past,
        position: &Position,
        now_us: u64,
        verdict: &mut Verdict,
    ) -> bool {
        let &Position { measured_m, sigma_m: (horizontal_m, vertical_m), ref place, ref level, lasting_m, steady } =
            position;
        // Dead reckoning on a velocity that is known goes far.
        let moving_known = now_us.saturating_sub(state.aided.velocity_us) < UNAIDED_US;
        let patience_us = if moving_known { POSITION_RESET_US } else { RESET_US };
        let placed = state.placed && self.group(state, verdict, place, lasting_m);
        if placed {
            state.aided.position_us = now_us;
        } else if !state.placed || steady && state.yields(state.aided.position_us, now_us, patience_us) {
            state.filter.place(past, measured_m, horizontal_m);
            (state.placed, verdict.taken, state.aided.position_us) = (true, true, now_us);
        }
        let levelled =
            state.levelled && self.group(state, verdict, level, Lasting { sigma: 1.5 * lasting_m.sigma, ..lasting_m });
        if levelled {
            state.aided.altitude_us = now_us;
        } else if !state.levelled || steady && state.yields(state.aided.altitude_us, now_us, patience_us) {
            state.filter.level_absolutely(past, measured_m, vertical_m, &self.config);
            (state.levelled, verdict.taken, state.aided.altitude_us) = (true, true, now_us);
        }
        placed
    }

    fn fuse_barometer(&self, state: &mut EstimatorState, source: Source, altitude: &Stamped<f32>, now_us: u64) {
        let Some(past) = state.past(altitude.time_us, now_us) else {
            return state.record(source, altitude.time_us, None);
        };
        let (sigma_m, mut verdict) = (self.config.aiding.barometer_m, Verdict::NONE);
        if state.barometer_heard != Some(source) {
            if state.levelled || state.barometer_heard.is_some() {
                state.filter.tare_barometer(&past, altitude.value, sigma_m);
            } else {
                state.filter.level_by_barometer(&past, altitude.value, sigma_m);
            }
            state.barometer_heard = Some(source);
        }
        let offset_m = state.filter.barometer_offset_m;
        let observations = observe::barometer(&past, altitude.value, offset_m, sigma_m);
        let steady = self.is_steady(state, source, &mut verdict, &observations);
        if self.group(state, &mut verdict, &observations, Lasting::NOTHING) {
            state.aided.altitude_us = now_us;
        } else if steady && state.yields(state.aided.altitude_us, now_us, RESET_US) {
            state.filter.level_by_barometer(&past, altitude.value, sigma_m);
            state.aided.altitude_us = now_us;
        }
        state.record(source, altitude.time_us, Some(&verdict));
    }

    fn fuse_range(&self, state: &mut EstimatorState, range: &Stamped<f32>, now_us: u64) {
        let Some(past) = state.past(range.time_us, now_us) else {
            return state.record(Source::Range, range.time_us, None);
        };
        let height_m = range.value * past.rotation.attitude().rows[2][2];
        if height_m < 0.5 * range.value {
            // Tilted beyond 60 degrees it looks at the walls.
            return;
        }
        let (sigma_m, mut verdict) = (self.config.aiding.range_m + RANGE_SHARE * range.value, Verdict::NONE);
        let ground_m = if let Some(ground_m) = state.filter.ground_m {
            ground_m
        } else {
            state.filter.find_ground(&past, height_m, sigma_m);
            past.position_m.z + height_m
        };
        let observations = observe::range(&past, range.value, ground_m, sigma_m);
        let steady = self.is_steady(state, Source::Range, &mut verdict, &observations);
        if self.group(state, &mut verdict, &observations, Lasting::NOTHING) {
            (state.ranged_us, state.aided.altitude_us) = (now_us, now_us);
        } else if steady && state.yields(state.ranged_us, now_us, RESET_US) {
            // A step in the ground, as far as the others know the altitude.
            state.filter.find_ground(&past, height_m, sigma_m);
            state.ranged_us = now_us;
        }
        state.record(Source::Range, range.time_us, Some(&verdict));
    }

    fn fuse_flow(&self, state: &mut EstimatorState, flow: &Stamped<Flow>, now_us: u64) {
        let Some(past) = state.past(flow.time_us, now_us) else {
            return state.record(Source::Flow, flow.time_us, None);
        };
        let Some(ground_m) = state.filter.ground_m else { return };
        let (height_m, mut verdict) = (ground_m - past.position_m.z, Verdict::NONE);
        let Some(observations) = observe::flow(&past, &flow.value, height_m, self.config.aiding.flow_rad_s) else {
            return;
        };
        self.is_steady(state, Source::Flow, &mut verdict, &observations);
        state.rivals.hear_image(&observations, past.velocity_m_s, now_us);
        if state.rivals.is_out(now_us) {
            return state.watches[Source::Flow as usize].refuse(SourceFault::Disagrees);
        }
        if self.group(state, &mut verdict, &observations, Lasting::NOTHING) {
            state.aided.velocity_us = now_us;
        } else if state.yields(state.aided.velocity_us, now_us, RESET_US) {
            state.filter.launch(&past, past.velocity_m_s, ROAMING_M_S, ASTRAY_RAD);
            state.aided.velocity_us = now_us;
        }
        state.record(Source::Flow, flow.time_us, Some(&verdict));
    }

    fn fuse_field(&self, state: &mut EstimatorState, field: &Stamped<Vec3<crate::frames::Body>>, now_us: u64) {
        let seen = state.watches[Source::Vision as usize].is_alive(Source::Vision, now_us);
        let Some(past) = state.past(field.time_us, now_us) else {
            return state.record(Source::Magnetometer, field.time_us, None);
        };
        let measured_ut = past.rotation.attitude().to_ned(field.value);
        let observations = observe::heading(measured_ut, self.earth, self.steep, self.config.aiding.magnetic_ut);
        let (Some(observations), false) = (observations, seen) else { return };
        let mut verdict = Verdict::NONE;
        let steady = self.is_steady(state, Source::Magnetometer, &mut verdict, &observations);
        let iron = Lasting { sigma: self.iron_rad, samples: Some(HEADING_SAMPLES) };
        if self.group(state, &mut verdict, &observations, iron) {
            state.aided.heading_us = now_us;
        } else if steady && state.yields(state.aided.heading_us, now_us, HEADING_RESET_US) {
            let [Observation { innovation, variance, .. }] = observations;
            state.filter.head(innovation, crate::Scalar::sqrt(variance));
            state.aided.heading_us = now_us;
        }
        state.record(Source::Magnetometer, field.time_us, Some(&verdict));
    }
}

impl EstimatorState {
    /// Keeps an unaided filter from losing its tilt and from counting beyond sense: gravity, and bounds.
    fn hold_together(&mut self, now_us: u64) {
        let gate = f32::MAX;
        let filter = &mut self.filter;
        if now_us.saturating_sub(self.aided.velocity_us) > UNAIDED_US {
            let f = filter.force_m_s2;
            let weight = f.norm_squared() / (crate::GRAVITY_M_S2 * crate::GRAVITY_M_S2);
            if (0.8..1.2).contains(&weight) {
                filter.fuse(&observe::gravity(&filter.attitude, f, ROAMING_M_S2), gate, Lasting::NOTHING);
            }
        }
        let v = observe::components(filter.nominal.velocity_m_s);
        for (axis, v) in v.into_iter().enumerate() {
            if filter.covariance.variance(VELOCITY + axis) > ROAMING_M_S * ROAMING_M_S {
                filter.fuse(&observe::standstill(axis, v, ROAMING_M_S), gate, Lasting::NOTHING);
            }
            if filter.covariance.variance(POSITION + axis) > ROAMING_M * ROAMING_M {
                filter.covariance.reset(POSITION + axis, 0.25 * ROAMING_M * ROAMING_M);
            }
        }
        for state in [BARO_OFFSET, GROUND] {
            if filter.covariance.variance(state) > ROAMING_M * ROAMING_M {
                filter.covariance.reset(state, 0.25 * ROAMING_M * ROAMING_M);
            }
        }
    }
}
