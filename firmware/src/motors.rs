//! Motors: what the step commands, to the speed controllers' lines.
//!
//! Invariants: with [`Command::Stop`] every line carries the stop value, or nothing; with [`Command::Bench`] those of motors
//! at 0 do.
use control_core::flight::Command;
use firmware::dshot;
use firmware::pulse::Pulse;

use crate::board::{MotorPins, PROTOCOL};

/// What the speed controllers are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(dead_code, reason = "a board uses one of them")]
pub(crate) enum Protocol {
    /// Digital frames, 300 kbit/s.
    DShot300,
    /// Digital frames, 600 kbit/s.
    DShot600,
    /// Pulses of 1 to 2 ms, which every speed controller takes.
    Pwm,
}

/// Pulses a second: every analogue speed controller takes them, and they leave room for [`Pulse::FULL`].
const PWM_HZ: u32 = 400;

impl Protocol {
    /// Periods a second of the timers: DShot's bits, or pulses.
    pub(crate) const fn timer_hz(self) -> u32 {
        match self {
            Self::DShot300 => 300_000,
            Self::DShot600 => 600_000,
            Self::Pwm => PWM_HZ,
        }
    }
}

/// The motor outputs, in airframe order.
pub(crate) struct Motors(MotorPins);

impl Motors {
    /// Connects the outputs, with every motor told to stand.
    pub(crate) fn new(mut pins: MotorPins) -> Self {
        if PROTOCOL == Protocol::Pwm {
            pins.set_pulses(pulses(Command::Stop, pins.counts()));
        }
        pins.enable();
        Self(pins)
    }

    /// Tells every motor what to do; with digital frames, returns when they are through, some 30 µs later.
    pub(crate) async fn write(&mut self, command: Command) {
        if PROTOCOL == Protocol::Pwm {
            self.0.set_pulses(pulses(command, self.0.counts()));
            return;
        }
        let values = match command {
            Command::Stop => [dshot::Value::STOP; 4],
            Command::Run(shares) => shares.map(dshot::Value::running),
            Command::Bench(shares) => {
                shares.map(|share| if share > 0.0 { dshot::Value::running(share) } else { dshot::Value::STOP })
            }
        };
        self.0.send(values).await;
    }
}

/// Pulse widths in counts of a timer that has `counts` in a period.
fn pulses(command: Command, counts: u32) -> [u32; 4] {
    let pulses = match command {
        Command::Stop => [Pulse::STOP; 4],
        Command::Run(shares) | Command::Bench(shares) => shares.map(Pulse::from_speed),
    };
    pulses.map(|pulse| u32::from(pulse.us()) * (counts * PWM_HZ / 1_000) / 1_000)
}
