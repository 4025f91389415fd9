//! DMA1 and DMA2: streams that move words between memory and a peripheral's data register on request.
//!
//! A beat is moved the moment it is asked for: neither the bus nor the FIFO delays it, which on the chip is some
//! 10 cycles. Memory to memory, double buffers and unequal widths are not modelled and are refused.
//!
//! Bursts fill the FIFO earlier than single beats would, which is not modelled; those that cross a boundary of 1 KiB are refused.
//!
//! # Source
//! RM0090, chapter 10.5 "DMA registers", tables 42 and 43 for the requests.
use super::only;

/// Who asks for beats. The number is the peripheral's, counted as the manual does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    SpiRx(usize),
    SpiTx(usize),
    UsartRx(usize),
    UsartTx(usize),
    I2cRx(usize),
    I2cTx(usize),
    TimerUpdate(usize),
    Adc(usize),
}

use Request::{Adc, I2cRx, I2cTx, SpiRx, SpiTx, TimerUpdate, UsartRx, UsartTx};

/// Controller, stream, channel: request.
const REQUESTS: [(usize, usize, u32, Request); 44] = [
    (1, 0, 0, SpiRx(3)),
    (1, 2, 0, SpiRx(3)),
    (1, 3, 0, SpiRx(2)),
    (1, 4, 0, SpiTx(2)),
    (1, 5, 0, SpiTx(3)),
    (1, 7, 0, SpiTx(3)),
    (1, 0, 1, I2cRx(1)),
    (1, 5, 1, I2cRx(1)),
    (1, 6, 1, I2cTx(1)),
    (1, 7, 1, I2cTx(1)),
    (1, 6, 2, TimerUpdate(4)),
    (1, 2, 3, I2cRx(3)),
    (1, 4, 3, I2cTx(3)),
    (1, 1, 3, TimerUpdate(2)),
    (1, 7, 3, TimerUpdate(2)),
    (1, 0, 4, UsartRx(5)),
    (1, 1, 4, UsartRx(3)),
    (1, 2, 4, UsartRx(4)),
    (1, 3, 4, UsartTx(3)),
    (1, 4, 4, UsartTx(4)),
    (1, 5, 4, UsartRx(2)),
    (1, 6, 4, UsartTx(2)),
    (1, 7, 4, UsartTx(5)),
    (1, 2, 5, TimerUpdate(3)),
    (1, 0, 6, TimerUpdate(5)),
    (1, 6, 6, TimerUpdate(5)),
    (1, 2, 7, I2cRx(2)),
    (1, 3, 7, I2cRx(2)),
    (1, 7, 7, I2cTx(2)),
    (2, 0, 0, Adc(1)),
    (2, 4, 0, Adc(1)),
    (2, 0, 3, SpiRx(1)),
    (2, 2, 3, SpiRx(1)),
    (2, 3, 3, SpiTx(1)),
    (2, 5, 3, SpiTx(1)),
    (2, 2, 4, UsartRx(1)),
    (2, 5, 4, UsartRx(1)),
    (2, 7, 4, UsartTx(1)),
    (2, 1, 5, UsartRx(6)),
    (2, 2, 5, UsartRx(6)),
    (2, 6, 5, UsartTx(6)),
    (2, 7, 5, UsartTx(6)),
    (2, 5, 6, TimerUpdate(1)),
    (2, 1, 7, TimerUpdate(8)),
];

const EN: u32 = 1;
const CIRC: u32 = 1 << 8;
const PINC: u32 = 1 << 9;
const MINC: u32 = 1 << 10;
const TCIF: u32 = 1 << 5;
const HTIF: u32 = 1 << 4;
/// Where the flags of streams 0 to 3 are in LISR, and 4 to 7 in HISR.
const FLAG_SHIFTS: [u32; 4] = [0, 6, 16, 22];

#[derive(Clone, Copy, Debug, Default)]
struct Stream {
    cr: u32,
    ndtr: u32,
    par: u32,
    m0ar: u32,
    fcr: u32,
    flags: u32,
    /// Beats of a whole transfer, and where memory is now.
    total: u32,
    memory: u32,
    /// Whether it was told what to move since it last began to.
    told: bool,
    /// Who asks for its beats, by its channel when it was last switched on.
    request: Option<Request>,
}

/// One word to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Beat {
    pub(crate) stream: usize,
    pub(crate) peripheral: u32,
    pub(crate) memory: u32,
    pub(crate) bytes: usize,
    pub(crate) to_peripheral: bool,
}

