//! The joint graph of poses and flat faces, from a log and what trackers made of it.

use nalgebra::{Const, DimMin, Matrix3, Matrix6, SMatrix};
use rayon::prelude::*;
use tactile_core::track::Status;

use super::alias::restart;
use super::average::{Averaged, averaged};
use super::confine::{Confined, confined};
use super::explain::{fitted, improve, is_endless, settle};
use super::factors::touch;
use super::problem::{Labels, Problem, State};
use super::regular::regular;
use super::retrack::{backwards, retrack};
use super::ridge::{self, Ridge, named};
use super::seat::{Seated, seated};
use super::slip::information;
use super::solve::Solved;
use super::tangent::{Face, six_by_six};
use crate::log::GraspLog;
use crate::model::faces::{self, Faces, Owner};
use crate::reference::Contact;
use crate::slam::choose::only;
use crate::slam::place::{Placed, doubt, place};
use crate::slam::track::Step;
use crate::space::{Point, Pose};

/// Rounds of moves: changes end after two or three.
const ROUNDS: usize = 6;

/// χ² of a contact on its face, four deviations, from which it is rather a wild one that lies near, and the share of
/// such up to which they are: faces that more contradict do not fit.
const STRANGE: f64 = 16.0;
const WILD: f64 = 0.1;

/// Grasps times faces up to which grasps are tried at other poses, which takes longer with either.
const RESTARTED: usize = 2400;

/// Contacts of a log up to which grasps are tried at other seats.
const SEATED: usize = 200;

/// Graphs with the same labels and costs nearer than this (nats) are one.
const SAME: f64 = 1e-3;

/// A face as the graph knows it, object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit, out of the object.
    pub normal: Point,
    /// ρ of n·p = ρ, metres.
    pub offset: f64,
    /// The two directions in which the normal turns; in the plane the second is zero.
    pub tangents: [Point; 2],
    /// Covariance of the turns along them (radians) and of the offset (metres), with respect to the
    /// frame that the first grasp fixed.
    pub covariance: Matrix3<f64>,
    /// Contacts that lie on it.
    pub contacts: usize,
}

impl Plane {
    /// The same as contacts of that centroid would give it.
    fn about(&self, centroid: &Point) -> faces::Face {
        let [t, u] = self.tangents;
        let row = Point::new(t.dot(centroid), u.dot(centroid), -1.0);
        let across = Matrix3::from_columns(&[t, u, Point::zeros()]);
        faces::Face {
            normal: self.normal,
            offset: self.offset,
            centroid: *centroid,
            offset_variance: row.dot(&(self.covariance * row)).max(0.0),
            normal_covariance: across * self.covariance * across.transpose(),
            contacts: self.contacts,
        }
    }
}

/// What the graph made of a log.
#[derive(Clone, Debug)]
pub struct Corrected {
    /// The steps with corrected poses and their marginal covariances, all else as it was. The first
    /// pose is as it was and without doubt: it defines the object frame. Where a face ends holds a pose
    /// back, but its covariance is that of endless faces: rather too large.
    pub steps: Vec<Step>,
    /// Covariance of each pose if the faces were known, in the same axes: how uncertain a contact is
    /// with respect to the others, where the marginal one also holds how uncertain all of them are
    /// with respect to the first grasp.
    pub given_faces: Vec<Matrix6<f64>>,
    /// The faces.
    pub faces: Vec<Plane>,
    /// What each usable contact lies on, in the log's order; `None` where nothing explains it.
    pub owners: Vec<Option<Owner>>,
    /// Negative log evidence, nats, up to a constant of the log, with what it takes to hold contacts where
    /// their faces are surface.
    pub cost: f64,
    /// χ² per degree of freedom of the contacts that lie on faces and edges, up to a tenth that are strange there left
    /// out, and of the motions that were measured, robustly: about 1 on flat faces.
    pub per_degree: f64,
}

impl Corrected {
    /// Share of the contacts that lie on faces and their edges.
    pub fn explained(&self) -> f64 {
        let explained = self.owners.iter().flatten().count();
        explained as f64 / self.owners.len().max(1) as f64
    }

