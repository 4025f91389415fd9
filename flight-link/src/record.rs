//! Records: what is said over a line, one kind a variant.
//!
//! A kind is known by its place, so new ones are appended, and none is removed or changed. All are SI; body is forward,
//! right, down and world north, east, down.
use serde::{Deserialize, Serialize};

use crate::{LogPart, LogRefusal, LogSize, LogWish, Motion, Rotors, Status};

/// Version of the records: raised when what was said means something else than before.
pub const VERSION: u8 = 2;

/// What a frame to the machine holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToBoard {
    /// Where it is, seen from outside.
    VisionPose(VisionPose),
    /// Keep this value of a parameter for good.
    SetParameter(ParameterName, f32),
    /// Say a parameter.
    GetParameter(ParameterName),
    /// Say your version of the records; and a sign of life, which a test on the bench needs.
    Hello,
    /// Do something on the ground.
    Order(Order),
    /// Say or erase the flight log.
    Log(LogWish),
}

/// What a frame from the machine holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromBoard {
    /// In answer to a wish about a parameter: the value that will fly from the next start on, NaN if there is no such
    /// parameter, and what became of the wish.
    Parameter(ParameterName, f32, Outcome),
    /// In answer to a hello: [`VERSION`] of whoever built the machine's program.
    Hello(u8),
    /// In answer to an order.
    Ordered(Verdict),
    /// How it is.
    Status(Status),
    /// How it moves.
    Motion(Motion),
    /// What its rotors do.
    Rotors(Rotors),
    /// How long its flight log is.
    LogSize(LogSize),
    /// A part of that.
    LogPart(LogPart),
    /// Why nothing of it is said, or erased.
    LogRefused(LogRefusal),
}

/// What is only done on the ground, disarmed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Order {
    /// Turn rotors for people to look at; ends when its line falls silent for half a second.
    MotorTest(MotorTest),
    /// Find out which rotor answers to which command; ends as a motor test does.
    WiringCheck,
    /// End whatever turns a rotor on the bench.
    Stop,
    /// Start anew.
    Restart,
}

/// A motor test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorTest {
    /// Rotor 0 to 3; all in turn if there is none.
    pub rotor: Option<u8>,
    /// Command, share of full.
    pub share: f32,
    /// How long each turns, s.
    pub seconds: f32,
}

/// What became of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Verdict {
    /// It is done, or has begun.
    Done,
    /// It is armed.
    Armed,
    /// A rotor that is none, or a share or a time beyond what a motor test may take.
    OutOfRange,
    /// The control loop does not run.
    Unheard,
}

/// A parameter's name in ASCII, filled up with zeros.
pub type ParameterName = [u8; 16];

/// What became of a wish about a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
    /// It was to be said, and is.
    Said,
    /// It is stored.
    Stored,
    /// There is none of this name.
    Unknown,
    /// Its range does not have the value.
    OutOfRange,
    /// Nothing is stored while armed.
    Armed,
    /// There is room for it only after a restart, which follows now; then it will be stored.
    Restarting,
    /// The flash has failed.
    Failed,
}

/// A pose from motion capture, or from visual odometry in a known frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VisionPose {
    /// How long before the frame's first byte was sent the pose was true, µs: clocks on both sides need not agree.
    pub age_us: u32,
    /// Position from the origin, north, east, down, m.
    pub position_m: [f32; 3],
    /// Body to world, a unit quaternion w, x, y, z.
    pub attitude: [f32; 4],
    /// Its own estimate of its error in position, 1 σ, m.
    pub position_sigma_m: f32,
    /// The same in attitude, rad.
    pub attitude_sigma_rad: f32,
}
