//! Board: Orbit H743. Pins, clocks and interrupts.
//!
//! | part             | pins                     | by                                                  |
//! |------------------|--------------------------|-----------------------------------------------------|
//! | motors 1 to 4    | PA0 … PA3                | TIM2 channels 1 to 4; bursts by DMA1 stream 6       |
//! | their answers    | the same                 | port A sampled by DMA2 stream 1, paced by TIM1      |
//! | ICM-42688-P      | PE11, PA5 … PA7          | SPI1; DMA2 streams 0 and 3                          |
//! | its data ready   | PE10                     | EXTI10                                              |
//! | radio receiver   | PB12                     | UART5; DMA1 stream 5                                |
//! | DPS310, magnetometer | PB8, PB9             | I2C1; DMA1 streams 3 and 4                          |
//! | GNSS receiver    | PC6, PC7                 | USART6; DMA1 streams 0 and 1                        |
//! | vision           | PE7                      | UART7; DMA1 stream 2                                |
//! | station          | PD5, PD6                 | USART2; DMA2 streams 7 and 5                        |
//! | USB              | PA11, PA12               | OTG_FS                                              |
//! | battery voltage  | PC0                      | ADC1 channel 10, through 1 : 10.1; DMA2 stream 2    |
//! | battery current  | PC1                      | ADC1 channel 11, 80 A/V; the same stream            |
//! | status LED       | PE3, low is on           | GPIO                                                |
//! | buzzer           | PB7, high sounds         | GPIO                                                |
//! | parameters       | none                     | the last two sectors of flash                       |
//! | crystal          | 8 MHz                    | PLL, 400 MHz                                        |
//! | probe            | PA13, PA14               | SWD: nothing else may claim them                    |
//! | clock            | none                     | TIM5 (`Cargo.toml`, `time-driver-tim5`)             |
//! | control task     | none                     | interrupt FMC                                       |
//!
//! The data cache stays off, and RAM is the AXI memory that DMA reaches (`memory_h743.x`).
//!
//! Two revisions have been published under this name, and this is the later one. On the first the motors are on PB6 to PB9, the buzzer on PC15,
//! barometer and magnetometer on PD12 and PD13, the inertial unit's data ready on PC4, and it is turned by 180°: this image would send DShot
//! nowhere, and sound the buzzer of a motor's line.
//!
//! # Source
//! ArduPilot's `libraries/AP_HAL_ChibiOS/hwdef/ORBITH743/hwdef.dat`, commit 1eee4fb: motors 1 to 4 (there on TIM5, which counts time here), SPI1 and
//! IMU1_CS, I2C1, UART5 as its receiver's, USART6 as its GNSS's, USART2, UART7, BATT_VOLTAGE_SENS, BATT_CURRENT_SENS, HAL_BATT_VOLT_SCALE, HAL_BATT_CURR_SCALE, LED0, BUZZER, OSCILLATOR_HZ and the
//! rotation of its first IMU, ROLL_180_YAW_270. The data-ready line is of the maker's own file for Betaflight, `configs/ORBITH743/config.h` in the repository
//! `orbittechnologyx/config` at 19bcab5; the first revision is the same file at 8f3614a.
use core::ops::Range;

use embassy_stm32::adc::{Adc, SampleTime};
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::flash::Flash;
use embassy_stm32::gpio::{AnyPin, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::i2c::{self, I2c};
use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH1, DMA1_CH2, DMA1_CH3, DMA1_CH4, DMA1_CH5, DMA1_CH6};
use embassy_stm32::peripherals::{DMA2_CH0, DMA2_CH1, DMA2_CH2, DMA2_CH3, DMA2_CH5, DMA2_CH7};
use embassy_stm32::peripherals::{I2C1, IWDG1, PB8, PB9, PC0, PC1, TIM1, TIM2, UART5, UART7, USART2, USART6};
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
use super::ecc::Checked;
use super::gauge::Gauge;
use super::{
    Board, Buffers, STATION_BAUD, WATCHDOG_US, control_executor, imu_bus_config, line_config, sensor_bus, store,
    usb_config,
};
use crate::gnss;

/// The board's name, for the log.
pub(crate) const NAME: &str = "Orbit H743";
/// Whether the flight log may be on a card, and in a flash chip.
pub(crate) const LOG_ON_CARD: bool = false;
pub(crate) const LOG_ON_FLASH: bool = false;
/// What the battery's lines stand for, unless parameters say otherwise.
pub(crate) const BATTERY_SCALE: Scale = Scale { divider: 10.1, amperes_per_v: 80.0, offset_a: 0.0 };
/// Time in which a line of the battery is sampled.
pub(super) const LINE_SAMPLE: SampleTime = SampleTime::CYCLES810_5;
/// The converter's counts at its reference.
pub(super) const FULL_SCALE: f32 = 65_535.0;
/// The pin of the battery's voltage.
pub(super) type VoltagePin = PC0;
/// The pin of the current out of it.
pub(super) type CurrentPin = PC1;
/// What moves the counts.
pub(super) type GaugeStream = DMA2_CH2;
/// Forward is against the part's y, right against its x, down against its z: it is turned by 90° counterclockwise, seen from above.
pub(crate) const IMU_MOUNT: Mount = [(1, true), (0, true), (2, true)];
/// The status LED is on when its pin is low.
pub(crate) const STATUS_ON: Level = Level::Low;
/// The region of flash that ends with the parameters.
pub(super) type StoreRegion = Checked;
/// The parameters' two sectors within it; the memory map leaves them out.
pub(super) const STORE: Range<u32> = 0xc_0000..0x10_0000;
/// The independent watchdog.
pub(super) type WatchdogUnit = IWDG1;

