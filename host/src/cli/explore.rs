//! `tactile explore`: a simulated hand decides where to touch.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};

use super::Error;
use super::terminal::{Progress, note, say, tell, tell_report};
use crate::explore::{self, Candidates, Cost, Criterion, Episode, NextArea, Planning, Until};
use crate::graph;
use crate::quantity::{self, Deviation};
use crate::shape::Geometry;
use crate::sim::{Bench, ObjectError, ObjectSpec, Options};
use crate::slam::choose::Choice;
use crate::slam::output::{Outcome, Provenance, check_folder, conclude};
use crate::slam::trackers::Kind;

/// Explore a simulated object: choose a touch, touch, update, until the shape is known
///
/// Writes what slam writes, and log.jsonl, from which slam and replay go on.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: tactile explore --object rectangle:0.10x0.06 --moving --out explored"
)]
pub struct ExploreArgs {
    /// What is explored, as in simulate
    #[arg(long, value_parser = object)]
    object: ObjectSpec,
    /// What a touch is worth
    #[arg(long, value_enum, default_value_t = Criterion::Information)]
    criterion: Criterion,
    /// Order of the Rényi entropy of --criterion renyi, above 0; 1 is Shannon's
    #[arg(long, value_name = "ALPHA", default_value_t = 2.0, value_parser = order)]
    alpha: f64,
    /// Among which grasps it chooses: the same ten every time, new ones, or those that face a contact area
    #[arg(long, value_enum, default_value_t = Kinds::Continuous)]
    candidates: Kinds,
    /// How many new ones at every choice
    #[arg(long, value_name = "N", default_value_t = 120,
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    count: usize,
    /// Of --candidates clusters: which contact area comes next [default: near]
    #[arg(long, value_enum)]
    area: Option<NextArea>,
    /// Grasps to make before the next decision
    #[arg(long, value_name = "K", default_value_t = 1,
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=20))]
    batch: usize,
    /// Choose each grasp for what can follow it, too
    #[arg(long)]
    lookahead: bool,
    /// Choose by gain per second. What takes how long: action=SECONDS, travel=SECONDS_PER_METRE and
    /// turn=SECONDS_PER_RADIAN from the last grasp, miss=SECONDS where nothing is met; what is left out
    /// as in action=5,travel=20,turn=3,miss=5
    #[arg(long, value_name = "COSTS")]
    cost: Option<Cost>,
    /// The object slips at every grasp, and a tracker follows it
    #[arg(long)]
    moving: bool,
    /// Standard deviations of that slip, per axis of the object
    #[arg(long, value_name = "LENGTH,ANGLE", default_value = "5mm,10deg", requires = "moving",
          value_parser = quantity::deviation)]
    motion_noise: Deviation,
    /// Standard deviations of contact points and normals, per axis
    #[arg(long, value_name = "LENGTH,ANGLE", default_value = "1mm,5deg",
          value_parser = quantity::deviation)]
    contact_noise: Deviation,
    /// Who follows a moving object
    #[arg(long, value_enum, default_value_t = Kind::Hypotheses, requires = "moving")]
    tracker: Kind,
    /// What corrects all poses together, after the tracker
    #[arg(long, value_enum, default_value_t = graph::Kind::None, requires = "moving")]
    graph: graph::Kind,
    /// When enough is known: strict (90 % of the surface within 1.8 mm, and known to be), lenient
    /// (3 mm, deviation 2.5 mm), coverage:SHARE (a contact within 5 mm), gain:NATS (no touch promises
    /// more, which a robot can decide without the truth)
    #[arg(long, value_name = "GOAL", default_value = "strict", value_parser = until)]
    until: Until,
    /// When to stop all the same
    #[arg(long, value_name = "N", default_value_t = 60,
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1_000))]
    max_actions: usize,
    /// The same seed gives the same exploration
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder for the results
    #[arg(long, default_value = "out")]
    out: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Candidates on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kinds {
    /// Ten grasps around the object (thesis 4.5.2)
    Fixed,
    /// Any direction and offset
    Continuous,
    /// Those that face a contact area: an uncertain part of the surface (thesis 4.5.1)
    Clusters,
}

fn object(text: &str) -> Result<ObjectSpec, String> {
    text.parse().map_err(|e: ObjectError| e.to_string())
}

fn order(text: &str) -> Result<f64, String> {
    let alpha = text.parse::<f64>().ok().filter(|a| a.is_finite() && *a > 0.0);
    alpha.ok_or_else(|| format!("expected a number above 0, found {text:?}"))
}

