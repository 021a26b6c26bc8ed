//! The closed loop: choose a grasp, make it, take what was felt, until enough is known.

use std::collections::VecDeque;
use std::time::Instant;

use nalgebra::{Point3, Translation3};

use super::areas::{self, NextArea};
use super::belief::{Belief, beside_each_other};
use super::coverage::Until;
use super::criterion::{About, Criterion, pose_deviation};
use super::placement::{Placement, drawn, fixed};
use super::planning::Planning;
use crate::graph;
use crate::shape::align::align;
use crate::sim::Bench;
use crate::sim::random::Random;
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
    /// Those that face the next contact area (thesis 4.5.1).
    Clusters(NextArea),
}

/// How to explore.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// What decides. A criterion about the pose decides while the pose is uncertain and leaves the
    /// rest to 4.20, as the thesis has it.
    pub criterion: Criterion,
    /// Among what.
    pub candidates: Candidates,
    /// How far ahead it decides.
    pub planning: Planning,
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
    /// How long choosing took, seconds: prediction and scores of all candidates; 0 where it was chosen
    /// together with the action before.
    pub choosing: f64,
    /// Contacts felt.
    pub contacts: usize,
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
    mut watch: impl FnMut(&Action),
) -> Result<Episode, Error> {
    let [mut random] = Random::streams(settings.seed ^ 0x5eed_ca5e);
    let dimension = bench.log().dimension;
    let mut actions: Vec<Action> = Vec::new();
    let mut planned: VecDeque<(Placement, Option<f64>)> = VecDeque::new();
    let (placement, contacts) = first(bench, settings, &mut random)?;
    let mut next = Action { placement, gain: None, choosing: 0.0, contacts, known: 0.0 };
    loop {
        let steps = follow(bench, settings);
        let belief = match settings.tracker {
            None => Belief::new(bench.log(), &steps)?,
            Some(_) => Belief::new(bench.log(), &beside_each_other(bench.log(), &steps))?,
        };
        let truth = true_frame(bench, settings, &belief, &steps);
        let (known, enough) = settings.until.known(&belief, bench.geometry(), &truth);
        next.known = known;
        watch(&next);
        actions.push(next);
        let finish = |actions, steps: Vec<Step>, reached| {
            let pose_error = pose_error(bench, &steps, &truth);
            Episode { actions, reached, steps, pose_error }
        };
        if known >= enough || actions.len() >= settings.most_actions {
            return Ok(finish(actions, steps, known >= enough));
        }

        let start = Instant::now();
        let decides = planned.is_empty();
        if decides {
            let candidates = candidates(&belief, settings, &actions, &mut random);
            let chosen = choose(&belief, settings, &candidates, &actions, &mut random);
            planned.extend(chosen.into_iter().map(|(i, gain)| (candidates[i], gain)));
        }
        let choosing = if decides { start.elapsed().as_secs_f64() } else { 0.0 };
        let Some((placement, gain)) = planned.pop_front() else {
            return Ok(finish(actions, steps, false));
        };
        if let (Until::Gain(least), Some(gain)) = (settings.until, gain)
            && gain < least
        {
            return Ok(finish(actions, steps, true));
        }
        let off = (placement.hand.translation.vector - belief.centre).norm();
        let strokes = placement.strokes(dimension, belief.radius + off);
        let contacts = bench.close(&(belief.pose * placement.hand), &strokes);
        next = Action { placement, gain, choosing, contacts, known: 0.0 };
    }
}

/// The first grasp, of which nothing is known but where the object roughly is: any candidate about the
/// world's origin, again until something is felt. Closings that felt nothing stay in the log.
fn first(
    bench: &mut Bench,
    settings: &Settings,
    random: &mut Random,
) -> Result<(Placement, usize), Error> {
    let (dimension, radius) = (bench.log().dimension, bench.radius());
    for _ in 0..FIRST_TRIES {
        let placement = match settings.candidates {
            Candidates::Fixed => {
                let ten = fixed(dimension, &Point::zeros());
                ten[((random.unit() * ten.len() as f64) as usize).min(ten.len() - 1)]
            }
            Candidates::Continuous(_) | Candidates::Clusters(_) => {
                drawn(dimension, &Point::zeros(), radius, random)
            }
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
    settings: &Settings,
    done: &[Action],
    random: &mut Random,
) -> Vec<Placement> {
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
fn choose(
    belief: &Belief,
    settings: &Settings,
    candidates: &[Placement],
    done: &[Action],
    random: &mut Random,
) -> Vec<(usize, Option<f64>)> {
    if candidates.is_empty() {
        return Vec::new();
    }
    let draw = |open: &[usize], random: &mut Random| {
        let any = ((random.unit() * open.len() as f64) as usize).min(open.len().saturating_sub(1));
        open.get(any).map(|i| (*i, None)).into_iter().collect()
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
    let recent = &done[done.len().saturating_sub(REMEMBERED)..];
    let last = done.last().map(|a| &a.placement);
    let plan = |left_out: &dyn Fn(usize) -> bool| {
        settings.planning.choose(criterion, belief, candidates, last, left_out)
    };
    let mut chosen = plan(&|i| again(&i, recent));
    if chosen.is_empty() {
        chosen = plan(&|_| false);
    }
    chosen.into_iter().map(|(i, gain)| (i, Some(gain))).collect()
}

/// Whether two grasps are the same one. Fixed ones follow the middle of the contacts, so they are told
/// by the way they face.
fn same(settings: &Settings, a: &Placement, b: &Placement) -> bool {
    let centred = |p: &Placement| match settings.candidates {
        Candidates::Fixed => {
            Placement { hand: Pose::from_parts(Translation3::identity(), p.hand.rotation), ..*p }
        }
        Candidates::Continuous(_) | Candidates::Clusters(_) => *p,
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
            planning: Planning::default(),
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
    fn contact_areas_lead_round_the_object_and_batches_decide_less_often() {
        for next in [NextArea::Near, NextArea::Gain] {
            let mut bench = bench("rectangle:0.1x0.06", STILL, 1);
            let settings = settings(Criterion::Entropy, Candidates::Clusters(next));
            let episode = explore(&mut bench, &settings, |_| ()).unwrap();
            assert!(episode.reached, "{next:?}: {:?}", episode.actions.last());
        }
        let mut bench = bench("rectangle:0.1x0.06", STILL, 1);
        let settings = Settings {
            planning: Planning { batch: 3, lookahead: true, ..Planning::default() },
            until: Until::Coverage(1.0),
            most_actions: 8,
            ..settings(Criterion::Entropy, Candidates::Continuous(40))
        };
        let episode = explore(&mut bench, &settings, |_| ()).unwrap();
        let decided = episode.actions.iter().map(|a| a.choosing > 0.0).collect::<Vec<_>>();
        assert_eq!(decided, [false, true, false, false, true, false, false, true]);
        assert!(episode.actions.iter().skip(1).all(|a| a.gain.is_some_and(|g| g >= 0.0)));
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
