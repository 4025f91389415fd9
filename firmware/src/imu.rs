//! The inertial unit on its bus: found by what it says it is, set up once, then read at each edge of its line; without edges, at the time of
//! one.
//!
//! Every few samples it must say who it is. While it does not, nothing that it says is believed.
use embassy_time::{Duration, Instant, Timer, with_deadline};
use firmware::icm42688::{self, BURSTS_MAX, FLUSH, Lost, READ, Records, SAMPLE_HZ, WHO_AM_I};
use firmware::mpu6000;

use crate::board::{self, IMU_MOUNT, ImuBus, ImuReady};
use control_core::measurement::Imu as Sample;
use embassy_stm32::gpio::Output;

/// Time between two samples.
const PERIOD: Duration = Duration::from_micros((1e6 / SAMPLE_HZ) as u64);
/// Time without an edge after which the line counts as broken.
const PATIENCE: Duration = Duration::from_micros((3e6 / SAMPLE_HZ) as u64);
/// Samples between two looks at who it is.
const LOOK_EVERY: u32 = 4;
/// How often, once a millisecond, it is asked who it is before it counts as none: an MPU-6000 may take 100 ms to answer after power comes on.
const ASKED_MAX: u32 = 100;
/// Fastest clock at which every part may be asked who it is, Hz.
const SLOWLY_HZ: u32 = mpu6000::SPI_HZ_MAX.0;

/// Which part is soldered on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Icm42688,
    Mpu6000,
}

impl Part {
    /// The part that says this of itself.
    const fn of(who: u8) -> Option<Self> {
        if who == WHO_AM_I.1 {
            Some(Self::Icm42688)
        } else if who == mpu6000::WHO_AM_I {
            Some(Self::Mpu6000)
        } else {
            None
        }
    }

    /// What resets it, one register at a time, and how long each takes, µs.
    const fn reset(self) -> (&'static [(u8, u8)], u64) {
        match self {
            Self::Icm42688 => (&[icm42688::RESET], icm42688::RESET_US),
            Self::Mpu6000 => (&mpu6000::RESET, mpu6000::RESET_US),
        }
    }

    /// What sets it up, and how long it takes to start, µs.
    const fn setup(self) -> (&'static [(u8, u8)], u64) {
        match self {
            Self::Icm42688 => (&icm42688::SETUP, icm42688::START_US),
            Self::Mpu6000 => (&mpu6000::SETUP, mpu6000::START_US),
        }
    }

    /// First register of its burst, and bytes with its address.
    const fn burst(self) -> (u8, usize) {
        match self {
            Self::Icm42688 => icm42688::BURST,
            Self::Mpu6000 => mpu6000::BURST,
        }
    }

    /// Fastest clock of its bursts, Hz.
    const fn burst_hz(self) -> u32 {
        match self {
            Self::Icm42688 => icm42688::SPI_HZ_MAX,
            Self::Mpu6000 => mpu6000::SPI_HZ_MAX.1,
        }
    }

    /// Its name.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Icm42688 => "ICM-42688-P",
            Self::Mpu6000 => "MPU-6000",
        }
    }
}

/// The inertial unit.
pub(crate) struct Imu {
    bus: ImuBus,
    select: Output<'static>,
    ready: ImuReady,
    /// When the last sample was due.
    due: Instant,
    /// Whether the line has been silent, and samples are fetched by time.
    silent: bool,
    part: Part,
    /// Whether it has said who it is.
    known: bool,
    waits: u32,
    /// What is read.
    burst: [u8; icm42688::BURST.1],
}

impl Imu {
    pub(crate) fn new(bus: ImuBus, select: Output<'static>, ready: ImuReady) -> Self {
        let burst = [0; icm42688::BURST.1];
        Self {
            bus,
            select,
            ready,
            due: Instant::now(),
            silent: false,
            part: Part::Icm42688,
            known: false,
            waits: 0,
            burst,
        }
    }

