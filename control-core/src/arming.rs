//! Arming: what must be so before the rotors turn, and what makes them stop.
//!
//! | from     | to       | when                                                              |
//! |----------|----------|-------------------------------------------------------------------|
//! | disarmed | armed    | the arm switch goes from off to on, and no check fails            |
//! | armed    | disarmed | the switch is off; a failsafe terminates; it has come down        |
//!
//! Only an edge of the switch arms: not power-up with the switch on, not the link coming back, not a check that passes at last, and
//! nothing after a failsafe but a pilot who switches off and on.
use crate::GRAVITY_M_S2;
use crate::frames::{Body, Vec3};
use crate::modes::{Level, Mode};
use crate::parameters::{Parameter, Parameters};
use crate::set::{Member, Set};
use core::fmt;

/// Largest body rate of a machine that is still, rad/s: ten standard deviations of a gyro's noise.
pub const STILL_RAD_S: f32 = 0.1;
/// Largest difference of the felt force from 1 g, m/s².
pub const FORCE_M_S2: f32 = 1.0;
/// Throttle that is low.
pub const THROTTLE_LOW: f32 = 0.05;

macro_rules! checks {
    ($($id:ident $text:literal, $passes:expr;)+) => {
        /// What arming asks for, named by what is wrong if it is refused.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Check { $(#[doc = $text] $id),+ }

        impl Member for Check {
            const ALL: &'static [Self] = &[$(Self::$id),+];

            fn index(self) -> usize {
                self as usize
            }
        }

        impl Check {
            /// What is wrong, for people.
            pub fn text(self) -> &'static str {
                match self { $(Self::$id => $text),+ }
            }

            fn passes(self, facts: &Facts, limits: &Limits) -> bool {
                let passes: fn(&Facts, &Limits) -> bool = match self { $(Self::$id => $passes),+ };
                passes(facts, limits)
            }
        }

        impl fmt::Display for Check {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.text())
            }
        }
    };
}

// Each condition says what must be so: a value that is not a number fails.
checks! {
    Link "the pilot is not heard", |f, l| f.link_age_s <= l.link_s;
    Throttle "the throttle is not low", |f, _| f.climbs_by_itself() || f.throttle < THROTTLE_LOW;
    Mode "the mode switch is in a mode that does not take off", |f, _| f.mode != Mode::Disarmed && !f.mode.comes_down();
    Parameters "the stored parameters were not all valid", |f, _| f.parameters_valid;
    SelfTest "a self-test has failed", |f, _| f.self_test_passed;
    GyroCalibrated "the gyro is not calibrated", |f, _| f.gyro_calibrated;
    GyroStill "the machine moves", |f, _| f.rate_rad_s.norm_squared() < STILL_RAD_S * STILL_RAD_S;
    Level "the accelerometer does not feel level ground", |f, l| f.feels_one_g() && f.leans_less(l.upright);
    Estimate "the estimate is not healthy enough for the mode", |f, _| f.level >= f.mode.needs();
    Battery "the battery is low, or not measured",
        |f, l| (!l.has_battery || f.cell_v.is_some_and(|v| v > l.cell_low_v))
            && (f.used_as <= l.used_as || l.used_as == f32::INFINITY);
    Motors "the wiring check has not passed", |f, l| !l.motors || f.wiring_passed;
    Bench "a test on the bench is running", |f, _| !f.on_bench;
    Late "the control loop is late", |f, _| !f.late;
}

/// Everything the checks look at, sampled once per tick.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "independent facts, each read by name")]
pub struct Facts {
    /// Age of the pilot's last word, s.
    pub link_age_s: f32,
    /// The throttle, 0 to 1.
    pub throttle: f32,
    /// The mode switch.
    pub mode: Mode,
    /// Whether every stored parameter was in its range.
    pub parameters_valid: bool,
    /// Whether every self-test has passed.
    pub self_test_passed: bool,
    /// Whether the gyro's bias is known.
    pub gyro_calibrated: bool,
    /// Body rates, bias taken off, rad/s.
    pub rate_rad_s: Vec3<Body>,
    /// Specific force, m/s².
    pub force_m_s2: Vec3<Body>,
    /// What of the estimate is flown on.
    pub level: Level,
    /// Voltage of a cell, if somebody measures it, V.
    pub cell_v: Option<f32>,
    /// Charge taken from the battery since the machine was switched on, A s.
    pub used_as: f32,
    /// Whether the wiring check has passed since power-up.
    pub wiring_passed: bool,
    /// Whether the bench has the motors.
    pub on_bench: bool,
    /// Whether the last step came late.
    pub late: bool,
}

