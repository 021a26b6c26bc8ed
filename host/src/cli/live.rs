//! `tactile live`: a grasp log through a board, and what the board made of it.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use tactile_core::space::{Planar, Spatial};
use tactile_core::wire::{Hello, WireSpace};

use self::record::Target;
use self::watch::Watch;
use super::bundled::Bundled;
use super::slam::Input;
use super::terminal::{Progress, note, say, tell, tell_report, warn};
use super::view_address::Address;
use super::{Error, files};
use crate::graph::{self, joint};
use crate::link::firmware::{self, Machine};
use crate::link::lesson::Lesson;
use crate::link::qemu::Qemu;
use crate::link::session::{SensedError, settings_for, steps};
use crate::link::tcp::Tcp;
use crate::link::{GraspOutcome, Link, LogOutcome, Patience, Session, virtual_board};
use crate::log::inspection::capacity;
use crate::log::recording::Header;
use crate::log::words::{Sensors, Words, WordsError};
use crate::log::{GraspLog, LoggedContact};
use crate::slam::choose::Choice;
use crate::slam::output::{self, Provenance, conclude};
use crate::slam::track::Step;
use crate::slam::trackers::Kind;
use crate::space::{Bridge, Point};

mod record;
mod watch;

/// Emulators end after this long, whatever happens.
const EMULATOR_LIMIT: Duration = Duration::from_secs(3600);
const CONNECT: Duration = Duration::from_secs(5);

/// Feed a grasp log through a board and reconstruct the object from its estimates.
///
/// The board runs the tracker; surface, report and picture are made here, as by `tactile slam`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  tactile live --port qemu --log ellipse.jsonl --record ellipse.tac --out live\n  tactile live --port virtual --pace 0.5 --view   (then open http://127.0.0.1:7332/)\n\n\
    Ports: qemu builds the firmware and starts it on an emulated STM32F405; virtual is the same code \
    in this process; tcp:HOST:PORT is a board behind a socket, for a serial port for example \
    `socat TCP-LISTEN:7000,reuseaddr FILE:/dev/ttyACM0,b115200,raw,echo=0` and tcp:127.0.0.1:7000."
)]
pub struct LiveArgs {
    /// qemu, virtual or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Port,
    /// Grasp log to feed; without one, a bundled recording
    #[arg(long, value_name = "LOG")]
    log: Option<PathBuf>,
    /// Which of the bundled recordings
    #[arg(long, value_enum, value_name = "NAME", default_value_t, conflicts_with = "log")]
    bundled: Bundled,
    /// Write all frames, both ways, to this recording (.tac); an old one stays if no board answers
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// What the board runs; a board behind tcp must have been built so [default: auto; hypotheses
    /// with --graph or --sensors; of a board behind tcp whatever it was built with]
    #[arg(long, value_enum)]
    tracker: Option<Kind>,
    /// Seed of the board's random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Show the session in a browser while it runs, and after, until Ctrl-C. Other machines see it
    /// only at an address that they reach, such as 0.0.0.0:7332, and then everyone there does
    #[arg(long, value_name = "[HOST:]PORT", num_args = 0..=1, default_missing_value = "7332")]
    view: Option<Address>,
    /// Seconds to wait between grasps: a log is faster than a hand
    #[arg(long, value_name = "SECONDS", default_value = "0", value_parser = pace,
          allow_negative_numbers = true)]
    pace: Duration,
    /// Correct all poses together and teach the board what came of it, from eight grasps on, and once
    /// more at the end; only the tracker hypotheses can be taught
    #[arg(long, value_enum, default_value_t = Correction::None)]
    graph: Correction,
    /// Grasps between two corrections
    #[arg(long, value_name = "N", default_value_t = 4, requires = "graph",
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1000))]
    correct_every: usize,
    /// Show the board's fingertips the raw words in the log (of simulate --sensors) instead of telling
    /// it the contacts: it estimates them itself, and is told those without words. Takes the image
    /// spatial-sensing, whose sensors are scripted, and whose tracker is hypotheses
    #[arg(long, conflicts_with = "graph")]
    sensors: bool,
    /// Folder for the results
    #[arg(long, default_value = "out")]
    out: PathBuf,
    /// Print the report, and what the board says of itself, as JSON
    #[arg(long)]
    json: bool,
}

impl LiveArgs {
    /// What the board has to run; `None` where it may be anything.
    fn wanted(&self) -> Option<Kind> {
        let is_faced = self.sensors || self.graph != Correction::None;
        match &self.port {
            _ if self.tracker.is_some() => self.tracker,
            _ if is_faced => Some(Kind::Hypotheses),
            Port::Tcp(_) => None,
            Port::Qemu | Port::Virtual => Some(Kind::Automatic),
        }
    }
}

