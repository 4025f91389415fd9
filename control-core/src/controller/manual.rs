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
use super::cascade::PSI;
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
    /// No torque, and the thrust that was: nobody knows how it turns.
    Coast,
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

impl Target {
    /// What a tick of the position is given as its setpoint.
    pub fn setpoint(&self) -> Setpoint {
        match *self {
            Self::Position(setpoint) => setpoint,
            Self::Ground { .. } | Self::Coast | Self::Rates { .. } | Self::Angles { .. } => Input::hovering().setpoint,
        }
    }
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
    /// The thrusts towards whatever kind of target is flown.
    ///
    /// - `input`: its setpoint is [`Target::setpoint`]'s; its position and velocity are not looked at where the target has none.
    /// - Returns the thrusts.
    ///
    /// [`Target::Position`] is [`Self::act`]. On the ground the state is that of a hover about to begin: nothing is learnt from
    /// what the feet do. A target or a sample that is not plausible changes nothing, as there; nor does [`Target::Coast`] but the thrusts.
    pub fn act_toward(&self, state: &mut State, input: &Input, target: &Target) -> Output {
        match *target {
            Target::Ground { share } => {
                *state = self.hover_state();
                Output { thrust_n: self.allocator.alike(share), rejected: false }
            }
            Target::Coast => self.coast(state, true, input.dt_s),
            Target::Rates { rate_rad_s, thrust_n } => {
                self.act_by_hand(state, input, &Hand { rate_rad_s, tilt_rad: None, lift: Lift::Thrust(thrust_n) })
            }
            Target::Angles { roll_rad, pitch_rad, yaw_rate_rad_s, lift } => {
                let rate_rad_s = Vec3::new(0.0, 0.0, yaw_rate_rad_s);
                self.act_by_hand(state, input, &Hand { rate_rad_s, tilt_rad: Some([roll_rad, pitch_rad]), lift })
            }
            Target::Position(_) => *self.act(state, input),
        }
    }

    /// A tick without a sample, in the air: the thrusts stay as they are, or what torque they make is taken away.
    ///
    /// - `level`: take it away. A torque asked for by a sample that is old turns it ever faster.
    /// - Returns the thrusts, rejected.
    #[cold]
    #[inline(never)]
    pub fn coast(&self, state: &mut State, level: bool, dt_s: f32) -> Output {
        if let Some(rotors) = &self.rotors {
            let dt_s = dt_s.max(self.dt_s_range.0).min(self.dt_s_range.1);
            rotors.coast(&mut state.rotors, &state.output.thrust_n, dt_s);
        }
        if level {
            let made_n = state.output.thrust_n.iter().zip(&state.rotors.shares).map(|(told_n, share)| told_n * share);
            let demand = Demand { thrust_n: made_n.sum(), ..Demand::NOTHING };
            state.take(self.allocator.allocate_weakened(&demand, &state.rotors.shares));
        }
        state.output.rejected = true;
        state.output
    }

