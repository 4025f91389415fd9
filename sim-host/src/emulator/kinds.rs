//! What can befall the emulated board and its parts, as the emulator's end of the pipe numbers it.
/// What may befall the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mishap {
    /// The core goes where there is no code.
    HardFault = 0,
    /// The program hangs where it is, all interrupts masked.
    Hang = 1,
    /// The inertial unit's data-ready line breaks.
    NoDataReady = 2,
    /// What runs below all interrupts hangs.
    HangBelow = 3,
    /// The program panics.
    Panic = 4,
    /// The supply drops for a moment, not so far that RAM forgets.
    BrownOut = 5,
    /// The inertial unit's data line stays low.
    AllZeros = 6,
    /// The inertial unit's data line stays high.
    AllOnes = 7,
    /// The inertial unit answers anything.
    Garbage = 8,
    /// Power is off for a moment.
    PowerCut = 9,
    /// The stack is used up but for a few words.
    StackOverflow = 10,
    /// The program panics as the hardware layer does, by `defmt`.
    DefmtPanic = 11,
    /// The satellite receiver refuses the next three messages that ask for more than a speed.
    GnssRefuses = 12,
    /// Each of the battery's converter's next twenty conversions never ends.
    ConverterHangs = 13,
}

/// A part on the slow sensors' bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The barometer.
    Barometer = 0,
    /// The magnetometer.
    Magnetometer = 1,
}

/// How a part does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// It does not answer.
    Silent = 0,
    /// It works.
    Well = 1,
    /// It holds the clock line, and so the bus.
    HoldsBus = 2,
}

/// How a speed controller answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Telemetry {
    /// Never.
    Silent = 0,
    /// As it should.
    Well = 1,
    /// With a bit turned.
    Garbled = 2,
}

/// A line over which bytes come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// The radio receiver's.
    Radio = 0,
    /// The satellite receiver's.
    Gnss = 1,
    /// The vision computer's.
    Vision = 2,
}

/// What carries commands to a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Frames at 300 kbit/s.
    DShot300,
    /// Frames at 600 kbit/s.
    DShot600,
    /// Pulses of 1 to 2 ms.
    Pwm,
}

impl Protocol {
    /// By its number in the pipe.
    pub(super) fn numbered(number: u8) -> Option<Self> {
        [None, Some(Self::DShot300), Some(Self::DShot600), Some(Self::Pwm)].get(usize::from(number)).copied().flatten()
    }

    /// Share of its fastest speed that a motor is told by a number: a frame's value, or the microseconds of a pulse.
    pub fn speed(self, told: u16) -> f64 {
        let (told, [slowest, fastest]) =
            (f64::from(told), if self == Self::Pwm { [1_070.0, 2e3] } else { [48.0, 2_047.0] });
        ((told - slowest) / (fastest - slowest)).max(0.0)
    }
}
