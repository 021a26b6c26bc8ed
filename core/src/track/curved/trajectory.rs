//! The poses of the remembered grasps as one trajectory: how the motion ties them together, what
//! their contacts say about them through the surface that all contacts share, and where they go from
//! there.

use core::ops::Range;

use super::doubt::{Belief, doubt_one, scaled};
use super::memory::{Memory, Move, Remembered};
use super::small::{carried, product, times, transposed_times};
use crate::contact::Contact;
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};
use crate::surface::{Bend, Revisable, Shared};

/// Rows of one contact at most: value and three slopes.
pub(super) const PARTS: usize = 4;

/// Numbers of a tangent at most.
const AXES: usize = 6;

/// Trust that changes by less is as it was.
const TRUST_STEP: f32 = 0.2;

/// Longest step of one iteration: metres and radians; or as long a part of the place's deviation.
const LONGEST: (f32, f32) = (0.03, 0.4);
const LEAP: f32 = 0.3;

/// A trajectory with what it makes of the contacts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hypothesis<S: Space, const GRASPS: usize, const CONTACTS: usize> {
    /// Pose before the oldest remembered grasp, where there was one.
    pub base: S::Pose,
    /// Of every remembered grasp, given all.
    pub poses: [S::Pose; GRASPS],
    /// Where it was proposed, about which everything is linear.
    pub about: [S::Pose; GRASPS],
    /// Tells it from the others of its grasp; not zero.
    pub number: u16,
    pub beliefs: [Belief<S>; CONTACTS],
    /// Log density of all remembered contacts, their poses marginalised (Laplace), and of `free`.
    pub evidence: f32,
    /// Log probability that the fingers which met nothing so far were outside.
    pub free: f32,
    /// Covariance of the last pose.
    pub covariance: S::Covariance,
    pub weight: f32,
}

impl<S: Space, const GRASPS: usize, const CONTACTS: usize> Hypothesis<S, GRASPS, CONTACTS> {
    pub const UNSET: Self = Hypothesis {
        base: S::Pose::UNSET,
        poses: [S::Pose::UNSET; GRASPS],
        about: [S::Pose::UNSET; GRASPS],
        number: 0,
        beliefs: [Belief::UNSET; CONTACTS],
        evidence: 0.0,
        free: 0.0,
        covariance: S::Covariance::ZERO,
        weight: 0.0,
    };

    /// What those of these contacts cost that do not fit.
    pub fn price(&self, contacts: Range<usize>) -> f32 {
        self.beliefs[contacts].iter().map(Belief::price).sum()
    }
}

/// How one grasp's pose follows from those before: x = x̂ ⊕ (offset + transport·η), where x̂ is the pose
/// about which everything is linear, and η is a random walk with the covariance `common`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link<S: Space> {
    offset: S::Tangent,
    transport: S::Covariance,
    common: S::Covariance,
}

impl<S: Space> Link<S> {
    const UNSET: Self = Link {
        offset: S::Tangent::ZERO,
        transport: S::Covariance::ZERO,
        common: S::Covariance::ZERO,
    };

    /// A pose known up to `covariance`.
    fn first(covariance: &S::Covariance) -> Self {
        Link { offset: S::Tangent::ZERO, transport: S::Covariance::IDENTITY, common: *covariance }
    }

    /// The next link, from the pose `from` to `to`.
    fn next(&self, from: &S::Pose, moved: &Move<S>, to: &S::Pose) -> Self {
        let predicted = moved.motion.compose(from);
        let apart = to.local(&predicted);
        // The derivative of `to.local(predicted ⊕ δ)`.
        const STEP: f32 = 1.0 / 64.0;
        let mut turn = S::Covariance::ZERO;
        for axis in 0..S::FREEDOM {
            let mut step = S::Tangent::ZERO;
            step[axis] = STEP;
            let ahead = to.local(&predicted.retract(step));
            step[axis] = -STEP;
            let behind = to.local(&predicted.retract(step));
            for i in 0..S::FREEDOM {
                *turn.at_mut(i, axis) = (ahead[i] - behind[i]) * (0.5 / STEP);
            }
        }
        let mut common = self.common;
        for axis in 0..S::FREEDOM {
            *common.at_mut(axis, axis) += moved.drift.along::<S>(axis);
        }
        Link {
            offset: apart + times::<S>(&turn, self.offset),
            transport: product::<S>(&turn, &self.transport),
            common,
        }
    }
}

