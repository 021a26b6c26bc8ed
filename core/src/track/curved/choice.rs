//! Which trajectories stay: the best first, equal ones as one, without the improbable.

use super::Curved;
use super::memory::Touch;
use super::small::Definite;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::{Pose, Space};
use crate::surface::Revisable;
use crate::track::Separation;

/// Poses of a hypothesis that differ by less in every grasp make it a copy. So do earlier ones that move no
/// contact out of the surface by as much: they slide under the fingers, and make the same surface. The last
/// pose may differ by what is left open of it: two normal distributions that are no farther apart are one,
/// found twice. (On a cylinder, whose turns about its axis nobody feels, many are.)
const COPY: Separation = Separation { translation: 0.002, rotation: 0.035 };

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    /// Sorts and weighs, drops copies and the improbable.
    pub(super) fn choose(&mut self) {
        self.order();
        self.forget_copies();
        self.weigh();
    }

    /// Sorts and weighs, drops the improbable.
    pub(super) fn rank(&mut self) {
        self.order();
        self.weigh();
    }

    /// Best first: insertion sort of a handful.
    fn order(&mut self) {
        for i in 1..self.count {
            let mut j = i;
            while j > 0 && self.hypotheses[j].evidence > self.hypotheses[j - 1].evidence {
                exchange(&mut self.hypotheses, j - 1, j);
                j -= 1;
            }
        }
    }

    /// Of trajectories that are the same only the best stays.
    fn forget_copies(&mut self) {
        let grasps = self.memory.grasps().len();
        let mut kept = 0;
        for index in 0..self.count {
            let (before, rest) = self.hypotheses.split_at(index);
            let Some(this) = rest.first() else { break };
            let copy = before[..kept].iter().any(|other| {
                let Some(last) = grasps.checked_sub(1) else { return true };
                let mut poses = this.poses[..grasps].iter().zip(&other.poses).enumerate();
                poses.all(|(grasp, (a, b))| {
                    COPY.between::<S>(a, b) < 1.0
                        || if grasp == last {
                            is_within::<S>(a, b, &other.covariance)
                        } else {
                            self.memory.touches_in(grasp).iter().all(|t| slides(t, a, b))
                        }
                })
            });
            if !copy {
                exchange(&mut self.hypotheses, kept, index);
                kept += 1;
            }
        }
        self.count = kept;
    }

    /// Weights from evidence; the improbable go.
    fn weigh(&mut self) {
        let Some(best) = self.hypotheses[..self.count].first().map(|h| h.evidence) else { return };
        let limit = best - self.settings.prune;
        self.count =
            self.hypotheses[..self.count].iter().take_while(|h| h.evidence >= limit).count();
        let mut total = 0.0;
        for hypothesis in &mut self.hypotheses[..self.count] {
            hypothesis.weight = math::exp(hypothesis.evidence - best);
            total += hypothesis.weight;
        }
        for hypothesis in &mut self.hypotheses[..self.count] {
            hypothesis.weight *= 1.0 / total;
        }
    }
}

/// Whether a pose is no farther from another than its covariance leaves open: two deviations, within which
/// two normal distributions have one peak.
fn is_within<S: Space>(pose: &S::Pose, other: &S::Pose, covariance: &S::Covariance) -> bool {
    let apart = steady::<S>(other.local(pose));
    Definite::<S>::new(covariance)
        .is_some_and(|covariance| apart.dot(covariance.solve(apart)) < 4.0)
}

/// A displacement as what is done all the way to it (a twist, but for its length): where something turns about
/// an axis beside the origin, the origin goes along an arc, and sets out across its chord.
pub(super) fn steady<S: Space>(displacement: S::Tangent) -> S::Tangent {
    let mut half = S::Tangent::ZERO;
    for axis in S::DIMENSION..S::FREEDOM {
        half[axis] = 0.5 * displacement[axis];
    }
    let chord = S::Vector::from_fn(|axis| displacement[axis]);
    let shift = S::Pose::IDENTITY.retract(half).unrotate(chord);
    S::Tangent::from_fn(|axis| if axis < S::DIMENSION { shift[axis] } else { displacement[axis] })
}

/// Whether a touch only moves along the surface, by less than a quarter turn, where one pose takes the place of
/// another.
fn slides<S: Space>(touch: &Touch<S>, pose: &S::Pose, other: &S::Pose) -> bool {
    let (here, there) = (touch.seen_from(pose), touch.seen_from(other));
    let moved = here.point - there.point;
    let out = match (here.normal, there.normal) {
        // A chord of a round surface is square to what lies between the normals at its ends.
        (Some(a), Some(b)) if a.dot(b) > 0.0 => 0.5 * (a + b).dot(moved).abs(),
        (Some(_), Some(_)) => f32::INFINITY,
        _ => moved.norm(),
    };
    out < COPY.translation
}

/// Swaps two hypotheses of which `before` comes first, without a third on the stack.
fn exchange<H>(hypotheses: &mut [H], before: usize, after: usize) {
    if before < after && after < hypotheses.len() {
        let (head, tail) = hypotheses.split_at_mut(after);
        core::mem::swap(&mut head[before], &mut tail[0]);
    }
}
