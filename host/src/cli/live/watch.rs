//! A session as a browser shows it while it runs.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Instant;

use crate::cli::Error;
use crate::cli::slam::Input;
use crate::cli::view_address::{self, Address};
use crate::log::GraspLog;
use crate::slam::choose::Choice;
use crate::slam::output::Outcome;
use crate::slam::reconstruct::{Reconstruction, reconstruct};
use crate::slam::track::Step;
use crate::view::growth::{shown, viewed};
use crate::view::live::LiveView;
use crate::view::scene::{Grasp, Meta, Shape, Surface};

/// Contacts that a surface on the way is fitted to at most, in the plane and in space.
const CONTACTS: [usize; 2] = [300, 200];

/// A view of a log that is being fed to a board.
pub(super) struct Watch<'a> {
    view: LiveView,
    log: &'a GraspLog,
    start: Instant,
    felt: Mutex<Felt>,
    news: Condvar,
}

/// What the board has made of the log so far.
#[derive(Default)]
struct Felt {
    steps: Vec<Step>,
    over: bool,
}

impl<'a> Watch<'a> {
    /// Opens the view and says where it is.
    ///
    /// # Errors
    /// When the address is not one of this machine, or taken.
    pub fn open(at: &Address, input: &'a Input, tracker: &str) -> Result<Self, Error> {
        let view = at.open()?;
        view.begin(&Meta {
            tracker: Some(tracker.to_owned()),
            fingers: input.log.fingers.clone(),
            grasps: Some(input.log.grasps.len() as u64),
            truth: input.truth.as_ref().map(|t| Shape::new(&shown(t))),
            ..Meta::new(input.log.dimension, input.title())
        });
        Ok(Watch {
            view,
            log: &input.log,
            start: Instant::now(),
            felt: Mutex::default(),
            news: Condvar::new(),
        })
    }

    fn felt(&self) -> MutexGuard<'_, Felt> {
        self.felt.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the board made of grasp `number` of the log.
    pub fn grasp(&self, number: usize, step: Step) {
        let Some(logged) = self.log.grasps.get(number) else { return };
        let grasp = Grasp::estimated(logged, &step, self.log.dimension);
        self.view.grasp(Grasp { time: Some(self.start.elapsed().as_secs_f64()), ..grasp });
        self.felt().steps.push(step);
        self.news.notify_all();
    }

    /// Does `work`; beside it, in a thread of its own, the surface of what was felt so far is fitted
    /// again and again, each time to the newest.
    pub fn beside<R>(&self, work: impl FnOnce() -> R) -> R {
        thread::scope(|scope| {
            scope.spawn(|| self.shape());
            // Also when `work` panics: the scope waits for its threads.
            let _over = Over(self);
            work()
        })
    }

    fn shape(&self) {
        let mut done = 0;
        loop {
            let mut felt = self.felt();
            while felt.steps.len() == done && !felt.over {
                felt = self.news.wait(felt).unwrap_or_else(PoisonError::into_inner);
            }
            if felt.over {
                return;
            }
            let steps = felt.steps.clone();
            drop(felt);
            done = steps.len();
            if let Some(reconstruction) = sketch(self.log, &steps) {
                let after = self.log.grasps.get(done - 1).map_or(0, |g| g.index);
                self.view.surface(&surface(&reconstruction, after));
            }
        }
    }

    /// Shows the final surface and that nothing more will come.
    pub fn finish(&self, outcome: &Outcome) {
        let judged = &outcome.report.surface;
        let after = self.log.grasps.last().map_or(0, |g| g.index);
        self.view.surface(&Surface {
            hausdorff_mm: judged.hausdorff_mm,
            mean_mm: judged.mean_mm,
            ..surface(&outcome.reconstruction, after)
        });
        self.view.end();
    }

    /// Keeps the view open until somebody ends the program.
    pub fn stay(&self) -> ! {
        view_address::stay(&self.view)
    }
}

/// Ends the thread that fits surfaces.
struct Over<'a>(&'a Watch<'a>);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.felt().over = true;
        self.0.news.notify_all();
    }
}

/// The object as the first grasps show it, from a part of their contacts where there are many; `None`
/// where nothing fits them.
fn sketch(log: &GraspLog, steps: &[Step]) -> Option<Reconstruction> {
    let mut grasps = log.grasps.get(..steps.len())?.to_vec();
    let count: usize = grasps.iter().map(|g| g.contacts.len()).sum();
    let stride = count.div_ceil(CONTACTS[usize::from(log.dimension == 3)]).max(1);
    let mut number = 0;
    for grasp in &mut grasps {
        grasp.contacts.retain(|_| {
            number += 1;
            number % stride == 0
        });
    }
    let log = GraspLog {
        dimension: log.dimension,
        description: String::new(),
        fingers: log.fingers.clone(),
        noise: log.noise,
        shape: None,
        grasps,
        unknown: serde_json::Map::new(),
    };
    reconstruct(&log, steps, Choice::Auto, &|_, _| ()).ok()
}

fn surface(reconstruction: &Reconstruction, after: u64) -> Surface {
    let (geometry, deviations) = viewed(reconstruction);
    Surface::new(&geometry, &deviations, after)
}