/// Who the report says followed the object.
fn on_board(tracker: Kind) -> String {
    format!("{} on the board", tracker.name())
}

/// Corrections that a board can be taught.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Correction {
    /// Poses and flat faces estimated together
    Planes,
    /// None
    None,
}

/// Where the board is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Port {
    /// In an emulator that this program starts.
    Qemu,
    /// In this process.
    Virtual,
    /// Behind a socket: host:port.
    Tcp(String),
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Port::Qemu => f.write_str("qemu"),
            Port::Virtual => f.write_str("virtual"),
            Port::Tcp(address) => write!(f, "tcp:{address}"),
        }
    }
}

impl FromStr for Port {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected qemu, virtual or tcp:HOST:PORT, found `{text}`");
        match text.split_once(':') {
            None if text == "qemu" => Ok(Port::Qemu),
            None if text == "virtual" => Ok(Port::Virtual),
            Some(("tcp", address)) => match address.rsplit_once(':') {
                Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => {
                    Ok(Port::Tcp(address.to_owned()))
                }
                _ => Err(expected()),
            },
            _ => Err(expected()),
        }
    }
}

/// Seconds between grasps.
fn pace(text: &str) -> Result<Duration, String> {
    let seconds = text.parse::<f64>().ok().filter(|s| (0.0..=3600.0).contains(s));
    seconds
        .map(Duration::from_secs_f64)
        .ok_or_else(|| format!("expected seconds from 0 to 3600, found `{text}`"))
}

/// Points in frames are no further from the origin than this, metres: micrometres in 32 bits.
const FURTHEST: f64 = i32::MAX as f64 * 1e-6;

/// Refuses points that a frame cannot hold.
fn fits_frames(log: &GraspLog) -> Result<(), String> {
    let fits = |p: &Point| p.amax() <= FURTHEST;
    for grasp in &log.grasps {
        let points =
            grasp.contacts.iter().map(|c| c.point).chain(grasp.free.iter().map(|f| f.point));
        if let Some(p) = points.into_iter().find(|p| !fits(p)) {
            return Err(format!(
                "grasp {}: expected points within ±2147 m, which is what frames to a board can say, found \
                 [{}, {}, {}]",
                grasp.index, p.x, p.y, p.z
            ));
        }
    }
    Ok(())
}

/// Runs the subcommand.
///
/// # Errors
/// Bad input before a board is touched; a board that does not answer; unwritable results.
pub fn run(args: &LiveArgs) -> Result<(), Error> {
    if let Some(other) = args.tracker.filter(|t| *t != Kind::Hypotheses)
        && args.graph != Correction::None
    {
        let name = other.name();
        return Err(Error::Input(format!(
            "--graph: expected --tracker hypotheses; a board cannot teach {name} another's belief"
        )));
    }
    if let (Some(log), Some(record)) = (&args.log, &args.record) {
        files::apart(log, record, "--record")?;
    }
    if let Some(record) = &args.record {
        files::beside(record, "--record", &args.out)?;
    }
    let input = Input::open(args.log.as_deref(), args.bundled, &args.out)?;
    let Input { log, name, truth } = &input;
    if let Some(record) = &args.record {
        files::apart_from_truth(log, record, "--record")?;
    }
    fits_frames(log).map_err(|e| Error::Input(format!("{name}: {e}")))?;
    let sensors = sensors(args, log).map_err(|e| Error::Input(format!("{name}: {e}")))?;
    let sensors = sensors.as_ref();
    let expected = match args.wanted() {
        Some(tracker) => on_board(tracker),
        None => "the board's own".into(),
    };
    let watch = args.view.as_ref().map(|at| Watch::open(at, &input, &expected)).transpose()?;
    let watch = watch.as_ref();
    let fed = if log.dimension == 2 {
        feed::<Planar>(args, log, sensors, watch)
    } else {
        feed::<Spatial>(args, log, sensors, watch)
    }?;
    let (title, tracker) = (input.title(), on_board(fed.tracker));
    let start = Instant::now();
    let corrected = match args.graph {
        Correction::Planes => graph::Kind::Planes.correct(log, &fed.steps),
        Correction::None => None,
    };
    let graph_seconds = start.elapsed().as_secs_f64() + fed.teaching;
    let (steps, relative, faces) = match corrected {
        Some(graph::Corrected { steps, relative, faces }) => (steps, Some(relative), faces),
        None => (fed.steps, None, None),
    };
    let progress = Progress::new("surface", "local experts");
    let provenance = Provenance {
        title,
        tracker: &tracker,
        surface: Choice::Auto,
        tracking_seconds: fed.seconds,
        graph: (args.graph != Correction::None).then_some(output::Correction {
            seconds: graph_seconds,
            relative: relative.as_deref(),
            faces: faces.as_ref(),
        }),
        progress: &|done, all| progress.at(done, all),
    };
    let outcome = conclude(log, truth.as_ref(), steps, provenance)
        .map_err(|e| Error::Input(format!("{name}: {e}")))?;
    drop(progress);
    if let Some(watch) = watch {
        watch.finish(&outcome);
    }
    input.write(&outcome, &args.out, &[])?;
    if args.json {
        let report = outcome.report.to_json().map_err(Error::failure)?;
        let mut report: Value = serde_json::from_str(&report).map_err(Error::failure)?;
        if let Some(fields) = report.as_object_mut() {
            fields.insert("board".into(), fed.board);
        }
        say(serde_json::to_string_pretty(&report).map_err(Error::failure)?)?;
    } else {
        tell(fed.text)?;
        if args.port == Port::Qemu {
            tell("               (the emulator's clock: not the time the chip takes)")?;
        }
        tell_report(&outcome.report)?;
        tell(format_args!("results in {}", args.out.display()))?;
    }
    match watch {
        Some(watch) => watch.stay(),
        None => Ok(()),
    }
}

