//! Motor test: one rotor after the other on the bench, at a little thrust, for people to look at.
//!
//! The wiring check (`wiring.rs`) finds out by itself which rotor answers; this one shows. It ends when its time is up or the
//! machine moves: then it is not on a bench.
//!
//! Invariants: at most one rotor turns, at no more than [`SHARE_MAX`], no longer than [`SECONDS_MAX`]; once ended, none, for good.
use crate::frames::{Body, Vec3};

/// Largest command, share of full.
pub const SHARE_MAX: f32 = 0.25;
/// Longest turn of a rotor, s.
pub const SECONDS_MAX: f32 = 10.0;
/// Pause before the next rotor, s.
pub const PAUSE_S: f32 = 0.5;
/// Body rate that ends the test, rad/s.
pub const MOVES_RAD_S: f32 = 0.5;

/// What is to be tested.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorTestOrder {
    /// Rotor 0 to 3; all in turn if there is none.
    pub rotor: Option<usize>,
    /// Command, share of full; held within 0 and [`SHARE_MAX`].
    pub share: f32,
    /// How long each turns, s; held within 0 and [`SECONDS_MAX`].
    pub seconds: f32,
}

/// Whose turn it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Turn(usize),
    Pause(usize),
    Done,
}

/// Everything a change of phase depends on, sampled once per tick.
#[derive(Clone, Copy)]
struct Facts {
    moves: bool,
    time_is_up: bool,
    /// The last rotor of the order.
    last: usize,
}

impl Phase {
    /// The next phase. Total: first matching row wins, otherwise stay.
    fn next(self, facts: Facts) -> Self {
        match self {
            _ if facts.moves => Self::Done,
            Self::Turn(rotor) if facts.time_is_up && rotor >= facts.last => Self::Done,
            Self::Turn(rotor) if facts.time_is_up => Self::Pause(rotor),
            Self::Pause(rotor) if facts.time_is_up => Self::Turn(rotor + 1),
            stay => stay,
        }
    }
}

/// One test, from its first tick to its end.
#[derive(Clone, Copy, Debug)]
pub struct MotorTest {
    phase: Phase,
    elapsed_s: f32,
    share: f32,
    seconds: f32,
    last: usize,
}

impl MotorTest {
    /// A test about to begin.
    pub fn new(order: &MotorTestOrder) -> Self {
        let within = |x: f32, most: f32| if x > 0.0 { x.min(most) } else { 0.0 };
        Self {
            phase: Phase::Turn(order.rotor.unwrap_or(0).min(3)),
            elapsed_s: 0.0,
            share: within(order.share, SHARE_MAX),
            seconds: within(order.seconds, SECONDS_MAX),
            last: order.rotor.unwrap_or(3).min(3),
        }
    }

    /// Takes a sample and gives the command of each motor, share of full, in airframe order.
    pub fn tick(&mut self, rate_rad_s: Vec3<Body>, dt_s: f32) -> [f32; 4] {
        self.elapsed_s = (self.elapsed_s + dt_s).min(SECONDS_MAX);
        let span_s = if matches!(self.phase, Phase::Pause(_)) { PAUSE_S } else { self.seconds };
        let still = rate_rad_s.norm_squared() < MOVES_RAD_S * MOVES_RAD_S;
        let facts = Facts { moves: !still, time_is_up: self.elapsed_s >= span_s, last: self.last };
        let next = self.phase.next(facts);
        if next != self.phase {
            self.elapsed_s = 0.0;
        }
        self.phase = next;
        core::array::from_fn(|i| if next == Phase::Turn(i) { self.share } else { 0.0 })
    }

    /// Whether it is over.
    pub fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }
}
