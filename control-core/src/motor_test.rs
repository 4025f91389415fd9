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

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f32 = 0.01;

    /// Which rotor turned when, as runs of (rotor, ticks); 4 for none.
    fn runs(order: &MotorTestOrder, rate: impl Fn(usize) -> f32) -> std::vec::Vec<(usize, usize)> {
        let mut test = MotorTest::new(order);
        let mut runs = std::vec::Vec::<(usize, usize)>::new();
        for tick in 0..5000 {
            let motors = test.tick(Vec3::new(0.0, rate(tick), 0.0), DT_S);
            assert!(motors.iter().all(|share| (0.0..=SHARE_MAX).contains(share)));
            let turning = motors.iter().filter(|&&share| share > 0.0).count();
            assert!(turning <= 1, "one at a time");
            let rotor = motors.iter().position(|&share| share > 0.0).unwrap_or(4);
            match runs.last_mut() {
                Some((last, ticks)) if *last == rotor => *ticks += 1,
                _ => runs.push((rotor, 1)),
            }
        }
        assert!(test.is_done());
        runs
    }

    #[test]
    fn phases_follow_the_table() {
        use Phase::{Done, Pause, Turn};
        let calm = Facts { moves: false, time_is_up: false, last: 3 };
        let late = Facts { time_is_up: true, ..calm };
        for (why, from, facts, want) in [
            ("a turn lasts", Turn(0), calm, Turn(0)),
            ("a pause follows", Turn(0), late, Pause(0)),
            ("the next follows the pause", Pause(0), late, Turn(1)),
            ("the last ends it", Turn(3), late, Done),
            ("a machine that moves ends it", Turn(0), Facts { moves: true, ..calm }, Done),
            ("in a pause too", Pause(2), Facts { moves: true, ..calm }, Done),
            ("the end stays", Done, late, Done),
        ] {
            assert_eq!(from.next(facts), want, "{why}");
        }
    }

    #[test]
    fn rotors_turn_in_order_or_one_alone() {
        let all = MotorTestOrder { rotor: None, share: 0.1, seconds: 1.0 };
        let turned: std::vec::Vec<_> = runs(&all, |_| 0.0).into_iter().map(|(rotor, _)| rotor).collect();
        assert_eq!(turned, [0, 4, 1, 4, 2, 4, 3, 4]);
        let one = runs(&MotorTestOrder { rotor: Some(2), ..all }, |_| 0.0);
        assert!(one[0].0 == 2 && one[0].1.abs_diff(100) <= 1 && one[1].0 == 4 && one.len() == 2, "{one:?}");
    }

    #[test]
    fn an_order_beyond_the_limits_is_held_within_them() {
        let wild = MotorTestOrder { rotor: Some(9), share: 7.0, seconds: f32::INFINITY };
        let one = runs(&wild, |_| 0.0);
        assert!(one[0].0 == 3 && one[0].1 <= 1001, "{one:?}");
        let nothing = MotorTestOrder { rotor: Some(0), share: f32::NAN, seconds: f32::NAN };
        assert_eq!(runs(&nothing, |_| 0.0), [(4, 5000)]);
    }

    #[test]
    fn it_ends_when_the_machine_moves_or_the_gyro_fails() {
        let order = MotorTestOrder { rotor: Some(0), share: 0.2, seconds: 5.0 };
        for bad in [0.6, f32::NAN, f32::INFINITY] {
            let one = runs(&order, |tick| if tick == 50 { bad } else { 0.0 });
            assert_eq!(one[0], (0, 50), "{bad}");
        }
    }
}
