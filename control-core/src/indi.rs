//! Incremental inner loop: asks for the change of torque that is missing, not for the torque.
//!
//! ```text
//! τ_c = τ_f + (v − I ω̇_f)        τ_f = low-pass of the torque the rotors make        ω̇_f = slope of the low-passed gyro
//! ```
//!
//! | symbol | what                                                         | unit  |
//! |--------|--------------------------------------------------------------|-------|
//! | v      | torque the attitude loop wants the body to feel              | N m   |
//! | τ_f    | torque it is believed to get: the last command less what was refused, through the rotors' lag and the filter | N m |
//! | I ω̇_f  | torque it does feel                                          | N m   |
//!
//! A weak rotor, a displaced mass or the body's own coupling is a torque that was commanded but not felt; it is asked for again
//! within the filter's delay, whatever caused it. Both τ and ω̇ pass the same filter, so that they are of the same age.
//!
//! Roll and pitch only. Heading has κ for an arm, a tenth of the others': the noise of its ω̇ would work the motors ten times harder
//! than everything else together.
//!
//! Source: S. Sieberling, Q. P. Chu, J. A. Mulder, "Robust flight control using incremental nonlinear dynamic
//! inversion and angular acceleration prediction", 2010; the filtered form of E. J. J. Smeur et al., 2016.
use crate::Scalar;
use crate::config::{ConfigError, positive};
use crate::filter::LowPass;
use crate::frames::{Body, Vec3};

/// What the incremental loop must know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndiConfig {
    /// Time constant of a rotor's thrust, s.
    pub motor_lag_s: f32,
    /// Corner of the low-pass on gyro and torque, Hz.
    pub filter_hz: f32,
}

impl IndiConfig {
    /// A rotor of 20 ms; a corner between the noise it lets into the motors and the time a weak rotor has to push.
    pub const NOMINAL: Self = Self { motor_lag_s: 0.02, filter_hz: 15.0 };
}

/// The loop, configured.
#[derive(Clone, Debug)]
pub(crate) struct Indi<S> {
    /// About roll and pitch.
    inertia_kg_m2: [S; 2],
    motor_rad_s: S,
    filter_rad_s: S,
}

/// What the loop remembers of one axis.
#[derive(Clone, Copy, Debug)]
struct AxisMemory<S> {
    command_nm: S,
    rate_rad_s: S,
    made_nm: S,
    felt_nm: S,
}

/// What the loop remembers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IndiState<S>([AxisMemory<S>; 2]);

impl<S: Scalar> IndiState<S> {
    pub(crate) fn at_rest() -> Self {
        Self([AxisMemory { command_nm: S::ZERO, rate_rad_s: S::ZERO, made_nm: S::ZERO, felt_nm: S::ZERO }; 2])
    }
}

impl<S: Scalar> Indi<S> {
    pub(crate) fn try_new(config: IndiConfig, inertia_kg_m2: [f32; 3]) -> Result<Self, ConfigError> {
        positive("indi", "motor_lag_s", config.motor_lag_s)?;
        positive("indi", "filter_hz", config.filter_hz)?;
        let [ix, iy, _] = inertia_kg_m2.map(S::from_f32);
        Ok(Self {
            inertia_kg_m2: [ix, iy],
            motor_rad_s: S::from_f32(1.0 / config.motor_lag_s),
            filter_rad_s: S::from_f32(core::f32::consts::TAU * config.filter_hz),
        })
    }

    /// The torques to command so that the body feels `wanted_nm` about roll and pitch; heading passes.
    ///
    /// - `refused_nm`: what the allocation refused of the last roll and pitch commands.
    pub(crate) fn step(
        &self,
        state: &mut IndiState<S>,
        wanted_nm: Vec3<Body, S>,
        refused_nm: [S; 2],
        rate: Vec3<Body, S>,
        dt_s: S,
    ) -> Vec3<Body, S> {
        let motor = LowPass::new(self.motor_rad_s, dt_s);
        let filter = LowPass::new(self.filter_rad_s, dt_s);
        let step = |memory: &mut AxisMemory<S>, wanted, refused, rate, inertia: S| {
            motor.step(&mut memory.made_nm, memory.command_nm - refused);
            filter.step(&mut memory.felt_nm, memory.made_nm);
            let acceleration = filter.step(&mut memory.rate_rad_s, rate);
            memory.command_nm = memory.felt_nm + wanted - inertia * acceleration;
            memory.command_nm
        };
        let [roll, pitch] = &mut state.0;
        let [ix, iy] = self.inertia_kg_m2;
        Vec3::new(
            step(roll, wanted_nm.x, refused_nm[0], rate.x, ix),
            step(pitch, wanted_nm.y, refused_nm[1], rate.y, iy),
            wanted_nm.z,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rigid axis behind a lagging motor that makes `share` of its torque, with a constant push; returns the acceleration error.
    fn settles_to(share: f32, push_nm: f32, motor_lag_s: f32) -> f32 {
        let (inertia, dt_s, wanted_nm) = (0.028_f32, 0.002, 0.05);
        let config = IndiConfig { motor_lag_s: 0.02, filter_hz: 15.0 };
        let indi = Indi::try_new(config, [inertia; 3]).expect("valid");
        let mut state = IndiState::at_rest();
        let (mut made, mut rate) = (0.0_f32, 0.0_f32);
        let wanted = Vec3::new(wanted_nm, 0.0, 0.0);
        let mut felt = 0.0;
        for _ in 0..1000 {
            let command = indi.step(&mut state, wanted, [0.0; 2], Vec3::new(rate, 0.0, 0.0), dt_s);
            made += (command.x - made) * dt_s / motor_lag_s;
            felt = share * made + push_nm;
            rate += felt / inertia * dt_s;
        }
        (felt - wanted_nm).abs()
    }

    #[test]
    fn the_body_feels_what_is_wanted_whatever_the_rotors_lose() {
        for (why, share, push_nm, lag_s) in [
            ("healthy", 1.0, 0.0, 0.02),
            ("weak", 0.6, 0.0, 0.02),
            ("pushed", 1.0, 0.1, 0.02),
            ("weak, pushed and slower than believed", 0.6, 0.1, 0.05),
        ] {
            let error = settles_to(share, push_nm, lag_s);
            assert!(error < 1e-3, "{why}: {error}");
        }
    }
}
