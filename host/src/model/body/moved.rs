//! A body where contacts moved it.
//!
//! The process takes parts to change with their parameters to first order, from where they were
//! fitted: an edge stays where it was however far contacts turn the planes that meet there. So the
//! parts are put where they went, and orders are taken again there (the iterated update of Bell and
//! Cathey, IEEE Transactions on Automatic Control 38, 1993).

use std::iter::repeat;

use nalgebra::{Matrix3, SymmetricEigen};

use super::{Body, Change, Mode, Part, Plane, Quadric};
use crate::reference::mean::Local;
use crate::space::Point;

/// Difference of a mode, in its deviations, for its slope.
const NUDGE: f64 = 1e-5;

/// Least eigenvalue of a quadric's form over its greatest that is one: a hyperboloid has no inside. A
/// cylinder's that was zero is the square of the turn below, and taken for zero again.
const HOLLOW: f64 = -0.1;

impl Mode {
    /// Whether it is of planes and quadrics.
    fn is_movable(&self) -> bool {
        self.changes.iter().all(|change| matches!(change.more, Part::Plane(_) | Part::Quadric(_)))
    }
}

impl Body {
    /// The same body with its planes and quadrics where the modes are `by` of their deviations from
    /// what was believed ([`Gpis::shifts`](crate::reference::Gpis::shifts); zero where there are too few
    /// numbers); planes turn about the point `about`, metres. What is believed stays as it was: to first order the mean
    /// is what it had been. `None` where a part cannot be there, and where there is none to move.
    pub fn moved(&self, by: &[f64], about: &Point) -> Option<Body> {
        if !self.modes.iter().any(Mode::is_movable) {
            return None;
        }
        let steps = self.steps(by);
        let parts = (0..self.parts.len()).map(|part| self.placed(part, &steps, about));
        let change_of = |index: usize, part: usize| {
            let nudged = |nudge: f64| {
                let mut steps = steps.clone();
                steps[index] += nudge;
                self.placed(part, &steps, about)
            };
            let (more, less) = (nudged(NUDGE)?, nudged(-NUDGE)?);
            Some(Change { part, more, less })
        };
        let mode = |(index, mode): (usize, &Mode)| {
            if !mode.is_movable() {
                return Some(mode.clone());
            }
            let changes = mode.changes.iter().map(|change| change_of(index, change.part));
            Some(Mode {
                changes: changes.collect::<Option<_>>()?,
                scale: (2.0 * NUDGE).recip(),
                moved: mode.moved + steps[index],
            })
        };
        Some(Body {
            parts: parts.collect::<Option<_>>()?,
            modes: self.modes.iter().enumerate().map(mode).collect::<Option<_>>()?,
            ..self.clone()
        })
    }

    /// How far from where it was moved to some part is, at most, where the modes are `by` of their deviations from
    /// what was believed; zero for a body that was not moved. To first order a part that strayed cuts others where
    /// it is not.
    pub fn strayed(&self, by: &[f64]) -> f64 {
        if self.modes.iter().all(|mode| mode.moved == 0.0) {
            return 0.0;
        }
        self.steps(by).into_iter().fold(0.0, |most, step| step.abs().max(most))
    }

    /// From where the modes are to `by`; zero for those that do not move.
    fn steps(&self, by: &[f64]) -> Vec<f64> {
        let ways = self.modes.iter().zip(by.iter().chain(repeat(&0.0)));
        ways.map(|(mode, to)| if mode.is_movable() { to - mode.moved } else { 0.0 }).collect()
    }

    /// A part after so many deviations of each mode.
    fn placed(&self, part: usize, steps: &[f64], about: &Point) -> Option<Part> {
        let changes = self.modes.iter().zip(steps).filter_map(|(mode, step)| {
            mode.of_part(part).map(|change| (change.more, change.less, mode.scale * step))
        });
        match self.parts[part] {
            Part::Plane(plane) => {
                let depth = |plane: &Plane| plane.offset - plane.normal.dot(about);
                let (mut normal, mut deep) = (plane.normal, depth(&plane));
                for change in changes {
                    let (Part::Plane(more), Part::Plane(less), times) = change else { continue };
                    normal += (more.normal - less.normal) * times;
                    deep += (depth(&more) - depth(&less)) * times;
                }
                let normal = normal.try_normalize(f64::EPSILON)?;
                let offset = deep + normal.dot(about);
                offset.is_finite().then_some(Part::Plane(Plane { normal, offset }))
            }
            Part::Quadric(quadric) => {
                let Quadric { mut centre, mut form, mut taper, .. } = quadric;
                for change in changes {
                    let (Part::Quadric(more), Part::Quadric(less), times) = change else {
                        continue;
                    };
                    centre += (more.centre - less.centre) * times;
                    form += (more.form - less.form) * times;
                    taper += (more.taper - less.taper) * times;
                }
                let eigen = SymmetricEigen::new(form);
                let (least, greatest) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
                if !(least > HOLLOW * greatest) {
                    return None;
                }
                // The nearest form that is none of a hyperboloid (Higham 1988).
                let flat = eigen.eigenvalues.map(|value| value.max(0.0));
                let form = eigen.eigenvectors
                    * Matrix3::from_diagonal(&flat)
                    * eigen.eigenvectors.transpose();
                Some(Part::Quadric(Quadric::tapered(centre, form, taper)?))
            }
            other => Some(other),
        }
    }

    /// What moving a part has changed of its field at `p`, to first order: the process adds it again.
    pub(super) fn displacement(&self, part: usize, p: &Point) -> Local {
        let moved = self.modes_of(part, p).zip(self.modes.iter().map(|mode| mode.moved));
        let nothing = (0.0, Point::zeros());
        moved.fold(nothing, |sum, (local, by)| (sum.0 + local.0 * by, sum.1 + local.1 * by))
    }
}
