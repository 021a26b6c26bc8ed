//! From optima to modes: refined on the exact surface, completed by symmetry, joined where no
//! barrier parts them, and weighed.

use nalgebra::{Matrix6, SymmetricEigen, UnitQuaternion, Vector6};
use rayon::prelude::*;

use super::likelihood::Evidence;
use super::search::{Candidate, apart, best_first, descend, distinct};
use super::{Exact, Surface};
use crate::shape::symmetry::Symmetry;
use crate::space::{Point, Pose};

/// Optima less likely than the best by more than this are no modes, nats.
const WINDOW: f64 = 8.0;

/// Most modes that are told apart.
pub(super) const MOST: usize = 64;

/// Steps on the exact surface.
const STEPS: usize = 12;

/// Two optima are one mode when the way between them costs no more than this above the worse of
/// them, nats.
const BARRIER: f64 = 2.0;

/// Places looked at on that way are this part of the object's radius apart.
const STRIDE: f64 = 0.1;

/// Optima that each one is tried to be joined with.
const NEIGHBOURS: usize = 6;

/// Modes whose relative motions are tried on all others.
const GENERATORS: usize = 8;

/// Optima as likely as each other within this are taken for images under a symmetry, nats.
const EQUAL: f64 = 1.0;

/// A pose (world to object) that stands for all around it, with its part of the belief.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weighed {
    pub seen: Pose,
    pub weight: f64,
    /// Standard deviation of the pose in its least certain direction, turns counted at the object's
    /// radius and that at most, metres.
    pub deviation: f64,
}

/// The modes, heaviest first, their weights summing to one, and the misfit (see
/// [`Evidence::misfit`]) that they were weighed with.
pub(super) fn modes<S: Surface>(
    grid: &S,
    exact: &Exact,
    evidence: &Evidence,
    symmetry: &Symmetry,
    mut optima: Vec<Candidate>,
) -> (Vec<Weighed>, f64) {
    best_first(&mut optima);
    let Some(best) = optima.first() else { return (Vec::new(), 1.0) };
    let misfit = evidence.misfit(grid, &best.seen);
    // The grid is coarse: twice the window, until the exact surface has its say.
    within(&mut optima, 2.0 * WINDOW * misfit);
    // Each image by itself: where optima crowd, one image's search may have found the best.
    optima = separate(grid, evidence, &Symmetry::none(), &optima, misfit);
    optima = refined(exact, evidence, &optima);
    let Some(best) = optima.first() else { return (Vec::new(), 1.0) };
    let misfit = evidence.misfit(exact, &best.seen);
    within(&mut optima, WINDOW * misfit);
    complete(grid, exact, evidence, symmetry, &mut optima, misfit);
    within(&mut optima, WINDOW * misfit);
    let apart = separate(grid, evidence, symmetry, &optima, misfit);
    let weighed = weighed(exact, evidence, &apart, misfit);
    (everywhere(exact, evidence, symmetry, &weighed, misfit), misfit)
}

/// One optimum that has all the weight.
pub(super) fn alone(exact: &Exact, evidence: &Evidence, optimum: Candidate) -> Weighed {
    let misfit = evidence.misfit(exact, &optimum.seen);
    let only = weighed(exact, evidence, &[optimum], misfit).pop();
    only.unwrap_or(Weighed { seen: optimum.seen, weight: 1.0, deviation: evidence.radius })
}

/// Keeps what is at most `window` nats less likely than the first; the order is by likelihood.
fn within(optima: &mut Vec<Candidate>, window: f64) {
    best_first(optima);
    if let Some(best) = optima.first().map(|c| c.nats) {
        optima.retain(|c| c.nats <= best + window);
    }
}

fn refined(exact: &Exact, evidence: &Evidence, optima: &[Candidate]) -> Vec<Candidate> {
    let descend = |c: &Candidate| descend(exact, evidence, &c.seen, 1.0, STEPS);
    let mut refined: Vec<Candidate> = optima.par_iter().map(descend).collect();
    best_first(&mut refined);
    distinct(&mut refined, evidence, MOST);
    refined
}

/// The optima of a nearly symmetric object come in groups: what takes one of the best to another is tried
/// on all, until nothing new is found.
fn complete<S: Surface>(
    grid: &S,
    exact: &Exact,
    evidence: &Evidence,
    symmetry: &Symmetry,
    optima: &mut Vec<Candidate>,
    misfit: f64,
) {
    let Some(best) = optima.first().copied() else { return };
    let equal = |c: &&Candidate| c.nats <= best.nats + EQUAL * misfit;
    let generators: Vec<Pose> = optima
        .iter()
        .filter(equal)
        .skip(1)
        .take(GENERATORS)
        .map(|c| c.seen * best.seen.inverse())
        .collect();
    let mut next = 0;
    while next < optima.len() && optima.len() < MOST {
        let from = optima[next];
        next += 1;
        if !equal(&&from) {
            continue;
        }
        for generator in &generators {
            let seen = generator * from.seen;
            // An image that is surely one need not be looked for.
            let beside = |a: &Pose, b: &Pose| nearest(evidence, symmetry, a, b).1;
            let known = |c: &Candidate| beside(&c.seen, &seen) < 0.05 * evidence.radius;
            if optima.iter().any(known) || optima.len() >= MOST {
                continue;
            }
            // Cheap first: most are no symmetry.
            if evidence.nats(grid, &seen, 1.0) > best.nats + 4.0 * WINDOW * misfit {
                continue;
            }
            let found = descend(exact, evidence, &seen, 1.0, STEPS);
            let known = |c: &Candidate| beside(&c.seen, &found.seen);
            if found.nats <= best.nats + WINDOW * misfit
                && optima.iter().all(|c| known(c) > 0.05 * evidence.radius)
            {
                optima.push(found);
            }
        }
    }
}