/// What came back.
struct Fed {
    /// What the board runs.
    tracker: Kind,
    steps: Vec<Step>,
    seconds: f64,
    /// Seconds of them that the corrections took.
    teaching: f64,
    board: Value,
    text: String,
}

/// What the log says of the sensors, where it is wanted.
fn sensors(args: &LiveArgs, log: &GraspLog) -> Result<Option<Sensors>, Error> {
    if !args.sensors {
        return Ok(None);
    }
    if let Some(other) = args.tracker.filter(|t| *t != Kind::Hypotheses) {
        let name = other.name();
        return Err(Error::Input(format!(
            "--sensors: expected --tracker hypotheses, no image with sensors carries {name}"
        )));
    }
    let sensors = Sensors::of(log).map_err(Error::input)?;
    let none = || Error::Input("no raw words; `tactile simulate --sensors` records them".into());
    let sensors = sensors.ok_or_else(none)?;
    // What an estimator refuses here a board would refuse without saying why.
    (0..sensors.rest.len())
        .try_for_each(|finger| sensors.estimator(finger).map(drop))
        .map_err(Error::input)?;
    for grasp in &log.grasps {
        let unreadable = |e| Error::Input(format!("grasp {}: {e}", grasp.index));
        grasp.contacts.iter().try_for_each(|c| readable(&sensors, c)).map_err(unreadable)?;
    }
    Ok(Some(sensors))
}

/// Whether what a contact's sensor read can be shown to a board.
fn readable(sensors: &Sensors, contact: &LoggedContact) -> Result<(), WordsError> {
    let Some((finger, words)) = contact.finger.zip(Words::of(contact)?) else { return Ok(()) };
    words.words.iter().try_for_each(|reading| sensors.on_wire(finger, reading).map(drop))
}

fn feed<S: Bridge + WireSpace>(
    args: &LiveArgs,
    log: &GraspLog,
    sensors: Option<&Sensors>,
    watch: Option<&Watch<'_>>,
) -> Result<Fed, Error> {
    let file = args.record.as_deref().map(Target::open).transpose()?;
    let link = match (sensors, &args.port) {
        (Some(_), Port::Virtual) => Ok(virtual_board::start_sensing()),
        (Some(_), Port::Qemu) => emulate_sensing(),
        _ => connect(&args.port, args.wanted().unwrap_or(Kind::Automatic), S::DIMENSION),
    }?;
    match &file {
        None => converse::<S>(link, log, sensors, args, watch),
        Some(file) => {
            let header = Header::new(log.dimension, log.fingers.clone(), log.description.clone());
            let recorded = file.record::<S, _>(link, &header).map_err(Error::failure)?;
            converse::<S>(recorded, log, sensors, args, watch)
        }
    }
}

