//! Failsafes: what must not go on, how long it may, and what is done about it.
//!
//! One table, [`TABLE`], worst first. A row acts when its condition has held for its time; the first that acts wins. The
//! reaction is a mode to aim at, so that it falls back as any mode does where the estimate does not carry it.
//!
//! A pilot who moves the mode switch while a row acts that may be overruled has it silent until its condition has been
//! false once: with little battery or beyond the fence it is the pilot who sees where to land.
use crate::modes::{Level, Mode};
use crate::parameters::{Parameter, Parameters};
use crate::set::{Member, Set};
use core::fmt;

/// Everything the failsafes depend on, sampled once per tick.
#[derive(Clone, Copy, Debug)]
pub struct Facts {
    /// The mode aimed at.
    pub aim: Mode,
    /// What of the estimate is flown on.
    pub level: Level,
    /// Age of the pilot's last word, s.
    pub link_age_s: f32,
    /// Age of the last setpoint from outside, s.
    pub offboard_age_s: f32,
    /// Voltage of a cell, if somebody measures it, V.
    pub cell_v: Option<f32>,
    /// Charge taken from the battery since the machine was switched on, A s.
    pub used_as: f32,
    /// Horizontal distance from home, if both are known, m.
    pub from_home_m: Option<f32>,
    /// Height above home, if both are known, m.
    pub height_m: Option<f32>,
    /// Cosine of the tilt.
    pub upright: f32,
    /// Whether the controller flies without one of the rotors.
    pub rotor_lost: bool,
    /// Whether this tick came late.
    pub late: bool,
}

impl Facts {
    /// Whether the pilot is heard; not at an age that is not a number.
    fn heard(&self, limits: &Limits) -> bool {
        self.link_age_s <= limits.link_s
    }

    /// Whether a setpoint from outside is there to follow.
    fn led(&self, limits: &Limits) -> bool {
        self.offboard_age_s <= limits.offboard_s
    }

    /// Whether somebody can fly it by hand.
    fn piloted(&self, limits: &Limits) -> bool {
        self.heard(limits) && !self.aim.comes_down()
    }

    fn lacks(&self, level: Level) -> bool {
        self.aim.needs() >= level && self.level < level
    }
}

/// Where the conditions begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Oldest word of the pilot, s.
    pub link_s: f32,
    /// Oldest setpoint from outside, s.
    pub offboard_s: f32,
    /// Low and critical voltage of a cell, V.
    pub cell_v: (f32, f32),
    /// Charge of the battery that may be used, A s; infinite if nobody minds.
    pub used_as: f32,
    /// Radius of the fence, m; infinite for none.
    pub fence_radius_m: f32,
    /// Height of the fence above home, m; infinite for none.
    pub fence_height_m: f32,
    /// Cosine of the largest tilt.
    pub upright: f32,
}

impl From<&Parameters> for Limits {
    fn from(parameters: &Parameters) -> Self {
        let p = |parameter| parameters[parameter];
        let fence = |m: f32| if m > 0.0 { m } else { f32::INFINITY };
        Self {
            link_s: p(Parameter::FsLinkS),
            offboard_s: p(Parameter::FsOffboardS),
            cell_v: (p(Parameter::BatLowV), p(Parameter::BatCriticalV)),
            used_as: parameters.battery_use_as(),
            fence_radius_m: fence(p(Parameter::FenceRadius)),
            fence_height_m: fence(p(Parameter::FenceHeight)),
            upright: crate::math::cos(parameters.rad(Parameter::FsTilt)),
        }
    }
}

/// What is done, mildest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reaction {
    /// The best mode that is left is flown: [`Mode::flown`].
    FallBack,
    /// Position hold.
    Hold,
    /// Return.
    Return,
    /// Land.
    Land,
    /// The rotors are stopped.
    Terminate,
}

impl Reaction {
    /// The mode it aims at, if it is one.
    pub fn mode(self) -> Option<Mode> {
        match self {
            Self::FallBack | Self::Terminate => None,
            Self::Hold => Some(Mode::PositionHold),
            Self::Return => Some(Mode::Return),
            Self::Land => Some(Mode::Land),
        }
    }

