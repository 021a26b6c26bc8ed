//! From what candidates are worth to what is done next: the best one, the first of the best two, or
//! several at once, by their gain or by their gain for its time.

use super::batch::greedy;
use super::belief::Belief;
use super::cost::Cost;
use super::criterion::{ALPHA, Criterion, best};
use super::foresight::Foresight;
use super::lookahead::first_of_two;
use super::placement::Placement;
use super::prediction::{Prediction, foresee};

/// Candidates that planning goes on with, the best ones for themselves: its memory grows with the
/// square of their number.
const KEPT: usize = 64;

/// How far to plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planning {
    /// Grasps to make before the next decision; 0 counts as 1.
    pub batch: usize,
    /// Whether the first of them is chosen for what can follow it, too.
    pub lookahead: bool,
    /// Where time counts, what takes how long: gain per second decides then.
    pub cost: Option<Cost>,
    /// Order of the Rényi entropy (4.4), above 0; 1 is Shannon's.
    pub alpha: f64,
}

impl Default for Planning {
    fn default() -> Self {
        Planning::SINGLE
    }
}

/// Candidates to plan with.
#[derive(Clone, Copy, Debug)]
pub struct Offer<'a> {
    /// By which they are judged.
    pub belief: &'a Belief,
    /// The candidates.
    pub placements: &'a [Placement],
    /// What they would feel.
    pub prediction: &'a Prediction,
    /// What each is worth for itself.
    pub scores: &'a [f64],
}

impl Planning {
    /// The best grasp for itself, one at a time.
    pub const SINGLE: Planning = Planning { batch: 1, lookahead: false, cost: None, alpha: ALPHA };

    /// Which placements to make, in this order, and the gain of each; `last` is where the hand is, and
    /// those `left_out` are not made. Empty where nothing is left.
    pub fn choose(
        &self,
        criterion: Criterion,
        belief: &Belief,
        placements: &[Placement],
        last: Option<&Placement>,
        left_out: impl Fn(usize) -> bool,
    ) -> Vec<(usize, f64)> {
        let prediction = &foresee(belief, placements);
        let scores = &criterion.worth_of_order(self.alpha, belief, prediction)[..];
        self.choose_from(
            criterion,
            &Offer { belief, placements, prediction, scores },
            last,
            left_out,
        )
    }

    /// The same of what is predicted and scored already.
    pub fn choose_from(
        &self,
        criterion: Criterion,
        offer: &Offer<'_>,
        last: Option<&Placement>,
        left_out: impl Fn(usize) -> bool,
    ) -> Vec<(usize, f64)> {
        let Offer { belief, placements, prediction, scores } = *offer;
        let felt = &prediction.contacts;
        let seconds = |from: Option<usize>, to: usize| {
            let from = from.map(|i| &placements[i]).or(last);
            self.cost.map_or(1.0, |c| c.expected(from, &placements[to], &felt[to]))
        };
        let rates: Vec<f64> = (0..scores.len()).map(|i| scores[i] / seconds(None, i)).collect();
        if self.batch <= 1 && !self.lookahead {
            return best(&rates, left_out).map(|i| (i, scores[i])).into_iter().collect();
        }

        let mut kept: Vec<usize> =
            (0..rates.len()).filter(|i| !left_out(*i) && !rates[*i].is_nan()).collect();
        kept.sort_by(|a, b| rates[*b].total_cmp(&rates[*a]).then(a.cmp(b)));
        kept.truncate(KEPT);
        let felt: Vec<_> = kept.iter().map(|i| felt[*i].clone()).collect();
        let mut foresight = Foresight::new(criterion, self.alpha, belief, &felt);
        let both = |steps: &[usize], gain: f64| {
            let mut from = None;
            let total: f64 = steps.iter().map(|s| seconds(from.replace(kept[*s]), kept[*s])).sum();
            gain / total
        };
        let mut chosen: Vec<(usize, f64)> = Vec::new();
        if self.lookahead {
            let Some(first) = first_of_two(&foresight, both, |_| false) else { return chosen };
            foresight.take(first.0);
            chosen.push(first);
        }
        let first = chosen.first().map(|c| c.0);
        let worth = |from: Option<usize>, to: usize, gain: f64| {
            gain / seconds(from.or(first).map(|i| kept[i]), kept[to])
        };
        let rest = self.batch.max(1) - chosen.len();
        chosen.extend(greedy(foresight, rest, worth, |i| Some(i) == first));
        chosen.into_iter().map(|(i, gain)| (kept[i], gain)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::foresight::tests::belief;
    use crate::explore::placement::{drawn, fixed};
    use crate::sim::random::Random;

    #[test]
    fn plans_of_every_kind_name_different_candidates_that_are_open() {
        let belief = belief();
        let [mut random] = Random::streams(1);
        let many: Vec<Placement> =
            (0..90).map(|_| drawn(2, &belief.centre, belief.radius, &mut random)).collect();
        let last = many[0];
        for lookahead in [false, true] {
            for batch in [0, 1, 3] {
                for cost in [None, Some(Cost::default())] {
                    let planning = Planning { batch, lookahead, cost, ..Planning::default() };
                    let choose = |criterion, left_out: fn(usize) -> bool| {
                        planning.choose(criterion, &belief, &many, Some(&last), left_out)
                    };
                    let chosen = choose(Criterion::Information, |i| i % 2 == 0);
                    assert_eq!(chosen.len(), batch.max(1), "{planning:?}");
                    let mut seen: Vec<usize> = chosen.iter().map(|c| c.0).collect();
                    assert!(seen.iter().all(|i| i % 2 == 1), "{planning:?} {seen:?}");
                    seen.sort_unstable();
                    seen.dedup();
                    assert_eq!(seen.len(), chosen.len());
                    assert_eq!(chosen, choose(Criterion::Information, |i| i % 2 == 0));
                    assert!(choose(Criterion::Kl, |_| true).is_empty());
                }
            }
        }
        let nothing = Planning { batch: 2, ..Planning::default() };
        assert!(nothing.choose(Criterion::Entropy, &belief, &[], None, |_| false).is_empty());
    }

    #[test]
    fn where_time_counts_the_hand_stays_nearer() {
        let belief = belief();
        let ten = fixed(2, &belief.centre);
        let costly = Cost { action: 0.01, travel: 0.0, turn: 100.0, miss: 0.0 };
        let planning = Planning { cost: Some(costly), ..Planning::default() };
        // Already there: nothing is as cheap as staying, next comes a neighbour.
        let first = planning.choose(Criterion::Entropy, &belief, &ten, Some(&ten[4]), |_| false);
        assert_eq!(first[0].0, 4);
        let next = planning.choose(Criterion::Entropy, &belief, &ten, Some(&ten[4]), |i| i == 4);
        assert!(matches!(next[0].0, 3 | 5), "{next:?}");
    }
}
