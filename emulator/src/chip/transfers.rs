//! Transfers by DMA: who asks for a beat, and what it moves.
use super::{Chip, Memory, TIMERS};
use crate::peripheral::dma::Request;
use crate::unit::{Unit, locate};

impl Chip {
    /// Moves beats until nobody asks for one.
    pub(super) fn run_dma(&mut self, memory: &mut dyn Memory) {
        for n in 0..2 {
            for stream in self.dma[n].running() {
                while let Some(request) = self.dma[n].request(stream)
                    && self.wants(request)
                {
                    let unit = self.beat(n, stream, memory);
                    if let Request::TimerUpdate(number) = request
                        && let Some(place) = TIMERS.iter().position(|&timer| timer == number)
                        && unit != Some(Unit::Timer(place))
                    {
                        self.timers[place].served();
                        self.refresh(Unit::Timer(place));
                    }
                    if let (Request::I2cRx(port), 1) = (request, self.dma[n].left(stream)) {
                        self.i2c[port - 1].one_left();
                    }
                }
            }
        }
    }

    fn wants(&self, request: Request) -> bool {
        match request {
            Request::SpiRx(n) => self.spi[n - 1].wants_read(),
            Request::SpiTx(n) => self.spi[n - 1].wants_write(),
            Request::UsartRx(n) => self.usart[n - 1].wants_read(),
            Request::UsartTx(n) => self.usart[n - 1].wants_write(),
            Request::I2cRx(n) => self.i2c[n - 1].wants_read(),
            Request::I2cTx(n) => self.i2c[n - 1].wants_write(),
            Request::TimerUpdate(n) => {
                TIMERS.iter().position(|&number| number == n).is_some_and(|n| self.timers[n].wants_dma())
            }
            Request::Adc(_) => self.adc.wants_read(),
        }
    }

    /// Moves a beat; returns the peripheral that it moved to or from.
    fn beat(&mut self, dma: usize, stream: usize, memory: &mut dyn Memory) -> Option<Unit> {
        let beat = self.dma[dma].take(stream);
        let Some((unit, offset)) = locate(beat.peripheral) else {
            self.fail(format!("DMA{} stream {stream} moves to or from {:#010x}", dma + 1, beat.peripheral));
            return None;
        };
        // Only the second controller's peripheral port reaches the bus of the ports.
        if dma == 0 && matches!(unit, Unit::Gpio(_)) {
            self.fail(format!("DMA1 stream {stream} does not reach {unit}"));
        }
        let mut word = [0; 4];
        let done = if beat.to_peripheral {
            memory.read(beat.memory, &mut word[..beat.bytes])
                && self.write_register(unit, offset, beat.bytes, u32::from_le_bytes(word)).is_some()
        } else {
            let value = self.read_register(unit, offset);
            word = value.unwrap_or(0).to_le_bytes();
            value.is_some() && memory.write(beat.memory, &word[..beat.bytes])
        };
        if !done {
            self.fail(format!("DMA{} cannot do {beat:x?}", dma + 1));
        }
        self.refresh(unit);
        self.refresh(Unit::Dma(dma));
        Some(unit)
    }
}
