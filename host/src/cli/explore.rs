//! `tactile explore`: a simulated hand decides where to touch.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};
use tactile_core::explore as core;
use tactile_core::space::{Planar, Spatial};
use tactile_core::wire::WireSpace;

use self::check::check;
use self::stage::Stage;
use self::table::table;
use super::live::{self, Port};
use super::terminal::{Progress, say, tell, tell_report, warn};
use super::view_address::{self, Address};
use super::{Error, closed, files};
use crate::explore::adviser::MOST;
use crate::explore::episode::{self, Event};
use crate::explore::{
    self, Adviser, Board, Candidates, Cost, Criterion, Episode, NextArea, Planning, Until,
};
use crate::graph;
use crate::link::{Patience, Session};
use crate::quantity::{self, Deviation};
use crate::shape::Geometry;
use crate::sim::hand::Articulated;
use crate::sim::{Bench, Hand, ObjectError, ObjectSpec, Options};
use crate::slam::choose::Choice;
use crate::slam::output::{self, Correction, Outcome, Provenance, check_folder, conclude};
use crate::slam::trackers::Kind;
use crate::space::Bridge;

mod check;
mod stage;
mod table;

/// Explore a simulated object: choose a touch, touch, update, until the shape is known
///
/// Writes what slam writes, and log.jsonl, from which slam and replay go on.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: tactile explore --object rectangle:0.10x0.06 --moving --out explored\n         tactile explore --object box:0.12x0.06x0.06 --view   (then open http://127.0.0.1:7332/)"
)]
pub struct ExploreArgs {
    /// What is explored, as in simulate
    #[arg(long, value_parser = object)]
    object: ObjectSpec,
    /// What touches: idealised (fingertips on straight ways), five-finger (an articulated hand in the
    /// proportions of the Shadow hand), or FILE.urdf, your own; articulated hands begin by probing from
    /// every side, and touch solids only
    #[arg(long, value_name = "HAND", default_value = "idealised", value_parser = hand_name)]
    hand: HandName,
    /// The links of a FILE.urdf that are fingertips [default: the last ones with collision geometry]
    #[arg(long, value_name = "LINK", value_delimiter = ',')]
    tips: Vec<String>,
    /// The object stands on a table, where the hand must not meet it
    #[arg(long)]
    table: bool,
    /// What a touch is worth
    #[arg(long, value_enum, default_value_t = Criterion::Information)]
    criterion: Criterion,
    /// Order of the Rényi entropy of --criterion renyi, above 0; 1 is Shannon's [default: 2]
    #[arg(long, value_name = "ALPHA", value_parser = order, allow_negative_numbers = true)]
    alpha: Option<f64>,
    /// Among which grasps it chooses: the same ten every time, new ones, or those that face a contact area
    #[arg(long, value_enum, default_value_t = Kinds::Continuous)]
    candidates: Kinds,
    /// Of --candidates continuous: how many new ones at every choice [default: 120]
    #[arg(long, value_name = "N",
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    count: Option<usize>,
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
          value_parser = quantity::deviation, allow_hyphen_values = true)]
    motion_noise: Deviation,
    /// Standard deviations of contact points and normals, per axis
    #[arg(long, value_name = "LENGTH,ANGLE", default_value = "1mm,5deg",
          value_parser = quantity::deviation, allow_hyphen_values = true)]
    contact_noise: Deviation,
    /// Who follows a moving object
    #[arg(long, value_enum, default_value_t = Kind::Automatic, requires = "moving")]
    tracker: Kind,
    /// What corrects all poses together, after the tracker; planes here from the third grasp on where all
    /// that was felt lies on flat faces, else from the eighth
    #[arg(long, value_enum, default_value_t = graph::Kind::Planes, requires = "moving")]
    graph: graph::Kind,
    /// Let a board choose, by what it makes of the grasps itself: qemu, virtual or tcp:HOST:PORT as in
    /// live. It chooses among at most 16 candidates (--candidates fixed, or --count 16), by information
    /// or variance-sum, one grasp at a time
    #[arg(long, value_name = "PORT", conflicts_with_all = ["batch", "lookahead", "cost"])]
    board: Option<Port>,
    /// What the board runs: hypotheses or bootstrap; the others foresee no contacts, so that they choose
    /// nothing
    #[arg(long, value_enum, default_value_t = Kind::Hypotheses, requires = "board",
          hide_possible_values = true)]
    board_tracker: Kind,
    /// When enough is known: strict (90 % of the surface within 1.8 mm, and known to be), lenient
    /// (3 mm, deviation 2.5 mm), coverage:SHARE (a contact within 5 mm), gain:NATS (no touch promises
    /// more, which a robot can decide without the truth)
    #[arg(long, value_name = "GOAL", default_value = "strict", value_parser = until)]
    until: Until,
    /// How well the last pose must be known besides (95 % within, by the explorer's own account)
    #[arg(long, value_name = "LENGTH,ANGLE", requires = "moving",
          value_parser = quantity::deviation, allow_hyphen_values = true)]
    pose: Option<Deviation>,
    /// When to stop all the same
    #[arg(long, value_name = "N", default_value_t = 60,
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1_000))]
    max_actions: usize,
    /// The same seed gives the same exploration
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Show the exploration in a browser while it runs, and after, until Ctrl-C. Other machines see it
    /// only at an address that they reach, such as 0.0.0.0:7332, and then everyone there does
    #[arg(long, value_name = "[HOST:]PORT", num_args = 0..=1, default_missing_value = "7332")]
    view: Option<Address>,
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