bind_interrupts!(pub(crate) struct Irqs {
    OTG_FS => usb::InterruptHandler<USB_OTG_FS>;
    EXTI15_10 => exti::InterruptHandler<interrupt::typelevel::EXTI15_10>;
    I2C1_EV => i2c::EventInterruptHandler<I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<I2C1>;
    UART5 => usart::InterruptHandler<UART5>;
    UART7 => usart::InterruptHandler<UART7>;
    USART2 => usart::InterruptHandler<USART2>;
    USART6 => usart::InterruptHandler<USART6>;
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    DMA1_STREAM1 => dma::InterruptHandler<DMA1_CH1>;
    DMA1_STREAM2 => dma::InterruptHandler<DMA1_CH2>;
    DMA1_STREAM3 => dma::InterruptHandler<DMA1_CH3>;
    DMA1_STREAM4 => dma::InterruptHandler<DMA1_CH4>;
    DMA1_STREAM5 => dma::InterruptHandler<DMA1_CH5>;
    DMA1_STREAM6 => dma::InterruptHandler<DMA1_CH6>;
    DMA2_STREAM0 => dma::InterruptHandler<DMA2_CH0>;
    DMA2_STREAM1 => dma::InterruptHandler<DMA2_CH1>;
    DMA2_STREAM2 => dma::InterruptHandler<DMA2_CH2>;
    DMA2_STREAM3 => dma::InterruptHandler<DMA2_CH3>;
    DMA2_STREAM7 => dma::InterruptHandler<DMA2_CH7>;
    DMA2_STREAM5 => dma::InterruptHandler<DMA2_CH5>;
});

sensor_bus!(I2C1, PB8, PB9, DMA1_CH3, DMA1_CH4);

/// The motors' lines.
pub(crate) struct MotorPins(Bank<TIM2, DMA1_CH6, 4>);

impl MotorPins {
    /// Sets the timers' periods a second, before they are enabled.
    pub(crate) fn set_rate(&mut self, hz: u32) {
        self.0.set_rate(hz);
    }

    /// The timer's counts in one period, which are the counts of a DShot bit or of the time between pulses.
    pub(crate) fn counts(&self) -> u32 {
        self.0.counts()
    }

    /// Sends one DShot frame to each motor; returns when they are through.
    pub(crate) async fn send(&mut self, values: [dshot::Value; 4], dialogue: Dialogue) {
        self.0.write(values, dialogue);
        self.0.send().await;
    }

    /// Sets how long each motor's pulses are from now on, in counts.
    pub(crate) fn set_pulses(&mut self, pulses: [u32; 4]) {
        self.0.set_pulses(pulses);
    }

    /// Connects the outputs; until then their lines are low.
    pub(crate) fn enable(&mut self, dialogue: Dialogue) {
        self.0.enable(dialogue);
    }
}

/// What listens to the speed controllers.
pub(crate) type MotorEar = Ear<TIM1, DMA2_CH1>;

