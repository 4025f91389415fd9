//! What is let in: ranges of what each part can measure, then the clock and the pulse of its source.
use super::gyro::GyroChain;
use super::sources::{Look, Source, SourceFault};
use super::{Estimator, EstimatorState};
use crate::frames::{Attitude, Vec3};
use crate::measurement::{Imu, Measurements, Stamped};

/// Twice 2000 °/s, and twice 16 g: what the largest ranges of inertial units reach.
const RATE_RAD_S_MAX: f32 = 70.0;
const FORCE_M_S2_MAX: f32 = 314.0;
/// How long a unit may be refused before the other stands in, µs.
const STAND_IN_US: u64 = 5_000;
/// Farther than the local frame is flat, m; faster than a receiver of this kind follows, m/s.
const DISTANCE_M_MAX: f32 = 50_000.0;
const SPEED_M_S_MAX: f32 = 150.0;
/// Poorer fixes say nothing to a hover, m and m/s.
const GNSS_M_MAX: f32 = 30.0;
const GNSS_M_S_MAX: f32 = 5.0;
/// Above the service ceiling of the parts, m.
const ALTITUDE_M_MAX: f32 = 12_000.0;
/// What a range finder of this kind reaches, m.
const RANGE_M: core::ops::RangeInclusive<f32> = 0.01..=60.0;
/// Least share of the image that must be tracked, and the most it can move, rad/s.
const QUALITY_MIN: f32 = 0.3;
const FLOW_RAD_S_MAX: f32 = 40.0;
/// Field over the earth's, squared, that is not a magnet nearby.
const FIELD_SHARE_SQUARED: core::ops::RangeInclusive<f32> = 0.25..=4.0;
/// Poorer poses say nothing, m and rad.
const VISION_M_MAX: f32 = 5.0;
const VISION_RAD_MAX: f32 = 0.5;
/// What the squared length of a row, or the product of two, may be off in a rotation.
const CROOKED_MAX: f32 = 0.01;

impl Estimator {
    /// Keeps what else may be believed until the next step of the covariance; of each source the newest.
    pub(super) fn admit(&self, state: &mut EstimatorState, measurements: &Measurements, now_us: u64) {
        let Measurements { magnetic_ut, gnss, range_m, flow, vision, rotor_rad_s, .. } = measurements;
        let mut admits = |source: Source, look: Look| state.watches[source as usize].admits(source, &look, now_us);
        if let Some(s) = gnss {
            let g = &s.value;
            let (p, v) = (g.position_m, g.velocity_m_s);
            let sure = (0.0..=GNSS_M_MAX).contains(&g.horizontal_m)
                && (0.0..=2.0 * GNSS_M_MAX).contains(&g.vertical_m)
                && (0.0..=GNSS_M_S_MAX).contains(&g.speed_m_s);
            let near = p.norm_squared() <= DISTANCE_M_MAX * DISTANCE_M_MAX
                && v.norm_squared() <= SPEED_M_S_MAX * SPEED_M_S_MAX;
            let values = [p.x, p.y, p.z, v.x, v.y, v.z, g.horizontal_m, g.vertical_m, g.speed_m_s];
            if admits(Source::Gnss, Look::of(s.time_us, values, g.fixed && sure && near)) {
                state.pending.gnss = *gnss;
            }
        }
        if let Some(s) = magnetic_ut {
            // Of the bits that were read: those of the field change with the motors, stuck or not.
            let Vec3 { x, y, z, .. } = s.value;
            let value = self.config.compass.correct(s.value, state.motor_load);
            let share = value.norm_squared() / (self.earth_ut * self.earth_ut);
            if admits(Source::Magnetometer, Look::of(s.time_us, [x, y, z], FIELD_SHARE_SQUARED.contains(&share))) {
                state.pending.magnetic_ut = Some(Stamped { value, ..*s });
            }
        }
        if let Some(s) = range_m
            && admits(Source::Range, Look::of(s.time_us, [s.value], RANGE_M.contains(&s.value)))
        {
            state.pending.range_m = *range_m;
        }
        if let Some(s) = flow {
            let [x, y] = s.value.rate_rad_s;
            let tracked = (QUALITY_MIN..=1.0).contains(&s.value.quality) && x.abs().max(y.abs()) <= FLOW_RAD_S_MAX;
            if admits(Source::Flow, Look::of(s.time_us, [x, y, s.value.quality], tracked)) {
                state.pending.flow = *flow;
            }
        }
        if let Some(s) = vision {
            let v = &s.value;
            let [[a, b, c], [d, e, f], [g, h, i]] = v.attitude.rows;
            let p = v.position_m;
            let sure = (0.0..=VISION_M_MAX).contains(&v.position_sigma_m)
                && (0.0..=VISION_RAD_MAX).contains(&v.attitude_sigma_rad);
            let near = p.norm_squared() <= DISTANCE_M_MAX * DISTANCE_M_MAX;
            let values = [p.x, p.y, p.z, a, b, c, d, e, f, g, h, i, v.position_sigma_m, v.attitude_sigma_rad];
            if admits(Source::Vision, Look::of(s.time_us, values, sure && near && is_rotation(&v.attitude))) {
                state.pending.vision = *vision;
            }
        }
        if let Some(s) = rotor_rad_s {
            GyroChain::hear(&mut state.gyro, &s.value, now_us);
        }
        admit_barometers(state, measurements, now_us);
    }
}

