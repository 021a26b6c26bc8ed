//! A grasp explained by every hypothesis.

use super::chart::Chart;
use super::hypothesis::Hypothesis;
use super::plane::Touch;
use super::search::{Felt, Odds};
use super::{Hypotheses, VAGUEST};
use crate::contact::FreePoint;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::{Pose, Space};
use crate::track::automatic::{log_sum, wild_of};

/// What became of the contacts of a grasp.
#[derive(Clone, Copy, Default)]
pub(super) struct Outcome {
    pub corrected: bool,
    pub lost: bool,
    pub dropped: u16,
    /// Log density of the contacts.
    pub density: f32,
}

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    /// What hypothesis `slot` expects of contacts.
    pub(super) fn odds(&self, slot: usize) -> Odds {
        let room = self.slots[slot].room(self.reach);
        let all = S::DIRECTIONS * self.reach;
        let density = self.settings.faces / all;
        let wild = self.settings.wild;
        Odds {
            opens: math::ln(density / (1.0 + density * room)),
            wild: [math::ln(wild / all), math::ln(wild / self.reach)],
            whole: math::max(1.0 - 2.0 * room / all, 0.0),
        }
    }

    /// Explains the first `count` touches and the free points by every hypothesis and keeps the best
    /// explanations.
    pub(super) fn absorb(&mut self, count: usize, free: &[FreePoint<S>]) -> Outcome {
        let lost = self.lost > 0;
        let wider = if lost { self.anywhere(&self.touches[..count]) } else { [0.0; 2] };
        self.search.clear();
        for number in 0..self.count {
            let slot = usize::from(self.order[number]);
            let odds = self.odds(slot);
            let felt = Felt { touches: &self.touches[..count], free, wider };
            // The less likely a hypothesis, the fewer ways it gets to explain the grasp.
            let share = match self.slots[slot].weight {
                w if w > -2.0 => 1,
                w if w > -6.0 => 2,
                _ => 4,
            };
            let width = usize::from(self.settings.beam.max(1)).div_ceil(share);
            let (search, work, prior) = (&mut self.search, &mut self.work, &self.slots[slot]);
            if lost {
                let middle = middle(felt.touches);
                let turns = (0..S::TURNS).step_by(8);
                for group in turns {
                    let group = group..(group + 8).min(S::TURNS);
                    let roots = group.map(|i| facing(prior, middle, S::turn(i)));
                    search.explain(work, prior, slot, &felt, &odds, roots, width);
                }
            } else {
                let roots = core::iter::once(S::Tangent::ZERO);
                search.explain(work, prior, slot, &felt, &odds, roots, width);
            }
        }
        let density = self.density();
        let Some(best) = self.search.leaves().first() else {
            return Outcome { lost: self.started, ..Outcome::default() };
        };
        let (known, wild) = (usize::from(best.known), usize::from(best.wild));
        let mapped = self.best().is_some_and(|b| b.faces > S::DIMENSION);
        // Fewer fingers than that must all agree, and one alone fits anywhere.
        let enough = (S::DIMENSION + 1).min(count).max(2);
        let nowhere = if lost {
            known < enough || 3 * wild > count
        } else {
            // New faces explain whatever is felt, where it is felt; what is likelier of no object at all is
            // not felt there.
            let touches = self.touches[..count].iter();
            2 * wild > count
                || known < 2 && density < touches.map(|t| wild_of::<S>(t.directed)).sum()
        };
        if mapped && nowhere {
            return Outcome { lost: true, ..Outcome::default() };
        }
        let corrected = known > 0;
        let dropped = best.wild.into();
        self.select(count, free, wider);
        Outcome { corrected, lost: false, dropped, density }
    }

    /// Variances of where a lost object is, beyond the motion's: it turned who knows how, and moved by half as
    /// much as the touches are from where its middle was expected, or by 100 mm.
    fn anywhere(&self, touches: &[Touch<S>]) -> [f32; 2] {
        let far = self.best().map_or(0.0, |best| {
            let shift = facing(best, middle(touches), S::Tangent::ZERO);
            (0..S::DIMENSION).map(|axis| shift[axis] * shift[axis]).sum()
        });
        [math::min(math::max(0.25 * far, 0.1 * 0.1), VAGUEST[0]), 1.5 * 1.5]
    }

    /// Log density of what was just explained, over all hypotheses and explanations.
    fn density(&self) -> f32 {
        let all = |logs: &mut dyn Iterator<Item = f32>| logs.fold(f32::NEG_INFINITY, log_sum);
        let before =
            self.order[..self.count].iter().map(|slot| self.slots[usize::from(*slot)].weight);
        all(&mut self.search.leaves().iter().map(|leaf| leaf.node.score)) - all(&mut { before })
    }
}

/// The mean of the touches, world frame.
fn middle<S: Space>(touches: &[Touch<S>]) -> S::Vector {
    let mut sum = S::Vector::ZERO;
    for touch in touches {
        sum += touch.point;
    }
    sum * (1.0 / touches.len().max(1) as f32)
}

/// The tangent at the predicted pose that turns the object by `turn` and brings its middle to
/// `middle` (world frame).
fn facing<
    S: Chart,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
>(
    prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    middle: S::Vector,
    turn: S::Tangent,
) -> S::Tangent {
    let (mut own, mut count) = (S::Vector::ZERO, 0.0);
    for (_, point) in prior.witnesses() {
        own += point;
        count += 1.0;
    }
    own = own * (1.0 / math::max(count, 1.0));
    let turned = prior.pose.retract(turn);
    let shift = prior.pose.untransform(middle) - prior.pose.unrotate(turned.rotate(own));
    let mut tangent = turn;
    for i in 0..S::DIMENSION {
        tangent[i] = shift[i];
    }
    tangent
}
