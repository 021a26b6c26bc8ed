//! `tactile import`: other people's data as grasp logs.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};

use super::terminal::tell;
use super::{Error, files};
use crate::log::GraspLog;
use crate::log::import::push::{self, FORCE_NOISE, Motion, Normals};
use crate::log::import::{Options, csv, off};
use crate::quantity::{self, Deviation};

/// Make a grasp log of other people's data
#[derive(Debug, Args)]
#[command(after_help = "Example: tactile import csv contacts.csv --unit mm -o contacts.jsonl")]
pub struct ImportArgs {
    #[command(subcommand)]
    source: Source,
}

#[derive(Debug, Subcommand)]
enum Source {
    Push(PushArgs),
    Csv(CsvArgs),
    Off(OffArgs),
}

/// Pushes of a triangular block by a robot (PushExp): one contact at the end of each push
///
/// The log is planar: the world is the robot's base frame without z.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: tactile import push exp_08_11_30.txt --poses noisy --seed 1 -o block.jsonl"
)]
struct PushArgs {
    /// The recording
    file: PathBuf,
    /// How the block moves between grasps
    #[arg(long, value_enum, default_value = "truth")]
    poses: Poses,
    /// Slip between grasps, standard deviations (with --poses noisy) [default: 10mm,20deg]
    #[arg(long, value_name = "LENGTH,ANGLE", value_parser = quantity::deviation,
          allow_hyphen_values = true)]
    motion_noise: Option<Deviation>,
    /// Contacts in a grasp (with --poses noisy) [default: 5]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    group: Option<u8>,
    /// Of the slips and of which contacts make a grasp (with --poses noisy) [default: 0]
    #[arg(long)]
    seed: Option<u64>,
    /// Where the contacts' normals come from
    #[arg(long, value_enum, default_value = "auto")]
    normals: Normals,
    /// The grasp log to write
    #[arg(short, long, value_name = "LOG")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Poses {
    /// As motion capture saw it, one grasp for each push
    Truth,
    /// Contacts of random pushes make grasps of an object that turns by 22.5° from grasp to grasp
    /// and slips
    Noisy,
}

/// A table of contacts: columns x,y[,z][,nx,ny[,nz]][,grasp][,finger][,force] in any order
///
/// The first line names the columns; commas, semicolons or tabs separate them. With z the log is
/// spatial. Rows of a grasp stand together; without a grasp column all rows are one grasp.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: tactile import csv contacts.csv --unit mm --contact-noise 1mm,5deg -o contacts.jsonl"
)]
struct CsvArgs {
    #[command(flatten)]
    points: PointArgs,
}

/// Contact points in an OFF file: one grasp without normals
#[derive(Debug, Args)]
#[command(after_help = "Example: tactile import off measurements.off --fixed -o contacts.jsonl")]
struct OffArgs {
    #[command(flatten)]
    points: PointArgs,
}

#[derive(Debug, Args)]
struct PointArgs {
    /// The file to read
    file: PathBuf,
    /// Unit of the coordinates: m, cm, mm or um
    #[arg(long, default_value = "m", value_parser = quantity::length_unit)]
    unit: f64,
    /// Standard deviations of points and normals
    #[arg(long, value_name = "LENGTH,ANGLE", value_parser = quantity::deviation,
          allow_hyphen_values = true)]
    contact_noise: Option<Deviation>,
    /// Standard deviations of the object's motion between grasps
    #[arg(long, value_name = "LENGTH,ANGLE", value_parser = quantity::deviation,
          allow_hyphen_values = true)]
    motion_noise: Option<Deviation>,
    /// The object did not move: its true poses and motions are the identity
    #[arg(long)]
    fixed: bool,
    /// The grasp log to write
    #[arg(short, long, value_name = "LOG")]
    output: PathBuf,
}

impl PointArgs {
    fn options(&self, what: &str) -> Options {
        Options {
            unit: self.unit,
            contact_noise: self.contact_noise,
            motion_noise: self.motion_noise,
            fixed: self.fixed,
            description: format!("{what} of {}", ending(&self.file)),
        }
    }
}

/// Reads the file, writes the log and says what is in it.
///
/// # Errors
/// When the file cannot be read or is not what it should be, or the log cannot be written.
pub fn run(args: &ImportArgs) -> Result<(), Error> {
    let (file, output) = match &args.source {
        Source::Push(PushArgs { file, output, .. }) => (file, output),
        Source::Csv(CsvArgs { points }) | Source::Off(OffArgs { points }) => {
            (&points.file, &points.output)
        }
    };
    files::apart(file, output, "--output")?;
    let log = match &args.source {
        Source::Push(args) => pushes(args)?,
        Source::Csv(CsvArgs { points }) => {
            csv::import(file, &points.options("contacts")).map_err(Error::input)?
        }
        Source::Off(OffArgs { points }) => {
            off::import(file, &points.options("contact points")).map_err(Error::input)?
        }
    };
    log.write(output).map_err(Error::input)?;
    tell(described(&log, output))
}