/// A controller.
#[derive(Debug)]
pub(crate) struct Dma {
    number: usize,
    streams: [Stream; 8],
}

impl Dma {
    /// Controller 1 or 2.
    pub(crate) fn new(number: usize) -> Self {
        Self { number, streams: [Stream { fcr: 0x21, ..Stream::default() }; 8] }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        let flags = |first: usize| (0..4).map(|n| self.streams[first + n].flags << FLAG_SHIFTS[n]).sum();
        if offset < 0x10 {
            return Some(match offset {
                0x0 => flags(0),
                0x4 => flags(4),
                _ => 0,
            });
        }
        let stream = self.streams.get((offset as usize - 0x10) / 0x18)?;
        Some(match (offset - 0x10) % 0x18 {
            0x00 => stream.cr,
            0x04 => stream.ndtr,
            0x08 => stream.par,
            0x0c => stream.m0ar,
            0x10 => 0,
            _ => stream.fcr,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        if offset < 0x10 {
            let first = if offset == 0x8 { 0 } else { 4 };
            if offset < 0x8 {
                return None;
            }
            for (n, shift) in FLAG_SHIFTS.into_iter().enumerate() {
                self.streams[first + n].flags &= !(value >> shift & 0x3d);
            }
            return Some(());
        }
        let index = (offset as usize - 0x10) / 0x18;
        let stream = self.streams.get_mut(index)?;
        match (offset - 0x10) % 0x18 {
            0x00 => {
                let started = value & EN != 0 && stream.cr & EN == 0;
                let stopped = value & EN == 0 && stream.cr & EN != 0;
                // Not peripheral flow control, double buffers or bursts to peripherals; bursts from memory only fill the
                // FIFO earlier.
                stream.cr = only(value, 0x0f83_7ede | EN | CIRC)?;
                if started {
                    self.start(index)?;
                } else if stopped {
                    // The chip flags the end of a stream that is switched off.
                    stream.flags |= TCIF;
                }
            }
            0x04 => {
                stream.ndtr = only(value, 0xffff)?;
                stream.told = true;
            }
            0x08 => stream.par = value,
            0x0c => stream.m0ar = value,
            0x10 => {
                only(value, 0)?;
            }
            _ => stream.fcr = only(value, 0xbf)? & 0x87 | 0x20,
        }
        Some(())
    }

    /// A stream is switched on: refuses what is not modelled.
    fn start(&mut self, index: usize) -> Option<()> {
        let stream = &mut self.streams[index];
        let channel = stream.cr >> 25 & 7;
        let row = REQUESTS.iter().find(|row| (row.0, row.1, row.2) == (self.number, index, channel));
        stream.request = Some(row?.3);
        (stream.cr >> 11 & 3 == stream.cr >> 13 & 3 && stream.cr & PINC == 0).then_some(())?;
        // One that was only switched off goes on where it was: an STM32F411 was seen to (embassy-rs/embassy, issue 6592).
        if std::mem::take(&mut stream.told) {
            (stream.total, stream.memory) = (stream.ndtr, stream.m0ar);
        }
        // On the chip it is an error that no flag tells of.
        let bytes = stream.ndtr << (stream.cr >> 13 & 3);
        let burst = [1, 4, 8, 16][stream.cr as usize >> 23 & 3] << (stream.cr >> 13 & 3);
        let mut bursts = (stream.memory..stream.memory + bytes).step_by(burst as usize);
        bursts.all(|start| start / 1024 == (start + burst - 1) / 1024).then_some(())
    }

    /// Who asks for the beats of a stream, if it is on.
    pub(crate) fn request(&self, index: usize) -> Option<Request> {
        let stream = &self.streams[index];
        stream.request.filter(|_| stream.cr & EN != 0)
    }

    /// The streams that are on.
    pub(crate) fn running(&self) -> impl Iterator<Item = usize> + use<> {
        let on: [bool; 8] = std::array::from_fn(|n| self.streams[n].cr & EN != 0);
        (0..8).filter(move |&n| on[n])
    }

    /// Takes the next beat of a stream, whose request is active.
    pub(crate) fn take(&mut self, index: usize) -> Beat {
        let stream = &mut self.streams[index];
        let bytes = 1 << (stream.cr >> 11 & 3);
        let beat = Beat {
            stream: index,
            peripheral: stream.par,
            memory: stream.memory,
            bytes,
            to_peripheral: stream.cr >> 6 & 3 == 1,
        };
        if stream.cr & MINC != 0 {
            stream.memory += bytes as u32;
        }
        stream.ndtr = stream.ndtr.saturating_sub(1);
        if stream.ndtr == stream.total / 2 {
            stream.flags |= HTIF;
        }
        if stream.ndtr == 0 {
            stream.flags |= TCIF;
            if stream.cr & CIRC == 0 {
                stream.cr &= !EN;
            } else {
                (stream.ndtr, stream.memory) = (stream.total, stream.m0ar);
            }
        }
        beat
    }

    /// Beats that are left of a stream's transfer.
    pub(crate) fn left(&self, index: usize) -> u32 {
        self.streams[index].ndtr
    }

    /// Level of the interrupt of each stream.
    pub(crate) fn interrupts(&self) -> [(u32, bool); 8] {
        let numbers =
            if self.number == 1 { [11, 12, 13, 14, 15, 16, 17, 47] } else { [56, 57, 58, 59, 60, 68, 69, 70] };
        std::array::from_fn(|n| {
            let Stream { cr, flags, .. } = self.streams[n];
            (numbers[n], flags & TCIF != 0 && cr & 1 << 4 != 0 || flags & HTIF != 0 && cr & 1 << 3 != 0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circular_stream_flags_half_and_whole_and_starts_again() {
        let mut dma = Dma::new(2);
        // Stream 2, channel 4: USART1 receives into 4 bytes.
        for (offset, value) in [(0x4, 4), (0x8, 0x4001_1004), (0xc, 0x2000_0000)] {
            dma.write(0x40 + offset, value);
        }
        dma.write(0x40, 4 << 25 | MINC | CIRC | 1 << 4 | 1 << 3 | EN);
        assert_eq!(dma.request(2), Some(UsartRx(1)));
        let memory: Vec<u32> = (0..5).map(|_| dma.take(2).memory - 0x2000_0000).collect();
        assert_eq!(memory, [0, 1, 2, 3, 0]);
        assert_eq!(dma.read(0x0), Some((TCIF | HTIF) << 16));
        assert!(dma.interrupts().contains(&(58, true)));
        dma.write(0x8, 0x3d << 16);
        assert!(dma.interrupts().contains(&(58, false)));
        assert_eq!(dma.read(0x44), Some(3));
    }

    #[test]
    fn a_stream_that_is_switched_off_and_on_goes_on_where_it_was() {
        let mut dma = Dma::new(2);
        for (offset, value) in [(0x4, 4), (0x8, 0x4001_1004), (0xc, 0x2000_0000)] {
            dma.write(0x40 + offset, value);
        }
        let on = 4 << 25 | MINC | CIRC | EN;
        let mut taken = |beats: usize| -> Vec<u32> {
            dma.write(0x40, on);
            let memory = (0..beats).map(|_| dma.take(2).memory - 0x2000_0000).collect();
            dma.write(0x40, on & !EN);
            memory
        };
        assert_eq!((taken(3), taken(3)), (vec![0, 1, 2], vec![3, 0, 1]));
        dma.write(0x44, 4);
        dma.write(0x40, on);
        assert_eq!(dma.take(2).memory, 0x2000_0000, "told anew");
    }

    #[test]
    fn bursts_that_cross_a_kibibyte_are_refused() {
        let start = |address: u32| {
            let mut dma = Dma::new(1);
            // Stream 6, channel 2: the updates of TIM4, halfwords in bursts of four.
            for (offset, value) in [(0xa4, 34), (0xa8, 0x4000_084c), (0xac, address)] {
                dma.write(offset, value);
            }
            dma.write(0xa0, 2 << 25 | 1 << 23 | 1 << 13 | 1 << 11 | MINC | 1 << 6 | EN)
        };
        assert_eq!(start(0x2000_0000), Some(()));
        assert_eq!(start(0x2000_03d8), Some(()), "to the boundary, and on");
        assert_eq!(start(0x2000_03d4), None, "across it");
        assert_eq!(start(0x2000_0004), Some(()), "near none");
    }

    #[test]
    fn a_stream_that_nobody_feeds_is_refused() {
        let mut dma = Dma::new(1);
        assert_eq!(dma.write(0x10, 1 << 25 | EN), Some(()), "I2C1 receives by stream 0, channel 1");
        assert_eq!(dma.write(0x28, EN), None, "nobody modelled asks for stream 1, channel 0");
        assert_eq!(dma.write(0x40, 4 << 25 | 1 << 11 | EN), None, "unequal widths");
    }
}
