//! The inertial unit, an ICM-42688-P or an MPU-6000, as its registers show it.
//!
//! It samples by its own clock, at the rate set for the gyro, once gyro and accelerometer are on; each sample raises its
//! line for 100 or 50 µs. What it samples is what it was last told of the motion ([`InertialUnit::feel`]), rounded to its scale and
//! limited to its range. Filters, noise, FIFO, and that an MPU-6000's accelerometer has half as many samples, are not modelled: the
//! simulator adds errors, FIFO registers do not answer.
//!
//! # Source
//! TDK DS-000347 rev 1.6, chapter 14 "User bank 0 register map"; `InvenSense` RM-MPU-6000A-00 rev 4.2, chapter 4.
use crate::peripheral::NEVER;

const READ: u8 = 0x80;
const DEVICE_CONFIG: u8 = 0x11;
const INT_CONFIG: u8 = 0x14;
const TEMPERATURE: u8 = 0x1d;
const LAST_DATA: u8 = 0x2a;
const INT_STATUS: u8 = 0x2d;
const PWR_MGMT0: u8 = 0x4e;
const GYRO_CONFIG0: u8 = 0x4f;
const ACCEL_CONFIG0: u8 = 0x50;
const GYRO_ACCEL_CONFIG0: u8 = 0x52;
const INT_CONFIG0: u8 = 0x63;
const INT_CONFIG1: u8 = 0x64;
const INT_SOURCE0: u8 = 0x65;
const BANK_SEL: u8 = 0x76;
/// Of both.
const WHO_AM_I: u8 = 0x75;
/// Of an MPU-6000.
const SMPLRT_DIV: u8 = 0x19;
const CONFIG: u8 = 0x1a;
const GYRO_CONFIG: u8 = 0x1b;
const ACCEL_CONFIG: u8 = 0x1c;
const INT_PIN_CFG: u8 = 0x37;
const INT_ENABLE: u8 = 0x38;
const MPU_STATUS: u8 = 0x3a;
const MPU_LAST_DATA: u8 = 0x48;
const SIGNAL_PATH_RESET: u8 = 0x68;
const USER_CTRL: u8 = 0x6a;
const PWR_MGMT_1: u8 = 0x6b;

const GRAVITY_M_S2: f32 = 9.806_65;

/// Which part it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inertial {
    /// An ICM-42688-P, as on the default board.
    Icm42688,
    /// An MPU-6000, as on older ones.
    Mpu6000,
}

impl Inertial {
    /// How long its line is high, and how long it resets, µs.
    const fn times_us(self) -> (u64, u64) {
        match self {
            Self::Icm42688 => (100, 1_000),
            Self::Mpu6000 => (50, 100_000),
        }
    }

    /// The register that says whether a sample is new, and the bit that does.
    const fn status(self) -> (u8, u8) {
        match self {
            Self::Icm42688 => (INT_STATUS, 0x08),
            Self::Mpu6000 => (MPU_STATUS, 0x01),
        }
    }
}

/// What it answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Answers {
    /// What it has.
    Truth,
    /// All bits alike: it has no supply, or its line is shorted.
    Always(u8),
    /// Anything.
    Garbage,
}

/// The part.
#[derive(Debug)]
pub(crate) struct InertialUnit {
    part: Inertial,
    registers: [u8; 128],
    /// Address byte of the running transfer and the register it is at.
    transfer: Option<(bool, u8)>,
    selected: bool,
    /// Specific force, m/s², and rate, rad/s, along the part's axes.
    force_m_s2: [f32; 3],
    rate_rad_s: [f32; 3],
    /// Core cycles in a microsecond, for its clock.
    cycles_us: u64,
    next_sample: u64,
    falls_at: u64,
    resets_until: u64,
    pub(crate) answers: Answers,
    chance: u32,
    /// A register that is not modelled, if one was touched.
    pub(crate) unknown: Option<u8>,
}

