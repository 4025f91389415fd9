//! The flight image on the emulator, in lock-step: this side of the pipe that `docs/emulator.md` describes.
//!
//! The emulator is spawned, never linked: its licence is not the workspace's. Both it and the image are built where they
//! are out of date.
use firmware::record::{Record, WORDS};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

mod kinds;
mod parts;
mod said;
mod sources;
mod store;

use parts::{Parts, parts};

pub use kinds::{Health, Line, Mishap, Part, Protocol, Telemetry};
pub use store::{SECTOR_BYTES, Store};

/// What moves the body: specific force, m/s², and rate, rad/s, forward, right, down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Specific force, m/s².
    pub force_m_s2: [f32; 3],
    /// Rate, rad/s.
    pub rate_rad_s: [f32; 3],
}

/// What the emulator answers after a period.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Core cycles since reset.
    pub cycles: u64,
    /// Of these, how many the core was awake.
    pub busy: u64,
    /// Longest time from an inertial sample to a motor frame through after it, core cycles.
    pub latency_max: u64,
    /// What each motor was told last, if anything.
    pub told: [Option<u16>; 4],
    /// What carried it.
    pub protocol: [Option<Protocol>; 4],
    /// Frames that each speed controller has understood.
    pub understood: [u32; 4],
    /// The image's record of its last step, or of the oldest that was not in an answer yet; none if there is no such, and one is being written.
    pub record: Option<Record>,
    /// What it has logged.
    pub log: String,
}

impl Answer {
    /// What each motor was told last, as a share of its fastest speed; 0 to stand.
    pub fn speeds(&self) -> [f64; 4] {
        let speed = |n: usize| Some(self.protocol[n]?.speed(self.told[n]?));
        std::array::from_fn(|n| speed(n).unwrap_or(0.0))
    }
}

/// What the image has taken of the chip.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Of the stack, and how large it is, bytes.
    pub stack_bytes: (u32, u32),
    /// Each task, and the longest that it ran without a pause, core cycles; interrupts are counted in, tasks that preempt it are not.
    pub tasks: Vec<(String, u64)>,
}

/// Why the image does not run, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// Emulator or image cannot be built.
    #[error("`cargo {0}`: {1}")]
    Build(String, String),
    /// The sources that the image would be built of cannot be read.
    #[error("the sources of the image: {0}")]
    Sources(io::Error),
    /// They are not those that this `sim-host` was built of.
    #[error(
        "`control-core` or `firmware` has changed since sim-host was built, which would part from the image: `cargo build --release -p sim-host`"
    )]
    Stale,
    /// The emulator does not start, or has gone.
    #[error("the pipe to the emulator: {0}")]
    Pipe(#[from] io::Error),
    /// The image has done what the emulator does not model.
    #[error("the emulator has stopped: {0}")]
    Stopped(String),
}

/// A running image.
pub struct Emulator {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    /// What was said since the last period.
    said: Vec<u8>,
}

impl Emulator {
    /// Switches a board on.
    ///
    /// # Errors
    /// If the emulator or the image does not build or start.
    pub fn start() -> Result<Self, EmulatorError> {
        let Parts { emulator, image } = parts()?;
        let mut child =
            Command::new(emulator).arg(image).arg("--pipe").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let missing = || io::Error::other("no pipe");
        let input = child.stdin.take().ok_or_else(missing)?;
        let output = BufReader::new(child.stdout.take().ok_or_else(missing)?);
        Ok(Self { child, input, output, said: Vec::new() })
    }

    /// Says something: its kind, and its numbers as bytes.
    fn say(&mut self, kind: u8, numbers: impl IntoIterator<Item = u8>) {
        self.said.push(kind);
        self.said.extend(numbers);
    }

    /// How often power has been off, and what the station has heard since it last asked.
    ///
    /// # Errors
    /// As [`Self::period`].
    pub fn station_heard(&mut self) -> Result<(u32, Vec<u8>), EmulatorError> {
        self.say(b'h', []);
        self.send()?;
        if self.bytes()? != *b"h" {
            return Err(EmulatorError::Stopped(self.text()?));
        }
        let power_cuts = u32::from_le_bytes(self.bytes()?);
        let mut heard = vec![0; u32::from_le_bytes(self.bytes()?) as usize];
        self.output.read_exact(&mut heard)?;
        Ok((power_cuts, heard))
    }

    /// Whether the buzzer sounds.
    ///
    /// # Errors
    /// As [`Self::period`].
    pub fn buzzer_sounds(&mut self) -> Result<bool, EmulatorError> {
        self.say(b'z', []);
        self.send()?;
        match self.bytes()? {
            [b'z', sounds] => Ok(sounds != 0),
            _ => Err(EmulatorError::Pipe(io::Error::other("no answer of the buzzer"))),
        }
    }