/// Keeps the first barometer's altitude, or the second's while the first is silent or refused.
fn admit_barometers(state: &mut EstimatorState, measurements: &Measurements, now_us: u64) {
    let mut admits = |source: Source, sample: &Option<Stamped<f32>>| {
        sample.filter(|s| {
            let look = Look::of(s.time_us, [s.value], s.value.abs() <= ALTITUDE_M_MAX);
            state.watches[source as usize].admits(source, &look, now_us)
        })
    };
    let first = admits(Source::Barometer, &measurements.baro_altitude_m);
    let second = admits(Source::BarometerSecond, &measurements.baro_second_altitude_m);
    let first_lives = state.watches[Source::Barometer as usize].is_alive(Source::Barometer, now_us);
    if first.is_some() {
        state.pending.baro_altitude_m = first;
        state.pending.baro_second_altitude_m = None;
    } else if second.is_some() && !first_lives {
        state.pending.baro_second_altitude_m = second;
    }
}

/// A unit's sample, if it may be believed.
fn admit_unit<'a>(
    state: &mut EstimatorState,
    source: Source,
    imu: Option<&'a Stamped<Imu>>,
    now_us: u64,
) -> Option<&'a Stamped<Imu>> {
    let imu = imu?;
    let Imu { rate_rad_s: w, specific_force_m_s2: f } = imu.value;
    let in_range =
        w.norm_squared() <= RATE_RAD_S_MAX * RATE_RAD_S_MAX && f.norm_squared() <= FORCE_M_S2_MAX * FORCE_M_S2_MAX;
    let look = Look::of_halves(imu.time_us, [w.x, w.y, w.z], [f.x, f.y, f.z], in_range);
    state.watches[source as usize].admits(source, &look, now_us).then_some(imu)
}

impl EstimatorState {
    /// The inertial sample to go on with, if there is one to believe.
    ///
    /// The second unit stands in for the first at once when the two say that it is at fault, or when it has been refused or silent for
    /// [`STAND_IN_US`]; and the other way round.
    pub(super) fn admit_inertial<'a>(
        &mut self,
        measurements: &'a Measurements,
        now_us: u64,
    ) -> Option<&'a Stamped<Imu>> {
        let first = admit_unit(self, Source::Inertial, measurements.imu.as_ref(), now_us);
        let second = admit_unit(self, Source::InertialSecond, measurements.imu_second.as_ref(), now_us);
        let (mut used, mut spare) = if self.units.on_second { (second, first) } else { (first, second) };
        let overdue = now_us.saturating_sub(self.watches[self.inertial() as usize].status.taken_us) > STAND_IN_US;
        let changes = match (used, spare) {
            (Some(a), Some(b)) => self.units.compare(&a.value, &b.value, &mut self.filter, now_us),
            (None, Some(_)) => overdue,
            _ => false,
        };
        if changes {
            self.units.change(&mut self.filter);
            core::mem::swap(&mut used, &mut spare);
        }
        let (source, other) = self.units.sources();
        if let Some(imu) = used {
            self.watches[source as usize].take(imu.time_us);
            self.units.believe(&imu.value);
        }
        if let Some(imu) = spare {
            let watch = &mut self.watches[other as usize];
            if self.units.apart { watch.refuse(SourceFault::Disagrees) } else { watch.take(imu.time_us) }
        }
        used.filter(|imu| imu.time_us > self.time_us)
    }

    /// The inertial unit that is gone by.
    pub(super) fn inertial(&self) -> Source {
        self.units.sources().0
    }
}

/// Whether rows are of unit length, at right angles and right-handed.
pub(super) fn is_rotation(attitude: &Attitude) -> bool {
    let [x, y, z] = attitude.rows.map(|[a, b, c]| Vec3::<crate::frames::Body>::new(a, b, c));
    let off = (x.cross(y) - z).norm_squared();
    let long = (x.norm_squared() - 1.0).abs().max((y.norm_squared() - 1.0).abs());
    // The cross product of unit vectors that are not at right angles is short of the third, which is checked by its difference.
    off <= CROOKED_MAX * CROOKED_MAX && long <= CROOKED_MAX && (z.norm_squared() - 1.0).abs() <= CROOKED_MAX
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compass::Compass;
    use crate::estimation::EstimatorConfig;

    /// What is wrong with a magnetometer after twenty samples while the motors' load changes, which is taken off as `motors_ut` at full load.
    fn fault_of(measured_ut: impl Fn(u64) -> f32, motors_ut: f32) -> Option<SourceFault> {
        let compass = Compass { motors_ut: Vec3::new(motors_ut, 0.0, 0.0), ..Compass::AS_BUILT };
        let config = EstimatorConfig::FLIGHT.calibrated(compass, Vec3::zero());
        let estimator = Estimator::try_new(&config).unwrap();
        let mut state = estimator.state();
        for n in 1..=20 {
            let time_us = 20_000 * n;
            state.bear(load(n));
            let value = Vec3::new(measured_ut(n), 0.0, 43.4);
            let measurements =
                Measurements { magnetic_ut: Some(Stamped { time_us, value }), ..Measurements::default() };
            estimator.admit(&mut state, &measurements, time_us);
        }
        state.watches[Source::Magnetometer as usize].status.fault
    }

    fn load(n: u64) -> f32 {
        0.3 + 0.01 * (n % 7) as f32
    }

    #[test]
    fn a_magnetometer_is_stuck_by_what_it_says_and_not_by_what_the_motors_make_of_it() {
        for motors_ut in [0.0, 8.0] {
            assert_eq!(fault_of(|_| 20.5, motors_ut), Some(SourceFault::Stuck), "{motors_ut} uT");
            assert_eq!(fault_of(|n| 20.5 + 8.0 * load(n), motors_ut), None, "{motors_ut} uT");
        }
    }
}