impl InertialUnit {
    pub(crate) fn new(part: Inertial, cycles_us: u64) -> Self {
        let mut unit = Self {
            part,
            registers: [0; 128],
            transfer: None,
            selected: false,
            force_m_s2: [0.0; 3],
            rate_rad_s: [0.0; 3],
            cycles_us,
            next_sample: NEVER,
            falls_at: NEVER,
            resets_until: 0,
            answers: Answers::Truth,
            chance: 1,
            unknown: None,
        };
        unit.reset();
        unit
    }

    /// Power comes on again.
    pub(crate) fn power_up(&mut self) {
        self.reset();
        self.falls_at = NEVER;
    }

    fn reset(&mut self) {
        self.registers = [0; 128];
        let values: &[(u8, u8)] = match self.part {
            Inertial::Icm42688 => &[
                (GYRO_CONFIG0, 0x06),
                (ACCEL_CONFIG0, 0x06),
                (GYRO_ACCEL_CONFIG0, 0x11),
                (INT_CONFIG1, 0x10),
                (INT_SOURCE0, 0x10),
                (WHO_AM_I, 0x47),
            ],
            Inertial::Mpu6000 => &[(PWR_MGMT_1, 0x40), (WHO_AM_I, 0x68)],
        };
        for &(register, value) in values {
            self.registers[usize::from(register)] = value;
        }
        if self.part == Inertial::Icm42688 {
            for register in TEMPERATURE..=LAST_DATA {
                self.registers[usize::from(register)] = if register % 2 == 1 { 0x80 } else { 0 };
            }
        }
        self.next_sample = NEVER;
    }

    /// Tells the part how it moves: specific force, m/s², and rate, rad/s, along its own axes.
    pub(crate) fn feel(&mut self, force_m_s2: [f32; 3], rate_rad_s: [f32; 3]) {
        (self.force_m_s2, self.rate_rad_s) = (force_m_s2, rate_rad_s);
    }

    /// Its select line.
    pub(crate) fn select(&mut self, low: bool) {
        self.selected = low;
        self.transfer = None;
    }

    /// One byte of a transfer.
    pub(crate) fn exchange(&mut self, byte: u8, now: u64) -> u8 {
        let truth = self.answer(byte, now);
        match self.answers {
            Answers::Truth => truth,
            Answers::Always(byte) => byte,
            Answers::Garbage => {
                // Numerical Recipes' generator; its upper bits are the better ones.
                self.chance = self.chance.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (self.chance >> 24) as u8
            }
        }
    }

    fn answer(&mut self, byte: u8, now: u64) -> u8 {
        if !self.selected {
            return u8::MAX;
        }
        match self.transfer {
            None => {
                self.transfer = Some((byte & READ != 0, byte & !READ));
                u8::MAX
            }
            Some((read, register)) => {
                // Consecutive registers in one transfer, the last one being 0x7f.
                self.transfer = Some((read, (register + 1).min(0x7f)));
                if read { self.read(register) } else { self.write(register, byte, now) }
            }
        }
    }

    fn read(&mut self, register: u8) -> u8 {
        let known = match self.part {
            Inertial::Icm42688 => matches!(
                register,
                DEVICE_CONFIG
                    | INT_CONFIG
                    | TEMPERATURE..=INT_STATUS
                    | PWR_MGMT0..=ACCEL_CONFIG0
                    | GYRO_ACCEL_CONFIG0
                    | INT_CONFIG0..=INT_SOURCE0
                    | WHO_AM_I
                    | BANK_SEL
            ),
            Inertial::Mpu6000 => {
                matches!(
                    register,
                    SMPLRT_DIV..=ACCEL_CONFIG
                        | INT_PIN_CFG..=INT_ENABLE
                        | MPU_STATUS..=MPU_LAST_DATA
                        | USER_CTRL..=PWR_MGMT_1
                        | WHO_AM_I
                )
            }
        };
        if !known {
            self.unknown = Some(register);
        }
        let value = self.registers[usize::from(register)];
        if register == self.part.status().0 {
            self.registers[usize::from(register)] = 0;
        }
        value
    }

