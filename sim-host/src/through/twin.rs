//! The image's twin: the host's build of what the image flies, given step by step what the image was given.
//!
//! The samples are those that the image has decoded of its parts' registers, from its record of the step. Every command is
//! compared; the hash of all so far is kept each second, as the image logs it.
use crate::reference::Target;
use crate::sortie::Decision;
use control_core::estimate::Estimate;
use control_core::estimation::EstimatorTelemetry;
use control_core::flight::{Command, Flight, Unflyable};
use control_core::measurement::Measurements;
use control_core::parameters::Parameters;
use control_core::{Input, Telemetry};
use firmware::flight_log::Resumed;
use firmware::icm42688::SAMPLE_HZ;
use firmware::record::Record;
use firmware::report::Tally;
use std::fmt;

/// Where image and host part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Parting {
    /// They decide otherwise.
    Command {
        /// The step, from 1.
        step: u32,
        /// When, µs since boot.
        time_us: u64,
        /// What the image decided.
        image: Command,
        /// What the host decided.
        host: Command,
    },
    /// A step of the image was not seen: it was reset, or was making two.
    Step {
        /// The step that was due.
        due: u32,
        /// The one that was seen.
        seen: u32,
    },
}

impl fmt::Display for Parting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Command { step, time_us, image, host } => {
                let t_s = *time_us as f64 * 1e-6;
                write!(f, "step {step}, {t_s:.4} s since boot: ")?;
                let (Command::Run(image), Command::Run(host)) = (image, host) else {
                    return write!(f, "the image {image:?}, the host {host:?}");
                };
                let mut rotors = (1..).zip(image.iter().zip(host));
                let differs = rotors.find(|(_, (image, host))| image.to_bits() != host.to_bits());
                differs.map_or(Ok(()), |(rotor, (image, host))| {
                    let bits = [image, host].map(|share| share.to_bits());
                    write!(
                        f,
                        "rotor {rotor}: the image {image} ({:#010x}), the host {host} ({:#010x})",
                        bits[0], bits[1]
                    )
                })
            }
            Self::Step { due, seen } => write!(f, "step {due} of the image was due, step {seen} was seen"),
        }
    }
}

/// Whether image and host have decided the same.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Commands that were compared.
    pub commands: u32,
    /// Hash of all commands of image and host until the end of each second.
    pub seconds: Vec<[u32; 2]>,
    /// Where they parted first, if they did; nothing is compared from there on.
    pub parting: Option<Parting>,
}

/// The host's build of what the image flies.
pub(crate) struct Twin {
    flight: Flight,
    last: Option<Record>,
    tallies: [Tally; 2],
    verdict: Verdict,
}

/// What of it a sample shows.
pub(super) struct Seen<'a> {
    pub(super) input: Input,
    pub(super) measurements: &'a Measurements,
    pub(super) clock_s: f64,
    pub(super) estimate: &'a Estimate,
    pub(super) estimator: EstimatorTelemetry,
    pub(super) decision: Option<Decision<'a>>,
    pub(super) rejected: bool,
    pub(super) telemetry: Telemetry,
}

impl Twin {
    pub(crate) fn new(parameters: &Parameters) -> Result<Self, Unflyable> {
        let flight = firmware::flight::boot(parameters)?;
        let verdict = Verdict { commands: 0, seconds: Vec::new(), parting: None };
        Ok(Self { flight, last: None, tallies: [Tally::new(SAMPLE_HZ); 2], verdict })
    }

    /// Goes on from what the image went on from, before its first step; whether it does.
    pub(crate) fn resume(&mut self, resumed: &Resumed) -> bool {
        self.flight.resume(resumed.memory, resumed.at_us)
    }

    /// Decides what the image has decided, if it has made a step.
    pub(crate) fn follow(&mut self, record: &Record) {
        let (due, seen) = (self.last.map_or(1, |last| last.step + 1), record.step);
        if seen + 1 == due || self.verdict.parting.is_some() {
            return;
        }
        if seen != due {
            self.verdict.parting = Some(Parting::Step { due, seen });
            return;
        }
        self.last = Some(*record);
        let host = self.flight.step(record.time_us, &record.arrived);
        self.verdict.commands += 1;
        let reports = [record.command, host].map(|command| (record.arrived.measurements.imu.is_some(), command));
        let mut hashes = [None; 2];
        for ((tally, (sampled, command)), hash) in self.tallies.iter_mut().zip(reports).zip(&mut hashes) {
            tally.step(sampled, command, 0);
            *hash = tally.close(false).map(|report| report.hash);
        }
        if let [Some(image), Some(host)] = hashes {
            self.verdict.seconds.push([image, host]);
        }
        if bits(host) != bits(record.command) {
            let Record { step, time_us, command: image, .. } = *record;
            self.verdict.parting = Some(Parting::Command { step, time_us, image, host });
        }
    }

    /// Shows what it believes and has decided, once it has made a step.
    pub(super) fn show(&self, target: &Target, observe: impl FnOnce(&Seen)) {
        let Some(Record { time_us, arrived, .. }) = &self.last else { return };
        let (helm, estimate) = (self.flight.helm(), self.flight.estimate());
        let Estimate { position_m, velocity_m_s, attitude, rate_rad_s, specific_force_m_s2, .. } = *estimate;
        observe(&Seen {
            input: Input {
                dt_s: 1.0 / SAMPLE_HZ,
                position_m,
                velocity_m_s,
                attitude,
                rate_rad_s,
                specific_force_m_s2,
                setpoint: target.setpoint(),
            },
            measurements: &arrived.measurements,
            clock_s: *time_us as f64 * 1e-6,
            estimate,
            estimator: self.flight.telemetry(*time_us),
            decision: helm.decision().map(|command| Decision { command, state: helm.state() }),
            rejected: helm.decision().is_some_and(|command| command.rejected),
            telemetry: helm.controller().telemetry(&helm.state().controller),
        });
    }

    /// The step that was followed last.
    pub(crate) fn last(&self) -> Option<&Record> {
        self.last.as_ref()
    }

    /// What has decided.
    pub(crate) fn flight(&self) -> &Flight {
        &self.flight
    }

    pub(crate) fn finish(self) -> Verdict {
        self.verdict
    }
}

/// A command, for a comparison that no two zeros and no two NaNs pass.
fn bits(command: Command) -> Option<[u32; 4]> {
    (command != Command::Stop).then(|| command.speeds().map(f32::to_bits))
}
