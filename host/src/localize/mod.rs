//! Where a known object is, from contacts alone: all six degrees of freedom, without a first guess
//! (thesis chapter 3, Table 3.1: "global localization of a fixed object").
//!
//! | part | module |
//! |---|---|
//! | the distance of a contact from the surface | [`grid`] while searching, [`exact`] at the end |
//! | how likely contacts are at a pose, Gauss–Newton steps | `likelihood` |
//! | poses worth a look | `proposals` |
//! | the search: scaling series (Petrovskaya & Khatib 2011) | `search` |
//! | modes and their weights | `modes` |
//! | motions that the contacts do not see | [`freedom`] |
//! | contacts from files | [`contacts`] |
//! | the mesh, with smooth normals | [`faces`](mod@faces) |

pub mod contacts;
pub mod exact;
pub mod faces;
pub mod freedom;
pub mod grid;
mod likelihood;
mod modes;
mod proposals;
mod search;
#[cfg(test)]
mod tests;

use crate::reference::Contact;
use crate::shape::Mesh;
use crate::shape::symmetry::Symmetry;
use crate::space::{Point, Pose};

pub use exact::Exact;
pub use freedom::Freedom;
pub use grid::Grid;

use faces::faces;
use likelihood::Evidence;
use proposals::Proposals;

/// Contacts below which a pose is not worth asking for.
pub const LEAST_CONTACTS: usize = 3;

/// What is nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Metres; of either sign where it is extrapolated through the surface.
    pub distance: f64,
    /// Of the distance, a unit vector.
    pub gradient: Point,
    /// Where the surface keeps more about it, see [`Surface::normal`].
    pub place: usize,
}

/// Something that contacts can be near to.
pub trait Surface: Sync {
    /// What is nearest to `point`, object frame.
    fn near(&self, point: &Point) -> Near;
    /// The surface's outward unit normal where it is nearest to `point`.
    fn normal(&self, near: &Near, point: &Point) -> Point;
}

/// How hard to search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// The same seed gives the same answer.
    pub seed: u64,
    /// Rounds of the search at most; it ends before when some in a row bring nothing better.
    pub rounds: usize,
    /// Optima kept while searching.
    pub optima: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { seed: 0, rounds: 16, optima: 128 }
    }
}

/// One place where the object may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Object to world.
    pub pose: Pose,
    /// Its part of the belief.
    pub weight: f64,
    /// Standard deviation of the pose in its least certain direction, turns counted at the object's
    /// radius (half of its bounding box's diagonal), metres; never more than that radius.
    pub deviation: f64,
    /// Mean distance of all contacts from the surface, metres.
    pub mean: f64,
    /// Negative logarithm of the likelihood, zero for contacts that fit exactly; to be divided by
    /// [`Localization::misfit`].
    pub nats: f64,
}

/// Where a known object is.
#[derive(Clone, Debug, PartialEq)]
pub struct Localization {
    /// Heaviest first; weights sum to one. At least one.
    pub modes: Vec<Mode>,
    /// Motions from the first mode that the contacts cannot tell from none.
    pub freedoms: Vec<Freedom>,
    /// By what factor the contacts cost more, in nats, than their stated deviations promise; at
    /// least one.
    pub misfit: f64,
    /// Poses looked at.
    pub drawn: usize,
    /// Whether there may be more modes than are listed.
    pub more: bool,
}

/// Why there is no answer.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LocalizeError {
    /// Too few contacts.
    #[error("expected at least {LEAST_CONTACTS} contacts, found {0}")]
    FewContacts(usize),
    /// A coordinate, normal or deviation cannot be used.
    #[error("contact {0}: expected finite numbers, a normal of length one and positive deviations")]
    Contact(usize),
    /// The search is to do nothing.
    #[error("expected at least one {0} of the search, found none")]
    Effort(&'static str),
    /// There is no surface to touch.
    #[error("the model's triangles have no area")]
    NoArea,
    /// Measured normals would all fit the wrong side.
    #[error(
        "the model is inside out: its triangles, counter-clockwise from inside, enclose {0:.3} litres"
    )]
    InsideOut(f64),
}