/// A hand as the command line names it.
#[derive(Clone, Debug, PartialEq, Eq)]
enum HandName {
    Idealised,
    FiveFinger,
    File(PathBuf),
}

impl fmt::Display for HandName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            HandName::Idealised => f.write_str("idealised"),
            HandName::FiveFinger => f.write_str("five-finger"),
            HandName::File(file) => file.display().fmt(f),
        }
    }
}

fn hand_name(text: &str) -> Result<HandName, String> {
    match text {
        "idealised" => Ok(HandName::Idealised),
        "five-finger" => Ok(HandName::FiveFinger),
        _ if Path::new(text).extension().is_some_and(|e| e.eq_ignore_ascii_case("urdf")) => {
            Ok(HandName::File(text.into()))
        }
        _ => Err("expected idealised, five-finger or a file ending in .urdf".into()),
    }
}

/// The hand that the arguments mean.
fn hand(name: &HandName, tips: &[String]) -> Result<Hand, Error> {
    let articulated = match name {
        HandName::Idealised | HandName::FiveFinger if !tips.is_empty() => {
            return Err(Error::input("--tips: only a hand from a FILE.urdf takes it"));
        }
        HandName::Idealised => return Ok(Hand::Idealised),
        HandName::FiveFinger => Articulated::five_finger(),
        HandName::File(file) => Articulated::read(file, tips),
    };
    Ok(Hand::Articulated(Arc::new(articulated.map_err(Error::input)?)))
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

impl ExploreArgs {
    fn count(&self) -> usize {
        self.count.unwrap_or(120)
    }

    fn alpha(&self) -> f64 {
        self.alpha.unwrap_or(2.0)
    }

    fn settings(&self) -> explore::Settings {
        explore::Settings {
            criterion: self.criterion,
            candidates: match self.candidates {
                Kinds::Fixed => Candidates::Fixed,
                Kinds::Continuous => Candidates::Continuous(self.count()),
                Kinds::Clusters => Candidates::Clusters(self.area.unwrap_or_default()),
            },
            planning: Planning {
                batch: self.batch,
                lookahead: self.lookahead,
                cost: self.cost,
                alpha: self.alpha(),
            },
            tracker: self.moving.then_some(self.tracker),
            graph: self.graph,
            until: self.until,
            pose: self.pose,
            most_actions: self.max_actions,
            seed: self.seed,
        }
    }
}

/// Explores, writes the results and says what came of it.
///
/// # Errors
/// An object that does not exist or is never met, before anything is written; unwritable results.
pub fn run(args: &ExploreArgs) -> Result<(), Error> {
    check(args)?;
    check_folder(&args.out).map_err(Error::input)?;
    if let Some(file) = files::of(&args.object) {
        files::spare(file, &args.out)?;
    }
    let still = Deviation { length: 0.0, angle: 0.0 };
    let options = Options {
        contact_noise: args.contact_noise,
        motion_noise: if args.moving { args.motion_noise } else { still },
        seed: args.seed,
        ..Options::new(args.object.clone())
    };
    let hand = hand(&args.hand, &args.tips)?;
    let mut bench = Bench::with_hand(options, hand, args.table).map_err(Error::input)?;
    if let Some(doubt) = closed::of(bench.geometry()) {
        warn(format_args!("{}: {doubt}", args.object));
    }
    let settings = args.settings();
    let mut adviser = match &args.board {
        None => None,
        Some(port) if bench.log().dimension == 2 => Some(adviser::<Planar>(args, port)?),
        Some(port) => Some(adviser::<Spatial>(args, port)?),
    };
    let adviser = adviser.as_mut().map(|a| a.as_mut() as &mut dyn Adviser);
    let view = args.view.as_ref().map(Address::open).transpose()?;
    let mut stage = Stage::new(view, &bench, &settings);
    let progress = Progress::new("explore", "actions at most");
    let mut number = 0;
    let episode = explore::explore_advised(&mut bench, &settings, adviser, |event| {
        if let Event::Touched { .. } = event {
            number += 1;
            progress.at(number, args.max_actions);
        }
        stage.show(event);
    })
    .map_err(|error| match error {
        episode::Error::Missed => Error::input(error),
        other => Error::failure(other),
    })?;
    drop(progress);

    let mut outcome = finish(&bench, &settings, &episode)?;
    let view = stage.finish(&mut outcome);
    let is_again = output::begin(&args.out).map_err(Error::failure)?;
    bench.write(&args.out.join("log.jsonl")).map_err(Error::failure)?;
    if is_again && bench.log().dimension == 2 {
        // The true mesh of an earlier run.
        output::remove(&args.out.join("log.ply")).map_err(Error::failure)?;
    }
    let truth = Some(bench.geometry());
    outcome.write(&args.out, bench.log(), truth, &[]).map_err(Error::failure)?;
    let report = outcome.report.to_json().map_err(Error::failure)?;
    let report: Value = serde_json::from_str(&report).map_err(Error::failure)?;
    if args.json {
        let result = result(args, &settings, &episode, report);
        say(serde_json::to_string_pretty(&result).map_err(Error::failure)?)?;
    } else {
        tell(table(&episode.actions))?;
        tell(format_args!(
            "{} after {} actions ({} until {})",
            if episode.reached() { "known" } else { "not known" },
            episode.actions.len(),
            name(args.criterion),
            args.until
        ))?;
        if episode.end == explore::End::NoCandidate {
            tell("no feasible grasp was left: this is what could be felt")?;
        }
        tell_report(&outcome.report)?;
        tell(format_args!("results in {}", args.out.display()))?;
    }
    match view {
        Some(view) => view_address::stay(&view),
        None => Ok(()),
    }
}

/// A board that chooses.
fn adviser<S: Bridge + WireSpace>(
    args: &ExploreArgs,
    port: &Port,
) -> Result<Box<dyn Adviser>, Error> {
    let criterion = match args.criterion {
        Criterion::Information => core::Criterion::Information,
        Criterion::VarianceSum => core::Criterion::VarianceSum,
        other => {
            let other = name(other);
            return Err(Error::Input(format!(
                "--board: expected --criterion information or variance-sum, found {other}"
            )));
        }
    };
    if args.hand != HandName::Idealised {
        return Err(Error::Input(
            "--board: expected --hand idealised, a board knows of straight strokes only".into(),
        ));
    }
    if args.candidates == Kinds::Clusters {
        return Err(Error::Input(format!(
            "--board: expected --candidates fixed or continuous, areas may offer more than {MOST}"
        )));
    }
    if args.candidates == Kinds::Continuous && args.count() > MOST {
        return Err(Error::Input(format!(
            "--board: expected --candidates fixed or --count up to {MOST}, found {}",
            args.count()
        )));
    }
    if !matches!(args.board_tracker, Kind::Hypotheses | Kind::Bootstrap) {
        let tracker = args.board_tracker.name();
        return Err(Error::Input(format!(
            "--board-tracker: expected hypotheses or bootstrap, which foresee contacts, found {tracker}"
        )));
    }
    let link = live::connect(port, args.board_tracker, S::DIMENSION)?;
    let session = Session::<S, _>::open(link, Patience::default()).map_err(Error::failure)?;
    Ok(Box::new(Board::new(session, criterion, args.seed)))
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
        tracking_seconds: episode.tracking,
        graph: settings.tracker.filter(|_| settings.graph != graph::Kind::None).map(|_| {
            Correction {
                seconds: episode.correcting,
                relative: episode.corrected.as_ref().map(|c| &c.relative[..]),
                faces: episode.corrected.as_ref().and_then(|c| c.faces.as_ref()),
            }
        }),
        progress: &|done, all| progress.at(done, all),
    };
    let truth: Option<&Geometry> = Some(bench.geometry());
    conclude(log, truth, episode.steps.clone(), provenance).map_err(Error::failure)
}

