//! `tactile localize`: contacts on a known object in, its pose out.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use serde_json::{Value, json};

use crate::cli::terminal::{say, warn};
use crate::cli::{Error, closed, normals, units};
use crate::localize::contacts::{ContactsError, Fixed, read};
use crate::localize::{Freedom, Localization, LocalizeError, Mode, Settings, localize};
use crate::quantity::{self, Deviation};
use crate::shape::files::read_mesh;
use crate::space::{Point, Pose};

/// Find a known object from contacts on it, without a first guess of its pose.
///
/// Poses map the model's frame to the world. Of an object that moved, the pose is that at the last
/// grasp: earlier contacts are carried along by the motions in the log.
///
/// Each pose has its part of the belief, the mean distance of the contacts from the model, and the standard deviation
/// in its least certain direction, turns counted at half the diagonal of the model's box and no more than that.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  tactile localize --model cylinder.off contacts.off --json")]
pub struct LocalizeArgs {
    /// The object: a triangle mesh (.ply, .stl, .obj, .off), metres
    #[arg(long, value_name = "MESH")]
    model: PathBuf,
    /// Where it was touched: a grasp log (.jsonl), a table x,y,z[,nx,ny,nz] (.csv), or points (.off)
    contacts: PathBuf,
    /// The object did not move, whatever the log says
    #[arg(long)]
    fixed: bool,
    /// Leave normals out
    #[arg(long)]
    no_normals: bool,
    /// Standard deviations of contact points and normals, instead of the log's
    #[arg(long, value_name = "LENGTH,ANGLE", value_parser = quantity::deviation,
          allow_hyphen_values = true)]
    contact_noise: Option<Deviation>,
    /// Seed of the search's random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// Files that cannot be read or do not hold what they should; too few contacts.
pub fn run(args: &LocalizeArgs) -> Result<(), Error> {
    let file = args.contacts.display();
    let start = Instant::now();
    let model = read_mesh(&args.model).map_err(Error::input)?;
    if let Some(doubt) = closed::doubt(&model) {
        warn(format_args!("{}: {doubt}", args.model.display()));
    }
    let fixed = if args.fixed { Fixed::Yes } else { Fixed::No };
    if args.contact_noise.is_some_and(|noise| !(noise.length > 0.0 && noise.angle > 0.0)) {
        return Err(Error::Input(
            "--contact-noise: expected a length and an angle above zero".into(),
        ));
    }
    let noise = args.contact_noise;
    let (log, mut contacts) = read(&args.contacts, fixed, noise).map_err(|error| match error {
        ContactsError::Planar | ContactsError::Motion { .. } => {
            Error::Input(format!("{file}: {error}"))
        }
        named => Error::input(named),
    })?;
    if let Some(doubt) = normals::doubt(&log).filter(|_| !args.no_normals) {
        warn(format_args!("{file}: {doubt}"));
    }
    if args.no_normals {
        contacts.iter_mut().for_each(|contact| contact.normal = None);
    }
    let reading = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let settings = Settings { seed: args.seed, ..Settings::default() };
    let found = localize(&model, &contacts, &settings).map_err(|error| match error {
        LocalizeError::NoArea | LocalizeError::InsideOut(_) => {
            Error::Input(format!("{}: {error}", args.model.display()))
        }
        _ => Error::Input(format!("{file}: {error}")),
    })?;
    let seconds = start.elapsed().as_secs_f64();
    let Some(best) = found.modes.first() else {
        return Err(Error::Failure(format!("{file}: no pose was found")));
    };
    let deviations: f64 = contacts.iter().map(|c| c.point_deviation).sum();
    let deviation = deviations / contacts.len() as f64;
    let (low, high) = model.bounds();
    if let Some(doubt) = units::doubt((high - low).norm(), best.mean, deviation) {
        warn(format_args!("{} on {}: {doubt}", args.contacts.display(), args.model.display()));
    }
    if args.json {
        let report = json!({
            "mean_mm": 1e3 * best.mean,
            "seconds": seconds,
            "reading_seconds": reading,
            "contacts": contacts.len(),
            "normals": contacts.iter().filter(|c| c.normal.is_some()).count(),
            "misfit": found.misfit,
            "modes": found.modes.iter().map(mode).collect::<Vec<_>>(),
            "more_modes": found.more,
            "unobservable": found.freedoms.iter().map(freedom).collect::<Vec<_>>(),
            "poses_tried": found.drawn,
        });
        say(serde_json::to_string_pretty(&report).map_err(Error::failure)?)
    } else {
        say(told(&found, best, contacts.len(), seconds, reading).trim_end())
    }
}

fn mode(mode: &Mode) -> Value {
    json!({
        "pose": pose(&mode.pose),
        "weight": mode.weight,
        "deviation_mm": 1e3 * mode.deviation,
        "mean_mm": 1e3 * mode.mean,
    })
}

/// As grasp logs have it.
fn pose(pose: &Pose) -> Value {
    let q = pose.rotation.quaternion();
    json!({"translation": list(&pose.translation.vector), "rotation": [q.i, q.j, q.k, q.w]})
}

fn freedom(freedom: &Freedom) -> Value {
    match freedom {
        Freedom::Shift { along } => json!({"motion": "shift", "axis": list(along)}),
        Freedom::Turn { about, through, pitch } => json!({
            "motion": "turn", "axis": list(about), "through": list(through), "pitch": pitch,
        }),
    }
}

fn list(p: &Point) -> [f64; 3] {
    (*p).into()
}

/// The same for people: the first modes, and what is not known.
fn told(found: &Localization, best: &Mode, contacts: usize, seconds: f64, reading: f64) -> String {
    const SHOWN: usize = 8;
    let mut text = format!(
        "{contacts} contacts lie {:.2} mm from the surface on average; {:.0} ms, after {:.0} ms of \
         reading\n",
        1e3 * best.mean,
        1e3 * seconds,
        1e3 * reading
    );
    if found.misfit > 2.0 {
        let misfit = found.misfit;
        text += &format!("they fit worse than their deviations promise, by a factor {misfit:.1}\n");
    }
    text += "  weight   mean mm   +- mm   x y z mm                     rotation x y z w\n";
    for mode in found.modes.iter().take(SHOWN) {
        let t = 1e3 * mode.pose.translation.vector;
        let q = mode.pose.rotation.quaternion();
        text += &format!(
            "{:>7.1}%{:>10.2}{:>8.1}   {:>8.2} {:>8.2} {:>8.2}   {:>7.4} {:>7.4} {:>7.4} {:>7.4}\n",
            100.0 * mode.weight,
            1e3 * mode.mean,
            1e3 * mode.deviation,
            t.x,
            t.y,
            t.z,
            q.i,
            q.j,
            q.k,
            q.w
        );
    }
    if found.modes.len() > SHOWN {
        let rest = found.modes.len() - SHOWN;
        let more = if found.more { ", and maybe others" } else { "" };
        text += &format!("  and {rest} more (--json lists them){more}\n");
    }
    for freedom in &found.freedoms {
        let (what, axis) = match freedom {
            Freedom::Shift { along } => ("a shift along", along),
            Freedom::Turn { about, .. } => ("a turn about", about),
        };
        text += &format!(
            "not observable: {what} the object's [{:.2}, {:.2}, {:.2}]\n",
            axis.x, axis.y, axis.z
        );
    }
    text
}
