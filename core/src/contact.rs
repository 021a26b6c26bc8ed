//! What a hand feels: contacts, fingertips that touched nothing, and a grasp of both.

use core::ops::RangeInclusive;

use heapless::Vec;

use crate::matrix::Coordinates;
use crate::space::{Pose, Space};

/// One fingertip on the surface, in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact<S: Space> {
    /// Where, metres.
    pub point: S::Vector,
    /// Unit normal out of the object, where the sensor gives one.
    pub normal: Option<S::Vector>,
    /// Standard deviation of the point along the normal, metres.
    pub point_deviation: f32,
    /// Standard deviation of the normal's direction, radians per axis.
    pub normal_deviation: f32,
    /// Which finger felt it.
    pub finger: u8,
}

/// Why a contact cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContactError {
    /// A coordinate of the point is NaN, or the point farther away than 1000 km.
    Point,
    /// The normal is not finite, or its length is not within 10⁻³ of one.
    Normal,
    /// A standard deviation is not between 10⁻⁹ and 10⁶.
    Deviation,
}

impl core::fmt::Display for ContactError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            ContactError::Point => "the point must be within 1000 km",
            ContactError::Normal => "the normal must have length 1 within 0.001",
            ContactError::Deviation => "standard deviations must be between 1e-9 and 1e6",
        })
    }
}

impl core::error::Error for ContactError {}

/// Farthest that a contact may be from the origin, metres.
const FARTHEST: f32 = 1e6;

/// Least and greatest standard deviation, metres and radians: variances, their reciprocals, and these times
/// squares of the farthest are numbers that `f32` has.
pub(crate) const DEVIATIONS: RangeInclusive<f32> = 1e-9..=1e6;

impl<S: Space> Contact<S> {
    /// The contact with its normal scaled to exactly one.
    ///
    /// # Errors
    /// When a number is not finite, the point farther away than 1000 km, the normal off unit length by more
    /// than 10⁻³, or a standard deviation (metres or radians) not between 10⁻⁹ and 10⁶.
    pub fn checked(mut self) -> Result<Self, ContactError> {
        // Squares of what is farther away would be infinite.
        if !(self.point.norm() <= FARTHEST) {
            return Err(ContactError::Point);
        }
        if let Some(n) = self.normal {
            if !((n.norm() - 1.0).abs() <= 1e-3) {
                return Err(ContactError::Normal);
            }
            self.normal = n.normalized();
        }
        let usable = |d: f32| DEVIATIONS.contains(&d);
        if !usable(self.point_deviation) || !usable(self.normal_deviation) {
            return Err(ContactError::Deviation);
        }
        Ok(self)
    }
}

/// A fingertip that closed on nothing: the object is not at `point` (world frame, metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreePoint<S: Space> {
    /// Where, metres.
    pub point: S::Vector,
    /// Which finger.
    pub finger: u8,
}

/// Everything felt in one closing of the hand, at most `CAPACITY` contacts and as many free points.
#[derive(Clone, Debug, PartialEq)]
pub struct Grasp<S: Space, const CAPACITY: usize> {
    /// What was felt.
    pub contacts: Vec<Contact<S>, CAPACITY>,
    /// What was not.
    pub free: Vec<FreePoint<S>, CAPACITY>,
}

impl<S: Space, const CAPACITY: usize> Grasp<S, CAPACITY> {
    /// A grasp that felt nothing.
    pub const fn new() -> Self {
        Grasp { contacts: Vec::new(), free: Vec::new() }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.contacts.clear();
        self.free.clear();
    }

    /// The grasp as slices, as [`crate::track::Tracker::update`] takes it.
    pub fn view(&self) -> GraspView<'_, S> {
        GraspView { contacts: &self.contacts, free: &self.free }
    }
}

impl<S: Space, const CAPACITY: usize> Default for Grasp<S, CAPACITY> {
    fn default() -> Self {
        Self::new()
    }
}

/// A grasp of any size, borrowed.
#[derive(Clone, Copy, Debug)]
pub struct GraspView<'a, S: Space> {
    /// What was felt.
    pub contacts: &'a [Contact<S>],
    /// What was not.
    pub free: &'a [FreePoint<S>],
}

impl<'a, S: Space> GraspView<'a, S> {
    /// The contacts that can be used ([`Contact::checked`]), with unit normals.
    pub fn usable(&self) -> impl Iterator<Item = Contact<S>> + Clone + use<'a, S> {
        self.contacts.iter().filter_map(|contact| contact.checked().ok())
    }

    /// The mean of the usable contacts' places; `None` without any.
    #[inline(never)]
    pub fn centroid(&self) -> Option<S::Vector> {
        let (mut sum, mut count) = (S::Vector::ZERO, 0.0);
        for contact in self.usable() {
            sum += contact.point;
            count += 1.0;
        }
        (count > 0.0).then(|| sum * (1.0 / count))
    }

    /// Points and normals of the usable contacts that have one, in the frame of an object at `pose`.
    pub fn felt_from(
        &self,
        pose: &S::Pose,
    ) -> impl Iterator<Item = (S::Vector, S::Vector)> + Clone + use<'a, S> {
        let pose = *pose;
        let placed =
            move |c: Contact<S>| Some((pose.untransform(c.point), pose.unrotate(c.normal?)));
        self.usable().filter_map(placed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::Planar;

    #[test]
    fn deviations_whose_squares_are_no_numbers_are_refused() {
        let of = |point_deviation, normal_deviation| {
            let contact = Contact::<Planar> {
                point: Vector([0.03, 0.0]),
                normal: Some(Vector([1.0, 0.0])),
                point_deviation,
                normal_deviation,
                finger: 0,
            };
            contact.checked().map(|_| ())
        };
        for usable in [1e-9, 1e-3, 1e6] {
            assert_eq!((of(usable, 0.09), of(1e-3, usable)), (Ok(()), Ok(())));
        }
        for unusable in [-1e-3, 0.0, 1e-20, 1e-10, 1e7, 1e20, f32::INFINITY, f32::NAN] {
            let refused = Err(ContactError::Deviation);
            assert_eq!((of(unusable, 0.09), of(1e-3, unusable)), (refused, refused));
        }
    }
}
