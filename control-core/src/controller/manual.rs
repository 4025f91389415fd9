//! Flight without a position: body rates or tilt to fly by hand, with the cascade's own inner loop.
//!
//! ```text
//! rates     e = T (ω_d − ω)      τ = k_p e + k_i ∫e + k_d (ω_d − ω)
//! angles    e = φ_d − φ          τ = k_p e + k_i ∫e − k_d ω
//! heading   e = T (r_d − r),     by the law of ψ
//! lift      a thrust, or the law of z and what it has learnt
//! ```
//!
//! A rate error counts as the angle error that it grows to within T: so the gains, the integrals and what they hold in trim are
//! the same by hand as on a position, and the one hands over to the other without a bump. What x and y have learnt waits.
//!
//! A machine that spins without a rotor has no heading to steer by and is held level, by the tick of the position.
//!
//! Flown by a board and a pilot, so in `f32` only.
use super::cascade::{PSI, Z};
use super::{Controller, Errors, State};
use crate::Demand;
use crate::frames::{Body, Vec3};
use crate::guidance::{Angles, Inner, Outer};
use crate::signals::{Input, Output, Setpoint};

/// What carries the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lift {
    /// This thrust along the body, N.
    Thrust(f32),
    /// What holds an altitude.
    Altitude {
        /// Position down, m.
        down_m: f32,
        /// Velocity down, m/s.
        down_m_s: f32,
    },
}

/// What the controller is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Standing on the ground: all rotors alike, the controller at rest.
    Ground {
        /// Command of every motor, share of full.
        share: f32,
    },
    /// Body rates.
    Rates {
        /// Wanted, rad/s.
        rate_rad_s: Vec3<Body>,
        /// Thrust along the body, N.
        thrust_n: f32,
    },
    /// Tilt.
    Angles {
        /// Roll, rad.
        roll_rad: f32,
        /// Pitch, rad.
        pitch_rad: f32,
        /// Yaw rate, rad/s.
        yaw_rate_rad_s: f32,
        /// What carries it.
        lift: Lift,
    },
    /// A position.
    Position(Setpoint),
}

/// T: the time in which a rate error counts as an angle error, s. It makes the rate gain half as high again.
const RATE_S: f32 = 0.1;

/// A target of the hand, in the terms of both kinds.
struct Hand {
    /// Wanted body rates; roll and pitch are none where an angle is wanted, rad/s.
    rate_rad_s: Vec3<Body>,
    /// Wanted roll and pitch, where they are wanted, rad.
    tilt_rad: Option<[f32; 2]>,
    lift: Lift,
}

impl Hand {
    fn is_finite(&self) -> bool {
        let tilt = self.tilt_rad.is_none_or(|tilt_rad| tilt_rad.into_iter().all(f32::is_finite));
        let lift = match self.lift {
            Lift::Thrust(n) => n.is_finite(),
            Lift::Altitude { down_m, down_m_s } => (down_m + down_m_s).is_finite(),
        };
        tilt && lift && self.rate_rad_s.norm_squared().is_finite()
    }

    /// The input whose errors are those of the lift alone.
    fn input(&self, input: &Input, angles: &Angles<f32>) -> Input {
        let zero = Vec3::zero();
        let (down_m, down_m_s, position_m, velocity_m_s) = match self.lift {
            Lift::Thrust(_) => (0.0, 0.0, zero, zero),
            Lift::Altitude { down_m, down_m_s } => {
                let (position_m, velocity_m_s) = (input.position_m.z, input.velocity_m_s.z);
                (down_m, down_m_s, Vec3::new(0.0, 0.0, position_m), Vec3::new(0.0, 0.0, velocity_m_s))
            }
        };
        let setpoint = Setpoint {
            position_m: Vec3::new(0.0, 0.0, down_m),
            velocity_m_s: Vec3::new(0.0, 0.0, down_m_s),
            acceleration_m_s2: zero,
            yaw_rad: angles.yaw_rad,
            yaw_rate_rad_s: self.rate_rad_s.z,
        };
        Input { position_m, velocity_m_s, setpoint, ..*input }
    }
}