/// Where everything remembered meets the map: the workspace for one hypothesis at a time.
#[derive(Clone, Debug)]
pub(super) struct Trajectory<
    S: Space,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> {
    links: [Link<S>; GRASPS],
    /// Of every row of the map with noise in common: what a change of η does to it, and its covariance
    /// with η.
    levers: [S::Tangent; ROWS],
    spreads: [S::Tangent; ROWS],
    /// Workspace: of each row as many numbers as a tangent has, or one for each row of a contact.
    scratch: [[f32; AXES]; ROWS],
    /// Of every contact: its first row (counted from the first in common) and how many.
    rows: [(u16, u8); CONTACTS],
    /// Rows in use.
    used: usize,
    /// Grasps and contacts placed.
    grasps: usize,
    contacts: usize,
    /// What [`Hypothesis`] held of the placed grasps.
    base: S::Pose,
    about: [S::Pose; GRASPS],
    beliefs: [Belief<S>; CONTACTS],
}

impl<S: Space, const GRASPS: usize, const CONTACTS: usize, const ROWS: usize>
    Trajectory<S, GRASPS, CONTACTS, ROWS>
{
    pub const fn new() -> Self {
        Trajectory {
            links: [Link::UNSET; GRASPS],
            levers: [S::Tangent::ZERO; ROWS],
            spreads: [S::Tangent::ZERO; ROWS],
            scratch: [[0.0; AXES]; ROWS],
            rows: [(0, 0); CONTACTS],
            used: 0,
            grasps: 0,
            contacts: 0,
            base: S::Pose::UNSET,
            about: [S::Pose::UNSET; GRASPS],
            beliefs: [Belief::UNSET; CONTACTS],
        }
    }

    /// Nothing is placed: map, memory or the covariance of the first pose is another than it was.
    pub fn clear(&mut self) {
        (self.used, self.grasps, self.contacts) = (0, 0, 0);
    }

    /// Places the contacts of the first `grasps` grasps as the hypothesis has them, in the map above its first `since`
    /// rows. `base` is the covariance of the pose before the oldest grasp; `None` where the oldest grasp
    /// fixes the frame. Grasps that are so already stay: trajectories of one origin share their past.
    pub fn place<M: Revisable<S>>(
        &mut self,
        map: &mut M,
        since: usize,
        base: Option<&S::Covariance>,
        memory: &Memory<S, GRASPS, CONTACTS>,
        hypothesis: &Hypothesis<S, GRASPS, CONTACTS>,
        grasps: usize,
    ) {
        let grasps = grasps.min(memory.grasps().len());
        let kept = self.shared(memory, hypothesis, grasps);
        self.withdraw(map, since, memory, kept);
        for grasp in kept..grasps {
            self.append(map, since, base, memory, hypothesis, grasp);
        }
        map.refit();
    }

    /// How many of the first `grasps` grasps are placed as the hypothesis has them.
    pub fn shared(
        &self,
        memory: &Memory<S, GRASPS, CONTACTS>,
        hypothesis: &Hypothesis<S, GRASPS, CONTACTS>,
        grasps: usize,
    ) -> usize {
        if self.base != hypothesis.base {
            return 0;
        }
        let placed = memory.grasps()[..grasps.min(self.grasps)].iter().enumerate();
        let same = |(grasp, remembered): &(usize, &Remembered<S>)| {
            let touches = remembered.touches();
            self.about[*grasp] == hypothesis.about[*grasp]
                && self.beliefs[touches.clone()] == hypothesis.beliefs[touches]
        };
        placed.take_while(same).count()
    }

    /// Places one grasp more.
    pub fn append<M: Revisable<S>>(
        &mut self,
        map: &mut M,
        since: usize,
        base: Option<&S::Covariance>,
        memory: &Memory<S, GRASPS, CONTACTS>,
        hypothesis: &Hypothesis<S, GRASPS, CONTACTS>,
        grasp: usize,
    ) {
        let Some(remembered) = memory.grasps().get(grasp) else { return };
        let pose = &hypothesis.about[grasp];
        let link = match (grasp.checked_sub(1), base) {
            (None, None) => Link::first(&S::Covariance::ZERO),
            (None, Some(covariance)) => {
                Link::first(covariance).next(&hypothesis.base, &remembered.moved, pose)
            }
            (Some(before), _) => {
                self.links[before].next(&hypothesis.about[before], &remembered.moved, pose)
            }
        };
        self.links[grasp] = link;
        (self.base, self.about[grasp]) = (hypothesis.base, *pose);
        for index in remembered.touches() {
            let (touch, belief) = (&memory.touches()[index], &hypothesis.beliefs[index]);
            self.beliefs[index] = *belief;
            let contact = scaled(touch, belief).seen_from(pose);
            let count = self.row_levers(&contact, belief, &link);
            let mut offset = [0.0; PARTS];
            for (part, offset) in offset[..count].iter_mut().enumerate() {
                *offset = lever(&contact, &belief.bend, part).dot(link.offset);
            }
            let end = self.used + count;
            let shared = Shared {
                offset,
                lever: self.levers.get(self.used..end).unwrap_or(&[]),
                spread: self.spreads.get(..end).unwrap_or(&[]),
                since,
            };
            let taken = map.append(&contact, &shared, self.scratch.as_flattened_mut());
            self.rows[index] = (self.used as u16, taken as u8);
            self.used += taken;
            self.contacts = index + 1;
        }
        self.grasps = grasp + 1;
    }

    /// Takes back all grasps from this one on.
    pub fn withdraw<M: Revisable<S>>(
        &mut self,
        map: &mut M,
        since: usize,
        memory: &Memory<S, GRASPS, CONTACTS>,
        grasp: usize,
    ) {
        let first = memory.touches_of(grasp);
        let rows = &self.rows[first..self.contacts.max(first)];
        self.used = rows.first().map_or(self.used, |(row, _)| usize::from(*row));
        (self.grasps, self.contacts) = (grasp, first);
        map.withdraw(since + self.used);
    }

    /// Writes lever and spread of a contact's rows; how many it has.
    fn row_levers(&mut self, contact: &Contact<S>, belief: &Belief<S>, link: &Link<S>) -> usize {
        let count = if contact.normal.is_some() { 1 + S::DIMENSION } else { 1 };
        for part in 0..count {
            let own = lever(contact, &belief.bend, part);
            let walked = transposed_times::<S>(&link.transport, own);
            if let Some(lever) = self.levers.get_mut(self.used + part) {
                *lever = walked;
                self.spreads[self.used + part] = times::<S>(&link.common, walked);
            }
        }
        count
    }

    /// Moves the poses to where they are most likely given all contacts and motions, to first order:
    /// the posterior mean of the Gaussian process of which they are part.
    pub fn settle<M: Revisable<S>>(
        &self,
        map: &M,
        since: usize,
        memory: &Memory<S, GRASPS, CONTACTS>,
        hypothesis: &mut Hypothesis<S, GRASPS, CONTACTS>,
    ) {
        let weights = map.weights().get(since..).unwrap_or(&[]);
        let sum = |rows: &[S::Tangent], contacts: Range<usize>| {
            let mut sum = S::Tangent::ZERO;
            for (first, count) in &self.rows[contacts] {
                let first = usize::from(*first);
                for row in first..first + usize::from(*count) {
                    sum += rows[row] * weights.get(row).copied().unwrap_or(0.0);
                }
            }
            sum
        };
        // η of a grasp: what grasps up to it say through what is common to them, and later ones by all.
        let mut later = sum(&self.levers, 0..self.contacts);
        let mut earlier = S::Tangent::ZERO;
        for (grasp, remembered) in memory.grasps()[..self.grasps].iter().enumerate() {
            let link = &self.links[grasp];
            later += -sum(&self.levers, remembered.touches());
            earlier += sum(&self.spreads, remembered.touches());
            let walk = earlier + times::<S>(&link.common, later);
            let step = link.offset + times::<S>(&link.transport, walk);
            let step = bounded::<S>(step, &link.common);
            if step.is_finite() {
                hypothesis.poses[grasp] = hypothesis.about[grasp].retract(step);
            }
        }
    }

    /// Posterior covariance of the last pose placed.
    pub fn covariance<M: Revisable<S>>(&mut self, map: &M, since: usize) -> S::Covariance {
        let Some(link) = self.grasps.checked_sub(1).map(|last| self.links[last]) else {
            return S::Covariance::ZERO;
        };
        let used = map.rows().min(ROWS).saturating_sub(since).min(self.used);
        let whitened = &mut self.scratch[..used];
        for (to, spread) in whitened.iter_mut().zip(&self.spreads) {
            *to = core::array::from_fn(|axis| if axis < S::FREEDOM { spread[axis] } else { 0.0 });
        }
        map.whiten(since, whitened);
        let mut covariance = link.common;
        for row in &*whitened {
            let row = S::Tangent::from_fn(|axis| row[axis]);
            covariance.add_outer(-1.0, row, row);
        }
        for axis in 0..S::FREEDOM {
            // Rounding must not take more than there is.
            let least = 1e-5 * link.common.at(axis, axis);
            let variance = covariance.at_mut(axis, axis);
            *variance = math::max(*variance, least);
        }
        carried::<S>(&link.transport, &covariance)
    }

    /// Compares each contact with what all others say, and trusts it accordingly: Student's t with
    /// four degrees of freedom as a normal distribution of uncertain scale. Whether that changes what is
    /// thought of any of `contacts`, which the map hears of when it is laid anew.
    pub fn doubt<M: Revisable<S>>(
        &mut self,
        map: &M,
        since: usize,
        memory: &Memory<S, GRASPS, CONTACTS>,
        hypothesis: &mut Hypothesis<S, GRASPS, CONTACTS>,
        contacts: Range<usize>,
    ) -> bool {
        let mut changed = false;
        for index in contacts.start..contacts.end.min(self.contacts) {
            let (first, count) = self.rows[index];
            let (first, count) = (since + usize::from(first), usize::from(count));
            let belief = &mut hypothesis.beliefs[index];
            let before = belief.trust;
            let workspace = self.scratch.as_flattened_mut();
            doubt_one(map, &memory.touches()[index], first, count, belief, workspace);
            changed |= (belief.trust - before).abs() > TRUST_STEP;
        }
        changed
    }
}

