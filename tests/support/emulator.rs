//! The flight image on the emulator, in lock-step: the other side of the pipe that `docs/emulator.md` describes.
//!
//! The emulator is spawned, never linked: its licence is not the workspace's.
use crate::root;
use firmware::record::{Record, WORDS};
use std::io::{self, BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::OnceLock;

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
}

/// A running image.
pub struct Emulator {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

/// Executable of the emulator and ELF of the image, built once.
fn built() -> &'static (PathBuf, PathBuf) {
    static BUILT: OnceLock<(PathBuf, PathBuf)> = OnceLock::new();
    BUILT.get_or_init(|| {
        let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
        cargo(&["build", "--package", "emulator", "--release"]);
        cargo(&["build", "--package", "firmware", "--profile", "image", "--target", "thumbv7em-none-eabihf"]);
        (target.join("release/emulator"), target.join("thumbv7em-none-eabihf/image/firmware"))
    })
}

fn cargo(arguments: &[&str]) {
    let status = Command::new(env!("CARGO")).args(arguments).current_dir(root()).status().expect("cargo starts");
    assert!(status.success(), "cargo {arguments:?}");
}

impl Emulator {
    /// Switches a board on.
    ///
    /// # Panics
    /// If the emulator or the image does not build or start.
    pub fn start() -> Self {
        let (emulator, image) = built();
        let mut child = Command::new(emulator)
            .arg(image)
            .arg("--pipe")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the emulator starts");
        let input = child.stdin.take().expect("piped");
        let output = BufReader::new(child.stdout.take().expect("piped"));
        Self { child, input, output }
    }

    /// Lets the radio receiver send a frame with these channels, 172 to 1811.
    ///
    /// # Panics
    /// If the pipe breaks.
    pub fn send_channels(&mut self, channels: [u16; 16]) {
        let mut message = vec![b'c'];
        message.extend(channels.into_iter().flat_map(u16::to_le_bytes));
        self.input.write_all(&message).expect("the emulator listens");
    }

    /// Does something to the chip that no program should: see [`Mishap`].
    ///
    /// # Panics
    /// If the pipe breaks.
    pub fn inflict(&mut self, mishap: Mishap) {
        self.input.write_all(&[b'f', mishap as u8]).expect("the emulator listens");
    }

    /// Moves the body and lets one period pass.
    ///
    /// # Panics
    /// If the image has done what the emulator does not model, with what it says of it.
    pub fn step(&mut self, motion: &Motion) -> Answer {
        let mut message = vec![b'm'];
        let numbers = motion.force_m_s2.into_iter().chain(motion.rate_rad_s);
        message.extend(numbers.flat_map(f32::to_le_bytes));
        message.push(b'n');
        self.input.write_all(&message).expect("the emulator listens");
        self.input.flush().expect("the emulator listens");
        self.answer().expect("the emulator answers")
    }

    fn answer(&mut self) -> io::Result<Answer> {
        let [kind] = self.bytes()?;
        assert_eq!(kind, b's', "the emulator has stopped: {}", self.text()?);
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
        let count = u32::from_le_bytes(self.bytes()?);
        assert_eq!(count as usize, 1 + WORDS, "a record is a sequence number and its words");
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

impl Drop for Emulator {
    fn drop(&mut self) {
        // It has nothing to save, and a test that fails must not leave it running.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
