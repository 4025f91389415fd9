//! ADC1: one conversion, or a scan of a sequence, started by software; once or endlessly, read by the program or by DMA.
//!
//! A conversion takes `sampling + 12` ADC clocks. Voltages are the board's (`board`). A value that nobody has taken when the next one is
//! there is an overrun: no DMA is asked for and nothing is converted until the flag is cleared and a start asked for again. A start
//! before the converter is awake, a change of the sequence while it converts, and DMA that is to end by itself are refused.
//!
//! # Source
//! RM0090, chapters 13.3.6 "Continuous conversion mode", 13.3.8 "Scan mode", 13.8 "Data management", 13.13 "ADC registers". Time to wake:
//! DS8626, "ADC characteristics", t_STAB.
use super::{NEVER, Tick, only};
use crate::board::CYCLES_US;

const EOC: u32 = 1 << 1;
const STRT: u32 = 1 << 4;
const OVR: u32 = 1 << 5;
const SCAN: u32 = 1 << 8;
const ADON: u32 = 1;
const CONT: u32 = 1 << 1;
const DMA: u32 = 1 << 8;
const DDS: u32 = 1 << 9;
const EOCS: u32 = 1 << 10;
const SWSTART: u32 = 1 << 30;
/// Sampling times, ADC clocks.
const SAMPLING: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
/// Core cycles in 3 µs, which it takes to wake.
const WAKE: u64 = 3 * CYCLES_US;

/// The converter with its common registers.
#[derive(Debug, Default)]
pub(crate) struct Adc {
    sr: u32,
    cr1: u32,
    cr2: u32,
    smpr: [u32; 2],
    sqr: [u32; 3],
    dr: u32,
    ccr: u32,
    /// Place in the sequence, and when its conversion is done.
    converting: Option<(u32, u64)>,
    /// When it is awake.
    awake_at: u64,
    /// Whether the value was not taken yet, and whether DMA is asked to.
    unread: bool,
    asks_dma: bool,
}

