//! The board: a SpeedyBee F405 V4, what is soldered to the chip's pins.
//!
//! | part                   | pins                               |
//! |------------------------|------------------------------------|
//! | inertial unit          | SPI1, select PA4, INT1 PC4         |
//! | speed controllers      | TIM4 CH1 PB6, CH2 PB7; TIM3 CH3 PB0, CH4 PB1 |
//! | radio receiver         | USART2                             |
//! | barometer, magnetometer | I2C1, PB8 and PB9                 |
//! | satellite receiver     | USART6                             |
//! | vision computer        | USART1                             |
//! | station                | USART3                             |
//! | buzzer                 | PC15                               |
//! | microSD card, or a flash chip in its place | SPI3, PB3 to PB5, select PC14 |
//! | battery: voltage through 1 : 11, current at 25 A/V | ADC1 channels 10 and 11, PC0 and PC1 |
//!
//! # Source
//! As `firmware/src/board/speedybee_f405_v4.rs`, where it is cited.
use crate::device::esc::{Esc, Heard, Protocol};
use crate::device::inertial_unit::{Inertial, InertialUnit};
use crate::device::log_flash::LogFlash;
use crate::device::sd_card::SdCard;
use crate::device::sensor_bus::SensorBus;
use crate::device::ublox::Ublox;
use crate::peripheral::timer::Pulse;

/// Frequency of the crystal, Hz.
pub(crate) const HSE_HZ: u64 = 8_000_000;
/// Cycles of the core in a microsecond, once its clock is set: devices have clocks of their own and begin after that.
pub(crate) const CYCLES_US: u64 = 168;
/// Port and pin of the inertial unit's select line and of its data-ready line.
pub(crate) const IMU_SELECT: (usize, u32) = (0, 4);
pub(crate) const IMU_READY: (usize, u32) = (2, 4);
/// Port and pin of the buzzer, which sounds while it is high.
pub(crate) const BUZZER: (usize, u32) = (2, 15);
/// The ports of the radio receiver, the satellite receiver and the vision computer, counted from zero.
pub(crate) const RADIO: usize = 1;
pub(crate) const GNSS: usize = 5;
pub(crate) const VISION: usize = 0;
/// Bits a second from the radio receiver and the vision computer.
pub(crate) const RADIO_BAUD: u32 = 420_000;
pub(crate) const VISION_BAUD: u32 = 921_600;
/// The bus of the slow sensors, counted from zero, its pins and their alternate function.
pub(crate) const SENSORS: usize = 0;
pub(crate) const SENSOR_PINS: [(usize, u32); 2] = [(1, 8), (1, 9)];
pub(crate) const SENSOR_FUNCTION: u32 = 4;
/// The card's bus, counted from zero, its pins and their alternate function, and its select line.
pub(crate) const CARD: usize = 2;
pub(crate) const CARD_PINS: [(usize, u32); 3] = [(1, 3), (1, 4), (1, 5)];
pub(crate) const CARD_FUNCTION: u32 = 6;
/// A card's fastest clock, Hz, in its default mode.
const CARD_HZ_MAX: u64 = 25_000_000;
/// The log flash's, for the instruction that reads.
const LOG_FLASH_HZ_MAX: u64 = 50_000_000;
pub(crate) const CARD_SELECT: (usize, u32) = (2, 14);
/// The station's port, counted from zero, and its speed, bit/s.
pub(crate) const STATION: usize = 2;
pub(crate) const STATION_BAUD: u32 = 115_200;
/// Timer and channel, port and pin of each motor; all are that pin's alternate function 2.
pub(crate) const MOTORS: [(usize, usize, (usize, u32)); 4] =
    [(4, 0, (1, 6)), (4, 1, (1, 7)), (3, 2, (1, 0)), (3, 3, (1, 1))];
pub(crate) const MOTOR_FUNCTION: u32 = 2;
/// The converter's channels, and port and pin, of the battery's voltage and current, and what a volt there stands for, V and A.
const BATTERY: [(u32, (usize, u32), f32); 2] = [(10, (2, 0), 11.0), (11, (2, 1), 25.0)];
const REFERENCE_V: f32 = 3.3;

/// What a bit takes at this many a second, core cycles.
pub(crate) fn bit_cycles(baud: u32) -> u64 {
    (1_000_000 * CYCLES_US + u64::from(baud) / 2) / u64::from(baud.max(1))
}

/// Devices, and what was seen of them.
#[derive(Debug)]
pub(crate) struct Board {
    pub(crate) imu: InertialUnit,
    pub(crate) sensors: SensorBus,
    pub(crate) gnss: Ublox,
    pub(crate) card: SdCard,
    /// What is soldered on in the place of the slot, if it is.
    pub(crate) log_flash: Option<LogFlash>,
    pub(crate) escs: [Esc; 4],
    /// Voltage, V, and current, A.
    pub(crate) battery: [f32; 2],
    /// How many conversions of the battery's lines never end, from now on.
    pub(crate) conversions_lost: u32,
    /// Whether the chip no longer sees the data-ready line.
    pub(crate) ready_line_broken: bool,
    /// Longest time from a sample to the first frame that was through after it, core cycles.
    pub(crate) latency_max: u64,
}

