//! Another's word for where the object is and what it looks like: a host that has thought all grasps
//! over knows better than a tracker that goes forward only.

use super::chart::{Chart, across};
use super::plane::{Plane, Record};
use super::{Hypotheses, Settings};
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};

/// Least deviations of a face that is told: metres, and radians. None is known without doubt.
const LEAST: [f32; 2] = [1e-5, 1e-4];

/// A face as it is told, object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToldFace<S: Space> {
    /// Unit, out of the object.
    pub normal: S::Vector,
    /// A point on it, near the middle of its contacts, metres.
    pub centre: S::Vector,
    /// Standard deviation along the normal there, metres.
    pub deviation: f32,
    /// Standard deviation of the normal, radians per axis.
    pub tilt: f32,
    /// Contacts that speak for it.
    pub contacts: u16,
}

/// Why a tracker does not take another's word. It believes what it did before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disbelief {
    /// A number is not finite, a normal not a direction, a deviation below zero or a covariance none.
    Number,
    /// There is no room for another face.
    Full,
}

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    /// Puts one hypothesis in the place of all others: the object at `pose`, in whatever object frame
    /// the teller uses, with this covariance (tangent coordinates), and no faces yet. Earlier grasps
    /// are not recalled any more.
    ///
    /// # Errors
    /// With numbers that are not finite, or a covariance that is not positive semidefinite.
    pub fn believe(&mut self, pose: &S::Pose, covariance: &S::Covariance) -> Result<(), Disbelief> {
        if !(pose.is_finite() && semidefinite::<S>(covariance)) {
            return Err(Disbelief::Number);
        }
        if !self.configured {
            self.configure(Settings::DEFAULT);
        }
        let slot = if self.count == 0 { 0 } else { self.order[0] };
        (self.order[0], self.count) = (slot, 1);
        let best = &mut self.slots[usize::from(slot)];
        best.place(*pose);
        for i in 0..S::FREEDOM {
            for j in 0..=i {
                best.joint.set(i, j, covariance.at(i, j));
            }
        }
        self.started = true;
        self.lost = 0;
        self.reach = math::max(self.reach, 0.01);
        self.forgotten = self.grasps;
        Ok(())
    }

    /// Adds a face to what [`believe`](Self::believe) began: independent of the pose and of the other
    /// faces.
    ///
    /// # Errors
    /// Without room, before any belief and any grasp, or with numbers that cannot be used.
    pub fn learn(&mut self, face: &ToldFace<S>) -> Result<(), Disbelief> {
        let positive = |v: f32| v >= 0.0 && v.is_finite();
        let direction = face.normal.normalized().filter(|n| (*n - face.normal).norm() < 0.01);
        let (Some(normal), true) =
            (direction, face.centre.is_finite() && positive(face.deviation) && positive(face.tilt))
        else {
            return Err(Disbelief::Number);
        };
        if self.count == 0 {
            return Err(Disbelief::Number);
        }
        let best = &mut self.slots[usize::from(self.order[0])];
        if best.faces >= FACES {
            return Err(Disbelief::Full);
        }
        let deviation = math::max(face.deviation, LEAST[0]);
        let tilt = math::max(face.tilt, LEAST[1]);
        let axes = across::<S>(normal);
        // ρ = n·c: a turn about the centre moves it.
        let mut row = [0.0f32; ROWS];
        let mut own = deviation * deviation;
        let before = best.joint.rows();
        for (k, axis) in axes.iter().enumerate().take(S::DIMENSION - 1) {
            best.joint.append(&[0.0; ROWS], tilt * tilt);
            let lever = axis.dot(face.centre);
            row[before + k] = tilt * tilt * lever;
            own += tilt * tilt * lever * lever;
        }
        best.joint.append(&row, own);
        best.planes[best.faces] = Plane { normal, offset: normal.dot(face.centre) };
        let mut record = Record::NONE;
        record.touch(face.centre);
        record.contacts = face.contacts.max(1);
        record.judge(false);
        best.records[best.faces] = record;
        best.faces += 1;
        self.reach = math::max(self.reach, 1.5 * face.centre.norm());
        Ok(())
    }
}

