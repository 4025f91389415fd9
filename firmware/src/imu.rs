//! The inertial unit on its bus: set up once, then one burst a data-ready edge.
use embassy_time::{Duration, Timer, with_timeout};
use firmware::icm42688::{BURST, READ, RESET, RESET_US, SETUP, START_US, WHO_AM_I, sample};

use crate::board::{IMU_MOUNT, ImuBus, ImuReady};
use control_core::measurement::Imu as Sample;
use embassy_stm32::gpio::Output;

/// The inertial unit.
pub(crate) struct Imu {
    bus: ImuBus,
    select: Output<'static>,
    ready: ImuReady,
}

impl Imu {
    pub(crate) fn new(bus: ImuBus, select: Output<'static>, ready: ImuReady) -> Self {
        Self { bus, select, ready }
    }

    /// Resets the part and sets it up; returns what it says it is, which is [`WHO_AM_I`]'s if it is there.
    pub(crate) async fn start(&mut self) -> u8 {
        self.write(RESET).await;
        Timer::after_micros(RESET_US).await;
        let mut who = [WHO_AM_I.0 | READ, 0];
        self.exchange(&mut who).await;
        for register in SETUP {
            self.write(register).await;
        }
        Timer::after_micros(START_US).await;
        who[1]
    }

    /// Waits for the next sample, but no longer than `at_most`; returns whether it came.
    pub(crate) async fn wait(&mut self, at_most: Duration) -> bool {
        with_timeout(at_most, self.ready.wait_for_rising_edge()).await.is_ok()
    }

    /// Reads the sample that is ready.
    pub(crate) async fn read(&mut self) -> Option<Sample> {
        let mut burst = [0; BURST.1];
        burst[0] = BURST.0 | READ;
        let through = self.exchange(&mut burst).await;
        through.then(|| sample(&burst, &IMU_MOUNT)).flatten()
    }

    async fn write(&mut self, (register, value): (u8, u8)) {
        self.exchange(&mut [register, value]).await;
    }

    /// One transfer; whether the bus worked.
    async fn exchange(&mut self, bytes: &mut [u8]) -> bool {
        self.select.set_low();
        let result = self.bus.transfer_in_place(bytes).await;
        self.select.set_high();
        result.is_ok()
    }
}
