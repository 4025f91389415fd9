//! Where the estimator begins: switched on, in the air with a motion that is known, or with one that is not.
use super::alignment::Alignment;
use super::filter::{Filter, Start, UNKNOWN_M, UNKNOWN_M_S};
use super::gyro::GyroState;
use super::quaternion::Quaternion;
use super::rivals::Rivals;
use super::sources::{SOURCES, Source, Watch};
use super::strapdown::Nominal;
use super::units::Units;
use super::{Aided, Estimator, EstimatorState, Phase, Tape};
use crate::GRAVITY_M_S2;
use crate::estimate::{Estimate, Health, Sigma};
use crate::frames::{Attitude, Vec3};
use crate::measurement::Measurements;

impl Estimator {
    /// The state of a board that was just switched on.
    #[inline(never)]
    pub fn state(&self) -> EstimatorState {
        let nominal = Nominal::at_rest(Quaternion::IDENTITY, Vec3::zero());
        EstimatorState {
            phase: Phase::Aligning,
            filter: Filter::new(&self.config, nominal, &self.thrown()),
            alignment: Alignment::NEW,
            watches: [Watch::UNHEARD; SOURCES],
            pending: Measurements::default(),
            motor_load: 0.0,
            gyro: GyroState::NEW,
            aided: Aided::default(),
            placed: false,
            levelled: false,
            barometer_heard: None,
            units: Units::NEW,
            rivals: Rivals::NEW,
            time_us: 0,
            stepped_us: 0,
            settled_us: 0,
            gap_s: 0.0,
            due: None,
            fallen_s: 0.0,
            ranged_us: 0,
            large_last: false,
            unaided_steps: 0,
            resets: 0,
            fallbacks: 0,
            estimate: Estimate {
                time_us: 0,
                position_m: Vec3::zero(),
                velocity_m_s: Vec3::zero(),
                attitude: Attitude::level(),
                rate_rad_s: Vec3::zero(),
                specific_force_m_s2: Vec3::new(0.0, 0.0, -GRAVITY_M_S2),
                gyro_bias_rad_s: Vec3::zero(),
                accelerometer_bias_m_s2: Vec3::zero(),
                sigma: Sigma::default(),
                health: Health::default(),
            },
        }
    }

    /// The state of a machine whose motion is known: one that a simulation starts in the air, or a board that was interrupted.
    ///
    /// - `known`: with standard deviations that are meant.
    #[inline(never)]
    pub fn resume(&self, known: &Estimate) -> EstimatorState {
        let sigma = &known.sigma;
        let start = Start {
            tilt_rad: sigma.tilt_rad.max(1e-4),
            heading_rad: sigma.heading_rad.max(1e-4),
            velocity_m_s: sigma.horizontal_m_s.max(sigma.vertical_m_s).max(1e-3),
            position_m: sigma.horizontal_m.max(sigma.altitude_m).max(1e-3),
            gyro_bias_rad_s: self.config.inertial.gyro_bias_rad_s,
            levelled_by_accelerometer: false,
        };
        let mut nominal = Nominal::at_rest(Quaternion::of(&known.attitude), known.gyro_bias_rad_s);
        nominal.accelerometer_bias_m_s2 = known.accelerometer_bias_m_s2;
        (nominal.velocity_m_s, nominal.position_m) = (known.velocity_m_s, known.position_m);
        let mut state = self.state();
        state.filter = Filter::new(&self.config, nominal, &start);
        state.filter.history.push(known.time_us, &state.filter.nominal);
        state.phase = Phase::Running;
        (state.time_us, state.stepped_us, state.settled_us) = (known.time_us, known.time_us, known.time_us);
        state.aided.heading_us = known.time_us;
        state.estimate = *known;
        state
    }

    /// The state of a board that was interrupted in the air, of what was kept: as if its sources had spoken just before, and its
    /// inertial unit just now.
    ///
    /// - `state`: that of a board that was just switched on; in its place, for it is large.
    pub(crate) fn go_on(&self, state: &mut EstimatorState, tape: &mut Tape, now_us: u64) {
        state.pass(tape);
        let EstimatorState { estimate: known, placed, levelled, barometer_heard, .. } = *state;
        let offset_m = state.filter.barometer_offset_m;
        *state = self.resume(&known);
        state.filter.barometer_offset_m = offset_m;
        (state.placed, state.levelled, state.barometer_heard) = (placed, levelled, barometer_heard);
        let heard = |healthy: bool| if healthy { known.time_us } else { 0 };
        state.aided = Aided {
            velocity_us: heard(known.health.velocity),
            position_us: heard(known.health.position),
            altitude_us: heard(known.health.altitude),
            heading_us: heard(known.health.heading),
            seen_us: 0,
        };
        state.watches[Source::Inertial as usize].take(now_us);
    }

    /// How little is known after an interruption in the air.
    pub(super) fn thrown(&self) -> Start {
        Start {
            tilt_rad: 0.1,
            heading_rad: 0.3,
            velocity_m_s: UNKNOWN_M_S,
            position_m: UNKNOWN_M,
            gyro_bias_rad_s: 2.0 * self.config.inertial.gyro_bias_rad_s,
            levelled_by_accelerometer: false,
        }
    }
}