    fn write(&mut self, register: u8, value: u8, now: u64) -> u8 {
        if now < self.resets_until {
            // It does not listen while it resets.
            return u8::MAX;
        }
        let (known, resets) = match self.part {
            Inertial::Icm42688 => (icm_knows(register, value), register == DEVICE_CONFIG && value & 1 == 1),
            Inertial::Mpu6000 => (mpu_knows(register, value), register == PWR_MGMT_1 && value & 0x80 != 0),
        };
        if !known {
            self.unknown = Some(register);
        }
        self.registers[usize::from(register)] = value;
        if resets {
            self.reset();
            self.resets_until = now + self.part.times_us().1 * self.cycles_us;
        } else if matches!(
            (self.part, register),
            (Inertial::Icm42688, PWR_MGMT0 | GYRO_CONFIG0) | (Inertial::Mpu6000, PWR_MGMT_1 | SMPLRT_DIV)
        ) {
            self.next_sample = if self.is_on() { now + self.period() } else { NEVER };
        }
        u8::MAX
    }

    fn is_on(&self) -> bool {
        match self.part {
            Inertial::Icm42688 => self.registers[usize::from(PWR_MGMT0)] & 0x0f == 0x0f,
            // Not asleep.
            Inertial::Mpu6000 => self.registers[usize::from(PWR_MGMT_1)] & 0x40 == 0,
        }
    }

    /// Core cycles between samples.
    pub(crate) fn period(&self) -> u64 {
        let hz = match self.part {
            Inertial::Icm42688 => sample_hz(self.registers[usize::from(GYRO_CONFIG0)] & 0xf).unwrap_or(1_000),
            Inertial::Mpu6000 => 8_000 / (1 + u64::from(self.registers[usize::from(SMPLRT_DIV)])),
        };
        1_000_000 * self.cycles_us / hz.max(1)
    }

    /// When the next sample is ready, if the part is on.
    pub(crate) fn next_sample(&self) -> Option<u64> {
        (self.next_sample != NEVER).then_some(self.next_sample)
    }

    /// When INT1 changes next.
    pub(crate) fn next(&self) -> u64 {
        self.next_sample.min(self.falls_at)
    }

    /// What is due at `now`; the new level of INT1, if that changes.
    pub(crate) fn event(&mut self, now: u64) -> Option<bool> {
        if now >= self.falls_at {
            self.falls_at = NEVER;
            return Some(false);
        }
        if now < self.next_sample {
            return None;
        }
        self.next_sample += self.period();
        self.sample();
        let register = |register: u8| self.registers[usize::from(register)];
        let ready = match self.part {
            Inertial::Icm42688 => register(INT_SOURCE0) & 0x08 != 0 && register(INT_CONFIG1) & 0x10 == 0,
            Inertial::Mpu6000 => register(INT_ENABLE) & 0x01 != 0,
        };
        if !ready {
            return None;
        }
        self.falls_at = now + self.part.times_us().0 * self.cycles_us;
        Some(true)
    }

    fn sample(&mut self) {
        let rate_scale = 32_768.0 / 2_000_f32.to_radians();
        let force_scale = 32_768.0 / (16.0 * GRAVITY_M_S2);
        let force = self.force_m_s2.map(|force| force * force_scale);
        let rate = self.rate_rad_s.map(|rate| rate * rate_scale);
        // Zero is 25 °C of the one, 37 °C of the other.
        let temperature = [0.0];
        let (first, values) = match self.part {
            Inertial::Icm42688 => (TEMPERATURE, [&temperature[..], &force, &rate]),
            Inertial::Mpu6000 => (MPU_STATUS + 1, [&force[..], &temperature, &rate]),
        };
        for (n, value) in values.concat().into_iter().enumerate() {
            // −32768 means that there is no sample.
            let counts = value.round().clamp(-32_767.0, 32_767.0) as i16;
            let at = usize::from(first) + 2 * n;
            self.registers[at..at + 2].copy_from_slice(&counts.to_be_bytes());
        }
        let (status, new) = self.part.status();
        self.registers[usize::from(status)] |= new;
    }
}

