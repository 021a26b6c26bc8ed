//! `tactile reproduce`: the thesis' figures and ours.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::PossibleValuesParser;
use serde::Serialize;

use self::part::PartArgs;
use crate::cli::Error;
use crate::cli::terminal::{note, say, warn};
use crate::data;
use crate::experiment::chapter2::{self, FIGURES};
use crate::experiment::figure::{Drawn, FigureError};
use crate::experiment::tracking::{Contender, consistency, mujoco};
use crate::experiment::{
    calibration, chapter3, chapter4, exploration, graphs, localization, memory, outliers, planning,
    pose_graphs, probing, push, sensing, shapes, solids, tracking,
};
use crate::graph;
use crate::log::write::write_atomically;
use crate::quantity::{self, Deviation};
use crate::slam::output::check_folder_for;
use crate::slam::trackers::Kind;
use crate::view::drawing::{Drawing, PictureError};

mod part;

/// Repeat an experiment: the thesis' number, or our goal, beside ours.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  tactile reproduce figure-2.7 --seeds 20 --out figures")]
pub struct ReproduceArgs {
    /// Which: a figure of the thesis, or one of ours; `all` is what takes minutes: the figures of chapter 2,
    /// those of chapter 4 but 4.4 and 4.5, push, and sensing of all three kinds. It leaves out chapter 3,
    /// figures 4.4 and 4.5, the tables, shapes, tracking, tracking-calibration, mujoco, pose-graphs,
    /// pose-graph-outliers, planning, calibration, memory, and solids and its kin
    #[arg(value_parser = PossibleValuesParser::new(names()))]
    name: String,
    /// How many seeds, from 0 on [default: 20; of tracking, tracking-calibration, table-4.2 and table-4.3
    /// 40, of solids and its kin 10, of pose-graphs and pose-graph-outliers 5, of sensing-drift 4 and no more, of
    /// mujoco 1]
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: Option<u64>,
    /// Print the numbers as JSON
    #[arg(long)]
    json: bool,
    /// Also write numbers (JSON) and pictures (SVG and PNG) into this folder
    #[arg(long)]
    out: Option<PathBuf>,
    #[command(flatten)]
    part: PartArgs,
}

impl ReproduceArgs {
    fn seeds(&self) -> u64 {
        self.seeds.unwrap_or(match self.name.as_str() {
            TRACKING | CONSISTENCY => 40,
            name if EXPLORATION.contains(&name) => 40,
            MUJOCO => 1,
            DRIFT => sensing::drift::SEEDS,
            POSE_GRAPHS | POSE_GRAPH_OUTLIERS => 5,
            name if SOLIDS.contains(&name) => 10,
            _ => 20,
        })
    }
}

/// The comparison of all models.
const SHAPES: &str = "shapes";

/// The comparison of all trackers.
const TRACKING: &str = "tracking";

/// Whether trackers know how wrong they are.
const CONSISTENCY: &str = "tracking-calibration";

/// All trackers on recordings of simulated physics.
const MUJOCO: &str = "mujoco";

/// Actions until a shape is known.
const EXPLORATION: [&str; 2] = ["table-4.2", "table-4.3"];

/// Grasps until a spatial object is known.
const SOLIDS: [&str; 3] = ["solids", "solids-moving", "solids-hand"];

/// What planning ahead is worth.
const PLANNING: &str = "planning";

/// The standard pose graphs of the field; seeds are repetitions.
const POSE_GRAPHS: &str = "pose-graphs";

/// The same with false loop closures.
const POSE_GRAPH_OUTLIERS: &str = "pose-graph-outliers";

/// How well a force/torque transducer, and electrodes, feel contacts, and both for an hour.
const WRENCH: &str = "sensing-wrench";
const ELECTRODES: &str = "sensing-electrodes";
const DRIFT: &str = "sensing-drift";

/// What is quick and no figure of the thesis.
const OTHERS: [&str; 5] = ["push", WRENCH, ELECTRODES, DRIFT, probing::NAME];

/// The same every time.
const UNSEEDED: [&str; 4] = ["push", "figure-3.7", "figure-3.20", "figure-3.21"];

/// Not part of `all`, which would take hours with them.
const LONG: [&str; 10] = [
    SHAPES,
    TRACKING,
    CONSISTENCY,
    MUJOCO,
    POSE_GRAPHS,
    POSE_GRAPH_OUTLIERS,
    PLANNING,
    "calibration",
    "memory",
    "table-3.1",
];

