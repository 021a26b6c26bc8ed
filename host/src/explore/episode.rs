//! The closed loop: choose a grasp, make it, take what was felt, until enough is known.

use std::collections::VecDeque;
use std::time::Instant;

use nalgebra::{Point3, Translation3};
use tactile_core::track::Status;

use super::adviser::Adviser;
use super::areas::NextArea;
use super::belief::{Belief, beside_each_other};
use super::choice::{advised, candidates, choose, same};
use super::coverage::{SAMPLES, Until, honesty};
use super::criterion::Criterion;
use super::localization;
use super::placement::{Placement, drawn, fixed};
use super::planning::Planning;
use super::poses::{Poses, is_lost};
use crate::graph::{self, Corrected};
use crate::link::SessionError;
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::shape::symmetry::Symmetry;
use crate::sim::hand::Unreachable;
use crate::sim::random::Random;
use crate::sim::{Bench, Hand};
use crate::slam::gauge::{at_start, gauge};
use crate::slam::reconstruct;
use crate::slam::track::Step;
use crate::slam::trackers::Kind;
use crate::space::{Point, Pose};

/// Tries at a first grasp that feels anything.
const FIRST_TRIES: usize = 50;

/// How probable it must be that the last pose is within its tolerance.
pub const SURE: f64 = 0.95;

/// Among what a hand chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Candidates {
    /// The same ten every time, as in the thesis.
    Fixed,
    /// So many new ones at every choice, about the object as it is believed to be.
    Continuous(usize),
    /// Those that face the next contact area (thesis 4.5.1). Of the idealised hand: an articulated one
    /// has its [`Fixed`](Candidates::Fixed) ones instead.
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
    /// What corrects the poses after the tracker. [`graph::Kind::Planes`] does so from the third grasp on
    /// where all that was felt lies on flat faces.
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

