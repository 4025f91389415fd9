//! The inertial unit, an ICM-42688-P or an MPU-6000, as its registers show it.
//!
//! It samples by its own clock, at the rate set for the gyro, once gyro and accelerometer are on. A sample that is ready raises its line for
//! a moment: each one, or of an ICM-42688-P's FIFO (`fifo.rs`) the one that reaches the watermark and those after it. What it samples is
//! what it was last told of the motion ([`InertialUnit::feel`]), rounded to its scale and limited to its range. Filters, noise, and that an
//! MPU-6000's accelerometer has half as many samples, are not modelled: the simulator adds errors.
//!
//! # Source
//! TDK DS-000347 rev 1.6, chapters 6 "FIFO" and 14 "User bank 0 register map"; `InvenSense` RM-MPU-6000A-00 rev 4.2, chapter 4.
mod fifo;
mod registers;

use crate::peripheral::NEVER;
use fifo::{Fifo, PACKET};
use registers::{
    ACCEL_CONFIG0, ASYNC_RESET, DATA_READY, DEVICE_CONFIG, EACH_ABOVE, FAST_PULSES, FIFO_CONFIG, FIFO_CONFIG1,
    FIFO_CONFIG2, FIFO_CONFIG3, FIFO_COUNTH, FIFO_COUNTL, FIFO_DATA, FULL, GYRO_ACCEL_CONFIG0, GYRO_CONFIG0,
    INT_CONFIG1, INT_ENABLE, INT_SOURCE0, INT_STATUS, LAST_DATA, MPU_STATUS, PWR_MGMT_1, PWR_MGMT0, SIGNAL_RESET,
    SMPLRT_DIV, TEMPERATURE, WATERMARK, WHO_AM_I, icm_shows, icm_takes, mpu_shows, mpu_takes, sample_hz,
};

const READ: u8 = 0x80;
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
    /// How long it resets, µs.
    const fn reset_us(self) -> u64 {
        match self {
            Self::Icm42688 => 1_000,
            Self::Mpu6000 => 100_000,
        }
    }

    /// As [`InertialUnit::spi_hz_max`]. The latter's registers but those of samples take 1 MHz, which is not looked at.
    const fn spi_hz_max(self) -> u64 {
        match self {
            Self::Icm42688 => 24_000_000,
            Self::Mpu6000 => 20_000_000,
        }
    }

    /// The register that says whether a sample is new, and the bit that does.
    const fn status(self) -> (u8, u8) {
        match self {
            Self::Icm42688 => (INT_STATUS, DATA_READY),
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

/// How it moves, along its own axes.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    /// Specific force, m/s², and rate, rad/s.
    force_m_s2: [f32; 3],
    rate_rad_s: [f32; 3],
}

impl Motion {
    /// On the way to another one, of which it has gone a part.
    fn towards(&self, other: &Self, part: f32) -> Self {
        let between = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|n| a[n] + (b[n] - a[n]) * part);
        Self {
            force_m_s2: between(self.force_m_s2, other.force_m_s2),
            rate_rad_s: between(self.rate_rad_s, other.rate_rad_s),
        }
    }
}

