//! The scene so far, and how far in it each viewer is.
//!
//! There are no queues. A viewer has a place in what came last; one that falls behind that is told the
//! scene from the start again, long scenes thinned ([`Timeline`]). So no viewer costs memory by being
//! slow, none holds up who tells, and every contact reaches everyone in one of the two ways. Of
//! surfaces and of choices a viewer gets the newest, when it has no grasps left to read.

use std::collections::VecDeque;

use tungstenite::Utf8Bytes;

use crate::view::scene::{Choice, Grasp, Message, Meta, Surface};
use crate::view::timeline::Timeline;

/// Grasps that are kept as they came.
const RECENT: usize = 512;

/// Grasps that a viewer takes at once.
const BATCH: usize = 64;

/// Surfaces on the way that are kept for who comes later, and choices.
const SURFACES: usize = 16;
const CHOICES: usize = 128;

/// What was told.
#[derive(Default)]
pub(super) struct History {
    /// Scenes begun.
    scene: u64,
    meta: Option<Utf8Bytes>,
    timeline: Timeline,
    /// The last grasps, and the number of grasps told.
    recent: VecDeque<Utf8Bytes>,
    grasps: u64,
    /// Surfaces, and the number of those told.
    surfaces: Vec<Utf8Bytes>,
    shaped: u64,
    /// The same of choices.
    choices: Vec<Utf8Bytes>,
    chosen: u64,
    ended: bool,
}

/// Where a viewer is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Place {
    scene: u64,
    grasps: u64,
    shaped: u64,
    chosen: u64,
    ended: bool,
}

/// What a viewer is told next.
pub(super) enum Next {
    /// It knows everything.
    Nothing,
    /// Some messages.
    Lines(Vec<Utf8Bytes>),
    /// The scene from the start.
    All(Box<Scene>),
}

/// A scene from the start.
pub(super) struct Scene {
    meta: Utf8Bytes,
    timeline: Timeline,
    surfaces: Vec<Utf8Bytes>,
    choices: Vec<Utf8Bytes>,
    end: Option<Utf8Bytes>,
}

impl Scene {
    /// Its messages.
    pub fn into_lines(self) -> impl Iterator<Item = Utf8Bytes> {
        let grasps = self.timeline.into_grasps().into_iter();
        let grasps = grasps.filter_map(|grasp| line(&Message::Grasp(&grasp)));
        let after = self.surfaces.into_iter().chain(self.choices).chain(self.end);
        [self.meta].into_iter().chain(grasps).chain(after)
    }
}

/// A message as it travels; none that the serialiser refuses.
fn line(message: &Message<'_>) -> Option<Utf8Bytes> {
    message.to_json().ok().map(Utf8Bytes::from)
}

/// Appends; where there are `most`, every other one of those before stays.
fn keep(lines: &mut Vec<Utf8Bytes>, line: Utf8Bytes, most: usize) {
    if lines.len() >= most {
        let mut stays = false;
        lines.retain(|_| {
            stays = !stays;
            stays
        });
    }
    lines.push(line);
}

impl History {
    /// A scene begins; the one before is gone.
    pub fn begin(&mut self, meta: &Meta) {
        *self = History {
            scene: self.scene + 1,
            meta: line(&Message::Meta(meta)),
            ..History::default()
        };
    }

    /// The hand closed once more.
    pub fn grasp(&mut self, grasp: Grasp) {
        let Some(line) = line(&Message::Grasp(&grasp)) else { return };
        self.timeline.push(grasp);
        self.recent.push_back(line);
        self.grasps += 1;
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
    }

    /// The surface as it is known now.
    pub fn surface(&mut self, surface: &Surface) {
        let Some(line) = line(&Message::Surface(surface)) else { return };
        keep(&mut self.surfaces, line, SURFACES);
        self.shaped += 1;
    }

    /// What is known now, and among what the next grasp was chosen.
    pub fn choice(&mut self, choice: &Choice) {
        let Some(line) = line(&Message::Choice(choice)) else { return };
        keep(&mut self.choices, line, CHOICES);
        self.chosen += 1;
    }

