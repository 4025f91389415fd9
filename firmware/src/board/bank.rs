//! Motors whose lines lie on one timer, and the DMA stream that writes its bursts.
use embassy_stm32::Peri;
use embassy_stm32::dma;
use embassy_stm32::interrupt::typelevel::Binding;
use embassy_stm32::timer::low_level::OutputPolarity;
use embassy_stm32::timer::simple_pwm::SimplePwm;
use embassy_stm32::timer::{Channel, GeneralInstance4Channel, UpDma};
use firmware::dshot::{self, Dialogue};

use super::chosen::Irqs;

/// A frame for each of `N` motors.
pub(crate) type Frames<const N: usize> = [[u16; N]; dshot::BITS];

/// `N` neighbouring channels of a timer.
pub(crate) struct Bank<T: GeneralInstance4Channel, D: UpDma<T>, const N: usize> {
    pub(super) timer: SimplePwm<'static, T>,
    pub(super) dma: Peri<'static, D>,
    pub(super) channels: [Channel; N],
}

impl<T, D, const N: usize> Bank<T, D, N>
where
    T: GeneralInstance4Channel<Word: From<u16>>,
    D: UpDma<T>,
    Irqs: Binding<D::Interrupt, dma::InterruptHandler<D>>,
{
    /// The timer's counts in one period, which are the counts of a DShot bit or of the time between pulses.
    pub(crate) fn counts(&self) -> u32 {
        self.timer.max_duty_cycle()
    }

    /// One DShot frame for each motor, in the order of the channels, as [`Self::send`] takes them.
    pub(crate) fn frames(&self, values: [dshot::Value; N], dialogue: Dialogue) -> Frames<N> {
        dshot::waveform(values, dialogue, self.counts() as u16)
    }

    /// Sends frames; returns when they are through.
    pub(crate) async fn send(&mut self, waveform: &Frames<N>) {
        let [Some(&first), Some(&last)] = [self.channels.first(), self.channels.last()] else { return };
        self.timer.waveform_up_multi_channel(self.dma.reborrow(), Irqs, first, last, waveform.as_flattened()).await;
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