fn names() -> Vec<&'static str> {
    let figures = FIGURES.iter().map(|f| f.name);
    let tracked = chapter3::FIGURES.iter().map(|f| f.name);
    let corrected = graphs::FIGURES.iter().map(|f| f.name);
    let solid = solids::figures::FIGURES.iter().map(|f| f.name);
    let explored = chapter4::FIGURES.iter().map(|f| f.name).chain(solid);
    let own = OTHERS.into_iter().chain(LONG).chain(EXPLORATION).chain(SOLIDS);
    figures.chain(tracked).chain(corrected).chain(explored).chain(own).chain(["all"]).collect()
}

/// What an experiment gave: numbers to read, the same for programs, pictures.
struct Outcome {
    name: &'static str,
    text: String,
    json: serde_json::Value,
    picture: Drawing,
}

impl Outcome {
    /// There is none without a picture.
    fn pictured<T: Display + Serialize>(
        name: &'static str,
        numbers: &T,
        picture: Result<Drawing, PictureError>,
    ) -> Result<Outcome, Error> {
        let json = serde_json::to_value(numbers).map_err(Error::failure)?;
        let picture = picture.map_err(Error::failure)?;
        Ok(Outcome { name, text: numbers.to_string(), json, picture })
    }

    fn drawn<N: Display + Serialize>(
        name: &'static str,
        drawn: Result<Drawn<N>, FigureError>,
    ) -> Result<Outcome, Error> {
        let drawn = drawn.map_err(|error| match error {
            FigureError::Recordings(missing) => Error::input(missing),
            other => Error::failure(other),
        })?;
        Outcome::pictured(name, &drawn, Ok(drawn.picture.clone()))
    }

    /// Files that [`Outcome::write`] makes.
    fn files(name: &str) -> [String; 3] {
        ["json", "svg", "png"].map(|kind| format!("{name}.{kind}"))
    }

    fn write(&self, folder: &Path) -> Result<(), Error> {
        let save = |name: &str, content: &[u8]| {
            let path = folder.join(name);
            write_atomically(&path, |w| w.write_all(content))
                .map_err(|e| Error::failure(format!("{}: cannot write: {e}", path.display())))
        };
        let [json, svg, png] = Outcome::files(self.name);
        let numbers = serde_json::to_string_pretty(&self.json).map_err(Error::failure)?;
        save(&json, numbers.as_bytes())?;
        save(&svg, self.picture.svg().as_bytes())?;
        save(&png, &self.picture.png().map_err(Error::failure)?)
    }
}

/// Runs the subcommand.
///
/// # Errors
/// Missing recordings, a folder that cannot be written.
pub fn run(args: &ReproduceArgs) -> Result<(), Error> {
    for (option, takers) in args.part.given() {
        if !takers.contains(&args.name.as_str()) {
            let verb = if takers.len() == 1 { "takes" } else { "take" };
            let takers = takers.join(" and ");
            return Err(Error::input(format!(
                "{option}: only {takers} {verb} it, not {}",
                args.name
            )));
        }
    }
    let fixed = UNSEEDED.contains(&args.name.as_str());
    let most = if args.name == DRIFT { sensing::drift::SEEDS } else { u64::MAX };
    if args.seeds.is_some_and(|seeds| fixed || seeds > most) {
        let what =
            if fixed { "has no chance in it".into() } else { format!("takes at most {most}") };
        return Err(Error::Input(format!("--seeds: {} {what}", args.name)));
    }
    if let Some(first) = args.part.first_seed
        && first.checked_add(args.seeds()).is_none()
    {
        return Err(Error::Input(format!(
            "--first-seed {first}: expected that it and --seeds {} make less than 2^64",
            args.seeds()
        )));
    }
    // Before anything long is begun.
    if let Some(folder) = &args.out {
        let figures = names().into_iter().filter(|name| args.name == "all" || args.name == *name);
        let files: Vec<String> = figures.flat_map(Outcome::files).collect();
        check_folder_for(folder, &files).map_err(Error::input)?;
        std::fs::create_dir_all(folder)
            .map_err(|e| Error::input(format!("{}: cannot write: {e}", folder.display())))?;
    }
    match args.name.as_str() {
        SHAPES => return compare_shapes(args),
        TRACKING | CONSISTENCY => return compare_trackers(args),
        MUJOCO => return follow_recordings(args),
        name if EXPLORATION.contains(&name) => return count_actions(args),
        name if SOLIDS.contains(&name) => return explore_solids(args),
        PLANNING => return plan_ahead(args),
        POSE_GRAPHS => return optimise_graphs(args),
        POSE_GRAPH_OUTLIERS => return spoil_graphs(args),
        _ => (),
    }
    let wanted = |name: &&str| match args.name.as_str() {
        "all" => {
            let slow = chapter3::figure(name).is_some()
                || graphs::figure(name).is_some()
                || solids::figures::figure(name).is_some();
            let long = LONG.contains(name) || EXPLORATION.contains(name) || SOLIDS.contains(name);
            *name != "all" && !long && !slow
        }
        one => one == *name,
    };
    let mut outcomes = Vec::new();
    for name in names().into_iter().filter(wanted) {
        let outcome = match one(name, args) {
            // Without real recordings there is the rest.
            Err(Error::Input(missing)) if args.name == "all" => {
                warn(format_args!("{name} is left out: {missing}"));
                continue;
            }
            outcome => outcome?,
        };
        if !args.json {
            say(&outcome.text)?;
        }
        if let Some(folder) = &args.out {
            outcome.write(folder)?;
        }
        outcomes.push(outcome.json);
    }
    if args.json {
        say(serde_json::to_string_pretty(&outcomes).map_err(Error::failure)?)?;
    }
    Ok(())
}

