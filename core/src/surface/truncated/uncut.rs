//! What a body is before its contacts, where faces truncate it.

use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Ball, Prior};

/// How much larger than the contacts the ball about them is.
const MARGIN: f32 = 1.2;

/// The ball that fits the body's contacts, or a given one about all contacts, those on faces among
/// them: it cuts nothing off where faces say what there is, and ends the object where nothing does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncut<S: Space> {
    ball: Ball<S>,
    is_given: bool,
}

impl<S: Space> Uncut<S> {
    /// Fitted, and not fitted yet; all zero bits.
    pub const UNSET: Self =
        Uncut { ball: Ball { centre: S::Vector::ZERO, radius: 0.0 }, is_given: false };

    /// About contacts in a ball about `centre` with `radius`, metres.
    pub fn about(centre: S::Vector, radius: f32) -> Self {
        let radius = math::max(MARGIN * radius, Ball::<S>::LEAST_RADIUS);
        Uncut { ball: Ball { centre, radius }, is_given: true }
    }
}

impl<S: Space> Prior<S> for Uncut<S> {
    const UNSET: Self = Uncut::UNSET;

    #[inline(always)]
    fn mean(&self, point: S::Vector) -> (f32, S::Vector) {
        self.ball.mean(point)
    }

    fn curvature(&self, point: S::Vector) -> [S::Vector; 3] {
        self.ball.curvature(point)
    }

    fn interpolation(&self, spread: f32) -> (f32, f32) {
        self.ball.interpolation(spread)
    }

    fn fitted(
        &self,
        contacts: impl Iterator<Item = (S::Vector, Option<S::Vector>)> + Clone,
    ) -> Self {
        if self.is_given { *self } else { Uncut { ball: self.ball.fitted(contacts), ..*self } }
    }
}
