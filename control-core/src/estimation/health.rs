//! How good the estimate is: standard deviations, and what may be flown on.
//!
//! | fact      | needs                                                                                           |
//! |-----------|-------------------------------------------------------------------------------------------------|
//! | rates     | an inertial sample that was believed, within 15 ms                                              |
//! | tilt      | rates; aligned; σ within its limit                                                              |
//! | heading   | tilt; σ within its limit                                                                        |
//! | altitude  | tilt; a source of altitude within the dead-reckoning time; σ of altitude and climb within limits |
//! | velocity  | heading; a source of horizontal motion within that time; σ within its limit                     |
//! | position  | velocity; σ within its limit                                                                    |
//!
//! With fixed gains only tilt, heading and altitude can be flown on, as long as their sources are alive.
use super::covariance::{ATTITUDE, POSITION, VELOCITY};
use super::{Estimator, EstimatorState, Phase};
use crate::Scalar;
use crate::estimate::{Health, Sigma};
use crate::frames::{Body, Vec3};

impl EstimatorState {
    /// What changes with every inertial sample.
    pub(super) fn fill_fast(&mut self, time_us: u64, specific_force_m_s2: Vec3<Body>, rate_rad_s: Vec3<Body>) {
        self.estimate.time_us = time_us;
        self.estimate.rate_rad_s = rate_rad_s;
        self.estimate.specific_force_m_s2 = specific_force_m_s2;
        self.fill_motion();
    }

    /// What dead reckoning moves, and what corrects it.
    pub(super) fn fill_motion(&mut self) {
        let (estimate, filter) = (&mut self.estimate, &self.filter);
        estimate.position_m = filter.nominal.position_now_m();
        estimate.velocity_m_s = filter.nominal.velocity_m_s;
        estimate.attitude = filter.attitude;
    }

    /// What changes with every step of the covariance.
    pub(super) fn fill_slow(&mut self) {
        let p = &self.filter.covariance;
        let root = |a: usize, b: usize| Scalar::sqrt(p.variance(a).max(p.variance(b)).max(0.0));
        self.estimate.sigma = Sigma {
            tilt_rad: root(ATTITUDE, ATTITUDE + 1),
            heading_rad: root(ATTITUDE + 2, ATTITUDE + 2),
            horizontal_m_s: root(VELOCITY, VELOCITY + 1),
            vertical_m_s: root(VELOCITY + 2, VELOCITY + 2),
            horizontal_m: root(POSITION, POSITION + 1),
            altitude_m: root(POSITION + 2, POSITION + 2),
        };
        self.estimate.gyro_bias_rad_s = self.filter.nominal.gyro_bias_rad_s;
        self.estimate.accelerometer_bias_m_s2 = self.filter.nominal.accelerometer_bias_m_s2;
    }
}

impl Estimator {
    /// Fills in what may be flown on.
    pub(super) fn judge(&self, state: &mut EstimatorState, now_us: u64) {
        let (limits, sigma, aided) = (&self.config.limits, &state.estimate.sigma, &state.aided);
        let recent = |time_us: u64| time_us > 0 && now_us.saturating_sub(time_us) <= self.reckoning_us;
        let unit = state.inertial();
        let rates = state.watches[unit as usize].is_alive(unit, now_us);
        let mut health = Health { rates, ..Health::default() };
        match state.phase {
            Phase::Aligning => {}
            Phase::Running => {
                health.tilt = rates && sigma.tilt_rad <= limits.tilt_rad;
                health.heading = health.tilt && sigma.heading_rad <= limits.heading_rad;
                health.altitude = health.tilt
                    && recent(aided.altitude_us)
                    && sigma.altitude_m <= limits.altitude_m
                    && sigma.vertical_m_s <= limits.velocity_m_s;
                health.velocity =
                    health.heading && recent(aided.velocity_us) && sigma.horizontal_m_s <= limits.velocity_m_s;
                health.position = health.velocity && sigma.horizontal_m <= limits.position_m;
            }
            Phase::FallenBack => {
                health.tilt = rates;
                health.heading = rates && recent(aided.heading_us);
                health.altitude = rates && recent(aided.altitude_us);
            }
        }
        state.estimate.health = health;
    }
}
