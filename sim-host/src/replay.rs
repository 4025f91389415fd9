//! Replay: a board's flight log, decided once more by the host's build of the same core.
//!
//! ```text
//! log ─► blocks ─► steps ─► Twin: the same step, given the same ─► every command compared, bit by bit
//! ```
//!
//! The core remembers all since boot, so what can be compared ends where a step is missing: a block that could not be written in
//! time, or was damaged. What is on either side of a gap is read all the same, and who asks sees it.
use crate::chronicle::{Chronicle, Happening};
use crate::sortie::Decision;
use crate::through::Verdict;
use crate::through::twin::Twin;
use control_core::flight::{Flight, Unflyable};
use control_core::parameters::{Parameters, TABLE, index_of};
use firmware::flight_log::{
    BLOCK_BYTES, BlockError, COUNT_M_S2, COUNT_RAD_S, Fact, Facts, Kind, MEMORY, Opened, Resumed, Steps, open,
};
use firmware::record::{Record, WORDS};
use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Read};

mod starts;

pub use starts::{Start, starts};

/// Why a file cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] io::Error),
    /// Nothing was written yet.
    #[error("offset 0: no flight log: nothing was written into this file yet")]
    Empty,
    /// It is no flight log.
    #[error("offset 0: no flight log: must begin with a block of {BLOCK_BYTES} bytes that begins with \"QF\"")]
    Foreign,
    /// It is of another version.
    #[error("offset 2: version {0}: must be {version}", version = firmware::flight_log::VERSION)]
    Version(u8),
    /// What flew is not said, or cannot be read.
    #[error("offset {0}: the block that says what flew is damaged")]
    Preamble(u64),
    /// What flew is said, but not this.
    #[error("{0}: missing: every log says it before its first step")]
    Missing(String),
    /// It was made from other sources.
    #[error("{name}: {found}: must be {known}: the image ({image}) was built from other sources than this program")]
    Other {
        /// Of what the preamble says.
        name: String,
        /// What it says.
        found: String,
        /// What this program knows.
        known: String,
        /// The image that wrote the log.
        image: String,
    },
    /// It was flown with what cannot fly.
    #[error("{0}.{1} = {2}: cannot fly")]
    Unflyable(&'static str, &'static str, f32),
}

impl From<Unflyable> for ReplayError {
    fn from(Unflyable { name: [part, name], value }: Unflyable) -> Self {
        Self::Unflyable(part, name, value)
    }
}

/// What flew, as the log says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flown {
    /// Version and commit of the image.
    pub image: String,
    /// The board.
    pub board: String,
    /// What it was flown with.
    pub parameters: Parameters,
    /// What it went on from, if a reset in the air came before its first step.
    pub resumed: Option<Resumed>,
}

/// Steps that are not in the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The step before, 0 for none, and when it was, µs since boot.
    pub after: (u32, u64),
    /// The step after it.
    pub before: (u32, u64),
}

/// A part of the file that is no block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Where it begins.
    pub offset: u64,
    /// Bytes of it: fewer than a block's where the file ends within one.
    pub bytes: usize,
}

/// What a log says, and what the host says to it.
#[derive(Clone, Debug)]
pub struct Replay {
    /// What flew.
    pub flown: Flown,
    /// Steps in the log.
    pub steps: u64,
    /// Of the first and the last, µs since boot.
    pub span_us: Option<(u64, u64)>,
    /// Steps that are missing.
    pub gaps: Vec<Gap>,
    /// What could not be read.
    pub damage: Vec<Damage>,
    /// Whether the host decides the same, up to the first gap.
    pub verdict: Verdict,
    /// What happened, up to the first gap, in words.
    pub happenings: Vec<Happening>,
}

impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { after: (last, last_us), before: (next, next_us) } = *self;
        let [from_s, to_s] = [last_us, next_us].map(|time_us| time_us as f64 * 1e-6);
        let missing = next.saturating_sub(last).saturating_sub(1);
        write!(f, "{missing} steps are missing, from {from_s:.4} s to {to_s:.4} s since boot")
    }
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { offset, bytes } = self;
        write!(f, "offset {offset}: {bytes} bytes are no block: torn or damaged")
    }
}

