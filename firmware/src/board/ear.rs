//! Ear: samples the motors' lines while speed controllers answer, all lines of a port at once.
//!
//! A timer that drives nothing paces a DMA stream that reads the port's inputs; the program has nothing to do meanwhile. What is heard is
//! taken apart in `firmware::erpm`.
use core::mem::{forget, transmute};
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::Peri;
use embassy_stm32::dma::{self, Transfer, TransferOptions};
use embassy_stm32::interrupt::typelevel::Binding;
use embassy_stm32::pac::gpio::{Gpio, vals};
use embassy_stm32::timer::low_level::Timer;
use embassy_stm32::timer::{GeneralInstance4Channel, UpDma};
use firmware::erpm::{MOTORS, SAMPLES, SAMPLES_A_BIT, SPEED_UP};

use super::chosen::Irqs;
use crate::tasks::now_us;

/// How long before it is to listen it may be told, µs: the pacer counts no further.
const AHEAD_US_MAX: u64 = 300;

/// What was heard last, two samples a word. The stream writes it, so it is nobody's but by atomics.
static HEARD: [AtomicU32; SAMPLES / 2] = [const { AtomicU32::new(0) }; SAMPLES / 2];

/// The lines of all motors, which lie on one port, and what listens to them. There is one.
pub(crate) struct Ear<T: GeneralInstance4Channel, D: UpDma<T>> {
    pacer: Timer<'static, T>,
    stream: Peri<'static, D>,
    port: Gpio,
    /// The pin of each motor.
    pins: [u8; MOTORS],
    /// The pacer's counts in a microsecond, and between two samples.
    counts: (u16, u16),
    /// What listens, or has.
    transfer: Option<Transfer<'static>>,
}

impl<T, D> Ear<T, D>
where
    T: GeneralInstance4Channel<Word: From<u16>>,
    D: UpDma<T>,
    Irqs: Binding<D::Interrupt, dma::InterruptHandler<D>>,
{
    /// Deaf as yet, the lines belonging to their timers.
    #[cfg_attr(feature = "foxeer-f722-v4", expect(dead_code, reason = "that board has no stream left to listen by"))]
    pub(super) fn new(pacer: Peri<'static, T>, stream: Peri<'static, D>, port: Gpio, pins: [u8; MOTORS]) -> Self {
        let pacer = Timer::new(pacer);
        pacer.set_autoreload_preload(true);
        Self { pacer, stream, port, pins, counts: (0, 0), transfer: None }
    }

    /// Lets the lines rest high where nobody drives them, as those of speed controllers that may answer must. Before any task runs.
    ///
    /// - `frames_hz`: bits a second of the frames that are answered.
    pub(crate) fn prepare(&mut self, frames_hz: u32) {
        let clock_hz = self.pacer.get_clock_frequency().0;
        let sample_hz = frames_hz * SPEED_UP.0 / SPEED_UP.1 * SAMPLES_A_BIT;
        let between = (clock_hz + sample_hz / 2) / sample_hz;
        self.counts = ((clock_hz / 1_000_000) as u16, between as u16);
        self.port.pupdr().modify(|w| self.pins.iter().for_each(|&pin| w.set_pupdr(pin.into(), vals::Pupdr::PULL_UP)));
    }

    /// Listens, while frames are sent, for what comes after them.
    ///
    /// - `from_us`: from when on, µs since boot; at most 300 from now, or else at once.
    pub(crate) fn listen(&mut self, from_us: u64) {
        let mut options = TransferOptions::default();
        // Nobody waits for its end.
        options.complete_transfer_ir = false;
        let request = self.stream.request();
        // SAFETY: the stream is this one's for good, and no other transfer of it is left.
        let mut channel = dma::Channel::new(unsafe { self.stream.clone_unchecked() }, Irqs);
        let heard = core::ptr::slice_from_raw_parts_mut(HEARD.as_ptr().cast::<u16>().cast_mut(), SAMPLES);
        // SAFETY: a register that can be read at any time, and memory that is written through atomics or by this. The transfer lives as long as
        // the stream that `self` owns, not as long as the handle to it.
        self.transfer = Some(unsafe {
            let inputs = self.port.idr().as_ptr().cast::<u16>();
            transmute::<Transfer<'_>, Transfer<'static>>(channel.read_raw(request, inputs, heard, options))
        });
        let (a_us, between) = self.counts;
        let ahead_us = from_us.saturating_sub(now_us());
        let first = if (1..=AHEAD_US_MAX).contains(&ahead_us) { a_us * ahead_us as u16 } else { between };
        self.pacer.set_max_compare_value((first - 1).into());
        // Counts from the first sample on.
        self.pacer.regs_gp16().arr().write(|w| w.set_arr(between - 1));
        self.pacer.enable_update_dma(true);
        self.pacer.start();
    }

    /// Takes the lines from their timers; to be called when the frames are through.
    pub(crate) fn open(&mut self) {
        self.set_lines(vals::Moder::INPUT);
    }

    /// Gives the lines back to their timers; whether everything was heard.
    pub(crate) fn stop(&mut self) -> bool {
        self.pacer.stop();
        self.pacer.enable_update_dma(false);
        self.set_lines(vals::Moder::ALTERNATE);
        let Some(mut transfer) = self.transfer.take() else { return false };
        let whole = !transfer.is_running();
        if whole {
            // Nothing is left to stop, which would cost an interrupt.
            forget(transfer);
        }
        whole
    }

    /// The bit of each motor's line in a sample.
    pub(crate) fn pins(&self) -> [u8; MOTORS] {
        self.pins
    }

    /// Nobody else writes this register but within critical sections below this task, which are over while it runs.
    fn set_lines(&self, mode: vals::Moder) {
        self.port.moder().modify(|w| self.pins.iter().for_each(|&pin| w.set_moder(pin.into(), mode)));
    }
}

/// What was heard last: pairs of samples, the earlier one in the lower half.
pub(crate) fn heard() -> impl Iterator<Item = u32> {
    HEARD.iter().map(|pair| pair.load(Ordering::Relaxed))
}
