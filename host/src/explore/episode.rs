//! The closed loop: choose a grasp, make it, take what was felt, until enough is known.

use std::time::Instant;

use nalgebra::{Point3, Translation3};
use tactile_core::track::Status;

use super::belief::{Belief, beside_each_other};
use super::coverage::{Until, believed_share, honesty};
use super::criterion::{About, Criterion, best, pose_deviation};
use super::localization;
use super::placement::{Placement, drawn, fixed};
use super::prediction::predict;
use crate::graph;
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::sim::Bench;
use crate::sim::random::Random;
use crate::slam::gauge::gauge;
use crate::slam::reconstruct;
use crate::slam::track::{Follower, Step};
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

/// How probable it must be that the last pose is within its tolerance.
pub const SURE: f64 = 0.95;

/// What a pose within its tolerance is worth where all of the shape is known, nats, and the power of the
/// known share by which it is worth less before.
const LOCALISED: f64 = 4.0;
const PATIENCE: i32 = 4;

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
    /// When enough of the shape is known.
    pub until: Until,
    /// How well the last pose must be known besides, with [`SURE`] probability by the explorer's own
    /// account, where a tracker follows the object; `None` asks for the shape alone.
    pub pose: Option<Deviation>,
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
    /// Share of the surface that counts as known after it.
    pub known: f64,
    /// Probability that the pose is within its tolerance after it, by the explorer's own account; `None`
    /// where none is asked for.
    pub localised: Option<f64>,
    /// How long it took to make tracker and surface of what was felt, seconds.
    pub learning: f64,
}

/// A finished exploration. The log is the bench's.
#[derive(Clone, Debug)]
pub struct Episode {
    /// In their order.
    pub actions: Vec<Action>,
    /// Why there were no more.
    pub end: End,
    /// The poses in the end.
    pub steps: Vec<Step>,
    /// Error of the last pose, metres at the object's centroid and radians, in the frame in which all
    /// contacts lie best on the true surface.
    pub pose_error: (f64, f64),
    /// How far that frame is from the one that the first grasp alone would give, likewise.
    pub drift: (f64, f64),
    /// Share of what the belief calls known whose error is within two of its standard deviations
    /// ([`honesty`]).
    pub honesty: Option<f64>,
    /// Actions that were nearly one before them.
    pub repeats: usize,
    /// Grasps that the tracker could not explain.
    pub lost: usize,
}

/// Why an exploration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Enough is known.
    Known,
    /// No grasp promises enough, which was asked for.
    NothingToGain,
    /// The actions are used up.
    OutOfActions,
    /// There is no grasp to choose.
    NoCandidate,
}

impl Episode {
    /// Whether what was asked for is known.
    pub fn reached(&self) -> bool {
        matches!(self.end, End::Known | End::NothingToGain)
    }
}