/// The comparison of all models, row by row as they are done.
fn compare_shapes(args: &ReproduceArgs) -> Result<(), Error> {
    let PartArgs { object, contacts, model, noise, first_seed, outliers, .. } = &args.part;
    let noise = match noise {
        Some(text) => {
            quantity::deviation(text).map_err(|e| Error::input(format!("--noise: {e}")))?
        }
        None => Deviation { length: 1e-3, angle: 5f64.to_radians() },
    };
    let selection = shapes::Selection {
        objects: object.clone(),
        contacts: contacts.clone(),
        models: model.clone(),
        noise,
        outliers: outliers.unwrap_or(0.0),
        seeds: args.seeds(),
        first_seed: first_seed.unwrap_or(0),
    };
    let rows = watch(args, shapes::heading(&selection));
    let table = shapes::run(data::folder().as_deref(), &selection, rows).map_err(Error::input)?;
    if table.rows.is_empty() {
        let why = table.skipped.first().map_or("nothing of that name", String::as_str);
        return Err(Error::Input(format!("--object {}: {why}", object.join(", "))));
    }
    conclude(args, &Outcome::pictured(SHAPES, &table, table.picture())?)
}

/// The comparison of all trackers, row by row as they are done.
fn compare_trackers(args: &ReproduceArgs) -> Result<(), Error> {
    let PartArgs { object, noise, first_seed, tracker, graph, carried, outliers, grasps, .. } =
        &args.part;
    let percent = |part: &str| {
        part.trim()
            .trim_end_matches('%')
            .parse()
            .ok()
            .filter(|v| (0.0..=1000.0).contains(v))
            .ok_or_else(|| {
                Error::input(format!(
                    "--noise: expected percents such as 25,50,100, found {part:?}"
                ))
            })
    };
    let noise = noise.iter().flat_map(|text| text.split(',')).map(percent);
    let selection = tracking::Selection {
        objects: object.clone(),
        noise: noise.collect::<Result<_, _>>()?,
        contenders: tracker.clone(),
        graph: graph.unwrap_or(graph::Kind::None),
        carried: *carried,
        outliers: outliers.unwrap_or(0.0),
        grasps: *grasps,
        seeds: args.seeds(),
        first_seed: first_seed.unwrap_or(0),
    };
    if args.name == CONSISTENCY {
        let rows = watch(args, consistency::heading());
        let table = consistency::run(&selection, rows).map_err(Error::input)?;
        some(&table.rows)?;
        return conclude(args, &Outcome::pictured(CONSISTENCY, &table, table.picture())?);
    }
    let rows = watch(args, tracking::heading());
    let table = tracking::run(&selection, rows).map_err(Error::input)?;
    some(&table.rows)?;
    conclude(args, &Outcome::pictured(TRACKING, &table, table.picture())?)
}

