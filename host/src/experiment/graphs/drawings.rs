//! Figures that explain: nodes and edges, contacts by face, two grasps laid on each other.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

use nalgebra::Point3;

use super::{Numbers, Subject};
use crate::experiment::Spread;
use crate::experiment::figure::{Drawn, FigureError};
use crate::experiment::tracking::judge::gauge;
use crate::experiment::with_room;
use crate::graph::joint::problem::Problem;
use crate::graph::joint::tangent::local;
use crate::graph::pairwise::alternatives::labelled;
use crate::graph::pairwise::clustering::clusters;
use crate::graph::pairwise::constraints::frames;
use crate::graph::pairwise::similarity::{Touched, similar};
use crate::graph::pairwise::{self, touched};
use crate::log::GraspLog;
use crate::reference::Contact;
use crate::shape::Geometry;
use crate::sim::{Options, Touch, simulate};
use crate::slam::track::{Step, truth};
use crate::space::{Point, Pose};
use crate::view::sheet::{self, Panel, Sheet};

/// How far out of the object its nodes are drawn, parts of its diagonal.
const OUT: f64 = 0.2;

/// Errors of the poses in figure 3.9: what a tracker at 100 % noise is off by, metres and radians.
const OFF: [f64; 2] = [4e-3, 0.12];

/// Contacts of figure 3.8.
const CONTACTS: usize = 120;

/// Nodes around the object, lines for edges.
pub(super) fn graph(
    title: &str,
    objects: &[&str],
    drawn: &mut Drawn<Numbers>,
) -> Result<(), FigureError> {
    let mut panels = Vec::new();
    for object in objects {
        let subject = Subject::new(object, 50.0)?;
        let (log, steps) = with_room(|| subject.tracked(0))?;
        let found = pairwise::correct(&log, &steps);
        let steps = found.as_ref().map_or(&steps, |f| &f.steps);
        let Some(frame) = gauge(&log, steps, &subject.truth.geometry) else { continue };
        let (low, high) = subject.truth.geometry.bounds();
        let middle = (low + high) / 2.0;
        let reach = (high - low) / 2.0 + Point::repeat(OUT * (high - low).norm());
        let count = log.grasps.len();
        let node = |k: usize| {
            let angle = TAU * k as f64 / count as f64;
            middle + Point::new(angle.cos() * reach.x, angle.sin() * reach.y, 0.0)
        };
        let (mut contacts, mut groups) = placed(&log, steps, &frame);
        contacts.extend((0..count).map(|k| (node(k), None)));
        groups.extend(0..count);
        let edges = found.as_ref().map_or(&[][..], |f| &f.edges[..]);
        let followed = (1..count).map(|k| [k - 1, k]);
        let links = edges.iter().copied().chain(followed).map(|[i, j]| [node(i), node(j)]);
        let refused = found.as_ref().map_or(0, |f| f.refused);
        let note = format!(
            "{count} grasps, {} steps, {} relative poses, {refused} of them refused",
            count - 1,
            edges.len()
        );
        drawn.numbers.notes.push(format!("{}: {note}", subject.options.object));
        panels.push(Panel {
            title: subject.options.object.to_string(),
            note,
            truth: subject.truth.geometry.clone(),
            estimate: None,
            deviations: Vec::new(),
            contacts,
            groups,
            links: links.collect(),
        });
    }
    drawn.picture = sheet::render(&Sheet { title: title.into(), columns: 3, panels })?;
    Ok(())
}

type Placed = (Vec<(Point, Option<Point>)>, Vec<usize>);

/// Contacts in the true object frame, and the grasp of each.
fn placed(log: &GraspLog, steps: &[Step], frame: &Pose) -> Placed {
    let (mut contacts, mut groups) = (Vec::new(), Vec::new());
    for (k, (grasp, step)) in log.grasps.iter().zip(steps).enumerate() {
        let to_object = frame * step.pose.inverse();
        for c in &grasp.contacts {
            let point = (to_object * Point3::from(c.point)).coords;
            contacts.push((point, c.normal.map(|n| to_object.rotation * n)));
            groups.push(k);
        }
    }
    (contacts, groups)
}