    /// Nothing more will come.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// What the viewer at `place` is told next; it is there then.
    pub fn next(&self, place: &mut Place) -> Next {
        let Some(meta) = &self.meta else { return Next::Nothing };
        let behind = self.grasps - place.grasps.min(self.grasps);
        if place.scene != self.scene || behind > self.recent.len() as u64 {
            *place = Place {
                scene: self.scene,
                grasps: self.grasps,
                shaped: self.shaped,
                chosen: self.chosen,
                ended: self.ended,
            };
            let end = self.ended.then(|| line(&Message::End)).flatten();
            let (meta, timeline) = (meta.clone(), self.timeline.clone());
            let (surfaces, choices) = (self.surfaces.clone(), self.choices.clone());
            return Next::All(Box::new(Scene { meta, timeline, surfaces, choices, end }));
        }
        if behind > 0 {
            let known = self.recent.len() - behind as usize;
            let lines: Vec<_> = self.recent.range(known..).take(BATCH).cloned().collect();
            place.grasps += lines.len() as u64;
            return Next::Lines(lines);
        }
        let mut lines = Vec::new();
        if place.shaped != self.shaped {
            place.shaped = self.shaped;
            lines.extend(self.surfaces.last().cloned());
        }
        if place.chosen != self.chosen {
            place.chosen = self.chosen;
            lines.extend(self.choices.last().cloned());
        }
        if self.ended && !place.ended {
            place.ended = true;
            lines.extend(line(&Message::End));
        }
        if lines.is_empty() { Next::Nothing } else { Next::Lines(lines) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::scene::Packed;

    fn grasp(number: u64) -> Grasp {
        let contacts = Packed(vec![number as f32, 0.0, 0.0, 1.0, 0.0, 0.0]);
        let fingers = Packed(vec![0]);
        Grasp { grasp: number, merged: 1, touched: 1, contacts, fingers, ..Grasp::default() }
    }

    fn begun() -> History {
        let mut history = History::default();
        history.begin(&Meta::new(2, "test"));
        history
    }

    /// Everything the viewer at `place` is told until it knows all, and how often from the start.
    fn told(history: &History, place: &mut Place) -> (Vec<String>, usize) {
        let (mut lines, mut starts) = (Vec::new(), 0);
        loop {
            match history.next(place) {
                Next::Nothing => break,
                Next::Lines(some) => lines.extend(some.iter().map(|l| l.to_string())),
                Next::All(scene) => {
                    starts += 1;
                    lines.extend(scene.into_lines().map(|l| l.to_string()));
                }
            }
        }
        (lines, starts)
    }

    fn types(lines: &[String]) -> String {
        lines.iter().map(|l| &l[9..10]).collect()
    }

    #[test]
    fn before_a_scene_begins_there_is_nothing() {
        let mut place = Place::default();
        assert_eq!(told(&History::default(), &mut place), (vec![], 0));
        assert_eq!(place, Place::default());
    }

    #[test]
    fn who_keeps_up_hears_each_thing_once_in_order() {
        let mut history = begun();
        let mut place = Place::default();
        assert_eq!(types(&told(&history, &mut place).0), "m");
        history.grasp(grasp(0));
        history.grasp(grasp(1));
        history.surface(&Surface { after: 1, ..Surface::default() });
        history.choice(&Choice { after: 1, ..Choice::default() });
        let (lines, starts) = told(&history, &mut place);
        assert_eq!((types(&lines).as_str(), starts), ("ggsc", 0));
        history.end();
        assert_eq!(types(&told(&history, &mut place).0), "e");
        assert_eq!(told(&history, &mut place), (vec![], 0));
    }

    #[test]
    fn who_comes_later_hears_the_scene_so_far() {
        let mut history = begun();
        (0..3).for_each(|k| history.grasp(grasp(k)));
        history.surface(&Surface { after: 2, ..Surface::default() });
        (0..3).for_each(|after| history.choice(&Choice { after, ..Choice::default() }));
        let mut place = Place::default();
        let (lines, starts) = told(&history, &mut place);
        assert_eq!((types(&lines).as_str(), starts), ("mgggsccc", 1));
        history.grasp(grasp(3));
        assert_eq!(types(&told(&history, &mut place).0), "g");
        history.end();
        assert_eq!(types(&told(&history, &mut Place::default()).0), "mggggsccce");
    }

    #[test]
    fn a_slow_viewer_skips_surfaces_and_no_grasp() {
        let mut history = begun();
        let mut place = Place::default();
        told(&history, &mut place);
        for k in 0..RECENT as u64 {
            history.grasp(grasp(k));
            history.surface(&Surface { after: k, ..Surface::default() });
        }
        let (lines, starts) = told(&history, &mut place);
        assert_eq!((lines.len(), starts), (RECENT + 1, 0));
        assert!(lines[RECENT].contains(&format!("\"after\":{}", RECENT - 1)), "the newest");
    }

    #[test]
    fn who_falls_far_behind_starts_again_and_misses_no_contact() {
        let mut history = begun();
        let mut place = Place::default();
        told(&history, &mut place);
        (0..=RECENT as u64).for_each(|k| history.grasp(grasp(k)));
        let (lines, starts) = told(&history, &mut place);
        assert_eq!((lines.len(), starts), (RECENT + 2, 1));
        assert!(lines[0].contains("\"meta\""));
        // A new scene takes its place for everyone.
        history.begin(&Meta::new(3, "another"));
        let (lines, starts) = told(&history, &mut place);
        assert_eq!((types(&lines).as_str(), starts), ("m", 1));
    }

    #[test]
    fn a_long_session_is_held_in_bounded_memory() {
        let mut history = begun();
        for k in 0..30_000 {
            history.grasp(grasp(k));
            if k % 100 == 0 {
                history.surface(&Surface { after: k, ..Surface::default() });
            }
        }
        assert_eq!((history.recent.len(), history.grasps), (RECENT, 30_000));
        assert!(history.surfaces.len() <= SURFACES);
        let (lines, _) = told(&history, &mut Place::default());
        assert!((1_000..4_000).contains(&lines.len()), "{}", lines.len());
        assert!(lines.last().unwrap().contains("\"after\":29900"), "the newest surface is kept");
    }
}
