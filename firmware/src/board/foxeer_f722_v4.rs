//! Board: Foxeer F722 V4. Pins, clocks and interrupts.
//!
//! | part             | pins                     | by                                                  |
//! |------------------|--------------------------|-----------------------------------------------------|
//! | motors 1, 2      | PA9, PA8                 | TIM1 channels 2, 1; bursts by DMA2 stream 5         |
//! | motors 3, 4      | PC9, PC8                 | TIM8 channels 4, 3; bursts by DMA2 stream 1         |
//! | ICM-42688-P      | PB2, PA5 … PA7           | SPI1; DMA2 streams 0 and 3                          |
//! | its data ready   | PC4                      | EXTI4                                               |
//! | radio receiver   | PA1                      | UART4; DMA1 stream 2                                |
//! | DPS310, magnetometer | PB8, PB9             | I2C1; DMA1 streams 7 and 0                          |
//! | GNSS receiver    | PA2, PA3                 | USART2; DMA1 streams 6 and 5                        |
//! | vision           | PB11                     | USART3; DMA1 stream 1                               |
//! | station          | PB6, PB7                 | USART1; DMA2 streams 7 and 2                        |
//! | USB              | PA11, PA12               | OTG_FS                                              |
//! | flash, a W25Q128 | PB12 … PB15              | SPI2; DMA1 streams 4 and 3                          |
//! | battery voltage  | PC0                      | ADC1 channel 10, through 1 : 11; DMA2 stream 4      |
//! | battery current  | PC2                      | ADC1 channel 12, 25 A/V; the same stream            |
//! | status LED       | PC15, low is on          | GPIO                                                |
//! | buzzer           | PA4, high sounds      | GPIO                                                |
//! | parameters       | none                     | the last two sectors of flash                       |
//! | crystal          | 8 MHz                    | PLL, 216 MHz                                        |
//! | probe            | PA13, PA14               | SWD: nothing else may claim them                    |
//! | clock            | none                     | TIM5 (`Cargo.toml`, `time-driver-tim5`)             |
//! | control task     | none                     | interrupt FMC                                       |
//!
//! The data cache stays off; all of RAM is reached by DMA (`memory_f722.x`).
//!
//! # Source
//! Betaflight's `configs/FOXEERF722V4/config.h`, repository `betaflight/config`: MOTOR1_PIN to MOTOR4_PIN, GYRO_1_*,
//! UART1_*, UART4_RX_PIN, SPI2_*, FLASH_SPI_INSTANCE, FLASH_CS_PIN, USE_FLASH_W25Q128FV, I2C1_*, BARO_I2C_INSTANCE and MAG_I2C_INSTANCE, UART2_*, UART3_RX_PIN, ADC_VBAT_PIN, ADC_CURR_PIN, LED0_PIN, BEEPER_PIN, BEEPER_INVERTED,
//! GYRO_1_ALIGN. It names no ports for receivers and vision: which are taken is ours. Crystal, divider and the scale of the current, 400 mV per 10 A, are Betaflight's
//! defaults, which the file leaves. Boards sold with an MPU-6000 in the place of the ICM-42688-P are
//! driven too, those with a BMP280 not.
use core::ops::Range;

use embassy_stm32::adc::SampleTime;
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::flash::{Bank1Region3, Blocking as StoreMode, Flash};
use embassy_stm32::gpio::{AnyPin, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::i2c::{self, I2c};
use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH1, DMA1_CH2, DMA1_CH3, DMA1_CH4, DMA1_CH5, DMA1_CH6, DMA1_CH7};
use embassy_stm32::peripherals::{DMA2_CH0, DMA2_CH1, DMA2_CH3, DMA2_CH4, DMA2_CH5};
use embassy_stm32::peripherals::{DMA2_CH2, DMA2_CH7, USART1};
use embassy_stm32::peripherals::{I2C1, IWDG, PB8, PB9, PC0, PC2, TIM1, TIM8, UART4, USART2, USART3};
use embassy_stm32::spi::Spi;
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::Channel::{Ch1, Ch2, Ch3, Ch4};
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embassy_stm32::usart::{self, Uart, UartRx};
use embassy_stm32::usb;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Config, Peri, Peripherals, bind_interrupts, dma, interrupt, pac, rcc};
use firmware::battery::Scale;
use firmware::dshot::{self, Dialogue};
use firmware::icm42688::Mount;
use firmware::{crsf, mpu6000, pose, ubx};