    fn act_by_hand(&self, state: &mut State, input: &Input, hand: &Hand) -> Output {
        let angles = Angles::of(&input.attitude);
        let input = hand.input(input, &angles);
        let mut errors = Errors::of(&input, &angles);
        errors.yaw_rad = RATE_S * errors.yaw_rate_rad_s;
        let plausible = errors.are_plausible(&input) && hand.is_finite();
        if plausible && state.rotors.spinning.is_some() {
            return *self.act(state, &input);
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
        let dt_s = input.dt_s.max(self.dt_s_range.0).min(self.dt_s_range.1);
        let Some(rotors) = &self.rotors else {
            let wanted = self.wanted_by_hand(state, rate, angles, errors, hand, dt_s);
            state.take(self.allocator.allocate(&wanted.with_torque(self.coupling.torque_nm(rate))));
            return;
        };
        let (coupling, residual) = self.feel(rotors, state, input, dt_s);
        let wanted = self.wanted_by_hand(state, rate, angles, errors, hand, dt_s);
        self.share_out(rotors, state, &rotors.demand(&wanted.with_torque(coupling), &residual));
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
                self.learn_altitude(state, errors, dt_s);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Attitude;
    use crate::{Airframe, Config, Law};
    use std::format;

    fn controllers() -> [Controller; 2] {
        let airframe = Airframe::paper(2.2);
        [Config::tolerant(airframe), Config::flight(Law::Lgs, airframe)]
            .map(|config| Controller::try_new(&config).expect("shipped gains"))
    }

    fn tick_toward(controller: &Controller, state: &mut State, input: &Input, target: &Target) -> Output {
        let output = controller.act_toward(state, &Input { setpoint: target.setpoint(), ..*input }, target);
        controller.reflect(state);
        output
    }

    fn weight_n() -> f32 {
        Airframe::paper(2.2).weight_n()
    }

    fn angles(roll_rad: f32, yaw_rate_rad_s: f32, lift: Lift) -> Target {
        Target::Angles { roll_rad, pitch_rad: 0.0, yaw_rate_rad_s, lift }
    }

    #[test]
    fn a_position_is_the_tick_of_a_position_to_the_bit() {
        for controller in controllers() {
            let (mut a, mut b) = (controller.hover_state(), controller.hover_state());
            let mut input = Input::hovering();
            for i in 0..500 {
                input.position_m = Vec3::new(0.01 * i as f32, -0.3, 0.001 * i as f32);
                let target = Target::Position(input.setpoint);
                let elsewhere = Setpoint { yaw_rad: 1.0, ..input.setpoint };
                let by_target = tick_toward(&controller, &mut a, &Input { setpoint: elsewhere, ..input }, &target);
                assert_eq!(
                    by_target.thrust_n.map(f32::to_bits),
                    controller.tick(&mut b, &input).thrust_n.map(f32::to_bits)
                );
            }
        }
    }

    #[test]
    fn what_is_asked_for_is_what_the_rotors_push_for() {
        let level = Lift::Thrust(weight_n());
        let rates = |x, y, z| Target::Rates { rate_rad_s: Vec3::new(x, y, z), thrust_n: weight_n() };
        // Rotors: right, front, left, back.
        for (why, target, more, less) in [
            ("roll right", angles(0.2, 0.0, level), 2, 0),
            ("roll right by rate", rates(1.0, 0.0, 0.0), 2, 0),
            ("nose up by rate", rates(0.0, 1.0, 0.0), 1, 3),
            ("turn clockwise", angles(0.0, 0.5, level), 0, 1),
            ("turn clockwise by rate", rates(0.0, 0.0, 0.5), 2, 3),
        ] {
            for controller in controllers() {
                let mut state = controller.hover_state();
                let output = tick_toward(&controller, &mut state, &Input::hovering(), &target);
                let total_n: f32 = output.thrust_n.iter().sum();
                assert!(!output.rejected && output.thrust_n[more] > output.thrust_n[less] + 0.01, "{why}: {output:?}");
                assert!((total_n - weight_n()).abs() < 1e-3, "{why}: {total_n}");
            }
        }
    }

    #[test]
    fn lift_is_the_thrust_asked_for_or_what_holds_the_altitude() {
        for controller in controllers() {
            let lifted = |lift, input: &Input| -> f32 {
                let mut state = controller.hover_state();
                tick_toward(&controller, &mut state, input, &angles(0.0, 0.0, lift)).thrust_n.iter().sum()
            };
            let hover = Input::hovering();
            assert!((lifted(Lift::Thrust(3.0), &hover) - 3.0).abs() < 1e-3);
            let still = |down_m| Lift::Altitude { down_m, down_m_s: 0.0 };
            assert!((lifted(still(0.0), &hover) - weight_n()).abs() < 1e-3);
            assert!(lifted(still(-0.1), &hover) > weight_n() + 0.5, "below its altitude");
            let lost = Input { position_m: Vec3::new(f32::NAN, 1e30, 0.0), ..hover };
            assert!((lifted(still(0.0), &lost) - weight_n()).abs() < 1e-3, "north and east are not looked at");
        }
    }

    #[test]
    fn the_position_and_velocity_laws_wait_while_they_are_not_flown() {
        for controller in controllers() {
            let mut state = controller.hover_state();
            let mut input = Input::hovering();
            input.position_m.x = -0.5;
            for _ in 0..1000 {
                controller.tick(&mut state, &input);
            }
            let learnt = |state: &State| {
                let [x, y, ..] = controller.telemetry(state).axes;
                [(x.gains, x.integral), (y.gains, y.integral)]
            };
            let before = learnt(&state);
            for _ in 0..1000 {
                tick_toward(&controller, &mut state, &input, &angles(0.1, 0.0, Lift::Thrust(weight_n())));
            }
            assert_eq!(learnt(&state), before);
        }
    }

    #[test]
    fn a_target_or_a_sample_that_is_not_plausible_changes_nothing() {
        let level = Lift::Thrust(weight_n());
        let hover = Input::hovering();
        let crooked = Input { attitude: Attitude { rows: [[2.0, 0.0, 0.0]; 3] }, ..hover };
        let spoilt = Input { rate_rad_s: Vec3::new(0.0, f32::NAN, 0.0), ..hover };
        for controller in controllers() {
            for (input, target) in [
                (hover, angles(f32::NAN, 0.0, level)),
                (hover, angles(0.0, f32::INFINITY, level)),
                (hover, angles(0.0, 0.0, Lift::Thrust(f32::NAN))),
                (hover, angles(0.0, 0.0, Lift::Altitude { down_m: f32::NAN, down_m_s: 0.0 })),
                (hover, Target::Rates { rate_rad_s: Vec3::new(0.0, f32::NAN, 0.0), thrust_n: 1.0 }),
                (crooked, angles(0.0, 0.0, level)),
                (spoilt, angles(0.0, 0.0, level)),
            ] {
                let mut state = controller.hover_state();
                assert!(tick_toward(&controller, &mut state, &input, &target).rejected, "{target:?}");
                state.output.rejected = false;
                assert_eq!(format!("{state:?}"), format!("{:?}", controller.hover_state()));
            }
        }
    }

    #[test]
    fn without_a_sample_it_coasts_on_the_thrust_that_was_and_no_torque() {
        for controller in controllers() {
            let mut state = controller.hover_state();
            let mut input = Input::hovering();
            (input.rate_rad_s.x, input.position_m.z) = (-1.0, 0.3);
            let told_n = controller.tick(&mut state, &input).thrust_n;
            assert!((told_n[0] - told_n[2]).abs() + (told_n[1] - told_n[3]).abs() > 0.1, "{told_n:?}");
            for _ in 0..3 {
                let coasting = tick_toward(&controller, &mut state, &input, &Target::Coast);
                assert!(coasting.rejected);
                for n in coasting.thrust_n {
                    assert!(
                        (4.0 * n - told_n.iter().sum::<f32>()).abs() < 1e-4,
                        "{:?}, told {told_n:?}",
                        coasting.thrust_n
                    );
                }
            }
        }
    }

    #[test]
    fn on_the_ground_all_rotors_are_alike_and_nothing_is_remembered() {
        for controller in controllers() {
            let mut state = controller.hover_state();
            let mut input = Input::hovering();
            input.position_m.z = 1.0;
            controller.tick(&mut state, &input);
            let output = tick_toward(&controller, &mut state, &input, &Target::Ground { share: 0.25 });
            assert!(output.thrust_n.iter().all(|n| (n - 0.25 * 2.2 * weight_n() / 4.0).abs() < 1e-5));
            assert_eq!(format!("{state:?}"), format!("{:?}", controller.hover_state()));
        }
    }
}