fn pushes(args: &PushArgs) -> Result<GraspLog, Error> {
    let motion = match args.poses {
        Poses::Truth => {
            for (given, name) in [
                (args.motion_noise.is_some(), "--motion-noise"),
                (args.group.is_some(), "--group"),
                (args.seed.is_some(), "--seed"),
            ] {
                if given {
                    return Err(Error::Input(format!(
                        "{name} has a meaning only with --poses noisy"
                    )));
                }
            }
            Motion::Recorded
        }
        Poses::Noisy => Motion::Invented {
            noise: args
                .motion_noise
                .unwrap_or(Deviation { length: 0.01, angle: 20f64.to_radians() }),
            group: args.group.unwrap_or(5).into(),
            seed: args.seed.unwrap_or(0),
        },
    };
    let pushes = push::read(&args.file).map_err(Error::input)?;
    let how = match motion {
        Motion::Recorded => "poses by motion capture".to_string(),
        Motion::Invented { noise, group, seed } => format!(
            "real contacts in grasps of {group}, moved by 22.5° and a slip of {noise}, seed {seed}"
        ),
    };
    let description = format!("pushes of a triangular block, {}, {how}", ending(&args.file));
    Ok(push::log(&pushes, &motion, args.normals, &description))
}

/// The file's name and the folder it is in: enough to recognise it, on any machine.
fn ending(path: &Path) -> String {
    let name = path.file_name().map(Path::new).unwrap_or(path);
    let folder = path.parent().and_then(Path::file_name).map(Path::new);
    folder.map_or(name.to_path_buf(), |folder| folder.join(name)).display().to_string()
}

fn described(log: &GraspLog, output: &Path) -> String {
    let contacts = || log.grasps.iter().flat_map(|g| &g.contacts);
    let with_normal = contacts().filter(|c| c.normal.is_some()).count();
    let by_force = contacts().filter(|c| c.normal_noise == Some(FORCE_NOISE)).count();
    let normals = match with_normal {
        0 => "without normals".to_string(),
        n if by_force > 0 => format!("{n} normals, {by_force} of them from the force"),
        n => format!("{n} normals"),
    };
    let (grasps, count) = (log.grasps.len(), contacts().count());
    let plural = if grasps == 1 { "" } else { "s" };
    format!("{}: {grasps} grasp{plural}, {count} contacts, {normals}", output.display())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        import: ImportArgs,
    }

    fn import(words: &[&str]) -> Result<(), String> {
        let line =
            Line::try_parse_from([&["import"], words].concat()).map_err(|e| e.to_string())?;
        run(&line.import).map_err(|e| {
            assert_eq!(e.code(), 2, "{e}");
            e.to_string()
        })
    }

    #[test]
    fn tables_become_logs_or_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).display().to_string();
        std::fs::write(at("a.csv"), "x,y,nx,ny,grasp\n1,2,0,1,0\n3,4,1,0,1\n").unwrap();
        std::fs::write(at("bad.csv"), "x,y\n1,2\n3,four\n").unwrap();
        let noise = ["--contact-noise", "1mm,5deg"];
        let out = at("a.jsonl");
        import(&[&["csv", &at("a.csv"), "--unit", "mm", "-o", &out], &noise[..]].concat()).unwrap();
        let log = GraspLog::read(Path::new(&out)).unwrap();
        assert_eq!((log.grasps.len(), log.noise.point), (2, Some(0.001)));
        assert_eq!(log.grasps[1].contacts[0].point.y, 0.004);
        assert!(log.description.ends_with("a.csv"), "{}", log.description);

        let refused = |words: &[&str], expected: &str| {
            let error = import(words).unwrap_err();
            assert!(error.contains(expected), "{error}");
        };
        let none = at("none.jsonl");
        refused(&["csv", &at("bad.csv"), "-o", &none], "bad.csv, line 3: column `y`");
        refused(&["csv", &at("missing.csv"), "-o", &none], "missing.csv: cannot read");
        refused(&["off", &at("a.csv"), "-o", &none], "expected the word OFF");
        refused(&["push", &at("a.csv"), "-o", &none], "expected the number of pushes");
        refused(&["csv", &at("a.csv"), "-o", &at("no/where.jsonl")], "cannot write: the folder");
        refused(&["csv", &at("a.csv"), "--unit", "deg", "-o", &none], "a unit of length");
        let angle = ["csv", &at("a.csv"), "--contact-noise", "5deg,1mm", "-o", &none];
        refused(&angle, "which is an angle");
        refused(&["push", &at("a.csv"), "--group", "5", "-o", &none], "only with --poses noisy");
        refused(&["push", &at("a.csv"), "--group", "0", "-o", &none], "0 is not in 1..=255");
        refused(&["push", &at("a.csv")], "--output");
        assert!(!Path::new(&none).exists());
    }
}