/// The part.
#[derive(Debug)]
pub(crate) struct InertialUnit {
    part: Inertial,
    registers: [u8; 128],
    /// Address byte of the running transfer and the register it is at.
    transfer: Option<(bool, u8)>,
    selected: bool,
    motion: Motion,
    /// When it is as it was last told, core cycles.
    told_at: u64,
    fifo: Fifo,
    /// The count of the FIFO's bytes, its lower half, as of when the upper one was read.
    count_low: u8,
    /// When what is read at a pulse of its line began to be ready, core cycles.
    pub(crate) ready_at: u64,
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
            motion: Motion::default(),
            told_at: 0,
            fifo: Fifo::default(),
            count_low: 0,
            ready_at: 0,
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
        (self.falls_at, self.ready_at) = (NEVER, 0);
    }

    fn reset(&mut self) {
        self.registers = [0; 128];
        let values: &[(u8, u8)] = match self.part {
            Inertial::Icm42688 => &[
                (GYRO_CONFIG0, 0x06),
                (ACCEL_CONFIG0, 0x06),
                (GYRO_ACCEL_CONFIG0, 0x11),
                (INT_CONFIG1, ASYNC_RESET),
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
        self.fifo.flush();
    }

    /// Tells the part how it moves when it is to be read next: specific force, m/s², and rate, rad/s, along its own axes.
    pub(crate) fn feel(&mut self, force_m_s2: [f32; 3], rate_rad_s: [f32; 3]) {
        let (motion, at) = (Motion { force_m_s2, rate_rad_s }, self.next_ready().unwrap_or(0));
        self.fifo.settle((self.told_at, &self.motion), (at, &motion));
        (self.motion, self.told_at) = (motion, at);
    }

    /// Its select line.
    pub(crate) fn select(&mut self, low: bool) {
        self.selected = low;
        self.transfer = None;
    }

    /// The fastest clock that it can be read with, Hz.
    pub(crate) fn spi_hz_max(&self) -> u64 {
        self.part.spi_hz_max()
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
                // Consecutive registers in one transfer, the last one being 0x7f; but the FIFO goes on where it is.
                let stays = self.part == Inertial::Icm42688 && register == FIFO_DATA;
                self.transfer = Some((read, if stays { register } else { (register + 1).min(0x7f) }));
                if read { self.read(register) } else { self.write(register, byte, now) }
            }
        }
    }

    fn read(&mut self, register: u8) -> u8 {
        let known = match self.part {
            Inertial::Icm42688 => icm_shows(register),
            Inertial::Mpu6000 => mpu_shows(register),
        };
        if !known {
            self.unknown = Some(register);
        }
        let value = self.registers[usize::from(register)];
        if register == self.part.status().0 {
            self.registers[usize::from(register)] = 0;
        }
        match (self.part, register) {
            (Inertial::Icm42688, FIFO_COUNTH) => {
                let [high, low] = self.fifo.bytes().to_be_bytes();
                self.count_low = low;
                high
            }
            (Inertial::Icm42688, FIFO_COUNTL) => self.count_low,
            (Inertial::Icm42688, FIFO_DATA) => self.fifo.read(),
            _ => value,
        }
    }

    fn write(&mut self, register: u8, value: u8, now: u64) -> u8 {
        if now < self.resets_until {
            // It does not listen while it resets.
            return u8::MAX;
        }
        let (known, resets) = match self.part {
            Inertial::Icm42688 => {
                (icm_takes(register, value, &self.registers), register == DEVICE_CONFIG && value & 1 == 1)
            }
            Inertial::Mpu6000 => (mpu_takes(register, value), register == PWR_MGMT_1 && value & 0x80 != 0),
        };
        if !known {
            self.unknown = Some(register);
        }
        self.registers[usize::from(register)] = value;
        if resets {
            self.reset();
            self.resets_until = now + self.part.reset_us() * self.cycles_us;
        } else if (self.part, register) == (Inertial::Icm42688, SIGNAL_RESET) {
            self.registers[usize::from(SIGNAL_RESET)] = 0;
            self.fifo.flush();
        } else if matches!(
            (self.part, register),
            (Inertial::Icm42688, PWR_MGMT0 | GYRO_CONFIG0) | (Inertial::Mpu6000, PWR_MGMT_1 | SMPLRT_DIV)
        ) {
            self.next_sample = if self.is_on() { now + self.sample_cycles() } else { NEVER };
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

    fn sample_cycles(&self) -> u64 {
        let hz = match self.part {
            Inertial::Icm42688 => sample_hz(self.register(GYRO_CONFIG0) & 0xf).unwrap_or(1_000),
            Inertial::Mpu6000 => 8_000 / (1 + u64::from(self.register(SMPLRT_DIV))),
        };
        1_000_000 * self.cycles_us / hz.max(1)
    }

    fn register(&self, register: u8) -> u8 {
        self.registers[usize::from(register)]
    }

    /// Bytes of the FIFO at which it is to be read, if it is told to say so.
    fn watermark(&self) -> Option<u16> {
        let says = self.part == Inertial::Icm42688 && self.register(INT_SOURCE0) & WATERMARK != 0;
        says.then(|| u16::from_le_bytes([self.register(FIFO_CONFIG2), self.register(FIFO_CONFIG3)]))
    }

    /// How many samples are read at a time, if none is late.
    fn at_a_time(&self) -> u64 {
        self.watermark().map_or(1, |bytes| u64::from(bytes) / PACKET as u64).max(1)
    }

    /// Core cycles from one time that it is to be read to the next.
    pub(crate) fn period(&self) -> u64 {
        self.sample_cycles() * self.at_a_time()
    }

    /// When it is to be read next, if the part is on.
    pub(crate) fn next_ready(&self) -> Option<u64> {
        let held = u64::from(self.fifo.bytes()) / PACKET as u64;
        let more = self.at_a_time().saturating_sub(1 + held);
        (self.next_sample != NEVER).then(|| self.next_sample + more * self.sample_cycles())
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
        self.next_sample += self.sample_cycles();
        let (says, pulse_us) = match self.part {
            Inertial::Icm42688 => {
                let fast = self.register(INT_CONFIG1) & FAST_PULSES == FAST_PULSES;
                (self.sample_icm(now), if fast { 8 } else { 100 })
            }
            Inertial::Mpu6000 => {
                self.show(MPU_STATUS + 1, [0, 1, 2, 6, 3, 4, 5]);
                self.ready_at = now;
                (self.register(INT_ENABLE) & 0x01 != 0, 50)
            }
        };
        let (status, new) = self.part.status();
        self.registers[usize::from(status)] |= new;
        if says {
            self.falls_at = now + pulse_us * self.cycles_us;
        }
        says.then_some(true)
    }

    /// An ICM-42688-P samples; whether it says so.
    fn sample_icm(&mut self, now: u64) -> bool {
        self.show(TEMPERATURE, [6, 0, 1, 2, 3, 4, 5]);
        let mut says = self.register(INT_SOURCE0) & DATA_READY != 0;
        if says {
            self.ready_at = now;
        }
        if self.register(FIFO_CONFIG) != 0 {
            let before = self.fifo.bytes();
            let full = self.fifo.push(&self.motion, now);
            self.registers[usize::from(INT_STATUS)] |= if full { FULL } else { 0 };
            if let Some(watermark) = self.watermark().filter(|&watermark| self.fifo.bytes() >= watermark) {
                self.registers[usize::from(INT_STATUS)] |= WATERMARK;
                let reached = before < watermark;
                if reached {
                    self.ready_at = now;
                }
                says |= reached || self.register(FIFO_CONFIG1) & EACH_ABOVE != 0;
            }
        }
        says && self.register(INT_CONFIG1) & ASYNC_RESET == 0
    }

    /// Lets registers show the motion, word by word: force, rate, and a temperature of zero, which is 25 °C of the one part, 37 °C of the other.
    fn show(&mut self, first: u8, order: [usize; 7]) {
        let [fx, fy, fz, rx, ry, rz] = counts(&self.motion);
        let words = [fx, fy, fz, rx, ry, rz, 0];
        let shown = &mut self.registers[usize::from(first)..][..14];
        for (word, n) in shown.chunks_exact_mut(2).zip(order) {
            word.copy_from_slice(&words[n].to_be_bytes());
        }
    }
}

/// What it says of a motion: force and rate, limited to its range.
fn counts(motion: &Motion) -> [i16; 6] {
    let rate_scale = 32_768.0 / 2_000_f32.to_radians();
    let force_scale = 32_768.0 / (16.0 * GRAVITY_M_S2);
    std::array::from_fn(|n| {
        let value = if n < 3 { motion.force_m_s2[n] * force_scale } else { motion.rate_rad_s[n - 3] * rate_scale };
        // −32768 means that there is no sample.
        value.round().clamp(-32_767.0, 32_767.0) as i16
    })
}

#[cfg(test)]
mod tests {
    use super::registers::{CONFIG, GYRO_CONFIG};
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
        transfer(&mut part, &[0x17, 0x40], 0);
        assert_eq!(part.unknown, Some(0x17));
    }

    /// On from time 0, 8 kHz, watermark at four packets.
    fn streaming() -> InertialUnit {
        let mut part = InertialUnit::new(Inertial::Icm42688, 168);
        let setup = [
            (INT_CONFIG1, FAST_PULSES),
            (FIFO_CONFIG, 0x40),
            (FIFO_CONFIG2, 64),
            (FIFO_CONFIG1, 0x47 | EACH_ABOVE),
            (INT_SOURCE0, WATERMARK),
            (GYRO_CONFIG0, 0x03),
            (ACCEL_CONFIG0, 0x03),
            (PWR_MGMT0, 0x0f),
        ];
        for (register, value) in setup {
            transfer(&mut part, &[register, value], 0);
        }
        assert_eq!((part.unknown, part.period(), part.next_ready()), (None, 84_000, Some(84_000)));
        part
    }

    /// Status, bytes that it holds, and as many of its packets' headers and first words of the rate.
    fn burst(part: &mut InertialUnit, packets: usize) -> (u8, u16, Vec<(u8, i16)>) {
        let answer = transfer(part, &[&[READ | INT_STATUS][..], &vec![0; 3 + 16 * packets]].concat(), 0);
        let packets = answer[4..].chunks_exact(16);
        let firsts = packets.map(|packet| (packet[0], i16::from_be_bytes([packet[7], packet[8]])));
        (answer[1], u16::from_be_bytes([answer[2], answer[3]]), firsts.collect())
    }

    /// Runs for some samples; how often the line rose.
    fn run(part: &mut InertialUnit, samples: u64) -> usize {
        let end = part.next_sample + samples * part.sample_cycles();
        let mut rose = 0;
        while part.next_sample < end || part.falls_at != NEVER {
            rose += usize::from(part.event(part.next()) == Some(true));
        }
        rose
    }

    #[test]
    fn the_fifo_says_when_four_packets_are_in_it_and_at_each_after_that() {
        let mut part = streaming();
        assert_eq!((run(&mut part, 3), run(&mut part, 1), run(&mut part, 1)), (0, 1, 1));
        assert_eq!(part.ready_at, 84_000, "at the fourth");
        let (status, bytes, packets) = burst(&mut part, 4);
        assert_eq!((status, bytes, packets), (DATA_READY | WATERMARK, 80, vec![(0x60, 0); 4]));
        // The fifth, and none behind it.
        assert_eq!(burst(&mut part, 2), (0, 16, vec![(0x60, 0), (0xff, -1)]));
        assert_eq!(part.next_ready(), Some((5 + 4) * 21_000));
        assert_eq!((run(&mut part, 3), run(&mut part, 1)), (0, 1), "four more");
    }

    #[test]
    fn between_two_motions_that_it_is_told_of_the_body_moves_evenly() {
        let mut part = streaming();
        let rate = |counts: f32| [counts * 2_000_f32.to_radians() / 32_768.0, 0.0, 0.0];
        run(&mut part, 3);
        part.feel([0.0; 3], rate(400.0));
        run(&mut part, 4);
        part.feel([0.0; 3], rate(800.0));
        run(&mut part, 2);
        let (_, _, packets) = burst(&mut part, 9);
        let rates: Vec<i16> = packets.into_iter().map(|(_, rate)| rate).collect();
        // Of the first it was told nothing before; after the last it holds.
        assert_eq!(rates, [100, 200, 300, 400, 500, 600, 700, 800, 800]);
    }

    #[test]
    fn a_fifo_that_nobody_reads_keeps_the_newest_says_that_it_is_full_and_is_flushed() {
        let mut part = streaming();
        run(&mut part, 200);
        let (status, bytes, _) = burst(&mut part, 0);
        assert_eq!((status, bytes), (DATA_READY | WATERMARK | FULL, 2_048));
        transfer(&mut part, &[SIGNAL_RESET, 0x02], 0);
        assert_eq!(burst(&mut part, 1), (0, 0, vec![(0xff, -1)]));
        // Four samples after the flush.
        assert_eq!((part.next_ready().unwrap() - part.next_sample, run(&mut part, 4)), (3 * 21_000, 1));
    }

    #[test]
    fn what_the_data_sheet_forbids_is_noted() {
        let mut part = InertialUnit::new(Inertial::Icm42688, 168);
        transfer(&mut part, &[GYRO_CONFIG0, 0x03], 0);
        assert_eq!(part.unknown.take(), Some(GYRO_CONFIG0), "8 kHz with long pulses");
        let mut part = streaming();
        transfer(&mut part, &[FIFO_CONFIG2, 16], 0);
        assert_eq!(part.unknown, Some(FIFO_CONFIG2), "another watermark while its interrupt is on");
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