/// What the checks compare with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Oldest word of the pilot, s.
    pub link_s: f32,
    /// Cosine of the largest tilt of the ground.
    pub upright: f32,
    /// Whether there is a battery to look at.
    pub has_battery: bool,
    /// Voltage of a cell that is low, V.
    pub cell_low_v: f32,
    /// Charge of the battery that may be used, A s; infinite if nobody minds.
    pub used_as: f32,
    /// Whether the wiring check is asked for.
    pub motors: bool,
}

impl From<&Parameters> for Limits {
    fn from(parameters: &Parameters) -> Self {
        let p = |parameter| parameters[parameter];
        Self {
            link_s: p(Parameter::FsLinkS),
            upright: crate::math::cos(parameters.rad(Parameter::ArmTilt)),
            has_battery: p(Parameter::BatCells) > 0.0,
            cell_low_v: p(Parameter::BatLowV),
            used_as: parameters.battery_use_as(),
            motors: p(Parameter::ArmMotors) > 0.5,
        }
    }
}

impl Facts {
    /// Every check that fails.
    // Not inlined: `cargo fw` knows by its name where it calls through pointers.
    #[inline(never)]
    pub fn failing(&self, limits: &Limits) -> Set<Check> {
        Check::ALL.iter().copied().filter(|check| !check.passes(self, limits)).collect()
    }

    /// Whether the mode leaves the ground whatever the throttle says.
    fn climbs_by_itself(&self) -> bool {
        matches!(self.mode, Mode::TakeOff | Mode::Offboard)
    }

    /// Whether the felt force points up to within an angle of this cosine.
    fn leans_less(&self, upright: f32) -> bool {
        let up = -self.force_m_s2.z;
        up > 0.0 && up * up > upright * upright * self.force_m_s2.norm_squared()
    }

    fn feels_one_g(&self) -> bool {
        let (low, high) = (GRAVITY_M_S2 - FORCE_M_S2, GRAVITY_M_S2 + FORCE_M_S2);
        let square = self.force_m_s2.norm_squared();
        square > low * low && square < high * high
    }
}

/// Whether the rotors are let turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arming {
    /// They stand.
    Disarmed,
    /// They turn.
    Armed,
}

/// What arming depends on, sampled once per tick.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "independent facts, each read by name")]
pub struct Moment {
    /// The arm switch.
    pub switch: bool,
    /// Whether it went from off to on in this tick.
    pub switch_rose: bool,
    /// Whether no check fails.
    pub ready: bool,
    /// Whether a failsafe stops the rotors.
    pub terminate: bool,
    /// Whether it stands on the ground in a mode that comes down.
    pub down: bool,
}

