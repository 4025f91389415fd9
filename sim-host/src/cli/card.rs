//! `sim-host card`: the file that a board fills with its flight logs, made on a card.
use super::{Failure, say};
use clap::Args;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The file, as the board knows it.
const NAME: &str = "FLIGHT.LOG";
/// What is written at once.
const PIECE_BYTES: usize = 1_000_000;

#[derive(Args)]
pub(super) struct CardArgs {
    /// The folder that shows the card.
    folder: PathBuf,
    /// Its size, MB; a minute of flight takes 6.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(1..=4_000))]
    megabytes: u32,
}

pub(super) fn card(args: &CardArgs) -> Result<(), Failure> {
    let file = args.folder.join(NAME);
    make(&file, args.megabytes).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => {
            let text = "is there already, and may have logs in it: move it away first";
            Failure::bad_input(format!("{}: {text}", file.display()))
        }
        _ => Failure::writing(&file)(error),
    })?;
    say(&format!("{} has room for {} MB of flight logs\n", file.display(), args.megabytes))
}

/// Zeros, all of them written: what is only promised may be in pieces, or hold what was there before.
fn make(file: &Path, megabytes: u32) -> io::Result<()> {
    let mut file = File::create_new(file)?;
    let zeros = vec![0; PIECE_BYTES];
    for _ in 0..megabytes {
        file.write_all(&zeros)?;
    }
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_made_of_zeros_and_one_that_is_there_is_left_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let args = CardArgs { folder: folder.path().to_owned(), megabytes: 2 };
        card(&args).expect("made");
        let file = folder.path().join(NAME);
        assert_eq!(std::fs::read(&file).expect("it is there"), vec![0; 2 * PIECE_BYTES]);
        std::fs::write(&file, "a log").expect("written");
        let refused = card(&args).expect_err("it is there").to_string();
        assert!(refused.contains("FLIGHT.LOG: is there already"), "{refused}");
        assert_eq!(std::fs::read(&file).expect("it is there"), b"a log");
    }
}
