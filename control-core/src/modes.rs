//! Modes: what the machine is asked to do, and what of it the estimate allows.
//!
//! Two steps, both functions over facts. The mode that is *aimed at* follows the pilot and the failsafes and stays until one of
//! them moves it: [`Mode::next`]. The mode that is *flown* is the first, from there down, that the estimate allows: [`Mode::flown`].
//!
//! | mode         | sticks                          | needs    | else             |
//! |--------------|---------------------------------|----------|------------------|
//! | disarmed     | none; the rotors stand          | nothing  |                  |
//! | rate         | body rates, thrust              | rates    |                  |
//! | angle        | tilt, yaw rate, thrust          | tilt     | rate             |
//! | altitude     | tilt, yaw rate, climb rate      | altitude | angle            |
//! | position     | velocity, yaw rate, climb rate  | velocity | altitude         |
//! | offboard     | none; a setpoint from outside   | position | position hold    |
//! | take-off     | none; straight up               | velocity | altitude         |
//! | return       | none; up, home, down            | position | land             |
//! | land         | none; straight down             | velocity | descend          |
//! | descend      | none; level, down               | tilt     |                  |
//!
//! Invariants: no failsafe's mode is left for a milder one while the failsafe acts; falling back takes one tick, coming back
//! [`SETTLE_S`]. While there is nothing, whatever the mode, the machine coasts: [`crate::Target::Coast`].
use crate::estimate::Health;
use crate::failsafe::Failsafe;
use core::fmt;

mod blind;
pub mod contact;
pub mod guide;

/// How much of the estimate may be flown on: each level includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Nothing.
    Nothing,
    /// Body rates.
    Rates,
    /// Roll and pitch too.
    Tilt,
    /// Altitude and climb rate too.
    Altitude,
    /// Heading and horizontal velocity too.
    Velocity,
    /// Horizontal position too.
    Position,
}

impl Level {
    /// What `health` allows.
    pub fn of(health: &Health) -> Self {
        let Health { rates, tilt, heading, altitude, velocity, position } = *health;
        let steps = [
            (rates, Self::Rates),
            (tilt, Self::Tilt),
            (altitude, Self::Altitude),
            (heading && velocity, Self::Velocity),
            (position, Self::Position),
        ];
        steps.into_iter().take_while(|(healthy, _)| *healthy).last().map_or(Self::Nothing, |(_, level)| level)
    }

    /// The first level that is not there.
    fn missing(self) -> Self {
        match self {
            Self::Nothing => Self::Rates,
            Self::Rates => Self::Tilt,
            Self::Tilt => Self::Altitude,
            Self::Altitude => Self::Velocity,
            Self::Velocity | Self::Position => Self::Position,
        }
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Nothing => "nothing",
            Self::Rates => "rates",
            Self::Tilt => "tilt",
            Self::Altitude => "altitude",
            Self::Velocity => "velocity",
            Self::Position => "position",
        })
    }
}

/// How long an estimate must have been better before it is flown on, s: the modes do not flap with a poor satellite fix.
pub const SETTLE_S: f32 = 1.0;

/// The level that is flown on: falls at once, rises when the better one has lasted [`SETTLE_S`]. While there is nothing,
/// for want of an inertial sample, nothing is judged: after that it is flown on as before.
#[derive(Clone, Copy, Debug)]
pub struct Trust {
    level: Level,
    /// The least that was offered while it was better.
    offered: Level,
    better_s: f32,
}

impl Trust {
    /// Before the first estimate.
    pub const NONE: Self = Self { level: Level::Nothing, offered: Level::Position, better_s: 0.0 };

    /// One that flies on `level` already.
    pub(crate) fn at(level: Level) -> Self {
        Self { level, ..Self::NONE }
    }

    /// Takes what one estimate allows; returns what is flown on.
    pub fn step(&mut self, now: Level, dt_s: f32) -> Level {
        if now == Level::Nothing {
            return now;
        }
        if now <= self.level {
            *self = Self { level: now, ..Self::NONE };
            return now;
        }
        self.offered = self.offered.min(now);
        self.better_s += dt_s;
        if self.better_s >= SETTLE_S {
            *self = Self { level: self.offered, ..Self::NONE };
        }
        self.level
    }
}

