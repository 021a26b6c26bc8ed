//! The closed loop: choose a grasp, make it, take what was felt, until enough is known.

use std::time::Instant;

use nalgebra::{Point3, Translation3};

use super::approach;
use super::belief::{Belief, beside_each_other};
use super::coverage::{SAMPLES, Until};
use super::criterion::{About, Criterion, best, pose_deviation};
use super::placement::{Placement, drawn, fixed};
use super::prediction::foresee;
use crate::graph;
use crate::shape::align::align;
use crate::sim::hand::Unreachable;
use crate::sim::random::Random;
use crate::sim::{Bench, Hand};
use crate::slam::reconstruct;
use crate::slam::track::Step;
use crate::slam::trackers::Kind;
use crate::space::{Point, Pose};

/// Tries at a first grasp that feels anything.
const FIRST_TRIES: usize = 50;

/// Grasps that are not done again at once.
const REMEMBERED: usize = 2;

/// Deviation of the pose per degree of freedom ([`pose_deviation`]) above which a criterion about the
/// pose takes over from 4.20, metres: the thesis' "fixed variance threshold", whose number it does not
/// give.
const UNCERTAIN: f64 = 3e-3;

/// Among what a hand chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Candidates {
    /// The same ten every time, as in the thesis.
    Fixed,
    /// So many new ones at every choice, about the object as it is believed to be.
    Continuous(usize),
}

/// How to explore.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// What decides. A criterion about the pose decides while the pose is uncertain and leaves the
    /// rest to 4.20, as the thesis has it.
    pub criterion: Criterion,
    /// Among what.
    pub candidates: Candidates,
    /// Who follows the object; `None` where it is known to stay where it is.
    pub tracker: Option<Kind>,
    /// What corrects the poses after the tracker.
    pub graph: graph::Kind,
    /// When to stop.
    pub until: Until,
    /// When to stop all the same.
    pub most_actions: usize,
    /// Of the draws.
    pub seed: u64,
}

/// One action and what came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Action {
    /// What was chosen.
    pub placement: Placement,
    /// What the criterion promised; `None` for the first and for chance.
    pub gain: Option<f64>,
    /// How long choosing took, seconds: prediction and scores of all candidates.
    pub choosing: f64,
    /// Contacts felt.
    pub contacts: usize,
    /// Why the hand could not get there, where it could not; the object was not touched then.
    pub refused: Option<Unreachable>,
    /// Share of the surface that counts as known after it.
    pub known: f64,
}

/// A finished exploration. The log is the bench's.
#[derive(Clone, Debug)]
pub struct Episode {
    /// In their order.
    pub actions: Vec<Action>,
    /// Whether enough is known, and not merely the actions used up.
    pub reached: bool,
    /// Whether it ended because no feasible grasp was left.
    pub stuck: bool,
    /// The poses in the end.
    pub steps: Vec<Step>,
    /// Error of the last pose, metres at the object's centroid and radians: how far the believed
    /// object, laid on the true one as well as it goes, is from where the true one is.
    pub pose_error: (f64, f64),
}

