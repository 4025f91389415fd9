//! Records: what is said over a line, one kind a variant.
//!
//! A kind is known by its place, so new ones are appended, and none is removed or changed. All are SI; body is forward,
//! right, down and world north, east, down.
use serde::{Deserialize, Serialize};

/// What a frame holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Record {
    /// To the machine: where it is, seen from outside.
    VisionPose(VisionPose),
    /// To the machine: keep this value of a parameter for good.
    SetParameter(ParameterName, f32),
    /// To the machine: say a parameter.
    GetParameter(ParameterName),
    /// From the machine, in answer to both: the value that will fly from the next start on, NaN if there is no such
    /// parameter, and what became of the wish.
    Parameter(ParameterName, f32, Outcome),
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