/// Replays a log; `observe` sees every step, and the flight that has decided it, until the first gap.
///
/// # Errors
/// [`ReplayError`] if this is no log, or not of an image that this program can repeat. Damage after the preamble is none.
pub fn replay(mut log: impl Read, observe: &mut dyn FnMut(&Record, Option<&Flight>)) -> Result<Replay, ReplayError> {
    let mut said = Said::default();
    let mut told: Option<Told> = None;
    let (mut offset, mut due, mut damage) = (0, 0, Vec::new());
    loop {
        let mut bytes = [0; BLOCK_BYTES];
        let count = fill(&mut log, &mut bytes)?;
        if count == 0 {
            break;
        }
        let opened = if count < BLOCK_BYTES { Err(BlockError::Checksum) } else { open(&bytes) };
        match (opened, &mut told) {
            (Ok(Opened { kind: Kind::Preamble, number, content }), None) if number == due => {
                said.hear(content).ok_or(ReplayError::Preamble(offset))?;
            }
            (Ok(Opened { kind: Kind::Steps, content, .. }), slot) => {
                let told = match slot {
                    Some(told) => told,
                    None => slot.insert(Told::new(said.flown()?)?),
                };
                // A step that breaks off is missing, and a gap.
                Steps::new(content).map_while(Result::ok).for_each(|record| told.step(&record, observe));
            }
            (Err(BlockError::Foreign), None) if offset == 0 => return Err(ReplayError::Foreign),
            (Err(BlockError::Version(version)), None) => return Err(ReplayError::Version(version)),
            (_, None) => return Err(ReplayError::Preamble(offset)),
            (_, Some(_)) => damage.push(Damage { offset, bytes: count }),
        }
        due += 1;
        offset += count as u64;
    }
    let told = told.map_or_else(|| Told::new(said.flown()?), Ok)?;
    Ok(told.finish(damage))
}

/// Reads until `bytes` are full or the file ends; returns how many were read.
fn fill(log: &mut impl Read, bytes: &mut [u8]) -> io::Result<usize> {
    let mut count = 0;
    while count < bytes.len() {
        match log.read(&mut bytes[count..])? {
            0 => break,
            read => count += read,
        }
    }
    Ok(count)
}

/// What the preamble has said so far.
#[derive(Default)]
struct Said {
    texts: BTreeMap<String, String>,
    words: BTreeMap<String, u32>,
    memory: Vec<u32>,
}

impl Said {
    fn hear(&mut self, content: &[u8]) -> Option<()> {
        for fact in Facts::new(content) {
            let (name, fact) = fact.ok()?;
            match fact {
                Fact::Text(text) => drop(self.texts.insert(name.to_owned(), text.to_owned())),
                Fact::Word(word) if name == MEMORY => self.memory.push(word),
                Fact::Word(word) => drop(self.words.insert(name.to_owned(), word)),
            }
        }
        Some(())
    }

    fn text(&self, name: &str) -> Result<String, ReplayError> {
        self.texts.get(name).cloned().ok_or_else(|| ReplayError::Missing(name.to_owned()))
    }

    fn word(&self, name: &str) -> Result<u32, ReplayError> {
        self.words.get(name).copied().ok_or_else(|| ReplayError::Missing(name.to_owned()))
    }

    fn flown(&self) -> Result<Flown, ReplayError> {
        let image = format!("{}, commit {}", self.text("image")?, self.text("commit")?);
        let other = |name: &str, found: String, known: String| {
            let (name, image) = (name.to_owned(), image.clone());
            ReplayError::Other { name, found, known, image }
        };
        let words = self.word("record_words")?;
        if words != WORDS as u32 {
            return Err(other("record_words", words.to_string(), WORDS.to_string()));
        }
        for (name, known) in [("rate_rad_s", COUNT_RAD_S), ("force_m_s2", COUNT_M_S2)] {
            let found = f32::from_bits(self.word(name)?);
            if found.to_bits() != known.to_bits() {
                return Err(other(name, found.to_string(), known.to_string()));
            }
        }
        let of_a_parameter = |name: &str| name.starts_with(|first: char| first.is_ascii_uppercase());
        if let Some(name) = self.words.keys().find(|name| of_a_parameter(name) && index_of(name).is_none()) {
            return Err(other(name, "set".to_owned(), "a parameter that is known here".to_owned()));
        }
        let mut parameters = Parameters::default();
        for known in &TABLE {
            let value = f32::from_bits(self.word(known.name)?);
            let refused = |_| other(known.name, value.to_string(), known.to_string());
            parameters.set(known.name, value).map_err(refused)?;
        }
        let resumed = Resumed::from_words(&self.memory);
        if resumed.is_none() && !self.memory.is_empty() {
            let [found, known] = [self.memory.len(), Resumed::WORDS].map(|count| format!("{count} words"));
            return Err(other(MEMORY, found, known));
        }
        Ok(Flown { image, board: self.text("board")?, parameters, resumed })
    }
}

