//! Board: Orbit H743. Names pins, timers and interrupts.
//!
//! | part             | pins                     | by                                                  |
//! |------------------|--------------------------|-----------------------------------------------------|
//! | motors 1 to 4    | PB6 … PB9                | TIM4 channels 1 to 4; bursts by DMA1 stream 6       |
//! | ICM-42688-P      | PE11, PA5 … PA7          | SPI1; DMA2 streams 0 and 3                          |
//! | its data ready   | PC4                      | EXTI4                                               |
//! | radio receiver   | PD6                      | USART2; DMA1 stream 5                               |
//! | battery voltage  | PC0                      | ADC1 channel 10, through 1 : 11                     |
//! | status LED       | PE3, low is on           | GPIO                                                |
//! | crystal          | 8 MHz                    | PLL, 400 MHz                                        |
//! | probe            | PA13, PA14               | SWD: nothing else may claim them                    |
//! | clock            | none                     | TIM5 (`Cargo.toml`, `time-driver-tim5`)             |
//! | control task     | none                     | interrupt FMC                                       |
//!
//! The data cache stays off, and RAM is the AXI memory that DMA reaches (`memory_h743.x`).
//!
//! # Source
//! Betaflight's `configs/ORBITH743/config.h`, repository `betaflight/config`: MOTOR1_PIN to MOTOR4_PIN, GYRO_1_*,
//! UART2_RX_PIN, ADC_VBAT_PIN, LED0_PIN. It names no port for the receiver; the second is taken. Crystal and divider are
//! Betaflight's defaults, which the file leaves.
use core::mem::forget;