/// Finds the object with the surface `model` from contacts on it, world frame.
///
/// The answer is the likeliest pose, not the one of least *mean* distance: contacts that fit as well
/// as they say are better averaged by least squares, and the least mean would rest six of them
/// exactly on the surface. Where contacts are many deviations off, the two come to the same, see the
/// cost in `likelihood`. [`Mode::mean`] is the mean distance at the likeliest pose.
///
/// # Errors
/// [`LocalizeError`].
///
/// ```
/// use tactile_host::localize::{Settings, localize};
/// use tactile_host::shape::Mesh;
/// use tactile_host::sim::{ObjectSpec, Touch, simulate};
/// use tactile_host::localize::contacts::{Fixed, from_log};
///
/// let object: ObjectSpec = "lshape:0.09x0.07x0.03x0.05".parse()?;
/// let options = tactile_host::sim::Options {
///     grasps: Some(1), contacts: 20, touch: Touch::Uniform, ..tactile_host::sim::Options::new(object)
/// };
/// let simulated = simulate(&options)?;
/// let contacts = from_log(&simulated.log, Fixed::No)?;
/// let tactile_host::shape::Geometry::Mesh(mesh) = &simulated.geometry else { unreachable!() };
/// let found = localize(mesh, &contacts, &Settings::default())?;
/// let truth = simulated.log.grasps[0].truth.unwrap();
/// assert!((found.modes[0].pose.translation.vector - truth.translation.vector).norm() < 0.003);
/// assert!(found.freedoms.is_empty());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn localize(
    model: &Mesh,
    contacts: &[Contact],
    settings: &Settings,
) -> Result<Localization, LocalizeError> {
    at_least_one("round", settings.rounds)?;
    at_least_one("optimum", settings.optima)?;
    let evidence = evidence(model, contacts)?;
    let (exact, grid) = surfaces(model)?;
    let mut proposals = Proposals::new(model, evidence.radius, settings.seed);
    let found = search::search(&grid, &evidence, &mut proposals, settings);
    let symmetry = symmetry(model, &exact, contacts);
    let (weighed, misfit) = modes::modes(&grid, &exact, &evidence, &symmetry, found.candidates);
    let best = weighed.first().ok_or(LocalizeError::NoArea)?;
    let mut freedoms = freedom::freedoms(&exact, &evidence, &best.seen, misfit);
    // The sides of a mesh that stands for something round may tell how it is turned: they are not the object's.
    let round = freedom::round(&symmetry);
    freedoms.extend(round.filter(|r| !freedoms.iter().any(|f| freedom::are_alike(f, r))));
    // One mode stands for all that a free motion leads to.
    let deviation = |m: &modes::Weighed| match freedoms[..] {
        [] => m.deviation,
        _ => evidence.radius,
    };
    let mode = |m: &modes::Weighed| {
        mode(&exact, &evidence, &modes::Weighed { deviation: deviation(m), ..*m })
    };
    Ok(Localization {
        modes: weighed.iter().map(mode).collect(),
        freedoms,
        misfit,
        drawn: found.drawn,
        more: weighed.len() + symmetry.motions().count() > modes::MOST,
    })
}

/// The likeliest pose that plain descent from many starts finds, none of them given up early: slow,
/// and the yardstick of [`localize`]. Its weight is one.
///
/// # Errors
/// As [`localize`].
pub fn exhaustive(
    model: &Mesh,
    contacts: &[Contact],
    starts: usize,
) -> Result<Mode, LocalizeError> {
    at_least_one("start", starts)?;
    let evidence = evidence(model, contacts)?;
    let (exact, grid) = surfaces(model)?;
    // Not the stream of any search.
    let mut proposals = Proposals::new(model, evidence.radius, u64::MAX);
    let best = search::exhaustive(&grid, &exact, &evidence, &mut proposals, starts);
    let best = best.ok_or(LocalizeError::NoArea)?;
    Ok(mode(&exact, &evidence, &modes::alone(&exact, &evidence, best)))
}

/// What [`Mode::nats`] would be at `pose` (object to world).
///
/// # Errors
/// As [`localize`].
pub fn nats(model: &Mesh, contacts: &[Contact], pose: &Pose) -> Result<f64, LocalizeError> {
    let exact = Exact::new(faces(model)).ok_or(LocalizeError::NoArea)?;
    Ok(evidence(model, contacts)?.nats(&exact, &pose.inverse(), 1.0))
}

fn at_least_one(what: &'static str, given: usize) -> Result<(), LocalizeError> {
    if given == 0 { Err(LocalizeError::Effort(what)) } else { Ok(()) }
}

/// The surface twice: exact, and quick.
fn surfaces(model: &Mesh) -> Result<(Exact, Grid), LocalizeError> {
    let faces = faces(model);
    let (exact, grid) = rayon::join(|| Exact::new(faces.clone()), || Grid::new(&faces));
    Ok((exact.ok_or(LocalizeError::NoArea)?, grid))
}

/// What maps the model to itself, beyond what any contact can tell.
fn symmetry(model: &Mesh, exact: &Exact, contacts: &[Contact]) -> Symmetry {
    let closest = |p: &Point| {
        let near = exact.near(p);
        p - near.gradient * near.distance
    };
    let symmetry = Symmetry::exact(model, &closest);
    // An open sheet may come to lie on itself with its normals on the other side.
    let is_blind = || contacts.iter().all(|c| c.normal.is_none()) || model.is_watertight();
    if symmetry.order() == Some(1) || is_blind() { symmetry } else { Symmetry::none() }
}

fn mode(exact: &Exact, evidence: &Evidence, found: &modes::Weighed) -> Mode {
    let &modes::Weighed { seen, weight, deviation } = found;
    let distances = evidence.distances(exact, &seen);
    let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
    Mode { pose: seen.inverse(), weight, deviation, mean, nats: evidence.nats(exact, &seen, 1.0) }
}

/// The contacts, checked, beside the sizes of the object.
fn evidence(model: &Mesh, contacts: &[Contact]) -> Result<Evidence, LocalizeError> {
    if contacts.len() < LEAST_CONTACTS {
        return Err(LocalizeError::FewContacts(contacts.len()));
    }
    let finite = |p: &Point| p.iter().all(|x| x.is_finite());
    let positive = |x: f64| x > 0.0 && x.is_finite();
    let usable = |c: &Contact| {
        finite(&c.point)
            && c.normal.is_none_or(|n| finite(&n) && (n.norm() - 1.0).abs() < 1e-3)
            && positive(c.point_deviation)
            && positive(c.normal_deviation)
    };
    if let Some(k) = contacts.iter().position(|c| !usable(c)) {
        return Err(LocalizeError::Contact(k));
    }
    let litres = 1e3 * model.volume();
    if litres < 0.0 && model.is_watertight() && contacts.iter().any(|c| c.normal.is_some()) {
        return Err(LocalizeError::InsideOut(litres));
    }
    let (low, high) = model.bounds();
    let radius = (high - low).norm() / 2.0;
    if !(radius > 0.0) {
        return Err(LocalizeError::NoArea);
    }
    Ok(Evidence { contacts: contacts.to_vec(), centre: (low + high) / 2.0, radius })
}
