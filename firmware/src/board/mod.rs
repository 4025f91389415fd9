//! The board this image is for, chosen by a feature, and what every board does alike.
//!
//! A board's file has its pins, clocks and interrupts, and nothing else; it gives the items that are imported here.
//! Another board is another such file, a feature in `Cargo.toml`, and its memory map (docs/boards.md).
use core::mem::forget;

use embassy_stm32::Peri;
use embassy_stm32::exti::ExtiInput;
use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use embassy_stm32::i2c;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{SPI1, USB_OTG_FS};
use embassy_stm32::rcc;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, RingBufferedUartRx, UartRx, UartTx};
use embassy_stm32::usb;
use embassy_stm32::wdg::IndependentWatchdog;
use firmware::icm42688::Mount;
use firmware::stored::Stored;

use crate::gnss;
use crate::log_bus::LogBus;

mod bank;
mod ear;
#[cfg(feature = "orbit-h743")]
mod ecc;
mod gauge;

#[cfg(feature = "foxeer-f722-v4")]
mod foxeer_f722_v4;
#[cfg(feature = "orbit-h743")]
mod orbit_h743;
#[cfg(feature = "speedybee-f405-v4")]
mod speedybee_f405_v4;

#[cfg(feature = "foxeer-f722-v4")]
use foxeer_f722_v4 as chosen;
#[cfg(feature = "orbit-h743")]
use orbit_h743 as chosen;
#[cfg(feature = "speedybee-f405-v4")]
use speedybee_f405_v4 as chosen;

pub(crate) use ear::heard;
pub(crate) use gauge::Gauge;

pub(crate) use chosen::{
    BATTERY_SCALE, IMU_MOUNT, LOG_ON_CARD, LOG_ON_FLASH, MotorEar, MotorPins, NAME, STATUS_ON, SensorBus, SensorPins,
    init, start_control_executor,
};

/// Time after which the watchdog resets the chip, without a step that took no longer than the law can be flown with, µs.
pub(crate) const WATCHDOG_US: u32 = 20_000;
/// Speed of the station's line, bits a second.
const STATION_BAUD: u32 = 115_200;
/// Speed of the slow sensors' bus, bits a second.
const SENSORS_HZ: u32 = 400_000;
/// A magnetometer, which a builder adds, has its arrow forward and its chip up.
pub(crate) const MAG_MOUNT: Mount = [(0, false), (1, true), (2, true)];

/// Parts the application is allowed to hold.
pub(crate) struct Board {
    /// The motor outputs.
    pub(crate) motors: MotorPins,
    /// What listens to the speed controllers, if anything can.
    pub(crate) ear: Option<MotorEar>,
    /// The inertial unit's bus.
    pub(crate) imu_bus: ImuBus,
    /// The inertial unit's select line, low while it is spoken to.
    pub(crate) imu_select: Output<'static>,
    /// Rises when a sample is ready.
    pub(crate) imu_ready: ImuReady,
    /// The radio receiver's line.
    pub(crate) radio: Radio,
    /// The slow sensors' bus.
    pub(crate) sensors: SensorPins,
    /// The satellite receiver's line.
    pub(crate) gnss: gnss::Port,
    /// The line of whoever sees the machine from outside.
    pub(crate) vision: RingBufferedUartRx<'static>,
    /// The station's line, to it and from it.
    pub(crate) station: (UartTx<'static, Async>, UartRx<'static, Async>),
    /// The station's line by USB.
    pub(crate) usb: UsbPort,
    /// Where parameters are stored.
    pub(crate) store: Store,
    /// The bus of what the flight log is on, if it has one.
    pub(crate) log_bus: Option<LogBus>,
    /// The battery's lines.
    pub(crate) battery: Gauge,
    /// The status LED.
    pub(crate) status: Status,
    /// The buzzer, which sounds while this is high.
    pub(crate) buzzer: Output<'static>,
    /// Resets the chip once it is unleashed and not fed.
    pub(crate) watchdog: Watchdog,
    /// Whether the watchdog has caused this start.
    pub(crate) bitten: bool,
    /// Whether a supply that was too low has, without being gone.
    pub(crate) browned_out: bool,
}

/// The independent watchdog.
pub(crate) type Watchdog = IndependentWatchdog<'static, chosen::WatchdogUnit>;
/// The inertial unit's bus.
pub(crate) type ImuBus = Spi<'static, Async, spi::mode::Master>;
/// The inertial unit's data-ready line.
pub(crate) type ImuReady = ExtiInput<'static, Async>;
/// The radio receiver's line.
pub(crate) type Radio = RingBufferedUartRx<'static>;
/// The full-speed port to a computer.
pub(crate) type UsbPort = usb::Driver<'static, USB_OTG_FS>;
/// Where parameters are stored.
pub(crate) type Store = Stored<chosen::StoreRegion>;
/// The status LED.
pub(crate) type Status = Output<'static>;