    /// Whether a contact lies where faces meet.
    fn has_edges(&self) -> bool {
        self.owners.iter().flatten().any(|owner| owner.faces().len() > 1)
    }

    /// The faces as a shape is made of them, with all contacts of the log at [`Corrected::relative`];
    /// `None` without faces. A second fit to the contacts would know less: what a grasp's contacts have
    /// in common, and which faces are parallel or square, is lost in them.
    pub fn shape(&self, log: &GraspLog) -> Option<Faces> {
        let relative = self.relative();
        // What lost grasps felt has owners, too, and is then left out of both.
        let all: Vec<Step> =
            relative.iter().map(|s| Step { status: Status::Tracking, ..s.clone() }).collect();
        let placed = place(log, &all);
        let is_placed = |p: &Placed| relative[p.grasp].status != Status::Lost;
        let is_placed: Vec<bool> = placed.iter().map(is_placed).collect();
        let contacts: Vec<Contact> = placed.iter().map(|p| p.contact).collect();
        self.explaining(log.dimension, &contacts, &is_placed)
    }

    /// The faces with those of all contacts in the object frame that are marked; `None` without faces.
    fn explaining(&self, dimension: usize, all: &[Contact], marked: &[bool]) -> Option<Faces> {
        if self.faces.is_empty() {
            return None;
        }
        let mut owners = self.owners.iter();
        let owner = |c: &Contact| {
            c.checked()?;
            *owners.next()?
        };
        let owners: Vec<Option<Owner>> = all.iter().map(owner).collect();
        Some(known(dimension, &self.faces, &only(all, marked), only(&owners, marked)))
    }

    /// The steps with the covariances of [`Corrected::given_faces`]: to place contacts side by side.
    pub fn relative(&self) -> Vec<Step> {
        let with = |(step, covariance): (&Step, &Matrix6<f64>)| Step {
            covariance: *covariance,
            ..step.clone()
        };
        self.steps.iter().zip(&self.given_faces).map(with).collect()
    }
}

/// Faces as a shape is made of them, which explain contacts in the object frame.
pub(super) fn known(
    dimension: usize,
    planes: &[Plane],
    placed: &[Contact],
    owners: Labels,
) -> Faces {
    let faces = planes.iter().enumerate().map(|(number, plane)| {
        let own = placed.iter().zip(&owners).filter(|(_, o)| **o == Some(Owner::Face(number)));
        let sum: Point = own.map(|(c, _)| c.point).sum();
        plane.about(&(sum / plane.contacts.max(1) as f64))
    });
    let faces = faces.collect();
    Faces::explaining(dimension, placed, faces, owners)
}

/// How far to search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Rounds of moves of faces.
    pub rounds: usize,
    /// Whether single grasps are tried at other poses.
    pub restarts: bool,
    /// Whether a trajectory of the graph's own is tried beside the trackers'.
    pub retrack: bool,
}

impl Default for Effort {
    fn default() -> Self {
        Effort { rounds: ROUNDS, restarts: true, retrack: true }
    }
}

/// All poses and faces of a log estimated together, from each of the trajectories; the cheapest
/// result. `None` where there is nothing to correct: no grasps, or no face that two contacts share.
///
/// ```
/// use tactile_host::graph::joint::{Effort, planes};
/// use tactile_host::sim::{Options, simulate};
/// use tactile_host::slam::track;
/// let log = simulate(&Options::new("rectangle:0.10x0.06".parse()?))?.log;
/// let truth = track::truth(&log)?;
/// let corrected = planes(&log, &[&truth], Effort::default()).unwrap();
/// assert_eq!(corrected.steps.len(), 16);
/// assert_eq!(corrected.faces.len(), 4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn planes(log: &GraspLog, trajectories: &[&[Step]], effort: Effort) -> Option<Corrected> {
    let problem = Problem::new(log);
    if log.dimension == 2 {
        run::<3>(&problem, trajectories, effort)
    } else {
        run::<6>(&problem, trajectories, effort)
    }
}

