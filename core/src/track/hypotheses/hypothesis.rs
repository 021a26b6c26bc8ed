//! One answer: a Gaussian over the pose and the planes.

use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};

use super::chart::{Chart, across};
use super::joint::Joint;
use super::past::Past;
use super::plane::{Plane, Record};
use super::work::Work;

/// One joint hypothesis: pose, planes, their covariance, and where the object was before.
#[derive(Clone, Debug)]
pub(super) struct Hypothesis<
    S: Space,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> {
    pub pose: S::Pose,
    /// Logarithm, up to a constant that all hypotheses share.
    pub weight: f32,
    /// Rows: the pose's tangent, then each plane's coordinates.
    pub joint: Joint<ROWS, PACKED>,
    pub planes: [Plane<S>; FACES],
    pub records: [Record<S>; FACES],
    pub faces: usize,
    /// Earlier grasps, a ring.
    pub past: [Past<S>; GRASPS],
}

impl<S: Chart, const FACES: usize, const ROWS: usize, const PACKED: usize, const GRASPS: usize>
    Hypothesis<S, FACES, ROWS, PACKED, GRASPS>
{
    const ROWS_AGREE: () = assert!(
        ROWS == S::FREEDOM + S::DIMENSION * FACES && FACES < 64,
        "ROWS must be FREEDOM + DIMENSION·FACES, and FACES below 64"
    );

    /// All zero bits.
    pub const fn new() -> Self {
        let () = Self::ROWS_AGREE;
        Hypothesis {
            pose: S::Pose::UNSET,
            weight: 0.0,
            joint: Joint::new(),
            planes: [Plane::UNSET; FACES],
            records: [Record::NONE; FACES],
            faces: 0,
            past: [Past::UNSET; GRASPS],
        }
    }

    pub fn place(&mut self, pose: S::Pose) {
        self.pose = pose;
        self.weight = 0.0;
        self.joint.reset(S::FREEDOM);
        self.faces = 0;
    }

    /// Copies everything that is in use.
    pub fn copy_from(&mut self, other: &Self) {
        self.pose = other.pose;
        self.weight = other.weight;
        self.joint.copy_from(&other.joint);
        let n = other.faces;
        self.planes[..n].copy_from_slice(&other.planes[..n]);
        self.records[..n].copy_from_slice(&other.records[..n]);
        self.faces = n;
        self.past.copy_from_slice(&other.past);
    }

    pub fn forget_face(&mut self, face: usize) {
        if face >= self.faces {
            return;
        }
        self.joint.remove(S::FREEDOM + S::DIMENSION * face, S::DIMENSION);
        self.planes.copy_within(face + 1..self.faces, face);
        self.records.copy_within(face + 1..self.faces, face);
        self.faces -= 1;
    }

    /// Covariance of the pose in its tangent coordinates.
    pub fn pose_covariance(&self) -> S::Covariance {
        let mut out = S::Covariance::ZERO;
        for i in 0..S::FREEDOM {
            for j in 0..S::FREEDOM {
                *out.at_mut(i, j) = self.joint.at(i, j);
            }
        }
        out
    }

    /// Points known to be of the object, with the plane each lies on: the ends of what was touched of it.
    pub fn witnesses(&self) -> impl Iterator<Item = (usize, S::Vector)> + Clone + '_ {
        self.records[..self.faces].iter().enumerate().flat_map(|(j, r)| {
            [(j, r.ends[0]), (j, r.ends[1])].into_iter().take(if r.contacts > 1 { 2 } else { 1 })
        })
    }

    /// Whether contacts showed a concavity.
    pub fn is_concave(&self) -> bool {
        self.records[..self.faces].iter().any(Record::is_reentrant)
    }

    /// How much room is left for planes not yet touched, radians (steradians) × metres: over all
    /// directions from the middle, the gap between the planes and the points that were touched.
    /// Nothing lies further than `reach` (metres) from the middle.
    pub fn room(&self, reach: f32) -> f32 {
        const COUNT: usize = 32;
        if self.faces == 0 {
            return S::DIRECTIONS * reach;
        }
        let middle = self.middle();
        let mut sum = 0.0;
        for i in 0..COUNT {
            let direction = S::direction(i, COUNT);
            let mut outer = reach;
            for plane in &self.planes[..self.faces] {
                let slope = plane.normal.dot(direction);
                let height = -plane.height(middle);
                if height < outer * slope {
                    outer = math::max(height, 0.0) / slope;
                }
            }
            let mut inner = 0.0;
            for (_, point) in self.witnesses() {
                inner = math::max(inner, direction.dot(point - middle));
            }
            sum += math::max(outer - inner, 0.0);
        }
        sum * (S::DIRECTIONS / COUNT as f32)
    }

    /// The mean of the points that were touched, object frame; zero of none.
    #[inline(never)]
    pub fn middle(&self) -> S::Vector {
        let (mut sum, mut count) = (S::Vector::ZERO, 0.0);
        for (_, point) in self.witnesses() {
            sum += point;
            count += 1.0;
        }
        sum * (1.0 / math::max(count, 1.0))
    }

    /// Takes the belief of `work`, whose mean is relative to `self.pose` and to its planes.
    pub fn adopt(&mut self, work: &Work<S, FACES, ROWS, PACKED>) {
        let tangent = work.tangent();
        self.pose = self.pose.retract(tangent);
        self.joint.copy_from(&work.joint);
        let transport = S::transport(tangent);
        self.joint.transform(0, S::FREEDOM, |i, j| transport.at(i, j));
        for face in self.faces..work.faces {
            self.records[face] = Record::NONE;
        }
        self.faces = work.faces;
        for face in 0..self.faces {
            let first = S::FREEDOM + S::DIMENSION * face;
            let old = across::<S>(work.planes[face].normal);
            let plane = work.planes[face].displaced(&work.mean[first..first + S::DIMENSION]);
            let new = across::<S>(plane.normal);
            self.planes[face] = plane;
            self.joint.transform(first, S::DIMENSION - 1, |i, j| new[i].dot(old[j]));
        }
        self.joint.keep_variances();
    }
}