fn until(text: &str) -> Result<Until, String> {
    text.parse()
}

/// Explores, writes the results and says what came of it.
///
/// # Errors
/// An object that does not exist or is never met, before anything is written; unwritable results.
pub fn run(args: &ExploreArgs) -> Result<(), Error> {
    if args.area.is_some() && args.candidates != Kinds::Clusters {
        return Err(Error::input(
            "--area: only --candidates clusters divides the surface into areas",
        ));
    }
    check_folder(&args.out).map_err(Error::input)?;
    let still = Deviation { length: 0.0, angle: 0.0 };
    let mut bench = Bench::new(Options {
        contact_noise: args.contact_noise,
        motion_noise: if args.moving { args.motion_noise } else { still },
        seed: args.seed,
        ..Options::new(args.object.clone())
    })
    .map_err(Error::input)?;
    let settings = explore::Settings {
        criterion: args.criterion,
        candidates: match args.candidates {
            Kinds::Fixed => Candidates::Fixed,
            Kinds::Continuous => Candidates::Continuous(args.count),
            Kinds::Clusters => Candidates::Clusters(args.area.unwrap_or_default()),
        },
        planning: Planning {
            batch: args.batch,
            lookahead: args.lookahead,
            cost: args.cost,
            alpha: args.alpha,
        },
        tracker: args.moving.then_some(args.tracker),
        graph: args.graph,
        until: args.until,
        most_actions: args.max_actions,
        seed: args.seed,
    };
    let mut number = 0;
    let episode = explore::explore(&mut bench, &settings, |action| {
        number += 1;
        if !args.json {
            let gain = action.gain.map_or(String::new(), |g| format!(", promised {g:.2}"));
            note(format_args!(
                "action {number}: {} contacts, {:.0} % known{gain}",
                action.contacts,
                100.0 * action.known
            ));
        }
    })
    .map_err(Error::failure)?;

    let outcome = finish(&bench, &settings, &episode)?;
    outcome.write(&args.out, bench.log(), Some(bench.geometry())).map_err(Error::input)?;
    let log = args.out.join("log.jsonl");
    bench.write(&log).map_err(Error::input)?;
    let report = outcome.report.to_json().map_err(Error::failure)?;
    let report: Value = serde_json::from_str(&report).map_err(Error::failure)?;
    if args.json {
        let result = result(&settings, &episode, report);
        say(serde_json::to_string_pretty(&result).map_err(Error::failure)?);
    } else {
        tell(format_args!(
            "{} after {} actions ({} until {})",
            if episode.reached { "known" } else { "not known" },
            episode.actions.len(),
            name(args.criterion),
            args.until
        ));
        tell_report(&outcome.report);
        tell(format!("results in {}", args.out.display()));
    }
    Ok(())
}

/// The shape of everything felt, judged.
fn finish(
    bench: &Bench,
    settings: &explore::Settings,
    episode: &Episode,
) -> Result<Outcome, Error> {
    let log = bench.log();
    let progress = Progress::new("surface", "local experts");
    let provenance = Provenance {
        title: &log.description,
        tracker: settings.tracker.map_or("known poses", Kind::name),
        surface: Choice::Auto,
        tracking_seconds: 0.0,
        graph: None,
        progress: &|done, all| progress.at(done, all),
    };
    let truth: Option<&Geometry> = Some(bench.geometry());
    conclude(log, truth, episode.steps.clone(), provenance).map_err(Error::failure)
}

fn result(settings: &explore::Settings, episode: &Episode, mut report: Value) -> Value {
    let actions: Vec<Value> = episode
        .actions
        .iter()
        .map(|a| {
            json!({
                "contacts": a.contacts,
                "gain": a.gain,
                "known": a.known,
                "choosing_seconds": a.choosing,
            })
        })
        .collect();
    let mut result = Map::new();
    result.insert("actions".into(), episode.actions.len().into());
    result.insert("reached".into(), episode.reached.into());
    for field in ["surface", "pose", "contacts", "contact_rms_mm"] {
        result.insert(field.into(), report[field].take());
    }
    result.insert("criterion".into(), name(settings.criterion).into());
    result.insert("until".into(), settings.until.to_string().into());
    result.insert("history".into(), actions.into());
    Value::Object(result)
}

/// As on the command line.
fn name(criterion: Criterion) -> String {
    criterion.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned())
}