/// The faces of contacts in the object frame whose places are known, and which contact lies on which of them or on
/// none; `None` where no two contacts share a face.
pub fn held(dimension: usize, contacts: &[Contact]) -> Option<Faces> {
    let problem = Problem::held(dimension, contacts);
    let steps = [Step::certain(Pose::identity())];
    let effort = Effort { restarts: false, retrack: false, ..Effort::default() };
    let found = if dimension == 2 {
        run::<3>(&problem, &[&steps], effort)
    } else {
        run::<6>(&problem, &[&steps], effort)
    };
    found?.explaining(dimension, contacts, &vec![true; contacts.len()])
}

fn run<const D: usize>(
    problem: &Problem,
    trajectories: &[&[Step]],
    effort: Effort,
) -> Option<Corrected>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let first = trajectories.first().and_then(|steps| Some(steps.first()?.pose));
    let steps = trajectories.first().copied().unwrap_or_default();
    // In space other seats were not found to help (87 runs of 280 right, 89 without), and take long; nor in
    // long logs (ten of sixty grasps: as good shapes without, in a quarter of the time where sides are curved).
    let seats = effort.restarts && problem.dimension == 2 && problem.felt.len() <= SEATED;
    // Whether fingers feel edges is decided by what comes of either in the end: poses that were found
    // without edges hide them.
    let problems = [false, true].map(|edges| Problem { edges, ..problem.clone() });
    let found = |starts: &(dyn Fn(&Problem) -> Vec<Solved<D>> + Sync)| {
        let each = problems.par_iter().flat_map(|problem| {
            let whole = |solved| explained(problem, solved, effort);
            let all: Vec<_> = starts(problem).into_iter().map(whole).collect();
            all.into_par_iter().map(move |(solved, others)| (problem, solved, others))
        });
        let whole =
            distinct(each.collect()).into_par_iter().filter_map(|(problem, solved, others)| {
                if seats {
                    seated(problem, solved, &others, steps)
                } else {
                    corrected(problem, solved, &others, steps)
                }
            });
        cheapest(whole.collect())
    };
    let mut best = found(&|problem| started(problem, trajectories, first, effort));
    if seats && effort.retrack && !best.as_ref().is_some_and(Seated::is_sound) {
        let back = found(&|problem| backwards::<D>(problem, first).into_iter().collect());
        best = cheapest(best.into_iter().chain(back).collect());
    }
    best.map(|best| best.corrected)
}

/// Of whole objects: that contacts lie where faces are surface is known of no others.
fn cheapest<const D: usize>(all: Vec<Seated<D>>) -> Option<Seated<D>> {
    all.into_iter().min_by(|a, b| a.corrected.cost.total_cmp(&b.corrected.cost))
}

/// A graph, of which problem, and others that may be meant where it is open how faces lie to each other.
type Considered<'a, const D: usize> = (&'a Problem, Solved<D>, Vec<Solved<D>>);

/// The first of those that are one, if it has faces.
fn distinct<const D: usize>(all: Vec<Considered<D>>) -> Vec<Considered<D>> {
    let mut kept: Vec<Considered<D>> = Vec::new();
    for one in all.into_iter().filter(|(_, solved, _)| !solved.state.faces.is_empty()) {
        if !kept.iter().any(|other| are_same(&one.1, &other.1)) {
            kept.push(one);
        }
    }
    kept
}

fn are_same<const D: usize>(one: &Solved<D>, other: &Solved<D>) -> bool {
    one.labels == other.labels && (one.cost - other.cost).abs() < SAME
}

/// Where to search from: every trajectory, and one of the graph's own.
fn started<const D: usize>(
    problem: &Problem,
    trajectories: &[&[Step]],
    first: Option<Pose>,
    effort: Effort,
) -> Vec<Solved<D>>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let mut found: Vec<Solved<D>> = Vec::new();
    for steps in trajectories {
        // With the poses' doubt and without: a tracker may be right to doubt, or not.
        for doubted in [true, false] {
            let (state, labels) = initial(problem, steps, doubted);
            let settled = settle::<D>(problem, state, labels);
            // Where there is no doubt, or it changes nothing, it is searched from once.
            found.extend(settled.filter(|one| !found.iter().any(|other| are_same(one, other))));
        }
    }
    if effort.retrack {
        found.extend(retrack::<D>(problem, first));
    }
    found
}