use super::bank::{Bank, UNTOLD};
use super::ear::Ear;
use super::gauge::Gauge;
use super::{
    Board, Buffers, STATION_BAUD, WATCHDOG_US, control_executor, imu_bus_config, line_config, sensor_bus, store,
    usb_config,
};
use crate::gnss;
use crate::log_bus::{self, LogBus};

/// The board's name, for the log.
pub(crate) const NAME: &str = "Foxeer F722 V4";
/// Whether the flight log may be on a card, and in a flash chip.
pub(crate) const LOG_ON_CARD: bool = false;
pub(crate) const LOG_ON_FLASH: bool = true;
/// What the battery's lines stand for, unless parameters say otherwise.
pub(crate) const BATTERY_SCALE: Scale = Scale { divider: 11.0, amperes_per_v: 25.0, offset_a: 0.0 };
/// Time in which a line of the battery is sampled.
pub(super) const LINE_SAMPLE: SampleTime = SampleTime::CYCLES480;
/// The converter's counts at its reference.
pub(super) const FULL_SCALE: f32 = 4_095.0;
/// The pin of the battery's voltage.
pub(super) type VoltagePin = PC0;
/// The pin of the current out of it.
pub(super) type CurrentPin = PC2;
/// What moves the counts.
pub(super) type GaugeStream = DMA2_CH4;
/// Forward is against the part's y, right against its x, down against its z: it is turned by 270° clockwise, seen from above.
pub(crate) const IMU_MOUNT: Mount = [(1, true), (0, true), (2, true)];
/// The status LED is on when its pin is low.
pub(crate) const STATUS_ON: Level = Level::Low;
/// The region of flash that ends with the parameters.
pub(super) type StoreRegion = Bank1Region3<'static, StoreMode>;
/// The parameters' two sectors within it; the memory map leaves them out.
pub(super) const STORE: Range<u32> = 0x2_0000..0x6_0000;
/// The independent watchdog.
pub(super) type WatchdogUnit = IWDG;

bind_interrupts!(pub(crate) struct Irqs {
    OTG_FS => usb::InterruptHandler<USB_OTG_FS>;
    EXTI4 => exti::InterruptHandler<interrupt::typelevel::EXTI4>;
    I2C1_EV => i2c::EventInterruptHandler<I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<I2C1>;
    UART4 => usart::InterruptHandler<UART4>;
    USART1 => usart::InterruptHandler<USART1>;
    USART2 => usart::InterruptHandler<USART2>;
    USART3 => usart::InterruptHandler<USART3>;
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    DMA1_STREAM1 => dma::InterruptHandler<DMA1_CH1>;
    DMA1_STREAM2 => dma::InterruptHandler<DMA1_CH2>;
    DMA1_STREAM3 => dma::InterruptHandler<DMA1_CH3>;
    DMA1_STREAM4 => dma::InterruptHandler<DMA1_CH4>;
    DMA1_STREAM5 => dma::InterruptHandler<DMA1_CH5>;
    DMA1_STREAM6 => dma::InterruptHandler<DMA1_CH6>;
    DMA1_STREAM7 => dma::InterruptHandler<DMA1_CH7>;
    DMA2_STREAM0 => dma::InterruptHandler<DMA2_CH0>;
    DMA2_STREAM1 => dma::InterruptHandler<DMA2_CH1>;
    DMA2_STREAM3 => dma::InterruptHandler<DMA2_CH3>;
    DMA2_STREAM4 => dma::InterruptHandler<DMA2_CH4>;
    DMA2_STREAM5 => dma::InterruptHandler<DMA2_CH5>;
    DMA2_STREAM7 => dma::InterruptHandler<DMA2_CH7>;
    DMA2_STREAM2 => dma::InterruptHandler<DMA2_CH2>;
});

