//! The inertial unit on its bus: set up once, then one burst a data-ready edge; without edges, at the time of one.
//!
//! Every few samples it must say who it is. While it does not, nothing that it says is believed.
use embassy_time::{Duration, Instant, Timer, with_deadline};
use firmware::icm42688::{BURST, READ, RESET, RESET_US, SAMPLE_HZ, SETUP, START_US, WHO_AM_I, sample};

use crate::board::{IMU_MOUNT, ImuBus, ImuReady};
use control_core::measurement::Imu as Sample;
use embassy_stm32::gpio::Output;

/// Time between two samples.
const PERIOD: Duration = Duration::from_micros((1e6 / SAMPLE_HZ) as u64);
/// Time without an edge after which the line counts as broken.
const PATIENCE: Duration = Duration::from_micros((3e6 / SAMPLE_HZ) as u64);
/// Samples between two looks at who it is.
const LOOK_EVERY: u32 = 4;

/// The inertial unit.
pub(crate) struct Imu {
    bus: ImuBus,
    select: Output<'static>,
    ready: ImuReady,
    /// When the last sample was due.
    due: Instant,
    /// Whether the line has been silent, and samples are fetched by time.
    silent: bool,
    /// Whether it has said who it is.
    known: bool,
    waits: u32,
}

impl Imu {
    pub(crate) fn new(bus: ImuBus, select: Output<'static>, ready: ImuReady) -> Self {
        Self { bus, select, ready, due: Instant::now(), silent: false, known: false, waits: 0 }
    }

    /// Resets the part and sets it up; returns what it says it is, which is [`WHO_AM_I`]'s if it is there.
    ///
    /// - `hurry`: in the air a part that is set up, and has gone on while the chip was reset, is left as it is.
    pub(crate) async fn start(&mut self, hurry: bool) -> u8 {
        let goes_on = hurry && self.is_set_up().await;
        if !goes_on {
            self.write(RESET).await;
            Timer::after_micros(RESET_US).await;
            for register in SETUP {
                self.write(register).await;
            }
            Timer::after_micros(START_US).await;
        }
        self.due = Instant::now();
        self.who().await
    }

    /// Waits for the next sample, or until it should be there.
    pub(crate) async fn wait(&mut self) {
        if self.waits.is_multiple_of(LOOK_EVERY) {
            self.known = self.who().await == WHO_AM_I.1;
        }
        self.waits = self.waits.wrapping_add(1);
        let patience = if self.silent { PERIOD } else { PATIENCE };
        let silent = with_deadline(self.due.saturating_add(patience), self.ready.wait_for_rising_edge()).await.is_err();
        self.due = if silent && self.silent { self.due.saturating_add(PERIOD) } else { Instant::now() };
        // Late by more than that: there is nothing to catch up with.
        self.due = self.due.max(Instant::now().saturating_sub(PERIOD));
        if silent != self.silent {
            defmt::error!("the inertial unit's data-ready line: silent {=bool}", silent);
        }
        self.silent = silent;
    }

    /// Reads the sample, if there is a new one.
    pub(crate) async fn read(&mut self) -> Option<Sample> {
        let mut burst = [0; BURST.1];
        burst[0] = BURST.0 | READ;
        let through = self.exchange(&mut burst).await;
        (through && self.known).then(|| sample(&burst, &IMU_MOUNT)).flatten()
    }

    /// What it says it is.
    async fn who(&mut self) -> u8 {
        self.ask(WHO_AM_I.0).await
    }

    /// Whether its registers are as [`SETUP`] sets them.
    async fn is_set_up(&mut self) -> bool {
        for (register, value) in SETUP {
            if self.ask(register).await != value {
                return false;
            }
        }
        true
    }

    async fn ask(&mut self, register: u8) -> u8 {
        let mut answer = [register | READ, 0];
        self.exchange(&mut answer).await;
        answer[1]
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
