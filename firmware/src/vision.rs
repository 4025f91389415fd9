//! Poses from outside, over a line of their own.
use control_core::measurement::{Stamped, Vision};
use embassy_stm32::usart::RingBufferedUartRx;
use firmware::pose::{self, FRAME_US};
use flight_link::Decoder;

use crate::tasks::{Newest, now_us};

/// The newest pose.
pub(crate) static VISION: Newest<Vision> = Newest::new();

/// Listens for ever.
#[embassy_executor::task]
pub(crate) async fn see(mut line: RingBufferedUartRx<'static>) -> ! {
    let mut decoder = Decoder::new();
    let mut bytes = [0; 64];
    loop {
        // After noise or an overrun the line is listened to anew: frames have checksums.
        if let Ok(count) = line.read(&mut bytes).await
            && let Some((age_us, value)) = pose::push(&mut decoder, &bytes[..count])
        {
            let time_us = now_us().saturating_sub(FRAME_US + u64::from(age_us));
            VISION.signal(Stamped { time_us, value });
        }
    }
}