/// What was asked for, as on the command line; null is what does not count.
fn options(args: &ExploreArgs) -> Value {
    let of = |kind: Kinds| args.candidates == kind;
    json!({
        "object": args.object.to_string(),
        "hand": args.hand.to_string(),
        "table": args.table,
        "criterion": name(args.criterion),
        "alpha": (args.criterion == Criterion::Renyi).then_some(args.alpha()),
        "candidates": name(args.candidates),
        "count": of(Kinds::Continuous).then_some(args.count()),
        "area": of(Kinds::Clusters).then(|| name(args.area.unwrap_or_default())),
        "batch": args.batch,
        "lookahead": args.lookahead,
        "cost": args.cost.as_ref().map(Cost::to_string),
        "motion_noise": args.moving.then(|| args.motion_noise.to_string()),
        "contact_noise": args.contact_noise.to_string(),
        "tracker": args.moving.then(|| args.tracker.name()),
        "graph": args.moving.then(|| name(args.graph)),
        "board": args.board.as_ref().map(Port::to_string),
        "board_tracker": args.board.as_ref().map(|_| args.board_tracker.name()),
        "until": args.until.to_string(),
        "pose": args.pose.as_ref().map(Deviation::to_string),
        "max_actions": args.max_actions,
        "seed": args.seed,
    })
}

