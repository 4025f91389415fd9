//! Whether the machine stands on its feet: what the ground bears is what the accelerometer feels and the rotors do not make.
//!
//! ```text
//! standing ── lift is wanted ──► spooling ── the rotors turn ──► flying ── the ground bears it, still ──► standing
//! ```
//!
//! In the air the specific force is the thrust over the mass, and a little drag: little thrust is felt as little. On the
//! ground the feet make up what the rotors do not, and 1 g is felt whatever they do. No altitude is needed to tell.
//!
//! What the ground does to the body looks like lost rotors. So it is suspected at once where it seems to bear the machine, and for
//! `JOLT_S` after a jolt, felt without a turn, that the rotors did not make.
//!
//! A machine without a rotor never keeps still on its feet. It stands, too, if it is to come down and does not: its setpoint is well
//! below it, and it does not sink.
use crate::GRAVITY_M_S2;
use crate::frames::{Body, Vec3};

/// Thrust over weight above which the machine is not taken to stand, and felt force over weight below which.
const STANDING_THRUST_MAX: f32 = 0.6;
const STANDING_FORCE_MIN: f32 = 0.8;
/// Fastest body rate of a machine that stands, rad/s.
const STILL_RAD_S: f32 = 0.3;
/// How long that must last, s: longer than any bump.
const STANDING_S: f32 = 0.5;
/// Felt force over weight beyond what the rotors make that is a jolt, and how long it is heeded, s.
const JOLT_WEIGHTS: f32 = 0.4;
const JOLT_S: f32 = 0.5;
/// Depth of the setpoint below a machine that does not come down, m: several times what one in the air is late by.
const PRESSED_M: f32 = 0.5;
/// Vertical speed of a machine that does not come down, m/s.
const STOPPED_M_S: f32 = 0.4;
/// How long the rotors spool up, s.
pub const SPOOL_S: f32 = 0.6;

/// Where the machine is between ground and flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contact {
    /// On its feet; the rotors idle.
    Standing,
    /// On its feet; the rotors spool up.
    Spooling,
    /// In the air.
    Flying,
}

/// What the step depends on, sampled once per tick.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "independent facts, each read by name")]
pub struct Facts {
    /// Whether the rotors are let turn.
    pub armed: bool,
    /// Whether the mode wants to be in the air.
    pub lift: bool,
    /// Whether the rotors have spooled up.
    pub spooled: bool,
    /// Whether the ground has borne the machine long enough.
    pub borne: bool,
}

impl Contact {
    /// The next state. Total: first matching row wins, otherwise stay.
    #[must_use]
    pub fn next(self, facts: &Facts) -> Self {
        match self {
            _ if !facts.armed => Self::Standing,
            Self::Standing if facts.lift => Self::Spooling,
            Self::Spooling if !facts.lift => Self::Standing,
            Self::Spooling if facts.spooled => Self::Flying,
            Self::Flying if facts.borne => Self::Standing,
            stay => stay,
        }
    }
}

/// The state, and how long what it waits for has lasted.
#[derive(Clone, Copy, Debug)]
pub struct Feet {
    contact: Contact,
    spooling_s: f32,
    borne_s: f32,
    /// How long a jolt is heeded yet, s.
    jolted_s: f32,
}

/// What one tick felt.
#[derive(Clone, Copy, Debug)]
pub struct Felt {
    /// Whether the rotors are let turn.
    pub armed: bool,
    /// Whether the mode wants to be in the air.
    pub lift: bool,
    /// How long the rotors are to spool up, s.
    pub spool_s: f32,
    /// Thrust that the rotors are believed to make, over the weight.
    pub thrust_weights: f32,
    /// Specific force along body z, m/s².
    pub force_z_m_s2: f32,
    /// Body rates, rad/s.
    pub rate_rad_s: Vec3<Body>,
    /// Of a machine that is to come down to an altitude: how deep the setpoint is below it, m, and its velocity down, m/s.
    pub pressed: Option<(f32, f32)>,
}

impl Feet {
    /// On the ground.
    pub const STANDING: Self = Self { contact: Contact::Standing, spooling_s: 0.0, borne_s: 0.0, jolted_s: 0.0 };

    /// In the air after an interruption, in which the rotors did what nobody knows: as after a jolt.
    pub(crate) const INTERRUPTED: Self = Self { contact: Contact::Flying, jolted_s: JOLT_S, ..Self::STANDING };

    /// Takes what one tick felt; returns where the machine is.
    pub fn step(&mut self, felt: &Felt, dt_s: f32) -> Contact {
        // A value that is not a number bears nothing.
        let still = felt.rate_rad_s.norm_squared() < STILL_RAD_S * STILL_RAD_S;
        let weights = -felt.force_z_m_s2 / GRAVITY_M_S2;
        let bears = felt.thrust_weights < STANDING_THRUST_MAX && weights > STANDING_FORCE_MIN && still;
        let jolts = !felt.lift && weights - felt.thrust_weights > JOLT_WEIGHTS && still;
        self.jolted_s = if jolts { JOLT_S } else { (self.jolted_s - dt_s).max(0.0) };
        let stops = felt.pressed.is_some_and(|(m, m_s)| m > PRESSED_M && m_s.abs() < STOPPED_M_S);
        self.borne_s = if bears || stops { (self.borne_s + dt_s).min(STANDING_S) } else { 0.0 };
        self.spooling_s += if self.contact == Contact::Spooling { dt_s } else { 0.0 };
        let next = self.contact.next(&Facts {
            armed: felt.armed,
            lift: felt.lift,
            spooled: self.spooling_s >= felt.spool_s,
            borne: self.borne_s >= STANDING_S,
        });
        if next != self.contact {
            *self = Self { contact: next, ..Self::STANDING };
        }
        self.contact
    }

