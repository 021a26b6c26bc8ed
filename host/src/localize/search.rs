//! Scaling series: many poses under wide deviations, ever fewer under ever narrower ones
//! (Petrovskaya & Khatib 2011), each moved to its nearest optimum by Gauss–Newton steps instead of
//! at random.

use rayon::prelude::*;

use super::likelihood::Evidence;
use super::proposals::Proposals;
use super::{Settings, Surface};
use crate::space::Pose;

/// Poses drawn in one round.
const DRAWN: usize = 3072;

/// Poses that go on to the widest deviations, and to each narrower ones.
const KEPT: [usize; 5] = [320, 128, 64, 32, 24];

/// Gauss–Newton steps under the widest and under each narrower deviation but the last.
const STEPS: usize = 3;

/// Steps under the stated deviations.
const LAST_STEPS: usize = 8;

/// The widest standard deviation is this part of the object's radius.
const WIDEST: f64 = 0.12;

/// Each level narrows them by this factor; the last two have the stated ones.
const NARROWER: f64 = 2.5;

/// Contacts that suffice while deviations are wide.
const FEW: usize = 24;

/// Poses closer than this part of the object's radius are one.
const SAME: f64 = 0.01;

/// The search ends when so many rounds in a row bring nothing better by [`BETTER`]: at least, and
/// over the number of contacts. Few contacts have more optima, and cost less.
const IDLE: [usize; 2] = [2, 40];

/// Nats.
const BETTER: f64 = 0.5;

/// A pose (world to object) and its negative log likelihood.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub seen: Pose,
    pub nats: f64,
}

/// What a search found.
pub(super) struct Found {
    /// Optima, best first, none twice.
    pub candidates: Vec<Candidate>,
    /// Poses looked at.
    pub drawn: usize,
}

/// Searches all poses.
pub(super) fn search<S: Surface>(
    surface: &S,
    evidence: &Evidence,
    proposals: &mut Proposals,
    settings: &Settings,
) -> Found {
    let few = evidence.spread(FEW);
    let usual = evidence.contacts.iter().map(|c| c.point_deviation).sum::<f64>()
        / evidence.contacts.len().max(1) as f64;
    let widest = (WIDEST * evidence.radius / usual).max(1.0);
    let mut pool: Vec<Candidate> = Vec::new();
    let enough = (IDLE[1] / evidence.contacts.len().max(1)).max(IDLE[0]);
    let (mut idle, mut drawn) = (0, 0);
    for _ in 0..settings.rounds {
        let poses: Vec<Pose> = (0..DRAWN).map(|_| proposals.draw(&few)).collect();
        drawn += poses.len();
        let mut candidates: Vec<Candidate> = poses
            .into_par_iter()
            .map(|seen| Candidate { nats: few.nats(surface, &seen, widest), seen })
            .collect();
        let mut width = widest;
        for (level, kept) in KEPT.iter().enumerate() {
            best_first(&mut candidates);
            candidates.truncate(*kept);
            // All contacts and the stated deviations from the last but one level on.
            let mut which = &few;
            if level + 2 >= KEPT.len() {
                (which, width) = (evidence, 1.0);
            }
            let last = level + 1 == KEPT.len();
            let steps = if last { LAST_STEPS } else { STEPS };
            let descend = |c: &Candidate| descend(surface, which, &c.seen, width, steps);
            candidates = candidates.par_iter().map(descend).collect();
            best_first(&mut candidates);
            // Not worth the while among the first many.
            if level > 0 {
                distinct(&mut candidates, evidence, usize::MAX);
            }
            width = (width / NARROWER).max(1.0);
        }
        let least = |part: &[Candidate]| part.iter().map(|c| c.nats).fold(f64::MAX, f64::min);
        let better = least(&candidates) < least(&pool) - BETTER;
        idle = if better { 0 } else { idle + 1 };
        pool.append(&mut candidates);
        best_first(&mut pool);
        distinct(&mut pool, evidence, settings.optima);
        if idle >= enough {
            break;
        }
    }
    Found { candidates: pool, drawn }
}

/// The best optimum that can be reached from any of `starts` poses, refined on the exact surface.
pub(super) fn exhaustive<G: Surface, E: Surface>(
    grid: &G,
    exact: &E,
    evidence: &Evidence,
    proposals: &mut Proposals,
    starts: usize,
) -> Option<Candidate> {
    let poses: Vec<Pose> = (0..starts).map(|_| proposals.draw(evidence)).collect();
    let down = |seen: Pose| {
        let widths = [30.0, 10.0, 3.0, 1.0];
        let end = widths.iter().fold(seen, |s, w| descend(grid, evidence, &s, *w, 12).seen);
        Candidate { nats: evidence.nats(grid, &end, 1.0), seen: end }
    };
    let mut ends: Vec<Candidate> = poses.into_par_iter().map(down).collect();
    best_first(&mut ends);
    distinct(&mut ends, evidence, KEPT[0]);
    let polish = |c: &Candidate| descend(exact, evidence, &c.seen, 1.0, 100);
    let mut best: Vec<Candidate> = ends.par_iter().map(polish).collect();
    best_first(&mut best);
    best.first().copied()
}

/// Levenberg–Marquardt from `seen`, at most `steps` steps.
pub(super) fn descend<S: Surface>(
    surface: &S,
    evidence: &Evidence,
    seen: &Pose,
    width: f64,
    steps: usize,
) -> Candidate {
    let mut seen = *seen;
    let mut here = evidence.about(surface, &seen, width);
    let mut damping = 1e-3;
    for _ in 0..steps {
        let Some(mut step) = here.step(damping) else { break };
        // A turn of half a radian is as far as the linearisation can be trusted.
        let length = step.norm();
        if !length.is_finite() {
            break;
        }
        if length > 0.5 * evidence.radius {
            step *= 0.5 * evidence.radius / length;
        }
        let tried = evidence.moved(&seen, &step);
        let there = evidence.about(surface, &tried, width);
        if there.nats < here.nats {
            let settled = length < 1e-7 && here.nats - there.nats < 1e-6;
            (seen, here) = (tried, there);
            damping = (damping * 0.2).max(1e-9);
            if settled {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e3 {
                break;
            }
        }
    }
    Candidate { seen, nats: here.nats }
}

/// In order of likelihood; equal ones stay in the order they were found.
pub(super) fn best_first(candidates: &mut [Candidate]) {
    candidates.sort_by(|a, b| a.nats.total_cmp(&b.nats));
}

/// Drops every pose that is close to a better one, and all but the first `most`.
pub(super) fn distinct(candidates: &mut Vec<Candidate>, evidence: &Evidence, most: usize) {
    let mut kept: Vec<Candidate> = Vec::with_capacity(candidates.len().min(most));
    for candidate in candidates.iter() {
        if kept.len() >= most {
            break;
        }
        let close = |k: &Candidate| apart(evidence, &k.seen, &candidate.seen);
        if kept.iter().all(|k| close(k) > SAME * evidence.radius) {
            kept.push(*candidate);
        }
    }
    *candidates = kept;
}

/// How far two poses (world to object) are apart: how far the object's centre moves and its rim
/// about that, metres. Turns count by their chord.
pub(super) fn apart(evidence: &Evidence, a: &Pose, b: &Pose) -> f64 {
    let turn = a.rotation.coords.dot(&b.rotation.coords);
    let chord = 2.0 * (2.0 * (1.0 - turn.abs()).max(0.0)).sqrt();
    let centre = |p: &Pose| p.rotation.inverse() * (evidence.centre - p.translation.vector);
    (centre(a) - centre(b)).norm() + evidence.radius * chord
}
