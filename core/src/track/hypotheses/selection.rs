//! The best explanations of a grasp become the hypotheses.

use super::Hypotheses;
use super::beam::{FACE, OPENS, WILD};
use super::chart::Chart;
use super::hypothesis::Hypothesis;
use super::search::{Felt, Leaf, Odds, replay, settle};
use crate::contact::FreePoint;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Pose;
use crate::track::Separation;

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    /// Hypotheses less likely than the best by this many nats are given up.
    const FORLORN: f32 = 15.0;

    /// Replaces the hypotheses by the best explanations.
    pub(super) fn select(&mut self, count: usize, free: &[FreePoint<S>], wider: [f32; 2]) {
        let mut chosen = [0u8; K];
        let mut kept = 0;
        let best = self.search.leaves()[0].node.score;
        for (number, leaf) in self.search.leaves().iter().enumerate() {
            if kept == K || leaf.node.score < best - Self::FORLORN {
                break;
            }
            let same = chosen[..kept]
                .iter()
                .any(|c| self.same(&self.search.leaves()[usize::from(*c)], leaf));
            if !same {
                chosen[kept] = number as u8;
                kept += 1;
            }
        }
        // A hypothesis with several children is copied for all but one of them, into slots without.
        let mut taken = [false; K];
        for c in &chosen[..kept] {
            taken[usize::from(self.search.leaves()[usize::from(*c)].parent)] = true;
        }
        let mut inherited = [false; K];
        let mut order = [0u8; K];
        for (place, c) in order.iter_mut().zip(&chosen[..kept]) {
            let parent = usize::from(self.search.leaves()[usize::from(*c)].parent);
            let mut slot = parent;
            if core::mem::replace(&mut inherited[parent], true)
                && let Some(free) = taken.iter().position(|t| !t)
            {
                taken[free] = true;
                slot = free;
                if let Ok([to, from]) = self.slots.get_disjoint_mut([free, parent]) {
                    to.copy_from(from);
                }
            }
            *place = slot as u8;
        }
        for (slot, c) in order.iter().zip(&chosen[..kept]) {
            let leaf = self.search.leaves()[usize::from(*c)];
            self.continue_with(usize::from(*slot), &leaf, count, free, wider);
        }
        (self.order, self.count) = (order, kept);
        self.remember_search(wider);
        self.rank();
    }

    /// A lost object may have gone as far as it was sought: else the grasps before would be taken to have
    /// been misplaced by a share of it.
    #[inline(never)]
    fn remember_search(&mut self, wider: [f32; 2]) {
        for slot in &self.order[..self.count] {
            let hypothesis = &mut self.slots[usize::from(*slot)];
            if let Some(past) = hypothesis.past.get_mut(self.grasps as usize % GRASPS.max(1)) {
                past.noise[0] += wider[0];
                past.noise[1] += wider[1];
            }
        }
    }

    /// Whether two explanations say the same of pose and planes.
    fn same(&self, a: &Leaf<S>, b: &Leaf<S>) -> bool {
        const NEAR: Separation = Separation { translation: 1.5e-3, rotation: 0.03 };
        let (p, q) = (usize::from(a.parent), usize::from(b.parent));
        let [p, q] = [p, q].map(|i| self.slots.get(i));
        let (Some(p), Some(q)) = (p, q) else { return false };
        p.faces + usize::from(a.opened) == q.faces + usize::from(b.opened)
            && NEAR.between::<S>(&a.pose, &b.pose) < 1.0
            && (a.parent == b.parent || alike(p, q))
    }

    /// Conditions the hypothesis in a slot on an explanation of the grasp.
    fn continue_with(
        &mut self,
        slot: usize,
        leaf: &Leaf<S>,
        count: usize,
        free: &[FreePoint<S>],
        wider: [f32; 2],
    ) {
        let odds = self.odds(slot);
        let felt = Felt::expected(&self.touches[..count], free, wider);
        let labels = &leaf.node.labels[..count];
        let hypothesis = &mut self.slots[slot];
        let mut opened = hypothesis.faces;
        replay(&mut self.work, hypothesis, &felt, labels, leaf.node.tangent);
        settle(&mut self.work, hypothesis, &felt, labels, &odds);
        for (touch, label) in felt.touches.iter().zip(labels).filter(|(_, l)| **l != WILD) {
            for face in (0..hypothesis.faces).filter(|f| *label != FACE + *f as u8) {
                let [height, variance] =
                    self.work.height(touch.point, touch.point_variance, &hypothesis.pose, face);
                let record = &mut hypothesis.records[face];
                record.tested = record.tested.saturating_add(1);
                if height > 3.0 * math::sqrt(variance) {
                    record.beyond = record.beyond.saturating_add(1);
                }
            }
        }
        hypothesis.adopt(&self.work);
        for (touch, label) in felt.touches.iter().zip(labels) {
            let face = match *label {
                WILD => continue,
                OPENS => {
                    opened += 1;
                    opened - 1
                }
                face => usize::from(face - FACE),
            };
            let point = hypothesis.pose.untransform(touch.point);
            if let Some(record) = hypothesis.records.get_mut(face) {
                record.touch(point);
            }
        }
        let concave = hypothesis.is_concave();
        for record in &mut hypothesis.records[..hypothesis.faces] {
            record.judge(concave);
        }
        hypothesis.weight = leaf.node.score;
        self.merge(slot, &odds);
    }

    /// Joins planes that are one: where that they coincide is likelier than that a second was opened
    /// (the ratio is the density of their difference at zero over that of a new face; Dickey 1971).
    fn merge(&mut self, slot: usize, odds: &Odds) {
        let (hypothesis, work) = (&mut self.slots[slot], &mut self.work);
        work.begin(hypothesis, S::Tangent::ZERO, [0.0; 2]);
        let mut b = 1;
        while b < hypothesis.faces {
            let mut joined = false;
            for a in 0..b {
                if let Some(gain) = work.coincidence(a, b)
                    && gain > odds.opens
                {
                    work.join(a, b);
                    hypothesis.adopt(work);
                    hypothesis.weight += gain - odds.opens;
                    let record = hypothesis.records[b];
                    hypothesis.records[a].merge(&record);
                    hypothesis.forget_face(b);
                    work.begin(hypothesis, S::Tangent::ZERO, [0.0; 2]);
                    joined = true;
                    break;
                }
            }
            if !joined {
                b += 1;
            }
        }
    }

    /// Sorts by weight, the best to zero, and gives up the forlorn.
    fn rank(&mut self) {
        for i in 1..self.count {
            let mut j = i;
            let weight = |i: usize| self.slots[usize::from(self.order[i])].weight;
            let own = weight(i);
            while j > 0 && weight(j - 1) < own {
                j -= 1;
            }
            self.order[j..=i].rotate_right(1);
        }
        let best = self.best().map_or(0.0, |b| b.weight);
        for slot in &self.order[..self.count] {
            self.slots[usize::from(*slot)].weight -= best;
        }
        let slots = &self.slots;
        let kept = |i: &&u8| slots[usize::from(**i)].weight > -Self::FORLORN;
        self.count = self.order[..self.count].iter().take_while(kept).count();
    }
}

/// Whether two hypotheses have the same planes.
fn alike<
    S: Chart,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
>(
    a: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    b: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
) -> bool {
    a.planes[..a.faces].iter().all(|p| {
        b.planes[..b.faces]
            .iter()
            .any(|q| p.normal.dot(q.normal) > 0.998 && (p.offset - q.offset).abs() < 2e-3)
    })
}