/// What a displacement of the pose does to a row of a contact (object frame): J of
/// [`Shared`](crate::surface::Shared). The contact moves against the surface, whose value and slope
/// change by ∇f and its slopes there; and the normal turns.
pub(super) fn lever<S: Space>(contact: &Contact<S>, bend: &Bend<S>, part: usize) -> S::Tangent {
    let Some(axis) = part.checked_sub(1) else {
        return -S::lever(contact.point, bend.gradient);
    };
    let mut lever = -S::lever(contact.point, bend.curvature[axis]);
    if let Some(normal) = contact.normal {
        let mut direction = S::Vector::ZERO;
        direction[axis] = 1.0;
        let turn = S::lever(normal, direction);
        for i in S::DIMENSION..S::FREEDOM {
            lever[i] += turn[i];
        }
    }
    lever
}

/// The step, shortened where it is too long to be linear. An object whose place has a greater variance than
/// hands leave, per axis at most `covariance`, is a greater one.
pub(super) fn bounded<S: Space>(step: S::Tangent, covariance: &S::Covariance) -> S::Tangent {
    let (mut shift, mut turn, mut vaguest) = (0.0, 0.0, 0.0);
    for i in 0..S::FREEDOM {
        if i < S::DIMENSION {
            shift += step[i] * step[i];
            vaguest = math::max(vaguest, covariance.at(i, i));
        } else {
            turn += step[i] * step[i];
        }
    }
    let longest = math::max(LONGEST.0, LEAP * math::sqrt(vaguest));
    let over = math::max(math::sqrt(shift) / longest, math::sqrt(turn) / LONGEST.1);
    if over > 1.0 { step * (1.0 / over) } else { step }
}
