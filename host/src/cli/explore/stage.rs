//! An exploration as a browser shows it, while it runs and after.

use std::time::Instant;

use crate::explore::episode::Event;
use crate::explore::{Belief, Settings};
use crate::shape::Field;
use crate::sim::Bench;
use crate::slam::output::Outcome;
use crate::slam::trackers::Kind;
use crate::view::growth::{shown, thinned, viewed};
use crate::view::live::LiveView;
use crate::view::scene::{Choice, Grasp, Meta, Shape, Surface};

/// Triangles of a surface on the way at most.
const TRIANGLES: usize = 6_000;

/// Takes down what was chosen among what, and tells a live view where there is one.
pub(super) struct Stage {
    view: Option<LiveView>,
    start: Instant,
    /// Grasps that were told.
    told: usize,
    choices: Vec<Choice>,
    /// What is known since the last grasp; the choice of the next is to come.
    open: Choice,
}

impl Stage {
    /// Before the first action; what a view showed before is gone.
    pub fn new(view: Option<LiveView>, bench: &Bench, settings: &Settings) -> Self {
        let log = bench.log();
        if let Some(view) = &view {
            view.begin(&Meta {
                tracker: Some(settings.tracker.map_or("known poses", Kind::name).to_owned()),
                fingers: log.fingers.clone(),
                truth: Some(Shape::new(&shown(bench.geometry()))),
                ..Meta::new(log.dimension, log.description.clone())
            });
        }
        let (choices, open) = (Vec::new(), Choice::default());
        Stage { view, start: Instant::now(), told: 0, choices, open }
    }

    /// What happened.
    pub fn show(&mut self, event: Event<'_>) {
        match event {
            Event::Touched { action, log, steps, belief } => {
                let after = log.grasps.last().map_or(0, |g| g.index);
                self.open = Choice { after, known: action.known, ..Choice::default() };
                let Some(view) = &self.view else { return };
                let time = Some(self.start.elapsed().as_secs_f64());
                for (logged, step) in log.grasps.iter().zip(steps).skip(self.told) {
                    let grasp = Grasp::estimated(logged, step, log.dimension);
                    view.grasp(Grasp { time, ..grasp });
                }
                self.told = log.grasps.len();
                view.surface(&surface(belief, after));
            }
            Event::Chosen { candidates, gains, choice } => {
                let mut made = std::mem::take(&mut self.open);
                for (number, candidate) in candidates.iter().enumerate() {
                    made.offer(&candidate.hand, gains.get(number).copied());
                }
                made.chosen = Some(choice);
                if let Some(view) = &self.view {
                    view.choice(&made);
                }
                self.choices.push(made);
            }
        }
    }

    /// Hands the choices over to the outcome; shows its surface and that nothing more will come.
    pub fn finish(mut self, outcome: &mut Outcome) -> Option<LiveView> {
        let after = self.open.after;
        if let Some(view) = &self.view {
            let judged = &outcome.report.surface;
            let (geometry, deviations) = viewed(&outcome.reconstruction);
            view.choice(&self.open);
            view.surface(&Surface {
                hausdorff_mm: judged.hausdorff_mm,
                mean_mm: judged.mean_mm,
                ..Surface::new(&geometry, &deviations, after)
            });
            view.end();
        }
        self.choices.push(self.open);
        outcome.choices = self.choices;
        self.view
    }
}

/// The shape as it is believed to be.
fn surface(belief: &Belief, after: u64) -> Surface {
    let (geometry, _) = thinned(belief.geometry.clone(), Vec::new(), TRIANGLES);
    let deviations = belief.surface.deviations(&geometry.vertices());
    Surface::new(&geometry, &deviations, after)
}
