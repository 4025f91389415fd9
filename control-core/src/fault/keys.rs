//! A fault as files write it: its kind by name, and every key of any kind beside it.
//!
//! An error names the key, which a tagged enum inside a flattened table could not.
use super::check::{Allowed, FaultError, FaultValue};
use super::{Fault, FaultKind, Profile, Recurrence, Rotors};
use core::fmt;

/// What breaks, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum FaultName {
    /// A rotor makes only a share of its thrust: `loss`.
    LossOfEffectiveness,
    /// The motor stops.
    Stopped,
    /// The motor heeds no command: `thrust_n`, or the thrust it has.
    Stuck,
    /// The motor runs at its largest thrust.
    HardOver,
    /// The motor is not driven, and its rotor runs down freely: `spin_down_s`.
    Floating,
    /// The motor answers late: `lag_factor`, and `rate_n_s_max` if there is a limit.
    SlowMotor,
    /// Commands arrive late, by the same time each: `delay_s`.
    CommandDelay,
    /// Commands arrive late, each by another time: `delay_s_max`.
    CommandJitter,
    /// The speed controller loses the motor again and again: `dropout_s`, `restart_s`, and `period_s` or `rate_1_s`.
    EscDesync,
    /// A chipped blade, which shakes the frame: `loss` and `unbalance_kg_m`.
    PropellerDamage,
    /// The battery's voltage falls with the thrust of all rotors: `sag`.
    BatterySag,
    /// The rotor turns backwards: `share`.
    Reversed,
    /// The commands of two rotors are exchanged.
    Swapped,
}

impl FaultName {
    /// The name in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::LossOfEffectiveness => "loss_of_effectiveness",
            Self::Stopped => "stopped",
            Self::Stuck => "stuck",
            Self::HardOver => "hard_over",
            Self::Floating => "floating",
            Self::SlowMotor => "slow_motor",
            Self::CommandDelay => "command_delay",
            Self::CommandJitter => "command_jitter",
            Self::EscDesync => "esc_desync",
            Self::PropellerDamage => "propeller_damage",
            Self::BatterySag => "battery_sag",
            Self::Reversed => "reversed",
            Self::Swapped => "swapped",
        }
    }
}

impl fmt::Display for FaultName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FaultKind {
    /// Its name.
    pub const fn name(self) -> FaultName {
        match self {
            Self::LossOfEffectiveness { .. } => FaultName::LossOfEffectiveness,
            Self::Stopped => FaultName::Stopped,
            Self::Stuck { .. } => FaultName::Stuck,
            Self::HardOver => FaultName::HardOver,
            Self::Floating { .. } => FaultName::Floating,
            Self::SlowMotor { .. } => FaultName::SlowMotor,
            Self::CommandDelay { .. } => FaultName::CommandDelay,
            Self::CommandJitter { .. } => FaultName::CommandJitter,
            Self::EscDesync { .. } => FaultName::EscDesync,
            Self::PropellerDamage { .. } => FaultName::PropellerDamage,
            Self::BatterySag { .. } => FaultName::BatterySag,
            Self::Reversed { .. } => FaultName::Reversed,
            Self::Swapped => FaultName::Swapped,
        }
    }
}

