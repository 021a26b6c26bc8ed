//! Which grasp next: the candidates, what each is worth, and which of them is made.

use nalgebra::Translation3;

use super::adviser::{Adviser, Closing};
use super::approach;
use super::areas;
use super::belief::Belief;
use super::coverage::{Until, believed_share};
use super::criterion::{About, Criterion, pose_deviation};
use super::episode::{Action, Candidates, Settings};
use super::localization;
use super::placement::{Placement, drawn, fixed};
use super::planning::Offer;
use super::prediction::{Prediction, foresee};
use crate::link::SessionError;
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::sim::Hand;
use crate::sim::random::Random;
use crate::slam::track::Step;
use crate::space::Pose;

/// Grasps that are not done again at once.
const REMEMBERED: usize = 2;

/// Deviation of the pose per degree of freedom ([`pose_deviation`]) above which a criterion about the
/// pose takes over from 4.20, metres: the thesis' "fixed variance threshold", whose number it does not
/// give.
const UNCERTAIN: f64 = 3e-3;

/// What a pose within its tolerance is worth where all of the shape is known, nats, and the power of the
/// known share by which it is worth less before. Neither matters much: 1, 4 or 16 nats, and a power of 1
/// or 4, took a slipping rectangle 5.5 to 5.8 grasps until shape (strict) and pose were known, and 4.8 to
/// 5.8 with the lenient shape, all within each other's 95 % intervals (24 runs each, seeds 1000 on).
const LOCALISED: f64 = 4.0;
const PATIENCE: i32 = 4;

/// What was decided.
#[derive(Clone, Debug, Default)]
pub(super) struct Choice {
    /// The candidates to make, in this order, and what each promises; empty where there is none.
    pub grasps: Vec<(usize, Option<f64>)>,
    /// What every candidate promises for itself; empty where chance decides.
    pub gains: Vec<f64>,
    /// What of that is about the shape, where the pose's part is no gain that could end.
    pub of_shape: Option<Vec<f64>>,
}

impl Choice {
    /// The most that any candidate promises, nats: by the `criterion` here, or where somebody else chose,
    /// by what they say of their choice. `None` where nothing is promised in nats.
    pub(super) fn promised(&self, criterion: Criterion, is_advised: bool) -> Option<f64> {
        if !criterion.is_in_nats() {
            None
        } else if is_advised {
            self.grasps.first()?.1
        } else {
            self.of_shape.as_ref().unwrap_or(&self.gains).iter().copied().reduce(f64::max)
        }
    }
}

/// The grasps among which to choose, object frame. What could not be reached before cannot be reached
/// now, as far as is known.
pub(super) fn candidates(
    belief: &Belief,
    settings: &Settings,
    done: &[Action],
    random: &mut Random,
) -> Vec<Placement> {
    let mut all = offered(belief, settings, done, random);
    let refused: Vec<&Action> = done.iter().filter(|a| a.refused.is_some()).collect();
    all.retain(|c| !refused.iter().any(|a| same(settings, &a.placement, c)));
    all
}

fn offered(
    belief: &Belief,
    settings: &Settings,
    done: &[Action],
    random: &mut Random,
) -> Vec<Placement> {
    if let Hand::Articulated(hand) = &belief.hand {
        return match settings.candidates {
            Candidates::Fixed | Candidates::Clusters(_) => approach::fixed(hand, belief),
            Candidates::Continuous(count) => approach::drawn(hand, belief, count, random),
        };
    }
    match settings.candidates {
        // About the middle of what was felt, which moves as more is felt; the ways they face stay.
        Candidates::Fixed => fixed(belief.dimension, &belief.centre),
        Candidates::Continuous(count) => (0..count)
            .map(|_| drawn(belief.dimension, &belief.centre, belief.radius, random))
            .collect(),
        Candidates::Clusters(next) => {
            let missed = done.iter().filter(|a| a.contacts == 0).map(|a| a.placement);
            let missed: Vec<Placement> = missed.collect();
            let done: Vec<Placement> = done.iter().map(|a| a.placement).collect();
            areas::candidates(belief, next, &done, &missed)
        }
    }
}