/// Contacts all over a body, by the face that the clustering finds for them.
pub(super) fn faces(
    title: &str,
    objects: &[&str],
    seeds: u64,
    drawn: &mut Drawn<Numbers>,
) -> Result<(), FigureError> {
    let mut panels = Vec::new();
    for object in objects {
        let (mut found, mut right) = (Vec::new(), Vec::new());
        let mut sides = 0;
        for seed in 0..seeds {
            let subject = Subject::new(object, 0.0)?;
            let options = Options {
                touch: Touch::Uniform,
                contacts: CONTACTS,
                grasps: Some(1),
                seed,
                ..subject.options.clone()
            };
            let log = simulate(&options)?.log;
            let problem = Problem::new(&log);
            let poses = truth(&log).map_err(|_| ()).unwrap_or_default();
            let poses: Vec<Pose> = poses.iter().map(|s| s.pose).collect();
            let contacts: Vec<Contact> =
                (0..problem.felt.len()).map(|i| problem.placed(&poses, i)).collect();
            let labels = clusters(&contacts);
            let true_sides = sides_of(&subject.truth.geometry, &contacts);
            let counted = agreement(&labels, &true_sides);
            found.push(counted.0 as f64);
            right.push(100.0 * counted.1);
            sides = true_sides.iter().max().map_or(0, |m| m + 1).max(sides);
            if seed == 0 {
                panels.push(Panel {
                    title: subject.options.object.to_string(),
                    note: format!("{} contacts, {} faces", contacts.len(), counted.0),
                    truth: subject.truth.geometry.clone(),
                    estimate: None,
                    deviations: Vec::new(),
                    contacts: contacts.iter().map(|c| (c.point, c.normal)).collect(),
                    groups: labels.iter().map(|l| l.map_or(0, |l| l + 1)).collect(),
                    links: Vec::new(),
                });
            }
        }
        let show = |all: Vec<f64>| Spread::of(all).map_or("–".to_owned(), |s| s.to_string());
        drawn.numbers.notes.push(format!(
            "{object}: {CONTACTS} contacts on {sides} sides; faces of three contacts or more: {}; \
             contacts whose face is their side's: {} %",
            show(found),
            show(right)
        ));
    }
    drawn.picture = sheet::render(&Sheet { title: title.into(), columns: 3, panels })?;
    Ok(())
}

/// The true side of each contact: sides are what nearest triangles of one plane make.
fn sides_of(geometry: &Geometry, contacts: &[Contact]) -> Vec<usize> {
    let mut planes: Vec<(Point, f64)> = Vec::new();
    let mut number = |point: &Point, normal: &Point| {
        let offset = normal.dot(point);
        let known =
            planes.iter().position(|(n, o)| n.dot(normal) > 0.999 && (o - offset).abs() < 1e-4);
        known.unwrap_or_else(|| {
            planes.push((*normal, offset));
            planes.len() - 1
        })
    };
    let samples = geometry.samples(4000);
    let one = |c: &Contact| {
        let cost = |(p, n): &(Point, Point)| {
            let turned = c.normal.map_or(0.0, |m| (m - n).norm());
            (p - c.point).norm() + 0.02 * turned
        };
        samples.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))
    };
    contacts.iter().map(|c| one(c).map_or(0, |(p, n)| number(p, n))).collect()
}

/// Faces with three contacts or more, and the share of contacts whose face is their side's: sides choose
/// in turn the face that most of their contacts are on and no other has, those with most first.
fn agreement(labels: &[Option<usize>], sides: &[usize]) -> (usize, f64) {
    let mut counts: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    for (label, side) in labels.iter().zip(sides) {
        if let Some(label) = label {
            *counts.entry((*side, *label)).or_default() += 1;
            *sizes.entry(*label).or_default() += 1;
        }
    }
    let mut pairs: Vec<((usize, usize), usize)> = counts.into_iter().collect();
    pairs.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let (mut owning, mut owned) = (BTreeSet::new(), BTreeSet::new());
    let mut own = 0;
    for ((side, label), count) in pairs {
        if !owning.contains(&side) && owned.insert(label) {
            owning.insert(side);
            own += count;
        }
    }
    let faces = sizes.values().filter(|c| **c >= 3).count();
    (faces, own as f64 / labels.len().max(1) as f64)
}

