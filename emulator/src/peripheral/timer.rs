//! TIM1 to TIM5 and TIM8: counting up, compare interrupts, PWM outputs, and bursts to their registers by DMA.
//!
//! ```text
//! count = ⌊(now − origin) / tick⌋        tick = (PSC + 1)·clock        period = (ARR + 1)·tick
//! ```
//!
//! `origin` is when the running period began. Preloaded registers take effect at the update event that ends a period.
//! A PWM output that is on makes one pulse a period, from its start, high or, its polarity turned, low; pulses of no width are not reported.
//! An update asks for DMA until that has come; a second one before that asks for nothing more.
//!
//! Not modelled, and refused: counting down, one pulse, slave modes, input capture, compare DMA, repetition.
//!
//! # Source
//! RM0090, chapters 17.4 and 18.4 "TIMx registers".
use super::{NEVER, Tick, only};

const CEN: u32 = 1;
const UDIS: u32 = 2;
const URS: u32 = 4;
const ARPE: u32 = 1 << 7;
const UIF: u32 = 1;
const UDE: u32 = 1 << 8;
const MOE: u32 = 1 << 15;

/// A pulse on an output, which began when it was reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Pulse {
    /// Channel, 0 to 3.
    pub(crate) channel: usize,
    /// When it began, core cycles.
    pub(crate) at: u64,
    /// How long it lasts, core cycles.
    pub(crate) long: u64,
    /// Time between pulses, core cycles.
    pub(crate) period: u64,
    /// Whether the line rests high and it is low.
    pub(crate) low: bool,
}

/// A timer.
#[derive(Debug)]
pub(crate) struct Timer {
    cr1: u32,
    cr2: u32,
    dier: u32,
    sr: u32,
    ccmr: [u32; 2],
    ccer: u32,
    psc: u32,
    arr: u32,
    ccr: [u32; 4],
    bdtr: u32,
    dcr: u32,
    /// What the counter works with: prescaler, last count, compare values.
    active_psc: u32,
    active_arr: u32,
    active_ccr: [u32; 4],
    /// When the running period began; while stopped, what the counter shows.
    origin: u64,
    stopped_at: u32,
    /// Counts of this period below this one have been looked at for matches.
    seen: u64,
    /// Registers that the burst still has to move, counted down from DBL + 1.
    burst_left: u32,
    /// Largest count.
    mask: u32,
    /// Whether outputs need MOE.
    advanced: bool,
    /// Pulses since they were last taken.
    pub(crate) pulses: Vec<Pulse>,
}

impl Timer {
    pub(crate) fn new(wide: bool, advanced: bool) -> Self {
        let mask = if wide { u32::MAX } else { 0xffff };
        Self {
            cr1: 0,
            cr2: 0,
            dier: 0,
            sr: 0,
            ccmr: [0; 2],
            ccer: 0,
            psc: 0,
            arr: mask,
            ccr: [0; 4],
            bdtr: 0,
            dcr: 0,
            active_psc: 0,
            active_arr: mask,
            active_ccr: [0; 4],
            origin: 0,
            stopped_at: 0,
            seen: 0,
            burst_left: 0,
            mask,
            advanced,
            pulses: Vec::new(),
        }
    }

