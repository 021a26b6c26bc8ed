//! `tactile reproduce`: the thesis' figures and ours.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::PossibleValuesParser;
use serde::Serialize;

use crate::cli::{Error, say};
use crate::experiment::chapter2::{self, FIGURES};
use crate::experiment::{Picture, calibration, data, push, tracking};
use crate::log::write::write_atomically;

/// Repeat an experiment: the thesis' number, or our goal, beside ours.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  tactile reproduce figure-2.7 --seeds 20 --out figures")]
pub struct ReproduceArgs {
    /// Which: a figure of the thesis, or one of ours
    #[arg(value_parser = PossibleValuesParser::new(names()))]
    name: String,
    /// How many seeds, from 0 on
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// Print the numbers as JSON
    #[arg(long)]
    json: bool,
    /// Also write numbers and pictures into this folder
    #[arg(long)]
    out: Option<PathBuf>,
}

/// What is not a figure of chapter 2.
const OTHERS: [&str; 3] = ["figure-3.12", "push", CALIBRATION];

/// How often the true surface lies within the reported 95 % band: minutes, so not among `all`.
const CALIBRATION: &str = "calibration";

fn names() -> Vec<&'static str> {
    let figures = FIGURES.iter().map(|f| f.name);
    figures.chain(OTHERS).chain(["all"]).collect()
}

/// What an experiment gave: numbers to read, the same for programs, pictures.
struct Outcome {
    name: &'static str,
    text: String,
    json: serde_json::Value,
    picture: Option<Picture>,
}

impl Outcome {
    fn new<T: Display + Serialize>(
        name: &'static str,
        numbers: &T,
        picture: Option<Picture>,
    ) -> Result<Outcome, Error> {
        let json = serde_json::to_value(numbers).map_err(Error::failure)?;
        Ok(Outcome { name, text: numbers.to_string(), json, picture })
    }

    fn write(&self, folder: &Path) -> Result<(), Error> {
        let save = |name: &str, content: &[u8]| {
            let path = folder.join(name);
            write_atomically(&path, |w| w.write_all(content)).map_err(|e| cannot_write(&path, &e))
        };
        let json = serde_json::to_string_pretty(&self.json).map_err(Error::failure)?;
        save(&format!("{}.json", self.name), json.as_bytes())?;
        match &self.picture {
            Some(picture) => save(&picture.name, &picture.png),
            None => Ok(()),
        }
    }
}

fn cannot_write(path: &Path, why: &dyn Display) -> Error {
    Error::input(format!("{}: cannot write: {why}", path.display()))
}

/// Runs the subcommand.
///
/// # Errors
/// Missing recordings, a folder that cannot be written.
pub fn run(args: &ReproduceArgs) -> Result<(), Error> {
    // Before anything long is begun.
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder).map_err(|e| cannot_write(folder, &e))?;
    }
    let wanted = |name: &&str| (args.name == "all" && *name != CALIBRATION) || args.name == *name;
    let mut outcomes = Vec::new();
    for name in names().into_iter().filter(|n| *n != "all").filter(wanted) {
        let outcome = one(name, args)?;
        if !args.json {
            say(&outcome.text);
        }
        if let Some(folder) = &args.out {
            outcome.write(folder)?;
        }
        outcomes.push(outcome.json);
    }
    if args.json {
        say(serde_json::to_string_pretty(&outcomes).map_err(Error::failure)?);
    }
    Ok(())
}

fn one(name: &'static str, args: &ReproduceArgs) -> Result<Outcome, Error> {
    if let Some(figure) = chapter2::figure(name) {
        let drawn = figure.draw(args.seeds).map_err(Error::failure)?;
        return Outcome::new(name, &drawn, Some(drawn.picture.clone()));
    }
    if name == CALIBRATION {
        let data = data();
        let table = calibration::run(data.as_deref(), 0, args.seeds).map_err(Error::failure)?;
        return Outcome::new(name, &table, None);
    }
    let table = match name {
        "figure-3.12" => tracking::run(args.seeds).map_err(Error::failure)?,
        _ => push::run(data().as_deref()).map_err(Error::input)?,
    };
    Outcome::new(name, &table, None)
}
