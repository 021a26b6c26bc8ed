//! What a truncated body is known to be at several points together.

use super::Truncated;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Joint, Kernel};

impl<
    S: Space,
    K: Kernel,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
> Truncated<S, K, SITES, ROWS, PACKED, FACES>
{
    /// The face whose value is the maximum at a point; `None` where it is the body's.
    pub(super) fn owner(&self, point: S::Vector) -> Option<usize> {
        let [mut most] = self.body.values(&[point]);
        let mut owner = None;
        for (number, face) in self.faces.cutting() {
            let value = face.value(point);
            if value > most {
                (most, owner) = (value, Some(number));
            }
        }
        owner
    }

    /// Covariance of a face's value at two points.
    pub(super) fn along(&self, number: usize, a: S::Vector, b: S::Vector) -> f32 {
        let Some(face) = self.faces.faces().get(number) else { return 0.0 };
        let open = |point| self.open(self.faces.beyond(number, point));
        let like = self.kernel.value((a - b).norm_squared());
        face.joint(a, b) + math::sqrt(open(a) * open(b)) * like
    }
}

impl<
    S: Space,
    K: Kernel,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
> Joint<S> for Truncated<S, K, SITES, ROWS, PACKED, FACES>
{
    fn values<const L: usize>(&self, points: &[S::Vector; L]) -> [f32; L] {
        let mut values = self.body.values(points);
        for (value, point) in values.iter_mut().zip(points) {
            for face in self.cuts() {
                *value = math::max(face.value(*point), *value);
            }
        }
        values
    }

    /// Each point is the body's or a face's, as in [`Surface::probe`](crate::surface::Surface::probe).
    /// Different ones are independent; what a face does not know beyond its contacts is alike at points
    /// near each other, as it is of the body.
    fn joint<const N: usize>(&self, points: &[S::Vector]) -> [[f32; N]; N] {
        let mut covariance = self.body.joint(points);
        let mut owners = [None; N];
        for (owner, point) in owners.iter_mut().zip(points) {
            *owner = self.owner(*point);
        }
        for i in 0..points.len().min(N) {
            for j in 0..=i {
                let shared = match (owners[i], owners[j]) {
                    (None, None) => continue,
                    (Some(a), Some(b)) if a == b => self.along(a, points[i], points[j]),
                    _ => 0.0,
                };
                (covariance[i][j], covariance[j][i]) = (shared, shared);
            }
        }
        covariance
    }

    /// The body's contacts, and of each face those farthest apart.
    fn touched(&self) -> impl Iterator<Item = S::Vector> + Clone + '_ {
        self.body.touched().chain(self.faces.ends())
    }
}
