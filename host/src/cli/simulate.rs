//! `tactile simulate`: grasp logs of simulated objects.

use std::path::PathBuf;

use clap::Args;

use super::terminal::{tell, warn};
use super::{Error, closed, files};
use crate::log::words::Kind;
use crate::quantity::{self, Deviation, Displacement};
use crate::shape::Geometry;
use crate::sim::objects::KINDS;
use crate::sim::sensed::sense;
use crate::sim::{ObjectSpec, Options, Touch, simulate};

/// Make a grasp log of a simulated object, with its true shape and poses
///
/// Between grasps the object is turned (by 22.5° in the plane, by 30° or 45° in space), which the
/// log says, and slips, which it does not.
#[derive(Debug, Args)]
#[command(after_help = "Lengths are metres unless they carry a unit. The true mesh of a spatial \
    object is written beside the log as NAME.ply.\n\n\
    Example: tactile simulate --object rectangle:0.12x0.06 --seed 1 -o rectangle.jsonl")]
pub struct SimulateArgs {
    #[arg(long, value_parser = object, help = format!("What is touched: {KINDS}"))]
    object: ObjectSpec,
    /// How many grasps [default: 16 in the plane, 20 in space]
    #[arg(long, value_name = "N")]
    grasps: Option<usize>,
    /// Contacts in a grasp; with --touch hand, how many fingers close
    #[arg(long, value_name = "N", default_value_t = 5)]
    contacts: usize,
    /// Where contacts come from
    #[arg(long, value_enum, default_value_t = Touch::Hand)]
    touch: Touch,
    /// Standard deviations of contact points and normals, per axis; of 0 the log says the least that models take, 0.1 mm
    /// and 0.5°
    #[arg(long, value_name = "LENGTH,ANGLE", default_value = "1mm,5deg",
          value_parser = quantity::deviation, allow_hyphen_values = true)]
    contact_noise: Deviation,
    /// Standard deviations of the slip between grasps, per axis of the object; of 0 the log says 0.1 mm and
    /// 0.06°. In space the default is more than the full noise of `reproduce tracking`, 10mm,11.5deg
    #[arg(long, value_name = "LENGTH,ANGLE", default_value = "10mm,20deg",
          value_parser = quantity::deviation, allow_hyphen_values = true)]
    motion_noise: Deviation,
    /// Carry the object so far away before the middle grasp, in any direction, turned so much about any axis.
    /// The hand finds it there, but the log does not say that it was carried
    #[arg(long, value_name = "LENGTH,ANGLE", value_parser = quantity::displacement, allow_hyphen_values = true)]
    carried: Option<Displacement>,
    /// Which part of the contacts is wild: within 30 mm of the surface, with any normal
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0, allow_negative_numbers = true)]
    outliers: f64,
    /// Put sensors into the fingertips: contacts are then those a board's estimators make of their
    /// words, which the log keeps. Takes the place of --contact-noise and --outliers
    #[arg(long, value_enum, value_name = "KIND", conflicts_with_all = ["contact_noise", "outliers"])]
    sensors: Option<Kind>,
    /// The same seed gives the same log
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The grasp log to write
    #[arg(short, long, value_name = "LOG")]
    output: PathBuf,
}

/// clap shows only the message of a parse error.
fn object(text: &str) -> Result<ObjectSpec, String> {
    text.parse().map_err(|e: crate::sim::ObjectError| e.to_string())
}

