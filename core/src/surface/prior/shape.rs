//! Any shape whose signed distance is known as prior mean.

use super::Prior;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Face, Surface};

/// A signed distance: what a shape offers to be a [`Shape`] prior. Plain parameters implement it
/// themselves; so do `fn` pointers, and `&'static` references to any [`Surface`].
pub trait SignedDistance<S: Space>: Copy + Send + Sync + 'static {
    /// Signed distance (metres, positive outside) and its gradient at `point` (object frame,
    /// metres). Beside the surface it may be any finite function of the same sign.
    fn distance(&self, point: S::Vector) -> (f32, S::Vector);
}

impl<S: Space> SignedDistance<S> for fn(S::Vector) -> (f32, S::Vector) {
    #[inline(always)]
    fn distance(&self, point: S::Vector) -> (f32, S::Vector) {
        self(point)
    }
}

impl<S: Space, T: Surface<S> + Sync> SignedDistance<S> for &'static T {
    #[inline]
    fn distance(&self, point: S::Vector) -> (f32, S::Vector) {
        let probe = self.probe(point);
        (probe.value, probe.gradient)
    }
}

/// A known shape as prior mean, as it is: contacts do not move it. The mean is zero while it is
/// unset.
///
/// ```
/// use tactile_core::matrix::{Coordinates, Vector};
/// use tactile_core::space::Spatial;
/// use tactile_core::surface::{Prior, Shape, SignedDistance};
///
/// /// A capsule along z.
/// #[derive(Clone, Copy)]
/// struct Capsule {
///     half_length: f32,
///     radius: f32,
/// }
///
/// impl SignedDistance<Spatial> for Capsule {
///     fn distance(&self, p: Vector<3>) -> (f32, Vector<3>) {
///         let z = p[2].clamp(-self.half_length, self.half_length);
///         let d = p - Vector([0.0, 0.0, z]);
///         (d.norm() - self.radius, d.normalized().unwrap_or(Vector::ZERO))
///     }
/// }
///
/// let bottle = Shape::of(Capsule { half_length: 0.1, radius: 0.03 });
/// let (value, slope) = bottle.mean(Vector([0.0, 0.04, 0.05]));
/// assert!((value - 0.01).abs() < 1e-6 && slope == Vector([0.0, 1.0, 0.0]));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape<D>(Option<D>);

impl<D> Shape<D> {
    /// `shape` as prior.
    pub const fn of(shape: D) -> Self {
        Shape(Some(shape))
    }
}

impl<S: Space, D: SignedDistance<S>> Prior<S> for Shape<D> {
    const UNSET: Self = Shape(None);

    #[inline(always)]
    fn mean(&self, point: S::Vector) -> (f32, S::Vector) {
        match &self.0 {
            Some(shape) => shape.distance(point),
            None => (0.0, S::Vector::ZERO),
        }
    }

    fn fitted(
        &self,
        _contacts: impl Iterator<Item = (S::Vector, Option<S::Vector>)> + Clone,
    ) -> Self {
        *self
    }
}

/// A convex polytope, maxⱼ (nⱼ·p − ρⱼ), of at most `FACES` planes: fitted faces, frozen, so that a
/// Gaussian process learns what they leave over. Without planes it is zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Polytope<S: Space, const FACES: usize> {
    planes: [(S::Vector, f32); FACES],
    count: usize,
}

impl<S: Space, const FACES: usize> Polytope<S, FACES> {
    /// The first `FACES` of these faces.
    pub fn of(faces: &[Face<S>]) -> Self {
        let mut polytope = Polytope { planes: [(S::Vector::ZERO, 0.0); FACES], count: 0 };
        for (plane, face) in polytope.planes.iter_mut().zip(faces) {
            *plane = (face.normal, face.offset);
            polytope.count += 1;
        }
        polytope
    }
}

