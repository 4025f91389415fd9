//! The flight image on the emulator, in lock-step: this side of the pipe that `docs/emulator.md` describes.
//!
//! The emulator is spawned, never linked: its licence is not the workspace's. Both it and the image are built where they
//! are out of date.
use firmware::record::{Record, WORDS};
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Mutex, PoisonError};

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
    /// Frames that each speed controller has understood.
    pub understood: [u32; 4],
    /// The image's record of its last step, once it has made one; none if a step was being made when the period ended.
    pub record: Option<Record>,
    /// What it has logged.
    pub log: String,
}

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
    /// The stack is used up but for a few words.
    StackOverflow = 10,
}

/// Why the image does not run, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// Emulator or image cannot be built.
    #[error("`cargo {0}`: {1}")]
    Build(String, String),
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

/// Executable of the emulator and ELF of the image.
#[derive(Clone)]
struct Parts {
    emulator: PathBuf,
    image: PathBuf,
}

/// Builds them, once.
fn parts() -> Result<Parts, EmulatorError> {
    static PARTS: Mutex<Option<Parts>> = Mutex::new(None);
    let mut parts = PARTS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(parts) = parts.as_ref() {
        return Ok(parts.clone());
    }
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace.join("target"), PathBuf::from);
    cargo(&workspace, "build --quiet --package emulator --release")?;
    cargo(&workspace, "build --quiet --package firmware --profile image --target thumbv7em-none-eabihf")?;
    let built =
        Parts { emulator: target.join("release/emulator"), image: target.join("thumbv7em-none-eabihf/image/firmware") };
    Ok(parts.insert(built).clone())
}

fn cargo(workspace: &Path, arguments: &str) -> Result<(), EmulatorError> {
    let refused = |why: &dyn ToString| EmulatorError::Build(arguments.to_owned(), why.to_string());
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let status = Command::new(program).args(arguments.split(' ')).current_dir(workspace).status();
    let status = status.map_err(|error| refused(&error))?;
    if status.success() { Ok(()) } else { Err(refused(&status)) }
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

    /// Moves the body; holds.
    pub fn move_body(&mut self, motion: &Motion) {
        self.say(b'm', bytes_of(&[motion.force_m_s2, motion.rate_rad_s].concat()));
    }

    /// Sets the battery's voltage, V; holds.
    pub fn set_battery(&mut self, volts: f32) {
        self.say(b'b', bytes_of(&[volts]));
    }

    /// Lets the radio receiver send a frame with these channels, 172 to 1811.
    pub fn send_channels(&mut self, channels: [u16; 16]) {
        self.say(b'c', channels.into_iter().flat_map(u16::to_le_bytes));
    }

    /// Does something to the chip that no program should: see [`Mishap`].
    pub fn inflict(&mut self, mishap: Mishap) {
        self.say(b'f', [mishap as u8]);
    }

    /// Lets one period of the inertial unit pass. The first is the whole boot.
    ///
    /// # Errors
    /// If the image has done what the emulator does not model, with what it says of it; or the pipe breaks.
    pub fn period(&mut self) -> Result<Answer, EmulatorError> {
        self.say(b'n', []);
        self.input.write_all(&self.said)?;
        self.input.flush()?;
        self.said.clear();
        self.answer()
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
        let mut understood = [0; 4];
        for understood in &mut understood {
            *understood = u32::from_le_bytes(self.bytes()?);
        }
        let record = self.record()?;
        Ok(Answer { cycles, busy, latency_max, told, understood, record, log: self.text()? })
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

/// Numbers as the pipe carries them.
fn bytes_of(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

impl Drop for Emulator {
    fn drop(&mut self) {
        // It has nothing to save, and a flight that fails must not leave it running.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