/// Whether an ICM-42688-P's register is modelled with a value.
fn icm_knows(register: u8, value: u8) -> bool {
    match register {
        DEVICE_CONFIG => value & !1 == 0,
        // Pulsed, pushed, active high.
        INT_CONFIG => value == 0x03,
        PWR_MGMT0 => value & !0x0f == 0,
        GYRO_CONFIG0 | ACCEL_CONFIG0 => sample_hz(value & 0xf).is_some() && value >> 5 == 0,
        GYRO_ACCEL_CONFIG0 | INT_CONFIG0 | INT_CONFIG1 | INT_SOURCE0 => true,
        BANK_SEL => value == 0,
        _ => false,
    }
}

/// Whether an MPU-6000's register is modelled with a value.
fn mpu_knows(register: u8, value: u8) -> bool {
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
fn sample_hz(field: u8) -> Option<u64> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn transfer(part: &mut InertialUnit, bytes: &[u8], now: u64) -> Vec<u8> {
        part.select(true);
        let answer = bytes.iter().map(|&byte| part.exchange(byte, now)).collect();
        part.select(false);
        answer
    }

    #[test]
    fn it_says_who_it_is_and_samples_when_switched_on() {
        let mut part = InertialUnit::new(Inertial::Icm42688, 168);
        assert_eq!(transfer(&mut part, &[READ | WHO_AM_I, 0], 0)[1], 0x47);
        assert_eq!(part.next(), NEVER);
        transfer(&mut part, &[INT_CONFIG1, 0, 0x08], 0);
        transfer(&mut part, &[PWR_MGMT0, 0x0f, 0x05], 0);
        assert_eq!(part.next(), 84_000);
        part.feel([0.0, 0.0, -GRAVITY_M_S2], [0.0, 1_000_f32.to_radians(), 0.0]);
        assert_eq!(part.event(84_000), Some(true));
        assert_eq!(part.next(), 84_000 + 16_800);
        assert_eq!(part.event(84_000 + 16_800), Some(false));
        let burst = transfer(&mut part, &[&[READ | TEMPERATURE][..], &[0; 14]].concat(), 84_100);
        assert_eq!(burst[7..9], (-2_048_i16).to_be_bytes());
        assert_eq!(burst[11..13], 16_384_i16.to_be_bytes());
        assert_eq!(part.unknown, None);
    }

    #[test]
    fn a_register_that_is_not_modelled_is_noted() {
        let mut part = InertialUnit::new(Inertial::Icm42688, 168);
        transfer(&mut part, &[0x16, 0x40], 0);
        assert_eq!(part.unknown, Some(0x16));
    }

    #[test]
    fn an_mpu_6000_says_who_it_is_and_samples_when_awake() {
        let mut part = InertialUnit::new(Inertial::Mpu6000, 168);
        assert_eq!(transfer(&mut part, &[READ | WHO_AM_I, 0], 0)[1], 0x68);
        transfer(&mut part, &[GYRO_CONFIG, 0x18, 0x18], 0);
        transfer(&mut part, &[SMPLRT_DIV, 3], 0);
        transfer(&mut part, &[INT_ENABLE, 1], 0);
        assert_eq!(part.next(), NEVER, "it sleeps");
        transfer(&mut part, &[PWR_MGMT_1, 1], 0);
        assert_eq!(part.next(), 84_000);
        part.feel([0.0, 0.0, -GRAVITY_M_S2], [0.0, 1_000_f32.to_radians(), 0.0]);
        assert_eq!(part.event(84_000), Some(true));
        assert_eq!(part.next(), 84_000 + 8_400);
        let burst = transfer(&mut part, &[&[READ | MPU_STATUS][..], &[0; 15]].concat(), 84_100);
        assert_eq!(burst[1], 0x01);
        assert_eq!(burst[6..8], (-2_048_i16).to_be_bytes());
        assert_eq!(burst[12..14], 16_384_i16.to_be_bytes());
        assert_eq!(part.unknown, None);
        transfer(&mut part, &[CONFIG, 3], 84_200);
        assert_eq!(part.unknown, Some(CONFIG), "other filters are not modelled");
    }
}