/// What the steps have told so far.
struct Told {
    flown: Flown,
    twin: Twin,
    chronicle: Chronicle,
    steps: u64,
    last: (u32, u64),
    span_us: Option<(u64, u64)>,
    gaps: Vec<Gap>,
}

impl Told {
    fn new(flown: Flown) -> Result<Self, ReplayError> {
        let mut twin = Twin::new(&flown.parameters)?;
        if flown.resumed.as_ref().is_some_and(|resumed| !twin.resume(resumed)) {
            let (name, image) = (MEMORY.to_owned(), flown.image);
            let [found, known] = ["what no flight goes on from", "what one does"].map(str::to_owned);
            return Err(ReplayError::Other { name, found, known, image });
        }
        let (chronicle, gaps) = (Chronicle::default(), Vec::new());
        Ok(Self { flown, twin, chronicle, steps: 0, last: (0, 0), span_us: None, gaps })
    }

    fn step(&mut self, record: &Record, observe: &mut dyn FnMut(&Record, Option<&Flight>)) {
        let now = (record.step, record.time_us);
        if record.step != self.last.0.wrapping_add(1) {
            self.gaps.push(Gap { after: self.last, before: now });
        }
        self.last = now;
        self.steps += 1;
        self.span_us = Some((self.span_us.map_or(record.time_us, |(first_us, _)| first_us), record.time_us));
        self.twin.follow(record);
        let followed = self.twin.last().is_some_and(|last| last.step == record.step);
        let flight = Some(self.twin.flight()).filter(|_| followed && self.gaps.is_empty());
        if let Some(flight) = flight {
            let decision = flight.helm().decision().map(|command| Decision { command, state: flight.helm().state() });
            let t_s = record.time_us as f64 * 1e-6;
            self.chronicle.look(t_s, Some(&flight.telemetry(record.time_us)), decision.as_ref());
        }
        observe(record, flight);
    }

