//! The log's bus: a card or a flash chip is on it, alone (`card.rs`, `log_flash.rs`).
//!
//! What is long and written in flight goes by DMA, on streams that the slow sensors' bus may have too: where a chip has no others left each waits
//! for its [`TURN`]. What is short, and what is read, is the core's to move.
use embassy_stm32::gpio::{Output, Pull};
use embassy_stm32::mode::Async;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;

/// Whose turn it is with the streams.
pub(crate) static TURN: Mutex<CriticalSectionRawMutex, ()> = Mutex::new(());

type Bus = Spi<'static, Async, spi::mode::Master>;

/// The bus, and the select line of what is on it.
pub(crate) struct LogBus {
    bus: Bus,
    select: Output<'static>,
}

/// How the bus is opened. Where nothing answers it reads ones.
pub(crate) fn config() -> spi::Config {
    let mut config = spi::Config::default();
    config.miso_pull = Pull::Up;
    config
}

impl LogBus {
    #[cfg_attr(feature = "orbit-h743", expect(dead_code, reason = "it has no chip that is driven"))]
    pub(crate) fn new(bus: Bus, select: Output<'static>) -> Self {
        Self { bus, select }
    }

    /// Sets the clock's frequency, Hz, or one near it that the bus has.
    pub(crate) fn set_speed(&mut self, hz: u32) {
        let mut config = config();
        config.frequency = Hertz(hz);
        // A speed can always be set.
        let _ = self.bus.set_config(&config);
    }

    /// Begins to speak to what is on it, which listens while its line is low.
    pub(crate) fn select(&mut self) {
        self.select.set_low();
    }

    /// Ends that, for at least a quarter of a microsecond: a slow pin takes 100 ns to rise, and a chip wants 50 of it high.
    pub(crate) fn deselect(&mut self) {
        self.select.set_high();
        cortex_m::asm::delay(64);
    }

    /// Sends bytes by DMA; whether that worked.
    pub(crate) async fn stream(&mut self, bytes: &[u8]) -> bool {
        let _turn = TURN.lock().await;
        self.bus.write(bytes).await.is_ok()
    }

    // A bus without anybody works as well: what fails is seen by what is answered.
    /// Sends bytes.
    pub(crate) fn send(&mut self, bytes: &[u8]) {
        let _ = self.bus.blocking_write(bytes);
    }

    /// Receives bytes, while ones are sent.
    pub(crate) fn receive(&mut self, bytes: &mut [u8]) {
        bytes.fill(0xff);
        let _ = self.bus.blocking_transfer_in_place(bytes);
    }

    /// Receives a byte.
    pub(crate) fn byte(&mut self) -> u8 {
        let mut byte = [0xff];
        self.receive(&mut byte);
        byte[0]
    }
}
