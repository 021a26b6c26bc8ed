//! Which directions of a pose a set of contacts can see (thesis 3.3.2, as corrected: eigenvectors
//! carry the directions, points are centred and rotation is scaled by the radius of the grasp, so
//! that translation and rotation are comparable; Gelfand et al. 2003).

use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::Space;

/// Eigen-decomposition of the information that contacts with normals give about a displacement.
///
/// Directions are tangents in the axes the points were given in, about [`centre`](Self::centre),
/// with rotations multiplied by [`radius`](Self::radius): all in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observability<S: Space> {
    /// Mean of HᵀH over the contacts: ascending eigenvalues, each in [0, 2]. Zero means that the
    /// displacement slides along every face that is touched.
    pub eigenvalues: S::Tangent,
    /// Eigenvectors as columns, in the order of the eigenvalues.
    pub directions: S::Covariance,
    /// Centroid of the contacts, metres.
    pub centre: S::Vector,
    /// Root mean square distance of the contacts to the centroid, metres (at least 10 µm).
    pub radius: f32,
}

/// Least radius, metres: contacts closer together are told apart by rounding.
const LEAST_RADIUS: f32 = 1e-5;

impl<S: Space> Observability<S> {
    /// Eigenvalues below this count as unobservable: what one contact in five gives when its normal
    /// is 72° off the direction.
    pub const THRESHOLD: f32 = 0.02;

    /// Nothing was touched: no direction is seen.
    pub const NONE: Self = Observability {
        eigenvalues: S::Tangent::ZERO,
        directions: S::Covariance::IDENTITY,
        centre: S::Vector::ZERO,
        radius: LEAST_RADIUS,
    };

    /// The observability of contacts given as (point, unit normal), in any one frame.
    pub fn of(contacts: impl Iterator<Item = (S::Vector, S::Vector)> + Clone) -> Self {
        let mut count = 0.0;
        let mut centre = S::Vector::ZERO;
        for (point, _) in contacts.clone() {
            centre += point;
            count += 1.0;
        }
        if count == 0.0 {
            return Self::NONE;
        }
        centre = centre * (1.0 / count);
        let mut spread = 0.0;
        for (point, _) in contacts.clone() {
            spread += (point - centre).norm_squared();
        }
        let radius = math::sqrt(spread / count).max(LEAST_RADIUS);
        let mut information = S::Covariance::ZERO;
        for (point, normal) in contacts {
            let mut h = S::lever(point - centre, normal);
            for i in S::DIMENSION..S::FREEDOM {
                h[i] *= 1.0 / radius;
            }
            information.add_outer(1.0 / count, h, h);
        }
        let (eigenvalues, directions) = information.symmetric_eigen();
        Observability { eigenvalues, directions, centre, radius }
    }

    /// Number of directions whose eigenvalue is above [`Self::THRESHOLD`].
    pub fn rank(&self) -> usize {
        (0..S::FREEDOM).filter(|&i| self.eigenvalues[i] > Self::THRESHOLD).count()
    }

    /// Whether every direction of the pose is seen.
    pub fn is_full(&self) -> bool {
        self.rank() == S::FREEDOM
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::{Planar, Spatial};

    #[test]
    fn two_parallel_faces_do_not_see_the_slide() {
        // Figure 3.6: contacts above and below a long rectangle; x is free.
        let contacts =
            [(-0.04, 0.03, 1.0), (0.05, 0.03, 1.0), (0.01, -0.03, -1.0), (-0.02, -0.03, -1.0)]
                .map(|(x, y, n)| (Vector([x, y]), Vector([0.0, n])));
        let seen = Observability::<Planar>::of(contacts.iter().copied());
        assert_eq!(seen.rank(), 2);
        assert!(seen.eigenvalues[0] < 1e-6);
        assert!(seen.directions.0[0][0].abs() > 0.999);
    }

    #[test]
    fn a_sphere_hides_its_three_rotations() {
        let contacts: std::vec::Vec<_> = (0..40)
            .map(|i| {
                let (s, c) = (0.9 * i as f32).sin_cos();
                let z = (i as f32 / 20.0) - 0.975;
                let r = (1.0 - z * z).sqrt();
                let n = Vector([r * c, r * s, z]);
                (n * 0.05 + Vector([0.3, 0.1, -0.2]), n)
            })
            .collect();
        let seen = Observability::<Spatial>::of(contacts.iter().copied());
        assert_eq!(seen.rank(), 3);
        // Rotations are the blind ones: translations have no part in the first three.
        for k in 0..3 {
            let t: f32 = (0..3).map(|i| seen.directions.0[i][k].powi(2)).sum();
            assert!(t < 0.05, "{t}");
        }
    }

    #[test]
    fn scale_does_not_matter() {
        let at = |s: f32| {
            let c = [
                (0.0, 1.0, 0.0, 1.0),
                (1.0, 0.2, 1.0, 0.0),
                (-1.0, -0.3, -1.0, 0.0),
                (0.5, -1.0, 0.0, -1.0),
            ]
            .map(|(x, y, a, b)| (Vector([x * s, y * s]), Vector([a, b])));
            Observability::<Planar>::of(c.iter().copied()).eigenvalues
        };
        assert!((at(0.03) - at(3.0)).norm() < 1e-5);
        assert!((at(0.03) - at(1e-4)).norm() < 1e-5);
    }

    #[test]
    fn nothing_touched_sees_nothing() {
        assert_eq!(Observability::<Planar>::of(core::iter::empty()).rank(), 0);
    }
}
