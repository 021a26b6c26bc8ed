//! `tactile inspect`: what is in a file, its gaps and its errors.

use std::path::{Path, PathBuf};

use clap::Args;

use super::terminal::{plain, say, warn};
use super::{Error, normals};
use crate::log::GraspLog;
use crate::log::inspection::inspect_recording;

mod courses;
mod log;
use log::Summary;

/// Say what is in a file, its gaps and its errors
#[derive(Debug, Args)]
#[command(after_help = "Example: tactile inspect box.jsonl --json")]
pub struct InspectArgs {
    /// A grasp log (.jsonl) or a recording (.tac)
    file: PathBuf,
    /// Print figures as JSON
    #[arg(long)]
    json: bool,
}

/// Tells the kind of file by its ending and says what is in it.
///
/// # Errors
/// When the kind is not known, or the file cannot be read.
pub fn run(args: &InspectArgs) -> Result<(), Error> {
    match args.file.extension().and_then(|e| e.to_str()) {
        Some("jsonl") => inspect_log(&args.file, args.json),
        Some("tac") => inspect_tac(&args.file, args.json),
        _ => Err(Error::Input(format!(
            "{}: expected a grasp log (.jsonl) or a recording (.tac)",
            args.file.display()
        ))),
    }
}

/// Says what is in a grasp log; of a damaged one, in what of it is sound.
///
/// # Errors
/// When the log cannot be read, or not all of it.
pub fn inspect_log(file: &Path, json: bool) -> Result<(), Error> {
    let (log, damage) = match GraspLog::read(file) {
        Ok(log) => (log, None),
        Err(error) => match GraspLog::salvage(file) {
            Ok((log, left_out)) if !log.grasps.is_empty() => (log, Some((error, left_out.len()))),
            _ => return Err(Error::input(error)),
        },
    };
    let summary = Summary::of(&log);
    if json {
        say(serde_json::to_string_pretty(&summary).map_err(Error::failure)?)
    } else {
        say(plain(format_args!("{}\n{}", file.display(), summary.text().trim_end())))?;
        courses::of_log(&log).iter().try_for_each(say)
    }?;
    if let Some(doubt) = normals::doubt(&log) {
        warn(format_args!("{}: {doubt}", file.display()));
    }
    let Some((error, count)) = damage else { return Ok(()) };
    let lines = if count == 1 { "1 line is".into() } else { format!("{count} lines are") };
    warn(format_args!("{}: {lines} left out of this", file.display()));
    Err(Error::input(error))
}

/// Says what is in a recording.
///
/// # Errors
/// When it is none.
fn inspect_tac(file: &Path, json: bool) -> Result<(), Error> {
    let inspection = inspect_recording(file).map_err(Error::input)?;
    if json {
        say(serde_json::to_string_pretty(&inspection.to_json()).map_err(Error::failure)?)
    } else {
        say(plain(format_args!("{}\n{}", file.display(), inspection.to_string().trim_end())))?;
        courses::of_recording(&inspection.replayed).iter().try_for_each(say)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_files_are_refused() {
        for name in ["a.txt", "a", "a.tac.gz"] {
            let args = InspectArgs { file: name.into(), json: false };
            let error = run(&args).unwrap_err();
            assert!(error.code() == 2 && error.to_string().contains("expected a grasp log"));
        }
        let args = InspectArgs { file: "no/such.jsonl".into(), json: true };
        assert!(run(&args).unwrap_err().to_string().contains("no/such.jsonl: cannot read"));
    }
}