fn result(
    args: &ExploreArgs,
    settings: &explore::Settings,
    episode: &Episode,
    mut report: Value,
) -> Value {
    let actions: Vec<Value> = episode
        .actions
        .iter()
        .map(|a| {
            json!({
                "contacts": a.contacts,
                "refused": a.refused.as_ref().map(ToString::to_string),
                "gain": a.gain,
                "known": a.known,
                "localised": a.localised,
                "choosing_seconds": a.choosing,
                "learning_seconds": a.learning,
            })
        })
        .collect();
    let mut result = Map::new();
    result.insert("actions".into(), episode.actions.len().into());
    result.insert("reached".into(), episode.reached().into());
    result.insert("stuck".into(), (episode.end == explore::End::NoCandidate).into());
    for field in ["surface", "pose", "contacts", "contact_rms_mm"] {
        result.insert(field.into(), report[field].take());
    }
    result.insert("criterion".into(), name(settings.criterion).into());
    result.insert("until".into(), settings.until.to_string().into());
    result.insert("options".into(), options(args));
    result.insert("history".into(), actions.into());
    Value::Object(result)
}

/// As on the command line.
fn name(value: impl ValueEnum) -> String {
    value.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::Placement;
    use crate::explore::episode::Action;
    use crate::space::Pose;

    #[test]
    fn the_last_actions_are_listed_and_all_of_them_drawn() {
        let placement = Placement { hand: Pose::identity(), spread: 1.0 };
        let action = |k: usize| Action {
            placement,
            gain: (k > 0).then_some(1.5),
            choosing: 0.25,
            contacts: 5,
            refused: None,
            known: (k + 1) as f64 / 30.0,
            localised: None,
            learning: 0.0,
        };
        let few: Vec<Action> = (0..2).map(action).collect();
        assert_eq!(
            table(&few),
            "action  contacts    gain  known  choosing\n     1         5       –    3 %    250 ms\n     \
             2         5    1.50    7 %    250 ms\n known  ▅█"
        );
        let many: Vec<Action> = (0..30).map(action).collect();
        let text = table(&many);
        assert!(
            text.contains("…  6 actions before") && text.contains("    30         5"),
            "{text}"
        );
        assert!(!text.contains("\n     6 "), "{text}");
        assert_eq!(text.lines().last().map(|l| l.chars().count()), Some(8 + 30));
    }

    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: ExploreArgs,
    }

    fn line(words: &[&str]) -> Result<Line, clap::Error> {
        Line::try_parse_from([&["explore"][..], words].concat())
    }

    fn refused(words: &[&str]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let line = line(&[words, &["--out", out.to_str().unwrap()][..]].concat()).unwrap();
        let error = run(&line.args).unwrap_err();
        assert!(!out.exists(), "nothing is written");
        error.to_string()
    }

    #[test]
    fn hands_that_make_no_sense_are_explained() {
        let planar = refused(&["--object", "rectangle:0.1x0.06", "--hand", "five-finger"]);
        assert!(planar.contains("closes around solids only"), "{planar}");
        let table = refused(&["--object", "box:0.1x0.06x0.06", "--table"]);
        assert!(table.contains("--table: expected an articulated hand"), "{table}");
        let missing = refused(&["--object", "box:0.1x0.06x0.06", "--hand", "no/such.urdf"]);
        assert!(missing.starts_with("no/such.urdf: cannot read"), "{missing}");
        let tips = ["--object", "box:0.1x0.06x0.06", "--hand", "five-finger", "--tips", "a"];
        assert!(refused(&tips).starts_with("--tips"));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("fist.urdf");
        std::fs::write(&file, "<robot name=\"fist\"><link name=\"palm\"/></robot>").unwrap();
        let none = refused(&["--object", "sphere:0.08", "--hand", file.to_str().unwrap()]);
        assert!(none.contains("no fingertip"), "{none}");
        let unknown = line(&["--object", "sphere:0.08", "--hand", "three-finger"]).unwrap_err();
        assert!(unknown.to_string().contains("five-finger or a file ending in .urdf"), "{unknown}");
    }

    #[test]
    fn the_result_says_what_was_asked_for() {
        let words = "--object rectangle:0.1x0.06 --criterion renyi --alpha 3 --candidates clusters --area gain \
                     --batch 2 --lookahead --cost action=7 --moving --pose 3mm,3deg";
        let options = options(&line(&words.split_whitespace().collect::<Vec<_>>()).unwrap().args);
        assert_eq!(options["candidates"], "clusters");
        assert_eq!((&options["area"], &options["count"]), (&"gain".into(), &Value::Null));
        assert_eq!((&options["batch"], &options["lookahead"]), (&2.into(), &true.into()));
        assert_eq!(options["alpha"], 3.0);
        assert_eq!(options["cost"], "action=7,travel=20,turn=3,miss=5");
        assert_eq!(options["tracker"], "auto");
        assert_eq!((&options["pose"], &options["board"]), (&"3mm,3deg".into(), &Value::Null));
        let still = super::options(&line(&["--object", "sphere:0.08"]).unwrap().args);
        assert_eq!((&still["count"], &still["area"]), (&120.into(), &Value::Null));
        assert!(
            still["tracker"].is_null()
                && still["motion_noise"].is_null()
                && still["alpha"].is_null()
        );
    }

    #[test]
    fn a_hand_from_a_file_explores_and_leaves_a_log() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mine.urdf");
        let text = include_str!("../../assets/hand/five_finger.urdf");
        std::fs::write(&file, text.replace("five_finger", "mine")).unwrap();
        let out = folder.path().join("out");
        let line = line(&[
            "--object",
            "box:0.06x0.06x0.06",
            "--hand",
            file.to_str().unwrap(),
            "--table",
            "--tips",
            "ff_distal,th_distal",
            "--count",
            "10",
            "--max-actions",
            "3",
            "--json",
            "--out",
            out.to_str().unwrap(),
        ]);
        run(&line.unwrap().args).unwrap();
        let log = crate::log::GraspLog::read(&out.join("log.jsonl")).unwrap();
        assert_eq!(log.fingers, ["ff_distal", "th_distal"]);
        assert_eq!(log.grasps.len(), 3);
        // The first is the probing: five touches, and that the object stands on the table.
        assert_eq!(log.grasps[0].contacts.len(), 6);
    }
}