/// Where bytes that come over lines wait until their task reads them.
pub(crate) struct Buffers {
    /// Of the radio receiver: eight frames.
    radio: [u8; 208],
    /// Of the satellite receiver: two fixes, 22 ms.
    gnss: [u8; 256],
    /// Of external vision: six poses, 3 ms.
    vision: [u8; 256],
    /// Of the port to a computer: a packet for each endpoint that takes some.
    usb: [u8; 128],
}

/// Empty ones.
pub(crate) const BUFFERS: Buffers = Buffers { radio: [0; 208], gnss: [0; 256], vision: [0; 256], usb: [0; 128] };

/// Where parameters are stored.
///
/// # Panics
/// If that is not two sectors.
fn store(region: chosen::StoreRegion) -> Store {
    Stored::try_new(region, chosen::STORE).expect("the range is two sectors")
}

/// How the inertial unit's bus is driven, at most at a speed, Hz.
pub(crate) fn imu_bus_config(hz_max: u32) -> spi::Config {
    let mut bus = spi::Config::default();
    // The driver takes the nearest power of two, which may be a faster one.
    let clock_hz = rcc::frequency::<SPI1>().0;
    let slower_hz = (1..8).map(|halvings| clock_hz >> halvings).find(|&hz| hz <= hz_max);
    bus.frequency = Hertz(slower_hz.unwrap_or(clock_hz >> 8));
    bus
}

/// How a line is read at a speed, bits a second.
fn line_config(baud: u32) -> usart::Config {
    let mut line = usart::Config::default();
    line.baudrate = baud;
    line
}

/// How the port to a computer is driven; its interrupts come below the control task.
///
/// Whether a cable is plugged in is not looked for: no board has the pin for it.
fn usb_config() -> usb::Config {
    interrupt::OTG_FS.set_priority(Priority::P7);
    let mut port = usb::Config::default();
    port.vbus_detection = false;
    port
}

/// How the slow sensors' bus is driven.
fn sensors_config() -> i2c::Config {
    let mut bus = i2c::Config::default();
    bus.frequency = Hertz(SENSORS_HZ);
    bus
}

/// Takes the motor lines from their timers and holds them low, whatever the program was doing; speed controllers stop
/// when pulses cease. Only for handlers that never return.
///
/// Not by stopping the timers: that can leave a line high for good.
pub(crate) fn cut_motors() {
    // SAFETY: nobody who holds these pins runs again.
    let pins: [Peri<'static, AnyPin>; 4] = unsafe { chosen::steal_motor_lines() };
    forget(pins.map(|pin| Output::new(pin, Level::Low, Speed::Low)));
}

/// The executor of the control task, on an interrupt that the board does not use.
macro_rules! control_executor {
    ($interrupt:ident) => {
        static CONTROL: embassy_executor::InterruptExecutor = embassy_executor::InterruptExecutor::new();

        /// Starts the executor of the control task; drivers and the clock are above it.
        pub(crate) fn start_control_executor() -> embassy_executor::SendSpawner {
            use embassy_stm32::interrupt::{InterruptExt, Priority};
            embassy_stm32::interrupt::$interrupt.set_priority(Priority::P1);
            CONTROL.start(embassy_stm32::interrupt::$interrupt)
        }

        #[embassy_stm32::interrupt]
        unsafe fn $interrupt() {
            // SAFETY: this handler is the one place that calls it, and `start` has unmasked the interrupt.
            unsafe { CONTROL.on_interrupt() }
        }
    };
}
use control_executor;

/// The slow sensors' bus, by interrupts and DMA: the peripheral, its pins, and the streams to and from it.
macro_rules! sensor_bus {
    ($i2c:ident, $clock:ident, $data:ident, $to:ident, $from:ident) => {
        /// The slow sensors' bus, open.
        pub(crate) type SensorBus<'a> = I2c<'a, embassy_stm32::mode::Async, i2c::mode::Master>;

        /// What the slow sensors' bus is made of.
        pub(crate) struct SensorPins {
            i2c: Peri<'static, $i2c>,
            clock: Peri<'static, $clock>,
            data: Peri<'static, $data>,
            to: Peri<'static, $to>,
            from: Peri<'static, $from>,
        }

        impl SensorPins {
            /// Resets the bus and opens it.
            pub(crate) fn open(&mut self) -> SensorBus<'_> {
                let Self { i2c, clock, data, to, from } = self;
                let (i2c, config) = (i2c.reborrow(), super::sensors_config());
                I2c::new(i2c, clock.reborrow(), data.reborrow(), to.reborrow(), from.reborrow(), Irqs, config)
            }
        }
    };
}
use sensor_bus;