/// Refuses what selects nothing.
fn some<R>(rows: &[R]) -> Result<(), Error> {
    let nothing = "--object, --tracker: nothing of these can be judged so";
    if rows.is_empty() { Err(Error::input(nothing)) } else { Ok(()) }
}

/// All trackers on the recordings, row by row as they are done.
fn follow_recordings(args: &ReproduceArgs) -> Result<(), Error> {
    let PartArgs { object, tracker, graph, .. } = &args.part;
    let selection = mujoco::Selection {
        names: object.clone(),
        contenders: tracker.clone(),
        graph: graph.unwrap_or(graph::Kind::None),
        seeds: args.seeds(),
    };
    let rows = watch(args, mujoco::heading());
    if tracker.iter().any(|contender| matches!(contender, Contender::Bound)) {
        return Err(Error::input("--tracker bound: no recording of mujoco has one"));
    }
    let table = mujoco::run(data::folder().as_deref(), &selection, rows).map_err(Error::input)?;
    conclude(args, &Outcome::pictured(MUJOCO, &table, table.picture())?)
}

/// Actions until the object is known, row by row as they are done.
fn count_actions(args: &ReproduceArgs) -> Result<(), Error> {
    let [fixed, moving] = EXPLORATION;
    let (name, of) = match args.name == fixed {
        true => (fixed, exploration::TableOf::Fixed),
        false => (moving, exploration::TableOf::Moving),
    };
    let first = args.part.first_seed.unwrap_or(0);
    let seeds = first..first.saturating_add(args.seeds());
    let PartArgs { object, tracker, graph, criterion, candidates, until, .. } = &args.part;
    let ours = |contender: &Contender| match contender {
        Contender::Tracker(kind) => Ok(*kind),
        _ => Err(Error::input(format!("--tracker: {name} takes one of ours"))),
    };
    let selection = exploration::Selection {
        objects: object.clone(),
        trackers: tracker.iter().map(ours).collect::<Result<_, _>>()?,
        graph: *graph,
        criteria: criterion.clone(),
        among: candidates.clone(),
        goals: until.clone(),
    };
    let rows = watch(args, exploration::heading());
    let table = exploration::run(of, &selection, seeds, rows).map_err(Error::input)?;
    if table.rows.is_empty() {
        return Err(Error::input(format!(
            "--until, --criterion, --candidates: {name} has no row like this: drawn candidates never repeat, \
             and the pose of what stays where it is is known"
        )));
    }
    conclude(args, &Outcome::pictured(name, &table, table.picture())?)
}

/// Grasps until solids are known, row by row as they are done.
fn explore_solids(args: &ReproduceArgs) -> Result<(), Error> {
    let [fixed, moving, hand] = SOLIDS;
    let PartArgs { object, first_seed, tracker, .. } = &args.part;
    let first = first_seed.unwrap_or(0);
    let seeds = first..first.saturating_add(args.seeds());
    if args.name == hand {
        let rows = watch(args, solids::on_table::heading());
        let table = solids::on_table::run(object, seeds, rows).map_err(Error::input)?;
        return conclude(args, &Outcome::pictured(hand, &table, table.picture())?);
    }
    let (name, moving) = if args.name == fixed { (fixed, None) } else { (moving, Some(tracker)) };
    if tracker.len() > 1 {
        return Err(Error::input("--tracker: solids-moving takes one"));
    }
    let follows = |contender: &Contender| match contender {
        Contender::Tracker(kind) => Ok(*kind),
        _ => Err(Error::input("--tracker: solids-moving takes one of ours")),
    };
    let moving = moving.map(|given| given.first().map_or(Ok(Kind::Hypotheses), follows));
    let selection =
        solids::Selection { objects: object.clone(), seeds, moving: moving.transpose()? };
    let rows = watch(args, solids::heading());
    let table = solids::run(data::folder().as_deref(), &selection, rows).map_err(Error::input)?;
    conclude(args, &Outcome::pictured(name, &table, table.picture())?)
}

/// What planning ahead is worth, row by row as they are done.
fn plan_ahead(args: &ReproduceArgs) -> Result<(), Error> {
    let first = args.part.first_seed.unwrap_or(0);
    let seeds = first..first.saturating_add(args.seeds());
    let rows = watch(args, planning::heading());
    let table = planning::run(&args.part.object, seeds, rows).map_err(Error::input)?;
    conclude(args, &Outcome::pictured(PLANNING, &table, table.picture())?)
}

