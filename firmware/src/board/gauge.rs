//! Gauge: the battery's lines, converted by ADC1 and moved by DMA while the program does other things.
//!
//! ```text
//! share of the reference = (counts of SCANS scans) / (SCANS · full scale)
//! ```
//!
//! Scans follow each other without a pause, over some ten periods of the speed controllers' switching, whose ripple is on the lines.
//! A reading that fails or does not end in time is none. Nothing of it is left for the next: each begins with the converter at rest.
//!
//! # Source
//! Time that the converter of an F4 or F7 takes to wake, 3 µs at most: their data sheets, "ADC characteristics", t_STAB.
use embassy_stm32::Peri;
use embassy_stm32::adc::{Adc, AdcChannel};
#[cfg(not(feature = "orbit-h743"))]
use embassy_stm32::adc::{CONTINUOUS, Exten};
use embassy_stm32::peripherals::ADC1;
#[cfg(not(feature = "orbit-h743"))]
use embassy_time::Timer;
use embassy_time::{Duration, with_timeout};

use super::chosen::{CurrentPin, FULL_SCALE, GaugeStream, Irqs, LINE_SAMPLE, VoltagePin};

/// Lines of the battery.
const LINES: usize = 2;
/// Scans whose mean is a reading.
const SCANS: usize = 8;
/// Conversions of a reading.
const COUNTS: usize = LINES * SCANS;
/// How long a reading may take: many times what it does, some 0.4 ms.
const PATIENCE: Duration = Duration::from_millis(5);
/// Time that the converter is given to wake, µs.
#[cfg(not(feature = "orbit-h743"))]
const WAKE_US: u64 = 10;

/// The battery's lines.
pub(crate) struct Gauge {
    #[cfg(not(feature = "orbit-h743"))]
    pub(super) converter: Peri<'static, ADC1>,
    #[cfg(feature = "orbit-h743")]
    pub(super) converter: Adc<'static, ADC1>,
    pub(super) voltage: Peri<'static, VoltagePin>,
    pub(super) current: Peri<'static, CurrentPin>,
    pub(super) stream: Peri<'static, GaugeStream>,
}

impl Gauge {
    /// What is at the pins of voltage and current, shares of the reference; nothing if the converter fails.
    pub(crate) async fn read(&mut self) -> Option<[f32; LINES]> {
        let mut counts = [0; COUNTS];
        with_timeout(PATIENCE, self.scan(&mut counts)).await.ok()??;
        let (scans, _) = counts.as_chunks::<LINES>();
        let sum = |line: usize| scans.iter().map(|scan| u32::from(scan[line])).sum::<u32>();
        Some(core::array::from_fn(|line| sum(line) as f32 / (SCANS as f32 * FULL_SCALE)))
    }

    /// Opens the converter, fills `counts` and closes it, also if nobody waits any more.
    #[cfg(not(feature = "orbit-h743"))]
    async fn scan(&mut self, counts: &mut [u16; COUNTS]) -> Option<()> {
        let Self { converter, voltage, current, stream } = self;
        // The driver of these chips knows endless scans only. What is asked for is the first half of a ring.
        let mut ring = [0; 2 * COUNTS];
        let lines =
            [voltage.reborrow().degrade_adc(), current.reborrow().degrade_adc()].map(|line| (line, LINE_SAMPLE));
        let converter = Adc::new(converter.reborrow());
        let (stream, lines) = (stream.reborrow(), lines.into_iter());
        let mut scans = converter.into_ring_buffered(stream, &mut ring, Irqs, lines, CONTINUOUS, Exten::DISABLED);
        Timer::after_micros(WAKE_US).await;
        scans.read(counts).await.ok().map(drop)
    }

    /// Fills `counts`.
    #[cfg(feature = "orbit-h743")]
    async fn scan(&mut self, counts: &mut [u16; COUNTS]) -> Option<()> {
        let Self { converter, voltage, current, stream } = self;
        let mut lines = [voltage.reborrow().degrade_adc(), current.reborrow().degrade_adc()];
        let lines = lines.each_mut().map(|line| (line, LINE_SAMPLE));
        converter.read(stream.reborrow(), Irqs, lines.into_iter(), counts).await;
        Some(())
    }
}
