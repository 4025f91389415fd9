//! Motors: what the step commands, to the speed controllers' lines.
//!
//! Where a port can be listened to, speed controllers are asked how fast their rotors turn (`firmware::erpm`).
//!
//! Invariants: with [`Command::Stop`] every line carries the stop value, or nothing; with [`Command::Bench`] those of motors
//! at 0 do.
use control_core::flight::Command;
use control_core::measurement::Stamped;
use control_core::parameters::{Parameter, Parameters};
use embassy_futures::join::join;
use firmware::dshot::{self, Dialogue};
use firmware::erpm::{Heard, LISTEN_US, MOTORS, Tachometer, answers};
use firmware::pulse::Pulse;

use crate::board::{self, MotorEar, MotorPins};
use crate::tasks::now_us;

/// What the speed controllers are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Protocol {
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
    fn of(parameters: &Parameters) -> Self {
        match parameters[Parameter::MotorProtocol] {
            600.0 => Self::DShot600,
            300.0 => Self::DShot300,
            _ => Self::Pwm,
        }
    }

    /// Periods a second of the timers: DShot's bits, or pulses.
    const fn timer_hz(self) -> u32 {
        match self {
            Self::DShot300 => 300_000,
            Self::DShot600 => 600_000,
            Self::Pwm => PWM_HZ,
        }
    }

    /// Time that digital frames take at least once they are given to their timers, µs.
    const fn frame_us(self) -> u64 {
        // One bit's time passes before the first.
        17 * 1_000_000 / self.timer_hz() as u64
    }
}

/// The motor outputs, in airframe order.
pub(crate) struct Motors {
    pins: MotorPins,
    protocol: Protocol,
    /// What listens to speed controllers, if they are asked.
    ear: Option<MotorEar>,
    tachometer: Tachometer,
    /// When the frames were sent whose answers are being heard, or were.
    asked_us: u64,
    rotor_rad_s: Option<Stamped<[f32; MOTORS]>>,
}

impl Motors {
    /// Connects the outputs, with every motor told to stand. Until their first frame or pulse begins, lines that are not answered stay low.
    ///
    /// - `ear`: what listens, if anything can; it does so if the parameters say so.
    /// - `resumed`: in the air no pulse tells a motor to stand.
    pub(crate) fn new(mut pins: MotorPins, ear: Option<MotorEar>, parameters: &Parameters, resumed: bool) -> Self {
        let protocol = Protocol::of(parameters);
        let asks = protocol != Protocol::Pwm && parameters[Parameter::DshotBidirectional] >= 0.5;
        let mut ear = ear.filter(|_| asks);
        pins.set_rate(protocol.timer_hz());
        if protocol == Protocol::Pwm && !resumed {
            pins.set_pulses(pulses(Command::Stop, pins.counts()));
        }
        if let Some(ear) = &mut ear {
            ear.prepare(protocol.timer_hz());
        }
        pins.enable(dialogue(ear.as_ref()));
        let tachometer = Tachometer::new(parameters[Parameter::MotorPoles]);
        Self { pins, protocol, ear, tachometer, asked_us: 0, rotor_rad_s: None }
    }

    /// Tells every motor what to do; with digital frames, returns when they are through, some 30 or 60 µs later.
    /// Pulses begin when the one before has had its time.
    ///
    /// What speed controllers have answered to the frames before is taken apart while these are sent: it delays nothing.
    pub(crate) async fn write(&mut self, command: Command) {
        let Self { pins, ear, tachometer, .. } = self;
        if self.protocol == Protocol::Pwm {
            pins.set_pulses(pulses(command, pins.counts()));
            return;
        }
        let values = each(command, dshot::Value::STOP, dshot::Value::running);
        let dialogue = dialogue(ear.as_ref());
        let heard = ear.as_mut().and_then(|ear| ear.stop().then(|| ear.pins()));
        let (before_us, now_us, frame_us) = (self.asked_us, now_us(), self.protocol.frame_us());
        let listen = async {
            let answers = heard.map(|pins| answers(board::heard(), pins));
            if let Some(ear) = ear.as_mut() {
                ear.listen(now_us + frame_us + LISTEN_US);
            }
            let rotor_rad_s = tachometer.hear(answers?, before_us)?;
            Some(Stamped { time_us: before_us, value: rotor_rad_s })
        };
        ((), self.rotor_rad_s) = join(pins.send(values, dialogue), listen).await;
        self.asked_us = now_us;
        if let Some(ear) = ear {
            ear.open();
        }
    }

    /// The rotors' speeds, rad/s, if any was told since the last call.
    pub(crate) fn take_speeds(&mut self) -> Option<Stamped<[f32; MOTORS]>> {
        self.rotor_rad_s.take()
    }

    /// How many frames each speed controller has answered since the last call, if they are asked.
    pub(crate) fn take_heard(&mut self) -> Option<[Heard; MOTORS]> {
        self.ear.as_ref().map(|_| self.tachometer.take())
    }
}

fn dialogue(ear: Option<&MotorEar>) -> Dialogue {
    if ear.is_some() { Dialogue::Answered } else { Dialogue::OneWay }
}

/// What each motor is told.
fn each<T: Copy>(command: Command, stop: T, running: impl Fn(f32) -> T) -> [T; 4] {
    match command {
        Command::Stop => [stop; 4],
        Command::Run(shares) => shares.map(running),
        Command::Bench(shares) => shares.map(|share| if share > 0.0 { running(share) } else { stop }),
    }
}

/// Pulse widths in counts of a timer that has `counts` in a period.
fn pulses(command: Command, counts: u32) -> [u32; 4] {
    each(command, Pulse::STOP, Pulse::running).map(|pulse| u32::from(pulse.us()) * (counts * PWM_HZ / 1_000) / 1_000)
}