    /// What stack and tasks have taken since the board was switched on.
    ///
    /// # Errors
    /// As [`Self::period`].
    pub fn taken(&mut self) -> Result<Taken, EmulatorError> {
        self.say(b'a', []);
        self.send()?;
        if self.bytes()? != *b"a" {
            return Err(EmulatorError::Stopped(self.text()?));
        }
        let (bytes, used) = (u32::from_le_bytes(self.bytes()?), u32::from_le_bytes(self.bytes()?));
        let mut tasks = Vec::new();
        for _ in 0..u32::from_le_bytes(self.bytes()?) {
            tasks.push((self.text()?, u64::from_le_bytes(self.bytes()?)));
        }
        Ok(Taken { stack_bytes: (used, bytes), tasks })
    }

    /// Lets one period of the inertial unit pass. The first is the whole boot.
    ///
    /// # Errors
    /// If the image has done what the emulator does not model, with what it says of it; or the pipe breaks.
    pub fn period(&mut self) -> Result<Answer, EmulatorError> {
        self.say(b'n', []);
        self.send()?;
        self.answer()
    }

    fn send(&mut self) -> io::Result<()> {
        self.input.write_all(&self.said)?;
        self.said.clear();
        self.input.flush()
    }

    fn answer(&mut self) -> Result<Answer, EmulatorError> {
        if self.bytes()? != *b"s" {
            return Err(EmulatorError::Stopped(self.text()?));
        }
        let (cycles, busy) = (u64::from_le_bytes(self.bytes()?), u64::from_le_bytes(self.bytes()?));
        let latency_max = u64::from_le_bytes(self.bytes()?);
        let mut told = [None; 4];
        for told in &mut told {
            *told = Some(u16::from_le_bytes(self.bytes()?)).filter(|&value| value != u16::MAX);
        }
        let protocol = self.bytes()?.map(Protocol::numbered);
        let mut understood = [0; 4];
        for understood in &mut understood {
            *understood = u32::from_le_bytes(self.bytes()?);
        }
        let record = self.record()?;
        Ok(Answer { cycles, busy, latency_max, told, protocol, understood, record, log: self.text()? })
    }

    fn record(&mut self) -> io::Result<Option<Record>> {
        let count = u32::from_le_bytes(self.bytes()?) as usize;
        if count != 1 + WORDS {
            return Err(io::Error::other(format!("a record of {count} words, where it has {}", 1 + WORDS)));
        }
        let sequence = u32::from_le_bytes(self.bytes()?);
        let mut words = [0; WORDS];
        for word in &mut words {
            *word = u32::from_le_bytes(self.bytes()?);
        }
        // Odd while it is being written.
        Ok((sequence > 0 && sequence.is_multiple_of(2)).then(|| Record::from_words(&words)))
    }

    fn bytes<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        self.output.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    fn text(&mut self) -> io::Result<String> {
        let length = u32::from_le_bytes(self.bytes()?);
        let mut text = vec![0; length as usize];
        self.output.read_exact(&mut text)?;
        String::from_utf8(text).map_err(io::Error::other)
    }
}

/// A running image whose station's line is served at a port of this computer, as fast as time passes.
pub struct Served {
    child: Child,
    /// `tcp:HOST:PORT`.
    pub line: String,
    /// Nobody reads the log, but it must not break.
    _log: BufReader<ChildStdout>,
}

impl Served {
    /// Switches a board on, for so many seconds.
    ///
    /// - `log_flash`: what is in the log flash that it has in the place of its slot, if it has one.
    ///
    /// # Errors
    /// As [`Emulator::start`].
    pub fn start(seconds: u32, log_flash: Option<&Path>) -> Result<Self, EmulatorError> {
        let Parts { emulator, image } = parts()?;
        let mut command = Command::new(emulator);
        command.arg(image).args(["--station", "0", "--seconds", &seconds.to_string()]).stdout(Stdio::piped());
        if let Some(file) = log_flash {
            command.arg("--log-flash").arg(file);
        }
        let mut child = command.spawn()?;
        let mut log = BufReader::new(child.stdout.take().ok_or_else(|| io::Error::other("no pipe"))?);
        let mut first = String::new();
        log.read_line(&mut first)?;
        let line = first.trim_end().rsplit(' ').next().unwrap_or_default().to_owned();
        Ok(Self { child, line, _log: log })
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        // As below.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        // It has nothing to save, and a flight that fails must not leave it running.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
