//! Actuator faults as plain data: what breaks, on which rotors, when, in what shape, and whether it is told.
//!
//! One set of types for everything that speaks of faults: scenarios, campaigns, bench tests, injection over a link. The
//! flight controller itself has no use for them. Nothing here draws random numbers: who applies a fault does.
//!
//! | kind                    | parameters                          | graded | takes over |
//! |-------------------------|-------------------------------------|--------|------------|
//! | `loss_of_effectiveness` | `loss`                              | yes    |            |
//! | `stopped`               |                                     |        | yes        |
//! | `stuck`                 | `thrust_n`, or where it is          |        | yes        |
//! | `hard_over`             |                                     |        | yes        |
//! | `floating`              | `spin_down_s`                       |        | yes        |
//! | `slow_motor`            | `lag_factor`, `rate_n_s_max` or any | yes    |            |
//! | `command_delay`         | `delay_s`                           | yes    |            |
//! | `command_jitter`        | `delay_s_max`                       | yes    |            |
//! | `esc_desync`            | `dropout_s`, `restart_s`, and `period_s` or `rate_1_s` | | yes |
//! | `propeller_damage`      | `loss`, `unbalance_kg_m`            | yes    |            |
//! | `battery_sag`           | `sag`                               | yes    |            |
//! | `reversed`              | `share`                             |        | yes        |
//! | `swapped`               |                                     |        |            |
//!
//! A graded fault may be there in part, as a ramp or a sine makes it; the others are there or not. Of those that take a
//! rotor's thrust over, one at a time can have a rotor.
//!
//! Elsewhere: shapes over time are `fault/profile.rs`, the set of rotors is `fault/rotors.rs`, the flat form of files is
//! `fault/keys.rs`, ranges are `fault/check.rs`. Faults of sensors are `fault/sensors.rs`.

mod check;
mod keys;
mod profile;
mod rotors;
pub mod sensors;

pub use check::{Allowed, FAULT_S_MAX, FaultError, FaultValue};
pub use keys::{FaultKeys, FaultName};
pub use profile::{Intermittent, Profile, PulseTrain, Ramp, Sine};
pub use rotors::Rotors;

/// What breaks, and how badly at its worst.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// A rotor makes only a share of its thrust, and of the torque that goes with it.
    LossOfEffectiveness {
        /// Share of the thrust that is lost, 0 to 1.
        loss: f64,
    },
    /// The motor stops: its thrust goes to zero with the motor's own lag.
    Stopped,
    /// The motor heeds no command.
    Stuck {
        /// Thrust it goes to, N; left out, it keeps the one it has at the onset.
        thrust_n: Option<f64>,
    },
    /// The motor runs at its largest thrust.
    HardOver,
    /// The motor is not driven, and its rotor runs down freely.
    Floating {
        /// Time constant of the thrust's decay, s; longer than the motor's lag.
        spin_down_s: f64,
    },
    /// The motor answers late.
    SlowMotor {
        /// What its time constant is multiplied by, 1 or more.
        lag_factor: f64,
        /// Largest change of its thrust, N/s; left out, there is no limit.
        rate_n_s_max: Option<f64>,
    },
    /// Commands arrive late, by the same time each.
    CommandDelay {
        /// How late, s; in whole control periods.
        delay_s: f64,
    },
    /// Commands arrive late, each by another time; one that is overtaken is dropped.
    CommandJitter {
        /// Bound of the delay, s, drawn evenly from zero on; in whole control periods.
        delay_s_max: f64,
    },
    /// The speed controller loses the motor again and again: no drive, then a restart.
    EscDesync {
        /// How long the motor is not driven, s.
        dropout_s: f64,
        /// How long its thrust is then limited by a ramp from nothing to the command, s.
        restart_s: f64,
        /// When it happens again.
        recurrence: Recurrence,
    },
    /// A chipped blade: thrust is lost, and the rotor shakes the frame once a revolution.
    PropellerDamage {
        /// Share of the thrust that is lost, 0 to 1.
        loss: f64,
        /// Mass times its distance from the axis, kg m: the frame is shaken by this times the squared rotor speed, N.
        unbalance_kg_m: f64,
    },
    /// The battery's voltage falls with the thrust of all four rotors, and thrust with its square.
    BatterySag {
        /// Share of the voltage lost at full thrust of all rotors, 0 to 0.9.
        sag: f64,
    },
    /// The rotor turns backwards: thrust down instead of up, torque the other way round.
    Reversed {
        /// Thrust made downwards over the thrust commanded, 0 to 1; the torque goes with it.
        share: f64,
    },
    /// The commands of two rotors are exchanged: a wiring error, there from the start or not at all.
    Swapped,
}

/// When a drop-out happens again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Recurrence {
    /// Every so many seconds, from one start to the next, the first at the onset.
    Period {
        /// s.
        period_s: f64,
    },
    /// At random, so many a second while the motor runs.
    Rate {
        /// 1/s.
        rate_1_s: f64,
    },
}

/// One fault.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(try_from = "FaultKeys", into = "FaultKeys"))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Fault {
    /// What breaks.
    pub kind: FaultKind,
    /// The rotors it breaks.
    pub rotors: Rotors,
    /// Onset, s.
    pub from_s: f64,
    /// End, s.
    pub until_s: f64,
    /// Shape in between.
    pub profile: Profile,
    /// Whether the controller is told of it.
    pub reported: bool,
}

impl FaultKind {
    /// Share of the thrust that is lost at its worst, for kinds that take thrust and leave the rest.
    pub const fn loss(self) -> Option<f64> {
        match self {
            Self::LossOfEffectiveness { loss } | Self::PropellerDamage { loss, .. } => Some(loss),
            Self::Stopped | Self::Floating { .. } => Some(1.0),
            _ => None,
        }
    }

    /// Whether it can be there in part.
    pub const fn is_graded(self) -> bool {
        matches!(
            self,
            Self::LossOfEffectiveness { .. }
                | Self::SlowMotor { .. }
                | Self::CommandDelay { .. }
                | Self::CommandJitter { .. }
                | Self::PropellerDamage { .. }
                | Self::BatterySag { .. }
        )
    }

    /// Whether it decides the rotor's thrust, so that no other such fault can at the same time.
    pub const fn takes_over(self) -> bool {
        !self.is_graded() && !matches!(self, Self::Swapped)
    }

    /// Whether it says something of the share of its commanded thrust that a rotor still makes.
    pub const fn concerns_share(self) -> bool {
        !matches!(self, Self::SlowMotor { .. } | Self::CommandDelay { .. } | Self::CommandJitter { .. } | Self::Swapped)
    }

    /// Whether it is of a motor: of its lag, its limits or its speed.
    pub const fn needs_motor(self) -> bool {
        !matches!(self, Self::LossOfEffectiveness { .. } | Self::Swapped)
    }
}

impl Fault {
    /// Whether it is between onset and end at `t_s`.
    pub fn is_active(&self, t_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&t_s)
    }

    /// How much of it is there at `t_s`, 0..=1.
    ///
    /// - `drawn_on`: what was drawn for an intermittent fault; the other profiles do not ask.
    pub fn level(&self, t_s: f64, drawn_on: bool) -> f64 {
        if self.is_active(t_s) { self.profile.level(t_s - self.from_s, drawn_on) } else { 0.0 }
    }

    /// Whether both have a rotor in common at the same time.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.rotors.meets(other.rotors) && self.from_s < other.until_s && other.from_s < self.until_s
    }
}
