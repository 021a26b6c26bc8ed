//! `tactile replay`: a recording or a grasp log as another file.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::terminal::{Progress, tell, warn};
use super::{Error, browser, files};
use crate::log::GraspLog;
use crate::log::recording::Recording;
use crate::log::replayed::Replayed;
use crate::log::write::write_atomically;
use crate::slam::output::true_shape;
use crate::slam::recorded::{FilmError, Recorded};
use crate::slam::replay;
use crate::view::scene::{Meta, Scene};
use crate::view::{html, mcap};

/// Turn a recording into a moving scene for a browser, a grasp log, a table, or a file for Foxglove,
/// Rerun and RViz
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  tactile replay session.tac --to jsonl -o session.jsonl\n  tactile slam session.jsonl\n  tactile replay session.tac --to html\n  tactile replay session.tac --to mcap -o session.mcap"
)]
pub struct ReplayArgs {
    /// A recording (.tac) or a grasp log (.jsonl)
    file: PathBuf,
    /// What to make of it
    #[arg(long, value_enum, default_value_t = Format::Jsonl)]
    to: Format,
    /// The file to write [default: a new one beside FILE, with the same name and the other ending]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Show the page in the browser (that `BROWSER` names, else the system's); with --to html
    #[arg(long)]
    open: bool,
}

/// What a recording can become.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Grasp log of what the board accepted, with its estimates in the field `estimate`
    Jsonl,
    /// One line per estimate: pose, standard deviations, counts (of a recording)
    Csv,
    /// A moving scene in one page that any browser opens; what the file lacks is said there
    Html,
    /// ROS 2 messages: contacts, poses, and the surface as it grows; of a grasp log, which has no
    /// estimates, contacts and the true shape
    Mcap,
}

impl Format {
    /// How a file of it ends.
    fn ending(self) -> &'static str {
        match self {
            Format::Jsonl => "jsonl",
            Format::Csv => "csv",
            Format::Html => "html",
            Format::Mcap => "mcap",
        }
    }
}

/// Where the output goes: one that nobody named replaces nothing.
fn output(args: &ReplayArgs) -> Result<PathBuf, Error> {
    if let Some(output) = &args.output {
        files::apart(&args.file, output, "--output")?;
        // Only what is there can be lost.
        let log = (is_log(&args.file) && output.exists()).then(|| GraspLog::salvage(&args.file));
        if let Some(Ok((log, _))) = log {
            files::apart_from_truth(&log, output, "--output")?;
        }
        return Ok(output.clone());
    }
    let output = args.file.with_extension(args.to.ending());
    if output.exists() {
        let name = output.display();
        return Err(Error::Input(format!(
            "{name}: there is such a file already; expected --output to say where to write"
        )));
    }
    Ok(output)
}

/// Runs the subcommand.
///
/// # Errors
/// Neither a recording nor a log, a recording without a grasp, or an unwritable output.
pub fn run(args: &ReplayArgs) -> Result<(), Error> {
    if args.open && args.to != Format::Html {
        return Err(Error::Input(
            "--open: expected --to html, a browser shows nothing else".into(),
        ));
    }
    let output = &output(args)?;
    let grasps = match args.to {
        // Says itself what is missing, and reads long recordings as they come.
        Format::Html => page(args, output),
        Format::Jsonl => log(args, output),
        Format::Csv => table(args, output),
        Format::Mcap => film(args, output),
    }?;
    tell(format!("{grasps} grasps in {}", output.display()))?;
    if args.open {
        browser::show(output);
    }
    Ok(())
}

fn is_log(file: &Path) -> bool {
    file.extension().is_some_and(|e| e == "jsonl")
}

/// Most lines of a damaged log that are named on the page.
const NAMED: usize = 6;

/// A page shows what there is, and says what there is not: of a file that is neither a log nor a recording,
/// anything.
fn page(args: &ReplayArgs, output: &Path) -> Result<u64, Error> {
    let scene = match scene(args) {
        Err(error) if args.file.is_file() => {
            let missing = vec![format!("There is nothing to show. {error}")];
            let name = args.file.file_name().unwrap_or_default().to_string_lossy();
            let meta = Meta { missing, ..Meta::new(3, name) };
            Scene { meta, grasps: Vec::new(), surfaces: Vec::new(), choices: Vec::new() }
        }
        told => told?,
    };
    for missing in &scene.meta.missing {
        warn(format_args!("{}: {missing}", args.file.display()));
    }
    write_atomically(output, |out| html::write(&scene, out)).map_err(|e| unwritable(output, e))?;
    Ok(scene.grasps.iter().map(|g| g.merged).sum())
}

