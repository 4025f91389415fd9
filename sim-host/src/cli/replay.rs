//! `sim-host replay`: a board's flight log, decided once more, and what happened in it.
use super::{Failure, LOG_HZ, folder_in, say};
use crate::chronicle::Happening;
use crate::output::Files;
use crate::replay::{Replay, ReplayError, Start, replay as repeat, starts};
use crate::through::Parting;
use clap::Args;
use control_core::estimate::Estimate;
use control_core::flight::{Command, Flight};
use control_core::measurement::{Imu, Stamped};
use firmware::icm42688::SAMPLE_HZ;
use firmware::record::Record;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

#[derive(Args)]
pub(super) struct ReplayArgs {
    /// The flight log, `FLIGHT.LOG` of the board's card.
    log: PathBuf,
    /// Which start of the board, from 1; the last one if left out.
    #[arg(long)]
    start: Option<usize>,
    /// Where log.csv goes; `out/<log>` if left out.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Columns of log.csv.
const COLUMNS: [&str; 23] = [
    "t_s",
    "step",
    "rate_x_rad_s",
    "rate_y_rad_s",
    "rate_z_rad_s",
    "force_x_m_s2",
    "force_y_m_s2",
    "force_z_m_s2",
    "motor_1",
    "motor_2",
    "motor_3",
    "motor_4",
    "battery_v",
    "battery_a",
    "north_m",
    "east_m",
    "altitude_m",
    "velocity_north_m_s",
    "velocity_east_m_s",
    "velocity_up_m_s",
    "tilt_rad",
    "heading_rad",
    "mode",
];

/// Gaps and damages that are printed.
const LISTED: usize = 10;

pub(super) fn replay(args: &ReplayArgs) -> Result<(), Failure> {
    let name = args.log.display();
    let folder = folder_in(args.out.as_ref(), Path::new("out"), &args.log)?;
    let refused = |error: ReplayError| Failure::bad_input(format!("{name}: {error}"));
    let mut log = BufReader::new(File::open(&args.log).map_err(|error| refused(error.into()))?);
    let all = starts(&mut log).map_err(refused)?;
    let number = args.start.unwrap_or(all.len());
    let Some(&Start { offset, bytes }) = number.checked_sub(1).and_then(|index| all.get(index)) else {
        return Err(Failure::bad_input(format!("--start {number}: must be from 1 to {} ({name})", all.len())));
    };
    log.seek(SeekFrom::Start(offset)).map_err(|error| refused(error.into()))?;
    let mut table = Table::new();
    let told = repeat(log.take(bytes), &mut |record, flight| table.note(record, flight)).map_err(refused)?;
    let mut files = Files::default();
    files.add("log.csv", table.writer.into_inner().map_err(|error| Failure::writing(&folder)(error.into_error()))?);
    files.write(&folder).map_err(Failure::writing(&folder))?;
    say(&format!("start {number} of {}\n{}log.csv is in {}\n", all.len(), summary(&told), folder.display()))?;
    judge(&told)
}

/// The rows of log.csv.
struct Table {
    writer: csv::Writer<Vec<u8>>,
    /// Volts and amperes.
    battery: [f32; 2],
}

impl Table {
    fn new() -> Self {
        let mut writer = csv::Writer::from_writer(Vec::new());
        // Writing to a vector cannot fail.
        let _ = writer.write_record(COLUMNS);
        Self { writer, battery: [f32::NAN; 2] }
    }

    fn note(&mut self, record: &Record, flight: Option<&Flight>) {
        let measurements = &record.arrived.measurements;
        for (last, reading) in self.battery.iter_mut().zip([measurements.battery_v, measurements.battery_a]) {
            *last = reading.map_or(*last, |reading| reading.value);
        }
        if !record.step.is_multiple_of((SAMPLE_HZ / LOG_HZ as f32) as u32) {
            return;
        }
        let mut row = vec![(record.time_us as f64 * 1e-6).to_string(), record.step.to_string()];
        let mut put = |values: &[f32]| row.extend(values.iter().map(f32::to_string));
        let sample = measurements
            .imu
            .map_or([f32::NAN; 6], |Stamped { value: Imu { rate_rad_s: r, specific_force_m_s2: f }, .. }| {
                [r.x, r.y, r.z, f.x, f.y, f.z]
            });
        put(&sample);
        put(&if let Command::Run(shares) = record.command { shares } else { [0.0; 4] });
        put(&self.battery);
        put(&flight.map_or([f32::NAN; 8], |flight| believed(flight.estimate())));
        let mode = flight.and_then(|flight| flight.helm().decision()).map(|decision| decision.mode.to_string());
        row.push(mode.unwrap_or_default());
        let _ = self.writer.write_record(row);
    }
}

/// Position, velocity, tilt and heading.
fn believed(estimate: &Estimate) -> [f32; 8] {
    let Estimate { position_m: p, velocity_m_s: v, attitude, .. } = estimate;
    let [[north, ..], [east, ..], [.., down]] = attitude.rows;
    [p.x, p.y, -p.z, v.x, v.y, -v.z, down.clamp(-1.0, 1.0).acos(), east.atan2(north)]
}

fn summary(told: &Replay) -> String {
    let Replay { flown, steps, span_us, gaps, damage, verdict, happenings } = told;
    let mut lines = vec![format!("{}, image {}", flown.board, flown.image)];
    let set = flown.parameters.iter().filter(|(known, value)| *value != known.default);
    lines.extend(set.map(|(known, value)| format!("{} = {value} {}", known.name, known.unit)));
    lines.extend(
        flown
            .resumed
            .iter()
            .map(|resumed| format!("{:9.3} s  went on after a reset in the air", resumed.at_us as f64 * 1e-6)),
    );
    lines.extend(happenings.iter().map(|Happening { t_s, what }| format!("{t_s:9.3} s  {what}")));
    let [from_s, to_s] = span_us.map_or([0.0; 2], |(first, last)| [first, last].map(|time_us| time_us as f64 * 1e-6));
    lines.push(format!("{steps} steps, {:.3} s, from {from_s:.3} s to {to_s:.3} s since boot", to_s - from_s));
    lines.extend(gaps.iter().map(ToString::to_string).chain(damage.iter().map(ToString::to_string)).take(LISTED));
    if let Some(more) = (gaps.len() + damage.len()).checked_sub(LISTED).filter(|&more| more > 0) {
        lines.push(format!("and {more} more of these"));
    }
    let seconds = verdict.seconds.len();
    let same = verdict.seconds.iter().filter(|[image, host]| image == host).count();
    lines.push(format!("{} commands compared; hashes of {same} of {seconds} seconds are equal", verdict.commands));
    match (&verdict.parting, gaps.first()) {
        (Some(Parting::Command { .. }), _) => {}
        (_, Some(gap)) => lines.push(format!(
            "no bit differs up to {:.4} s since boot; after that nothing can be compared: {gap}",
            gap.after.1 as f64 * 1e-6
        )),
        (_, None) => lines.push("no bit differs".to_owned()),
    }
    lines.join("\n") + "\n"
}

fn judge(told: &Replay) -> Result<(), Failure> {
    let failed = |text: String| Err(Failure { text, code: 1 });
    match &told.verdict.parting {
        Some(parting @ Parting::Command { .. }) => failed(format!("the host decides otherwise: {parting}")),
        _ if told.verdict.commands == 0 => {
            failed("nothing could be compared: the log does not have the first step".to_owned())
        }
        _ => Ok(()),
    }
}
