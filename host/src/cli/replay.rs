//! `tactile replay`: a recording or a grasp log as another file.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::{Error, say};
use crate::log::GraspLog;
use crate::log::recording::Recording;
use crate::log::replayed::Replayed;
use crate::log::write::write_atomically;
use crate::slam::output::true_shape;
use crate::slam::track::Step;
use crate::view::mcap;

/// Turn a recording into a grasp log, a table, or a file for Foxglove, Rerun and RViz
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  tactile replay session.tac --to jsonl -o session.jsonl\n  tactile slam session.jsonl\n  tactile replay session.tac --to mcap -o session.mcap"
)]
pub struct ReplayArgs {
    /// A recording (.tac) or a grasp log (.jsonl)
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
    /// One line per estimate: pose, standard deviations, counts (of a recording)
    Csv,
    /// ROS 2 messages: contacts, poses, the true shape; a grasp log has no estimates
    Mcap,
}

/// Runs the subcommand.
///
/// # Errors
/// Neither a recording nor a log, a recording without a grasp, or an unwritable output.
pub fn run(args: &ReplayArgs) -> Result<(), Error> {
    let count = match args.file.extension().and_then(|e| e.to_str()) {
        Some("jsonl") => {
            let log = GraspLog::read(&args.file).map_err(Error::input)?;
            convert_log(&log, args)?;
            log.grasps.len()
        }
        _ => {
            let replayed = read(&args.file)?;
            convert_recording(&replayed, args)?;
            replayed.log.grasps.len()
        }
    };
    say(format!("{count} grasps in {}", args.output.display()));
    Ok(())
}

fn read(file: &Path) -> Result<Replayed, Error> {
    let recording = Recording::read(file).map_err(Error::input)?;
    let replayed = recording.replay();
    let name = file.display();
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
    Ok(replayed)
}

fn convert_recording(replayed: &Replayed, args: &ReplayArgs) -> Result<(), Error> {
    let log = &replayed.log;
    match args.to {
        Format::Jsonl => log.write(&args.output).map_err(Error::input),
        Format::Csv => write_atomically(&args.output, |writer| replayed.write_csv(writer))
            .map_err(|e| unwritable(&args.output, e)),
        Format::Mcap => {
            // An estimate without a pose is missing; the others carry the time of their grasp.
            let mut estimates = replayed.estimates.iter().peekable();
            let mut step = |time: Option<f64>| {
                let own = estimates.next_if(|e| Some(e.time.as_secs_f64()) == time);
                own.map(Step::from)
            };
            let steps: Vec<_> = log.grasps.iter().map(|g| step(g.time)).collect();
            film(log, &steps, args)
        }
    }
}

fn convert_log(log: &GraspLog, args: &ReplayArgs) -> Result<(), Error> {
    match args.to {
        Format::Jsonl => log.write(&args.output).map_err(Error::input),
        Format::Csv => Err(Error::Input(format!(
            "{}: expected a recording (.tac), found a grasp log: it has no estimates to tabulate",
            args.file.display()
        ))),
        Format::Mcap => film(log, &[], args),
    }
}

fn film(log: &GraspLog, steps: &[Option<Step>], args: &ReplayArgs) -> Result<(), Error> {
    let name = args.file.display().to_string();
    let truth = true_shape(log).unwrap_or_else(|error| {
        eprintln!("warning: {name}: {error}; the true shape is left out");
        None
    });
    let contents = mcap::Contents {
        title: if log.description.is_empty() { &name } else { &log.description },
        log,
        steps,
        shape: None,
        truth: truth.as_ref(),
        report: None,
    };
    mcap::write(&args.output, &contents).map_err(|e| unwritable(&args.output, e))
}

fn unwritable(path: &Path, error: std::io::Error) -> Error {
    Error::Input(format!("{}: cannot write: {error}", path.display()))
}