use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_stm32::adc::{Adc, AdcChannel, AnyAdcChannel, SampleTime};
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::gpio::{Level, Output, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::peripherals::{ADC1, DMA1_CH5, DMA1_CH6, DMA2_CH0, DMA2_CH3, IWDG1, TIM4, USART2};
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::Channel::{Ch1, Ch2, Ch3, Ch4};
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embassy_stm32::usart::{self, RingBufferedUartRx, UartRx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Config, Peri, Peripherals, bind_interrupts, dma, pac, rcc};
use firmware::icm42688::{Mount, SPI_HZ_MAX};
use firmware::{crsf, dshot};

use crate::motors::Protocol;

/// The board's name, for the log.
pub(crate) const NAME: &str = "Orbit H743";
/// What the speed controllers are sent.
pub(crate) const PROTOCOL: Protocol = Protocol::DShot600;
/// Battery voltage over pin voltage.
pub(crate) const BATTERY_DIVIDER: f32 = 11.0;
/// Forward is the part's y, right its x, down against its z: it is turned by 90° clockwise, seen from above.
pub(crate) const IMU_MOUNT: Mount = [(1, false), (0, false), (2, true)];
/// The status LED is on when its pin is low.
pub(crate) const STATUS_ON: Level = Level::Low;

/// Time without a step that was done in time after which the watchdog resets the chip, µs.
const WATCHDOG_US: u32 = 20_000;
/// Bytes of the radio receiver that may wait: eight frames.
const RADIO_BYTES: usize = 208;

bind_interrupts!(struct Irqs {
    EXTI4 => exti::InterruptHandler<interrupt::typelevel::EXTI4>;
    USART2 => usart::InterruptHandler<USART2>;
    DMA1_STREAM5 => dma::InterruptHandler<DMA1_CH5>;
    DMA1_STREAM6 => dma::InterruptHandler<DMA1_CH6>;
    DMA2_STREAM0 => dma::InterruptHandler<DMA2_CH0>;
    DMA2_STREAM3 => dma::InterruptHandler<DMA2_CH3>;
});

/// Parts the application is allowed to hold.
pub(crate) struct Board {
    /// The motor outputs.
    pub(crate) motors: MotorPins,
    /// The inertial unit's bus.
    pub(crate) imu_bus: ImuBus,
    /// The inertial unit's select line, low while it is spoken to.
    pub(crate) imu_select: Output<'static>,
    /// Rises when a sample is ready.
    pub(crate) imu_ready: ImuReady,
    /// The radio receiver's line.
    pub(crate) radio: Radio,
    /// The battery's voltage.
    pub(crate) battery: Battery,
    /// The status LED.
    pub(crate) status: Status,
    /// Resets the chip once it is unleashed and not fed.
    pub(crate) watchdog: Watchdog,
    /// Whether the watchdog has caused this start.
    pub(crate) bitten: bool,
}

/// The independent watchdog.
pub(crate) type Watchdog = IndependentWatchdog<'static, IWDG1>;
/// The inertial unit's bus.
pub(crate) type ImuBus = Spi<'static, embassy_stm32::mode::Async, spi::mode::Master>;
/// The inertial unit's data-ready line.
pub(crate) type ImuReady = ExtiInput<'static, embassy_stm32::mode::Async>;
/// The radio receiver's line.
pub(crate) type Radio = RingBufferedUartRx<'static>;
/// The status LED.
pub(crate) type Status = Output<'static>;

/// The battery's channel of the converter.
pub(crate) struct Battery {
    converter: Adc<'static, ADC1>,
    channel: AnyAdcChannel<'static, ADC1>,
}

impl Battery {
    /// Measures; the upper 12 of the converter's 16 bits.
    pub(crate) fn counts(&mut self) -> u16 {
        self.converter.blocking_read(&mut self.channel, SampleTime::CYCLES810_5) >> 4
    }
}

/// The timer of the motors, and the DMA stream that writes its bursts.
pub(crate) struct MotorPins {
    timer: SimplePwm<'static, TIM4>,
    dma: Peri<'static, DMA1_CH6>,
}

impl MotorPins {
    /// The timer's counts in one period, which are the counts of a DShot bit or of the time between pulses.
    pub(crate) fn counts(&self) -> u32 {
        self.timer.max_duty_cycle()
    }

    /// Sends one DShot frame to each motor; returns when they are through.
    pub(crate) async fn send(&mut self, values: [dshot::Value; 4]) {
        let words: [u16; 4 * dshot::BITS] = dshot::waveform(values, self.counts() as u16);
        self.timer.waveform_up_multi_channel(self.dma.reborrow(), Irqs, Ch1, Ch4, &words).await;
    }

    /// Sets how long each motor's pulses are from now on, in counts.
    pub(crate) fn set_pulses(&mut self, pulses: [u32; 4]) {
        for (channel, counts) in [Ch1, Ch2, Ch3, Ch4].into_iter().zip(pulses) {
            self.timer.channel(channel).set_duty_cycle(counts);
        }
    }

    /// Connects the outputs; until then their lines are low.
    pub(crate) fn enable(&mut self) {
        for channel in [Ch1, Ch2, Ch3, Ch4] {
            self.timer.channel(channel).enable();
        }
    }
}

/// Claims every peripheral once and leaves the motor lines low.
///
/// - `radio`: where the radio receiver's bytes wait.
pub(crate) fn init(radio: &'static mut RadioBuffer) -> Board {
    let p = embassy_stm32::init(clocks());
    freeze_motor_timer_in_debug();
    // TIM5, the clock, and the drivers stay at the highest priority, 0; the control task is next.
    interrupt::FMC.set_priority(Priority::P1);

    let push = OutputType::PushPull;
    let pins = (PwmPin::new(p.PB6, push), PwmPin::new(p.PB7, push), PwmPin::new(p.PB8, push), PwmPin::new(p.PB9, push));
    let (rate, up) = (Hertz(PROTOCOL.timer_hz()), CountingMode::EdgeAlignedUp);
    let (m1, m2, m3, m4) = pins;
    let motors =
        MotorPins { timer: SimplePwm::new(p.TIM4, Some(m1), Some(m2), Some(m3), Some(m4), rate, up), dma: p.DMA1_CH6 };

    let mut bus = spi::Config::default();
    bus.frequency = Hertz(SPI_HZ_MAX);
    let mut line = usart::Config::default();
    line.baudrate = crsf::BAUD;
    Board {
        motors,
        imu_bus: Spi::new(p.SPI1, p.PA5, p.PA7, p.PA6, p.DMA2_CH3, p.DMA2_CH0, Irqs, bus),
        imu_select: Output::new(p.PE11, Level::High, Speed::VeryHigh),
        imu_ready: ExtiInput::new(p.PC4, p.EXTI4, Pull::Down, Irqs),
        radio: UartRx::new(p.USART2, p.PD6, p.DMA1_CH5, Irqs, line)
            .expect("the baud rate is within the port's range")
            .into_ring_buffered(radio),
        battery: Battery { converter: Adc::new(p.ADC1), channel: p.PC0.degrade_adc() },
        status: Output::new(p.PE3, Level::High, Speed::Low),
        watchdog: IndependentWatchdog::new(p.IWDG1, WATCHDOG_US),
        bitten: take_bitten(),
    }
}

/// Whether the watchdog has caused this start; the flag that says so is cleared.
fn take_bitten() -> bool {
    let bitten = pac::RCC.rsr().read().iwdg1rstf();
    pac::RCC.rsr().modify(|w| w.set_rmvf(true));
    bitten
}

/// Where the radio receiver's bytes wait.
pub(crate) type RadioBuffer = [u8; RADIO_BYTES];
/// An empty one.
pub(crate) const RADIO_BUFFER: RadioBuffer = [0; RADIO_BYTES];

/// 400 MHz from the 8 MHz crystal, half of it for the buses, a quarter for the peripherals.
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

/// Stops the motor timer whenever a probe halts the core: without pulses the speed controllers stop by themselves,
/// where a timer that runs on would repeat the last one.
fn freeze_motor_timer_in_debug() {
    pac::DBGMCU.apb1lfzr1().modify(|w| w.set_tim4(true));
}

/// Takes the motor lines from their timers and holds them low, whatever the program was doing; speed controllers stop
/// when pulses cease.
///
/// Not by stopping the timers: that can leave a line high for good.
pub(crate) fn cut_motors() {
    // SAFETY: for handlers that never return: nobody who holds these pins runs again.
    let p = unsafe { Peripherals::steal() };
    forget([
        Output::new(p.PB6, Level::Low, Speed::Low),
        Output::new(p.PB7, Level::Low, Speed::Low),
        Output::new(p.PB8, Level::Low, Speed::Low),
        Output::new(p.PB9, Level::Low, Speed::Low),
    ]);
}

static CONTROL: InterruptExecutor = InterruptExecutor::new();

/// Starts the executor of the control task, on the interrupt of a memory controller that this package has no pins for.
pub(crate) fn start_control_executor() -> SendSpawner {
    CONTROL.start(interrupt::FMC)
}

#[embassy_stm32::interrupt]
unsafe fn FMC() {
    // SAFETY: this handler is the one place that calls it, and `start` has unmasked the interrupt.
    unsafe { CONTROL.on_interrupt() }
}
