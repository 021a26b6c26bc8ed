//! Somebody else who chooses the next grasp: a board, by the belief that it holds itself.

use tactile_core::device::CANDIDATES;
use tactile_core::explore::{Candidate, Criterion, Stroke};
use tactile_core::wire::WireSpace;

use crate::link::session::settings_for;
use crate::link::{Link, Session, SessionError};
use crate::log::GraspLog;
use crate::sim::touch;
use crate::slam::track;
use crate::space::{Bridge, Pose};

/// A grasp that could be made.
#[derive(Clone, Debug, PartialEq)]
pub struct Closing {
    /// Hand to world.
    pub hand: Pose,
    /// The ways of its fingertips, hand frame.
    pub strokes: Vec<touch::Stroke>,
}

impl Closing {
    /// The same for a board; fingers beyond the fifth stay open.
    pub fn candidate<S: Bridge>(&self) -> Candidate<S> {
        let mut candidate = Candidate::new(S::pose(&self.hand));
        for stroke in &self.strokes {
            if let Some(place) = candidate.strokes.get_mut(stroke.finger) {
                *place = Some(Stroke {
                    start: S::vector(&stroke.start),
                    direction: S::vector(&stroke.direction),
                    travel: stroke.travel as f32,
                });
            }
        }
        candidate
    }
}

/// Who chooses.
pub trait Adviser {
    /// The best of some grasps and what it promises, by what is in `log`: the grasps that it has heard
    /// of before and those that have been made since.
    ///
    /// # Errors
    /// When nobody answers, or there is nothing to choose.
    fn choose(
        &mut self,
        log: &GraspLog,
        closings: &[Closing],
    ) -> Result<(usize, f64), SessionError>;
}

/// A board that follows the grasps with its own tracker and chooses by its own belief.
///
/// ```
/// use tactile_core::explore::Criterion;
/// use tactile_core::space::Planar;
/// use tactile_core::wire::TrackerKind;
/// use tactile_host::explore::{self, Board, Candidates, Planning, Settings, Until};
/// use tactile_host::link::{Patience, Session, virtual_board};
/// use tactile_host::sim::{Bench, Options};
///
/// let board = virtual_board::start(2, TrackerKind::Hypotheses).unwrap();
/// let session = Session::<Planar, _>::open(board, Patience::default()).unwrap();
/// let mut board = Board::new(session, Criterion::Information, 0);
/// let still = tactile_host::quantity::Deviation { length: 0.0, angle: 0.0 };
/// let object = "rectangle:0.1x0.06".parse().unwrap();
/// let mut bench = Bench::new(Options { motion_noise: still, ..Options::new(object) }).unwrap();
/// let settings = Settings {
///     criterion: explore::Criterion::Information,
///     candidates: Candidates::Fixed,
///     planning: Planning::default(),
///     tracker: None,
///     graph: tactile_host::graph::Kind::None,
///     until: Until::Lenient,
///     pose: None,
///     most_actions: 3,
///     seed: 1,
/// };
/// let episode = explore::explore_advised(&mut bench, &settings, Some(&mut board), |_| ()).unwrap();
/// assert!(episode.actions.iter().skip(1).all(|a| a.gain.is_some_and(|nats| nats > 0.0)));
/// ```
pub struct Board<S: WireSpace, L> {
    session: Session<S, L>,
    criterion: Criterion,
    seed: u64,
    /// Grasps of the log that it has been told.
    told: usize,
}

impl<S: WireSpace, L: Link> Board<S, L> {
    /// A board that begins anew with the first grasp it is told; `seed` of its tracker.
    pub fn new(session: Session<S, L>, criterion: Criterion, seed: u64) -> Self {
        Board { session, criterion, seed, told: 0 }
    }
}

impl<S: Bridge + WireSpace, L: Link> Adviser for Board<S, L> {
    fn choose(
        &mut self,
        log: &GraspLog,
        closings: &[Closing],
    ) -> Result<(usize, f64), SessionError> {
        if log.dimension != S::DIMENSION {
            let board = S::DIMENSION as u8;
            return Err(SessionError::Dimension { board, log: log.dimension });
        }
        if self.told == 0 {
            self.session.configure(settings_for(log, self.seed))?;
        }
        for grasp in log.grasps.iter().skip(self.told) {
            let motion = grasp.motion.as_ref().map(S::pose);
            let contacts = track::contacts::<S>(grasp, &log.noise);
            let free = track::free_points::<S>(grasp);
            self.session.grasp(motion.as_ref(), &contacts, &free)?;
            self.told += 1;
        }
        let candidates: Vec<Candidate<S>> = closings.iter().map(Closing::candidate).collect();
        let choice = self.session.choose(self.criterion, &candidates)?;
        Ok((choice.number.into(), choice.gain.into()))
    }
}

/// Candidates that a board can be asked about.
pub const MOST: usize = CANDIDATES;

#[cfg(test)]
mod tests {
    use tactile_core::space::{Planar, Spatial};
    use tactile_core::wire::{Refusal, TrackerKind};