    /// Finds the part, resets it and sets it up; whether it is one that is known.
    ///
    /// - `hurry`: in the air a part that is set up, and has gone on while the chip was reset, is left as it is.
    pub(crate) async fn start(&mut self, hurry: bool) -> bool {
        let found = self.find().await;
        if let Some(part) = found {
            (self.part, self.known) = (part, true);
            if !(hurry && self.is_set_up()) {
                self.set_up().await;
            }
            self.clock(part.burst_hz());
            // What was sampled before, or while the chip was reset, is of the past.
            self.read().await;
        }
        self.due = Instant::now();
        found.is_some()
    }

    /// Waits for the next sample, or until it should be there.
    pub(crate) async fn wait(&mut self) {
        if self.waits.is_multiple_of(LOOK_EVERY) {
            self.known = self.is_itself();
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

    /// Reads the sample, if there is a new one: of an ICM-42688-P, all that its FIFO holds. If that cannot be used it is flushed, and there is
    /// no sample until four new ones are in it.
    pub(crate) async fn read(&mut self) -> Option<Sample> {
        let mut records = Records::default();
        let (first, length) = self.part.burst();
        for _ in 0..BURSTS_MAX {
            let burst = &mut self.burst;
            burst[0] = first | READ;
            self.select.set_low();
            let result = self.bus.transfer_in_place(burst.get_mut(..length)?).await;
            self.select.set_high();
            if result.is_err() || !self.known {
                return None;
            }
            match self.part {
                Part::Mpu6000 => return mpu6000::sample(burst.first_chunk()?, &IMU_MOUNT),
                Part::Icm42688 => match records.take(burst) {
                    Ok(true) => return records.mean(&IMU_MOUNT),
                    Ok(false) => {}
                    Err(Lost) => break,
                },
            }
        }
        self.write(FLUSH);
        None
    }

    /// The part that is there, by what it says it is; it may still be waking.
    async fn find(&mut self) -> Option<Part> {
        let mut who = 0;
        for _ in 0..ASKED_MAX {
            who = self.ask(WHO_AM_I.0);
            if let Some(part) = Part::of(who) {
                defmt::info!("the inertial unit is an {=str}", part.name());
                return Some(part);
            }
            Timer::after_millis(1).await;
        }
        defmt::error!("the inertial unit says it is {=u8:#04x}, which is none that is known", who);
        None
    }

    async fn set_up(&mut self) {
        let (reset, reset_us) = self.part.reset();
        let (setup, start_us) = self.part.setup();
        for (registers, pause_us) in [(reset, reset_us), (setup, 0)] {
            for &register in registers {
                self.write(register);
                Timer::after_micros(pause_us).await;
            }
        }
        Timer::after_micros(start_us).await;
    }

    /// Whether its registers are as they are set up.
    fn is_set_up(&mut self) -> bool {
        for &(register, value) in self.part.setup().0 {
            if self.ask(register) != value {
                return false;
            }
        }
        true
    }

    /// Whether it says that it is what it was at the start.
    fn is_itself(&mut self) -> bool {
        // The one must be asked slowly, for which there is time before the next sample; the other need not.
        let slowly = self.part == Part::Mpu6000;
        if slowly {
            self.clock(SLOWLY_HZ);
        }
        let who = self.ask(WHO_AM_I.0);
        if slowly {
            self.clock(self.part.burst_hz());
        }
        Part::of(who) == Some(self.part)
    }

    fn clock(&mut self, hz: u32) {
        // A speed can always be set.
        let _ = self.bus.set_config(&board::imu_bus_config(hz));
    }

    fn ask(&mut self, register: u8) -> u8 {
        self.reach([register | READ, 0])
    }

    fn write(&mut self, (register, value): (u8, u8)) {
        self.reach([register, value]);
    }

    /// Two bytes each way, which are through before DMA would be set up; the second one that came.
    fn reach(&mut self, mut bytes: [u8; 2]) -> u8 {
        self.select.set_low();
        // A bus without a part works as well: what fails is seen by what it answers.
        let _ = self.bus.blocking_transfer_in_place(&mut bytes);
        self.select.set_high();
        bytes[1]
    }
}