/// What happens in an exploration, as it happens.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// The next grasp was chosen and is about to be made.
    Chosen {
        /// Among these, object frame.
        candidates: &'a [Placement],
        /// What each promises; empty where chance decides.
        gains: &'a [f64],
        /// Which of them.
        choice: usize,
    },
    /// A grasp was made.
    Touched {
        /// It, and what came of it.
        action: &'a Action,
        /// All that was felt.
        log: &'a GraspLog,
        /// The poses as they are known now.
        steps: &'a [Step],
        /// The shape as it is known now.
        belief: &'a Belief,
    },
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
    /// Why the hand could not get there, where it could not; the object was not touched then.
    pub refused: Option<Unreachable>,
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
    /// What the graph made of them, to make a shape of; `None` where the tracker's stand.
    pub corrected: Option<Corrected>,
    /// What tracker and graph have taken in all, seconds.
    pub tracking: f64,
    /// See `tracking`.
    pub correcting: f64,
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
    /// No feasible grasp is left.
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
            refused: None,
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
    /// Probing found nothing to explore.
    #[error("probing from every side: {0}; is the object out of the hand's reach?")]
    NotFound(#[from] Unreachable),
    /// What was felt makes no surface.
    #[error(transparent)]
    Surface(#[from] reconstruct::Error),
    /// Who was to choose does not answer.
    #[error(transparent)]
    Adviser(#[from] SessionError),
}

/// What a belief is judged by: it, and the pose that takes the true object frame to the believed one,
/// give the share that counts as known and how much of it is enough.
type Judge<'a> = dyn FnMut(&Belief, &Pose) -> (f64, f64) + 'a;

/// Explores the object on the bench, and tells `watch` of every choice and every action.
///
/// # Errors
/// When the hand meets nothing at first, or what it felt makes no surface.
pub fn explore(
    bench: &mut Bench,
    settings: &Settings,
    watch: impl FnMut(Event<'_>),
) -> Result<Episode, Error> {
    explore_advised(bench, settings, None, watch)
}

/// The same where somebody else chooses among the candidates, by what it makes of the grasps itself.
/// Candidates are drawn and enough is known by the belief held here, as ever.
///
/// # Errors
/// As [`explore`], and where nobody advises.
pub fn explore_advised(
    bench: &mut Bench,
    settings: &Settings,
    adviser: Option<&mut dyn Adviser>,
    mut watch: impl FnMut(Event<'_>),
) -> Result<Episode, Error> {
    let surface = bench.reachable(SAMPLES);
    let mut judge =
        |belief: &Belief, frame: &Pose| settings.until.known_of(belief, &surface, frame);
    run(bench, settings, &mut judge, adviser, &mut watch)
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
    mut watch: impl FnMut(Event<'_>),
) -> Result<Episode, Error> {
    run(bench, settings, &mut known, None, &mut watch)
}

fn run(
    bench: &mut Bench,
    settings: &Settings,
    judge: &mut Judge<'_>,
    mut adviser: Option<&mut dyn Adviser>,
    watch: &mut dyn FnMut(Event<'_>),
) -> Result<Episode, Error> {
    let [mut random] = Random::streams(settings.seed ^ 0x5eed_ca5e);
    let mut poses = Poses::new(bench.log(), settings);
    let mut actions: Vec<Action> = Vec::new();
    let mut planned: VecDeque<(Placement, Option<f64>)> = VecDeque::new();
    let (placement, contacts) = first(bench, &mut poses, settings, &mut random)?;
    let mut next = Action::new(placement, contacts);
    let mut before: Option<Belief> = None;
    loop {
        let start = Instant::now();
        let steps = poses.after(bench.log());
        let belief = believed(bench, settings, &steps, before.as_ref())?;
        next.learning = start.elapsed().as_secs_f64();
        let truth = true_frame(bench, settings, &steps);
        let (known, enough) = judge(&belief, &truth);
        next.known = known;
        let sure = before.as_ref().filter(|_| !is_lost(&steps));
        next.localised = settings.pose.filter(|_| settings.tracker.is_some()).map(|tolerance| {
            sure.map_or(0.0, |before| localization::known(before, &belief, bench.log(), &tolerance))
        });
        let localised = next.localised.is_none_or(|p| p >= SURE);
        let log = bench.log();
        watch(Event::Touched { action: &next, log, steps: &steps, belief: &belief });
        actions.push(next);
        let finish = |actions: Vec<Action>, steps: Vec<Step>, end| {
            let start = true_start(bench, &steps);
            Episode {
                pose_error: apart(bench, &steps, &truth),
                drift: between(bench, &start, &truth),
                honesty: honesty(&belief, bench.geometry(), &truth),
                repeats: repeats(settings, &actions),
                lost: steps.iter().filter(|s| s.status == Status::Lost).count(),
                corrected: poses.corrected.clone(),
                tracking: poses.tracking,
                correcting: poses.correcting,
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
        let decides = planned.is_empty();
        if decides {
            let candidates = candidates(&belief, settings, &actions, &mut random);
            let mut choice = choose(&belief, &steps, settings, &candidates, &actions, &mut random);
            if let (Some(adviser), false) = (adviser.as_deref_mut(), choice.grasps.is_empty()) {
                choice.grasps =
                    advised(adviser, &belief, bench.log(), settings, &candidates, &actions)?;
            }
            if let Until::Gain(least) = settings.until
                && localised
                && choice
                    .promised(settings.criterion, adviser.is_some())
                    .is_some_and(|most| most < least)
            {
                return Ok(finish(actions, steps, End::NothingToGain));
            }
            if let Some((first, _)) = choice.grasps.first() {
                let (candidates, gains) = (&candidates[..], &choice.gains[..]);
                watch(Event::Chosen { candidates, gains, choice: *first });
            }
            planned.extend(choice.grasps.iter().map(|(i, gain)| (candidates[*i], *gain)));
        }
        let choosing = if decides { start.elapsed().as_secs_f64() } else { 0.0 };
        let Some((placement, gain)) = planned.pop_front() else {
            return Ok(finish(actions, steps, End::NoCandidate));
        };
        if !decides {
            let (candidates, gains) = ([placement], Vec::from_iter(gain));
            watch(Event::Chosen { candidates: &candidates, gains: &gains, choice: 0 });
        }
        let off = (placement.hand.translation.vector - belief.centre).norm();
        let at = belief.pose * placement.hand;
        let felt = bench.grasp(&at, placement.spread, belief.radius + off);
        let (contacts, refused) = felt.map_or_else(|why| (0, Some(why)), |count| (count, None));
        next = Action { gain, choosing, refused, ..Action::new(placement, contacts) };
        before = Some(belief);
    }
}

/// What is believed after the log's last grasp. Where poses are given, `before` only learns that grasp.
fn believed(
    bench: &Bench,
    settings: &Settings,
    steps: &[Step],
    before: Option<&Belief>,
) -> Result<Belief, Error> {
    let log = bench.log();
    let mut belief = match (settings.tracker, before) {
        (None, Some(before)) => before.after(log, steps)?,
        (None, None) => Belief::new(log, steps)?,
        (Some(_), before) => Belief::new(log, &beside_each_other(log, steps, before))?,
    };
    (belief.hand, belief.table) = (bench.hand().clone(), bench.table());
    Ok(belief)
}

/// The first action. An articulated hand delimits the object by probing (thesis figure 4.2), all guarded
/// moves together counted as one action. The idealised hand, of which nothing can be in the object's way,
/// opens as wide as it can and closes about the middle of the workspace, from any side, again until
/// something is felt; closings that felt nothing stay in the log. Nothing is known of the object's size.
fn first(
    bench: &mut Bench,
    poses: &mut Poses,
    settings: &Settings,
    random: &mut Random,
) -> Result<(Placement, usize), Error> {
    let dimension = bench.log().dimension;
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
            Candidates::Continuous(_) | Candidates::Clusters(_) => {
                drawn(dimension, &Point::zeros(), 0.0, random)
            }
        };
        let contacts = bench.close(&placement.hand, &placement.strokes(dimension, 0.0));
        if contacts > 0 {
            // In the object frame, which a tracker puts at the middle of the contacts.
            let steps = poses.after(bench.log());
            let hand = steps.last().map_or(placement.hand, |s| s.pose.inv_mul(&placement.hand));
            return Ok((Placement { hand, ..placement }, contacts));
        }
    }
    Err(Error::Missed)
}

/// From the true object frame to the believed one: by the first grasp that felt something, which fixed it. Where the
/// pose is tracked, nobody can know how that grasp lay on the shape beyond what it felt: then by where all
/// contacts at the tracked poses lie best on the true surface ([`gauge()`]).
fn true_frame(bench: &Bench, settings: &Settings, steps: &[Step]) -> Pose {
    let frame = true_start(bench, steps);
    if settings.tracker.is_none() {
        return frame;
    }
    gauge(bench.log(), steps, bench.geometry()).map_or(frame, |gauge| gauge.inverse())
}

/// From the true object frame to the believed one by the first grasp that felt something.
fn true_start(bench: &Bench, steps: &[Step]) -> Pose {
    at_start(bench.log(), steps).unwrap_or_else(Pose::identity)
}

/// How far the last pose is from the true one.
fn apart(bench: &Bench, steps: &[Step], frame: &Pose) -> (f64, f64) {
    let last = bench.log().grasps.last().and_then(|g| g.truth).zip(steps.last());
    let Some((truth, step)) = last else { return (0.0, 0.0) };
    between(bench, &(step.pose * frame), &truth)
}

/// Between two poses of the object: metres at its centroid, and radians up to its symmetry.
fn between(bench: &Bench, a: &Pose, b: &Pose) -> (f64, f64) {
    let centre = Point3::from(bench.geometry().centroid());
    let turn = a.rotation.inverse() * b.rotation;
    ((a * centre - b * centre).norm(), Symmetry::of(bench.geometry()).angle(&turn))
}

fn repeats(settings: &Settings, actions: &[Action]) -> usize {
    let again = |(i, action): &(usize, &Action)| {
        actions[..*i].iter().any(|before| same(settings, &before.placement, &action.placement))
    };
    actions.iter().enumerate().filter(again).count()
}

#[cfg(test)]
mod tests;
