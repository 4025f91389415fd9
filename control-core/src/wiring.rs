//! Wiring check: on the ground, each rotor pulls a little in turn, and the gyro says which corner rose.
//!
//! ```text
//! told:   1 ▔▔▔╲____  2 ▔▔▔╲____  3 ▔▔▔╲____  4 ▔▔▔╲____ ► verdict
//! tilt:     ╱▔▔╲        ╱▔▔╲        ╱▔▔╲        ╱▔▔╲         a = (∫pulse ω dt − ∫pause ω dt) / 2
//! ```
//!
//! | symbol | code                           | unit |
//! |--------|--------------------------------|------|
//! | ω      | `rate_rad_s`, roll and pitch   | rad/s |
//! | a      | `WiringCheck::tilts_rad`       | rad  |
//!
//! The feet give way under a rotor that pulls below lift-off: its own corner rises, along r × F = (−right, forward) of its
//! arm, and sinks back in the pause. The pause counts against the pulse, so a constant bias of the gyro cancels. The rotor
//! whose arm the tilt is closest to is the one that answered. If that is the one told, four times, the wiring is right.
//!
//! Assumed: four feet below the rotors that sink 1 mm or more under the weight, a motor lag below a quarter of a pulse,
//! gyro noise of 0.01 rad/s at 500 Hz, still air. With the 5 mm of the simulated feet a healthy rotor tilts by 8.6 mrad; the
//! noise of `a` is 0.16 mrad, so that taking one rotor for another takes 38 standard deviations. Measured: with ten times
//! the noise no verdict of 2400 changes, with fifteen times 2 % of sound machines are refused and no swap passes. What it
//! cannot tell: how strong a rotor is, its sense of rotation, and two facing rotors both reversed from the same two swapped.
//!
//! Invariants: at most one rotor above idle; once there is a verdict, none, for good. A sample that is not finite never
//! passes.
use crate::Airframe;
use crate::frames::{Body, Vec3};
use core::array::from_fn;
use core::fmt;

/// Thrust of a pulse over the weight. It takes three quarters of itself off the rotor's own foot, a half by tilt and a
/// quarter by rise: that foot, which bears a quarter of the weight, leaves the ground at a third. The machine tips at half.
/// The weakest rotor that is flown can pull 0.26.
pub const PULSE_WEIGHT_SHARE: f32 = 0.2;
/// Length of a pulse, and of the pause after it, s: twelve lags of the usual motor and the feet's oscillation have passed.
pub const PULSE_S: f32 = 0.25;
/// Tilt below which a rotor has not answered, rad: six standard deviations of the noise, a ninth of what is usual.
pub const TILT_RAD_MIN: f32 = 1e-3;
/// Tilt that ends the check, rad: 3 degrees, six times what is usual.
pub const TILT_RAD_MAX: f32 = 0.05;
/// Longest time between samples, s: a fifth of a pulse.
pub const SAMPLE_S_MAX: f32 = 0.05;

/// What is wrong, of rotors 1 to 4.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WiringFault {
    /// The machine tilts as if another rotor pulled: they are swapped.
    AnswersAs {
        /// The rotor that was told to pull.
        told: usize,
        /// The rotor that seems to.
        answers: usize,
    },
    /// The rotor pushes down.
    Reversed {
        /// The rotor.
        rotor: usize,
    },
    /// The machine does not tilt.
    Silent {
        /// The rotor.
        rotor: usize,
    },
    /// The machine tilts more than a pulse can make it: [`TILT_RAD_MAX`].
    Tipping {
        /// The rotor whose turn it was.
        rotor: usize,
    },
    /// A sample was not finite, or came later than [`SAMPLE_S_MAX`].
    BadSample {
        /// The rotor whose turn it was.
        rotor: usize,
    },
}

impl fmt::Display for WiringFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AnswersAs { told, answers } => write!(f, "rotor {told} answers as rotor {answers}"),
            Self::Reversed { rotor } => write!(f, "rotor {rotor} is reversed"),
            Self::Silent { rotor } => write!(f, "rotor {rotor} does not answer"),
            Self::Tipping { rotor } => write!(f, "the machine tips while rotor {rotor} is checked"),
            Self::BadSample { rotor } => write!(f, "the gyro fails while rotor {rotor} is checked"),
        }
    }
}

impl core::error::Error for WiringFault {}

/// Whose turn it is, by index.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Pulse(usize),
    Pause(usize),
    Done(Result<(), WiringFault>),
}

