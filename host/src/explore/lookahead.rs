//! Looking one grasp further: a first step is as good as it and the best second step after it.

use super::criterion::best;
use super::foresight::Foresight;

/// First steps that are followed up: the best ones for themselves.
pub const FIRST_STEPS: usize = 8;

/// The grasp to make first and what it brings for itself. `worth` says what the gains of one or two
/// steps are worth, from the steps and the sum of their gains; those `left_out` are no first steps. With
/// nothing left, `None`.
///
/// The best [`FIRST_STEPS`] for themselves are followed up. The contacts to be expected of each are
/// conditioned on, and its best second step, which may be any other grasp, is added.
pub fn first_of_two(
    foresight: &Foresight<'_>,
    worth: impl Fn(&[usize], f64) -> f64,
    left_out: impl Fn(usize) -> bool,
) -> Option<(usize, f64)> {
    let scores = foresight.scores();
    let ranks: Vec<f64> = (0..scores.len()).map(|i| worth(&[i], scores[i])).collect();
    let mut firsts: Vec<usize> =
        (0..scores.len()).filter(|i| !left_out(*i) && !ranks[*i].is_nan()).collect();
    firsts.sort_by(|a, b| ranks[*b].total_cmp(&ranks[*a]).then(a.cmp(b)));
    firsts.truncate(FIRST_STEPS);
    let pairs: Vec<f64> = firsts
        .iter()
        .map(|&first| {
            let mut after = foresight.clone();
            after.take(first);
            let gains = after.scores();
            let seconds = (0..gains.len()).filter(|second| *second != first);
            let pairs = seconds.map(|s| worth(&[first, s], scores[first] + gains[s]));
            // A single candidate has no second step.
            pairs.reduce(f64::max).unwrap_or(ranks[first])
        })
        .collect();
    let first = firsts[best(&pairs, |_| false)?];
    Some((first, scores[first]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::criterion::Criterion;
    use crate::explore::foresight::tests::belief;
    use crate::explore::placement::fixed;
    use crate::explore::prediction::{Expected, predict};

    #[test]
    fn the_first_of_the_best_pair_is_taken() {
        let belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        let together = |set: &[usize]| {
            let felt: Vec<Expected> = set.iter().flat_map(|g| grasps[*g].clone()).collect();
            Criterion::Entropy.scores(&belief, &[felt])[0]
        };
        let foresight = Foresight::new(Criterion::Entropy, 2.0, &belief, &grasps);
        let (first, gain) = first_of_two(&foresight, |_, g| g, |_| false).unwrap();
        assert!((gain - together(&[first])).abs() < 1e-6);
        let with =
            |a: usize| (0..10).filter(|b| *b != a).map(|b| together(&[a, b])).fold(0.0, f64::max);
        let most = (0..10).map(with).fold(0.0, f64::max);
        assert!((with(first) - most).abs() < 1e-6, "{first}");
    }

    #[test]
    fn one_candidate_is_taken_and_none_is_none() {
        let belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre)[..1]);
        let foresight = Foresight::new(Criterion::Information, 2.0, &belief, &grasps);
        assert_eq!(first_of_two(&foresight, |_, g| g, |_| false).unwrap().0, 0);
        assert_eq!(first_of_two(&foresight, |_, g| g, |_| true), None);
        let foresight = Foresight::new(Criterion::Information, 2.0, &belief, &[]);
        assert_eq!(first_of_two(&foresight, |_, g| g, |_| false), None);
    }
}
