//! The flight image on the emulator, in lock-step: this side of the pipe that `docs/emulator.md` describes.
//!
//! The emulator is spawned, never linked: its licence is not the workspace's. Both it and the image are built where they
//! are out of date.
use control_core::frames::{Attitude, Body, Vec3};
use control_core::geodesy::Geodetic;
use control_core::measurement::{Gnss, Vision};
use firmware::record::{Record, WORDS};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

mod kinds;
mod parts;
mod sources;

use parts::{Parts, parts};

pub use kinds::{Health, Line, Mishap, Part, Telemetry};

/// How many satellites a fix is said to be of.
const SATELLITES: u8 = 14;

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

    /// Puts an MPU-6000 in the place of the ICM-42688-P; before the first period.
    pub fn solder_mpu6000(&mut self) {
        self.say(b'i', [1]);
    }

    /// Switches the board on anew; its image takes its clock to have run for so many seconds.
    pub fn begin_after(&mut self, uptime_s: u32) {
        self.say(b'w', uptime_s.to_le_bytes());
    }

    /// Moves the body; holds.
    pub fn move_body(&mut self, motion: &Motion) {
        self.say(b'm', bytes_of(&[motion.force_m_s2, motion.rate_rad_s].concat()));
    }

    /// Sets how fast the rotors turn, rad/s; holds.
    pub fn turn_rotors(&mut self, rotor_rad_s: [f32; 4]) {
        self.say(b'r', bytes_of(&rotor_rad_s));
    }

    /// Sets how the speed controller of a motor, 0 to 3, answers; holds.
    pub fn set_telemetry(&mut self, motor: u8, telemetry: Telemetry) {
        self.say(b'q', [motor, telemetry as u8]);
    }

    /// Sets the battery's voltage, V; holds.
    pub fn set_battery(&mut self, volts: f32) {
        self.say(b'b', bytes_of(&[volts]));
    }

    /// Lets the radio receiver send a frame with these channels, 172 to 1811.
    pub fn send_channels(&mut self, channels: [u16; 16]) {
        self.say(b'c', channels.into_iter().flat_map(u16::to_le_bytes));
    }

    /// Sets the air at the barometer: static pressure, Pa, and temperature, °C; holds.
    pub fn set_air(&mut self, pressure_pa: f32, temperature_c: f32) {
        self.say(b'p', bytes_of(&[pressure_pa, temperature_c]));
    }

    /// Sets the magnetic field, µT; holds.
    pub fn set_field(&mut self, field_ut: Vec3<Body>) {
        self.say(b'g', bytes_of(&[field_ut.x, field_ut.y, field_ut.z]));
    }

    /// Lets the satellite receiver send a fix. Of `fix`, the position is left out: it is `place`.
    pub fn send_fix(&mut self, place: &Geodetic, fix: &Gnss) {
        let v = fix.velocity_m_s;
        let values = [place.altitude_m, v.x, v.y, v.z, fix.horizontal_m, fix.vertical_m, fix.speed_m_s];
        let mut numbers: Vec<u8> =
            [place.latitude_e7, place.longitude_e7].into_iter().flat_map(i32::to_le_bytes).collect();
        numbers.extend(bytes_of(&values));
        numbers.extend([if fix.fixed { 3 } else { 0 }, SATELLITES]);
        self.say(b'u', numbers);
    }

    /// Lets the vision computer send a pose that was true `age_us` ago.
    pub fn send_pose(&mut self, age_us: u32, pose: &Vision) {
        let (p, attitude) = (pose.position_m, quaternion(&pose.attitude));
        let mut numbers = age_us.to_le_bytes().to_vec();
        numbers.extend(bytes_of(&[p.x, p.y, p.z]));
        numbers.extend(bytes_of(&attitude));
        numbers.extend(bytes_of(&[pose.position_sigma_m, pose.attitude_sigma_rad]));
        self.say(b'v', numbers);
    }

    /// Sets how a part does; holds.
    pub fn set_health(&mut self, part: Part, health: Health) {
        self.say(b'd', [part as u8, health as u8]);
    }

    /// Lets bytes come over a line, whoever has sent them: up to 255.
    pub fn send_bytes(&mut self, line: Line, bytes: &[u8]) {
        let bytes = &bytes[..bytes.len().min(u8::MAX.into())];
        self.say(b't', [line as u8, bytes.len() as u8].into_iter().chain(bytes.iter().copied()));
    }

    /// Does something to the chip that no program should: see [`Mishap`].
    pub fn inflict(&mut self, mishap: Mishap) {
        self.say(b'f', [mishap as u8]);
    }

    /// Cuts power, for a moment, after so many words programmed and sectors erased; `within`: the next one is done in part.
    pub fn cut_power_at(&mut self, after: u32, within: bool) {
        self.say(b'k', after.to_le_bytes().into_iter().chain([within.into()]));
    }

    /// Fills flash as somebody may have left it.
    pub fn fill_flash(&mut self, address: u32, bytes: &[u8]) {
        let header = [address, bytes.len() as u32].into_iter().flat_map(u32::to_le_bytes);
        self.say(b'e', header.chain(bytes.iter().copied()));
    }

    /// Puts a card into its slot, whose content is this file, or pulls the one that is there.
    pub fn put_card(&mut self, file: Option<&Path>) {
        let path = file.unwrap_or(Path::new("")).to_string_lossy();
        let count = path.len() as u32;
        self.say(b'o', count.to_le_bytes().into_iter().chain(path.bytes()));
    }

    /// Sets how long the card takes to program a block, µs: as a rule, and once in `long_every` blocks.
    pub fn set_card_busy(&mut self, usual_us: u32, long_us: u32, long_every: u32) {
        self.say(b'j', [usual_us, long_us, long_every].into_iter().flat_map(u32::to_le_bytes));
    }

    /// Lets the station send these bytes, at most 255.
    pub fn send_station(&mut self, bytes: &[u8]) {
        self.say(b'l', [bytes.len() as u8].into_iter().chain(bytes.iter().copied()));
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

/// The unit quaternion w, x, y, z of an attitude.
fn quaternion(attitude: &Attitude) -> [f32; 4] {
    let rows = attitude.rows.map(|row| row.map(f64::from));
    let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    [q.w, q.i, q.j, q.k].map(|value| value as f32)
}

/// Numbers as the pipe carries them.
fn bytes_of(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
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
    /// # Errors
    /// As [`Emulator::start`].
    pub fn start(seconds: u32) -> Result<Self, EmulatorError> {
        let Parts { emulator, image } = parts()?;
        let mut command = Command::new(emulator);
        command.arg(image).args(["--station", "0", "--seconds", &seconds.to_string()]).stdout(Stdio::piped());
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
