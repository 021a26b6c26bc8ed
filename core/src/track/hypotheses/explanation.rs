//! A grasp explained by every hypothesis.

use super::alignment::{ANY_TURN, Alignments, between, middle};
use super::chart::Chart;
use super::plane::Touch;
use super::search::{Felt, Odds};
use super::{Hypotheses, VAGUEST};
use crate::contact::FreePoint;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Pose;
use crate::track::automatic::{log_sum, wild_of};

/// What became of the contacts of a grasp.
#[derive(Clone, Copy)]
pub(super) struct Outcome {
    pub corrected: bool,
    pub lost: bool,
    /// Whether only a slip to anywhere explains it.
    pub slipped: bool,
    pub dropped: u16,
    /// Log density of the contacts.
    pub density: f32,
}

impl Outcome {
    /// Nothing happened.
    pub const NONE: Self =
        Outcome { corrected: false, lost: false, slipped: false, dropped: 0, density: 0.0 };
}

/// How a grasp is explained best: contacts on known faces, on none, and the log density of all.
#[derive(Clone, Copy)]
struct Found {
    known: usize,
    wild: usize,
    density: f32,
}

impl Found {
    /// Whether as many fingers agree as tell where an object is. Fewer than that must all agree, and one alone
    /// fits anywhere.
    fn is_sure(&self, dimension: usize, count: usize) -> bool {
        let enough = (dimension + 1).min(count).max(2);
        self.known >= enough && 3 * self.wild <= count
    }
}

/// No doubt about where the object is but the motion's.
const HERE: [f32; 2] = [0.0; 2];

/// Log probability that the object slipped to anywhere since the last grasp: 3 %.
const SLIP: f32 = -3.5;

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
    /// explanations; as the first part of a grasp, or where its first part was.
    ///
    /// What known faces have next to no part in, or what is no likelier so than contacts with nothing in
    /// particular, is sought wherever the object may have slipped to: faces are endless, and new ones explain
    /// whatever is felt, where it is felt.
    #[inline(never)]
    pub(super) fn absorb(
        &mut self,
        count: usize,
        free: &[FreePoint<S>],
        is_first: bool,
    ) -> Outcome {
        const LOST: Outcome = Outcome { lost: true, ..Outcome::NONE };
        let mapped = self.best().is_some_and(|b| b.faces > S::DIMENSION);
        let anywhere = self.anywhere(&self.touches[..count]);
        if self.lost > 0 {
            let found = self.explain(count, free, anywhere);
            let found = found.filter(|found| !mapped || found.is_sure(S::DIMENSION, count));
            return found.map_or(LOST, |found| self.take(found, count, free, anywhere));
        }
        let Some(here) = self.explain(count, free, HERE) else {
            return Outcome { lost: self.started, ..Outcome::NONE };
        };
        let touches = self.touches[..count].iter();
        let wild = |touch: &Touch<S>| wild_of::<S>(touch.directed, touch.point_variance);
        let nothing: f32 = touches.map(wild).sum();
        let poor = mapped && is_first && !(here.density > nothing);
        let sought = poor || mapped && is_first && here.known < 2;
        if sought && let Some(slipped) = self.explain(count, free, anywhere) {
            let density = slipped.density + SLIP;
            if slipped.is_sure(S::DIMENSION, count) && density > math::max(here.density, nothing) {
                let outcome = self.take(slipped, count, free, anywhere);
                return Outcome { slipped: true, density, ..outcome };
            }
        }
        if mapped && (2 * here.wild > count || poor && here.known < 2) {
            return LOST;
        }
        if sought {
            // In vain.
            self.explain(count, free, HERE);
        }
        self.take(here, count, free, HERE)
    }

    /// Explanations by every hypothesis, of an object that is where it was expected, or with this further
    /// doubt about it turned to all sides; the best of them. `None` where there is none.
    fn explain(&mut self, count: usize, free: &[FreePoint<S>], wider: [f32; 2]) -> Option<Found> {
        self.search.clear();
        let touches = &self.touches[..count];
        let sought = wider[1] > 0.0;
        let places = match self.best() {
            Some(best) if sought => Alignments::of(best, touches),
            _ => Alignments::none(),
        };
        for number in 0..self.count {
            let slot = usize::from(self.order[number]);
            let odds = self.odds(slot);
            let felt = Felt::expected(&self.touches[..count], free, wider);
            // The less likely a hypothesis, the fewer ways it gets to explain the grasp.
            let share = match self.slots[slot].weight {
                w if w > -2.0 => 1,
                w if w > -6.0 => 2,
                _ => 4,
            };
            let (search, work, prior) = (&mut self.search, &mut self.work, &self.slots[slot]);
            let (tries, width) = match sought {
                true => (places.poses().len().div_ceil(share), 1),
                false => (1, usize::from(self.settings.beam.max(1)).div_ceil(share)),
            };
            // One place that searches, for one copy of it in a board's flash (as all that is not inlined here).
            for place in 0..tries {
                let near = match places.poses().get(place) {
                    Some(pose) => Felt {
                        about: between::<S>(&prior.pose, pose).0,
                        wider: places.near,
                        ..felt
                    },
                    None => felt,
                };
                search.explain(work, prior, slot, &felt, &near, &odds, width);
            }
        }
        let density = self.density();
        let best = self.search.leaves().first()?;
        Some(Found { known: best.known.into(), wild: best.wild.into(), density })
    }

    /// Takes what was explained last for what happened.
    fn take(
        &mut self,
        found: Found,
        count: usize,
        free: &[FreePoint<S>],
        wider: [f32; 2],
    ) -> Outcome {
        self.select(count, free, wider);
        Outcome {
            corrected: found.known > 0,
            dropped: found.wild as u16,
            density: found.density,
            ..Outcome::NONE
        }
    }

    /// Variances of where a lost object is, beyond the motion's: it turned who knows how, and moved by half as
    /// much as the touches are from where its middle was expected, or by 100 mm.
    #[inline(never)]
    fn anywhere(&self, touches: &[Touch<S>]) -> [f32; 2] {
        let far = self.best().map_or(0.0, |best| {
            (best.pose.untransform(middle(touches)) - best.middle()).norm_squared()
        });
        [math::min(math::max(0.25 * far, 0.1 * 0.1), VAGUEST[0]), ANY_TURN]
    }

    /// Log density of what was just explained, over all hypotheses and explanations.
    fn density(&self) -> f32 {
        let all = |logs: &mut dyn Iterator<Item = f32>| logs.fold(f32::NEG_INFINITY, log_sum);
        let before =
            self.order[..self.count].iter().map(|slot| self.slots[usize::from(*slot)].weight);
        all(&mut self.search.leaves().iter().map(|leaf| leaf.node.score)) - all(&mut { before })
    }
}
