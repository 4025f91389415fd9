//! The pilot's channels: which is which.
//!
//! | channel | what                | low        | middle            | high          |
//! |---------|---------------------|------------|-------------------|---------------|
//! | 1       | roll                | left       |                   | right         |
//! | 2       | pitch               | back       |                   | forward       |
//! | 3       | throttle            | down       |                   | up            |
//! | 4       | yaw                 | left       |                   | right         |
//! | 5       | arm                 | off        | off               | on            |
//! | 6       | mode                | angle      | altitude hold     | position hold |
//! | 7       | by itself           | as 6       | take-off          | return        |
use control_core::modes::Mode;
use control_core::pilot::{PilotInput, Sticks};

use crate::crsf::Channels;

/// Beyond it a switch is high, below its negative low.
const SWITCH: f32 = 0.5;

/// What the pilot says with these channels.
pub fn input(channels: &Channels) -> PilotInput {
    let [right, forward, throttle, clockwise, arm, mode, by_itself, ..] = channels.0;
    let mode = match (position(by_itself), position(mode)) {
        (1, _) => Mode::TakeOff,
        (2, _) => Mode::Return,
        (_, 0) => Mode::Angle,
        (_, 1) => Mode::AltitudeHold,
        _ => Mode::PositionHold,
    };
    let sticks = Sticks { right, forward, clockwise, throttle: 0.5 * (throttle + 1.0) };
    PilotInput { sticks, arm: position(arm) == 2, mode }
}

/// 0 low, 1 middle, 2 high.
fn position(switch: f32) -> u8 {
    u8::from(switch > -SWITCH) + u8::from(switch > SWITCH)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_sticks_and_switches_as_the_table_says() {
        let mut channels = Channels([0.0; 16]);
        channels.0[..7].copy_from_slice(&[0.1, 0.2, -1.0, 0.4, 1.0, -1.0, -1.0]);
        let said = input(&channels);
        assert_eq!(said.sticks, Sticks { right: 0.1, forward: 0.2, clockwise: 0.4, throttle: 0.0 });
        assert!(said.arm);
        for (six, seven, mode) in [
            (-1.0, -1.0, Mode::Angle),
            (0.0, -1.0, Mode::AltitudeHold),
            (1.0, -1.0, Mode::PositionHold),
            (1.0, 0.0, Mode::TakeOff),
            (-1.0, 1.0, Mode::Return),
        ] {
            (channels.0[5], channels.0[6]) = (six, seven);
            assert_eq!(input(&channels).mode, mode, "{six} {seven}");
        }
        channels.0[4] = 0.4;
        assert!(!input(&channels).arm, "a switch in its middle does not arm");
    }
}