/// Everything a change of phase depends on, sampled once per tick.
#[derive(Clone, Copy)]
struct Facts {
    sample_is_good: bool,
    tips: bool,
    time_is_up: bool,
    /// What all tilts so far say.
    verdict: Result<(), WiringFault>,
}

impl Phase {
    /// The next phase. Total: first matching row wins, otherwise stay.
    fn next(self, facts: Facts) -> Self {
        match self {
            Self::Pulse(i) | Self::Pause(i) if !facts.sample_is_good => {
                Self::Done(Err(WiringFault::BadSample { rotor: i + 1 }))
            }
            Self::Pulse(i) | Self::Pause(i) if facts.tips => Self::Done(Err(WiringFault::Tipping { rotor: i + 1 })),
            Self::Pulse(i) if facts.time_is_up => Self::Pause(i),
            Self::Pause(i) if facts.time_is_up && i < 3 => Self::Pulse(i + 1),
            Self::Pause(_) if facts.time_is_up => Self::Done(facts.verdict),
            stay => stay,
        }
    }
}

/// Roll and pitch, in any unit.
type RollPitch = [f32; 2];

fn dot(a: RollPitch, b: RollPitch) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}

/// One check of one machine, from its first tick to its verdict.
#[derive(Clone, Copy, Debug)]
pub struct WiringCheck {
    /// Which way each rotor tilts the machine.
    axes: [RollPitch; 4],
    idle_n: f32,
    pulse_n: [f32; 4],
    phase: Phase,
    /// Time in this phase, s.
    elapsed_s: f32,
    /// Tilt since the rotor's pulse began, rad.
    tilt_rad: RollPitch,
    /// What each rotor did.
    tilts_rad: [RollPitch; 4],
}

impl WiringCheck {
    /// A check about to begin, of a machine that stands still on its feet.
    pub fn new(airframe: &Airframe) -> Self {
        let idle_n = airframe.thrust_n_min;
        let pulse_n = idle_n + PULSE_WEIGHT_SHARE * airframe.weight_n();
        Self {
            axes: airframe.rotors.map(|rotor| [-rotor.right_m, rotor.forward_m]),
            idle_n,
            pulse_n: airframe.rotors.map(|rotor| pulse_n.min(rotor.thrust_n_max)),
            phase: Phase::Pulse(0),
            elapsed_s: 0.0,
            tilt_rad: [0.0; 2],
            tilts_rad: [[0.0; 2]; 4],
        }
    }

    /// Takes a sample and gives the thrust of each rotor, N, in airframe order.
    ///
    /// - `rate_rad_s`: what the gyro reads.
    /// - `dt_s`: time since the last sample; above 0 and at most [`SAMPLE_S_MAX`], or the check ends.
    pub fn tick(&mut self, rate_rad_s: Vec3<Body>, dt_s: f32) -> [f32; 4] {
        let turned_rad = [rate_rad_s.x * dt_s, rate_rad_s.y * dt_s];
        let sample_is_good = dt_s > 0.0 && dt_s <= SAMPLE_S_MAX && rate_rad_s.norm_squared().is_finite();
        if sample_is_good {
            self.note(turned_rad, dt_s);
        }
        let next = self.phase.next(Facts {
            sample_is_good,
            tips: dot(self.tilt_rad, self.tilt_rad) > TILT_RAD_MAX * TILT_RAD_MAX,
            time_is_up: self.elapsed_s >= PULSE_S,
            verdict: self.judge(),
        });
        if next != self.phase {
            self.elapsed_s = 0.0;
        }
        if let Phase::Pulse(_) = next
            && next != self.phase
        {
            self.tilt_rad = [0.0; 2];
        }
        self.phase = next;
        from_fn(|i| if next == Phase::Pulse(i) { self.pulse_n[i] } else { self.idle_n })
    }

    /// Whether every rotor is where it should be; none while the check goes on.
    pub fn verdict(&self) -> Option<Result<(), WiringFault>> {
        match self.phase {
            Phase::Done(verdict) => Some(verdict),
            _ => None,
        }
    }

    /// Adds what the machine turned by to the tilt, and to what is known of the rotor whose turn it is.
    fn note(&mut self, turned_rad: RollPitch, dt_s: f32) {
        let (rotor, half) = match self.phase {
            Phase::Pulse(i) => (i, 0.5),
            Phase::Pause(i) => (i, -0.5),
            Phase::Done(_) => return,
        };
        self.elapsed_s += dt_s;
        let tilts_rad = &mut self.tilts_rad[rotor % 4];
        for (axis, turned_rad) in turned_rad.into_iter().enumerate() {
            self.tilt_rad[axis] += turned_rad;
            tilts_rad[axis] += half * turned_rad;
        }
    }

