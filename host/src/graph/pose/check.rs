//! What is asked of a graph before it is optimised.

use nalgebra::SMatrix;

use super::diagnosis::Kind;
use super::error::Error;
use super::{Edge, Group, PoseGraph};

impl<G: Group<D>, const D: usize> PoseGraph<G, D> {
    /// Whether the graph can be optimised: edges join different poses that exist, every number is
    /// finite, information is symmetric and positive semidefinite.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), Error> {
        self.check_indices()?;
        self.check_values()
    }

    pub(super) fn check_indices(&self) -> Result<(), Error> {
        let poses = self.poses.len();
        if self.ids.len() != poses {
            return Err(Error::Ids { ids: self.ids.len(), poses });
        }
        if let Some(&pose) = self.fixed.iter().find(|&&pose| pose >= poses) {
            return Err(Error::MissingFixed { pose, poses });
        }
        for (edge, Edge { from, to, .. }) in self.edges.iter().enumerate() {
            if let Some(&pose) = [from, to].into_iter().find(|&&pose| pose >= poses) {
                return Err(Error::MissingPose { edge, pose, poses });
            }
            if from == to {
                return Err(Error::Loop { edge, id: self.ids[*from] });
            }
        }
        Ok(())
    }

    pub(super) fn check_values(&self) -> Result<(), Error> {
        if let Some(pose) = self.poses.iter().position(|pose| !pose.is_finite()) {
            return Err(Error::PoseNotFinite { id: self.ids[pose] });
        }
        for (edge, e) in self.edges.iter().enumerate() {
            e.check(edge, self.ids[e.from], self.ids[e.to])?;
        }
        Ok(())
    }

    /// Which poses stay: those fixed, and the first of every connected part that has none.
    pub(super) fn held(&self) -> Vec<bool> {
        let mut part: Vec<usize> = (0..self.poses.len()).collect();
        fn root(part: &mut [usize], mut pose: usize) -> usize {
            while part[pose] != pose {
                part[pose] = part[part[pose]];
                pose = part[pose];
            }
            pose
        }
        for e in &self.edges {
            let (a, b) = (root(&mut part, e.from), root(&mut part, e.to));
            // The first pose of a part is its root.
            part[a.max(b)] = a.min(b);
        }
        let mut held = vec![false; self.poses.len()];
        let mut anchored = vec![false; self.poses.len()];
        for &pose in &self.fixed {
            held[pose] = true;
            anchored[root(&mut part, pose)] = true;
        }
        for pose in 0..held.len() {
            if part[pose] == pose && !anchored[pose] {
                held[pose] = true;
            }
        }
        held
    }
}

impl<G: Group<D>, const D: usize> Edge<G, D> {
    /// Whether its numbers can be optimised; it is the edge `edge`, and between poses of these ids.
    pub(super) fn check(&self, edge: usize, from: u64, to: u64) -> Result<(), Error> {
        if !(self.measured.is_finite() && self.information.iter().all(|x| x.is_finite())) {
            return Err(Error::EdgeNotFinite { edge, from, to });
        }
        information(&self.information).map_err(|problem| Error::Information {
            edge,
            from,
            to,
            problem,
        })
    }
}

/// Whether Ω is symmetric and positive semidefinite, to rounding: its own and that of files ([`Kind`]).
fn information<const D: usize>(omega: &SMatrix<f64, D, D>) -> Result<(), &'static str> {
    for i in 0..D {
        for j in 0..i {
            let own = omega[(i, i)].abs().sqrt() * omega[(j, j)].abs().sqrt();
            let scale = own.max(omega[(i, j)].abs()).max(omega[(j, i)].abs());
            if (omega[(i, j)] - omega[(j, i)]).abs() > 1e-9 * scale {
                return Err("not symmetric");
            }
        }
    }
    match Kind::of(omega) {
        Kind::Indefinite { .. } => Err("not positive semidefinite"),
        _ => Ok(()),
    }
}