/// What the machine is asked to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The rotors stand.
    Disarmed,
    /// Sticks are body rates and thrust.
    Rate,
    /// Sticks are tilt, yaw rate and thrust.
    Angle,
    /// Sticks are tilt, yaw rate and climb rate.
    AltitudeHold,
    /// Sticks are velocity and yaw rate.
    PositionHold,
    /// Follows a setpoint from outside.
    Offboard,
    /// Climbs straight up, then holds.
    TakeOff,
    /// Climbs, flies home, lands.
    Return,
    /// Comes straight down, then disarms.
    Land,
    /// Comes down level, wherever the wind takes it, then disarms.
    Descend,
}

impl Mode {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Disarmed,
        Self::Rate,
        Self::Angle,
        Self::AltitudeHold,
        Self::PositionHold,
        Self::Offboard,
        Self::TakeOff,
        Self::Return,
        Self::Land,
        Self::Descend,
    ];

    /// What it needs of the estimate.
    pub fn needs(self) -> Level {
        match self {
            Self::Disarmed => Level::Nothing,
            Self::Rate => Level::Rates,
            Self::Angle | Self::Descend => Level::Tilt,
            Self::AltitudeHold => Level::Altitude,
            Self::PositionHold | Self::TakeOff | Self::Land => Level::Velocity,
            Self::Offboard | Self::Return => Level::Position,
        }
    }

    /// What is flown where that is not to be had; nothing below the last.
    pub fn fallback(self) -> Option<Self> {
        match self {
            Self::Offboard => Some(Self::PositionHold),
            Self::PositionHold | Self::TakeOff => Some(Self::AltitudeHold),
            Self::AltitudeHold => Some(Self::Angle),
            Self::Angle => Some(Self::Rate),
            Self::Return => Some(Self::Land),
            Self::Land => Some(Self::Descend),
            Self::Disarmed | Self::Rate | Self::Descend => None,
        }
    }

    /// Whether it ends on the ground, disarmed.
    pub fn comes_down(self) -> bool {
        matches!(self, Self::Return | Self::Land | Self::Descend)
    }

    /// Whether the throttle is thrust, so that low means little.
    pub fn throttle_is_thrust(self) -> bool {
        matches!(self, Self::Rate | Self::Angle)
    }

    /// How drastic it is: what a failsafe may not be talked out of.
    pub(crate) fn severity(self) -> u8 {
        match self {
            Self::Return => 2,
            Self::Land => 3,
            Self::Descend => 4,
            _ => 0,
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Disarmed => "disarmed",
            Self::Rate => "rate",
            Self::Angle => "angle",
            Self::AltitudeHold => "altitude hold",
            Self::PositionHold => "position hold",
            Self::Offboard => "offboard",
            Self::TakeOff => "take-off",
            Self::Return => "return",
            Self::Land => "land",
            Self::Descend => "descend",
        })
    }
}

/// Why the mode is what it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The pilot chose it.
    Chosen,
    /// The pilot, the landing or a failsafe disarmed it.
    Disarmed,
    /// The mode before has done what it was for.
    Arrived,
    /// A failsafe asks for it.
    Failsafe(Failsafe),
    /// The estimate does not give what the mode aimed at needs.
    Lacks(Level),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Chosen => write!(f, "as the pilot chose"),
            Self::Disarmed => write!(f, "disarmed"),
            Self::Arrived => write!(f, "arrived"),
            Self::Failsafe(failsafe) => write!(f, "failsafe: {failsafe}"),
            Self::Lacks(level) => write!(f, "no {level} to fly on"),
        }
    }
}

/// Everything the mode aimed at depends on, sampled once per tick.
#[derive(Clone, Copy, Debug)]
pub struct Facts {
    /// Whether arming lets the rotors turn.
    pub armed: bool,
    /// What the pilot chooses in this tick: with the switch, or by arming.
    pub chosen: Option<Mode>,
    /// The worst failsafe that acts.
    pub failsafe: Option<Failsafe>,
    /// Whether the mode has done what it is for: at height, or at home.
    pub arrived: bool,
}

impl Mode {
    /// The mode aimed at next, and why if it is another. Total: first matching row wins, otherwise stay.
    #[must_use]
    pub fn next(self, facts: &Facts) -> (Self, Option<Reason>) {
        let asked = facts.failsafe.and_then(|failsafe| Some((failsafe, failsafe.row().reaction.mode()?)));
        let least = facts.failsafe.map_or(0, |failsafe| failsafe.row().reaction.severity());
        let (mode, reason) = match (self, asked, facts.chosen) {
            _ if !facts.armed => (Self::Disarmed, Reason::Disarmed),
            (_, Some((failsafe, mode)), _) if least > self.severity() => (mode, Reason::Failsafe(failsafe)),
            (_, _, Some(chosen)) if chosen.severity() >= least => (chosen, Reason::Chosen),
            (Self::TakeOff, ..) if facts.arrived => (Self::PositionHold, Reason::Arrived),
            (Self::Return, ..) if facts.arrived => (Self::Land, Reason::Arrived),
            (stay, ..) => (stay, Reason::Chosen),
        };
        (mode, (mode != self).then_some(reason))
    }