/// Declares [`FaultKeys`] and the list of its parameters, so that no parameter can be forgotten in either.
macro_rules! fault_keys {
    ($($(#[doc = $doc:literal])+ $key:ident,)+) => {
        /// One fault. Which keys belong to it is decided by its kind.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
        #[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub struct FaultKeys {
            /// What breaks.
            pub kind: FaultName,
            /// The rotors it breaks, 1 to 4.
            pub rotors: Rotors,
            $(
                $(#[doc = $doc])+
                #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
                pub $key: Option<f64>,
            )+
            /// Onset, s.
            pub from_s: f64,
            /// End, s.
            pub until_s: f64,
            /// Shape in between.
            #[cfg_attr(feature = "serde", serde(default))]
            pub profile: Profile,
            /// Whether the controller is told of it; faults are silent unless they say so.
            #[cfg_attr(feature = "serde", serde(default))]
            pub reported: bool,
        }

        impl FaultKeys {
            /// Every parameter by name; none where it is left out.
            fn parameters(&self) -> impl Iterator<Item = (&'static str, Option<f64>)> {
                [$((stringify!($key), self.$key)),+].into_iter()
            }
        }

        impl From<Fault> for FaultKeys {
            fn from(fault: Fault) -> Self {
                let Fault { kind, rotors, from_s, until_s, profile, reported } = fault;
                let name = kind.name();
                let mut keys = Self { kind: name, rotors, $($key: None,)+ from_s, until_s, profile, reported };
                kind.write(&mut keys);
                keys
            }
        }
    };
}

fault_keys! {
    /// `loss_of_effectiveness`, `propeller_damage`: share of the thrust that is lost, 0 to 1.
    loss,
    /// `propeller_damage`: mass times its distance from the axis, kg m; times the squared rotor speed it shakes the frame, N.
    unbalance_kg_m,
    /// `stuck`: thrust it goes to, N; left out, it keeps the one it has at the onset.
    thrust_n,
    /// `floating`: time constant of the thrust's decay, s; longer than the motor's lag.
    spin_down_s,
    /// `slow_motor`: what the motor's time constant is multiplied by, 1 or more.
    lag_factor,
    /// `slow_motor`: largest change of thrust, N/s; left out, there is no limit.
    rate_n_s_max,
    /// `command_delay`: how late commands arrive, s.
    delay_s,
    /// `command_jitter`: bound of the delay, s, drawn evenly from zero on.
    delay_s_max,
    /// `esc_desync`: how long the motor is not driven, s.
    dropout_s,
    /// `esc_desync`: how long thrust is then limited by a ramp from nothing to the command, s.
    restart_s,
    /// `esc_desync`: time from one drop-out to the next, s; or `rate_1_s`.
    period_s,
    /// `esc_desync`: drop-outs at random, so many a second while the motor runs; or `period_s`.
    rate_1_s,
    /// `battery_sag`: share of the voltage lost at full thrust of all rotors, 0 to 0.9; thrust falls with its square.
    sag,
    /// `reversed`: thrust made downwards over the thrust commanded, 0 to 1.
    share,
}

impl FaultKind {
    /// Puts its parameters into `keys`.
    fn write(self, keys: &mut FaultKeys) {
        match self {
            Self::Stopped | Self::HardOver | Self::Swapped => {}
            Self::LossOfEffectiveness { loss } => keys.loss = Some(loss),
            Self::Stuck { thrust_n } => keys.thrust_n = thrust_n,
            Self::Floating { spin_down_s } => keys.spin_down_s = Some(spin_down_s),
            Self::SlowMotor { lag_factor, rate_n_s_max } => {
                keys.lag_factor = Some(lag_factor);
                keys.rate_n_s_max = rate_n_s_max;
            }
            Self::CommandDelay { delay_s } => keys.delay_s = Some(delay_s),
            Self::CommandJitter { delay_s_max } => keys.delay_s_max = Some(delay_s_max),
            Self::EscDesync { dropout_s, restart_s, recurrence } => {
                keys.dropout_s = Some(dropout_s);
                keys.restart_s = Some(restart_s);
                match recurrence {
                    Recurrence::Period { period_s } => keys.period_s = Some(period_s),
                    Recurrence::Rate { rate_1_s } => keys.rate_1_s = Some(rate_1_s),
                }
            }
            Self::PropellerDamage { loss, unbalance_kg_m } => {
                keys.loss = Some(loss);
                keys.unbalance_kg_m = Some(unbalance_kg_m);
            }
            Self::BatterySag { sag } => keys.sag = Some(sag),
            Self::Reversed { share } => keys.share = Some(share),
        }
    }

    /// The kind that `keys` name, with the parameters it needs.
    fn read(keys: &FaultKeys) -> Result<Self, FaultError> {
        let need = |key: &'static str, value: Option<f64>| {
            let (value_found, allowed) = (FaultValue::Word("nothing"), Allowed::GivenWith(keys.kind.as_str()));
            value.ok_or(FaultError { key, value: value_found, allowed })
        };
        Ok(match keys.kind {
            FaultName::LossOfEffectiveness => Self::LossOfEffectiveness { loss: need("loss", keys.loss)? },
            FaultName::Stopped => Self::Stopped,
            FaultName::Stuck => Self::Stuck { thrust_n: keys.thrust_n },
            FaultName::HardOver => Self::HardOver,
            FaultName::Floating => Self::Floating { spin_down_s: need("spin_down_s", keys.spin_down_s)? },
            FaultName::SlowMotor => {
                Self::SlowMotor { lag_factor: need("lag_factor", keys.lag_factor)?, rate_n_s_max: keys.rate_n_s_max }
            }
            FaultName::CommandDelay => Self::CommandDelay { delay_s: need("delay_s", keys.delay_s)? },
            FaultName::CommandJitter => Self::CommandJitter { delay_s_max: need("delay_s_max", keys.delay_s_max)? },
            FaultName::EscDesync => Self::EscDesync {
                dropout_s: need("dropout_s", keys.dropout_s)?,
                restart_s: need("restart_s", keys.restart_s)?,
                recurrence: match (keys.period_s, keys.rate_1_s) {
                    (None, Some(rate_1_s)) => Recurrence::Rate { rate_1_s },
                    (period_s, _) => Recurrence::Period { period_s: need("period_s or rate_1_s", period_s)? },
                },
            },
            FaultName::PropellerDamage => Self::PropellerDamage {
                loss: need("loss", keys.loss)?,
                unbalance_kg_m: need("unbalance_kg_m", keys.unbalance_kg_m)?,
            },
            FaultName::BatterySag => Self::BatterySag { sag: need("sag", keys.sag)? },
            FaultName::Reversed => Self::Reversed { share: need("share", keys.share)? },
            FaultName::Swapped => Self::Swapped,
        })
    }
}

impl TryFrom<FaultKeys> for Fault {
    type Error = FaultError;

    /// # Errors
    /// A key that the kind needs and that is left out, or one that it does not have.
    fn try_from(keys: FaultKeys) -> Result<Self, FaultError> {
        let FaultKeys { rotors, from_s, until_s, profile, reported, .. } = keys;
        let fault = Self { kind: FaultKind::read(&keys)?, rotors, from_s, until_s, profile, reported };
        let known = FaultKeys::from(fault);
        for ((key, given), (_, known)) in keys.parameters().zip(known.parameters()) {
            if let (Some(value), None) = (given, known) {
                let (value, allowed) = (FaultValue::Number(value), Allowed::LeftOutWith(keys.kind.as_str()));
                return Err(FaultError { key, value, allowed });
            }
        }
        Ok(fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    /// Every kind, each parameter another number.
    const KINDS: [FaultKind; 15] = [
        FaultKind::LossOfEffectiveness { loss: 1.0 },
        FaultKind::Stopped,
        FaultKind::Stuck { thrust_n: None },
        FaultKind::Stuck { thrust_n: Some(2.0) },
        FaultKind::HardOver,
        FaultKind::Floating { spin_down_s: 3.0 },
        FaultKind::SlowMotor { lag_factor: 4.0, rate_n_s_max: Some(5.0) },
        FaultKind::CommandDelay { delay_s: 6.0 },
        FaultKind::CommandJitter { delay_s_max: 7.0 },
        FaultKind::EscDesync { dropout_s: 8.0, restart_s: 9.0, recurrence: Recurrence::Period { period_s: 10.0 } },
        FaultKind::EscDesync { dropout_s: 8.0, restart_s: 9.0, recurrence: Recurrence::Rate { rate_1_s: 11.0 } },
        FaultKind::PropellerDamage { loss: 12.0, unbalance_kg_m: 13.0 },
        FaultKind::BatterySag { sag: 14.0 },
        FaultKind::Reversed { share: 15.0 },
        FaultKind::Swapped,
    ];

    fn fault(kind: FaultKind) -> Fault {
        Fault { kind, rotors: Rotors::ALL, from_s: 1.0, until_s: 2.0, profile: Profile::Step, reported: true }
    }

    #[test]
    fn every_kind_is_written_and_read_back() {
        for kind in KINDS {
            let keys = FaultKeys::from(fault(kind));
            assert_eq!(Fault::try_from(keys), Ok(fault(kind)));
        }
    }

    #[test]
    fn keys_of_other_kinds_and_missing_keys_are_refused_by_name() {
        let stopped = FaultKeys::from(fault(FaultKind::Stopped));
        let desync = FaultKeys::from(fault(KINDS[9]));
        for (keys, says) in [
            (FaultKeys { loss: Some(0.4), ..stopped }, "loss = 0.4: must be left out with the kind `stopped`"),
            (
                FaultKeys { kind: FaultName::BatterySag, ..stopped },
                "sag = nothing: must be given with the kind `battery_sag`",
            ),
            (FaultKeys { rate_1_s: Some(2.0), ..desync }, "rate_1_s = 2: must be left out"),
            (FaultKeys { period_s: None, ..desync }, "period_s or rate_1_s = nothing: must be given"),
        ] {
            let line = Fault::try_from(keys).expect_err("it is refused").to_string();
            assert!(line.contains(says), "`{says}` is not in: {line}");
        }
    }
}