    pub(crate) fn read(&mut self, offset: u32, t: Tick) -> Option<u32> {
        self.catch_up(t);
        Some(match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x08 => 0,
            0x0c => self.dier,
            0x10 => self.sr,
            0x14 => 0,
            0x18 | 0x1c => self.ccmr[(offset as usize - 0x18) / 4],
            0x20 => self.ccer,
            0x24 => self.count(t),
            0x28 => self.psc,
            0x2c => self.arr,
            0x30 if self.advanced => 0,
            0x34..=0x40 => self.ccr[(offset as usize - 0x34) / 4],
            0x44 if self.advanced => self.bdtr,
            0x48 => self.dcr,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, t: Tick) -> Option<()> {
        self.catch_up(t);
        match offset {
            0x00 => self.set_control(only(value, CEN | UDIS | URS | ARPE | 0x300)?, t),
            // CCDS and idle states have no effect here.
            0x04 => self.cr2 = only(value, 0x7f08)?,
            0x08 => {
                only(value, 0)?;
            }
            0x0c => {
                self.dier = only(value, 0x1f | UDE)?;
                if value & UDE == 0 {
                    self.burst_left = 0;
                }
            }
            0x10 => self.sr &= value,
            0x14 => self.generate(value, t)?,
            0x18 | 0x1c => self.ccmr[(offset as usize - 0x18) / 4] = only(value, 0x7c7c)?,
            0x20 => self.ccer = only(value, 0x3333)?,
            0x24 => self.set_count(value, t),
            0x28 => self.psc = only(value, 0xffff)?,
            0x2c => {
                self.arr = value & self.mask;
                if self.cr1 & ARPE == 0 {
                    self.active_arr = self.arr;
                }
            }
            0x30 if self.advanced => {
                only(value, 0)?;
            }
            0x34..=0x40 => self.set_compare((offset as usize - 0x34) / 4, value),
            0x44 if self.advanced => self.bdtr = value,
            0x48 => self.dcr = only(value, 0x1f1f)?,
            0x4c => self.burst(value, t)?,
            _ => return None,
        }
        Some(())
    }

    /// Whether the interrupt line is high.
    pub(crate) fn interrupts(&self) -> bool {
        self.sr & self.dier & 0x1f != 0
    }

    /// Whether the next update asks for DMA that is not asked for already.
    fn asks_by_update(&self) -> bool {
        self.dier & UDE != 0 && self.burst_left == 0
    }

    /// What an update has asked for is done, and was no burst.
    pub(crate) fn served(&mut self) {
        self.burst_left = 0;
    }

    /// Whether the update asks for DMA.
    pub(crate) fn wants_dma(&self) -> bool {
        self.burst_left > 0
    }

    /// When something happens that somebody looks at.
    pub(crate) fn next(&self, t: Tick) -> u64 {
        if !self.is_on() {
            return NEVER;
        }
        let at = |count: u64| self.origin + count * self.tick(t);
        let period = u64::from(self.active_arr) + 1;
        let mut next = NEVER;
        let update_wanted = self.dier & (UIF & !self.sr) != 0 || self.asks_by_update() || self.makes_pulses();
        if update_wanted {
            next = at(period);
        }
        for (n, &compare) in self.active_ccr.iter().enumerate() {
            let compare = u64::from(compare);
            if self.dier & !self.sr & 2 << n != 0 && compare < period {
                next = next.min(at(if compare >= self.seen { compare } else { period + compare }));
            }
        }
        next
    }

    /// Takes in the time that has passed: flags, pulses, preloads.
    pub(crate) fn catch_up(&mut self, t: Tick) {
        if !self.is_on() {
            return;
        }
        loop {
            let tick = self.tick(t);
            let period = u64::from(self.active_arr) + 1;
            let count = t.now.saturating_sub(self.origin) / tick;
            self.flag_matches(self.seen, (count + 1).min(period));
            if count < period {
                self.seen = count + 1;
                return;
            }
            self.origin += period * tick;
            self.seen = 0;
            self.update(t);
            // Periods that nobody watched are all alike.
            let (tick, period) = (self.tick(t), u64::from(self.active_arr) + 1);
            let passed = t.now.saturating_sub(self.origin) / (tick * period);
            if passed > 1 && !self.makes_pulses() && !self.asks_by_update() {
                self.flag_matches(0, period);
                self.origin += (passed - 1) * tick * period;
            }
        }
    }

    /// Sets the flags of the compare values in `from..to`.
    fn flag_matches(&mut self, from: u64, to: u64) {
        for (n, &compare) in self.active_ccr.iter().enumerate() {
            if (from..to).contains(&u64::from(compare)) {
                self.sr |= 2 << n;
            }
        }
    }

    /// An update event at `origin`, where a period begins.
    fn update(&mut self, t: Tick) {
        if self.cr1 & UDIS != 0 {
            return;
        }
        self.sr |= UIF;
        self.load();
        if self.asks_by_update() {
            self.burst_left = (self.dcr >> 8 & 0x1f) + 1;
        }
        let tick = self.tick(t);
        for channel in 0..4 {
            if self.is_pwm(channel) && self.active_ccr[channel] > 0 {
                let period = (u64::from(self.active_arr) + 1) * tick;
                let long = (u64::from(self.active_ccr[channel]) * tick).min(period);
                let low = self.ccer >> (4 * channel + 1) & 1 != 0;
                self.pulses.push(Pulse { channel, at: self.origin, long, period, low });
            }
        }
    }

    fn load(&mut self) {
        (self.active_psc, self.active_arr, self.active_ccr) = (self.psc, self.arr, self.ccr);
    }

    fn tick(&self, t: Tick) -> u64 {
        (u64::from(self.active_psc) + 1) * t.clock
    }

    /// Whether it counts.
    pub(crate) fn is_on(&self) -> bool {
        self.cr1 & CEN != 0
    }

    fn is_pwm(&self, channel: usize) -> bool {
        let mode = self.ccmr[channel / 2] >> (8 * (channel % 2) + 4) & 7;
        let on = self.ccer >> (4 * channel) & 1 != 0 && (!self.advanced || self.bdtr & MOE != 0);
        mode == 6 && on
    }

    fn makes_pulses(&self) -> bool {
        (0..4).any(|n| self.is_pwm(n) && (self.active_ccr[n] > 0 || self.ccr[n] > 0))
    }

    fn count(&self, t: Tick) -> u32 {
        if self.is_on() { ((t.now - self.origin) / self.tick(t)) as u32 } else { self.stopped_at }
    }

    fn set_count(&mut self, count: u32, t: Tick) {
        self.stopped_at = count & self.mask;
        self.origin = t.now.wrapping_sub(u64::from(self.stopped_at) * self.tick(t));
        self.seen = u64::from(self.stopped_at);
    }

    fn set_control(&mut self, value: u32, t: Tick) {
        let shown = self.count(t);
        let was_on = self.is_on();
        self.cr1 = value;
        if was_on != self.is_on() {
            self.set_count(shown, t);
        }
        if value & ARPE == 0 {
            self.active_arr = self.arr;
        }
    }

    fn set_compare(&mut self, channel: usize, value: u32) {
        self.ccr[channel] = value & self.mask;
        let preloaded = self.ccmr[channel / 2] >> (8 * (channel % 2) + 3) & 1 != 0;
        if !preloaded {
            self.active_ccr[channel] = self.ccr[channel];
        }
    }

    /// EGR: only the update event.
    fn generate(&mut self, value: u32, t: Tick) -> Option<()> {
        if only(value, 1)? == 1 {
            self.set_count(0, t);
            let flags = self.sr;
            self.update(t);
            if self.cr1 & URS != 0 {
                self.sr = flags;
                self.burst_left = 0;
            }
        }
        Some(())
    }

    /// A word of a DMA burst.
    fn burst(&mut self, value: u32, t: Tick) -> Option<()> {
        let (base, length) = (self.dcr & 0x1f, (self.dcr >> 8 & 0x1f) + 1);
        let index = length.checked_sub(self.burst_left)?;
        self.burst_left = self.burst_left.checked_sub(1)?;
        self.write(4 * (base + index), value, t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(now: u64) -> Tick {
        Tick { now, clock: 2 }
    }

    /// A running timer of period 10 counts, 4 cycles a count.
    fn running() -> Timer {
        let mut timer = Timer::new(false, false);
        timer.write(0x28, 1, at(0));
        timer.write(0x2c, 9, at(0));
        timer.write(0x14, 1, at(0));
        timer.write(0x10, 0, at(0));
        timer.write(0x00, CEN, at(0));
        timer
    }

    #[test]
    fn it_counts_and_flags_its_updates_and_matches() {
        let mut timer = running();
        timer.write(0x38, 3, at(0));
        // Channels at count 0 match as soon as the counter starts; that is not what is looked at.
        timer.catch_up(at(1));
        timer.write(0x10, 0, at(1));
        timer.write(0x0c, UIF | 4, at(1));
        assert_eq!(timer.read(0x24, at(11)), Some(2));
        assert_eq!(timer.next(at(11)), 12);
        timer.catch_up(at(12));
        assert_eq!(timer.read(0x10, at(12)), Some(4));
        assert!(timer.interrupts());
        timer.write(0x10, !4, at(12));
        assert_eq!(timer.next(at(12)), 40);
        timer.catch_up(at(45));
        assert_eq!(timer.read(0x24, at(45)), Some(1));
        assert_eq!(timer.sr & (UIF | 4), UIF);
        timer.catch_up(at(4_000));
        assert_eq!(timer.read(0x24, at(4_000)), Some(0));
        assert_eq!(timer.sr & 4, 4);
    }

    #[test]
    fn pulses_follow_preloaded_widths_from_the_next_period() {
        let mut timer = running();
        timer.write(0x18, 6 << 4 | 8, at(0));
        timer.write(0x20, 1, at(0));
        timer.write(0x34, 4, at(1));
        assert_eq!(timer.next(at(1)), 40);
        timer.catch_up(at(81));
        let pulse = |at| Pulse { channel: 0, at, long: 16, period: 40, low: false };
        assert_eq!(timer.pulses, [pulse(40), pulse(80)]);
        timer.write(0x34, 0, at(81));
        timer.catch_up(at(500));
        assert_eq!(timer.pulses.len(), 2);
        assert_eq!(timer.next(at(500)), NEVER);
    }

    #[test]
    fn an_update_asks_for_a_burst_of_words_to_consecutive_registers() {
        let mut timer = running();
        // From CCR1 (register 13), four.
        timer.write(0x48, 0x030d, at(0));
        timer.write(0x0c, UDE, at(0));
        assert!(!timer.wants_dma());
        timer.catch_up(at(40));
        for value in 5..9 {
            assert!(timer.wants_dma());
            timer.write(0x4c, value, at(40));
        }
        assert!(!timer.wants_dma());
        assert_eq!(timer.ccr, [5, 6, 7, 8]);
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let mut timer = running();
        for (offset, value) in [(0x00, 1 << 4), (0x08, 4), (0x0c, 1 << 9), (0x18, 1), (0x14, 2), (0x50, 0)] {
            assert_eq!(timer.write(offset, value, at(0)), None, "{offset:#x}");
        }
    }
}