sensor_bus!(I2C1, PB8, PB9, DMA1_CH7, DMA1_CH0);

/// The motors' lines.
pub(crate) struct MotorPins {
    first: Bank<TIM1, DMA2_CH5, 2>,
    second: Bank<TIM8, DMA2_CH1, 2>,
}

/// What would listen to the speed controllers: nothing does, their lines are on two ports, and both streams that timers pace and that reach
/// ports are the motors' own.
pub(crate) type MotorEar = Ear<TIM1, DMA2_CH5>;

impl MotorPins {
    /// Sets the timers' periods a second, before they are enabled.
    pub(crate) fn set_rate(&mut self, hz: u32) {
        self.first.set_rate(hz);
        self.second.set_rate(hz);
    }

    /// The timers' counts in one period, which are the counts of a DShot bit or of the time between pulses.
    pub(crate) fn counts(&self) -> u32 {
        self.first.counts()
    }

    /// Sends one DShot frame to each motor; returns when they are through.
    pub(crate) async fn send(&mut self, [a, b, c, d]: [dshot::Value; 4], dialogue: Dialogue) {
        // First all of them: they begin together.
        self.first.write([b, a], dialogue);
        self.second.write([d, c], dialogue);
        embassy_futures::join::join(self.first.send(), self.second.send()).await;
    }

    /// Sets how long each motor's pulses are from now on, in counts.
    pub(crate) fn set_pulses(&mut self, [a, b, c, d]: [u32; 4]) {
        self.first.set_pulses([b, a]);
        self.second.set_pulses([d, c]);
    }

    /// Connects the outputs; until then their lines are low.
    pub(crate) fn enable(&mut self, dialogue: Dialogue) {
        self.first.enable(dialogue);
        self.second.enable(dialogue);
    }
}

/// Claims every peripheral once and leaves the motor lines low.
///
/// - `buffers`: where bytes that come over lines wait.
pub(crate) fn init(buffers: &'static mut Buffers) -> Board {
    let p = embassy_stm32::init(clocks());
    start_core_extras();
    freeze_motor_timers_in_debug();

    let push = OutputType::PushPull;
    let (m1, m2) = (PwmPin::new(p.PA9, push), PwmPin::new(p.PA8, push));
    let (m3, m4) = (PwmPin::new(p.PC9, push), PwmPin::new(p.PC8, push));
    let (rate, up) = (UNTOLD, CountingMode::EdgeAlignedUp);
    let first = SimplePwm::new(p.TIM1, Some(m2), Some(m1), None, None, rate, up);
    let second = SimplePwm::new(p.TIM8, None, None, Some(m4), Some(m3), rate, up);
    let gnss = Uart::new(p.USART2, p.PA3, p.PA2, p.DMA1_CH6, p.DMA1_CH5, Irqs, line_config(ubx::BAUD));
    let (bitten, browned_out) = take_causes();
    Board {
        motors: MotorPins {
            first: Bank::new(first, p.DMA2_CH5, [Ch1, Ch2]),
            second: Bank::new(second, p.DMA2_CH1, [Ch3, Ch4]),
        },
        ear: None,
        imu_bus: Spi::new(
            p.SPI1,
            p.PA5,
            p.PA7,
            p.PA6,
            p.DMA2_CH3,
            p.DMA2_CH0,
            Irqs,
            imu_bus_config(mpu6000::SPI_HZ_MAX.0),
        ),
        imu_select: Output::new(p.PB2, Level::High, Speed::VeryHigh),
        imu_ready: ExtiInput::new(p.PC4, p.EXTI4, Pull::Down, Irqs),
        radio: UartRx::new(p.UART4, p.PA1, p.DMA1_CH2, Irqs, line_config(crsf::BAUD))
            .expect("the baud rate is within the port's range")
            .into_ring_buffered(&mut buffers.radio),
        sensors: SensorPins { i2c: p.I2C1, clock: p.PB8, data: p.PB9, to: p.DMA1_CH7, from: p.DMA1_CH0 },
        gnss: gnss::Port::new(gnss.expect("the baud rate is within the port's range"), &mut buffers.gnss),
        vision: UartRx::new(p.USART3, p.PB11, p.DMA1_CH1, Irqs, line_config(pose::BAUD))
            .expect("the baud rate is within the port's range")
            .into_ring_buffered(&mut buffers.vision),
        station: Uart::new(p.USART1, p.PB7, p.PB6, p.DMA2_CH7, p.DMA2_CH2, Irqs, line_config(STATION_BAUD))
            .expect("the baud rate is within the port's range")
            .split(),
        usb: usb::Driver::new_fs(p.USB_OTG_FS, Irqs, p.PA12, p.PA11, &mut buffers.usb, usb_config()),
        store: store(Flash::new_blocking(p.FLASH).into_blocking_regions().bank1_region3),
        log_bus: Some(LogBus::new(
            Spi::new(p.SPI2, p.PB13, p.PB15, p.PB14, p.DMA1_CH4, p.DMA1_CH3, Irqs, log_bus::config()),
            Output::new(p.PB12, Level::High, Speed::VeryHigh),
        )),
        battery: Gauge { converter: p.ADC1, voltage: p.PC0, current: p.PC2, stream: p.DMA2_CH4 },
        status: Output::new(p.PC15, Level::High, Speed::Low),
        buzzer: Output::new(p.PA4, Level::Low, Speed::Low),
        watchdog: IndependentWatchdog::new(p.IWDG, WATCHDOG_US),
        bitten,
        browned_out,
    }
}