impl Action {
    fn new(placement: Placement, contacts: usize) -> Action {
        Action {
            placement,
            gain: None,
            choosing: 0.0,
            contacts,
            known: 0.0,
            localised: None,
            learning: 0.0,
        }
    }
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
    let mut poses = Poses::new(bench.log(), settings);
    let mut actions: Vec<Action> = Vec::new();
    let (placement, contacts) = first(bench, &mut poses, settings, &mut random)?;
    let mut next = Action::new(placement, contacts);
    let mut before: Option<Belief> = None;
    loop {
        let start = Instant::now();
        let steps = poses.after(bench.log());
        let belief = match settings.tracker {
            None => Belief::new(bench.log(), &steps)?,
            Some(_) => Belief::new(bench.log(), &beside_each_other(bench.log(), &steps))?,
        };
        next.learning = start.elapsed().as_secs_f64();
        let truth = true_frame(bench, settings, &steps);
        let (known, enough) = settings.until.known(&belief, bench.geometry(), &truth);
        next.known = known;
        let tolerance = settings.pose.filter(|_| settings.tracker.is_some());
        next.localised = tolerance.map(|tolerance| {
            let before = before.as_ref().filter(|_| !is_lost(&steps));
            before.map_or(0.0, |b| localization::known(b, &belief, bench.log(), &tolerance))
        });
        let localised = next.localised.is_none_or(|p| p >= SURE);
        watch(&next);
        actions.push(next);
        let finish = |actions: Vec<Action>, steps: Vec<Step>, end| {
            let start = true_start(bench, &steps);
            Episode {
                pose_error: apart(bench, &steps, &truth),
                drift: between(bench, &start, &truth),
                honesty: honesty(&belief, bench.geometry(), &truth),
                repeats: repeats(settings, &actions),
                lost: steps.iter().filter(|s| s.status == Status::Lost).count(),
                actions,
                end,
                steps,
            }
        };
        if known >= enough && localised {
            return Ok(finish(actions, steps, End::Known));
        }
        if actions.len() >= settings.most_actions {
            return Ok(finish(actions, steps, End::OutOfActions));
        }

        let start = Instant::now();
        let candidates = candidates(&belief, settings, &mut random);
        let Some((choice, gain)) =
            choose(&belief, &steps, settings, &candidates, &actions, &mut random)
        else {
            return Ok(finish(actions, steps, End::NoCandidate));
        };
        if let (Until::Gain(least), Some(gain)) = (settings.until, gain)
            && gain < least
            && localised
        {
            return Ok(finish(actions, steps, End::NothingToGain));
        }
        let choosing = start.elapsed().as_secs_f64();
        let placement = candidates[choice];
        let off = (placement.hand.translation.vector - belief.centre).norm();
        let strokes = placement.strokes(dimension, belief.radius + off);
        let contacts = bench.close(&(belief.pose * placement.hand), &strokes);
        next = Action { gain, choosing, ..Action::new(placement, contacts) };
        before = Some(belief);
    }
}

/// The poses of all grasps as they are known now.
struct Poses {
    tracker: Option<Follower>,
    graph: graph::Kind,
    taken: usize,
}

impl Poses {
    fn new(log: &GraspLog, settings: &Settings) -> Poses {
        let tracker = settings.tracker.map(|kind| kind.start(log, settings.seed));
        Poses { tracker, graph: settings.graph, taken: 0 }
    }

    /// Takes the grasps that are new in the log.
    fn after(&mut self, log: &GraspLog) -> Vec<Step> {
        let Some(tracker) = &mut self.tracker else {
            return vec![Step::certain(Pose::identity()); log.grasps.len()];
        };
        for grasp in log.grasps.iter().skip(self.taken) {
            tracker.take(grasp, &log.noise);
        }
        self.taken = log.grasps.len();
        let steps = tracker.steps();
        self.graph.correct(log, &steps).map_or(steps, |corrected| corrected.steps)
    }
}

fn is_lost(steps: &[Step]) -> bool {
    steps.last().is_some_and(|s| s.status == Status::Lost)
}

/// The first grasp, of which nothing is known but where the object roughly is: any candidate about the
/// world's origin, again until something is felt. Closings that felt nothing stay in the log.
fn first(
    bench: &mut Bench,
    poses: &mut Poses,
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
            Candidates::Continuous(_) => drawn(dimension, &Point::zeros(), radius, random),
        };
        let strokes = placement.strokes(dimension, 2.0 * radius);
        let contacts = bench.close(&placement.hand, &strokes);
        if contacts > 0 {
            // In the object frame, which a tracker puts at the middle of the contacts.
            let steps = poses.after(bench.log());
            let hand = steps.last().map_or(placement.hand, |s| s.pose.inv_mul(&placement.hand));
            return Ok((Placement { hand, ..placement }, contacts));
        }
    }
    Err(Error::Missed)
}

/// From the true object frame to the believed one: by the first grasp, which fixed it. Where the pose
/// is tracked, nobody can know how that grasp lay on the shape beyond what it felt: then by where all
/// contacts at the tracked poses lie best on the true surface ([`gauge()`]).
fn true_frame(bench: &Bench, settings: &Settings, steps: &[Step]) -> Pose {
    let frame = true_start(bench, steps);
    if settings.tracker.is_none() {
        return frame;
    }
    gauge(bench.log(), steps, bench.geometry()).map_or(frame, |gauge| gauge.inverse())
}

/// From the true object frame to the believed one by the first grasp alone.
fn true_start(bench: &Bench, steps: &[Step]) -> Pose {
    let first = bench.log().grasps.first().and_then(|g| g.truth).zip(steps.first());
    first.map_or_else(Pose::identity, |(truth, step)| step.pose.inv_mul(&truth))
}

