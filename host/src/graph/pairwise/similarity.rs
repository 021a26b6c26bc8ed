//! Which grasps felt the same parts of the object (thesis 3.3.3.1).

use nalgebra::{Matrix3, SymmetricEigen};

use super::registration::Pair;
use crate::reference::Contact;
use crate::space::Point;

/// Faces that two grasps must share (thesis 3.3.3.1).
const FACES: usize = 3;

/// Least eigenvalue of the mean of n nᵀ over the shared faces: below it a translation is hardly seen.
const SEEN: f64 = 0.03;

/// The contacts of a grasp that have normals, in the grasp's own frame, and the faces they lie on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Touched {
    /// Grasp frame.
    pub contacts: Vec<Contact>,
    /// Of each contact; `None` where it lies on no face.
    pub faces: Vec<Option<usize>>,
}

impl Touched {
    /// The faces, each once, ascending, with the mean normal of the contacts on it.
    pub fn felt(&self) -> Vec<(usize, Point)> {
        let mut faces: Vec<usize> = self.faces.iter().flatten().copied().collect();
        faces.sort_unstable();
        faces.dedup();
        let mean = |face: usize| {
            let sum: Point = self.on(face).filter_map(|c| c.normal).sum();
            Some((face, sum.try_normalize(1e-6)?))
        };
        faces.into_iter().filter_map(mean).collect()
    }

    /// The contacts on a face.
    pub fn on(&self, face: usize) -> impl Iterator<Item = &Contact> {
        let own =
            move |(c, f): (&'_ Contact, &Option<usize>)| *f == Some(face) && c.normal.is_some();
        self.contacts.iter().zip(&self.faces).filter(move |(c, f)| own((c, f))).map(|(c, _)| c)
    }
}

/// Two grasps that felt the same faces.
#[derive(Clone, Debug, PartialEq)]
pub struct Similar {
    /// Positions of the two grasps, ascending.
    pub grasps: [usize; 2],
    /// The faces that both felt, ascending.
    pub faces: Vec<usize>,
}

/// All pairs of grasps that share at least three faces which determine a relative pose.
pub fn similar(dimension: usize, grasps: &[Touched]) -> Vec<Similar> {
    let felt: Vec<Vec<(usize, Point)>> = grasps.iter().map(Touched::felt).collect();
    let mut found = Vec::new();
    for (i, a) in felt.iter().enumerate() {
        for (j, b) in felt.iter().enumerate().skip(i + 1) {
            let shared: Vec<&(usize, Point)> =
                a.iter().filter(|(face, _)| b.iter().any(|(other, _)| other == face)).collect();
            let normals: Vec<Point> = shared.iter().map(|(_, normal)| *normal).collect();
            if observable(dimension, &normals) {
                let faces = shared.iter().map(|(face, _)| *face).collect();
                found.push(Similar { grasps: [i, j], faces });
            }
        }
    }
    found
}

/// Whether faces with these normals determine a pose: three of them, and no translation along all
/// (thesis 3.18, whose rotations the normals themselves show).
pub fn observable(dimension: usize, normals: &[Point]) -> bool {
    if normals.len() < FACES {
        return false;
    }
    let mut mean = Matrix3::zeros();
    for n in normals {
        mean += n * n.transpose() / normals.len() as f64;
    }
    if dimension == 2 {
        // z is no direction.
        mean[(2, 2)] = 1.0;
    }
    mean.iter().all(|v| v.is_finite()) && SymmetricEigen::new(mean).eigenvalues.min() > SEEN
}

/// All pairs of contacts on matched faces, `from` in the one grasp and `to` in the other. Of k and l
/// contacts on a face, k l pairs count as the k l/(k + l) · 2 that two means would.
pub fn pairs(from: &Touched, to: &Touched, matched: &[[usize; 2]]) -> Vec<Pair> {
    let mut found = Vec::new();
    for [a, b] in matched {
        let count = from.on(*a).count() + to.on(*b).count();
        for p in from.on(*a) {
            for q in to.on(*b) {
                found.push(Pair { from: *p, to: *q, weight: 2.0 / count as f64 });
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn touched(list: &[(usize, [f64; 3])]) -> Touched {
        let contact = |(_, n): &(usize, [f64; 3])| Contact {
            point: Point::from(*n) * 0.03,
            normal: Some(Point::from(*n).normalize()),
            point_deviation: 1e-3,
            normal_deviation: 0.09,
        };
        Touched {
            contacts: list.iter().map(contact).collect(),
            faces: list.iter().map(|(face, _)| Some(*face)).collect(),
        }
    }

    const X: [f64; 3] = [1.0, 0.0, 0.0];
    const Y: [f64; 3] = [0.0, 1.0, 0.0];
    const Z: [f64; 3] = [0.0, 0.0, 1.0];
    const W: [f64; 3] = [-1.0, 0.0, 0.0];

    #[test]
    fn grasps_are_similar_that_share_three_faces() {
        let grasps = [
            touched(&[(0, X), (1, Y), (2, W), (1, Y)]),
            touched(&[(2, W), (0, X), (5, Z)]),
            touched(&[(1, Y), (0, X), (2, W), (7, Z)]),
            Touched::default(),
        ];
        let found = similar(2, &grasps);
        assert_eq!(found, [Similar { grasps: [0, 2], faces: vec![0, 1, 2] }]);
        // In space the same three leave z open.
        assert!(similar(3, &grasps).is_empty());
        assert!(observable(3, &[X, Y, Z].map(Point::from)));
        // Three faces of one direction and its opposite leave a translation open.
        assert!(!observable(2, &[X, W, X].map(Point::from)));
        assert!(!observable(2, &[X, Y].map(Point::from)));
        assert!(!observable(2, &[X, Y, [f64::NAN; 3]].map(Point::from)));
    }

    #[test]
    fn faces_that_felt_more_count_as_their_means() {
        let a = touched(&[(0, X), (0, X), (1, Y)]);
        let b = touched(&[(4, X), (4, X), (3, Y), (9, Z)]);
        let found = pairs(&a, &b, &[[0, 4], [1, 3]]);
        assert_eq!(found.len(), 5);
        let total: f64 = found.iter().map(|p| p.weight).sum();
        assert!((total - 3.0).abs() < 1e-12);
        // A contact without a normal is in no pair.
        let mut bare = a.clone();
        bare.contacts[2].normal = None;
        assert_eq!(pairs(&bare, &b, &[[0, 4], [1, 3]]).len(), 4);
        assert_eq!(bare.felt().len(), 1);
    }
}
