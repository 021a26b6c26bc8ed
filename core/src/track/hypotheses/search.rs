//! Which contact lies on which plane: a beam search over the answers, each scored by its exact
//! Gaussian evidence.

use crate::contact::FreePoint;
use crate::math::{self, normal};
use crate::matrix::Coordinates;
use crate::space::{Pose, Space};

use super::beam::{Beam, FACE, Node, OPENS, WILD};
use super::chart::Chart;
use super::hypothesis::Hypothesis;
use super::plane::{BEYOND, Record, Touch};
use super::work::Work;

/// Partial answers kept at most while a grasp is being explained.
const BEAM: usize = 16;

/// Whole answers kept at most, of all hypotheses.
pub(super) const LEAVES: usize = 32;

/// Answers with the same labels this close together (metres and radians, squared) are one.
const COPY: f32 = 1e-5;

/// Partial answers this many nats behind the best are given up.
const HOPELESS: f32 = 12.0;

/// An answer for a whole grasp.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaf<S: Space> {
    pub node: Node<S>,
    /// Which hypothesis it continues.
    pub parent: u8,
    /// Contacts on faces known before, on faces opened, and on none.
    pub known: u8,
    pub opened: u8,
    pub wild: u8,
    /// Object to world.
    pub pose: S::Pose,
}

/// What is expected of contacts before they are felt.
#[derive(Clone, Copy, Debug)]
pub(super) struct Odds {
    /// Log density of a contact that opens a face.
    pub opens: f32,
    /// Log density of a wild contact with a normal, and without one.
    pub wild: [f32; 2],
    /// In [0, 1]: how far the map is known to be whole, so that what is inside its planes is inside
    /// the object.
    pub whole: f32,
}

impl Odds {
    fn of_wild<S: Space>(&self, touch: &Touch<S>) -> f32 {
        self.wild[usize::from(!touch.directed)]
    }
}

/// A grasp as the filter takes it.
#[derive(Clone, Copy)]
pub(super) struct Felt<'a, S: Space> {
    pub touches: &'a [Touch<S>],
    pub free: &'a [FreePoint<S>],
    /// Where the object is looked for, as a tangent at the predicted pose.
    pub about: S::Tangent,
    /// Further doubt about that: variances of each translation and rotation.
    pub wider: [f32; 2],
}

impl<'a, S: Space> Felt<'a, S> {
    /// The object is about where it was predicted.
    pub fn expected(touches: &'a [Touch<S>], free: &'a [FreePoint<S>], wider: [f32; 2]) -> Self {
        Felt { touches, free, about: S::Tangent::ZERO, wider }
    }
}

/// Log probability that a point is on the right side: its height in metres, the variance of that,
/// and how often such a thing is not so.
fn allowed([height, variance]: [f32; 2], doubt: f32) -> f32 {
    if height <= 0.0 && height * height > 9.0 * variance {
        return 0.0;
    }
    math::ln(doubt + (1.0 - 2.0 * doubt) * normal(-height / math::sqrt(variance)).1)
}

/// Log probability of a contact where it is: that it does not lie beyond planes it is not on.
fn inside_others<
    S: Chart,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
>(
    work: &Work<S, FACES, ROWS, PACKED>,
    prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    touch: &Touch<S>,
) -> f32 {
    let mut least = 0.0;
    for face in 0..prior.faces {
        let height = work.height(touch.point, touch.point_variance, &prior.pose, face);
        least =
            math::min(least, allowed(height, Record::<S>::doubt(prior.records[face].reentrant)));
    }
    least
}

/// Conditions `work` on what is known beside the contacts' own planes: that they lie inside the
/// others, and that fingers which met nothing are outside; the log probability of that.
pub(super) fn settle<
    S: Chart,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