/// How far the last pose is from the true one.
fn apart(bench: &Bench, steps: &[Step], frame: &Pose) -> (f64, f64) {
    let last = bench.log().grasps.last().and_then(|g| g.truth).zip(steps.last());
    let Some((truth, step)) = last else { return (0.0, 0.0) };
    between(bench, &(step.pose * frame), &truth)
}

/// Between two poses of the object: metres at its centroid, and radians.
fn between(bench: &Bench, a: &Pose, b: &Pose) -> (f64, f64) {
    let centre = Point3::from(bench.geometry().centroid());
    ((a * centre - b * centre).norm(), a.rotation.angle_to(&b.rotation))
}

fn repeats(settings: &Settings, actions: &[Action]) -> usize {
    let again = |(i, action): &(usize, &Action)| {
        actions[..*i].iter().any(|before| same(settings, &before.placement, &action.placement))
    };
    actions.iter().enumerate().filter(again).count()
}

fn candidates(belief: &Belief, settings: &Settings, random: &mut Random) -> Vec<Placement> {
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
    steps: &[Step],
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
        (_, About::Pose) if tracked_deviation(belief, steps) < UNCERTAIN => Criterion::VarianceSum,
        (criterion, _) => criterion,
    };
    let scores = match (criterion, settings.pose, settings.tracker) {
        (Criterion::Both, Some(tolerance), Some(_)) => {
            both(belief, settings.until, candidates, &tolerance)
        }
        _ => criterion.scores(belief, &predict(belief, candidates)),
    };
    let recent = &done[done.len().saturating_sub(REMEMBERED)..];
    let choice = best(&scores, |i| again(&i, recent)).or_else(|| best(&scores, |_| false))?;
    Some((choice, Some(scores[choice])))
}

/// Information about the shape, and the chance that the grasp leaves the pose within its tolerance: worth
/// the more the more of the shape the belief takes for known, since the next slip undoes it.
fn both(
    belief: &Belief,
    until: Until,
    candidates: &[Placement],
    tolerance: &Deviation,
) -> Vec<f64> {
    let worth = LOCALISED * believed_share(belief, until.deviation()).powi(PATIENCE);
    let about_shape = Criterion::Information.scores(belief, &predict(belief, candidates));
    let chances = localization::expected(belief, candidates, tolerance);
    about_shape.iter().zip(chances).map(|(shape, chance)| shape + worth * chance).collect()
}

/// The pose's deviation by the tracker's own account, which the thesis' switch asks.
fn tracked_deviation(belief: &Belief, steps: &[Step]) -> f64 {
    steps.last().map_or(0.0, |last| pose_deviation(belief, &last.covariance))
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
            pose: None,
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
        assert!(episode.reached() && episode.actions.len() <= 6, "{}", episode.actions.len());
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
        assert!(episode.reached(), "{:?}", episode.actions.last());
        assert!(
            episode.pose_error.0 < 4e-3 && episode.pose_error.1 < 0.08,
            "{:?}",
            episode.pose_error
        );
    }

    #[test]
    fn it_goes_on_until_the_pose_is_known_as_well_as_it_was_asked_for() {
        let mut bench = bench("rectangle:0.1x0.06", (5e-3, 10f64.to_radians()), 1001);
        let pose = Deviation { length: 3e-3, angle: 3f64.to_radians() };
        let settings = Settings {
            tracker: Some(Kind::Hypotheses),
            pose: Some(pose),
            most_actions: 30,
            ..settings(Criterion::Both, Candidates::Continuous(40))
        };
        let episode = with_room(|| explore(&mut bench, &settings, |_| ())).unwrap();
        assert_eq!(episode.end, End::Known, "{:?}", episode.actions.last());
        let (last, before) = episode.actions.split_last().unwrap();
        assert!(last.localised.unwrap() >= SURE && last.known >= 0.9);
        for action in before {
            assert!(action.localised.unwrap() < SURE || action.known < 0.9);
        }
        let (length, angle) = episode.pose_error;
        assert!(length < 2.0 * pose.length && angle < 2.0 * pose.angle, "{length} {angle}");
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
        assert!(episode.reached() && episode.actions.len() == 1);
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
