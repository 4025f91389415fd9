//! Motors whose lines lie on one timer, and the DMA stream that writes its bursts.
use embassy_stm32::Peri;
use embassy_stm32::dma;
use embassy_stm32::interrupt::typelevel::Binding;
use embassy_stm32::timer::low_level::OutputPolarity;
use embassy_stm32::timer::simple_pwm::SimplePwm;
use embassy_stm32::timer::{Channel, GeneralInstance4Channel, UpDma};
use firmware::dshot::{self, Dialogue, Waveform};

use super::chosen::Irqs;

/// `N` neighbouring channels of a timer.
pub(crate) struct Bank<T: GeneralInstance4Channel, D: UpDma<T>, const N: usize> {
    timer: SimplePwm<'static, T>,
    dma: Peri<'static, D>,
    channels: [Channel; N],
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
        Self { timer, dma, channels, waveform: Aligned([[T::Word::from(0); N]; dshot::BITS]) }
    }

    /// The timer's counts in one period, which are the counts of a DShot bit or of the time between pulses.
    pub(crate) fn counts(&self) -> u32 {
        self.timer.max_duty_cycle()
    }

    /// Writes one DShot frame for each motor, in the order of the channels.
    pub(crate) fn write(&mut self, values: [dshot::Value; N], dialogue: Dialogue) {
        let counts = self.counts() as u16;
        dshot::write(&mut self.waveform.0, values, dialogue, counts);
    }

    /// Sends them; returns when they are through.
    pub(crate) async fn send(&mut self) {
        let [Some(&first), Some(&last)] = [self.channels.first(), self.channels.last()] else { return };
        self.timer
            .waveform_up_multi_channel(self.dma.reborrow(), Irqs, first, last, self.waveform.0.as_flattened())
            .await;
    }

    /// Sets how long each motor's pulses are from now on, in counts.
    pub(crate) fn set_pulses(&mut self, pulses: [u32; N]) {
        for (channel, counts) in self.channels.into_iter().zip(pulses) {
            self.timer.channel(channel).set_duty_cycle(counts);
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
