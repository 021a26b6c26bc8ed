//! `tactile replay`: a recording as a grasp log or a table.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::{Error, say};
use crate::log::recording::Recording;
use crate::log::write::write_atomically;

/// Turn a recording back into a grasp log, or its estimates into a table
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  tactile replay session.tac --to jsonl -o session.jsonl\n  tactile slam session.jsonl"
)]
pub struct ReplayArgs {
    /// A recording (.tac)
    file: PathBuf,
    /// What to make of it
    #[arg(long, value_enum, default_value_t = Format::Jsonl)]
    to: Format,
    /// The file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// What a recording can become.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Grasp log of what the board accepted, with its estimates in the field `estimate`
    Jsonl,
    /// One line per estimate: pose, standard deviations, counts
    Csv,
}

/// Runs the subcommand.
///
/// # Errors
/// Not a recording, a recording without a grasp, or an unwritable output.
pub fn run(args: &ReplayArgs) -> Result<(), Error> {
    let recording = Recording::read(&args.file).map_err(Error::input)?;
    let replayed = recording.replay();
    let name = args.file.display();
    if replayed.log.grasps.is_empty() {
        return Err(Error::Input(format!("{name}: expected at least one whole grasp, found none")));
    }
    for (count, what) in [
        (recording.torn, "bytes of a torn last piece skipped"),
        (recording.damaged, "damaged pieces skipped"),
    ] {
        if count > 0 {
            eprintln!("warning: {name}: {count} {what}");
        }
    }
    match args.to {
        Format::Jsonl => replayed.log.write(&args.output).map_err(Error::input)?,
        Format::Csv => table(&replayed, &args.output)?,
    }
    say(format!("{} grasps in {}", replayed.log.grasps.len(), args.output.display()));
    Ok(())
}

fn table(replayed: &crate::log::replayed::Replayed, path: &Path) -> Result<(), Error> {
    write_atomically(path, |writer| replayed.write_csv(writer))
        .map_err(|e| Error::Input(format!("{}: cannot write: {e}", path.display())))
}