/// Reaches the board that follows objects so, or starts one.
pub(super) fn connect(
    port: &Port,
    tracker: Kind,
    dimension: usize,
) -> Result<Box<dyn Link>, Error> {
    let name = tracker.name();
    let none = || Error::Input(format!("--tracker {name}: no board carries it in {dimension}D"));
    let tracker = tracker.on_board();
    match port {
        Port::Virtual => virtual_board::start(dimension, tracker).ok_or_else(none),
        Port::Tcp(address) => Tcp::connect(address, CONNECT)
            .map(|link| Box::new(link) as Box<dyn Link>)
            .map_err(|e| Error::Failure(format!("tcp:{address}: {e}"))),
        Port::Qemu => {
            note("building the firmware (a minute the first time) and starting QEMU");
            Qemu::build_and_start(dimension, tracker, EMULATOR_LIMIT)
                .map(|link| Box::new(link) as Box<dyn Link>)
                .map_err(Error::failure)
        }
    }
}

/// An emulated board whose fingertips have scripted sensors.
fn emulate_sensing() -> Result<Box<dyn Link>, Error> {
    note("building the firmware (a minute the first time) and starting QEMU");
    let machine = Machine::Stm32f405;
    let elf = firmware::build(firmware::SENSING, machine).map_err(Error::failure)?;
    let board = Qemu::start(&elf, machine, EMULATOR_LIMIT).map_err(Error::failure)?;
    Ok(Box::new(board))
}

fn converse<S: Bridge + WireSpace>(
    link: impl Link,
    log: &GraspLog,
    sensors: Option<&Sensors>,
    args: &LiveArgs,
    watch: Option<&Watch<'_>>,
) -> Result<Fed, Error> {
    let start = Instant::now();
    let session = Session::<S, _>::open(link, Patience::default()).map_err(Error::failure)?;
    if let Some(wanted) = args.wanted()
        && let Some(hello) = session.hello().filter(|h| h.tracker != wanted.on_board())
    {
        let (name, found) = (wanted.name(), Kind::of_board(hello.tracker).name());
        return Err(Error::Failure(format!("--tracker {name}: the board was built with {found}")));
    }
    let (mut lessons, mut teaching) = (0, 0.0);
    let progress = Progress::new("board", "grasps");
    let seen = |number: usize, outcome: &GraspOutcome<S>| {
        progress.at(number + 1, log.grasps.len());
        if let Some((watch, step)) = watch.zip(outcome.step()) {
            watch.grasp(number, step);
        }
        if number + 1 < log.grasps.len() {
            std::thread::sleep(args.pace);
        }
    };
    let after = |number: usize, hello: &Hello, outcomes: &[GraspOutcome<S>]| {
        if let Some(last) = outcomes.last() {
            seen(number, last);
        }
        let done = number + 1;
        let due = done < log.grasps.len() && done.is_multiple_of(args.correct_every);
        if args.graph == Correction::None || !due {
            return None;
        }
        let start = Instant::now();
        let mut known = log.clone();
        known.grasps.truncate(done);
        let corrected = joint::correct(&known, &steps(outcomes));
        let room = usize::from(hello.map);
        let lesson = corrected.and_then(|c| Lesson::new(&known, &c, room));
        teaching += start.elapsed().as_secs_f64();
        lessons += usize::from(lesson.is_some());
        lesson
    };
    let settings = settings_for(log, args.seed);
    let run = || match sensors {
        None => session.run_taught(log, settings, after).map_err(Error::failure),
        Some(sensors) => {
            session.run_sensed(log, sensors, settings, &seen).map_err(|error| match error {
                SensedError::Session(error) => Error::failure(error),
                error => Error::input(error),
            })
        }
    };
    let outcome = match watch {
        Some(watch) => watch.beside(run),
        None => run(),
    }?;
    let seconds = start.elapsed().as_secs_f64() - teaching;
    for (count, what) in left_out(&outcome).into_iter().zip(["contacts", "free points"]) {
        if count > 0 {
            let room = outcome.hello.contacts;
            warn(format_args!("{count} {what} beyond {room} in a grasp are left out"));
        }
    }
    let mut board = figures(&outcome);
    let mut text = words(&outcome);
    if sensors.is_some() {
        let felt: usize = outcome.grasps.iter().map(|g| g.felt.len()).sum();
        let logged: usize = log.grasps.iter().map(|g| g.contacts.len()).sum();
        let shown = outcome.shown;
        if felt == 0 && shown > 0 {
            return Err(Error::Failure(format!(
                "the board felt none of the {shown} contacts whose words it was shown: expected those of \
                 fingertips as `sensors` in the log's header says"
            )));
        }
        for (count, what) in [
            (
                logged.saturating_sub(shown),
                "are told as the log has them: without words, or of no finger with sensors",
            ),
            (shown.saturating_sub(felt), "were shown, but not felt: the poses do without them"),
        ] {
            if count > 0 {
                warn(format_args!("{count} of {logged} contacts {what}"));
            }
        }
        if let Some(fields) = board.as_object_mut() {
            fields.insert("felt".into(), felt.into());
        }
        text += &format!("\nfelt           {felt} of {logged} contacts by the board's own sensors");
    }
    if args.graph != Correction::None {
        if let Some(fields) = board.as_object_mut() {
            fields.insert("lessons".into(), lessons.into());
        }
        text += &format!("\ntaught         {lessons} times what the graph found");
    }
    let tracker = Kind::of_board(outcome.hello.tracker);
    Ok(Fed { tracker, steps: outcome.steps(), seconds, teaching, board, text })
}