impl Controller {
    /// Runs the whole controller once, towards whatever kind of target is flown.
    ///
    /// - `input`: its setpoint is not looked at; nor are its position and velocity where the target has none.
    /// - Returns the thrusts.
    ///
    /// [`Target::Position`] is [`Self::tick`]. On the ground the state is that of a hover about to begin: nothing is learnt from
    /// what the feet do. A target or a sample that is not plausible changes nothing, as there.
    pub fn tick_toward(&self, state: &mut State, input: &Input, target: &Target) -> Output {
        match *target {
            Target::Ground { share } => {
                *state = self.hover_state();
                Output { thrust_n: self.allocator.alike(share), rejected: false }
            }
            Target::Rates { rate_rad_s, thrust_n } => {
                self.tick_by_hand(state, input, &Hand { rate_rad_s, tilt_rad: None, lift: Lift::Thrust(thrust_n) })
            }
            Target::Angles { roll_rad, pitch_rad, yaw_rate_rad_s, lift } => {
                let rate_rad_s = Vec3::new(0.0, 0.0, yaw_rate_rad_s);
                self.tick_by_hand(state, input, &Hand { rate_rad_s, tilt_rad: Some([roll_rad, pitch_rad]), lift })
            }
            Target::Position(setpoint) => *self.tick(state, &Input { setpoint, ..*input }),
        }
    }

    fn tick_by_hand(&self, state: &mut State, input: &Input, hand: &Hand) -> Output {
        let angles = Angles::of(&input.attitude);
        let input = hand.input(input, &angles);
        let mut errors = Errors::of(&input, &angles);
        errors.yaw_rad = RATE_S * errors.yaw_rate_rad_s;
        let plausible = errors.are_plausible(&input) && hand.is_finite();
        let rate = input.rate_rad_s;
        if plausible && self.rotors.as_ref().is_some_and(|r| r.next_spinning(&state.rotors, rate.z).is_some()) {
            return *self.tick(state, &input);
        }
        state.output.rejected = !plausible;
        if plausible {
            self.advance_by_hand(state, &input, &angles, &errors, hand);
        }
        state.output
    }

    fn advance_by_hand(
        &self,
        state: &mut State,
        input: &Input,
        angles: &Angles<f32>,
        errors: &Errors<f32>,
        hand: &Hand,
    ) {
        let rate = input.rate_rad_s;
        let dt_s = input.dt_s.clamp(self.dt_s_range.0, self.dt_s_range.1);
        let coupling = self.coupling.torque_nm(rate);
        let Some(rotors) = &self.rotors else {
            let wanted = self.wanted_by_hand(state, rate, angles, errors, hand, dt_s);
            state.take(self.allocator.allocate(&wanted.with_torque(coupling)));
            return;
        };
        let coupling = coupling + rotors.gyroscopic_nm(&mut state.rotors, rate);
        let force_m_s2 = input.specific_force_m_s2.z;
        let residual = rotors.observe(&mut state.rotors, &state.output.thrust_n, rate, coupling, force_m_s2, dt_s);
        let wanted = self.wanted_by_hand(state, rate, angles, errors, hand, dt_s);
        let demand = rotors.demand(&wanted.with_torque(coupling), &residual);
        let demand = rotors.less_stuck(&state.rotors, &demand);
        let mut allocation = self.allocator.allocate_weakened(&demand, &state.rotors.shares);
        rotors.tell_stuck(&state.rotors, &mut allocation.thrust_n);
        state.take(allocation);
    }

    /// Thrust and torques, the body's own coupling not yet taken away.
    fn wanted_by_hand(
        &self,
        state: &mut State,
        rate: Vec3<Body>,
        angles: &Angles<f32>,
        errors: &Errors<f32>,
        hand: &Hand,
        dt_s: f32,
    ) -> Demand {
        let (outer, heading_nm) = self.command(state, errors, dt_s);
        let braking = self.braking(state, errors.yaw_rad, -errors.yaw_rate_rad_s, dt_s);
        self.learn_axis(PSI, state, errors, braking, dt_s);
        let thrust_n = match hand.lift {
            Lift::Thrust(n) => n,
            Lift::Altitude { .. } => {
                self.learn_axis(Z, state, errors, false, dt_s);
                let up = Outer { north_m_s2: 0.0, east_m_s2: 0.0, up_n: outer.up_n };
                self.guidance.convert(&up, angles).thrust_n
            }
        };
        let ahead = hand.rate_rad_s - rate;
        let (past, [roll_rad, pitch_rad]) = match hand.tilt_rad {
            Some(tilt_rad) => (rate, tilt_rad),
            None => (-ahead, [angles.roll_rad + RATE_S * ahead.x, angles.pitch_rad + RATE_S * ahead.y]),
        };
        let tilt = Inner { roll_rad, pitch_rad, thrust_n, refused_north_m_s2: 0.0, refused_east_m_s2: 0.0 };
        let [roll_nm, pitch_nm] = self.inner(state, past, angles, &tilt, dt_s);
        state.tilt_setpoint_rad = [roll_rad, pitch_rad];
        state.refused_m_s2 = [0.0; 2];
        let yaw_nm = if braking { self.brake_nm(-errors.yaw_rate_rad_s) } else { heading_nm };
        Demand { thrust_n, roll_nm, pitch_nm, yaw_nm }
    }
}