impl Adc {
    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.sr,
            0x04 => self.cr1,
            0x08 => self.cr2 & !SWSTART,
            0x0c | 0x10 => self.smpr[(offset as usize - 0x0c) / 4],
            0x2c..=0x34 => self.sqr[(offset as usize - 0x2c) / 4],
            0x4c => {
                self.sr &= !EOC;
                (self.unread, self.asks_dma) = (false, false);
                self.dr
            }
            0x304 => self.ccr,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, t: Tick) -> Option<()> {
        match offset {
            0x00 => self.sr &= value,
            // 12 bits, SCAN, EOCIE, OVRIE.
            0x04 => self.cr1 = only(value, 0x0400_0120)?,
            // No external trigger, no injected conversions, right aligned.
            0x08 => self.control(only(value, ADON | CONT | DMA | DDS | EOCS | SWSTART)?, t)?,
            0x0c | 0x10 if self.converting.is_none() => self.smpr[(offset as usize - 0x0c) / 4] = value,
            0x2c..=0x34 if self.converting.is_none() => self.sqr[(offset as usize - 0x2c) / 4] = value,
            // Prescaler, and the switches of battery and temperature.
            0x304 => self.ccr = only(value, 0x00c3_0000)?,
            _ => return None,
        }
        Some(())
    }

    fn control(&mut self, value: u32, t: Tick) -> Option<()> {
        (value & DMA == 0 || value & DDS != 0).then_some(())?;
        let was = std::mem::replace(&mut self.cr2, value);
        if value & ADON == 0 {
            self.converting = None;
        } else if was & ADON == 0 {
            self.awake_at = t.now + WAKE;
        }
        if value & DMA == 0 {
            self.asks_dma = false;
        }
        if value & SWSTART != 0 {
            (value & ADON != 0 && t.now >= self.awake_at && self.converting.is_none()).then_some(())?;
            self.sr |= STRT;
            if self.sr & OVR == 0 {
                self.unread = false;
                self.convert(0, t);
            }
        }
        Some(())
    }

    fn convert(&mut self, place: u32, t: Tick) {
        let channel = self.channel(place);
        let field = self.smpr[usize::from(channel < 10)] >> (3 * (channel % 10)) & 7;
        let prescaler = 2 * (u64::from(self.ccr >> 16 & 3) + 1);
        let cycles = (SAMPLING[field as usize] + 12) * prescaler * t.clock;
        self.converting = Some((place, t.now + cycles));
    }

    fn channel(&self, place: u32) -> u32 {
        // SQR3 has the first six, SQR2 the next six, SQR1 the rest.
        self.sqr[2 - place as usize / 6] >> (5 * (place % 6)) & 0x1f
    }

    pub(crate) fn next(&self) -> u64 {
        self.converting.map_or(NEVER, |(_, done)| done)
    }

    /// The channel whose conversion is done; [`Self::converted`] or [`Self::lose`] must follow.
    pub(crate) fn due(&self) -> u32 {
        self.converting.map_or(0, |(place, _)| self.channel(place))
    }

    /// What was due never comes.
    pub(crate) fn lose(&mut self) {
        self.converting = None;
    }

    /// The value, 12 bits, of the channel that was due.
    pub(crate) fn converted(&mut self, value: u32, t: Tick) {
        let Some((place, _)) = self.converting.take() else { return };
        let dma = self.cr2 & DMA != 0;
        let watched = dma || self.cr2 & EOCS != 0;
        if watched && self.unread {
            self.sr |= OVR;
            self.asks_dma = false;
            return;
        }
        self.dr = value & 0xfff;
        (self.unread, self.asks_dma) = (true, dma);
        let last = self.cr1 & SCAN == 0 || place >= self.sqr[0] >> 20 & 0xf;
        if last || self.cr2 & EOCS != 0 {
            self.sr |= EOC;
        }
        match (last, self.cr2 & CONT != 0) {
            (false, _) => self.convert(place + 1, t),
            (true, true) => self.convert(0, t),
            (true, false) => {}
        }
    }

    pub(crate) fn interrupts(&self) -> bool {
        self.cr1 & 1 << 5 != 0 && self.sr & EOC != 0 || self.cr1 & 1 << 26 != 0 && self.sr & OVR != 0
    }

    pub(crate) fn wants_read(&self) -> bool {
        self.asks_dma
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: u64 = (28 + 12) * 2 * 2;

    fn t(now: u64) -> Tick {
        Tick { now, clock: 2 }
    }

    /// Awake, with channels 10 and 11 in its sequence: 28 clocks each.
    fn two() -> Adc {
        let mut adc = Adc::default();
        for (offset, value) in [(0x2c, 1 << 20), (0x34, 0x16a), (0x0c, 0b010_010), (0x08, ADON)] {
            adc.write(offset, value, t(0)).expect("is modelled");
        }
        adc
    }

    /// Lets what is due be done; returns its channel and when that was.
    fn pass(adc: &mut Adc, value: u32) -> (u32, u64) {
        let (channel, now) = (adc.due(), adc.next());
        adc.converted(value, t(now));
        (channel, now)
    }

    #[test]
    fn a_conversion_takes_its_sampling_time_and_twelve_clocks() {
        let mut adc = two();
        adc.write(0x08, SWSTART | ADON, t(WAKE));
        assert_eq!(pass(&mut adc, 1234), (10, WAKE + T));
        assert_eq!(adc.read(0x00), Some(STRT | EOC));
        assert_eq!(adc.read(0x4c), Some(1234));
        assert_eq!(adc.read(0x00), Some(STRT));
        assert_eq!(adc.next(), NEVER, "without SCAN the first of the sequence is all");
    }

    #[test]
    fn an_endless_scan_asks_dma_for_each_value_and_goes_on_with_the_first() {
        let mut adc = two();
        adc.write(0x04, SCAN, t(0));
        adc.write(0x08, SWSTART | ADON | CONT | DMA | DDS, t(WAKE));
        for n in 1..=5 {
            assert!(!adc.wants_read());
            assert_eq!(pass(&mut adc, n as u32), (if n % 2 == 1 { 10 } else { 11 }, WAKE + n * T));
            assert!(adc.wants_read());
            assert_eq!(adc.read(0x4c), Some(n as u32));
        }
        adc.write(0x08, CONT | DMA | DDS, t(WAKE + 5 * T + 1));
        assert_eq!(adc.next(), NEVER, "switched off");
    }

    #[test]
    fn a_value_that_nobody_takes_ends_the_scan_until_its_flag_is_cleared() {
        let mut adc = two();
        adc.write(0x04, SCAN | 1 << 26, t(0));
        let start = SWSTART | ADON | CONT | DMA | DDS;
        adc.write(0x08, start, t(WAKE));
        pass(&mut adc, 1);
        assert!(!adc.interrupts());
        pass(&mut adc, 2);
        assert_eq!((adc.read(0x00), adc.interrupts()), (Some(STRT | OVR), true));
        assert_eq!((adc.wants_read(), adc.next(), adc.read(0x4c)), (false, NEVER, Some(1)));
        adc.write(0x08, start, t(10 * T));
        assert_eq!(adc.next(), NEVER, "still overrun");
        adc.write(0x00, !OVR, t(10 * T));
        adc.write(0x08, start, t(10 * T));
        assert_eq!(pass(&mut adc, 3), (10, 11 * T));
    }

    #[test]
    fn what_is_not_modelled_or_cannot_work_is_refused() {
        let mut adc = two();
        let refused = |adc: &mut Adc, offset, value, now| assert_eq!(adc.write(offset, value, t(now)), None);
        refused(&mut adc, 0x08, SWSTART | ADON, WAKE - 1);
        refused(&mut adc, 0x08, SWSTART, WAKE);
        refused(&mut adc, 0x08, ADON | DMA, WAKE);
        refused(&mut adc, 0x08, ADON | 1 << 28, WAKE);
        refused(&mut adc, 0x04, 1 << 24, WAKE);
        adc.write(0x08, ADON, t(WAKE));
        adc.write(0x08, SWSTART | ADON, t(2 * WAKE)).expect("is awake");
        refused(&mut adc, 0x34, 5, 2 * WAKE);
        refused(&mut adc, 0x0c, 5, 2 * WAKE);
        refused(&mut adc, 0x08, SWSTART | ADON, 2 * WAKE + 1);
    }
}
