//! `--through`: who decides in a flight, the host's build of the core or the image on the emulator.
use super::{Failure, refused};
use crate::controllers::ControllerName;
use crate::flight::{Flight, NumberFormat, Sample};
use crate::metrics::{Flown, fly_measured};
use crate::scenario::Scenario;
use crate::through::{self, Board, CORE_HZ};
use clap::ValueEnum;
use std::path::Path;

/// Who decides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(super) enum Through {
    /// The core, built for this computer.
    #[default]
    Native,
    /// The image that is flashed, on an emulated board: docs/emulator.md.
    Emulator,
}

/// Seconds in a line of hashes.
const SECONDS_A_LINE: usize = 8;

impl Through {
    /// The scenario as it is flown; refuses what the image cannot.
    pub(super) fn prepare(
        self,
        file: &Path,
        scenario: Scenario,
        controllers: &[ControllerName],
        format: NumberFormat,
    ) -> Result<Scenario, Failure> {
        if self == Self::Native {
            return Ok(scenario);
        }
        if let Some(name) = controllers.iter().find(|&&name| name != ControllerName::Default) {
            let allowed = "must be `default` alone: no other is in the image (--through emulator)";
            return Err(Failure::bad_input(format!("controllers = {name}: {allowed}")));
        }
        if format != NumberFormat::F32 {
            return Err(Failure::bad_input("--format: must be f32: the image has no other (--through emulator)"));
        }
        scenario.for_image(file).map_err(Failure::bad_input)
    }

    /// Flies and measures.
    pub(super) fn fly(
        self,
        file: &Path,
        flight: &Flight,
        observe: &mut dyn FnMut(&Sample),
    ) -> Result<(Flown, Option<Board>), Failure> {
        match self {
            Self::Native => {
                fly_measured(flight, observe).map(|flown| (flown, None)).map_err(refused(file, flight.controller))
            }
            Self::Emulator => {
                let (flown, board) = through::fly_measured(flight, observe)
                    .map_err(|error| Failure { text: format!("{}: {error}", file.display()), code: 1 })?;
                Ok((flown, Some(board)))
            }
        }
    }
}

/// What a flight took of the board, and whether the host has decided the same.
pub(super) fn summary(board: &Board) -> String {
    let Board { emulated_s, wall_s, load, latency_max_s, taken, verdict, .. } = board;
    let seconds: Vec<String> = verdict.seconds.iter().map(|[image, _]| format!("{image:08x}")).collect();
    let lines = seconds.chunks(SECONDS_A_LINE).enumerate();
    let lines = lines.map(|(line, hashes)| format!("{:5}  {}", line * SECONDS_A_LINE + 1, hashes.join(" ")));
    let hashes = lines.collect::<Vec<_>>().join("\n");
    let verdict = match &verdict.parting {
        None => format!("the host decides the same: of {} commands no bit differs", verdict.commands),
        Some(parting) => format!("the host decides otherwise: {parting}"),
    };
    let tasks: Vec<String> =
        taken.tasks.iter().map(|(name, cycles)| format!("{name} {:.0}", *cycles as f64 / CORE_HZ * 1e6)).collect();
    let (used, bytes) = taken.stack_bytes;
    format!(
        "hash of the image's commands, second by second since boot\n{hashes}\n{verdict}\n\
         load {:.1} %, from sample to motor frame {:.0} us at worst; stack {used} of {bytes} bytes\n\
         each task without a pause at most, us: {}\n\
         {emulated_s:.1} s of board in {wall_s:.1} s: {:.2} times real time\n",
        100.0 * load,
        1e6 * latency_max_s,
        tasks.join(", "),
        emulated_s / wall_s,
    )
}

/// A flight in which image and host have parted has failed.
pub(super) fn judge(board: &Board) -> Result<(), Failure> {
    match &board.verdict.parting {
        None => Ok(()),
        Some(parting) => Err(Failure { text: format!("image and host part: {parting}"), code: 1 }),
    }
}
