//! The pilot: sticks, switches and how old they are.
//!
//! ```text
//! x' = (|x| − d) / (1 − d)        shaped = sign(x) x' ((1 − e) + e x'²)
//! ```
//!
//! `d` is the dead band, `e` the expo. A frame that is not finite, or stamped too far from now on either side, is no frame: the
//! sticks are neutral, the switches keep what they last said, and nothing is chosen.
use crate::measurement::Stamped;
use crate::modes::Mode;
use crate::parameters::{Parameter, Parameters};

/// Sticks, each −1 to 1; the throttle 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sticks {
    /// To the right: roll right.
    pub right: f32,
    /// Pushed forward: nose down.
    pub forward: f32,
    /// Clockwise seen from above.
    pub clockwise: f32,
    /// Up.
    pub throttle: f32,
}

impl Sticks {
    /// Nobody touches them; the throttle, too, is in its middle.
    pub const NEUTRAL: Self = Self { right: 0.0, forward: 0.0, clockwise: 0.0, throttle: 0.5 };

    fn is_finite(&self) -> bool {
        [self.right, self.forward, self.clockwise, self.throttle].into_iter().all(f32::is_finite)
    }
}

/// One frame from the pilot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PilotInput {
    /// The sticks.
    pub sticks: Sticks,
    /// The arm switch.
    pub arm: bool,
    /// The mode switch.
    pub mode: Mode,
}

/// How sticks are read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    dead: f32,
    expo: f32,
    link_s: f32,
}

impl From<&Parameters> for Shape {
    fn from(parameters: &Parameters) -> Self {
        let p = |parameter| parameters[parameter];
        Self { dead: p(Parameter::StickDead), expo: p(Parameter::StickExpo), link_s: p(Parameter::FsLinkS) }
    }
}

impl Shape {
    /// A stick, shaped; −1 to 1.
    fn stick(&self, x: f32) -> f32 {
        let magnitude = ((x.abs() - self.dead) / (1.0 - self.dead)).clamp(0.0, 1.0);
        let shaped = magnitude * ((1.0 - self.expo) + self.expo * magnitude * magnitude);
        if x < 0.0 { -shaped } else { shaped }
    }
}

/// What the pilot says in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Shaped; the throttle as it is, 0 to 1.
    pub sticks: Sticks,
    /// The throttle as a stick with a centre, shaped: −1 to 1.
    pub climb: f32,
    /// The arm switch.
    pub arm: bool,
    /// Whether it went from off to on in this tick.
    pub arm_rose: bool,
    /// The mode switch.
    pub mode: Mode,
    /// Whether it moved in this tick.
    pub mode_moved: bool,
    /// Age of the frame, s; infinite if there is none.
    pub age_s: f32,
}

/// What the switches last said.
#[derive(Clone, Copy, Debug)]
pub struct Pilot {
    heard: bool,
    arm: bool,
    mode: Option<Mode>,
}

/// µs to s.
const S_PER_US: f32 = 1e-6;

/// Time from one stamp to the other, s; a stamp from the future is as strange as an old one, and as far.
pub(crate) fn age_s(now_us: u64, then_us: u64) -> f32 {
    now_us.abs_diff(then_us) as f32 * S_PER_US
}

impl Pilot {
    /// Before the first frame. The arm switch counts as on: one that is on at power-up has no edge.
    pub const UNHEARD: Self = Self { heard: false, arm: true, mode: None };

    /// Heard, armed, and in `mode`.
    pub(crate) fn flying(mode: Mode) -> Self {
        Self { heard: true, arm: true, mode: Some(mode) }
    }

