//! Motors whose lines lie on one timer, and the DMA stream that writes its bursts.
use embassy_stm32::Peri;
use embassy_stm32::dma;
use embassy_stm32::interrupt::typelevel::Binding;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::OutputPolarity;
use embassy_stm32::timer::simple_pwm::SimplePwm;
use embassy_stm32::timer::{Channel, GeneralInstance4Channel, UpDma};
use firmware::dshot::{self, Dialogue, Waveform};

use super::chosen::Irqs;

/// Periods a second of a timer until it is told: so many that what it is told holds at once.
pub(super) const UNTOLD: Hertz = Hertz(600_000);

/// `N` neighbouring channels of a timer.
pub(crate) struct Bank<T: GeneralInstance4Channel, D: UpDma<T>, const N: usize> {
    timer: SimplePwm<'static, T>,
    dma: Peri<'static, D>,
    channels: [Channel; N],
    /// The timer's counts in one period, which are the counts of a DShot bit or of the time between pulses.
    counts: u32,
    waveform: Aligned<T::Word, N>,
}

/// A frame for each motor. The stream reads it in bursts of up to four of the timer's words, of which none may cross a boundary of 1 KiB
/// (RM0090, 10.3.11).
#[repr(align(16))]
struct Aligned<W, const N: usize>(Waveform<W, N>);

impl<T, D, const N: usize> Bank<T, D, N>
where
    T: GeneralInstance4Channel<Word: From<u16>>,
    D: UpDma<T>,
    Irqs: Binding<D::Interrupt, dma::InterruptHandler<D>>,
{
    /// Not connected yet.
    pub(super) fn new(timer: SimplePwm<'static, T>, dma: Peri<'static, D>, channels: [Channel; N]) -> Self {
        Self { timer, dma, channels, counts: 0, waveform: Aligned([[T::Word::from(0); N]; dshot::BITS]) }
    }

    /// Sets the timer's periods a second, before it is enabled.
    pub(super) fn set_rate(&mut self, hz: u32) {
        self.timer.set_frequency(Hertz(hz));
        self.counts = self.timer.max_duty_cycle();
    }

    /// The timer's counts in one period.
    pub(super) fn counts(&self) -> u32 {
        self.counts
    }

    /// Writes one DShot frame for each motor, in the order of the channels.
    pub(crate) fn write(&mut self, values: [dshot::Value; N], dialogue: Dialogue) {
        dshot::write(&mut self.waveform.0, values, dialogue, self.counts as u16);
    }

    /// Sends them; returns when they are through.
    pub(crate) async fn send(&mut self) {
        let [Some(&first), Some(&last)] = [self.channels.first(), self.channels.last()] else { return };
        self.timer
            .waveform_up_multi_channel(self.dma.reborrow(), Irqs, first, last, self.waveform.0.as_flattened())
            .await;
    }

    /// Sets how long each motor's pulses are from now on, in counts; whoever gives more than there are has lines that stay high.
    pub(crate) fn set_pulses(&mut self, pulses: [u32; N]) {
        // SAFETY: this timer's own registers, which are laid out like this in advanced and wide timers too. `SimplePwm` would panic at a pulse too long.
        let registers = unsafe { TimGp16::from_ptr(T::regs()) };
        for (channel, counts) in self.channels.into_iter().zip(pulses) {
            registers.ccr(channel.index()).write(|w| w.set_ccr(counts as u16));
        }
    }

    /// Connects the outputs; until then their lines are low. From then on lines that are answered rest high.
    pub(crate) fn enable(&mut self, dialogue: Dialogue) {
        for channel in self.channels {
            let mut output = self.timer.channel(channel);
            if dialogue == Dialogue::Answered {
                output.set_polarity(OutputPolarity::ActiveLow);
            }
            output.enable();
        }
    }
}
