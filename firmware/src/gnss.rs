//! The satellite receiver on its line: set up until it acknowledges, then listened to, and set up again when it falls silent.
use control_core::geodesy::LocalFrame;
use control_core::measurement::{Gnss, Stamped};
use embassy_stm32::mode::Async;
use embassy_stm32::usart::{RingBufferedUartRx, Uart, UartTx};
use embassy_time::{Duration, with_timeout};
use firmware::ubx::{AGE_US, BAUD, BAUDS, Heard, Receiver, setup, speed};

use crate::restart;
use crate::tasks::{Newest, now_us};

/// The newest fix.
pub(crate) static GNSS: Newest<Gnss> = Newest::new();

/// How long the receiver takes to change its speed, and to answer that it has.
const SETTLE: Duration = Duration::from_millis(50);
/// How long an acknowledgement is waited for.
const ANSWER: Duration = Duration::from_millis(500);
/// Silence after which the receiver is taken for one that was switched off: ten fixes.
const SILENCE: Duration = Duration::from_secs(1);

/// The receiver's line, both ways.
pub(crate) struct Port {
    line: RingBufferedUartRx<'static>,
    to: UartTx<'static, Async>,
}

impl Port {
    /// - `buffer`: where the receiver's bytes wait.
    pub(crate) fn new(uart: Uart<'static, Async>, buffer: &'static mut [u8]) -> Self {
        let (to, from) = uart.split();
        Self { line: from.into_ring_buffered(buffer), to }
    }

    /// Sets the speed of both ways, bits a second.
    fn set_speed(&self, baud: u32) {
        // Every speed that is asked for is within the port's range.
        let _ = self.line.set_baudrate(baud);
    }

    /// Sends a message; returns when it is through.
    async fn say(&mut self, message: &[u8]) {
        // Sending has no errors, only waiting has a signature for them.
        let _ = self.to.write(message).await;
        let _ = self.to.flush().await;
    }
}

/// Listens for ever, with a home that was known before this start, if one was; a receiver that is absent is asked again and again, at no cost to others.
#[embassy_executor::task]
pub(crate) async fn locate(mut port: Port, home: Option<LocalFrame>) -> ! {
    let mut kept = home.inspect(restart::keep_home).is_some();
    let mut receiver = Receiver::at(home);
    loop {
        set_up(&mut port, &mut receiver).await;
        defmt::info!("the satellite receiver is set up");
        while let Ok((time_us, heard)) = with_timeout(SILENCE, hear(&mut port, &mut receiver)).await {
            if let (false, Some(home)) = (kept, receiver.home()) {
                restart::keep_home(home);
                kept = true;
            }
            if let Heard::Fix(value) = heard {
                GNSS.signal(Stamped { time_us: time_us.saturating_sub(AGE_US), value });
            }
        }
        defmt::warn!("the satellite receiver is silent");
    }
}

/// Tells the receiver what is wanted, at each speed that it may have, until it acknowledges. One that refuses is told again.
async fn set_up(port: &mut Port, receiver: &mut Receiver) {
    for baud in BAUDS.into_iter().cycle() {
        port.set_speed(baud);
        port.say(&speed()).await;
        port.set_speed(BAUD);
        // What it says until then is no answer to what follows, though an acknowledgement looks like one.
        let before = async {
            loop {
                let _ = port.line.read(&mut [0; 64]).await;
            }
        };
        let _ = with_timeout(SETTLE, before).await;
        port.say(&setup()).await;
        let acknowledged = async { while hear(port, receiver).await.1 != Heard::Acknowledged {} };
        if with_timeout(ANSWER, acknowledged).await.is_ok() {
            return;
        }
    }
}

/// What the receiver says next, and when its last byte had come, µs.
async fn hear(port: &mut Port, receiver: &mut Receiver) -> (u64, Heard) {
    let mut bytes = [0; 64];
    loop {
        // After noise or an overrun the line is listened to anew: frames have checksums.
        if let Ok(count) = port.line.read(&mut bytes).await
            && let Some(heard) = receiver.push(&bytes[..count])
        {
            return (now_us(), heard);
        }
    }
}