>(
    work: &mut Work<S, FACES, ROWS, PACKED>,
    prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    felt: &Felt<'_, S>,
    labels: &[u8],
    odds: &Odds,
) -> f32 {
    let mut score = 0.0;
    for face in 0..prior.faces {
        let others = felt.touches.iter().zip(labels);
        let others = others.filter(|(_, l)| **l != WILD && **l != FACE + face as u8);
        // Either the plane bounds the object or it does not, for all contacts alike.
        let (mut bounds, mut reenters, mut near) = (0.0, 0.0, false);
        for (touch, _) in others.clone() {
            let [height, variance] =
                work.height(touch.point, touch.point_variance, &prior.pose, face);
            let mut inside = 1.0;
            if height > 0.0 || height * height < 9.0 * variance {
                inside = normal(-height / math::sqrt(variance)).1;
                near = true;
            }
            bounds += math::ln(BEYOND[0] + (1.0 - 2.0 * BEYOND[0]) * inside);
            reenters += math::ln(BEYOND[1] + (1.0 - 2.0 * BEYOND[1]) * inside);
        }
        let odds = prior.records[face].reentrant;
        let (bounds, reenters) =
            (math::ln(1.0 - odds) + bounds, math::ln(math::max(odds, 1e-6)) + reenters);
        let least = math::max(bounds, reenters);
        let (a, b) = (math::exp(bounds - least), math::exp(reenters - least));
        score += least + math::ln(a + b);
        if near {
            let doubt = Record::<S>::doubt(b / (a + b));
            for (touch, _) in others {
                let point = (touch.point, touch.point_variance);
                work.bound(point, &prior.pose, face, (1.0, doubt));
            }
        }
    }
    if prior.faces <= S::DIMENSION {
        return score;
    }
    let doubt = 0.5 - 0.45 * odds.whole;
    for finger in felt.free.iter().filter(|f| f.point.is_finite()) {
        // Outside the object is outside one of its planes: the one it is outside of most.
        let pose = prior.pose.retract(work.tangent());
        let point = pose.untransform(finger.point);
        let (mut highest, mut outermost) = (f32::NEG_INFINITY, 0);
        for (face, plane) in work.planes[..prior.faces].iter().enumerate() {
            let height = plane.height(point);
            if height > highest {
                (highest, outermost) = (height, face);
            }
        }
        score += work.bound((finger.point, 1e-6), &prior.pose, outermost, (-1.0, doubt));
    }
    score
}

/// Log probability of a face at a contact: that no point touched before lies beyond it.
fn cuts_nothing<
    S: Chart,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
>(
    work: &Work<S, FACES, ROWS, PACKED>,
    prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    touch: &Touch<S>,
) -> f32 {
    let doubt = if prior.is_concave() { 0.2 } else { 0.02 };
    let pose = prior.pose.retract(work.tangent());
    let normal = pose.unrotate(touch.normal);
    let point = pose.untransform(touch.point);
    let (mut shift, mut turn) = (0.0, 0.0);
    for i in 0..S::FREEDOM {
        if i < S::DIMENSION { shift += work.joint.at(i, i) } else { turn += work.joint.at(i, i) }
    }
    shift *= 1.0 / S::DIMENSION as f32;
    turn = touch.normal_variance + turn / (S::FREEDOM - S::DIMENSION) as f32;
    let mut least = 0.0;
    for (_, witness) in prior.witnesses() {
        let arm = witness - point;
        let variance = 2.0 * touch.point_variance + shift + turn * arm.norm_squared();
        least = math::min(least, allowed([normal.dot(arm), variance], doubt));
    }
    least
}

/// Conditions `work` on contacts as `labels` say, linearised at the tangent `at`; the log evidence.
pub(super) fn replay<
    S: Chart,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
>(
    work: &mut Work<S, FACES, ROWS, PACKED>,
    prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    felt: &Felt<'_, S>,
    labels: &[u8],
    at: S::Tangent,
) -> f32 {
    work.begin(prior, felt.about, felt.wider);
    let mut density = 0.0;
    for (touch, label) in felt.touches.iter().zip(labels) {
        match *label {
            WILD => {}
            OPENS => {
                if work.open(touch, &prior.pose, at).is_none() {
                    return f32::NEG_INFINITY;
                }
            }
            face => density += work.observe(touch, &prior.pose, at, usize::from(face - FACE)),
        }
    }
    density
}

