//! ADC1: one conversion at a time, started by software, or a sequence of them with DMA.
//!
//! A conversion takes `sampling + 12` ADC clocks. Voltages are the board's (`board`).
//!
//! # Source
//! RM0090, chapter 13.13 "ADC registers".
use super::{NEVER, Tick, only};

const EOC: u32 = 1 << 1;
const STRT: u32 = 1 << 4;
const OVR: u32 = 1 << 5;
/// Sampling times, ADC clocks.
const SAMPLING: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];

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
    asks_dma: bool,
}

impl Adc {
    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.sr,
            0x04 => self.cr1,
            0x08 => self.cr2 & !(1 << 30),
            0x0c | 0x10 => self.smpr[(offset as usize - 0x0c) / 4],
            0x2c..=0x34 => self.sqr[(offset as usize - 0x2c) / 4],
            0x4c => {
                self.sr &= !EOC;
                self.asks_dma = false;
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
            // ADON, DMA, DDS, EOCS, SWSTART; no external trigger, no continuous mode, right aligned.
            0x08 => {
                self.cr2 = only(value, 0x4000_0701)?;
                if value & 1 << 30 != 0 {
                    self.sr |= STRT;
                    self.convert(0, t);
                }
            }
            0x0c | 0x10 => self.smpr[(offset as usize - 0x0c) / 4] = value,
            0x2c..=0x34 => self.sqr[(offset as usize - 0x2c) / 4] = value,
            // Prescaler, and the switches of battery and temperature.
            0x304 => self.ccr = only(value, 0x00c3_0000)?,
            _ => return None,
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

    /// The channel whose conversion is done; [`Self::converted`] must follow.
    pub(crate) fn due(&self) -> u32 {
        self.converting.map_or(0, |(place, _)| self.channel(place))
    }

    /// The value, 12 bits, of the channel that was due.
    pub(crate) fn converted(&mut self, value: u32, t: Tick) {
        let Some((place, _)) = self.converting.take() else { return };
        let dma = self.cr2 & 1 << 8 != 0;
        if dma && self.asks_dma {
            self.sr |= OVR;
        }
        self.dr = value & 0xfff;
        self.asks_dma = dma;
        let last = place >= self.sqr[0] >> 20 & 0xf;
        if last || self.cr2 & 1 << 10 != 0 {
            self.sr |= EOC;
        }
        if !last {
            self.convert(place + 1, t);
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

    #[test]
    fn a_conversion_takes_its_sampling_time_and_twelve_clocks() {
        let t = |now| Tick { now, clock: 2 };
        let mut adc = Adc::default();
        adc.write(0x34, 10, t(0));
        // Channel 10: 28 clocks.
        adc.write(0x0c, 2, t(0));
        adc.write(0x08, 1 << 30 | 1, t(0));
        assert_eq!((adc.next(), adc.due()), ((28 + 12) * 2 * 2, 10));
        adc.converted(1234, t(160));
        assert_eq!(adc.read(0x00), Some(STRT | EOC));
        assert_eq!(adc.read(0x4c), Some(1234));
        assert_eq!(adc.read(0x00), Some(STRT));
        assert_eq!(adc.next(), NEVER);
    }
}