/// Contacts and free points that a grasp had no room for.
fn left_out<S: WireSpace>(outcome: &LogOutcome<S>) -> [usize; 2] {
    let grasps = &outcome.grasps;
    [grasps.iter().map(|g| g.not_sent).sum(), grasps.iter().map(|g| g.free_not_sent).sum()]
}

fn figures<S: WireSpace>(outcome: &LogOutcome<S>) -> Value {
    let hello = &outcome.hello;
    let [major, minor, patch] = hello.firmware;
    let health = outcome.grasps.last().map(|g| g.health);
    let [contacts, free] = left_out(outcome);
    json!({
        "board": format!("{:?}", hello.board),
        "tracker": format!("{:?}", hello.tracker),
        "firmware": format!("{major}.{minor}.{patch}"),
        "capacity": { "grasp": hello.contacts, "map": hello.map, "particles": hello.particles },
        "frames": outcome.received.frames, "damaged": outcome.received.damaged(),
        "repeated": outcome.repeated, "contacts_not_sent": contacts, "free_points_not_sent": free,
        "health": health.map(|h| json!({
            "frames": h.received.frames, "damaged": h.received.damaged(), "overruns": h.overruns,
            "refused": h.refused, "peak_stack": h.peak_stack, "stack": h.stack,
            "worst_update_us": h.worst_update,
        })),
    })
}

fn words<S: WireSpace>(outcome: &LogOutcome<S>) -> String {
    let hello = &outcome.hello;
    let [major, minor, patch] = hello.firmware;
    let mut text = format!(
        "board          {:?}, firmware {major}.{minor}.{patch}: {:?}, {}\n\
         link           {} frames from the board, {} damaged, {} sent again",
        hello.board,
        hello.tracker,
        capacity(hello),
        outcome.received.frames,
        outcome.received.damaged(),
        outcome.repeated
    );
    if let Some(health) = outcome.grasps.last().map(|g| g.health) {
        if health.stack > 0 {
            text += &format!("\nstack          {} of {} B", health.peak_stack, health.stack);
        }
        text += &format!(
            "\nupdate         at most {:.1} ms by the board's clock",
            f64::from(health.worst_update) / 1e3
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_frames_cannot_say_are_refused() {
        let at = |x: f64| {
            let log = format!(
                "{{\"format\":\"tactile-grasp-log\",\"version\":1,\"dimension\":2,\"frame\":\"world\"}}\n\
                 {{\"grasp\":7,\"contacts\":[{{\"point\":[0,0]}}],\"free\":[{{\"point\":[0,{x}]}}]}}\n"
            );
            fits_frames(&GraspLog::parse(log.as_bytes(), std::path::Path::new("x")).unwrap())
        };
        assert_eq!(at(-2147.48), Ok(()));
        let error = at(-2147.49).unwrap_err();
        assert!(error.contains("grasp 7: expected points within ±2147 m"), "{error}");
    }

    #[test]
    fn paces_are_read_strictly() {
        assert_eq!(pace("0.25"), Ok(Duration::from_millis(250)));
        for bad in ["", "-1", "NaN", "inf", "1e9", "1s"] {
            assert!(pace(bad).unwrap_err().contains("expected seconds"), "{bad}");
        }
    }

    #[test]
    fn ports_are_read_strictly() {
        assert_eq!("qemu".parse(), Ok(Port::Qemu));
        assert_eq!("virtual".parse(), Ok(Port::Virtual));
        assert_eq!("tcp:localhost:7000".parse(), Ok(Port::Tcp("localhost:7000".into())));
        for bad in
            ["", "tcp", "tcp:7000", "tcp::7000", "tcp:host:x", "serial:/dev/ttyACM0", "qemu:1"]
        {
            assert!(bad.parse::<Port>().unwrap_err().contains("expected qemu"), "{bad}");
        }
    }
}
