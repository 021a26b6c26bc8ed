//! What the field is believed to be before any contact, as the Gaussian process needs it: any
//! signed distance will do (thesis 2.2.3).

use std::fmt;
use std::sync::Arc;

use super::gpis::Error;
use super::{Contact, Prior};
use crate::space::Point;

/// A field at one point: value (metres) and gradient.
pub type Local = (f64, Point);

/// Mean of the Gaussian process before data: positive outside, negative inside, scaled as a signed
/// distance in metres near the surface.
///
/// A mean that was fitted is not certain. Its [`modes`](Mean::modes) say how it would change: the
/// process takes it as m(p) + Σ zₖ φₖ(p) with independent standard normal zₖ (Rasmussen and
/// Williams 2006, section 2.7), so that contacts go on correcting it, its doubt is part of every
/// variance, and a mean with many parameters pays for them in the marginal likelihood.
pub trait Mean: fmt::Debug + Send + Sync {
    /// Value at `p`, metres.
    fn value(&self, p: &Point) -> f64;

    /// Gradient at `p`; where there is a crease, that of one of its sides.
    fn gradient(&self, p: &Point) -> Point;

    /// The gradient that the contact's normal is compared with. It differs from
    /// [`gradient`](Mean::gradient) near a crease: a contact whose point is known to a deviation
    /// may lie on either side, and its normal says on which.
    fn felt(&self, contact: &Contact) -> Point {
        self.gradient(&contact.point)
    }

    /// φₖ: the change of value and gradient at `p` per standard deviation of each parameter; as
    /// many at every point. None for a mean that is certain.
    fn modes(&self, _p: &Point) -> Vec<Local> {
        vec![]
    }

    /// The same for what a contact sees: the change of the value there and of
    /// [`felt`](Mean::felt).
    fn felt_modes(&self, contact: &Contact) -> Vec<Local> {
        self.modes(&contact.point)
    }

    /// Refuses parameters that are not usable.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the parameter and its value.
    fn check(&self) -> Result<(), Error> {
        Ok(())
    }
}

impl Mean for Prior {
    fn value(&self, p: &Point) -> f64 {
        Prior::value(self, p)
    }

    fn gradient(&self, p: &Point) -> Point {
        Prior::gradient(self, p)
    }

    fn check(&self) -> Result<(), Error> {
        Prior::check(self)
    }
}

impl From<Prior> for Arc<dyn Mean> {
    fn from(prior: Prior) -> Self {
        Arc::new(prior)
    }
}