/// One optimum, the best, of each set that no barrier parts, images of one another taken for one. Each is
/// tried with the [`NEIGHBOURS`] nearest before it that are not of its set yet.
fn separate<S: Surface>(
    surface: &S,
    evidence: &Evidence,
    symmetry: &Symmetry,
    optima: &[Candidate],
    misfit: f64,
) -> Vec<Candidate> {
    // A grid's own errors must not look like barriers: ways are compared with their ends on it.
    let ends: Vec<f64> = optima.iter().map(|c| evidence.nats(surface, &c.seen, 1.0)).collect();
    let mut group: Vec<usize> = (0..optima.len()).collect();
    for b in 0..optima.len() {
        let image = |a: usize| nearest(evidence, symmetry, &optima[b].seen, &optima[a].seen);
        let mut before: Vec<(usize, (Pose, f64))> = (0..b).map(|a| (a, image(a))).collect();
        before.sort_by(|(_, a), (_, b)| a.1.total_cmp(&b.1));
        let mut tried = 0;
        for (a, (there, far)) in before {
            if group[a] == group[b] {
                continue;
            }
            if tried == NEIGHBOURS {
                break;
            }
            tried += 1;
            let allowed = ends[a].max(ends[b]) + BARRIER * misfit;
            let stations = 2 + (far / (STRIDE * evidence.radius)) as usize;
            let open = (1..stations).all(|k| {
                let part = k as f64 / stations as f64;
                let seen = between(evidence, &there, &optima[b].seen, part);
                evidence.nats(surface, &seen, 1.0) <= allowed
            });
            if open {
                let (keep, gone) = (group[a].min(group[b]), group[a].max(group[b]));
                group.iter_mut().filter(|g| **g == gone).for_each(|g| *g = keep);
            }
        }
    }
    // Groups are named after their first member, which is their best.
    let first = |(k, _): &(usize, &Candidate)| group[*k] == *k;
    optima.iter().enumerate().filter(first).map(|(_, c)| *c).collect()
}

/// The image of `b` that is nearest to `a`, and how far from it.
fn nearest(evidence: &Evidence, symmetry: &Symmetry, a: &Pose, b: &Pose) -> (Pose, f64) {
    let turn = symmetry.nearest(&(a.rotation * b.rotation.inverse()));
    let image = symmetry.motion(&turn) * b;
    (image, apart(evidence, a, &image))
}

/// Each mode in all its images, as heavy as itself: no contact tells them apart, and none has to be found.
/// Those that no barrier parts are one, as all of a ball's. Of equal ones the least turned comes first.
fn everywhere(
    exact: &Exact,
    evidence: &Evidence,
    symmetry: &Symmetry,
    modes: &[Weighed],
    misfit: f64,
) -> Vec<Weighed> {
    let mut everywhere = Vec::new();
    for mode in modes {
        let image = |motion: Pose| Candidate { seen: motion * mode.seen, nats: 0.0 };
        let images: Vec<Candidate> = symmetry.motions().map(image).collect();
        let mut apart = separate(exact, evidence, &Symmetry::none(), &images, misfit);
        // All of a mode's images, or none.
        if !everywhere.is_empty() && everywhere.len() + apart.len() > MOST {
            break;
        }
        let turn = |c: &Candidate| c.seen.rotation.angle();
        apart.sort_by(|a, b| turn(a).total_cmp(&turn(b)));
        everywhere.extend(apart.iter().map(|c| Weighed { seen: c.seen, ..*mode }));
    }
    let total: f64 = everywhere.iter().map(|m: &Weighed| m.weight).sum();
    everywhere.iter_mut().for_each(|m| m.weight /= total);
    everywhere
}

/// The pose a part of the way from `a` to `b`: the centre moves straight, turning evenly.
fn between(evidence: &Evidence, a: &Pose, b: &Pose, part: f64) -> Pose {
    let motion = b * a.inverse();
    let centre = nalgebra::Point3::from(evidence.centre);
    let shift = motion * centre - centre;
    let turn: Point = UnitQuaternion::scaled_axis(&motion.rotation) * evidence.radius;
    evidence.moved(a, &(Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z) * part))
}

/// Laplace's approximation: likelihood times the volume of the optimum, which no direction makes
/// wider than the object.
fn weighed(exact: &Exact, evidence: &Evidence, optima: &[Candidate], misfit: f64) -> Vec<Weighed> {
    let widest = 1.0 / (evidence.radius * evidence.radius);
    // Logarithm of the mass, and the deviation.
    let measured = |c: &Candidate| {
        let information: Matrix6<f64> = evidence.information(exact, &c.seen, misfit);
        let eigen = SymmetricEigen::new(information).eigenvalues.map(|x| x.max(widest));
        let volume: f64 = eigen.iter().map(|x| -0.5 * x.ln()).sum();
        (volume - c.nats / misfit, eigen.min().sqrt().recip())
    };
    let measured: Vec<(f64, f64)> = optima.par_iter().map(measured).collect();
    let greatest = measured.iter().map(|m| m.0).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = measured.iter().map(|m| (m.0 - greatest).exp()).sum();
    let weigh = |(c, (mass, deviation)): (&Candidate, (f64, f64))| Weighed {
        seen: c.seen,
        weight: (mass - greatest).exp() / total,
        deviation,
    };
    let mut weighed: Vec<Weighed> = optima.iter().zip(measured).map(weigh).collect();
    weighed.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    weighed
}
