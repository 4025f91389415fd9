//! Board: SpeedyBee F405 V3. The only file that names pins, timers or interrupts.
//! To port: copy this file, keep its public items, select it in `board/mod.rs`.
//!
//! | part          | pins      | by                                       |
//! |---------------|-----------|------------------------------------------|
//! | motors 1 to 4 | PB6 … PB9 | TIM4 channels 1 to 4                     |
//! | status LED    | PC8       | GPIO                                     |
//! | crystal       | 8 MHz     | PLL, 168 MHz                             |
//! | probe         | PA13, PA14 | SWD: nothing else may claim them        |
//! | clock         | none      | TIM5 (`Cargo.toml`, `time-driver-tim5`)  |
//! | control task  | none      | interrupt FSMC                           |
//!
//! # Source
//! Betaflight's unified target `configs/default/SPBE-SPEEDYBEEF405V3.config`, repository `betaflight/unified-targets`:
//! resources MOTOR 1 to 4, LED 1, timers of B06 to B09, `system_hse_mhz`.
use core::mem::forget;

use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_stm32::gpio::{Level, Output, OutputType, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::peripherals::TIM4;
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::{CountingMode, OutputCompareMode, Timer};
use embassy_stm32::timer::simple_pwm::PwmPin;
use embassy_stm32::timer::{Ch1, Ch2, Ch3, Ch4, Channel};
use embassy_stm32::{Config, Peri, Peripherals, pac, rcc};
use firmware::pulse::Pulse;

/// The board's name, for the log.
pub(crate) const NAME: &str = "SpeedyBee F405 V3";

/// Time between motor pulses, µs: 400 Hz, which every analogue speed controller takes and which leaves room for
/// [`Pulse::FULL`].
const MOTOR_PERIOD_US: u16 = 2_500;
/// One count of the motor timer is a microsecond, so that a compare value is a pulse width.
const MOTOR_COUNT_HZ: Hertz = Hertz(1_000_000);
const MOTOR_CHANNELS: [Channel; 4] = [Channel::Ch1, Channel::Ch2, Channel::Ch3, Channel::Ch4];

/// Parts the application is allowed to hold.
pub(crate) struct Board {
    /// The four motor outputs.
    pub(crate) motors: Motors,
    /// The status LED.
    pub(crate) status: Status,
}

/// The status LED.
pub(crate) type Status = Output<'static>;

/// The motor lines. Held, for a pin that is dropped lets go of its line.
type MotorPins =
    (PwmPin<'static, TIM4, Ch1>, PwmPin<'static, TIM4, Ch2>, PwmPin<'static, TIM4, Ch3>, PwmPin<'static, TIM4, Ch4>);

/// The four motor outputs, in airframe order. They can only stop: sending any other pulse comes with arming.
pub(crate) struct Motors {
    timer: Timer<'static, TIM4>,
    _pins: MotorPins,
}

impl Motors {
    fn new(timer: Peri<'static, TIM4>, pins: MotorPins) -> Self {
        let mut timer = Timer::new(timer);
        timer.set_counting_mode(CountingMode::EdgeAlignedUp);
        timer.set_tick_freq(MOTOR_COUNT_HZ);
        timer.set_max_compare_value(MOTOR_PERIOD_US - 1);
        timer.set_autoreload_preload(true);
        for channel in MOTOR_CHANNELS {
            timer.set_output_compare_mode(channel, OutputCompareMode::PwmMode1);
            // A width changes between pulses, never within one.
            timer.set_output_compare_preload(channel, true);
        }
        let mut motors = Self { timer, _pins: pins };
        motors.stop();
        motors.timer.generate_update_event();
        // Before the count starts, so that the first pulse is not cut short.
        for channel in MOTOR_CHANNELS {
            motors.timer.enable_channel(channel, true);
        }
        motors.timer.start();
        motors
    }

    /// Sends the stop pulse to every motor.
    pub(crate) fn stop(&mut self) {
        for channel in MOTOR_CHANNELS {
            self.timer.set_compare_value(channel, Pulse::STOP.us());
        }
    }
}

/// Claims every peripheral once and leaves the motors stopped.
pub(crate) fn init() -> Board {
    let p = embassy_stm32::init(clocks());
    enable_flash_caches();
    freeze_motor_timer_in_debug();
    // TIM5, the clock, stays at the highest priority, 0; the control task is next.
    interrupt::FSMC.set_priority(Priority::P1);
    let push = OutputType::PushPull;
    Board {
        motors: Motors::new(
            p.TIM4,
            (PwmPin::new(p.PB6, push), PwmPin::new(p.PB7, push), PwmPin::new(p.PB8, push), PwmPin::new(p.PB9, push)),
        ),
        status: Output::new(p.PC8, Level::Low, Speed::Low),
    }
}

/// 168 MHz from the 8 MHz crystal; 48 MHz for USB.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(rcc::Hse { freq: Hertz(8_000_000), mode: rcc::HseMode::Oscillator });
    config.rcc.pll_src = rcc::PllSource::HSE;
    config.rcc.pll = Some(rcc::Pll {
        prediv: rcc::PllPreDiv::DIV4,
        mul: rcc::PllMul::MUL168,
        divp: Some(rcc::PllPDiv::DIV2),
        divq: Some(rcc::PllQDiv::DIV7),
        divr: None,
    });
    config.rcc.ahb_pre = rcc::AHBPrescaler::DIV1;
    config.rcc.apb1_pre = rcc::APBPrescaler::DIV4;
    config.rcc.apb2_pre = rcc::APBPrescaler::DIV2;
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    config
}

/// Turns on the flash's instruction and data caches, which the HAL leaves off: every miss costs five wait states.
///
/// Not the prefetch: revision A of the chip does not support it.
fn enable_flash_caches() {
    pac::FLASH.acr().modify(|w| {
        w.set_icen(true);
        w.set_dcen(true);
    });
}

/// Stops the motor timer whenever a probe halts the core: without pulses the speed controllers stop by themselves,
/// where a timer that runs on would repeat the last one.
fn freeze_motor_timer_in_debug() {
    pac::DBGMCU.apb1fzr().modify(|w| w.set_tim4(true));
}

/// Takes the motor lines from their timer and holds them low, whatever the program was doing; speed controllers stop
/// when pulses cease.
///
/// Not by stopping the timer: that can leave a line high for good.
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
    CONTROL.start(interrupt::FSMC)
}

#[embassy_stm32::interrupt]
unsafe fn FSMC() {
    // SAFETY: this handler is the one place that calls it, and `start` has unmasked the interrupt.
    unsafe { CONTROL.on_interrupt() }
}
