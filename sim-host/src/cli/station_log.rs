//! `sim-host station … log`: the flight logs in a board's flash chip, listed, fetched and erased.
use super::{Failure, say};
use crate::station::Station;
use clap::Subcommand;
use firmware::flight_log::BLOCK_BYTES;
use flight_link::{LogSize, Order};
use std::fs::File;
use std::io::{ErrorKind, Write, stderr};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Subcommand)]
pub(super) enum LogCommand {
    /// Print which logs there are, and how much room is left.
    List,
    /// Fetch a log into a file that `sim-host replay` takes.
    Get {
        /// Which one, as `list` numbers them; the newest before this start of the board if left out, or if there is none this start's.
        number: Option<usize>,
        /// The file, which must not be there.
        #[arg(long, default_value = "FLIGHT.LOG")]
        file: PathBuf,
    },
    /// Erase all of them and start the board anew, so that the next log begins with its first step.
    Erase,
}

pub(super) fn log(station: &mut Station, command: &LogCommand) -> Result<(), Failure> {
    match command {
        LogCommand::List => list(station),
        LogCommand::Get { number, file } => get(station, *number, file),
        LogCommand::Erase => {
            station.erase_log(&mut |left| show(&format!("{} are left", size(left))))?;
            station.order(Order::Restart)?;
            station.wait_for_restart()?;
            say("erased; the board has started anew\n")
        }
    }
}

fn list(station: &mut Station) -> Result<(), Failure> {
    let (LogSize { used, room, running }, logs) = station.logs()?;
    for (number, log) in (1..).zip(&logs) {
        let now = if log.start == running { ", being written" } else { "" };
        say(&format!("{number}: {}{now}\n", size(log.end - log.start)))?;
    }
    say(&format!("{} of {} are written\n", size(used), size(room)))
}

fn get(station: &mut Station, number: Option<usize>, file: &Path) -> Result<(), Failure> {
    let (LogSize { running, .. }, logs) = station.logs()?;
    let Range { start, end } = choose(&logs, number, running)?;
    let mut place = File::create_new(file).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => {
            Failure::bad_input(format!("--file = {}: is there already: move it away first", file.display()))
        }
        _ => Failure::writing(file)(error),
    })?;
    let began = Instant::now();
    let blocks = station.read_log(start..end, &mut |count| show(&format!("{} of {}", size(count), size(end - start))));
    let written = blocks.map_err(Failure::from).and_then(|blocks| {
        place.write_all(blocks.as_flattened()).map_err(Failure::writing(file))?;
        say(&format!("{}: {} in {:.0} s\n", file.display(), size(end - start), began.elapsed().as_secs_f64()))
    });
    if written.is_err() {
        // All or none; that it failed is said already.
        let _ = std::fs::remove_file(file);
    }
    written
}

/// The log with a number from 1, or the newest before the one that is being written.
fn choose(logs: &[Range<u32>], number: Option<usize>, running: u32) -> Result<Range<u32>, Failure> {
    let before = logs.iter().filter(|log| log.start != running).count();
    let number = number.unwrap_or(if before > 0 { before } else { logs.len() });
    let chosen = number.checked_sub(1).and_then(|place| logs.get(place)).cloned();
    chosen.ok_or_else(|| match logs.len() {
        0 => Failure::bad_input("the board has no flight log".to_owned()),
        count => Failure::bad_input(format!("log get {number}: must be from 1 to {count}")),
    })
}

fn size(blocks: u32) -> String {
    format!("{:.2} MB", f64::from(blocks) * BLOCK_BYTES as f64 * 1e-6)
}

/// Shows how far it is, in one line; nobody minds where that cannot be seen.
fn show(text: &str) {
    let _ = write!(stderr(), "\r{text}  \r");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_flight_is_the_one_before_this_start_and_others_go_by_their_number() {
        let logs = [0..5, 5..9, 9..20];
        for (number, running, chosen) in [(None, 9, 5..9), (None, 20, 9..20), (Some(1), 9, 0..5), (Some(3), 9, 9..20)] {
            assert_eq!(choose(&logs, number, running).expect("it is there"), chosen, "{number:?}, {running}");
        }
        assert_eq!(choose(&logs[..1], None, 0).expect("this start's"), 0..5);
        for (logs, number, says) in [
            (&logs[..], Some(0), "log get 0: must be from 1 to 3"),
            (&logs, Some(4), "from 1 to 3"),
            (&[], None, "no flight log"),
        ] {
            let refused = choose(logs, number, 9).expect_err("there is none").to_string();
            assert!(refused.contains(says), "{refused}");
        }
    }
}
