//! Registers of an ICM-42688-P and of an MPU-6000: their addresses, and which values of them are modelled.
//!
//! # Source
//! TDK DS-000347 rev 1.6, chapter 14 "User bank 0 register map"; `InvenSense` RM-MPU-6000A-00 rev 4.2, chapter 4.

pub(super) const DEVICE_CONFIG: u8 = 0x11;
pub(super) const INT_CONFIG: u8 = 0x14;
pub(super) const FIFO_CONFIG: u8 = 0x16;
pub(super) const TEMPERATURE: u8 = 0x1d;
pub(super) const LAST_DATA: u8 = 0x2a;
pub(super) const INT_STATUS: u8 = 0x2d;
pub(super) const FIFO_COUNTH: u8 = 0x2e;
pub(super) const FIFO_COUNTL: u8 = 0x2f;
pub(super) const FIFO_DATA: u8 = 0x30;
pub(super) const SIGNAL_RESET: u8 = 0x4b;
pub(super) const PWR_MGMT0: u8 = 0x4e;
pub(super) const GYRO_CONFIG0: u8 = 0x4f;
pub(super) const ACCEL_CONFIG0: u8 = 0x50;
pub(super) const GYRO_ACCEL_CONFIG0: u8 = 0x52;
pub(super) const FIFO_CONFIG1: u8 = 0x5f;
pub(super) const FIFO_CONFIG2: u8 = 0x60;
pub(super) const FIFO_CONFIG3: u8 = 0x61;
pub(super) const INT_CONFIG0: u8 = 0x63;
pub(super) const INT_CONFIG1: u8 = 0x64;
pub(super) const INT_SOURCE0: u8 = 0x65;
pub(super) const BANK_SEL: u8 = 0x76;
/// Of both.
pub(super) const WHO_AM_I: u8 = 0x75;
/// Of an MPU-6000.
pub(super) const SMPLRT_DIV: u8 = 0x19;
pub(super) const CONFIG: u8 = 0x1a;
pub(super) const GYRO_CONFIG: u8 = 0x1b;
pub(super) const ACCEL_CONFIG: u8 = 0x1c;
pub(super) const INT_PIN_CFG: u8 = 0x37;
pub(super) const INT_ENABLE: u8 = 0x38;
pub(super) const MPU_STATUS: u8 = 0x3a;
pub(super) const MPU_LAST_DATA: u8 = 0x48;
pub(super) const SIGNAL_PATH_RESET: u8 = 0x68;
pub(super) const USER_CTRL: u8 = 0x6a;
pub(super) const PWR_MGMT_1: u8 = 0x6b;

/// Of INT_STATUS: a sample is new, the watermark is reached, the FIFO is full.
pub(super) const DATA_READY: u8 = 0x08;
pub(super) const WATERMARK: u8 = 0x04;
pub(super) const FULL: u8 = 0x02;
/// Of INT_CONFIG1: pulses of 8 µs, none suppressed after another, as from 4 kHz on they must be; INT1 does not work.
pub(super) const FAST_PULSES: u8 = 0x60;
pub(super) const ASYNC_RESET: u8 = 0x10;
/// Of FIFO_CONFIG1: a pulse at each record from the watermark on, not at the one that reaches it alone.
pub(super) const EACH_ABOVE: u8 = 0x20;

/// Whether an ICM-42688-P's register can be read.
pub(super) fn icm_shows(register: u8) -> bool {
    matches!(
        register,
        DEVICE_CONFIG
            | INT_CONFIG
            | FIFO_CONFIG
            | TEMPERATURE..=FIFO_DATA
            | PWR_MGMT0..=ACCEL_CONFIG0
            | GYRO_ACCEL_CONFIG0
            | FIFO_CONFIG1..=FIFO_CONFIG3
            | INT_CONFIG0..=INT_SOURCE0
            | WHO_AM_I
            | BANK_SEL
    )
}

/// Whether an MPU-6000's register can be read.
pub(super) fn mpu_shows(register: u8) -> bool {
    matches!(
        register,
        SMPLRT_DIV..=ACCEL_CONFIG
            | INT_PIN_CFG..=INT_ENABLE
            | MPU_STATUS..=MPU_LAST_DATA
            | USER_CTRL..=PWR_MGMT_1
            | WHO_AM_I
    )
}

/// Whether an ICM-42688-P's register is modelled with a value, as the others are.
pub(super) fn icm_takes(register: u8, value: u8, others: &[u8; 128]) -> bool {
    let other = |register: u8| others[usize::from(register)];
    match register {
        DEVICE_CONFIG => value & !1 == 0,
        // Pulsed, pushed, active high.
        INT_CONFIG => value == 0x03,
        // Bypassed, or stream to FIFO.
        FIFO_CONFIG => value == 0 || value == 0x40,
        // Flush.
        SIGNAL_RESET => value == 0x02,
        PWR_MGMT0 => value & !0x0f == 0,
        GYRO_CONFIG0 | ACCEL_CONFIG0 => {
            let fast = sample_hz(value & 0xf).is_some_and(|hz| hz >= 4_000);
            sample_hz(value & 0xf).is_some()
                && value >> 5 == 0
                && (!fast || other(INT_CONFIG1) & FAST_PULSES == FAST_PULSES)
        }
        // Packets of both sensors and the temperature, reading that goes on where it ended.
        FIFO_CONFIG1 => value & !EACH_ABOVE == 0x47,
        // Whole packets, and not while its interrupt is on.
        FIFO_CONFIG2 => value.is_multiple_of(16) && other(INT_SOURCE0) & WATERMARK == 0,
        FIFO_CONFIG3 => value < 0x08 && other(INT_SOURCE0) & WATERMARK == 0,
        GYRO_ACCEL_CONFIG0 | INT_CONFIG0 | INT_CONFIG1 | INT_SOURCE0 => true,
        BANK_SEL => value == 0,
        _ => false,
    }
}

/// Whether an MPU-6000's register is modelled with a value.
pub(super) fn mpu_takes(register: u8, value: u8) -> bool {
    match register {
        SMPLRT_DIV => true,
        // The gyro at 8 kHz; 2000 °/s; 16 g; pulsed, pushed, active high; data ready alone.
        CONFIG | INT_PIN_CFG => value == 0,
        GYRO_CONFIG | ACCEL_CONFIG => value == 0x18,
        INT_ENABLE => value & !1 == 0,
        SIGNAL_PATH_RESET => value & !7 == 0,
        USER_CTRL => value == 0x10,
        PWR_MGMT_1 => matches!(value, 0x80 | 0x01 | 0x40),
        _ => false,
    }
}

/// Samples a second of an ODR field.
pub(super) fn sample_hz(field: u8) -> Option<u64> {
    Some(match field {
        0x3 => 8_000,
        0x4 => 4_000,
        0x5 => 2_000,
        0x6 => 1_000,
        0x7 => 200,
        0x8 => 100,
        0xf => 500,
        _ => return None,
    })
}