    /// How well `tilt_rad` points the way rotor `i` tilts: its length squared times the cosine squared, with the cosine's sign.
    fn likeness(&self, tilt_rad: RollPitch, i: usize) -> f32 {
        let axis = self.axes[i];
        let along = dot(tilt_rad, axis);
        along * along.abs() / dot(axis, axis)
    }

    /// The rotor that tilts the machine most nearly like this; none if it does not tilt.
    fn answer(&self, tilt_rad: RollPitch) -> Option<usize> {
        let best = (0..4).map(|i| (i, self.likeness(tilt_rad, i))).reduce(|a, b| if b.1 > a.1 { b } else { a });
        best.map(|(i, _)| i).filter(|_| dot(tilt_rad, tilt_rad) >= TILT_RAD_MIN * TILT_RAD_MIN)
    }

    /// The first thing wrong with the tilts. A rotor that tilts the machine the opposite way is reversed, unless the
    /// facing one does so too: then the two are swapped.
    fn judge(&self) -> Result<(), WiringFault> {
        let answers = self.tilts_rad.map(|tilt_rad| self.answer(tilt_rad));
        for (i, tilt_rad) in self.tilts_rad.into_iter().enumerate() {
            let rotor = i + 1;
            let Some(answer) = answers[i] else { return Err(WiringFault::Silent { rotor }) };
            if answer == i {
                continue;
            }
            let opposite = self.likeness(tilt_rad, i) < -0.5 * dot(tilt_rad, tilt_rad);
            // The bound is said where the compiler sees it: no index panics in flight.
            return Err(if opposite && answers[answer % 4] != Some(i) {
                WiringFault::Reversed { rotor }
            } else {
                WiringFault::AnswersAs { told: rotor, answers: answer + 1 }
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use WiringFault::{AnswersAs, BadSample, Reversed, Silent, Tipping};

    const DT_S: f32 = 0.002;

    /// Checks a machine on soft feet whose rotor `i`, when driven, acts as `answers[i]` says: at whose place, how strongly.
    ///
    /// - `spoil`: what the gyro makes of the rates at a tick.
    fn check(
        airframe: &Airframe,
        answers: [(usize, f32); 4],
        spoil: impl Fn(usize, Vec3<Body>) -> Vec3<Body>,
    ) -> Result<(), WiringFault> {
        let mut check = WiringCheck::new(airframe);
        let (mut tilt, mut rate) = ([0.0; 2], Vec3::zero());
        for i in 0..2000 {
            let thrust_n = check.tick(spoil(i, rate), DT_S);
            assert!(thrust_n.iter().filter(|&&n| n > airframe.thrust_n_min).count() <= 1, "one at a time");
            if let Some(verdict) = check.verdict() {
                assert_eq!(thrust_n, [airframe.thrust_n_min; 4]);
                return verdict;
            }
            // The feet let a thrust of the weight tilt a 0.2 m arm by 0.05 rad, with a lag of 20 ms.
            let mut wanted = [0.0; 2];
            for (n, (place, strength)) in thrust_n.into_iter().zip(answers) {
                let rotor = airframe.rotors[place];
                let soft = strength * n / airframe.weight_n() * 0.05 / 0.2;
                wanted = [wanted[0] - soft * rotor.right_m, wanted[1] + soft * rotor.forward_m];
            }
            let turn: [f32; 2] = from_fn(|axis| (wanted[axis] - tilt[axis]) / 0.02);
            tilt = from_fn(|axis| tilt[axis] + turn[axis] * DT_S);
            rate = Vec3::new(turn[0], turn[1], 0.0);
        }
        panic!("the check takes two seconds");
    }

    fn machines() -> [Airframe; 4] {
        let mut stretched = Airframe::os4(2.2).into_x();
        stretched.rotors = stretched.rotors.map(|rotor| crate::Rotor { forward_m: 1.6 * rotor.forward_m, ..rotor });
        let idling = Airframe { thrust_n_min: 0.1, ..Airframe::paper(2.2) };
        [Airframe::paper(1.05), Airframe::paper(3.0).into_x(), stretched, idling]
    }

    const STRAIGHT: [(usize, f32); 4] = [(0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0)];

    #[test]
    fn phases_follow_the_table() {
        let good = Facts { sample_is_good: true, tips: false, time_is_up: false, verdict: Ok(()) };
        let late = Facts { time_is_up: true, ..good };
        let done = Phase::Done(Err(Silent { rotor: 2 }));
        for (why, from, facts, want) in [
            ("a pulse lasts", Phase::Pulse(1), good, Phase::Pulse(1)),
            ("a pause follows it", Phase::Pulse(1), late, Phase::Pause(1)),
            ("the next rotor follows the pause", Phase::Pause(1), late, Phase::Pulse(2)),
            ("the verdict follows the last", Phase::Pause(3), late, Phase::Done(Ok(()))),
            (
                "a bad sample ends it",
                Phase::Pause(3),
                Facts { sample_is_good: false, ..late },
                Phase::Done(Err(BadSample { rotor: 4 })),
            ),
            ("tipping ends it", Phase::Pulse(0), Facts { tips: true, ..good }, Phase::Done(Err(Tipping { rotor: 1 }))),
            ("a verdict stays", done, late, done),
            ("whatever comes", done, Facts { sample_is_good: false, tips: true, ..late }, done),
        ] {
            assert_eq!(from.next(facts), want, "{why}");
        }
    }

    #[test]
    fn a_machine_that_is_wired_right_passes() {
        for airframe in machines() {
            assert_eq!(check(&airframe, STRAIGHT, |_, rate| rate), Ok(()));
        }
    }

    #[test]
    fn every_swap_is_named() {
        for airframe in machines() {
            for one in 0..4 {
                for other in one + 1..4 {
                    let mut answers = STRAIGHT;
                    answers.swap(one, other);
                    let want = Err(AnswersAs { told: one + 1, answers: other + 1 });
                    assert_eq!(check(&airframe, answers, |_, rate| rate), want);
                }
            }
        }
    }

    #[test]
    fn every_rotor_that_is_reversed_or_silent_is_named() {
        for airframe in machines() {
            for (i, rotor) in (1..=4).enumerate() {
                for (strength, want) in
                    [(-1.0, Reversed { rotor }), (-0.5, Reversed { rotor }), (0.0, Silent { rotor })]
                {
                    let mut answers = STRAIGHT;
                    answers[i].1 = strength;
                    assert_eq!(check(&airframe, answers, |_, rate| rate), Err(want));
                }
            }
        }
    }

    #[test]
    fn no_permutation_of_the_rotors_passes_but_the_right_one() {
        let digits = |n: usize| [n % 4, n / 4 % 4, n / 16 % 4, n / 64];
        for n in 0..256 {
            let places = digits(n);
            let verdict = check(&machines()[0], places.map(|place| (place, 1.0)), |_, rate| rate);
            assert_eq!(verdict.is_ok(), places == [0, 1, 2, 3], "{places:?}");
        }
    }

    #[test]
    fn a_constant_bias_of_the_gyro_changes_nothing() {
        let bias = Vec3::new(0.05, -0.05, 0.1);
        assert_eq!(check(&machines()[0], STRAIGHT, |_, rate| rate + bias), Ok(()));
        let silent = [(0, 1.0), (1, 0.0), (2, 1.0), (3, 1.0)];
        assert_eq!(check(&machines()[0], silent, |_, rate| rate + bias), Err(Silent { rotor: 2 }));
    }

    #[test]
    fn a_sample_that_is_not_finite_ends_the_check() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
            for vector in [Vec3::new(bad, 0.0, 0.0), Vec3::new(0.0, bad, 0.0), Vec3::new(0.0, 0.0, bad)] {
                for (tick, rotor) in [(0, 1), (200, 1), (300, 2), (999, 4)] {
                    let verdict = check(&machines()[0], STRAIGHT, |i, rate| if i == tick { vector } else { rate });
                    assert_eq!(verdict, Err(BadSample { rotor }), "{bad} at tick {tick}");
                }
            }
        }
    }

    #[test]
    fn a_time_that_cannot_be_true_ends_the_check() {
        for dt_s in [f32::NAN, f32::INFINITY, 0.0, -0.002, 0.1] {
            let mut check = WiringCheck::new(&machines()[0]);
            assert_eq!(check.tick(Vec3::zero(), dt_s), [0.0; 4]);
            assert_eq!(check.verdict(), Some(Err(BadSample { rotor: 1 })), "{dt_s}");
        }
    }

    #[test]
    fn a_machine_that_tips_is_let_go() {
        let strong = [(0, 1.0), (1, 10.0), (2, 1.0), (3, 1.0)];
        assert_eq!(check(&machines()[0], strong, |_, rate| rate), Err(Tipping { rotor: 2 }));
    }
}