impl<S: Space, const FACES: usize> SignedDistance<S> for Polytope<S, FACES> {
    /// Exact inside and beside a face, a lower bound beside edges and corners.
    fn distance(&self, point: S::Vector) -> (f32, S::Vector) {
        let mut most: Option<(f32, S::Vector)> = None;
        for (normal, offset) in self.planes.iter().take(self.count) {
            let value = normal.dot(point) - offset;
            if most.is_none_or(|(m, _)| value > m) {
                most = Some((value, *normal));
            }
        }
        most.unwrap_or((0.0, S::Vector::ZERO))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::Contact;
    use crate::matrix::Vector;
    use crate::space::Planar;
    use crate::surface::cholesky::packed;
    use crate::surface::{Faces, Gpis, Map, Matern32, Training};

    /// Two contacts on each side of a square of 40 mm.
    fn square() -> Faces<Planar, 8> {
        let mut square = Faces::<Planar, 8>::new();
        for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
            for along in [-0.01f32, 0.01] {
                square.insert(&Contact {
                    point: Vector([0.02 * x - along * y, 0.02 * y + along * x]),
                    normal: Some(Vector([x, y])),
                    point_deviation: 1e-3,
                    normal_deviation: 0.09,
                    finger: 0,
                });
            }
        }
        square
    }

    #[test]
    fn faces_as_prior_keep_their_corners_and_learn_a_dent() {
        let faces = square();
        let prior = Shape::of(Polytope::<Planar, 8>::of(faces.faces()));
        type Dented = Gpis<Planar, Matern32, Shape<Polytope<Planar, 8>>, 8, 24, { packed(24) }>;
        let mut surface = Dented::new();
        surface.configure(
            Matern32 { amplitude: 0.003, lengthscale: 0.01 },
            prior,
            Training::Normals,
        );
        // The right side is 3 mm in at its middle.
        surface.insert(&Contact {
            point: Vector([0.017, 0.0]),
            normal: Some(Vector([1.0, 0.0])),
            point_deviation: 1e-4,
            normal_deviation: 0.09,
            finger: 0,
        });
        surface.refit();
        assert_eq!(surface.prior(), prior);
        assert!(surface.probe(Vector([0.017, 0.0])).value.abs() < 1e-4);
        // The far corner is as sharp as ever.
        assert!(surface.probe(Vector([-0.0202, -0.0202])).value > 1e-4);
        assert!(surface.probe(Vector([-0.0198, -0.0198])).value < -1e-4);
    }

    #[test]
    fn surfaces_and_functions_are_shapes() {
        let faces: &'static Faces<Planar, 8> =
            std::boxed::Box::leak(std::boxed::Box::new(square()));
        let frozen = Polytope::<Planar, 8>::of(faces.faces());
        let of_faces = Shape::of(faces);
        fn line(p: Vector<2>) -> (f32, Vector<2>) {
            (p[1] - 0.01, Vector([0.0, 1.0]))
        }
        let of_line = Shape::of(line as fn(Vector<2>) -> (f32, Vector<2>));
        for p in [Vector([0.03, 0.01]), Vector([0.0, 0.0]), Vector([-0.01, -0.05])] {
            let (a, b) = (Prior::<Planar>::mean(&of_faces, p), frozen.distance(p));
            assert!((a.0 - b.0).abs() < 1e-7 && a.1 == b.1);
            assert_eq!(Prior::<Planar>::mean(&of_line, p), (p[1] - 0.01, Vector([0.0, 1.0])));
        }
        let none = Shape::<Polytope<Planar, 8>>::UNSET;
        assert_eq!(none.mean(Vector([1.0, 0.0])), (0.0, Vector::ZERO));
        assert_eq!(Polytope::<Planar, 2>::of(&[]).distance(Vector([1.0, 0.0])).0, 0.0);
        // Only as many planes as fit.
        assert_eq!(Polytope::<Planar, 2>::of(faces.faces()).count, 2);
    }
}