    fn finish(self, damage: Vec<Damage>) -> Replay {
        let Self { flown, twin, chronicle, steps, span_us, gaps, .. } = self;
        let happenings = chronicle.happenings().to_vec();
        Replay { flown, steps, span_us, gaps, damage, verdict: twin.finish(), happenings }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::through::Parting;
    use control_core::flight::{Arrived, Command};
    use control_core::frames::{Attitude, Vec3};
    use control_core::measurement::{Imu, Measurements, Stamped, Vision};
    use control_core::modes::Mode;
    use control_core::pilot::{PilotInput, Sticks};
    use firmware::flight_log::{Packer, Preamble};

    const SECONDS: u32 = 6;
    const SAMPLE_HZ: u32 = 2_000;

    /// A machine that lies on the ground, seen by cameras, armed after 5 s; every step of it, as the image would log it.
    fn flown(parameters: &Parameters) -> Vec<Record> {
        let mut flight = firmware::flight::boot(parameters).expect("it flies");
        (1..=SECONDS * SAMPLE_HZ)
            .map(|step| {
                let time_us = 120_000 + 500 * u64::from(step);
                let stamped = |value| Some(Stamped { time_us: time_us - 7, value });
                let count = |n: u32| f32::from((step * n % 13) as i16 - 6);
                let rate_rad_s = Vec3::new(count(3), count(5), count(7)) * COUNT_RAD_S;
                let force = Vec3::new(count(11), count(2), -8_192.0 + count(3)) * COUNT_M_S2;
                let vision = Vision {
                    position_m: Vec3::new(0.0, 0.1, -0.05),
                    attitude: Attitude::level(),
                    position_sigma_m: 0.002,
                    attitude_sigma_rad: 0.004,
                };
                let sticks = Sticks { throttle: 0.0, ..Sticks::NEUTRAL };
                let pilot = PilotInput { sticks, arm: step > 5 * SAMPLE_HZ, mode: Mode::Angle };
                let arrived = Arrived {
                    measurements: Measurements {
                        imu: Some(Stamped { time_us, value: Imu { rate_rad_s, specific_force_m_s2: force } }),
                        vision: stamped(vision)
                            .filter(|_| step % 20 == 3)
                            .map(|Stamped { time_us, .. }| Stamped { time_us, value: vision }),
                        battery_v: (step % 200 == 9).then_some(Stamped { time_us: time_us - 90, value: 16.1 }),
                        battery_a: (step % 200 == 9).then_some(Stamped { time_us: time_us - 90, value: 4.2 }),
                        ..Measurements::default()
                    },
                    pilot: (step % 40 == 1).then_some(Stamped { time_us: time_us + 21, value: pilot }),
                    self_test_passed: true,
                    parameters_valid: true,
                    ..Arrived::default()
                };
                Record { step, time_us, arrived, command: flight.step(time_us, &arrived) }
            })
            .collect()
    }

    /// The file that the image makes of it; blocks of steps for which `lost` is true are not in it.
    fn file(parameters: &Parameters, records: &[Record], lost: impl Fn(usize) -> bool) -> Vec<u8> {
        written(parameters, None, records, lost)
    }

    fn written(
        parameters: &Parameters,
        resumed: Option<&Resumed>,
        records: &[Record],
        lost: impl Fn(usize) -> bool,
    ) -> Vec<u8> {
        let preamble = Preamble { image: ["0.1.0", "c0ffee"], board: "a board", parameters, resumed };
        let mut blocks: Vec<_> = preamble.blocks().collect();
        let mut packer = Packer::new();
        let mut steps = Vec::new();
        for record in records {
            packer.note(&record.to_words(), |full| steps.push(full.clone()));
        }
        steps.push(packer.finish());
        blocks.extend(steps.into_iter().enumerate().filter(|(n, _)| !lost(*n)).map(|(_, block)| block));
        (0..).zip(&blocks).flat_map(|(number, block)| block.sealed(number)).collect()
    }

    fn read(file: &[u8]) -> Result<Replay, ReplayError> {
        replay(file, &mut |_, _| {})
    }

    #[test]
    fn a_flight_that_was_logged_is_decided_again_to_the_bit() {
        let mut parameters = Parameters::default();
        parameters.set("GAIN_TILT", 1.1).expect("in its range");
        let records = flown(&parameters);
        assert!(records.iter().any(|record| matches!(record.command, Command::Run(_))), "it armed");
        let mut seen = Vec::new();
        let told = replay(&*file(&parameters, &records, |_| false), &mut |record, flight| {
            assert!(flight.is_some());
            seen.push(*record);
        })
        .expect("a log");
        assert_eq!(seen, records);
        let Replay { flown, steps, span_us, gaps, damage, verdict, happenings } = told;
        assert_eq!((flown.board.as_str(), flown.image.as_str()), ("a board", "0.1.0, commit c0ffee"));
        assert_eq!(flown.parameters, parameters);
        assert_eq!((steps, gaps, damage), (u64::from(SECONDS * SAMPLE_HZ), vec![], vec![]));
        assert_eq!(span_us, Some((120_500, 6_120_000)));
        assert_eq!((verdict.parting, verdict.commands), (None, SECONDS * SAMPLE_HZ));
        assert!(verdict.seconds.len() == 6 && verdict.seconds.iter().all(|[image, host]| image == host));
        assert!(happenings.iter().any(|Happening { what, .. }| what == "armed"), "{happenings:?}");
    }

    #[test]
    fn one_bit_of_one_command_is_found_and_so_is_another_pilot() {
        let parameters = Parameters::default();
        let mut records = flown(&parameters);
        let at = records.len() - 500;
        let Command::Run(shares) = &mut records[at].command else { panic!("it is armed") };
        shares[2] = shares[2].next_up();
        let told = read(&file(&parameters, &records, |_| false)).expect("a log");
        let parting = told.verdict.parting.expect("they part");
        assert!(matches!(parting, Parting::Command { step, .. } if step as usize == at + 1), "{parting}");
        assert!(parting.to_string().contains("rotor 3: the image 0."), "{parting}");

        let mut records = flown(&parameters);
        let armed = records.iter_mut().find_map(|record| record.arrived.pilot.as_mut().filter(|pilot| pilot.value.arm));
        armed.expect("the switch went on").value.arm = false;
        let told = read(&file(&parameters, &records, |_| false)).expect("a log");
        let parting = told.verdict.parting.expect("they part");
        assert!(matches!(parting, Parting::Command { step, .. } if step > 5 * SAMPLE_HZ), "{parting}");
    }

    #[test]
    fn what_is_missing_is_told_and_ends_the_comparison() {
        let parameters = Parameters::default();
        let records = flown(&parameters);
        let whole = file(&parameters, &records, |_| false);
        let lost = read(&file(&parameters, &records, |n| (300..303).contains(&n))).expect("a log");
        let mut damaged = whole.clone();
        damaged[512 * 300 + 77] ^= 4;
        let damaged = read(&damaged).expect("a log");
        let torn = read(&whole[..512 * 500 + 100]).expect("a log");
        for (why, told, gaps, damage) in [
            ("blocks that were not written", &lost, 1, vec![]),
            ("a damaged block", &damaged, 1, vec![Damage { offset: 512 * 300, bytes: 512 }]),
            ("a torn file", &torn, 0, vec![Damage { offset: 512 * 500, bytes: 100 }]),
        ] {
            assert_eq!((told.gaps.len(), &told.damage), (gaps, &damage), "{why}");
            assert!(!matches!(told.verdict.parting, Some(Parting::Command { .. })), "{why}");
            let compared = told.gaps.first().map_or(told.steps, |gap| gap.after.0.into());
            assert_eq!(u64::from(told.verdict.commands), compared, "{why}");
        }
        let [gap] = lost.gaps[..] else { panic!("{:?}", lost.gaps) };
        assert_eq!(lost.steps + u64::from(gap.before.0 - gap.after.0 - 1), records.len() as u64);
    }

    #[test]
    fn a_flight_that_went_on_from_what_cannot_be_is_refused() {
        let parameters = Parameters::default();
        let resumed = Resumed { at_us: 7, memory: [3; control_core::restart::WORDS] };
        let error = read(&written(&parameters, Some(&resumed), &[], |_| false)).expect_err("refused").to_string();
        assert!(error.starts_with("memory: what no flight goes on from: must be what one does"), "{error}");
        let mut said = Said::default();
        said.hear(b"\x06memory\x01abcd").expect("a fact");
        assert_eq!(said.memory, [u32::from_le_bytes(*b"abcd")]);
    }

    #[test]
    fn what_is_no_log_of_this_core_is_refused_by_offset_and_name() {
        let parameters = Parameters::default();
        let good = file(&parameters, &[], |_| false);
        let said = |bytes: &[u8]| read(bytes).expect_err("refused").to_string();
        assert!(said(b"t_s,step\n").starts_with("offset 0: the block"), "{}", said(b"t_s,step\n"));
        assert!(said(&[b'x'; 512]).contains("offset 0: no flight log: must begin"));
        assert_eq!(said(&[]), "image: missing: every log says it before its first step");
        let mut newer = good.clone();
        newer[2] = 9;
        assert_eq!(said(&newer), "offset 2: version 9: must be 2");
        let mut torn = good.clone();
        torn[600] ^= 1;
        assert_eq!(said(&torn), "offset 512: the block that says what flew is damaged");
        let mut known = Said::default();
        known.texts = ["image", "commit", "board"].map(|name| (name.to_owned(), "x".to_owned())).into();
        known.words = parameters.iter().map(|(known, value)| (known.name.to_owned(), value.to_bits())).collect();
        known.words.extend([
            ("record_words".to_owned(), WORDS as u32),
            ("rate_rad_s".to_owned(), COUNT_RAD_S.to_bits()),
            ("force_m_s2".to_owned(), COUNT_M_S2.to_bits()),
        ]);
        assert_eq!(known.flown().expect("all is said").parameters, parameters);
        for (name, bits, says) in [
            ("record_words", 7, "record_words: 7: must be "),
            ("FS_LINK_S", 1e3_f32.to_bits(), "FS_LINK_S: 1000: must be from 0.1 to 10 s: the image (x, commit x) was"),
            ("FS_LINKS", 0, "FS_LINKS: set: must be a parameter that is known here"),
        ] {
            let before = known.words.insert(name.to_owned(), bits);
            let error = known.flown().expect_err(name).to_string();
            assert!(error.starts_with(says), "{error}");
            match before {
                Some(before) => known.words.insert(name.to_owned(), before),
                None => known.words.remove(name),
            };
        }
    }
}
