//! ICM-42688-P: the inertial unit, as its registers show it.
//!
//! It samples by its own clock, at the rate set for the gyro, once gyro and accelerometer are on; each sample raises INT1
//! for 100 µs. What it samples is what it was last told of the motion ([`Icm42688::feel`]), rounded to its scale and
//! limited to its range. Its filters, noise and FIFO are not modelled: the simulator adds errors, FIFO registers do not
//! answer.
//!
//! # Source
//! TDK DS-000347 rev 1.6, chapter 14 "User bank 0 register map".
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
const WHO_AM_I: u8 = 0x75;
const BANK_SEL: u8 = 0x76;

const GRAVITY_M_S2: f32 = 9.806_65;
const PULSE_NS: u64 = 100_000;
const RESET_NS: u64 = 1_000_000;

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
pub(crate) struct Icm42688 {
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

impl Icm42688 {
    pub(crate) fn new(cycles_us: u64) -> Self {
        let mut part = Self {
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
        part.reset();
        part
    }

    /// Power comes on again.
    pub(crate) fn power_up(&mut self) {
        self.reset();
        self.falls_at = NEVER;
    }

    fn reset(&mut self) {
        self.registers = [0; 128];
        for (register, value) in [
            (GYRO_CONFIG0, 0x06),
            (ACCEL_CONFIG0, 0x06),
            (GYRO_ACCEL_CONFIG0, 0x11),
            (INT_CONFIG1, 0x10),
            (INT_SOURCE0, 0x10),
            (WHO_AM_I, 0x47),
        ] {
            self.registers[usize::from(register)] = value;
        }
        for register in TEMPERATURE..=LAST_DATA {
            self.registers[usize::from(register)] = if register % 2 == 1 { 0x80 } else { 0 };
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
        let known = matches!(
            register,
            DEVICE_CONFIG
                | INT_CONFIG
                | TEMPERATURE..=INT_STATUS
                | PWR_MGMT0..=ACCEL_CONFIG0
                | GYRO_ACCEL_CONFIG0
                | INT_CONFIG0..=INT_SOURCE0
                | WHO_AM_I
                | BANK_SEL
        );
        if !known {
            self.unknown = Some(register);
        }
        let value = self.registers[usize::from(register)];
        if register == INT_STATUS {
            self.registers[usize::from(INT_STATUS)] = 0;
        }
        value
    }

    fn write(&mut self, register: u8, value: u8, now: u64) -> u8 {
        if now < self.resets_until {
            // It does not listen while it resets.
            return u8::MAX;
        }
        let known = match register {
            DEVICE_CONFIG => value & !1 == 0,
            // Pulsed, pushed, active high.
            INT_CONFIG => value == 0x03,
            PWR_MGMT0 => value & !0x0f == 0,
            GYRO_CONFIG0 | ACCEL_CONFIG0 => sample_hz(value & 0xf).is_some() && value >> 5 == 0,
            GYRO_ACCEL_CONFIG0 | INT_CONFIG0 | INT_CONFIG1 | INT_SOURCE0 => true,
            BANK_SEL => value == 0,
            _ => false,
        };
        if !known {
            self.unknown = Some(register);
        }
        self.registers[usize::from(register)] = value;
        if register == DEVICE_CONFIG && value & 1 == 1 {
            self.reset();
            self.resets_until = now + RESET_NS * self.cycles_us / 1_000;
        } else if register == PWR_MGMT0 || register == GYRO_CONFIG0 {
            let on = self.registers[usize::from(PWR_MGMT0)] & 0x0f == 0x0f;
            self.next_sample = if on { now + self.period() } else { NEVER };
        }
        u8::MAX
    }

    /// Core cycles between samples.
    pub(crate) fn period(&self) -> u64 {
        let hz = sample_hz(self.registers[usize::from(GYRO_CONFIG0)] & 0xf).unwrap_or(1_000);
        1_000_000 * self.cycles_us / hz
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
        let ready = self.registers[usize::from(INT_SOURCE0)] & 0x08 != 0;
        let works = self.registers[usize::from(INT_CONFIG1)] & 0x10 == 0;
        if !(ready && works) {
            return None;
        }
        self.falls_at = now + PULSE_NS * self.cycles_us / 1_000;
        Some(true)
    }

    fn sample(&mut self) {
        let rate_scale = 32_768.0 / 2_000_f32.to_radians();
        let force_scale = 32_768.0 / (16.0 * GRAVITY_M_S2);
        // 25 °C is zero.
        let mut at = usize::from(TEMPERATURE) + 2;
        self.registers[usize::from(TEMPERATURE)..at].fill(0);
        let force = self.force_m_s2.map(|force| force * force_scale);
        let rate = self.rate_rad_s.map(|rate| rate * rate_scale);
        for value in force.into_iter().chain(rate) {
            // −32768 means that there is no sample.
            let counts = value.round().clamp(-32_767.0, 32_767.0) as i16;
            self.registers[at..at + 2].copy_from_slice(&counts.to_be_bytes());
            at += 2;
        }
        self.registers[usize::from(INT_STATUS)] |= 0x08;
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

    fn transfer(part: &mut Icm42688, bytes: &[u8], now: u64) -> Vec<u8> {
        part.select(true);
        let answer = bytes.iter().map(|&byte| part.exchange(byte, now)).collect();
        part.select(false);
        answer
    }

    #[test]
    fn it_says_who_it_is_and_samples_when_switched_on() {
        let mut part = Icm42688::new(168);
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
        let mut part = Icm42688::new(168);
        transfer(&mut part, &[0x16, 0x40], 0);
        assert_eq!(part.unknown, Some(0x16));
    }
}