/// Which candidates, and what each promises.
pub(super) fn choose(
    belief: &Belief,
    steps: &[Step],
    settings: &Settings,
    candidates: &[Placement],
    done: &[Action],
    random: &mut Random,
) -> Choice {
    if candidates.is_empty() {
        return Choice::default();
    }
    let draw = |open: &[usize], random: &mut Random| {
        let any = ((random.unit() * open.len() as f64) as usize).min(open.len().saturating_sub(1));
        let grasps = open.get(any).map(|i| (*i, None)).into_iter().collect();
        Choice { grasps, ..Choice::default() }
    };
    let any: Vec<usize> = (0..candidates.len()).collect();
    let again = |i: &usize, actions: &[Action]| {
        actions.iter().any(|a| same(settings, &a.placement, &candidates[*i]))
    };
    let criterion = match (settings.criterion, settings.criterion.about()) {
        (Criterion::NoRepeat, _) => {
            let open: Vec<usize> = any.iter().copied().filter(|i| !again(i, done)).collect();
            return draw(if open.is_empty() { &any } else { &open }, random);
        }
        (_, About::Chance) => return draw(&any, random),
        (_, About::Pose) if tracked_deviation(belief, steps) < UNCERTAIN => match settings.until {
            // What is to be compared with nats has to be in nats.
            Until::Gain(_) => Criterion::Information,
            _ => Criterion::VarianceSum,
        },
        (criterion, _) => criterion,
    };
    let prediction = foresee(belief, candidates);
    let is_planned = settings.planning.batch > 1 || settings.planning.lookahead;
    let (gains, of_shape) = match (criterion, settings.pose, settings.tracker) {
        (Criterion::Both, Some(tolerance), Some(_)) if !is_planned => {
            let (gains, of_shape) =
                both(belief, settings.until, candidates, &prediction, &tolerance);
            (gains, Some(of_shape))
        }
        _ => (criterion.worth_of_order(settings.planning.alpha, belief, &prediction), None),
    };
    let recent = &done[done.len().saturating_sub(REMEMBERED)..];
    let last = done.last().map(|a| &a.placement);
    let offer = Offer { belief, placements: candidates, prediction: &prediction, scores: &gains };
    let plan = |left_out: &dyn Fn(usize) -> bool| {
        settings.planning.choose_from(criterion, &offer, last, left_out)
    };
    let mut chosen = plan(&|i| again(&i, recent));
    if chosen.is_empty() {
        chosen = plan(&|_| false);
    }
    let grasps = chosen.into_iter().map(|(i, gain)| (i, Some(gain))).collect();
    Choice { grasps, gains, of_shape }
}

/// Information about the shape, and the chance that the grasp leaves the pose within its tolerance: worth
/// the more the more of the shape the belief takes for known, since the next slip undoes it. Beside the sum the
/// first alone.
fn both(
    belief: &Belief,
    until: Until,
    candidates: &[Placement],
    prediction: &Prediction,
    tolerance: &Deviation,
) -> (Vec<f64>, Vec<f64>) {
    let worth = LOCALISED * believed_share(belief, until.deviation()).powi(PATIENCE);
    let about_shape = Criterion::Information.worth(belief, prediction);
    let chances = localization::expected(belief, candidates, tolerance);
    let gains = about_shape.iter().zip(chances).map(|(shape, chance)| shape + worth * chance);
    (gains.collect(), about_shape)
}

/// The pose's deviation by the tracker's own account, which the thesis' switch asks.
fn tracked_deviation(belief: &Belief, steps: &[Step]) -> f64 {
    steps.last().map_or(0.0, |last| pose_deviation(belief, &last.covariance))
}

/// What somebody else would make of the candidates that were not among the last actions.
pub(super) fn advised(
    adviser: &mut dyn Adviser,
    belief: &Belief,
    log: &GraspLog,
    settings: &Settings,
    candidates: &[Placement],
    done: &[Action],
) -> Result<Vec<(usize, Option<f64>)>, SessionError> {
    let open = open(settings, candidates, done);
    let closings: Vec<Closing> = open.iter().map(|i| closing(belief, &candidates[*i])).collect();
    let (choice, gain) = adviser.choose(log, &closings)?;
    Ok(open.get(choice).map(|i| (*i, Some(gain))).into_iter().collect())
}

/// A candidate as it would be made.
fn closing(belief: &Belief, placement: &Placement) -> Closing {
    let off = (placement.hand.translation.vector - belief.centre).norm();
    Closing {
        hand: belief.pose * placement.hand,
        strokes: placement.strokes(belief.dimension, belief.radius + off),
    }
}

/// The candidates that were not among the last actions, or all where there are no others.
fn open(settings: &Settings, candidates: &[Placement], done: &[Action]) -> Vec<usize> {
    let recent = &done[done.len().saturating_sub(REMEMBERED)..];
    let again = |i: &usize| recent.iter().any(|a| same(settings, &a.placement, &candidates[*i]));
    let open: Vec<usize> = (0..candidates.len()).filter(|i| !again(i)).collect();
    if open.is_empty() { (0..candidates.len()).collect() } else { open }
}

/// Whether two grasps are the same one. Fixed ones follow the middle of the contacts, so they are told
/// by the way they face.
pub(super) fn same(settings: &Settings, a: &Placement, b: &Placement) -> bool {
    let centred = |p: &Placement| match settings.candidates {
        Candidates::Fixed => {
            Placement { hand: Pose::from_parts(Translation3::identity(), p.hand.rotation), ..*p }
        }
        Candidates::Continuous(_) | Candidates::Clusters(_) => *p,
    };
    centred(a).repeats(&centred(b))
}