    /// On the scale of [`Mode::severity`], on which a mode the pilot flies is 0.
    pub(crate) fn severity(self) -> u8 {
        match self {
            Self::FallBack => 0,
            Self::Hold => 1,
            Self::Return | Self::Land => self.mode().map_or(0, Mode::severity),
            Self::Terminate => u8::MAX,
        }
    }
}

impl fmt::Display for Reaction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::FallBack => "best mode left",
            Self::Hold => "hold",
            Self::Return => "return",
            Self::Land => "land",
            Self::Terminate => "stop the rotors",
        })
    }
}

/// One failsafe.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Which.
    pub failsafe: Failsafe,
    /// Its name, for people.
    pub name: &'static str,
    /// Its condition, for people.
    pub text: &'static str,
    /// Its condition.
    pub when: fn(&Facts, &Limits) -> bool,
    /// How long the condition must hold, s.
    pub after_s: f32,
    /// What is done.
    pub reaction: Reaction,
    /// Whether the pilot may overrule it.
    pub overrule: bool,
}

macro_rules! failsafes {
    ($($id:ident $name:literal, $text:literal, $when:expr, after $after_s:literal, $reaction:ident, overrule $overrule:literal;)+) => {
        /// What must not go on: the rows of [`TABLE`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Failsafe { $(#[doc = $text] $id),+ }

        impl Member for Failsafe {
            const ALL: &'static [Self] = &[$(Self::$id),+];

            fn index(self) -> usize {
                self as usize
            }
        }

        /// Every failsafe, worst first.
        pub const TABLE: [Row; Failsafe::ALL.len()] = [$(Row {
            failsafe: Failsafe::$id,
            name: $name,
            text: $text,
            when: $when,
            after_s: $after_s,
            reaction: Reaction::$reaction,
            overrule: $overrule,
        }),+];
    };
}

failsafes! {
    NoRates "nothing to fly on", "no body rates: not a number, or the inertial unit is dead",
        |f, _| f.level < Level::Rates, after 0.1, Terminate, overrule false;
    NoTilt "attitude lost", "no roll and pitch, and nobody to fly by rates",
        |f, l| f.level < Level::Tilt && !f.piloted(l), after 0.5, Terminate, overrule false;
    Tipped "tilt", "tilted beyond FS_TILT, but in rate mode",
        |f, l| f.level >= Level::Tilt && f.aim != Mode::Rate && f.upright < l.upright, after 1.0, Terminate, overrule false;
    BatteryCritical "battery critical", "a cell below BAT_CRIT_V",
        |f, l| f.cell_v.is_some_and(|v| v < l.cell_v.1), after 2.0, Land, overrule true;
    RotorLost "rotor lost", "the controller flies without a rotor",
        |f, _| f.rotor_lost, after 1.0, Land, overrule false;
    Overrun "control loop late", "every tick late",
        |f, _| f.late, after 0.2, Land, overrule false;
    BatteryLow "battery low", "a cell below BAT_LOW_V or more than BAT_USE_MAX used, and a position to return by",
        |f, l| f.level >= Level::Position && (f.cell_v.is_some_and(|v| v < l.cell_v.0) || f.used_as > l.used_as), after 5.0, Return, overrule true;
    Fence "geofence", "beyond FENCE_RADIUS or FENCE_HEIGHT",
        |f, l| {
            let beyond = |far_m: Option<f32>, limit_m| far_m.is_some_and(|m| m > limit_m);
            beyond(f.from_home_m, l.fence_radius_m) || beyond(f.height_m, l.fence_height_m)
        }, after 0.5, Return, overrule true;
    LinkLost "link lost", "the pilot's last word older than FS_LINK_S",
        |f, l| !f.heard(l), after 0.0, Return, overrule false;
    OffboardStale "offboard setpoint stale", "in offboard, its last setpoint older than FS_OFFB_S",
        |f, l| f.aim == Mode::Offboard && !f.led(l), after 0.0, Hold, overrule false;
    NoAltitude "altitude lost", "no altitude, in a mode that needs it",
        |f, _| f.lacks(Level::Altitude), after 0.0, FallBack, overrule false;
    NoVelocity "velocity lost", "no horizontal velocity or heading, in a mode that needs them",
        |f, _| f.lacks(Level::Velocity), after 0.0, FallBack, overrule false;
    NoPosition "position lost", "no position, in a mode that needs it",
        |f, _| f.lacks(Level::Position), after 0.0, FallBack, overrule false;
}

