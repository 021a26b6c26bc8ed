//! Where the object may be when the belief has several answers.

use crate::math;
use crate::space::{Pose, Space};

/// Modes that an estimate reports at most.
pub const MODES: usize = 4;

/// One answer of a belief.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode<S: Space> {
    /// Object to world.
    pub pose: S::Pose,
    /// Its share of the belief, in (0, 1].
    pub weight: f32,
}

/// The answers of a belief, heaviest first; at most [`MODES`], the others' weight left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Modes<S: Space> {
    modes: [Mode<S>; MODES],
    count: usize,
}

/// How far apart two poses are before they are two answers: translation (metres) and rotation
/// (radians), added in squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Metres.
    pub translation: f32,
    /// Radians.
    pub rotation: f32,
}

impl Separation {
    /// 10 mm, or 20°: what the thesis' motion noise calls one deviation.
    pub const DEFAULT: Self = Separation { translation: 0.01, rotation: 0.349_065_85 };

    /// The distance between two poses, 1 at the separation.
    pub fn between<S: Space>(&self, a: &S::Pose, b: &S::Pose) -> f32 {
        let apart = a.local(b);
        let (mut shift, mut turn) = (0.0, 0.0);
        for i in 0..S::FREEDOM {
            let squared = apart[i] * apart[i];
            if i < S::DIMENSION { shift += squared } else { turn += squared }
        }
        let (t, r) = (self.translation, self.rotation);
        math::sqrt(shift / (t * t) + turn / (r * r))
    }
}

impl<S: Space> Modes<S> {
    /// No answer.
    pub const NONE: Self =
        Modes { modes: [Mode { pose: S::Pose::UNSET, weight: 0.0 }; MODES], count: 0 };

    /// The only answer.
    pub fn one(pose: S::Pose) -> Self {
        let mut modes = Self::NONE;
        modes.modes[0] = Mode { pose, weight: 1.0 };
        modes.count = 1;
        modes
    }

    /// The answers in a set of weighted poses: the heaviest pose takes all within `separation` of it,
    /// the heaviest of the rest the next, [`MODES`] times; O(`MODES` × poses). Weights need not sum
    /// to one; what is not above zero is ignored.
    pub fn of(
        poses: impl Iterator<Item = (f32, S::Pose)> + Clone,
        separation: &Separation,
    ) -> Self {
        let mut found = Self::NONE;
        let mut total = 0.0;
        for (weight, _) in poses.clone() {
            if weight > 0.0 {
                total += weight;
            }
        }
        if !(total > 0.0 && total.is_finite()) {
            return found;
        }
        for _ in 0..MODES {
            let mut heaviest: Option<(f32, S::Pose)> = None;
            for (weight, pose) in poses.clone() {
                let free = !found.as_slice().iter().any(|m| near::<S>(&m.pose, &pose, separation));
                if weight > 0.0 && free && heaviest.is_none_or(|(most, _)| weight > most) {
                    heaviest = Some((weight, pose));
                }
            }
            let Some((_, seed)) = heaviest else { break };
            let mut weight = 0.0;
            for (w, pose) in poses.clone() {
                let taken = found.as_slice().iter().any(|m| near::<S>(&m.pose, &pose, separation));
                if w > 0.0 && !taken && near::<S>(&seed, &pose, separation) {
                    weight += w;
                }
            }
            found.push(Mode { pose: seed, weight: weight / total });
        }
        found.sort();
        found
    }

    /// Adds an answer, which must not be heavier than those before it; beyond [`MODES`] it is left
    /// out.
    pub fn push(&mut self, mode: Mode<S>) {
        if let Some(place) = self.modes.get_mut(self.count) {
            *place = mode;
            self.count += 1;
        }
    }

    /// The answers, heaviest first.
    pub fn as_slice(&self) -> &[Mode<S>] {
        self.modes.get(..self.count).unwrap_or(&[])
    }

    /// Whether a second answer has at least `share` of the belief.
    pub fn disagree(&self, share: f32) -> bool {
        self.as_slice().get(1).is_some_and(|second| second.weight >= share)
    }

    /// Insertion sort: a handful of elements, and no heap.
    fn sort(&mut self) {
        for i in 1..self.count {
            let mut j = i;
            while j > 0 && self.modes[j].weight > self.modes[j - 1].weight {
                self.modes.swap(j, j - 1);
                j -= 1;
            }
        }
    }
}

fn near<S: Space>(a: &S::Pose, b: &S::Pose, separation: &Separation) -> bool {
    separation.between::<S>(a, b) < 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::{Planar, PlanarPose};

    fn at(x: f32, angle: f32) -> PlanarPose {
        PlanarPose::new(Vector([x, 0.0]), angle)
    }

    #[test]
    fn two_heaps_are_two_answers_heaviest_first() {
        let poses = [(0.5, at(0.0, 0.0)), (0.3, at(0.004, 0.0)), (1.2, at(0.0, 1.0))];
        let modes = Modes::<Planar>::of(poses.iter().copied(), &Separation::DEFAULT);
        let [first, second] = modes.as_slice() else { panic!("{modes:?}") };
        assert_eq!((first.pose, second.pose), (at(0.0, 1.0), at(0.0, 0.0)));
        assert!((first.weight - 0.6).abs() < 1e-6 && (second.weight - 0.4).abs() < 1e-6);
        assert!(modes.disagree(0.39) && !modes.disagree(0.41));
    }

    #[test]
    fn what_has_no_weight_has_no_answer() {
        let poses = [(0.0, at(0.0, 0.0)), (f32::NAN, at(0.1, 0.0)), (-1.0, at(0.2, 0.0))];
        assert_eq!(Modes::<Planar>::of(poses.into_iter(), &Separation::DEFAULT), Modes::NONE);
        assert!(Modes::<Planar>::NONE.as_slice().is_empty());
        assert!(!Modes::<Planar>::one(at(0.0, 0.0)).disagree(0.0));
    }

    #[test]
    fn more_answers_than_room_keep_the_heaviest() {
        let poses = (0..8).map(|i| (1.0 + i as f32, at(0.1 * i as f32, 0.0)));
        let modes = Modes::<Planar>::of(poses, &Separation::DEFAULT);
        let weights: std::vec::Vec<f32> = modes.as_slice().iter().map(|m| m.weight).collect();
        assert_eq!(weights, [8.0 / 36.0, 7.0 / 36.0, 6.0 / 36.0, 5.0 / 36.0]);
    }
}