impl Board {
    pub(crate) fn new() -> Self {
        Self {
            imu: InertialUnit::new(Inertial::Icm42688, CYCLES_US),
            sensors: SensorBus::new(CYCLES_US),
            gnss: Ublox::new(CYCLES_US),
            card: SdCard::new(CYCLES_US),
            log_flash: None,
            escs: std::array::from_fn(Esc::new),
            battery: [16.8, 0.0],
            conversions_lost: 0,
            ready_line_broken: false,
            latency_max: 0,
        }
    }

    /// Power fails for a moment.
    pub(crate) fn cut_power(&mut self, now: u64) {
        self.imu.power_up();
        self.card.power_up();
        self.escs.iter_mut().for_each(Esc::power_up);
        if let Some(flash) = &mut self.log_flash {
            flash.cut_power(now);
        }
    }

    /// The select line of what is on the log's bus.
    pub(crate) fn select_log(&mut self, low: bool, now: u64) {
        match &mut self.log_flash {
            Some(flash) => flash.select(low, now),
            None => self.card.select(low),
        }
    }

    /// What of that is not modelled, if something of it was done.
    pub(crate) fn unknown_of_log(&mut self) -> Option<String> {
        self.log_flash.as_mut().map_or(&mut self.card.unknown, |flash| &mut flash.unknown).take()
    }

    /// Tells the inertial unit how the body moves: forward, right, down.
    pub(crate) fn move_body(&mut self, force_m_s2: [f32; 3], rate_rad_s: [f32; 3]) {
        // Its x is right, its y forward, its z up.
        let part = |[forward, right, down]: [f32; 3]| [right, forward, -down];
        self.imu.feel(part(force_m_s2), part(rate_rad_s));
    }

    /// Tells the magnetometer the field: forward, right, down, µT.
    pub(crate) fn set_field(&mut self, [forward, right, down]: [f32; 3], now: u64) {
        // Its x is forward, its y left, its z up.
        self.sensors.magnetometer.feel([forward, -right, -down], now);
    }

    /// The fastest clock that what is on a bus can take, Hz.
    pub(crate) fn spi_hz_max(&self, spi: usize) -> u64 {
        match spi {
            0 => self.imu.spi_hz_max(),
            CARD if self.log_flash.is_some() => LOG_FLASH_HZ_MAX,
            CARD => CARD_HZ_MAX,
            _ => u64::MAX,
        }
    }

    /// Answers a word on a bus.
    pub(crate) fn exchange(&mut self, spi: usize, word: u16, now: u64) -> u16 {
        match spi {
            0 => self.imu.exchange(word as u8, now).into(),
            CARD => match &mut self.log_flash {
                Some(flash) => flash.exchange(word as u8, now).into(),
                None => self.card.exchange(word as u8, now).into(),
            },
            _ => u16::MAX,
        }
    }

    /// What is due; the new level of the data-ready line, if that changes.
    pub(crate) fn event(&mut self, now: u64) -> Option<bool> {
        self.imu.event(now).filter(|_| !self.ready_line_broken)
    }

    /// A pulse on a motor's line.
    ///
    /// # Errors
    /// What is wrong with it, if its speed controller cannot take it.
    pub(crate) fn pulse(&mut self, motor: usize, pulse: Pulse) -> Result<(), String> {
        let esc = &mut self.escs[motor];
        let good = esc.good;
        esc.hear(pulse, CYCLES_US);
        // Pulses go on whether there are samples or not.
        if esc.good > good && esc.protocol != Some(Protocol::Pwm) && self.imu.ready_at > 0 {
            self.latency_max = self.latency_max.max(esc.through_at - self.imu.ready_at);
        }
        esc.refused.take().map_or(Ok(()), |Pulse { long, period, low, .. }| {
            let us = |cycles: u64| cycles as f64 / CYCLES_US as f64;
            let (long, period) = (us(long), us(period));
            let level = if low { "low" } else { "high" };
            Err(format!(
                "motor {}'s line is {level} for {long:.3} us every {period:.3} us, which is of no protocol, or of another than {:?}",
                motor + 1,
                esc.protocol
            ))
        })
    }

    /// What the converter reads of a channel, 12 bits, and the pin it is on, if something is.
    pub(crate) fn convert(&self, channel: u32) -> Option<((usize, u32), u32)> {
        let (&(_, pin, per_volt), there) = BATTERY.iter().zip(self.battery).find(|(line, _)| line.0 == channel)?;
        Some((pin, (there / per_volt / REFERENCE_V * 4_095.0).round().clamp(0.0, 4_095.0) as u32))
    }

    /// What each speed controller was told last: a DShot value, or microseconds of a pulse.
    pub(crate) fn told(&self) -> [Option<u16>; 4] {
        self.escs.map(|esc| match esc.heard {
            Heard::Nothing => None,
            Heard::Value(value) | Heard::PulseUs(value) => Some(value),
        })
    }
}