/// The search for one hypothesis after the other.
#[derive(Clone, Debug)]
pub(super) struct Search<S: Space> {
    now: Beam<S, BEAM>,
    next: Beam<S, BEAM>,
    leaves: [Leaf<S>; LEAVES],
    count: usize,
}

impl<S: Chart> Search<S> {
    pub const fn new() -> Self {
        let leaf = Leaf {
            node: Node::UNSET,
            parent: 0,
            known: 0,
            opened: 0,
            wild: 0,
            pose: S::Pose::UNSET,
        };
        Search { now: Beam::new(), next: Beam::new(), leaves: [leaf; LEAVES], count: 0 }
    }

    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Whole answers, best first.
    pub fn leaves(&self) -> &[Leaf<S>] {
        &self.leaves[..self.count]
    }

    /// Explains a grasp by the hypothesis number `parent` with at most `width` partial answers at a time. They
    /// are sought as if it were known that the object is `near`, and weighed without.
    #[allow(clippy::too_many_arguments)]
    pub fn explain<
        const FACES: usize,
        const ROWS: usize,
        const PACKED: usize,
        const GRASPS: usize,
    >(
        &mut self,
        work: &mut Work<S, FACES, ROWS, PACKED>,
        prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
        parent: usize,
        felt: &Felt<'_, S>,
        near: &Felt<'_, S>,
        odds: &Odds,
        width: usize,
    ) {
        self.now.start(near.about);
        for (index, touch) in felt.touches.iter().enumerate() {
            self.next.clear();
            let hopeless = self.now.as_slice().first().map_or(0.0, |n| n.score) - HOPELESS;
            for number in 0..self.now.as_slice().len() {
                let node = self.now.as_slice()[number];
                if node.score < hopeless {
                    break;
                }
                replay(work, prior, near, &node.labels[..index], node.tangent);
                self.extend(work, prior, index, touch, &node, odds, width);
            }
            core::mem::swap(&mut self.now, &mut self.next);
        }
        for number in 0..self.now.as_slice().len() {
            let node = self.now.as_slice()[number];
            let best = self.leaves().first().map_or(f32::NEG_INFINITY, |l| l.node.score);
            if prior.weight + node.score < best - 2.0 * HOPELESS {
                break;
            }
            self.finish(work, prior, parent, felt, odds, node);
        }
    }

    /// All that one more contact may be.
    #[allow(clippy::too_many_arguments)]
    #[inline(never)]
    fn extend<const FACES: usize, const ROWS: usize, const PACKED: usize, const GRASPS: usize>(
        &mut self,
        work: &Work<S, FACES, ROWS, PACKED>,
        prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
        index: usize,
        touch: &Touch<S>,
        node: &Node<S>,
        odds: &Odds,
        width: usize,
    ) {
        let child = |label, tangent, density| {
            let mut labels = node.labels;
            labels[index] = label;
            Node { labels, tangent, score: node.score + density }
        };
        // Normals further apart than five deviations need no closer look.
        let mut variance = touch.normal_variance + 0.01;
        for i in S::DIMENSION..S::FREEDOM {
            variance += work.joint.at(i, i);
        }
        let normal = prior.pose.retract(work.tangent()).unrotate(touch.normal);
        let apart = |face: usize| {
            touch.directed && 1.0 - work.planes[face].normal.dot(normal) > 10.0 * variance
        };
        for face in (0..work.faces).filter(|f| !apart(*f)) {
            if let Some(found) = work.fit(touch, &prior.pose, face)
                && found.density > odds.of_wild(touch) - 4.0
            {
                let label = FACE + face as u8;
                self.next.offer(child(label, found.tangent, found.density), width);
            }
        }
        let wild = odds.of_wild(touch);
        let mut opens = f32::NEG_INFINITY;
        if touch.directed && work.faces < FACES {
            opens =
                odds.opens + cuts_nothing(work, prior, touch) + inside_others(work, prior, touch);
        }
        let (label, density) = if opens > wild { (OPENS, opens) } else { (WILD, wild) };
        self.next.offer(child(label, work.tangent(), density), width);
    }