    use super::*;
    use crate::explore::{Candidates, Planning, Settings, Until, explore_advised};
    use crate::graph;
    use crate::link::{Faults, Faulty, Patience, virtual_board};
    use crate::quantity::Deviation;
    use crate::sim::{Bench, Options};

    fn bench(object: &str, moved: f64) -> Bench {
        let motion_noise = Deviation { length: moved, angle: 35.0 * moved };
        let options = Options::new(object.parse().unwrap());
        Bench::new(Options { motion_noise, seed: 5, ..options }).unwrap()
    }

    fn board<S: WireSpace>(tracker: TrackerKind) -> Board<S, Box<dyn Link>> {
        let link = virtual_board::start(S::DIMENSION, tracker).unwrap();
        let session = Session::open(link, Patience::default()).unwrap();
        Board::new(session, Criterion::Information, 3)
    }

    const SETTINGS: Settings = Settings {
        criterion: crate::explore::Criterion::Information,
        candidates: Candidates::Fixed,
        planning: Planning::SINGLE,
        tracker: None,
        graph: graph::Kind::None,
        until: Until::Strict,
        pose: None,
        most_actions: 5,
        seed: 5,
    };

    #[test]
    fn a_rectangle_is_explored_as_its_board_advises() {
        for (tracker, candidates) in [
            (TrackerKind::Hypotheses, Candidates::Fixed),
            (TrackerKind::Bootstrap, Candidates::Continuous(MOST)),
        ] {
            let mut bench = bench("rectangle:0.1x0.06", 0.0);
            let settings = Settings { candidates, ..SETTINGS };
            let mut board = board::<Planar>(tracker);
            let episode = explore_advised(&mut bench, &settings, Some(&mut board), |_| ()).unwrap();
            assert!(episode.reached(), "{tracker:?}: {:?}", episode.actions.last());
            // Every grasp but the last was told, as there was nothing to choose after it.
            assert_eq!(board.told + 1, bench.log().grasps.len());
            let gains: Vec<f64> = episode.actions.iter().filter_map(|a| a.gain).collect();
            assert_eq!(gains.len() + 1, episode.actions.len());
            assert!(gains.iter().all(|g| *g > 0.0 && *g < 50.0), "{gains:?}");
        }
    }

    /// What a bad line does to frames changes nothing of what is chosen.
    #[test]
    fn advice_survives_a_bad_line() {
        let run = |faults: Faults| {
            let link = virtual_board::start(2, TrackerKind::Hypotheses).unwrap();
            let mut link = Faulty::new(link, faults, 9);
            let patience = Patience { attempts: 60, ..Patience::default() };
            let session = Session::<Planar, _>::open(&mut link, patience).unwrap();
            let mut board = Board::new(session, Criterion::VarianceSum, 0);
            let mut bench = bench("hexagon:0.04", 2e-3);
            let settings = Settings { most_actions: 3, ..SETTINGS };
            let episode = explore_advised(&mut bench, &settings, Some(&mut board), |_| ()).unwrap();
            let chosen: Vec<_> = episode.actions.iter().map(|a| (a.placement, a.gain)).collect();
            (chosen, link.injected())
        };
        let none = Faults { drop: 0.0, corrupt: 0.0, double: 0.0, reorder: 0.0 };
        let some = Faults { drop: 0.03, corrupt: 0.03, double: 0.03, reorder: 0.03 };
        let ((clean, zero), (faulty, injected)) = (run(none), run(some));
        assert!(zero == 0 && injected > 3);
        assert_eq!(clean, faulty);
    }

    #[test]
    fn what_cannot_be_chosen_from_is_named() {
        let mut board = board::<Spatial>(TrackerKind::Hypotheses);
        let mut bench = bench("box:0.1x0.06x0.08", 0.0);
        let error = |result: Result<(usize, f64), SessionError>| result.unwrap_err().to_string();
        let strokes = touch::strokes(3, 5, 0.06, 1.0, 0.0);
        let closing = Closing { hand: Pose::identity(), strokes: strokes.clone() };
        assert!(error(board.choose(bench.log(), &[])).contains("no candidate"));
        let one = std::slice::from_ref(&closing);
        assert!(error(board.choose(bench.log(), one)).contains("nothing is known of the shape"));
        assert!(bench.close(&closing.hand, &strokes) > 0);
        board.choose(bench.log(), one).unwrap();
        let many = vec![closing.clone(); MOST + 1];
        match board.choose(bench.log(), &many) {
            Err(SessionError::Refused { refusal: Refusal::TooMany, .. }) => {}
            other => panic!("{other:?}"),
        }
        let open = Closing { strokes: Vec::new(), ..closing.clone() };
        let text = error(board.choose(bench.log(), &[closing.clone(), open]));
        assert!(text.contains("candidate 1") && text.contains("finger"), "{text}");
        let mut nowhere = closing.clone();
        nowhere.hand.translation.vector.x = f64::NAN;
        assert!(error(board.choose(bench.log(), &[nowhere])).contains("candidate 0"));
        let mut flat = bench.log().clone();
        flat.dimension = 2;
        assert!(error(board.choose(&flat, one)).contains("3 dimensions"));
    }
}