/// Claims every peripheral once and leaves the motor lines low.
///
/// - `buffers`: where bytes that come over lines wait.
pub(crate) fn init(buffers: &'static mut Buffers) -> Board {
    let p = embassy_stm32::init(clocks());
    start_core_extras();
    freeze_motor_timer_in_debug();

    let push = OutputType::PushPull;
    let (m1, m2) = (PwmPin::new(p.PA0, push), PwmPin::new(p.PA1, push));
    let (m3, m4) = (PwmPin::new(p.PA2, push), PwmPin::new(p.PA3, push));
    let (rate, up) = (UNTOLD, CountingMode::EdgeAlignedUp);
    let timer = SimplePwm::new(p.TIM2, Some(m1), Some(m2), Some(m3), Some(m4), rate, up);
    let gnss = Uart::new(p.USART6, p.PC7, p.PC6, p.DMA1_CH0, p.DMA1_CH1, Irqs, line_config(ubx::BAUD));
    let (bitten, browned_out) = take_causes();
    Board {
        motors: MotorPins(Bank::new(timer, p.DMA1_CH6, [Ch1, Ch2, Ch3, Ch4])),
        ear: Some(Ear::new(p.TIM1, p.DMA2_CH1, pac::GPIOA, [0, 1, 2, 3])),
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
        imu_select: Output::new(p.PE11, Level::High, Speed::VeryHigh),
        imu_ready: ExtiInput::new(p.PE10, p.EXTI10, Pull::Down, Irqs),
        radio: UartRx::new(p.UART5, p.PB12, p.DMA1_CH5, Irqs, line_config(crsf::BAUD))
            .expect("the baud rate is within the port's range")
            .into_ring_buffered(&mut buffers.radio),
        sensors: SensorPins { i2c: p.I2C1, clock: p.PB8, data: p.PB9, to: p.DMA1_CH3, from: p.DMA1_CH4 },
        gnss: gnss::Port::new(gnss.expect("the baud rate is within the port's range"), &mut buffers.gnss),
        vision: UartRx::new(p.UART7, p.PE7, p.DMA1_CH2, Irqs, line_config(pose::BAUD))
            .expect("the baud rate is within the port's range")
            .into_ring_buffered(&mut buffers.vision),
        station: Uart::new(p.USART2, p.PD6, p.PD5, p.DMA2_CH7, p.DMA2_CH5, Irqs, line_config(STATION_BAUD))
            .expect("the baud rate is within the port's range")
            .split(),
        usb: usb::Driver::new_fs(p.USB_OTG_FS, Irqs, p.PA12, p.PA11, &mut buffers.usb, usb_config()),
        store: store(Checked(Flash::new_blocking(p.FLASH).into_blocking_regions().bank2_region)),
        log_bus: None,
        battery: Gauge { converter: Adc::new(p.ADC1), voltage: p.PC0, current: p.PC1, stream: p.DMA2_CH2 },
        status: Output::new(p.PE3, Level::High, Speed::Low),
        buzzer: Output::new(p.PB7, Level::Low, Speed::Low),
        watchdog: IndependentWatchdog::new(p.IWDG1, WATCHDOG_US),
        bitten,
        browned_out,
    }
}

/// Whether the watchdog, or a supply that was too low, has caused this start; the flags that say so are cleared.
fn take_causes() -> (bool, bool) {
    let flags = pac::RCC.rsr().read();
    pac::RCC.rsr().modify(|w| w.set_rmvf(true));
    // Switching on raises the flag of the supply too.
    (flags.iwdg1rstf(), flags.borrstf() && !flags.porrstf())
}

/// 400 MHz from the 8 MHz crystal, half of it for the buses, a quarter for the peripherals. USB has an oscillator of its own, which
/// follows the computer's.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(rcc::Hse { freq: Hertz(8_000_000), mode: rcc::HseMode::Oscillator });
    config.rcc.pll1 = Some(rcc::Pll {
        source: rcc::PllSource::HSE,
        prediv: rcc::PllPreDiv::DIV1,
        mul: rcc::PllMul::MUL100,
        fracn: None,
        divp: Some(rcc::PllDiv::DIV2),
        divq: Some(rcc::PllDiv::DIV8),
        divr: None,
    });
    config.rcc.pll2 = Some(rcc::Pll {
        source: rcc::PllSource::HSE,
        prediv: rcc::PllPreDiv::DIV1,
        mul: rcc::PllMul::MUL50,
        fracn: None,
        // For the converter.
        divp: Some(rcc::PllDiv::DIV8),
        divq: None,
        divr: None,
    });
    config.rcc.hsi48 = Some(rcc::Hsi48Config { sync_from_usb: true });
    config.rcc.mux.usbsel = rcc::mux::Usbsel::HSI48;
    config.rcc.mux.adcsel = rcc::mux::Adcsel::PLL2_P;
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    config.rcc.ahb_pre = rcc::AHBPrescaler::DIV2;
    config.rcc.apb1_pre = rcc::APBPrescaler::DIV2;
    config.rcc.apb2_pre = rcc::APBPrescaler::DIV2;
    config.rcc.apb3_pre = rcc::APBPrescaler::DIV2;
    config.rcc.apb4_pre = rcc::APBPrescaler::DIV2;
    config.rcc.voltage_scale = rcc::VoltageScale::Scale1;
    config
}

/// Turns on the instruction cache, and the cycle counter, which this core locks.
fn start_core_extras() {
    // SAFETY: nothing else has begun.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.SCB.enable_icache();
    cortex_m::peripheral::DWT::unlock();
}

/// Stops the motor timer whenever a probe halts the core: without pulses the speed controllers stop by themselves,
/// where a timer that runs on would repeat the last one.
fn freeze_motor_timer_in_debug() {
    pac::DBGMCU.apb1lfzr1().modify(|w| w.set_tim2(true));
}

/// The motors' lines, whoever holds them.
///
/// # Safety
/// Nobody else may use them from now on.
pub(super) unsafe fn steal_motor_lines() -> [Peri<'static, AnyPin>; 4] {
    // SAFETY: as above.
    let p = unsafe { Peripherals::steal() };
    [p.PA0.into(), p.PA1.into(), p.PA2.into(), p.PA3.into()]
}

// The interrupt of a memory controller that this package has no pins for.
control_executor!(FMC);