    /// Scores a whole answer at its own best pose.
    #[inline(never)]
    fn finish<const FACES: usize, const ROWS: usize, const PACKED: usize, const GRASPS: usize>(
        &mut self,
        work: &mut Work<S, FACES, ROWS, PACKED>,
        prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
        parent: usize,
        felt: &Felt<'_, S>,
        odds: &Odds,
        mut node: Node<S>,
    ) {
        let labels = &node.labels[..felt.touches.len()];
        replay(work, prior, felt, labels, node.tangent);
        node.tangent = work.tangent();
        let mut score = replay(work, prior, felt, labels, node.tangent);
        let mut leaf =
            Leaf { node, parent: parent as u8, known: 0, opened: 0, wild: 0, pose: prior.pose };
        for (touch, &label) in felt.touches.iter().zip(labels) {
            match label {
                WILD => {
                    leaf.wild += 1;
                    score += odds.of_wild(touch);
                }
                OPENS => {
                    let face = prior.faces + usize::from(leaf.opened);
                    // A face that would be joined with another at once need not be opened.
                    let doubled = (0..face).filter_map(|other| work.coincidence(other, face));
                    if doubled.into_iter().any(|density| density > odds.opens) {
                        return;
                    }
                    leaf.opened += 1;
                    score += odds.opens + cuts_nothing(work, prior, touch);
                }
                face => leaf.known += u8::from(usize::from(face - FACE) < prior.faces),
            }
        }
        score += settle(work, prior, felt, labels, odds);
        leaf.pose = prior.pose.retract(work.tangent());
        leaf.node.score = prior.weight + score;
        self.keep(leaf);
    }

    fn keep(&mut self, leaf: Leaf<S>) {
        if !leaf.node.score.is_finite() || !leaf.pose.is_finite() {
            return;
        }
        // The same answer, found from another root of a lost object.
        let same = |other: &Leaf<S>| {
            (other.parent, other.node.labels) == (leaf.parent, leaf.node.labels)
                && (other.node.tangent + leaf.node.tangent * -1.0).norm_squared() < COPY
        };
        if let Some(copy) = self.leaves().iter().position(same) {
            if self.leaves[copy].node.score >= leaf.node.score {
                return;
            }
            self.leaves.copy_within(copy + 1..self.count, copy);
            self.count -= 1;
        }
        let mut place = self.count;
        while place > 0 && self.leaves[place - 1].node.score < leaf.node.score {
            place -= 1;
        }
        if place >= LEAVES {
            return;
        }
        self.count = (self.count + 1).min(LEAVES);
        self.leaves.copy_within(place..self.count - 1, place + 1);
        self.leaves[place] = leaf;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::{Planar, PlanarPose};

    #[test]
    fn an_answer_found_from_two_roots_counts_once() {
        let mut search = Search::<Planar>::new();
        let leaf = |x: f32, label: u8, score: f32| {
            let mut node = Node::UNSET;
            (node.labels[0], node.tangent, node.score) = (label, Vector([x, 0.0, 0.0]), score);
            let pose = PlanarPose::new(Vector([x, 0.0]), 0.0);
            Leaf { node, parent: 0, known: 1, opened: 0, wild: 0, pose }
        };
        for (x, label, score) in [
            (0.0, FACE, 1.0),
            (1e-4, FACE, 2.0),
            (2e-4, FACE, 0.0),
            (0.1, FACE, 0.5),
            (0.0, WILD, 0.0),
        ] {
            search.keep(leaf(x, label, score));
        }
        let scores = search.leaves().iter().map(|l| l.node.score);
        assert!(scores.eq([2.0, 0.5, 0.0]));
    }
}