/// Whether a covariance is finite and, but for rounding, positive semidefinite.
fn semidefinite<S: Space>(covariance: &S::Covariance) -> bool {
    let mut l = [[0.0f32; 6]; 6];
    for i in 0..S::FREEDOM {
        for j in 0..=i {
            let mut sum = covariance.at(i, j);
            if !sum.is_finite() {
                return false;
            }
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            let slack = 1e-3 * covariance.at(i, i).abs();
            if i == j {
                if sum < -slack {
                    return false;
                }
                l[i][i] = math::sqrt(math::max(sum, 0.0));
            } else if l[j][j] > 0.0 {
                l[i][j] = sum / l[j][j];
            } else if sum.abs()
                > 1e-3 * math::sqrt(covariance.at(i, i).abs() * covariance.at(j, j).abs())
            {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::{Contact, GraspView};
    use crate::matrix::{Matrix, Vector};
    use crate::space::{Planar, PlanarPose};
    use crate::surface::cholesky::packed;
    use crate::track::{Status, Tracker};

    type Tested = Hypotheses<Planar, 4, 5, 13, { packed(13) }, 4>;

    /// The sides of a rectangle of 100 × 60 mm.
    const SIDES: [([f32; 2], f32); 4] =
        [([1.0, 0.0], 0.05), ([0.0, 1.0], 0.03), ([-1.0, 0.0], 0.05), ([0.0, -1.0], 0.03)];

    fn told((normal, offset): ([f32; 2], f32)) -> ToldFace<Planar> {
        let normal = Vector(normal);
        ToldFace { normal, centre: normal * offset, deviation: 2e-4, tilt: 0.01, contacts: 9 }
    }

    fn touch(pose: &PlanarPose) -> std::vec::Vec<Contact<Planar>> {
        let one = |((x, y), offset): ((f32, f32), f32)| Contact {
            point: pose.transform(Vector([x * offset - y * 0.01, y * offset + x * 0.01])),
            normal: Some(pose.rotate(Vector([x, y]))),
            point_deviation: 1e-3,
            normal_deviation: 0.09,
            finger: 0,
        };
        SIDES.map(|([x, y], offset)| one(((x, y), offset))).into()
    }

    fn taught(pose: &PlanarPose) -> Tested {
        let mut tracker = Tested::new();
        tracker
            .believe(pose, &Matrix([[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-4]]))
            .unwrap();
        for side in SIDES {
            tracker.learn(&told(side)).unwrap();
        }
        tracker
    }

    #[test]
    fn what_is_told_is_believed_and_used() {
        let pose = PlanarPose::new(Vector([0.1, -0.05]), 0.4);
        let mut tracker = taught(&pose);
        let faces: std::vec::Vec<_> = tracker.faces().collect();
        assert_eq!(faces.len(), 4);
        for (face, side) in faces.iter().zip(SIDES) {
            let told = told(side);
            assert!((face.offset - side.1).abs() < 1e-6 && face.contacts == 9);
            assert!((math::sqrt(face.variance) - told.deviation).abs() < 1e-6);
            assert!((math::sqrt(face.normal_variance) - told.tilt).abs() < 1e-6);
        }
        // The next grasp is sought on these faces: a slip of 6 mm and 8° is found.
        let moved = PlanarPose::new(Vector([0.105, -0.053]), 0.54);
        let felt = touch(&moved);
        let estimate = tracker.update(None, GraspView { contacts: &felt, free: &[] });
        assert_eq!(estimate.status, Status::Tracking);
        assert!((estimate.pose.translation - moved.translation).norm() < 1e-3, "{estimate:?}");
        assert!((estimate.pose.angle() - 0.54).abs() < 0.02);
        assert_eq!(tracker.faces().count(), 4);
        assert!(tracker.recall(0).is_some() && estimate.grasp == 0);
    }

    #[test]
    fn a_belief_replaces_what_was_believed() {
        let mut tracker = Tested::new();
        let felt = touch(&PlanarPose::IDENTITY);
        let first = tracker.update(None, GraspView { contacts: &felt, free: &[] });
        tracker.update(None, GraspView { contacts: &felt, free: &[] });
        assert_eq!((first.grasp, tracker.faces().count()), (0, 4));
        assert!(tracker.recall(0).is_some());
        let pose = PlanarPose::new(Vector([0.3, 0.0]), 0.0);
        tracker.believe(&pose, &Matrix([[0.0; 3]; 3])).unwrap();
        assert_eq!((tracker.faces().count(), tracker.hypotheses().count()), (0, 1));
        assert_eq!(tracker.hypotheses().next().map(|h| h.1), Some(pose));
        assert_eq!(tracker.recall(0), None);
        let third = tracker.update(None, GraspView { contacts: &felt, free: &[] });
        assert_eq!(third.grasp, 2);
        assert!(tracker.recall(1).is_none() && tracker.recall(2).is_some());
    }

    #[test]
    fn nonsense_is_not_believed() {
        let pose = PlanarPose::IDENTITY;
        let mut tracker = taught(&pose);
        let before: std::vec::Vec<_> = tracker.faces().collect();
        let fine = Matrix([[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-4]]);
        for entry in [f32::NAN, f32::INFINITY, -1e-6, 1e-3] {
            let mut bad = fine;
            (bad.0[0][1], bad.0[1][0]) = (entry, entry);
            if entry == -1e-6 {
                bad = fine;
                bad.0[1][1] = entry;
            }
            assert_eq!(tracker.believe(&pose, &bad), Err(Disbelief::Number), "{entry}");
        }
        let nowhere = PlanarPose::new(Vector([f32::NAN, 0.0]), 0.0);
        assert_eq!(tracker.believe(&nowhere, &fine), Err(Disbelief::Number));
        let good = told(SIDES[0]);
        for bad in [
            ToldFace { normal: Vector([0.0, 0.0]), ..good },
            ToldFace { normal: Vector([2.0, 0.0]), ..good },
            ToldFace { centre: Vector([0.0, f32::INFINITY]), ..good },
            ToldFace { deviation: -1.0, ..good },
            ToldFace { tilt: f32::NAN, ..good },
        ] {
            assert_eq!(tracker.learn(&bad), Err(Disbelief::Number));
        }
        assert_eq!(before, tracker.faces().collect::<std::vec::Vec<_>>());
        assert_eq!(tracker.learn(&good), Ok(()));
        assert_eq!(tracker.learn(&good), Err(Disbelief::Full));
        assert_eq!(Tested::new().learn(&good), Err(Disbelief::Number));
    }
}
