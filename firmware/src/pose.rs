//! Poses from outside: a record of `flight-link` to what the estimator wants.
//!
//! ```text
//! R = 1 + 2 (w [v]× + [v]×²)        for the unit quaternion w, v
//! ```
//!
//! Whether it is one, and whether the pose is likely, is for the estimator to judge.
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::Vision;
use flight_link::{Decoder, ToBoard, VisionPose};

/// Bits a second on the line.
pub const BAUD: u32 = 921_600;
/// What a pose's frame takes on the line, µs: 43 bytes, or one more where it is older than 16 ms.
pub const FRAME_US: u64 = 43 * 10 * 1_000_000 / BAUD as u64;
/// Longest a pose is believed to have taken, µs.
const AGE_US_MAX: u32 = 1_000_000;

/// Takes in bytes as they come; returns the newest pose that they complete, and how old it was when it was sent, µs.
pub fn push(decoder: &mut Decoder<ToBoard>, bytes: &[u8]) -> Option<(u32, Vision)> {
    let records = bytes.iter().filter_map(|&byte| decoder.push(byte));
    let poses = records.filter_map(|record| match record {
        ToBoard::VisionPose(pose) => Some(pose),
        _ => None,
    });
    poses.last().filter(|pose| pose.age_us <= AGE_US_MAX).map(|pose| (pose.age_us, vision(&pose)))
}

fn vision(pose: &VisionPose) -> Vision {
    let [x, y, z] = pose.position_m;
    Vision {
        position_m: Vec3::new(x, y, z),
        attitude: attitude(pose.attitude),
        position_sigma_m: pose.position_sigma_m,
        attitude_sigma_rad: pose.attitude_sigma_rad,
    }
}

fn attitude([w, x, y, z]: [f32; 4]) -> Attitude {
    Attitude {
        rows: [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control_core::frames::Body;
    use flight_link::{FRAME_BYTES_MAX, encode};

    fn pose(age_us: u32, x_m: f32) -> VisionPose {
        // Nose to the east.
        let half = core::f32::consts::FRAC_1_SQRT_2;
        VisionPose {
            age_us,
            position_m: [x_m, 2.0, -3.0],
            attitude: [half, 0.0, 0.0, half],
            position_sigma_m: 0.001,
            attitude_sigma_rad: 0.002,
        }
    }

    fn frame(pose: VisionPose) -> std::vec::Vec<u8> {
        encode(&ToBoard::VisionPose(pose), &mut [0; FRAME_BYTES_MAX]).unwrap().to_vec()
    }

    #[test]
    fn the_newest_pose_comes_out_with_its_age_and_its_axes() {
        let mut decoder = Decoder::new();
        let bytes = [frame(pose(9_000, 1.0)), frame(pose(8_000, 1.5))].concat();
        let (age_us, vision) = push(&mut decoder, &bytes).unwrap();
        assert_eq!((age_us, vision.position_m), (8_000, Vec3::new(1.5, 2.0, -3.0)));
        let ahead = vision.attitude.to_ned(Vec3::<Body>::new(1.0, 0.0, 0.0));
        assert!(ahead.x.abs() < 1e-6 && (ahead.y - 1.0).abs() < 1e-6 && ahead.z == 0.0, "{ahead:?}");
    }

    #[test]
    fn a_pose_of_long_ago_is_none() {
        assert_eq!(push(&mut Decoder::new(), &frame(pose(1_000_001, 1.0))), None);
    }
}