impl Failsafe {
    /// Its row of the table.
    pub fn row(self) -> &'static Row {
        &TABLE[self as usize]
    }
}

impl fmt::Display for Failsafe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.row().name)
    }
}

/// How long each condition has held, and what the pilot has overruled.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    held_s: [f32; TABLE.len()],
    overruled: Set<Failsafe>,
}

impl Watch {
    /// Before the flight.
    pub const NEW: Self = Self { held_s: [0.0; TABLE.len()], overruled: Set::EMPTY };

    /// Takes the facts of a tick; returns the failsafes that act.
    ///
    /// - `chosen`: whether the pilot moves the mode switch in this tick.
    pub fn step(&mut self, facts: &Facts, limits: &Limits, chosen: bool, dt_s: f32) -> Set<Failsafe> {
        let mut acting = Set::EMPTY;
        for (row, held_s) in TABLE.iter().zip(&mut self.held_s) {
            if !(row.when)(facts, limits) {
                *held_s = 0.0;
                self.overruled.put(row.failsafe, false);
                continue;
            }
            // Held at its limit, which is all it is compared with.
            let due = *held_s + dt_s >= row.after_s;
            *held_s = (*held_s + dt_s).min(row.after_s);
            if due && chosen && row.overrule {
                self.overruled.put(row.failsafe, true);
            }
            acting.put(row.failsafe, due && !self.overruled.contains(row.failsafe));
        }
        acting
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Failsafe::{
        BatteryCritical, BatteryLow, Fence, LinkLost, NoAltitude, NoPosition, NoRates, NoTilt, NoVelocity,
        OffboardStale, Overrun, RotorLost, Tipped,
    };

    const DT_S: f32 = 0.01;

    fn good() -> Facts {
        Facts {
            aim: Mode::PositionHold,
            level: Level::Position,
            link_age_s: 0.02,
            offboard_age_s: f32::INFINITY,
            cell_v: Some(4.0),
            used_as: 3_000.0,
            from_home_m: Some(10.0),
            height_m: Some(10.0),
            upright: 1.0,
            rotor_lost: false,
            late: false,
        }
    }

    fn limits() -> Limits {
        let mut parameters = Parameters::default();
        parameters.set("FENCE_RADIUS", 100.0).expect("in its range");
        parameters.set("BAT_USE_MAX", 1_000.0).expect("in its range");
        Limits::from(&parameters)
    }

    /// What acts after `facts` have held for `seconds`.
    fn after(facts: &Facts, seconds: f32) -> Set<Failsafe> {
        let mut watch = Watch::NEW;
        let ticks = (seconds / DT_S).round() as usize;
        (0..ticks).map(|_| watch.step(facts, &limits(), false, DT_S)).last().expect("a tick")
    }

    /// Each row with facts that make it act, and it alone.
    fn triggers() -> [(Failsafe, Facts); TABLE.len()] {
        [
            (NoRates, Facts { level: Level::Nothing, aim: Mode::Rate, ..good() }),
            (NoTilt, Facts { level: Level::Rates, aim: Mode::Descend, ..good() }),
            (Tipped, Facts { upright: 0.1, ..good() }),
            (BatteryCritical, Facts { cell_v: Some(3.2), level: Level::Velocity, ..good() }),
            (RotorLost, Facts { rotor_lost: true, ..good() }),
            (Overrun, Facts { late: true, ..good() }),
            (BatteryLow, Facts { cell_v: Some(3.4), ..good() }),
            (Fence, Facts { from_home_m: Some(101.0), ..good() }),
            (LinkLost, Facts { link_age_s: 0.6, ..good() }),
            (OffboardStale, Facts { aim: Mode::Offboard, offboard_age_s: 0.6, ..good() }),
            (NoAltitude, Facts { aim: Mode::AltitudeHold, level: Level::Tilt, ..good() }),
            (NoVelocity, Facts { level: Level::Altitude, ..good() }),
            (NoPosition, Facts { aim: Mode::Return, level: Level::Velocity, ..good() }),
        ]
    }

    #[test]
    fn every_row_acts_alone_when_its_time_is_up_and_not_before() {
        assert!(after(&good(), 10.0).is_empty());
        for (failsafe, facts) in triggers() {
            let after_s = failsafe.row().after_s;
            assert!(after(&facts, after_s + DT_S).iter().eq([failsafe]), "{failsafe}");
            if after_s > 2.0 * DT_S {
                assert!(after(&facts, after_s - 2.0 * DT_S).is_empty(), "{failsafe}: before its time");
            }
        }
    }

    #[test]
    fn a_condition_that_pauses_starts_again() {
        for (failsafe, facts) in triggers().into_iter().filter(|(failsafe, _)| failsafe.row().after_s > 0.0) {
            let mut watch = Watch::NEW;
            let half = (failsafe.row().after_s / DT_S * 0.7) as usize;
            for tick in 0..3 * half {
                let facts = if tick % half == 0 { good() } else { facts };
                assert!(watch.step(&facts, &limits(), false, DT_S).is_empty(), "{failsafe}");
            }
        }
    }

    #[test]
    fn rows_that_look_alike_are_told_apart() {
        let acts = |facts: Facts, failsafe| after(&facts, 10.0).contains(failsafe);
        for (why, facts, failsafe, want) in [
            ("a pilot flies by rates", Facts { level: Level::Rates, ..good() }, NoTilt, false),
            ("no pilot does", Facts { level: Level::Rates, link_age_s: 9.0, ..good() }, NoTilt, true),
            ("rate mode may tilt", Facts { upright: -1.0, aim: Mode::Rate, ..good() }, Tipped, false),
            ("a tilt that nobody knows", Facts { upright: -1.0, level: Level::Rates, ..good() }, Tipped, false),
            ("nowhere to return to", Facts { cell_v: Some(3.4), level: Level::Velocity, ..good() }, BatteryLow, false),
            ("enough is left", Facts { used_as: 3_599.0, ..good() }, BatteryLow, false),
            (
                "too much is used, whatever the voltage",
                Facts { used_as: 3_601.0, cell_v: None, ..good() },
                BatteryLow,
                true,
            ),
            ("nobody measures it", Facts { cell_v: None, ..good() }, BatteryLow, false),
            ("the ceiling", Facts { height_m: Some(121.0), ..good() }, Fence, true),
            ("home unknown", Facts { from_home_m: None, height_m: None, ..good() }, Fence, false),
            ("an age that is not a number", Facts { link_age_s: f32::NAN, ..good() }, LinkLost, true),
            ("nobody sends setpoints, nor needs them", good(), OffboardStale, false),
            ("angle needs no position", Facts { aim: Mode::Angle, level: Level::Tilt, ..good() }, NoPosition, false),
        ] {
            assert_eq!(acts(facts, failsafe), want, "{why}");
        }
    }

    #[test]
    fn the_table_is_sorted_worst_first_and_complete() {
        assert!(TABLE.windows(2).all(|rows| rows[0].reaction >= rows[1].reaction));
        assert!(TABLE.iter().enumerate().all(|(i, row)| row.failsafe.index() == i));
        assert!(triggers().into_iter().map(|(failsafe, _)| failsafe).eq(Failsafe::ALL.iter().copied()));
    }

    #[test]
    fn the_worst_that_acts_comes_first() {
        let facts = Facts { link_age_s: 9.0, cell_v: Some(3.0), rotor_lost: true, ..good() };
        let acting = after(&facts, 10.0);
        assert!(acting.iter().eq([BatteryCritical, RotorLost, BatteryLow, LinkLost]), "{acting:?}");
    }

    #[test]
    fn what_the_pilot_overrules_is_silent_until_it_was_over_once() {
        for (failsafe, facts) in triggers() {
            let mut watch = Watch::NEW;
            let mut step = |facts: &Facts, moved| watch.step(facts, &limits(), moved, 10.0).contains(failsafe);
            assert!(step(&facts, false), "{failsafe}");
            assert_eq!(step(&facts, true), !failsafe.row().overrule, "{failsafe}");
            assert_eq!(step(&facts, false), !failsafe.row().overrule, "{failsafe}");
            assert!(!step(&good(), false));
            assert!(step(&facts, false), "{failsafe}: again");
        }
    }
}