/// The pose graphs, row by row as they are done.
fn optimise_graphs(args: &ReproduceArgs) -> Result<(), Error> {
    let rows = watch(args, pose_graphs::heading());
    let table = pose_graphs::run(data::folder().as_deref(), &args.part.object, args.seeds(), rows)
        .map_err(Error::input)?;
    conclude(args, &Outcome::pictured(POSE_GRAPHS, &table, table.picture())?)
}

/// The pose graphs with false loop closures, row by row as they are done.
fn spoil_graphs(args: &ReproduceArgs) -> Result<(), Error> {
    let first = args.part.first_seed.unwrap_or(0);
    let seeds = first..first.saturating_add(args.seeds());
    let share = args.part.outliers.map(|part| match (100.0 * part).round() {
        percent if (1.0..=90.0).contains(&percent) => Ok(percent as u32),
        _ => Err(Error::input(format!("--outliers {part}: expected a part from 0.01 to 0.9"))),
    });
    let rows = watch(args, outliers::heading());
    let object = &args.part.object;
    let table = outliers::run(data::folder().as_deref(), object, share.transpose()?, seeds, rows)
        .map_err(Error::input)?;
    conclude(args, &Outcome::pictured(POSE_GRAPH_OUTLIERS, &table, table.picture())?)
}

/// Shows the rows of a long comparison to whoever watches, as they are done.
fn watch<R: Display>(args: &ReproduceArgs, heading: String) -> impl FnMut(&R) {
    let mut heading = (!args.json).then_some(heading);
    let quiet = args.json;
    move |row| {
        if let Some(heading) = heading.take() {
            note(heading);
        }
        if !quiet {
            note(row);
        }
    }
}

/// Prints and writes what came of a comparison.
fn conclude(args: &ReproduceArgs, outcome: &Outcome) -> Result<(), Error> {
    if args.json {
        say(serde_json::to_string_pretty(&outcome.json).map_err(Error::failure)?)?;
    } else {
        say(&outcome.text)?;
    }
    args.out.as_ref().map_or(Ok(()), |folder| outcome.write(folder))
}

fn one(name: &'static str, args: &ReproduceArgs) -> Result<Outcome, Error> {
    if let Some(figure) = chapter2::figure(name) {
        return Outcome::drawn(name, figure.draw(args.seeds()));
    }
    if let Some(figure) = chapter3::figure(name) {
        return Outcome::drawn(name, figure.draw(args.seeds()));
    }
    if let Some(figure) = graphs::figure(name) {
        return Outcome::drawn(name, figure.draw(data::folder().as_deref(), args.seeds()));
    }
    if let Some(figure) = solids::figures::figure(name) {
        return Outcome::drawn(name, figure.draw(args.seeds()));
    }
    if let Some(figure) = chapter4::figure(name) {
        return Outcome::drawn(name, figure.draw(args.seeds()));
    }
    if name == "calibration" {
        let table =
            calibration::run(data::folder().as_deref(), 0, args.seeds()).map_err(Error::failure)?;
        return Outcome::pictured(name, &table, table.picture());
    }
    if name == "memory" {
        let table = memory::run(args.seeds()).map_err(Error::failure)?;
        return Outcome::pictured(name, &table, table.picture());
    }
    if name == "table-3.1" {
        let table =
            localization::run(data::folder().as_deref(), args.seeds()).map_err(Error::failure)?;
        return Outcome::pictured(name, &table, table.picture());
    }
    if name == probing::NAME {
        let figure = probing::run(args.seeds()).map_err(Error::failure)?;
        return Outcome::pictured(name, &figure, Ok(figure.picture.clone()));
    }
    if name == WRENCH {
        let table = sensing::wrench::run(args.seeds()).map_err(Error::failure)?;
        return Outcome::pictured(name, &table, table.picture());
    }
    if name == ELECTRODES {
        let table = sensing::electrodes::run(args.seeds()).map_err(Error::failure)?;
        return Outcome::pictured(name, &table, table.picture());
    }
    if name == DRIFT {
        let hour = sensing::drift::HOUR;
        let table = sensing::drift::run(args.seeds(), hour).map_err(Error::failure)?;
        return Outcome::pictured(name, &table, table.picture());
    }
    let table = push::run(data::folder().as_deref()).map_err(Error::input)?;
    Outcome::pictured(name, &table, table.picture())
}
