//! Several grasps at once: greedily, each the best one given those before it.

use super::criterion::best;
use super::foresight::Foresight;

/// Up to `count` different grasps and what each adds, in the order to make them. `worth` says what a
/// gain is worth, from the grasp before (none for the first) and the grasp itself; those `left_out` are
/// not taken. Fewer where there are no more.
///
/// Where gains are submodular and not weighed by cost, what the batch brings is at least 1 − 1/e (63 %)
/// of the best batch of that size (Nemhauser, Wolsey & Fisher 1978); see [`Foresight`] for which
/// criteria are.
pub fn greedy(
    mut foresight: Foresight<'_>,
    count: usize,
    worth: impl Fn(Option<usize>, usize, f64) -> f64,
    left_out: impl Fn(usize) -> bool,
) -> Vec<(usize, f64)> {
    let mut chosen: Vec<(usize, f64)> = Vec::new();
    while chosen.len() < count {
        let last = chosen.last().map(|c| c.0);
        if let Some(last) = last {
            foresight.take(last);
        }
        let scores = foresight.scores();
        let ranks: Vec<f64> = (0..scores.len()).map(|i| worth(last, i, scores[i])).collect();
        let Some(next) = best(&ranks, |i| left_out(i) || chosen.iter().any(|c| c.0 == i)) else {
            break;
        };
        chosen.push((next, scores[next]));
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::criterion::Criterion;
    use crate::explore::foresight::tests::belief;
    use crate::explore::placement::fixed;
    use crate::explore::prediction::{Expected, predict};

    #[test]
    fn a_batch_brings_most_of_what_the_best_one_would() {
        let belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        let together = |set: &[usize]| {
            let felt: Vec<Expected> = set.iter().flat_map(|g| grasps[*g].clone()).collect();
            Criterion::Entropy.scores(&belief, &[felt])[0]
        };
        let foresight = Foresight::new(Criterion::Entropy, 2.0, &belief, &grasps);
        let batch = greedy(foresight, 3, |_, _, g| g, |_| false);
        let set: Vec<usize> = batch.iter().map(|c| c.0).collect();
        let brought: f64 = batch.iter().map(|c| c.1).sum();
        assert!((brought - together(&set)).abs() < 1e-6, "gains add up");
        assert!(batch[0].1 >= batch[1].1 && batch[1].1 >= batch[2].1);
        let mut most = 0.0f64;
        for a in 0..10 {
            for b in 0..a {
                for c in 0..b {
                    most = most.max(together(&[a, b, c]));
                }
            }
        }
        let bound = 1.0 - (-1f64).exp();
        assert!(brought >= bound * most && brought <= most + 1e-6, "{brought} {most}");
    }

    #[test]
    fn it_takes_each_once_and_none_left_out() {
        let belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        let one = Foresight::new(Criterion::Information, 2.0, &belief, &grasps);
        let batch = greedy(one, 100, |_, _, g| g, |i| i < 4);
        let mut taken: Vec<usize> = batch.iter().map(|c| c.0).collect();
        taken.sort_unstable();
        assert_eq!(taken, (4..10).collect::<Vec<_>>());
        let nothing = Foresight::new(Criterion::Entropy, 2.0, &belief, &[]);
        assert!(greedy(nothing, 3, |_, _, g| g, |_| false).is_empty());
    }

    #[test]
    fn what_a_gain_is_worth_decides() {
        let belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        let foresight = Foresight::new(Criterion::Entropy, 2.0, &belief, &grasps);
        // Only the next neighbour is near.
        let near = |from: Option<usize>, to: usize, gain: f64| match from {
            Some(from) if to != (from + 1) % 10 => 1e-3 * gain,
            _ => gain,
        };
        let batch = greedy(foresight, 3, near, |_| false);
        assert_eq!(batch[1].0, (batch[0].0 + 1) % 10);
        assert_eq!(batch[2].0, (batch[1].0 + 1) % 10);
    }
}