/// What comes of a graph, with others that may be meant where it is open how faces lie to each other.
fn explained<const D: usize>(
    problem: &Problem,
    solved: Solved<D>,
    effort: Effort,
) -> (Solved<D>, Vec<Solved<D>>)
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let mut solved = searched(problem, solved, effort);
    let others = regular(problem, &mut solved);
    (solved, others)
}

/// Moves faces and grasps for as long as it pays.
fn searched<const D: usize>(problem: &Problem, mut solved: Solved<D>, effort: Effort) -> Solved<D>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    for _ in 0..effort.rounds {
        let moved = improve(problem, &mut solved);
        if is_endless(&solved.state) {
            break;
        }
        let size = solved.state.poses.len() * solved.state.faces.len();
        let restarted = effort.restarts && size <= RESTARTED && restart(problem, &mut solved);
        if !moved && !restarted {
            break;
        }
    }
    solved
}

/// Faces fitted at a tracker's poses.
fn initial(problem: &Problem, steps: &[Step], doubted: bool) -> (State, Labels) {
    let given: Vec<Option<Pose>> = steps.iter().map(|s| Some(s.pose)).collect();
    let poses = problem.poses(&given);
    let placed = |i: usize| {
        let contact = problem.placed(&poses, i);
        match steps.get(problem.felt[i].grasp) {
            Some(step) if doubted && step.covariance.iter().all(|v| v.is_finite()) => {
                doubt(contact, &step.covariance)
            }
            _ => contact,
        }
    };
    let contacts: Vec<Option<Contact>> = (0..problem.felt.len()).map(|i| Some(placed(i))).collect();
    let (faces, labels) = fitted(problem.dimension, &contacts);
    (State { poses, faces, relations: Vec::new() }, labels)
}

/// The whole object that a graph makes, with its poses where the object's surface is, and with what the
/// tracker's `steps` say beside them.
pub(super) fn corrected<const D: usize>(
    problem: &Problem,
    best: Solved<D>,
    others: &[Solved<D>],
    steps: &[Step],
) -> Option<Seated<D>> {
    let Averaged { state, covariance: inverse } = averaged(problem.dimension, &best, others)?;
    let dimension = problem.dimension;
    let blocks = |blocks: &[nalgebra::SMatrix<f64, D, D>]| -> Vec<Matrix6<f64>> {
        std::iter::once(Matrix6::zeros()).chain(blocks.iter().map(six_by_six)).collect()
    };
    let (marginal, given_faces) = (blocks(&inverse.poses), blocks(&inverse.given_faces));
    let faces = state.faces.iter().enumerate().map(|(j, face)| {
        let mut covariance = Matrix3::zeros();
        let number = |k: usize| if dimension == 2 && k == 1 { 2 } else { k };
        for a in 0..dimension {
            for b in 0..dimension {
                covariance[(number(a), number(b))] =
                    inverse.faces[(dimension * j + a, dimension * j + b)];
            }
        }
        Plane {
            normal: face.normal,
            offset: face.offset,
            tangents: face.tangents(dimension),
            covariance,
            contacts: best.labels.iter().filter(|l| **l == Some(Owner::Face(j))).count(),
        }
    });
    let faces: Vec<Plane> = faces.collect();
    let Confined { state, cost, hanging } = confined::<D>(problem, &state, &best.labels, &faces);
    let steps = state
        .poses
        .iter()
        .zip(&marginal)
        .enumerate()
        .map(|(k, (pose, covariance))| match steps.get(k) {
            Some(before) => {
                let is_found = problem.is_found(k, |i| best.labels[i].is_some());
                before.at(*pose, *covariance, is_found)
            }
            None => Step { covariance: *covariance, ..Step::certain(*pose) },
        })
        .collect();
    let corrected = Corrected {
        steps,
        given_faces,
        faces,
        owners: best.labels.clone(),
        cost: best.cost + cost,
        per_degree: per_degree::<D>(problem, &state, &best.labels),
    };
    Some(Seated { solved: best, corrected, hanging })
}