/// Two similar grasps at poses that are off, before and after.
pub(super) fn alignment(
    title: &str,
    objects: &[&str],
    seeds: u64,
    drawn: &mut Drawn<Numbers>,
) -> Result<(), FigureError> {
    let mut panels = Vec::new();
    for object in objects {
        let subject = Subject::new(object, 100.0)?;
        let (mut before, mut after) = ([Vec::new(), Vec::new()], [Vec::new(), Vec::new()]);
        for seed in 0..seeds {
            let log = simulate(&Options { seed, ..subject.options.clone() })?.log;
            let Ok(steps) = truth(&log) else { continue };
            let found = aligned(&log, &steps, seed);
            if seed == 0
                && let Some(one) = found.first()
            {
                for (name, poses) in [("before", &one.off), ("after", &one.found)] {
                    panels.push(one.panel(&log, &subject, name, poses));
                }
            }
            for one in &found {
                for (list, errors) in [(&mut before, one.errors[0]), (&mut after, one.errors[1])] {
                    list[0].push(1e3 * errors[0]);
                    list[1].push(errors[1].to_degrees());
                }
            }
        }
        let show = |all: [Vec<f64>; 2]| {
            let [mm, degrees] =
                all.map(|v| Spread::of(v).map_or("–".to_owned(), |s| s.to_string()));
            format!("{mm} mm, {degrees}°")
        };
        drawn.numbers.notes.push(format!(
            "{object}: {} pairs of similar grasps; relative pose off by {} before, {} after",
            before[0].len(),
            show(before),
            show(after)
        ));
    }
    drawn.picture = sheet::render(&Sheet { title: title.into(), columns: 2, panels })?;
    Ok(())
}

/// A pair of grasps.
struct Aligned {
    grasps: [usize; 2],
    /// The second one's pose, before and after; the first one's is the true one.
    off: Pose,
    found: Pose,
    /// Of the relative pose: metres and radians, before and after.
    errors: [[f64; 2]; 2],
}

/// All similar pairs of a log with true faces, the second of each off by [`OFF`].
fn aligned(log: &GraspLog, steps: &[Step], seed: u64) -> Vec<Aligned> {
    let problem = Problem::new(log);
    let poses: Vec<Pose> = steps.iter().map(|s| s.pose).collect();
    let contacts: Vec<Contact> =
        (0..problem.felt.len()).map(|i| problem.placed(&poses, i)).collect();
    let labels = pairwise::faces_at(log, &contacts);
    let frames = frames(&problem, &poses);
    let touched: Vec<Touched> = touched(&problem, &frames, &labels);
    let mut found = Vec::new();
    for (number, pair) in similar(problem.dimension, &touched).into_iter().enumerate() {
        let [i, j] = pair.grasps;
        // Off in directions that go round from pair to pair.
        let angle = 2.4 * (number as f64 + 0.3 * seed as f64);
        let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
        let wrong = crate::space::planar(OFF[0] * angle.cos(), OFF[0] * angle.sin(), sign * OFF[1]);
        let off = poses[j] * wrong;
        let relative = |pose: &Pose| frames[i].inverse() * poses[i] * pose.inverse() * frames[j];
        let (guess, exact) = (relative(&off), relative(&poses[j]));
        let pair = labelled(problem.dimension, &touched[i], &touched[j], &pair.faces, &guess);
        let Ok(registered) = pair else { continue };
        let error = |pose: &Pose| {
            let apart = local(&exact, pose);
            [apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm()]
        };
        let corrected = frames[j] * registered.pose.inverse() * frames[i].inverse() * poses[i];
        found.push(Aligned {
            grasps: [i, j],
            off,
            found: corrected,
            errors: [error(&guess), error(&registered.pose)],
        });
    }
    found
}

impl Aligned {
    fn panel(&self, log: &GraspLog, subject: &Subject, name: &str, second: &Pose) -> Panel {
        let [i, j] = self.grasps;
        let (mut contacts, mut groups) = (Vec::new(), Vec::new());
        let first = log.grasps[i].truth.unwrap_or_else(Pose::identity);
        for (group, (k, pose)) in [(i, &first), (j, second)].into_iter().enumerate() {
            let to_object = pose.inverse();
            for c in &log.grasps[k].contacts {
                let point = (to_object * Point3::from(c.point)).coords;
                contacts.push((point, c.normal.map(|n| to_object.rotation * n)));
                groups.push(group);
            }
        }
        let errors = self.errors[usize::from(name == "after")];
        Panel {
            title: format!("{}, {name}", subject.options.object),
            note: format!(
                "grasps {i} and {j}: {:.1} mm, {:.1}° off",
                1e3 * errors[0],
                errors[1].to_degrees()
            ),
            truth: subject.truth.geometry.clone(),
            estimate: None,
            deviations: Vec::new(),
            contacts,
            groups,
            links: Vec::new(),
        }
    }
}
