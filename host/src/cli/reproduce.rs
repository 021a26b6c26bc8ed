//! `tactile reproduce`: the thesis' figures and ours.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::PossibleValuesParser;
use serde::Serialize;

use crate::cli::{Error, say};
use crate::experiment::chapter2::{self, FIGURES};
use crate::experiment::{Picture, calibration, data, graph, memory, push, shapes, tracking};
use crate::log::write::write_atomically;
use crate::quantity::{self, Deviation};

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
    #[command(flatten)]
    shapes: ShapesArgs,
}

/// What `shapes` alone takes: all of it together runs for hours.
#[derive(Debug, PartialEq, Args)]
#[command(next_help_heading = "Only for shapes")]
struct ShapesArgs {
    /// Only objects whose name holds this, such as ycb/ or box; or any object as in simulate
    #[arg(long, value_name = "OBJECT")]
    object: Vec<String>,
    /// Only these numbers of contacts [default: 5 to 60 in the plane, 5 to 200 in space]
    #[arg(long, value_name = "N", value_delimiter = ',',
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1024))]
    contacts: Vec<usize>,
    /// Standard deviations of contact points and normals [default: 1mm,5deg]
    #[arg(long, value_name = "LENGTH,ANGLE", value_parser = quantity::deviation)]
    noise: Option<Deviation>,
    /// The first seed [default: 0]
    #[arg(long, value_name = "SEED")]
    first_seed: Option<u64>,
}

impl ShapesArgs {
    /// The first option that was given.
    fn given(&self) -> Option<&'static str> {
        [
            ("--object", !self.object.is_empty()),
            ("--contacts", !self.contacts.is_empty()),
            ("--noise", self.noise.is_some()),
            ("--first-seed", self.first_seed.is_some()),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }
}

/// The comparison of all models.
const SHAPES: &str = "shapes";

/// What is not a figure of chapter 2.
const OTHERS: [&str; 2] = ["figure-3.12", "push"];

/// Not part of `all`, which would take hours with them.
const LONG: [&str; 4] = [SHAPES, "calibration", "memory", "graph"];

fn names() -> Vec<&'static str> {
    let figures = FIGURES.iter().map(|f| f.name);
    figures.chain(OTHERS).chain(LONG).chain(["all"]).collect()
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
    if let Some(option) = args.shapes.given()
        && args.name != SHAPES
        && args.name != "graph"
    {
        return Err(Error::input(format!("{option}: only shapes takes it, not {}", args.name)));
    }
    // Before anything long is begun.
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder).map_err(|e| cannot_write(folder, &e))?;
    }
    if args.name == SHAPES {
        return compare(args);
    }
    let wanted = |name: &&str| match args.name.as_str() {
        "all" => *name != "all" && !LONG.contains(name),
        one => one == *name,
    };
    let mut outcomes = Vec::new();
    for name in names().into_iter().filter(wanted) {
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

/// The comparison of all models, row by row as they are done.
fn compare(args: &ReproduceArgs) -> Result<(), Error> {
    let ShapesArgs { object, contacts, noise, first_seed } = &args.shapes;
    let selection = shapes::Selection {
        objects: object.clone(),
        contacts: contacts.clone(),
        noise: noise.unwrap_or(Deviation { length: 1e-3, angle: 5f64.to_radians() }),
        seeds: args.seeds,
        first_seed: first_seed.unwrap_or(0),
    };
    if !args.json {
        eprintln!("{}", shapes::heading());
    }
    let progress = |row: &shapes::Row| {
        if !args.json {
            eprintln!("{row}");
        }
    };
    let table = shapes::run(data().as_deref(), &selection, progress).map_err(Error::input)?;
    let outcome = Outcome::new(SHAPES, &table, None)?;
    if let Some(folder) = &args.out {
        outcome.write(folder)?;
    }
    if args.json {
        say(serde_json::to_string_pretty(&outcome.json).map_err(Error::failure)?);
    } else {
        say(&outcome.text);
    }
    Ok(())
}

fn one(name: &'static str, args: &ReproduceArgs) -> Result<Outcome, Error> {
    if let Some(figure) = chapter2::figure(name) {
        let drawn = figure.draw(args.seeds).map_err(Error::failure)?;
        return Outcome::new(name, &drawn, Some(drawn.picture.clone()));
    }
    if name == "calibration" {
        let table = calibration::run(data().as_deref(), 0, args.seeds).map_err(Error::failure)?;
        return Outcome::new(name, &table, None);
    }
    if name == "graph" {
        let mut selection = graph::Selection::usual(args.seeds);
        if !args.shapes.object.is_empty() {
            selection.objects = args.shapes.object.clone();
        }
        let table = graph::run(&selection).map_err(Error::failure)?;
        return Outcome::new(name, &table, None);
    }
    if name == "memory" {
        let table = memory::run(args.seeds).map_err(Error::failure)?;
        return Outcome::new(name, &table, None);
    }
    let table = match name {
        "figure-3.12" => tracking::run(args.seeds).map_err(Error::failure)?,
        _ => push::run(data().as_deref()).map_err(Error::input)?,
    };
    Outcome::new(name, &table, None)
}
