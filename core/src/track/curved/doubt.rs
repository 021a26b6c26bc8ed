//! How far each contact is trusted: what the others say of it, and what disbelief costs.

use super::memory::Touch;
use super::trajectory::PARTS;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::cholesky::{Cholesky, packed};
use crate::surface::{Bend, Revisable};
use crate::track::likelihood::FREEDOM;

/// Contacts trusted more than this are trusted fully: Student's t of contacts that fit would blunt them.
const FITS: f32 = 0.5;

/// Largest factor on the variance of a contact's noise.
const WILDEST: f32 = 1e4;

/// What a hypothesis holds of one contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Belief<S: Space> {
    /// The surface there.
    pub bend: Bend<S>,
    /// Factors on the variance of point and normal, 1 for a contact that fits.
    pub scale: [f32; 2],
    /// Student's weight, 1 for a contact that fits.
    pub trust: f32,
}

impl<S: Space> Belief<S> {
    pub const UNSET: Self = Belief {
        bend: Bend { gradient: S::Vector::ZERO, curvature: [S::Vector::ZERO; 3] },
        scale: [0.0; 2],
        trust: 0.0,
    };

    pub fn new(bend: Bend<S>) -> Self {
        Belief { bend, scale: [1.0; 2], trust: 1.0 }
    }

    /// What the doubt costs: the log density of Student's t against that of the normal distribution of
    /// the noise that the contact is given, whose constants hardly depend on the number of rows.
    pub fn price(&self) -> f32 {
        const CONSTANT: f32 = 0.3;
        if self.trust < 1.0 {
            0.5 * FREEDOM * (math::ln(self.trust) - self.trust + 1.0) - CONSTANT
        } else {
            0.0
        }
    }
}

/// The residual of a contact's rows given all others follows from the inverse covariance
/// (Rasmussen & Williams 2006, 5.12).
pub(super) fn doubt_one<S: Space, M: Revisable<S>>(
    map: &M,
    touch: &Touch<S>,
    first: usize,
    count: usize,
    belief: &mut Belief<S>,
    workspace: &mut [f32],
) {
    let Some(precision) = map.precision::<PARTS>(first, count, workspace) else { return };
    let Some(weights) = map.weights().get(first..first + count) else { return };
    let mut inverse = [[0.0; PARTS]; PARTS];
    let mut residual = [0.0; PARTS];
    let mut factor = Cholesky::<PARTS, { packed(PARTS) }>::new();
    for row in &precision[..count] {
        let staged = factor.stage(0);
        let n = staged.len();
        staged.copy_from_slice(&row[..n]);
        if factor.append().is_err() {
            return;
        }
    }
    for axis in 0..count {
        inverse[axis][axis] = 1.0;
        factor.forward(&mut inverse[axis]);
        factor.backward(&mut inverse[axis]);
        residual[axis] = inverse[axis].iter().zip(weights).map(|(a, b)| a * b).sum();
    }
    // As if the contact had its usual noise.
    let usual = |part: usize| {
        let deviation = if part == 0 { touch.point_deviation } else { touch.normal_deviation };
        deviation * deviation
    };
    let mut spread = Cholesky::<PARTS, { packed(PARTS) }>::new();
    for (part, row) in inverse[..count].iter().enumerate() {
        let staged = spread.stage(0);
        let n = staged.len();
        staged.copy_from_slice(&row[..n]);
        staged[part] -= (belief.scale[part.min(1)] - 1.0) * usual(part);
        staged[part] = math::max(staged[part], usual(part));
        if spread.append().is_err() {
            return;
        }
    }
    let mut whitened = residual;
    spread.forward(&mut whitened);
    let squared: f32 = whitened[..count].iter().map(|v| v * v).sum();
    let trust = (FREEDOM + count as f32) / (FREEDOM + squared);
    let trust = if trust > FITS { 1.0 } else { trust };
    let excess = 1.0 / trust - 1.0;
    let mut scale = [1.0f32; 2];
    for part in 0..count {
        let expected = inverse[part][part] - (belief.scale[part.min(1)] - 1.0) * usual(part);
        let more = 1.0 + excess * math::max(expected, usual(part)) / usual(part);
        let kind = part.min(1);
        scale[kind] = math::max(scale[kind], math::min(more, WILDEST));
    }
    (belief.trust, belief.scale) = (trust, scale);
}

/// The touch with its noise as the hypothesis believes it.
pub(super) fn scaled<S: Space>(touch: &Touch<S>, belief: &Belief<S>) -> Touch<S> {
    Touch {
        point_deviation: touch.point_deviation * math::sqrt(belief.scale[0]),
        normal_deviation: touch.normal_deviation * math::sqrt(belief.scale[1]),
        ..*touch
    }
}