/// Simulates, writes the log (and the mesh) and says what is in it.
///
/// # Errors
/// When an option is out of range, the object does not exist or is never reached, or the log
/// cannot be written.
pub fn run(args: &SimulateArgs) -> Result<(), Error> {
    if let Some(file) = files::of(&args.object) {
        files::apart(file, &args.output, "--output")?;
    }
    let options = Options {
        object: args.object.clone(),
        grasps: args.grasps,
        contacts: args.contacts,
        touch: args.touch,
        contact_noise: match args.sensors {
            Some(_) => Deviation { length: 0.0, angle: 0.0 },
            None => args.contact_noise,
        },
        motion_noise: args.motion_noise,
        carried: args.carried,
        outliers: args.outliers,
        free: true,
        seed: args.seed,
    };
    let mut simulation = simulate(&options).map_err(Error::input)?;
    if let Some(doubt) = closed::of(&simulation.geometry) {
        warn(format_args!("{}: {doubt}", args.object));
    }
    let mut unfelt = String::new();
    if let Some(kind) = args.sensors {
        let sensed = sense(&mut simulation, kind, args.seed).map_err(Error::input)?;
        unfelt = format!("; {} touches were not felt", sensed.unfelt);
    }
    simulation.write(&args.output).map_err(Error::input)?;
    let grasps = &simulation.log.grasps;
    let contacts: usize = grasps.iter().map(|g| g.contacts.len()).sum();
    let free: usize = grasps.iter().map(|g| g.free.len()).sum();
    let plural = if grasps.len() == 1 { "" } else { "s" };
    tell(format_args!(
        "{}: {} grasp{plural}, {contacts} contacts, {free} free points{unfelt}{}",
        args.output.display(),
        grasps.len(),
        match simulation.geometry {
            Geometry::Outline(_) => "",
            Geometry::Mesh(_) => "; the true mesh is beside it",
        }
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{GraspLog, Noise};
    use clap::Parser;
    use std::path::Path;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        simulate: SimulateArgs,
    }

    fn run_line(words: &str, output: &Path) -> Result<(), String> {
        let words = ["simulate"].into_iter().chain(words.split(' '));
        let words = words.chain(["-o", output.to_str().unwrap()]);
        let line = Line::try_parse_from(words).map_err(|e| {
            assert_eq!(e.exit_code(), 2);
            e.to_string()
        })?;
        run(&line.simulate).map_err(|e| {
            assert_eq!(e.code(), 2);
            e.to_string()
        })
    }

    #[test]
    fn options_reach_the_log() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jsonl");
        run_line("--object hexagon:45mm", &path).unwrap();
        let log = GraspLog::read(&path).unwrap();
        assert_eq!((log.dimension, log.grasps.len()), (2, 16));
        assert_eq!((log.noise.point, log.noise.translation), (Some(0.001), Some(0.01)));
        assert!(log.grasps.iter().map(|g| g.contacts.len()).sum::<usize>() > 60);

        let all = "--object box:0.12x0.06x0.06 --grasps 3 --contacts 40 --touch uniform \
            --contact-noise 2mm,0 --motion-noise 0,0.1rad --carried 0.3m,60deg --outliers 0.05 --seed 9";
        run_line(&all.split_whitespace().collect::<Vec<_>>().join(" "), &path).unwrap();
        let log = GraspLog::read(&path).unwrap();
        assert!(log.grasps.len() == 3 && log.grasps.iter().all(|g| g.contacts.len() == 40));
        assert_eq!((log.noise.point, log.noise.normal), (Some(0.002), Some(Noise::LEAST_NORMAL)));
        assert_eq!(
            (log.noise.translation, log.noise.rotation),
            (Some(Noise::LEAST_TRANSLATION), Some(0.1))
        );
        assert!(log.description.contains("carried 300mm,60deg away"), "{}", log.description);
        assert!(folder.path().join("a.ply").exists());

        let sensed = "--object box:0.12x0.06x0.06 --grasps 3 --sensors electrodes";
        run_line(sensed, &path).unwrap();
        let log = GraspLog::read(&path).unwrap();
        let sensors = crate::log::words::Sensors::of(&log).unwrap().unwrap();
        assert_eq!(sensors.kind, Kind::Electrodes);
        assert!(log.grasps.iter().flat_map(|g| &g.contacts).all(|c| c.force.is_some()));
    }

    #[test]
    fn bad_input_is_named_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jsonl");
        for (words, expected) in [
            ("--object cube:0.1", "unknown object \"cube:0.1\": expected rectangle:WxH"),
            ("--object sphere:0", "above zero"),
            ("--object sphere:5deg", "an angle"),
            ("--object no/such.stl", "no/such.stl: cannot read"),
            ("--object polygon:no/such.csv", "no/such.csv: cannot read"),
            ("--object sphere:0.1 --grasps 0", "--grasps: expected at least 1"),
            ("--object sphere:0.1 --grasps=-3", "'--grasps <N>'"),
            ("--object sphere:0.1 --contacts 6", "at most 5 with --touch hand"),
            ("--object sphere:0.1 --touch foot", "possible values: hand, uniform"),
            ("--object sphere:0.1 --contact-noise 5deg,1mm", "--contact-noise"),
            ("--object sphere:0.1 --motion-noise 10mm", "a length and an angle"),
            ("--object sphere:0.1 --carried=-1m,0deg", "--carried <LENGTH,ANGLE>"),
            ("--object sphere:0.1 --outliers 2", "--outliers: expected a fraction from 0 to 1"),
            ("--object sphere:0.1 --seed x", "--seed"),
            ("--object sphere:0.1 --sensors skin", "possible values: wrench, electrodes"),
            ("--object sphere:0.1 --sensors wrench --outliers 0.1", "cannot be used with"),
            ("--object hexagon:0.05 --sensors wrench", "expected a spatial object"),
            ("--object sphere:0.1 --touch uniform --sensors wrench", "expected --touch hand"),
        ] {
            let error = run_line(words, &path).unwrap_err();
            assert!(error.contains(expected), "{words}: {error}");
        }
        for object in ["sphere:0.1", "hexagon:0.05"] {
            let nowhere = folder.path().join("none/a.jsonl");
            let error = run_line(&format!("--object {object}"), &nowhere).unwrap_err();
            assert!(error.contains("does not exist"), "{error}");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
