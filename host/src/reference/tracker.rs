//! Algorithm 3.1 from end to end: grasps in, poses and a growing surface out.

use super::filter::{Filter, Settings};
use super::gpis::Error;
use super::{Contact, Gpis, Kernel, Prior, Training};
use crate::space::{Point, Pose};
use nalgebra::{DMatrix, DVector};

/// Filter and surface together. The first grasp fixes the object frame: its origin at the centroid
/// of the contacts, its axes along the world's.
#[derive(Clone, Debug)]
pub struct Tracker {
    settings: Settings,
    kernel: Kernel,
    training: Training,
    /// Object frame.
    contacts: Vec<Contact>,
    belief: Option<(Filter, Gpis)>,
}

/// What is believed after a grasp.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Object to world.
    pub pose: Pose,
    /// In tangent coordinates at `pose`: object axes, metres before radians.
    pub covariance: DMatrix<f64>,
    /// Effective number of particles, before resampling.
    pub effective: f64,
    /// Whether the contacts corrected the pose: not on the first grasp, without contacts, or when
    /// no particle explains them; the pose is then the prediction.
    pub corrected: bool,
}

impl Tracker {
    /// A tracker that has touched nothing.
    pub fn new(settings: Settings, kernel: Kernel, training: Training) -> Self {
        Tracker { settings, kernel, training, contacts: Vec::new(), belief: None }
    }

    /// The surface so far, object frame; `None` before the first contact.
    pub fn surface(&self) -> Option<&Gpis> {
        self.belief.as_ref().map(|(_, surface)| surface)
    }

    /// The contacts learnt so far, object frame.
    pub fn contacts(&self) -> &[Contact] {
        &self.contacts
    }

    /// One grasp in the world frame, after the object moved by `motion` (world to world; `None`
    /// when that is unknown). `None` before anything was touched.
    ///
    /// # Errors
    /// When the surface cannot be fitted to the contacts; the tracker is then as it was, but for
    /// having predicted and weighed.
    pub fn update(
        &mut self,
        motion: Option<&Pose>,
        contacts: &[Contact],
    ) -> Result<Option<Step>, Error> {
        let (filter, corrected) = match &mut self.belief {
            None if contacts.is_empty() => return Ok(None),
            None => {
                let sum: Point = contacts.iter().map(|c| c.point).sum();
                let centroid = sum / contacts.len() as f64;
                let start = Pose::from_parts(centroid.into(), nalgebra::UnitQuaternion::identity());
                (Filter::new(self.settings, start), false)
            }
            Some((filter, surface)) => {
                filter.predict(motion);
                let corrected = !contacts.is_empty() && filter.weigh(surface, contacts);
                (filter.clone(), corrected)
            }
        };
        let (pose, covariance) = filter.mean();
        let step = Step { pose, covariance, effective: filter.effective(), corrected };

        let mut learnt = self.contacts.clone();
        let dimension = self.settings.dimension;
        let place = |c| placed(dimension, c, &step.pose, &step.covariance);
        learnt.extend(contacts.iter().map(place));
        let prior = Prior::fitted(&learnt).unwrap_or(Prior::Constant(0.0));
        let surface = Gpis::fit(dimension, self.kernel, prior, self.training, &learnt)?;
        self.contacts = learnt;
        let (filter, _) = self.belief.insert((filter, surface));
        filter.resample();
        Ok(Some(step))
    }
}

/// A contact of the world in the object frame at an uncertain `pose`, its noise increased by that
/// doubt: along the normal (in all directions alike without one) for the point, of the rotation for
/// the normal. `covariance` is in tangent coordinates at the pose.
pub fn placed(
    dimension: usize,
    contact: &Contact,
    pose: &Pose,
    covariance: &DMatrix<f64>,
) -> Contact {
    let c = contact.transformed(&pose.inverse());
    let along = |n: &Point| {
        let turn = c.point.cross(n);
        let lever = if dimension == 2 {
            DVector::from_column_slice(&[n.x, n.y, turn.z])
        } else {
            DVector::from_column_slice(&[n.x, n.y, n.z, turn.x, turn.y, turn.z])
        };
        (lever.transpose() * covariance * lever)[0]
    };
    let doubt = match &c.normal {
        Some(n) => along(n),
        None => {
            let axes = [Point::x(), Point::y(), Point::z()];
            axes[..dimension].iter().map(along).sum::<f64>() / dimension as f64
        }
    };
    let turns = covariance.diagonal();
    let turns = turns.rows_range(dimension..);
    Contact {
        point_deviation: (c.point_deviation.powi(2) + doubt).sqrt(),
        normal_deviation: (c.normal_deviation.powi(2) + turns.mean()).sqrt(),
        ..c
    }
}