fn scene(args: &ReplayArgs) -> Result<Scene, Error> {
    Ok(if is_log(&args.file) {
        let (log, left_out) = GraspLog::salvage(&args.file).map_err(Error::input)?;
        let mut missing: Vec<String> =
            left_out.iter().take(NAMED).map(|e| format!("Left out: {e}")).collect();
        if left_out.len() > NAMED {
            missing.push(format!("{} more lines are left out.", left_out.len() - NAMED));
        }
        if log.grasps.is_empty() {
            missing.push("There is no whole grasp in the log.".into());
        }
        let truth = true_shape(&log).unwrap_or_else(|error| {
            missing.push(format!("The true shape is left out: {error}"));
            None
        });
        let name = args.file.file_name().unwrap_or_default().to_string_lossy();
        let title = if log.description.is_empty() { &*name } else { &log.description };
        replay::of_log(&log, title, truth.as_ref(), missing)
    } else {
        recorded(args)?.scene()
    })
}

fn recorded(args: &ReplayArgs) -> Result<Recorded, Error> {
    let reading = Progress::new("reading", "MB");
    Recorded::read(&args.file, &|done, all| reading.at(done, all)).map_err(Error::input)
}

fn read(file: &Path) -> Result<Replayed, Error> {
    let recording = Recording::read(file).map_err(Error::input)?;
    let replayed = recording.replay();
    if replayed.log.grasps.is_empty() {
        return Err(without_grasp(file));
    }
    let name = file.display();
    for (count, what) in [
        (recording.torn, "bytes of a torn last piece skipped"),
        (recording.damaged, "damaged pieces skipped"),
    ] {
        if count > 0 {
            warn(format_args!("{name}: {count} {what}"));
        }
    }
    if let Some(at) = recording.another {
        warn(format_args!("{name}: another recording begins at byte {at}: it is left out"));
    }
    for sentence in replayed.left_out.sentences() {
        warn(format_args!("{name}: {sentence}"));
    }
    Ok(replayed)
}

fn log(args: &ReplayArgs, output: &Path) -> Result<u64, Error> {
    let log = match is_log(&args.file) {
        true => GraspLog::read(&args.file).map_err(Error::input)?,
        false => read(&args.file)?.log,
    };
    log.write(output).map_err(Error::input)?;
    Ok(log.grasps.len() as u64)
}

fn table(args: &ReplayArgs, output: &Path) -> Result<u64, Error> {
    if is_log(&args.file) {
        return Err(Error::Input(format!(
            "{}: expected a recording (.tac), found a grasp log: it has no estimates to tabulate",
            args.file.display()
        )));
    }
    let replayed = read(&args.file)?;
    write_atomically(output, |writer| replayed.write_csv(writer))
        .map_err(|e| unwritable(output, e))?;
    Ok(replayed.log.grasps.len() as u64)
}

/// What a page says is missing is said here.
fn film(args: &ReplayArgs, output: &Path) -> Result<u64, Error> {
    if is_log(&args.file) {
        return film_of_log(args, output);
    }
    let progress = Progress::new("writing", "MB");
    let (mut filmed, mut unreadable) = (None, None);
    let written = write_atomically(output, |out| {
        match Recorded::film(&args.file, out, &|done, all| progress.at(done, all)) {
            Ok(recorded) => filmed = Some(recorded),
            Err(FilmError::Film(error)) => return Err(error),
            Err(other) => {
                unreadable = Some(other);
                return Err(std::io::Error::other("there is no film"));
            }
        }
        Ok(())
    });
    drop(progress);
    if let Some(error) = unreadable {
        return Err(Error::input(error));
    }
    written.map_err(|e| unwritable(output, e))?;
    let missing = filmed.iter().flat_map(|recorded| &recorded.missing);
    missing.for_each(|missing| warn(format_args!("{}: {missing}", args.file.display())));
    Ok(filmed.map_or(0, |recorded| recorded.count))
}

fn film_of_log(args: &ReplayArgs, output: &Path) -> Result<u64, Error> {
    let log = GraspLog::read(&args.file).map_err(Error::input)?;
    let name = args.file.display().to_string();
    let truth = true_shape(&log).unwrap_or_else(|error| {
        warn(format_args!("{name}: {error}; the true shape is left out"));
        None
    });
    let title = args.file.file_name().unwrap_or_default().to_string_lossy();
    let contents = mcap::Contents {
        title: if log.description.is_empty() { &title } else { &log.description },
        log: &log,
        steps: &[],
        surfaces: &[],
        truth: truth.as_ref(),
        report: None,
    };
    mcap::write(output, &contents).map_err(|e| unwritable(output, e))?;
    Ok(log.grasps.len() as u64)
}

fn without_grasp(file: &Path) -> Error {
    let name = file.display();
    Error::Input(format!("{name}: expected at least one whole grasp, found none"))
}

fn unwritable(path: &Path, error: std::io::Error) -> Error {
    Error::Input(format!("{}: cannot write: {error}", path.display()))
}