/// Negative log evidence of contacts, motions and faces, nats, as the Bayesian information criterion has
/// it, if so many `numbers` make the faces: to be compared with that of a body that is not made of faces.
pub(super) fn criterion(problem: &Problem, found: &Corrected, numbers: usize) -> f64 {
    let poses: Vec<Pose> = found.steps.iter().map(|step| step.pose).collect();
    let of_faces: Vec<Face> =
        found.faces.iter().map(|f| Face { normal: f.normal, offset: f.offset }).collect();
    let problem = &Problem { edges: found.has_edges(), ..problem.clone() };
    let numbered: Vec<(usize, Face)> = of_faces.iter().copied().enumerate().collect();
    let contact = |i: usize| {
        let contact = problem.placed(&poses, i);
        let on = of_faces.iter().map(|face| problem.on(face, &contact));
        let edges = ridge::near(problem, &numbered, &contact, |_| contact.point_deviation);
        let on_edge = edges.iter().map(|(_, ridge)| ridge.cost(problem, &contact, 1.0));
        let on = on.chain(on_edge).fold(f64::INFINITY, f64::min);
        problem.or_wild(&contact, on).0 - problem.exact(&contact)
    };
    let centre = problem.middle(&poses);
    let motion = |k: usize| problem.moved(k, &poses[k - 1], &poses[k], &centre);
    let measured = problem.measured(problem.felt.len()) as f64;
    (0..problem.felt.len()).map(contact).sum::<f64>()
        + (1..poses.len()).map(motion).sum::<f64>()
        + 0.5 * numbers as f64 * measured.ln()
}

/// χ² of contacts, without those that are strange, and of motions, robustly, over the numbers measured less those found.
fn per_degree<const D: usize>(problem: &Problem, state: &State, labels: &Labels) -> f64 {
    let d = problem.dimension;
    let mut contacts: Vec<Left<D>> = Vec::with_capacity(labels.len());
    for (felt, label) in problem.felt.iter().zip(labels) {
        let Some(owner) = label else { continue };
        let (pose, faces) = (&state.poses[felt.grasp], named(owner, &state.faces));
        let (chi, of_pose) = match (Ridge::new(&faces), &faces[..]) {
            (Some(ridge), _) => {
                let touch = ridge.touch(pose, d, &felt.contact);
                (touch.residual.norm_squared(), information(&touch.by_pose))
            }
            (None, [face, ..]) => {
                let touch = touch(pose, face, d, &felt.contact);
                (touch.residual.norm_squared(), information(&touch.by_pose))
            }
            _ => (0.0, SMatrix::zeros()),
        };
        let numbers = problem.numbers(&felt.contact) as f64;
        contacts.push(Left { grasp: felt.grasp, chi, numbers, of_pose });
    }
    let strange = contacts.iter().filter(|left| left.chi > STRANGE).count();
    if strange as f64 <= WILD * contacts.len() as f64 {
        contacts.retain(|left| left.chi <= STRANGE);
    }
    let mut chi: f64 = contacts.iter().map(|left| left.chi).sum();
    let mut degrees: f64 = contacts.iter().map(|left| left.numbers).sum();
    degrees -= (d * state.faces.len()) as f64;
    let centre = problem.middle(&state.poses);
    for k in 1..state.poses.len() {
        let felt = || contacts.iter().filter(|left| left.grasp == k).map(|left| left.of_pose).sum();
        let (slipped, spent) = problem.told::<D>(k, &state.poses, &centre, felt);
        chi += slipped;
        degrees -= spent;
    }
    chi / degrees.max(1.0)
}

/// What the faces leave of a grasp's contact: its χ², how many numbers it is, what it says of the pose.
struct Left<const D: usize> {
    grasp: usize,
    chi: f64,
    numbers: f64,
    of_pose: SMatrix<f64, D, D>,
}

#[cfg(test)]
mod tests;