#[cfg(test)]
mod tests {
    use super::super::filter::{local, retract};
    use super::*;
    use crate::shape::Field;
    use crate::space::planar;

    const KERNEL: Kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.1 };
    const SETTINGS: Settings = Settings {
        dimension: 2,
        particles: 1500,
        translation: 0.004,
        rotation: 0.08,
        gate: None,
        seed: 1,
    };

    /// A contact on a 120 × 60 mm ellipse about the object's origin.
    fn touch(angle: f64) -> Contact {
        let (sin, cos) = angle.sin_cos();
        Contact {
            point: Point::new(0.06 * cos, 0.03 * sin, 0.0),
            normal: Some(Point::new(cos / 0.06, sin / 0.03, 0.0).normalize()),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    }

    #[test]
    fn follows_an_ellipse_and_learns_it() {
        let mut tracker = Tracker::new(SETTINGS, KERNEL, Training::Derivative);
        let mut truth = planar(0.3, 0.1, 0.7);
        // What the tracker cannot know: where the object's own frame lies in that of the ellipse.
        let mut frame = None;
        for grasp in 0..10 {
            let motion = planar(0.01, -0.005, 0.3);
            if grasp > 0 {
                // The object moves by a little more than the hand meant, to either side.
                let sign = if grasp % 2 == 0 { 1.0 } else { -1.0 };
                let extra = vec![0.004 * sign, -0.003, 0.06 * sign];
                truth = retract(2, &(motion * truth), &extra.into());
            }
            let felt: Vec<Contact> = (0..5)
                .map(|k| touch(f64::from(grasp) * 0.35 + f64::from(k) * 1.2).transformed(&truth))
                .collect();
            let step = tracker.update(Some(&motion), &felt).unwrap().unwrap();
            assert_eq!(step.corrected, grasp > 0);
            let frame = *frame.get_or_insert_with(|| truth.inverse() * step.pose);
            let off = local(2, &(truth * frame), &step.pose);
            assert!(off.rows(0, 2).norm() < 4e-3 && off[2].abs() < 0.08, "{grasp}: {off}");
        }
        assert_eq!(tracker.contacts().len(), 50);
        let surface = tracker.surface().unwrap();
        let frame: Pose = frame.unwrap();
        for i in 0..60 {
            let on = touch(f64::from(i) * 0.105).transformed(&frame.inverse());
            let f = surface.values(&[on.point])[0];
            assert!(f.abs() < 4e-3, "{i}: {f}");
        }
    }

    #[test]
    fn nothing_felt_only_predicts() {
        let mut tracker = Tracker::new(SETTINGS, KERNEL, Training::Derivative);
        assert_eq!(tracker.update(None, &[]), Ok(None));
        let first: Vec<Contact> = (0..5).map(|k| touch(f64::from(k))).collect();
        let start = tracker.update(None, &first).unwrap().unwrap();
        assert_eq!(start.covariance, DMatrix::zeros(3, 3));
        let motion = planar(0.02, 0.0, 0.0);
        let step = tracker.update(Some(&motion), &[]).unwrap().unwrap();
        assert!(!step.corrected && step.effective > 1499.0);
        assert!(local(2, &(motion * start.pose), &step.pose).norm() < 0.02);
        assert_eq!(tracker.contacts().len(), 5);
        // Felt while in doubt: the contact counts less.
        let moved: Vec<Contact> = first.iter().map(|c| c.transformed(&motion)).collect();
        let unsure = tracker.update(None, &moved).unwrap().unwrap();
        assert!(unsure.corrected);
        let last = tracker.contacts().last().unwrap();
        assert!(last.point_deviation > 1.02e-3 && last.normal_deviation > 0.0873);
    }

    #[test]
    fn a_surface_that_cannot_be_fitted_is_refused() {
        let mut tracker = Tracker::new(
            SETTINGS,
            Kernel::ThinPlate { amplitude: 0.05, range: 0.01 },
            Training::Derivative,
        );
        let error = tracker.update(None, &[touch(0.0), touch(3.0)]).unwrap_err();
        assert!(matches!(error, Error::Range { .. }));
        assert!(tracker.surface().is_none() && tracker.contacts().is_empty());
    }
}