    /// Takes the last frame that arrived.
    pub fn read(&mut self, shape: &Shape, frame: Option<&Stamped<PilotInput>>, now_us: u64) -> Reading {
        let frame = frame.filter(|frame| frame.value.sticks.is_finite());
        let age_s = frame.map_or(f32::INFINITY, |frame| age_s(now_us, frame.time_us));
        let before = *self;
        let mut sticks = Sticks::NEUTRAL;
        self.heard = age_s <= shape.link_s;
        if let Some(frame) = frame.filter(|_| self.heard) {
            (self.arm, self.mode) = (frame.value.arm, Some(frame.value.mode));
            sticks = frame.value.sticks;
        }
        let throttle = sticks.throttle.clamp(0.0, 1.0);
        Reading {
            sticks: Sticks {
                right: shape.stick(sticks.right),
                forward: shape.stick(sticks.forward),
                clockwise: shape.stick(sticks.clockwise),
                throttle,
            },
            climb: shape.stick(throttle + throttle - 1.0),
            arm: self.arm,
            // A switch that was thrown while nobody listened has no edge either.
            arm_rose: self.arm && !before.arm && before.heard,
            mode: self.mode.unwrap_or(Mode::Disarmed),
            mode_moved: before.mode.is_some() && self.mode != before.mode,
            age_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW_US: u64 = 10_000_000;

    fn shape() -> Shape {
        Shape::from(&Parameters::default())
    }

    fn frame(arm: bool, mode: Mode) -> Stamped<PilotInput> {
        Stamped { time_us: NOW_US, value: PilotInput { sticks: Sticks::NEUTRAL, arm, mode } }
    }

    #[test]
    fn sticks_are_shaped_through_a_dead_band_to_full_travel() {
        let shape = shape();
        for (x, want) in [(0.0, 0.0), (0.05, 0.0), (-0.05, 0.0), (1.0, 1.0), (-1.0, -1.0), (7.0, 1.0)] {
            assert!((shape.stick(x) - want).abs() < 1e-6, "{x}: {}", shape.stick(x));
        }
        let fine = shape.stick(0.3);
        assert!(fine > 0.0 && fine < 0.25, "finer about the centre: {fine}");
        let steps = (0..=100).map(|i| shape.stick(i as f32 / 100.0));
        assert!(steps.clone().zip(steps.skip(1)).all(|(a, b)| a <= b), "monotonic");
    }

    #[test]
    fn a_frame_that_is_old_from_the_future_or_not_finite_is_no_frame() {
        let pushed = Sticks { forward: 1.0, ..Sticks::NEUTRAL };
        let mut good = frame(true, Mode::Angle);
        good.value.sticks = pushed;
        let mut bad = good;
        bad.value.sticks.right = f32::NAN;
        let old = Stamped { time_us: NOW_US - 600_000, ..good };
        let future = Stamped { time_us: NOW_US + 600_000, ..good };
        for (why, frame, heard) in [
            ("good", Some(good), true),
            ("none", None, false),
            ("old", Some(old), false),
            ("from the future", Some(future), false),
            ("not a number", Some(bad), false),
        ] {
            let mut pilot = Pilot::UNHEARD;
            let reading = pilot.read(&shape(), frame.as_ref(), NOW_US);
            assert_eq!(reading.sticks.forward > 0.9, heard, "{why}");
            assert_eq!(reading.age_s < 0.5, heard, "{why}");
            assert!(heard || reading.climb == 0.0, "{why}: the throttle is neutral, too");
        }
    }

    #[test]
    fn switches_have_edges_only_where_they_were_seen_to_move() {
        let mut pilot = Pilot::UNHEARD;
        let mut read = |frame: Option<Stamped<PilotInput>>| {
            let reading = pilot.read(&shape(), frame.as_ref(), NOW_US);
            (reading.arm, reading.arm_rose, reading.mode_moved)
        };
        assert_eq!(read(Some(frame(true, Mode::Angle))), (true, false, false), "on at power-up");
        assert_eq!(read(Some(frame(false, Mode::Angle))), (false, false, false));
        assert_eq!(read(Some(frame(true, Mode::Angle))), (true, true, false));
        assert_eq!(read(Some(frame(true, Mode::Rate))), (true, false, true));
        assert_eq!(read(None), (true, false, false), "the link is lost: the switches stay");
        assert_eq!(read(Some(frame(true, Mode::Rate))), (true, false, false), "and comes back");
        assert_eq!(read(None), (true, false, false));
        assert_eq!(read(Some(frame(false, Mode::Angle))), (false, false, true), "moved meanwhile");
        assert_eq!(read(None), (false, false, false));
        assert_eq!(read(Some(frame(true, Mode::Angle))), (true, false, false), "thrown while nobody listened");
    }
}
