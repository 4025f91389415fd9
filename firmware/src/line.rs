//! A line to the station, the serial port or USB: frames wait in it, and whoever writes them never waits for the line.
//!
//! Which bytes are framed on it is nobody's matter here: a line carries bytes.
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_stm32::mode::Async;
use embassy_stm32::usart::{RingBufferedUartRx, UartTx};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::pipe::Pipe;
use embassy_time::Timer;
use flight_link::{Decoder, FRAME_BYTES_MAX, FromBoard, ToBoard, encode};

/// Bytes that may wait on a line: what is said ten times a second, and an answer.
const WAITING: usize = 512;
/// Of these, those that are left to what is said ten times a second where there is more to say.
const OTHERS: usize = 192;
/// How long a line may take none of that, ms.
const PATIENCE_MS: u32 = 1_000;
/// Bytes that are handed to a port at once.
const CHUNK: usize = 64;
/// Records that may wait to be considered.
const HEARD: usize = 4;

/// What has been heard, and on which line.
pub(crate) static RECORDS: Channel<CriticalSectionRawMutex, (&'static Line, ToBoard), HEARD> = Channel::new();
/// The serial port.
pub(crate) static SERIAL: Line = Line::new(true);
/// The port of a computer.
pub(crate) static USB: Line = Line::new(false);

/// One line.
pub(crate) struct Line {
    waiting: Pipe<CriticalSectionRawMutex, WAITING>,
    dropped: AtomicU32,
    /// Whether somebody may listen.
    open: AtomicBool,
}

impl Line {
    const fn new(open: bool) -> Self {
        Self { waiting: Pipe::new(), dropped: AtomicU32::new(0), open: AtomicBool::new(open) }
    }

    /// Notes that somebody listens from now on, or nobody; what waits is forgotten.
    pub(crate) fn set_open(&self, open: bool) {
        self.open.store(open, Ordering::Relaxed);
        self.waiting.clear();
    }

    /// The next bytes to be sent.
    pub(crate) async fn next(&self, bytes: &mut [u8]) -> usize {
        self.waiting.read(bytes).await
    }

    /// Puts a record's frame behind those that wait; drops it if there is no room, and counts that.
    pub(crate) fn say(&self, record: &FromBoard) {
        if !self.open.load(Ordering::Relaxed) {
            return;
        }
        let mut place = [0; FRAME_BYTES_MAX];
        let Ok(mut frame) = encode(record, &mut place) else { return };
        if self.waiting.free_capacity() < frame.len() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        // In two parts where the pipe's memory ends. All who write are on one executor, and nobody waits in between.
        while let Ok(count @ 1..) = self.waiting.try_write(frame) {
            frame = frame.get(count..).unwrap_or_default();
        }
    }

    /// Says one record of many once there is room for it and for what else is said; whether the line took it.
    pub(crate) async fn say_in_turn(&self, record: &FromBoard) -> bool {
        for _ in 0..PATIENCE_MS {
            if !self.open.load(Ordering::Relaxed) {
                break;
            }
            if self.waiting.free_capacity() >= OTHERS + FRAME_BYTES_MAX {
                self.say(record);
                return true;
            }
            Timer::after_millis(1).await;
        }
        false
    }

    /// Records that there was no room for.
    pub(crate) fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Waits until all is on the wire, but no longer than a full line takes.
    pub(crate) async fn drain(&self) {
        for _ in 0..50 {
            Timer::after_millis(1).await;
            if self.waiting.is_empty() {
                break;
            }
        }
        // The last bytes are still on their way.
        Timer::after_millis(20).await;
    }
}

/// Passes on what is heard over the serial port.
#[embassy_executor::task]
pub(crate) async fn hear(mut port: RingBufferedUartRx<'static>) -> ! {
    let mut decoder = Decoder::new();
    let mut bytes = [0; CHUNK];
    loop {
        // After noise or an overrun the line is listened to anew: frames have checksums.
        let Ok(count) = port.read(&mut bytes).await else { continue };
        for record in bytes[..count].iter().filter_map(|&byte| decoder.push(byte)) {
            RECORDS.send((&SERIAL, record)).await;
        }
    }
}

/// Sends what waits for the serial port.
#[embassy_executor::task]
pub(crate) async fn speak(mut port: UartTx<'static, Async>) -> ! {
    let mut bytes = [0; CHUNK];
    loop {
        let count = SERIAL.next(&mut bytes).await;
        // Nobody to tell whom that the line does not work.
        let _ = port.write(&bytes[..count]).await;
    }
}
