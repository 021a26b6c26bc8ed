//! The faces of the best answer, as others see them.

use super::Hypotheses;
use super::chart::{Chart, across};
use super::joint::Sparse;
use crate::matrix::Coordinates;
use crate::space::Space;

/// A face of the best hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face<S: Space> {
    /// Unit, out of the object (object frame).
    pub normal: S::Vector,
    /// ρ of the plane n·p = ρ, metres.
    pub offset: f32,
    /// Mean of the contacts on it, metres.
    pub centre: S::Vector,
    /// Variance of the height of the plane there, square metres.
    pub variance: f32,
    /// Variance of the normal, radians² per axis.
    pub normal_variance: f32,
    /// Contacts on it.
    pub contacts: u16,
    /// Whether contacts lay beyond it: the object is concave there.
    pub reentrant: bool,
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
    /// The faces of the best hypothesis, in the order they were first touched.
    pub fn faces(&self) -> impl Iterator<Item = Face<S>> + '_ {
        self.best().into_iter().flat_map(|best| {
            (0..best.faces).map(|face| {
                let (plane, record) = (&best.planes[face], &best.records[face]);
                let first = S::FREEDOM + S::DIMENSION * face;
                let axes = across::<S>(plane.normal);
                let last = S::DIMENSION - 1;
                let mut height = S::Vector::ZERO;
                let mut normal_variance = 0.0;
                for k in 0..last {
                    height[k] = axes[k].dot(record.centre);
                    normal_variance += best.joint.at(first + k, first + k) / last as f32;
                }
                height[last] = -1.0;
                Face {
                    normal: plane.normal,
                    offset: plane.offset,
                    centre: record.centre,
                    variance: best.joint.variance(Sparse([(first, height.as_slice()), (0, &[])])),
                    normal_variance,
                    contacts: record.contacts,
                    reentrant: record.is_reentrant(),
                }
            })
        })
    }
}