/// Whether the watchdog, or a supply that was too low, has caused this start; the flags that say so are cleared.
fn take_causes() -> (bool, bool) {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // Switching on raises the flag of the supply too.
    (flags.wdgrstf(), flags.borrstf() && !flags.porrstf())
}

/// 216 MHz from the 8 MHz crystal; 48 MHz for USB.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(rcc::Hse { freq: Hertz(8_000_000), mode: rcc::HseMode::Oscillator });
    config.rcc.pll_src = rcc::PllSource::HSE;
    config.rcc.pll = Some(rcc::Pll {
        prediv: rcc::PllPreDiv::DIV4,
        mul: rcc::PllMul::MUL216,
        divp: Some(rcc::PllPDiv::DIV2),
        divq: Some(rcc::PllQDiv::DIV9),
        divr: None,
    });
    config.rcc.mux.clk48sel = rcc::mux::Clk48sel::PLL1_Q;
    config.rcc.ahb_pre = rcc::AHBPrescaler::DIV1;
    config.rcc.apb1_pre = rcc::APBPrescaler::DIV4;
    config.rcc.apb2_pre = rcc::APBPrescaler::DIV2;
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    config
}

/// Turns on the instruction cache, and the cycle counter, which this core locks.
fn start_core_extras() {
    // SAFETY: nothing else has begun.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.SCB.enable_icache();
    cortex_m::peripheral::DWT::unlock();
}

/// Stops the motor timers whenever a probe halts the core: without pulses the speed controllers stop by themselves,
/// where a timer that runs on would repeat the last one.
fn freeze_motor_timers_in_debug() {
    pac::DBGMCU.apb2fzr().modify(|w| {
        w.set_tim1(true);
        w.set_tim8(true);
    });
}

/// The motors' lines, whoever holds them.
///
/// # Safety
/// Nobody else may use them from now on.
pub(super) unsafe fn steal_motor_lines() -> [Peri<'static, AnyPin>; 4] {
    // SAFETY: as above.
    let p = unsafe { Peripherals::steal() };
    [p.PA9.into(), p.PA8.into(), p.PC9.into(), p.PC8.into()]
}

// The interrupt of a memory controller that this package has no pins for.
control_executor!(FMC);