/// Why there is no exploration.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The hand never met the object.
    #[error("the hand closed on nothing {FIRST_TRIES} times; is the object too small?")]
    Missed,
    /// Probing found nothing to explore.
    #[error("probing from every side: {0}; is the object out of the hand's reach?")]
    NotFound(#[from] Unreachable),
    /// What was felt makes no surface.
    #[error(transparent)]
    Surface(#[from] reconstruct::Error),
}

/// Explores the object on the bench, and tells `watch` of every action.
///
/// # Errors
/// When the hand meets nothing at first, or what it felt makes no surface.
pub fn explore(
    bench: &mut Bench,
    settings: &Settings,
    watch: impl FnMut(&Action),
) -> Result<Episode, Error> {
    let surface = bench.reachable(SAMPLES);
    let known = |belief: &Belief, frame: &Pose| settings.until.known_of(belief, &surface, frame);
    explore_until(bench, settings, known, watch)
}

/// The same with another measure of what is known: of a belief, and the pose that takes the true object
/// frame to the believed one, it tells the share that counts as known and how much of it is enough.
///
/// # Errors
/// As [`explore`].
pub fn explore_until(
    bench: &mut Bench,
    settings: &Settings,
    mut known: impl FnMut(&Belief, &Pose) -> (f64, f64),
    mut watch: impl FnMut(&Action),
) -> Result<Episode, Error> {
    let [mut random] = Random::streams(settings.seed ^ 0x5eed_ca5e);
    let mut actions: Vec<Action> = Vec::new();
    let (placement, contacts) = first(bench, settings, &mut random)?;
    let mut next =
        Action { placement, gain: None, choosing: 0.0, contacts, refused: None, known: 0.0 };
    let mut before: Option<Belief> = None;
    loop {
        let steps = follow(bench, settings);
        let mut belief = match (settings.tracker, before) {
            (None, Some(before)) => before.after(bench.log(), &steps)?,
            (None, None) => Belief::new(bench.log(), &steps)?,
            (Some(_), _) => Belief::new(bench.log(), &beside_each_other(bench.log(), &steps))?,
        };
        belief.hand = bench.hand().clone();
        let truth = true_frame(bench, settings, &belief, &steps);
        let (known, enough) = known(&belief, &truth);
        next.known = known;
        watch(&next);
        actions.push(next);
        let finish = |actions, steps: Vec<Step>, reached| {
            let pose_error = pose_error(bench, &steps, &truth);
            Episode { actions, reached, stuck: false, steps, pose_error }
        };
        if known >= enough || actions.len() >= settings.most_actions {
            return Ok(finish(actions, steps, known >= enough));
        }

        let start = Instant::now();
        let mut candidates = candidates(&belief, bench.table(), settings, &mut random);
        // What could not be reached cannot be reached now, as far as is known.
        let refused: Vec<&Action> = actions.iter().filter(|a| a.refused.is_some()).collect();
        candidates.retain(|c| !refused.iter().any(|a| same(settings, &a.placement, c)));
        if candidates.is_empty() {
            return Ok(Episode { stuck: true, ..finish(actions, steps, false) });
        }
        let Some((choice, gain)) = choose(&belief, settings, &candidates, &actions, &mut random)
        else {
            return Ok(finish(actions, steps, false));
        };
        if let (Until::Gain(least), Some(gain)) = (settings.until, gain)
            && gain < least
        {
            return Ok(finish(actions, steps, true));
        }
        let choosing = start.elapsed().as_secs_f64();
        let placement = candidates[choice];
        let off = (placement.hand.translation.vector - belief.centre).norm();
        let at = belief.pose * placement.hand;
        let felt = bench.grasp(&at, placement.spread, belief.radius + off);
        let (contacts, refused) = felt.map_or_else(|why| (0, Some(why)), |count| (count, None));
        next = Action { placement, gain, choosing, contacts, refused, known: 0.0 };
        before = Some(belief);
    }
}

/// The first action. An articulated hand delimits the object by probing (thesis figure 4.2), all guarded
/// moves together counted as one action. The idealised hand grasps: any candidate about the world's origin,
/// again until something is felt; closings that felt nothing stay in the log.
fn first(
    bench: &mut Bench,
    settings: &Settings,
    random: &mut Random,
) -> Result<(Placement, usize), Error> {
    let (dimension, radius) = (bench.log().dimension, bench.radius());
    if matches!(bench.hand(), Hand::Articulated(_)) {
        let probe = bench.probe()?;
        let contacts = probe.touches().count();
        let middle = Translation3::from((probe.low + probe.high) / 2.0);
        return Ok((Placement { hand: middle.into(), spread: 0.0 }, contacts));
    }
    for _ in 0..FIRST_TRIES {
        let placement = match settings.candidates {
            Candidates::Fixed => {
                let ten = fixed(dimension, &Point::zeros());
                ten[((random.unit() * ten.len() as f64) as usize).min(ten.len() - 1)]
            }
            Candidates::Continuous(_) => drawn(dimension, &Point::zeros(), radius, random),
        };
        let strokes = placement.strokes(dimension, 2.0 * radius);
        let contacts = bench.close(&placement.hand, &strokes);
        if contacts > 0 {
            // In the object frame, which a tracker puts at the middle of the contacts.
            let steps = follow(bench, settings);
            let hand = steps.last().map_or(placement.hand, |s| s.pose.inv_mul(&placement.hand));
            return Ok((Placement { hand, ..placement }, contacts));
        }
    }
    Err(Error::Missed)
}

/// The poses of all grasps as they are known now.
fn follow(bench: &Bench, settings: &Settings) -> Vec<Step> {
    let log = bench.log();
    let Some(tracker) = settings.tracker else {
        return vec![Step::certain(Pose::identity()); log.grasps.len()];
    };
    let steps = tracker.follow(log, settings.seed);
    settings.graph.correct(log, &steps).map_or(steps, |corrected| corrected.steps)
}

/// From the true object frame to the believed one: by the first grasp, which fixed it. Where the pose
/// is tracked, nobody can know how that grasp lay on the shape beyond what it felt, and the shapes are
/// aligned from there.
fn true_frame(bench: &Bench, settings: &Settings, belief: &Belief, steps: &[Step]) -> Pose {
    let first = bench.log().grasps.first().and_then(|g| g.truth).zip(steps.first());
    let frame = first.map_or_else(Pose::identity, |(truth, step)| step.pose.inv_mul(&truth));
    if settings.tracker.is_none() {
        return frame;
    }
    let aligned = align(&belief.geometry.transformed(&frame.inverse()), bench.geometry());
    frame * aligned.inverse()
}

fn pose_error(bench: &Bench, steps: &[Step], frame: &Pose) -> (f64, f64) {
    let last = bench.log().grasps.last().and_then(|g| g.truth).zip(steps.last());
    let Some((truth, step)) = last else { return (0.0, 0.0) };
    let estimate = step.pose * frame;
    let centre = Point3::from(bench.geometry().centroid());
    ((estimate * centre - truth * centre).norm(), estimate.rotation.angle_to(&truth.rotation))
}

fn candidates(
    belief: &Belief,
    table: Option<f64>,
    settings: &Settings,
    random: &mut Random,
) -> Vec<Placement> {
    if let Hand::Articulated(hand) = &belief.hand {
        return match settings.candidates {
            Candidates::Fixed => approach::fixed(hand, belief, table),
            Candidates::Continuous(count) => approach::drawn(hand, belief, table, count, random),
        };
    }
    match settings.candidates {
        // About the middle of what was felt, which moves as more is felt; the ways they face stay.
        Candidates::Fixed => fixed(belief.dimension, &belief.centre),
        Candidates::Continuous(count) => (0..count)
            .map(|_| drawn(belief.dimension, &belief.centre, belief.radius, random))
            .collect(),
    }
}

/// Which candidate, and what it promises.
fn choose(
    belief: &Belief,
    settings: &Settings,
    candidates: &[Placement],
    done: &[Action],
    random: &mut Random,
) -> Option<(usize, Option<f64>)> {
    if candidates.is_empty() {
        return None;
    }
    let draw = |open: &[usize], random: &mut Random| {
        open.get(((random.unit() * open.len() as f64) as usize).min(open.len().saturating_sub(1)))
            .map(|i| (*i, None))
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
        (_, About::Pose) if pose_deviation(belief) < UNCERTAIN => Criterion::VarianceSum,
        (criterion, _) => criterion,
    };
    let scores = criterion.worth(belief, &foresee(belief, candidates));
    let recent = &done[done.len().saturating_sub(REMEMBERED)..];
    let choice = best(&scores, |i| again(&i, recent)).or_else(|| best(&scores, |_| false))?;
    Some((choice, Some(scores[choice])))
}

/// Whether two grasps are the same one. Fixed ones follow the middle of the contacts, so they are told
/// by the way they face.
fn same(settings: &Settings, a: &Placement, b: &Placement) -> bool {
    let centred = |p: &Placement| match settings.candidates {
        Candidates::Fixed => {
            Placement { hand: Pose::from_parts(Translation3::identity(), p.hand.rotation), ..*p }
        }
        Candidates::Continuous(_) => *p,
    };
    centred(a).repeats(&centred(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::with_room;
    use crate::quantity::Deviation;
    use crate::sim::Options;

    fn bench(object: &str, motion: (f64, f64), seed: u64) -> Bench {
        let motion_noise = Deviation { length: motion.0, angle: motion.1 };
        Bench::new(Options { motion_noise, seed, ..Options::new(object.parse().unwrap()) }).unwrap()
    }

    const STILL: (f64, f64) = (0.0, 0.0);

    fn settings(criterion: Criterion, candidates: Candidates) -> Settings {
        Settings {
            criterion,
            candidates,
            tracker: None,
            graph: graph::Kind::None,
            until: Until::Lenient,
            most_actions: 12,
            seed: 2,
        }
    }

    #[test]
    fn a_rectangle_is_known_after_a_few_actions_and_the_same_ones_every_time() {
        let run = || {
            let mut bench = bench("rectangle:0.1x0.06", STILL, 1);
            let settings = settings(Criterion::Entropy, Candidates::Continuous(40));
            let mut watched = 0;
            let episode = explore(&mut bench, &settings, |_| watched += 1).unwrap();
            assert_eq!(watched, episode.actions.len());
            assert_eq!(bench.log().grasps.len(), episode.steps.len());
            episode
        };
        let episode = run();
        assert!(episode.reached && episode.actions.len() <= 6, "{}", episode.actions.len());
        assert!(episode.pose_error.0 < 1e-9 && episode.pose_error.1 < 1e-9);
        let placements = |e: &Episode| e.actions.iter().map(|a| a.placement).collect::<Vec<_>>();
        assert_eq!(placements(&episode), placements(&run()));
        assert!(episode.actions.iter().skip(1).all(|a| a.gain.is_some_and(|g| g > 0.0)));
    }

    #[test]
    fn a_moving_object_is_followed_while_it_is_explored() {
        let mut bench = bench("hexagon:0.04", (5e-3, 10f64.to_radians()), 4);
        let settings = Settings {
            tracker: Some(Kind::Hypotheses),
            ..settings(Criterion::Information, Candidates::Continuous(40))
        };
        let episode = with_room(|| explore(&mut bench, &settings, |_| ())).unwrap();
        assert!(episode.reached, "{:?}", episode.actions.last());
        assert!(
            episode.pose_error.0 < 4e-3 && episode.pose_error.1 < 0.08,
            "{:?}",
            episode.pose_error
        );
    }

    #[test]
    fn a_box_is_explored_in_space() {
        let mut bench = bench("box:0.1x0.06x0.06", STILL, 1);
        let settings = Settings {
            most_actions: 2,
            until: Until::Coverage(0.05),
            ..settings(Criterion::VarianceSum, Candidates::Fixed)
        };
        let episode = explore(&mut bench, &settings, |_| ()).unwrap();
        assert!(episode.actions.iter().all(|a| a.contacts <= 5 && a.known <= 1.0));
        assert!(episode.actions.iter().any(|a| a.contacts > 0));
    }

    #[test]
    fn without_the_truth_it_ends_when_nothing_is_promised_any_more() {
        let mut bench = bench("ellipse:0.1x0.06", STILL, 1);
        let settings = Settings {
            until: Until::Gain(1e6),
            ..settings(Criterion::Entropy, Candidates::Continuous(10))
        };
        let episode = explore(&mut bench, &settings, |_| ()).unwrap();
        assert!(episode.reached && episode.actions.len() == 1);
    }

    #[test]
    fn no_repeat_takes_each_of_the_ten_once() {
        let mut bench = bench("ellipse:0.1x0.06", STILL, 3);
        let settings = Settings {
            until: Until::Coverage(1.0),
            most_actions: 10,
            ..settings(Criterion::NoRepeat, Candidates::Fixed)
        };
        let episode = explore(&mut bench, &settings, |_| ()).unwrap();
        assert_eq!(episode.actions.len(), 10);
        for (i, a) in episode.actions.iter().enumerate() {
            assert!(!episode.actions[..i].iter().any(|b| same(
                &settings,
                &a.placement,
                &b.placement
            )));
        }
    }

    #[test]
    fn an_object_too_small_to_meet_is_named() {
        let mut bench = bench("rectangle:0.0005x0.0005", STILL, 1);
        let settings = settings(Criterion::Entropy, Candidates::Continuous(10));
        // The thumb and a middle finger meet even small things now and then.
        match explore(&mut bench, &settings, |_| ()) {
            Err(error) => assert!(!error.to_string().is_empty()),
            Ok(episode) => assert!(!episode.actions.is_empty()),
        }
    }
}