    /// Whether the ground seems to bear the machine, just now.
    pub fn suspects(&self) -> bool {
        self.borne_s > 0.0 || self.jolted_s > 0.0
    }

    /// Share of the spooling that is done, 0 to 1.
    pub fn spooled(&self) -> f32 {
        (self.spooling_s / SPOOL_S).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f32 = 0.01;
    const STANDING: Felt = Felt {
        armed: true,
        lift: false,
        spool_s: SPOOL_S,
        thrust_weights: 0.1,
        force_z_m_s2: -GRAVITY_M_S2,
        rate_rad_s: Vec3::zero(),
        pressed: None,
    };
    const HOVERING: Felt = Felt { lift: true, thrust_weights: 1.0, ..STANDING };

    #[test]
    fn contact_follows_the_table() {
        use Contact::{Flying, Spooling, Standing};
        let idle = Facts { armed: true, lift: false, spooled: false, borne: false };
        let lift = Facts { lift: true, ..idle };
        for (why, from, facts, want) in [
            ("it stands", Standing, Facts { borne: true, ..idle }, Standing),
            ("to take off, it spools up", Standing, lift, Spooling),
            ("which takes its time", Spooling, lift, Spooling),
            ("and may be given up", Spooling, idle, Standing),
            ("then it flies", Spooling, Facts { spooled: true, ..lift }, Flying),
            ("with the throttle low it still flies", Flying, idle, Flying),
            ("the ground bears it", Flying, Facts { borne: true, ..idle }, Standing),
            ("disarmed in the air", Flying, Facts { armed: false, ..lift }, Standing),
        ] {
            assert_eq!(from.next(&facts), want, "{why}");
        }
    }

    /// Where a machine in the air is after a second of `felt`.
    fn after_a_second(felt: Felt) -> Contact {
        let mut feet = Feet::STANDING;
        for _ in 0..70 {
            feet.step(&HOVERING, DT_S);
        }
        assert_eq!(feet.contact, Contact::Flying);
        (0..100).map(|_| feet.step(&felt, DT_S)).find(|&c| c != Contact::Flying).unwrap_or(Contact::Flying)
    }

    #[test]
    fn only_the_ground_bears_a_machine_that_does_not_pull() {
        use Contact::{Flying, Standing};
        let falling = Felt { force_z_m_s2: -0.1 * GRAVITY_M_S2, ..STANDING };
        let moving = Vec3::new(0.5, 0.0, 0.0);
        for (why, felt, want) in [
            ("on its feet", STANDING, Standing),
            ("hovering", Felt { lift: false, ..HOVERING }, Flying),
            ("falling with the throttle low", falling, Flying),
            ("sinking at constant speed", Felt { thrust_weights: 0.9, ..STANDING }, Flying),
            ("rolling over", Felt { rate_rad_s: moving, ..STANDING }, Flying),
            ("feeling nothing that is a number", Felt { force_z_m_s2: f32::NAN, ..STANDING }, Flying),
            ("told to come down, and does not", Felt { pressed: Some((0.6, 0.1)), ..HOVERING }, Standing),
            ("told to come down, and does", Felt { pressed: Some((0.6, 0.7)), ..HOVERING }, Flying),
            ("told to come down, just now", Felt { pressed: Some((0.2, 0.0)), ..HOVERING }, Flying),
        ] {
            assert_eq!(after_a_second(Felt { lift: false, ..felt }), want, "{why}");
        }
    }

    #[test]
    fn the_ground_is_suspected_after_a_jolt_that_the_rotors_did_not_make() {
        let jolted = Felt { lift: false, force_z_m_s2: -1.5 * GRAVITY_M_S2, ..HOVERING };
        let turning = Felt { rate_rad_s: Vec3::new(0.5, 0.0, 0.0), ..jolted };
        for (why, felt, want) in [
            ("hovering", Felt { lift: false, ..HOVERING }, false),
            ("it meets the ground", jolted, true),
            ("a rotor runs away with it", turning, false),
            ("a gust in a climb", Felt { lift: true, ..jolted }, false),
        ] {
            let mut feet = Feet::STANDING;
            for _ in 0..70 {
                feet.step(&HOVERING, DT_S);
            }
            feet.step(&felt, DT_S);
            let suspected = (0..100).take_while(|_| {
                feet.step(&HOVERING, DT_S);
                feet.suspects()
            });
            assert_eq!(suspected.count() >= 48, want, "{why}");
            assert!(!feet.suspects(), "{why}");
        }
    }

    #[test]
    fn a_bump_is_no_landing() {
        let mut feet = Feet::STANDING;
        for tick in 0..1000 {
            let felt = if tick < 100 || tick % 45 == 0 { HOVERING } else { Felt { lift: tick < 100, ..STANDING } };
            let contact = feet.step(&felt, DT_S);
            assert!(tick < 70 || contact == Contact::Flying, "tick {tick}");
        }
    }
}