    /// The mode to fly where this one is aimed at, and why if it is another: the first on the way down that `level` allows.
    #[must_use]
    pub fn flown(self, level: Level) -> (Self, Option<Reason>) {
        let down = core::iter::successors(Some(self), |mode| mode.fallback());
        let allowed = down.clone().find(|mode| mode.needs() <= level);
        let mode = allowed.or(down.last()).unwrap_or(self);
        (mode, (mode != self).then_some(Reason::Lacks(level.missing())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const HEALTHY: Health =
        Health { rates: true, tilt: true, heading: true, altitude: true, velocity: true, position: true };

    #[test]
    fn a_level_needs_those_before_it() {
        for (why, health, want) in [
            ("nothing", Health::default(), Level::Nothing),
            ("all", HEALTHY, Level::Position),
            ("no position", Health { position: false, ..HEALTHY }, Level::Velocity),
            ("no heading", Health { heading: false, ..HEALTHY }, Level::Altitude),
            ("no velocity", Health { velocity: false, ..HEALTHY }, Level::Altitude),
            ("no altitude", Health { altitude: false, ..HEALTHY }, Level::Tilt),
            ("no tilt", Health { tilt: false, ..HEALTHY }, Level::Rates),
            ("no rates", Health { rates: false, ..HEALTHY }, Level::Nothing),
        ] {
            assert_eq!(Level::of(&health), want, "{why}");
        }
    }

    #[test]
    fn trust_falls_at_once_and_rises_to_what_has_lasted() {
        let mut trust = Trust::NONE;
        let mut offer = |level, seconds: f32| {
            let ticks = (seconds / 0.01) as usize;
            (0..ticks).map(|_| trust.step(level, 0.01)).last().expect("a tick")
        };
        assert_eq!(offer(Level::Position, 0.9), Level::Nothing, "not yet");
        assert_eq!(offer(Level::Position, 0.2), Level::Position);
        assert_eq!(offer(Level::Tilt, 0.01), Level::Tilt, "falls at once");
        assert_eq!(offer(Level::Position, 0.5), Level::Tilt);
        assert_eq!(offer(Level::Altitude, 0.01), Level::Tilt);
        assert_eq!(offer(Level::Position, 0.6), Level::Altitude, "the least that was offered");
        assert_eq!(offer(Level::Position, 1.1), Level::Position);
        assert_eq!(offer(Level::Nothing, 0.05), Level::Nothing);
        assert_eq!(offer(Level::Position, 0.01), Level::Position, "as before");
        assert_eq!(offer(Level::Nothing, 0.05), Level::Nothing);
        assert_eq!(offer(Level::Altitude, 0.01), Level::Altitude, "no better than it is");
    }

    #[test]
    fn every_mode_falls_back_to_the_best_that_is_left() {
        use Level::{Altitude, Nothing, Position, Rates, Tilt, Velocity};
        for (aim, level, want, lacks) in [
            (Mode::Offboard, Position, Mode::Offboard, None),
            (Mode::Offboard, Velocity, Mode::PositionHold, Some(Position)),
            (Mode::Offboard, Altitude, Mode::AltitudeHold, Some(Velocity)),
            (Mode::PositionHold, Velocity, Mode::PositionHold, None),
            (Mode::PositionHold, Altitude, Mode::AltitudeHold, Some(Velocity)),
            (Mode::PositionHold, Tilt, Mode::Angle, Some(Altitude)),
            (Mode::PositionHold, Rates, Mode::Rate, Some(Tilt)),
            (Mode::PositionHold, Nothing, Mode::Rate, Some(Rates)),
            (Mode::TakeOff, Altitude, Mode::AltitudeHold, Some(Velocity)),
            (Mode::AltitudeHold, Altitude, Mode::AltitudeHold, None),
            (Mode::Angle, Tilt, Mode::Angle, None),
            (Mode::Rate, Rates, Mode::Rate, None),
            (Mode::Return, Velocity, Mode::Land, Some(Position)),
            (Mode::Return, Altitude, Mode::Descend, Some(Velocity)),
            (Mode::Land, Tilt, Mode::Descend, Some(Altitude)),
            (Mode::Descend, Tilt, Mode::Descend, None),
            (Mode::Descend, Rates, Mode::Descend, None),
            (Mode::Disarmed, Nothing, Mode::Disarmed, None),
        ] {
            assert_eq!(aim.flown(level), (want, lacks.map(Reason::Lacks)), "{aim} on {level}");
        }
    }

    #[test]
    fn whatever_is_aimed_at_is_flown_on_no_less_than_it_needs() {
        for aim in Mode::ALL {
            for level in [Level::Rates, Level::Tilt, Level::Altitude, Level::Velocity, Level::Position] {
                let (mode, _) = aim.flown(level);
                let last = mode.fallback().is_none() && level < Level::Tilt;
                assert!(mode.needs() <= level || last, "{aim} on {level}: {mode}");
                assert!(!aim.comes_down() || mode.comes_down(), "{aim} never turns into one that stays up");
            }
        }
    }

    #[test]
    fn the_mode_aimed_at_follows_the_table() {
        use Failsafe::{BatteryCritical, LinkLost, NoPosition, NoRates, OffboardStale, RotorLost};
        let calm = Facts { armed: true, chosen: None, failsafe: None, arrived: false };
        let chosen = |mode| Facts { chosen: Some(mode), ..calm };
        let failsafe = |failsafe| Facts { failsafe: Some(failsafe), ..calm };
        let because = |failsafe| Some(Reason::Failsafe(failsafe));
        for (why, from, facts, want, reason) in [
            ("stays", Mode::Angle, calm, Mode::Angle, None),
            ("the pilot chooses", Mode::Angle, chosen(Mode::Rate), Mode::Rate, Some(Reason::Chosen)),
            ("what is flown already", Mode::Angle, chosen(Mode::Angle), Mode::Angle, None),
            ("disarmed", Mode::Angle, Facts { armed: false, ..calm }, Mode::Disarmed, Some(Reason::Disarmed)),
            ("at height", Mode::TakeOff, Facts { arrived: true, ..calm }, Mode::PositionHold, Some(Reason::Arrived)),
            ("at home", Mode::Return, Facts { arrived: true, ..calm }, Mode::Land, Some(Reason::Arrived)),
            ("a landing arrives nowhere", Mode::Land, Facts { arrived: true, ..calm }, Mode::Land, None),
            ("link lost", Mode::Rate, failsafe(LinkLost), Mode::Return, because(LinkLost)),
            ("link lost while landing", Mode::Land, failsafe(LinkLost), Mode::Land, None),
            ("worse while returning", Mode::Return, failsafe(RotorLost), Mode::Land, because(RotorLost)),
            ("stale setpoint", Mode::Offboard, failsafe(OffboardStale), Mode::PositionHold, because(OffboardStale)),
            ("position lost is for the fallback", Mode::Return, failsafe(NoPosition), Mode::Return, None),
            ("to terminate is for arming", Mode::Angle, failsafe(NoRates), Mode::Angle, None),
            ("it stays when the failsafe is over", Mode::Return, calm, Mode::Return, None),
            ("then the pilot takes over", Mode::Return, chosen(Mode::Angle), Mode::Angle, Some(Reason::Chosen)),
            (
                "the pilot cannot choose a milder mode while it acts",
                Mode::Land,
                Facts { chosen: Some(Mode::Angle), ..failsafe(BatteryCritical) },
                Mode::Land,
                None,
            ),
            (
                "but a harder one",
                Mode::Return,
                Facts { chosen: Some(Mode::Descend), ..failsafe(LinkLost) },
                Mode::Descend,
                Some(Reason::Chosen),
            ),
            (
                "at home while the link is still lost",
                Mode::Return,
                Facts { arrived: true, ..failsafe(LinkLost) },
                Mode::Land,
                Some(Reason::Arrived),
            ),
        ] {
            assert_eq!(from.next(&facts), (want, reason), "{why}");
        }
    }

    #[test]
    fn reasons_are_text_for_people() {
        assert_eq!(Reason::Lacks(Level::Velocity).to_string(), "no velocity to fly on");
        assert_eq!(Reason::Failsafe(Failsafe::LinkLost).to_string(), "failsafe: link lost");
    }
}