impl Arming {
    /// The next state. Total: first matching row wins, otherwise stay.
    #[must_use]
    pub fn next(self, moment: &Moment) -> Self {
        match self {
            Self::Disarmed if moment.switch_rose && moment.ready => Self::Armed,
            Self::Armed if !moment.switch || moment.terminate || moment.down => Self::Disarmed,
            stay => stay,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    fn good() -> Facts {
        Facts {
            link_age_s: 0.02,
            throttle: 0.0,
            mode: Mode::PositionHold,
            parameters_valid: true,
            self_test_passed: true,
            gyro_calibrated: true,
            rate_rad_s: Vec3::zero(),
            force_m_s2: Vec3::new(0.0, 0.0, -GRAVITY_M_S2),
            level: Level::Position,
            cell_v: Some(4.0),
            used_as: 3_000.0,
            wiring_passed: true,
            on_bench: false,
            late: false,
        }
    }

    fn limits() -> Limits {
        let mut parameters = Parameters::default();
        for (name, value) in [("ARM_MOTORS", 1.0), ("BAT_CELLS", 4.0), ("BAT_USE_MAX", 1_000.0)] {
            parameters.set(name, value).expect("in its range");
        }
        Limits::from(&parameters)
    }

    #[test]
    fn every_check_fails_alone_and_says_why() {
        assert!(good().failing(&limits()).is_empty());
        let leaning = Vec3::new(GRAVITY_M_S2 * 0.5, 0.0, -GRAVITY_M_S2 * 0.866);
        let cases: [(Check, Facts); 24] = [
            (Check::Link, Facts { link_age_s: 0.6, ..good() }),
            (Check::Link, Facts { link_age_s: f32::INFINITY, ..good() }),
            (Check::Link, Facts { link_age_s: f32::NAN, ..good() }),
            (Check::Throttle, Facts { throttle: 0.1, ..good() }),
            (Check::Throttle, Facts { throttle: f32::NAN, ..good() }),
            (Check::Mode, Facts { mode: Mode::Land, ..good() }),
            (Check::Mode, Facts { mode: Mode::Disarmed, ..good() }),
            (Check::Parameters, Facts { parameters_valid: false, ..good() }),
            (Check::SelfTest, Facts { self_test_passed: false, ..good() }),
            (Check::GyroCalibrated, Facts { gyro_calibrated: false, ..good() }),
            (Check::GyroStill, Facts { rate_rad_s: Vec3::new(0.0, 0.2, 0.0), ..good() }),
            (Check::GyroStill, Facts { rate_rad_s: Vec3::new(f32::NAN, 0.0, 0.0), ..good() }),
            (Check::Level, Facts { force_m_s2: leaning, ..good() }),
            (Check::Level, Facts { force_m_s2: Vec3::new(0.0, 0.0, GRAVITY_M_S2), ..good() }),
            (Check::Level, Facts { force_m_s2: Vec3::new(0.0, 0.0, -12.0), ..good() }),
            (Check::Level, Facts { force_m_s2: Vec3::new(f32::NAN, 0.0, -GRAVITY_M_S2), ..good() }),
            (Check::Estimate, Facts { level: Level::Altitude, ..good() }),
            (Check::Battery, Facts { cell_v: Some(3.4), ..good() }),
            (Check::Battery, Facts { cell_v: None, ..good() }),
            (Check::Battery, Facts { used_as: 3_601.0, ..good() }),
            (Check::Battery, Facts { used_as: f32::NAN, ..good() }),
            (Check::Motors, Facts { wiring_passed: false, ..good() }),
            (Check::Bench, Facts { on_bench: true, ..good() }),
            (Check::Late, Facts { late: true, ..good() }),
        ];
        for (check, facts) in cases {
            assert!(facts.failing(&limits()).iter().eq([check]), "{check}: {facts:?}");
        }
        assert!(Check::ALL.iter().all(|check| cases.iter().any(|(tried, _)| tried == check)), "every check is tried");
    }

    #[test]
    fn a_refusal_names_every_failing_check() {
        let facts = Facts { throttle: 0.5, gyro_calibrated: false, link_age_s: 9.0, ..good() };
        let text = facts.failing(&limits()).to_string();
        assert_eq!(text, "the pilot is not heard; the throttle is not low; the gyro is not calibrated");
    }

    #[test]
    fn what_nobody_asks_for_is_not_checked() {
        let limits = Limits::from(&Parameters::default());
        let facts = Facts { cell_v: None, used_as: f32::NAN, wiring_passed: false, ..good() };
        assert!(facts.failing(&limits).is_empty());
        let by_itself = Facts { throttle: 0.5, mode: Mode::TakeOff, ..good() };
        assert!(by_itself.failing(&limits).is_empty(), "take-off does not look at the throttle");
    }

    #[test]
    fn arming_follows_the_table() {
        use Arming::{Armed, Disarmed};
        let good = Moment { switch: true, switch_rose: true, ready: true, terminate: false, down: false };
        let on = Moment { switch_rose: false, ..good };
        for (why, from, moment, want) in [
            ("arms when all is well", Disarmed, good, Armed),
            ("switch on at power-up", Disarmed, on, Disarmed),
            ("a check fails", Disarmed, Moment { ready: false, ..good }, Disarmed),
            ("a check that passes at last does not arm", Disarmed, on, Disarmed),
            ("stays armed", Armed, on, Armed),
            ("checks are not made in the air", Armed, Moment { ready: false, ..on }, Armed),
            ("the switch disarms", Armed, Moment { switch: false, ..on }, Disarmed),
            ("a failsafe terminates", Armed, Moment { terminate: true, ..on }, Disarmed),
            ("it has come down", Armed, Moment { down: true, ..on }, Disarmed),
            ("after a failsafe nothing re-arms but an edge", Disarmed, on, Disarmed),
        ] {
            assert_eq!(from.next(&moment), want, "{why}");
        }
    }
}
