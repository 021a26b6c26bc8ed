//! A convex object as planes: n·p = ρ, each with covariance, fitted to all contacts at once.
//!
//! A contact (p, N) with deviations σ_p and σ_θ on the plane (n, ρ) costs
//! (n·p − ρ)²/σ_p² + |N − n|²/σ_θ², whose sum over a face depends on its contacts only through
//! additive moments about their centroid (`Moments`). So faces are found by merging: every
//! contact starts as its own face, and the two faces whose union costs least are merged while that
//! costs no more than noise would; contacts are then handed to the face that suits them best, and
//! merging is tried again. The prototype's greedy clustering (expectation–maximisation from contacts
//! in order of arrival) depends on that order; this does not, up to as many contacts as are merged at
//! once (`BATCH`): more are merged with what those before them made, as they arrive.
//!
//! Fingers also touch where faces meet, and feel any normal between theirs there: [`edges`] tells such
//! contacts from faces of their own. What people make has parallel and square faces: [`regular`] finds
//! out which of them are.

pub mod edges;
pub mod regular;

use nalgebra::{Matrix3, SymmetricEigen};

use crate::reference::Contact;
use crate::shape::Field;
use crate::space::{Point, across};

/// Cost above which two faces are not the same plane: χ² with 2 or 3 degrees of freedom exceeds it
/// once in ten thousand.
const GATE: [f64; 2] = [18.4, 21.1];

/// A face of one contact is confirmed where others that are parallel or square to it leave its normal
/// less than this share of the contact's own variance.
const CONFIRMED: f64 = 0.5;

/// Rounds of handing contacts over and merging; changes end after two or three.
const ROUNDS: usize = 6;

/// Contacts merged at once: the effort grows with the square.
const BATCH: usize = 120;

/// Deviations beyond which a contact shows a concavity: once in 30 000 by noise.
const CONCAVE: f64 = 4.0;

/// What a face keeps of its contacts, about their centroid so that nothing depends on the frame.
#[derive(Clone, Copy, Debug)]
struct Moments {
    count: usize,
    /// Σ 1/σ_p².
    weight: f64,
    /// Weighted mean of the points.
    centroid: Point,
    /// Σ (p − centroid)(p − centroid)ᵀ/σ_p².
    scatter: Matrix3<f64>,
    /// Σ N/σ_θ².
    normals: Point,
    /// Σ 1/σ_θ².
    normal_weight: f64,
}

impl Moments {
    fn of(contact: &Contact, normal: Point) -> Moments {
        let normal_weight = contact.normal_deviation.powi(-2);
        Moments {
            count: 1,
            weight: contact.point_deviation.powi(-2),
            centroid: contact.point,
            scatter: Matrix3::zeros(),
            normals: normal * normal_weight,
            normal_weight,
        }
    }

    /// Of a contact that only says where the surface is.
    fn bare(contact: &Contact) -> Moments {
        Moments {
            normals: Point::zeros(),
            normal_weight: 0.0,
            ..Moments::of(contact, Point::zeros())
        }
    }

    fn plus(&self, other: &Moments) -> Moments {
        let weight = self.weight + other.weight;
        let apart = other.centroid - self.centroid;
        Moments {
            count: self.count + other.count,
            weight,
            centroid: self.centroid + apart * (other.weight / weight),
            scatter: self.scatter
                + other.scatter
                + apart * apart.transpose() * (self.weight * other.weight / weight),
            normals: self.normals + other.normals,
            normal_weight: self.normal_weight + other.normal_weight,
        }
    }

    /// How far the contacts reach across the normal, up to a factor: a length in the plane, an area in space.
    fn reach(&self, normal: &Point, dimension: usize) -> f64 {
        let spread = self.scatter / self.weight;
        let [first, second] = across(dimension, normal);
        let [a, b, c] = [(first, first), (first, second), (second, second)]
            .map(|(one, other)| one.dot(&(spread * other)));
        if dimension == 2 { a.sqrt() } else { (a * c - b * b).max(0.0).sqrt() }
    }

    /// The normal of least cost, and that cost: the minimum of nᵀSn − 2b·n on the unit sphere is
    /// (S + λ)n = b with the λ above −(least eigenvalue of S) that makes |n| = 1.
    fn solve(&self) -> Option<(Point, f64)> {
        let eigen = SymmetricEigen::new(self.scatter);
        let b = eigen.eigenvectors.transpose() * self.normals;
        let length = b.norm();
        if !(length > 1e-9 * self.normal_weight) || !self.scatter.iter().all(|v| v.is_finite()) {
            return None;
        }
        // Axes along which the normals say nothing stay out of it (z in the plane).
        let touched = (0..3).filter(|i| b[*i].abs() > 1e-12 * length);
        let least = touched.map(|i| eigen.eigenvalues[i]).fold(f64::INFINITY, f64::min);
        let norm = |lambda: f64| {
            (0..3)
                .filter(|i| b[*i].abs() > 1e-12 * length)
                .map(|i| (b[i] / (eigen.eigenvalues[i] + lambda)).powi(2))
                .sum::<f64>()
        };
        let (mut low, mut high) = (-least, length - least);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if norm(middle) > 1.0 { low = middle } else { high = middle }
        }
        let mut u = Point::zeros();
        for i in 0..3 {
            if b[i].abs() > 1e-12 * length {
                u[i] = b[i] / (eigen.eigenvalues[i] + high);
            }
        }
        let normal = (eigen.eigenvectors * u).try_normalize(1e-12)?;
        let cost = normal.dot(&(self.scatter * normal))
            + 2.0 * (self.normal_weight - normal.dot(&self.normals));
        Some((normal, cost.max(0.0)))
    }
}

/// One plane.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// Unit, out of the object.
    pub normal: Point,
    /// ρ, metres.
    pub offset: f64,
    /// Weighted mean of its contacts, metres: there offset and normal are uncorrelated.
    pub centroid: Point,
    /// Variance of ρ at the centroid, square metres.
    pub offset_variance: f64,
    /// Covariance of the normal, radians²; zero along the normal itself.
    pub normal_covariance: Matrix3<f64>,
    /// How many contacts it was fitted to.
    pub contacts: usize,
}

impl Face {
    fn of(moments: &Moments, normal: Point, dimension: usize) -> Face {
        // Second derivatives of half the cost along the tangents, at the minimum: S + λ with
        // λ = n·(b − S n); a z that does not exist takes part in neither.
        let lambda = normal.dot(&(moments.normals - moments.scatter * normal));
        let tangent = Matrix3::identity() - normal * normal.transpose();
        let mut information = tangent * moments.scatter * tangent + tangent * lambda.max(0.0);
        if dimension == 2 {
            information[(2, 2)] = 0.0;
        }
        let eigen = SymmetricEigen::new(information);
        let mut normal_covariance = Matrix3::zeros();
        for (value, axis) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value > 1e-9 * information.trace() {
                normal_covariance += axis * axis.transpose() / *value;
            }
        }
        Face {
            normal,
            offset: normal.dot(&moments.centroid),
            centroid: moments.centroid,
            offset_variance: 1.0 / moments.weight,
            normal_covariance,
            contacts: moments.count,
        }
    }

    /// n·p − ρ, metres.
    pub fn value(&self, point: &Point) -> f64 {
        self.normal.dot(point) - self.offset
    }

    /// Variance of that, square metres.
    pub fn variance(&self, point: &Point) -> f64 {
        let arm = point - self.centroid;
        self.offset_variance + arm.dot(&(self.normal_covariance * arm))
    }

    fn cost(&self, contact: &Contact, normal: &Point) -> f64 {
        (self.value(&contact.point) / contact.point_deviation).powi(2)
            + (normal - self.normal).norm_squared() / contact.normal_deviation.powi(2)
    }
}

/// What explains a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// It lies on this face and has its normal.
    Face(usize),
    /// It lies on both faces, its normal anywhere between theirs.
    Edge([usize; 2]),
    /// It lies on three faces, its normal anywhere between theirs.
    Corner([usize; 3]),
}

impl Owner {
    /// The faces it lies on.
    pub fn faces(&self) -> &[usize] {
        match self {
            Owner::Face(face) => std::slice::from_ref(face),
            Owner::Edge(faces) => faces,
            Owner::Corner(faces) => faces,
        }
    }
}

/// The faces of an object.
#[derive(Clone, Debug)]
pub struct Faces {
    /// 2 or 3.
    pub dimension: usize,
    /// In no particular order; not empty.
    pub faces: Vec<Face>,
    /// What explains each contact that was given; `None` where it cannot be used, and without a normal,
    /// unless a face is all that it can lie on.
    pub owners: Vec<Option<Owner>>,
    /// Sum of the contacts' costs.
    pub chi_squared: f64,
    /// Measured numbers less fitted ones: the expectation of [`Faces::chi_squared`] on flat faces.
    pub degrees: f64,
    /// How much the normals turn with position within faces, in standard deviations: about N(0, 1)
    /// on flat faces, positive on convex curves, which χ² would take many more contacts to show.
    pub bending: f64,
    /// The worst contradiction to convexity in standard deviations: how far a contact lies outside a
    /// face that is not its own.
    pub protrusion: f64,
    /// Nats by which contacts speak for the relations that [`Faces::regular`] took to hold, against
    /// faces that lie anyhow; zero before.
    pub order: f64,
}

impl Faces {
    /// The faces that explain the contacts (object frame). Contacts without a normal are left out, and
    /// so are those that cannot be used ([`Contact::checked`]). `None` when none is left.
    pub fn fit(dimension: usize, contacts: &[Contact]) -> Option<Faces> {
        let checked = |c: &Contact| c.checked().and_then(|c| Some((c, c.normal?)));
        let felt: Vec<(Contact, Point)> = contacts.iter().filter_map(checked).collect();
        let gate = GATE[dimension.clamp(2, 3) - 2];
        let mut groups: Vec<Moments> = Vec::new();
        for batch in felt.chunks(BATCH) {
            groups.extend(batch.iter().map(|(c, n)| Moments::of(c, *n)));
            merge(&mut groups, gate, dimension);
        }
        let mut faces = solved(&groups, dimension);
        if faces.is_empty() {
            return None;
        }
        let mut owners: Vec<usize> = Vec::new();
        for _ in 0..ROUNDS {
            let before = std::mem::take(&mut owners);
            owners = felt.iter().map(|(c, n)| nearest(&faces, c, n)).collect::<Option<_>>()?;
            if owners == before {
                break;
            }
            groups = vec![];
            for face in 0..faces.len() {
                let own = felt.iter().zip(&owners).filter(|(_, o)| **o == face);
                groups.extend(
                    own.map(|((c, n), _)| Moments::of(c, *n)).reduce(|sum, m| sum.plus(&m)),
                );
            }
            merge(&mut groups, gate, dimension);
            faces = solved(&groups, dimension);
        }
        if faces.is_empty() {
            return None;
        }
        let owner = |c: &Contact| {
            let (contact, normal) = checked(c)?;
            Some(Owner::Face(nearest(&faces, &contact, &normal)?))
        };
        let owners = contacts.iter().map(owner).collect();
        Some(Faces::explaining(dimension, contacts, faces, owners))
    }

    /// Faces and what they explain, with the figures that follow from them.
    pub(crate) fn explaining(
        dimension: usize,
        contacts: &[Contact],
        faces: Vec<Face>,
        owners: Vec<Option<Owner>>,
    ) -> Faces {
        let own = |(contact, owner): (&Contact, &Option<Owner>)| Some((*contact, (*owner)?));
        let owned: Vec<(Contact, Owner)> = contacts.iter().zip(&owners).filter_map(own).collect();
        let chi_squared = owned.iter().map(|(c, o)| edges::cost(&faces, c, o)).sum();
        let measured: usize =
            owned.iter().map(|(c, _)| if c.normal.is_some() { dimension } else { 1 }).sum();
        // What nobody felt was fitted to no contact.
        let fitted = faces.iter().filter(|face| face.contacts > 0).count();
        let degrees = measured as f64 - (dimension * fitted) as f64;
        let felt: Vec<(Contact, Point, usize)> = owned
            .iter()
            .filter_map(|(c, owner)| match owner {
                Owner::Face(face) => Some((*c, c.normal?, *face)),
                _ => None,
            })
            .collect();
        let (bending, protrusion) = (bending(&felt, &faces), protrusion(&felt, &faces));
        Faces { dimension, faces, owners, chi_squared, degrees, bending, protrusion, order: 0.0 }
    }

    /// Whether no contact contradicts a convex object.
    pub fn is_convex(&self) -> bool {
        self.protrusion < CONCAVE
    }

    /// The faces that were felt by one of these `contacts` (those they were fitted to) and lie neither
    /// parallel nor square to others that say the same, by their numbers. On curves every contact makes
    /// its own.
    pub fn unconfirmed(&self, contacts: &[Contact]) -> Vec<usize> {
        let alone = |face: &usize| {
            let owned =
                |(_, owner): &(&Contact, &Option<Owner>)| **owner == Some(Owner::Face(*face));
            let mut own = contacts.iter().zip(&self.owners).filter(owned);
            let (Some((contact, _)), None) = (own.next(), own.next()) else { return false };
            let own = (self.dimension - 1) as f64 * contact.normal_deviation.powi(2);
            self.faces[*face].normal_covariance.trace() > CONFIRMED * own
        };
        (0..self.faces.len()).filter(alone).collect()
    }

    /// max (n·p − ρ) and the face that attains it; `None` without faces.
    pub fn active(&self, point: &Point) -> Option<(f64, &Face)> {
        self.faces.iter().map(|face| (face.value(point), face)).max_by(|a, b| a.0.total_cmp(&b.0))
    }
}

impl Field for Faces {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        points.iter().map(|p| self.active(p).map_or(f64::INFINITY, |(value, _)| value)).collect()
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        let deviation = |p| self.active(p).map_or(f64::INFINITY, |(_, f)| f.variance(p).sqrt());
        points.iter().map(deviation).collect()
    }
}

fn solved(groups: &[Moments], dimension: usize) -> Vec<Face> {
    groups.iter().filter_map(|m| Some(Face::of(m, m.solve()?.0, dimension))).collect()
}

fn nearest(faces: &[Face], contact: &Contact, normal: &Point) -> Option<usize> {
    let cost = |face: &Face| face.cost(contact, normal);
    (0..faces.len()).min_by(|a, b| cost(&faces[*a]).total_cmp(&cost(&faces[*b])))
}

/// What it costs to tell the contacts of two faces apart where they lie among each other, as χ² has it, and nothing
/// where they lie side by side: a contact may lie anywhere on a face, so that each is the less likely the farther its
/// face reaches, and the more likely the more of all contacts lie on it (the classification likelihood of Celeux and
/// Govaert, Computational Statistics and Data Analysis 14, 1992). Without it, faces of many contacts fall in two, those
/// that noise put farther in and farther out.
fn mixed(parts: &[Moments; 2], union: &Moments, normal: &Point, dimension: usize) -> f64 {
    let all = union.count as f64;
    let label = |m: &Moments| m.count as f64 * (m.count as f64 / all).ln();
    let place = |m: &Moments| m.count as f64 * m.reach(normal, dimension).ln();
    let labels: f64 = parts.iter().map(label).sum();
    let places = place(union) - parts.iter().map(place).sum::<f64>();
    // No more than all labels, where contacts on a line or at one place have no reach.
    (-2.0 * (labels + places)).max(0.0).min(-2.0 * labels)
}

/// Merges the pair whose union costs least while that is below `gate`.
fn merge(groups: &mut Vec<Moments>, gate: f64, dimension: usize) {
    groups.retain(|m| m.solve().is_some());
    let mut own: Vec<f64> = groups.iter().filter_map(|m| Some(m.solve()?.1)).collect();
    let rise = |groups: &[Moments], own: &[f64], i: usize, j: usize| {
        let union = groups[i].plus(&groups[j]);
        union.solve().map_or(f64::INFINITY, |(normal, cost)| {
            cost - own[i] - own[j] - mixed(&[groups[i], groups[j]], &union, &normal, dimension)
        })
    };
    // What the union of each with each before it costs, kept up to date.
    let mut rises: Vec<Vec<f64>> =
        (0..groups.len()).map(|i| (0..i).map(|j| rise(groups, &own, i, j)).collect()).collect();
    loop {
        let mut best = (gate, 0, 0);
        for (i, row) in rises.iter().enumerate() {
            for (j, rise) in row.iter().enumerate() {
                if *rise < best.0 {
                    best = (*rise, i, j);
                }
            }
        }
        let (_, gone, kept) = best;
        if gone == kept {
            return;
        }
        groups[kept] = groups[kept].plus(&groups[gone]);
        own[kept] = groups[kept].solve().map_or(f64::INFINITY, |(_, cost)| cost);
        groups.remove(gone);
        own.remove(gone);
        rises.remove(gone);
        for row in &mut rises {
            if row.len() > gone {
                row.remove(gone);
            }
        }
        for other in 0..groups.len() {
            let (i, j) = (other.max(kept), other.min(kept));
            if i != j {
                rises[i][j] = rise(groups, &own, i, j);
            }
        }
    }
}

/// See [`Faces::bending`]. Along each principal axis e of a face's contacts, Σ(a·e)(N·e)/σ_θ² over
/// its standard deviation is N(0, 1) on a flat face; axes count alike, so that the straight lines of
/// a cylinder do not hide its round ones.
fn bending(felt: &[(Contact, Point, usize)], faces: &[Face]) -> f64 {
    let (mut sum, mut axes) = (0.0, 0.0_f64);
    for (number, face) in faces.iter().enumerate() {
        let own: Vec<_> = felt.iter().filter(|(_, _, owner)| *owner == number).collect();
        if own.is_empty() {
            continue;
        }
        let weights: Vec<f64> = own.iter().map(|(c, ..)| c.normal_deviation.powi(-2)).collect();
        let total: f64 = weights.iter().sum();
        let centre: Point =
            own.iter().zip(&weights).map(|((c, ..), w)| c.point * *w).sum::<Point>() / total;
        let tangent = Matrix3::identity() - face.normal * face.normal.transpose();
        let arms: Vec<Point> = own.iter().map(|(c, ..)| tangent * (c.point - centre)).collect();
        let spread: Matrix3<f64> =
            arms.iter().zip(&weights).map(|(a, w)| a * a.transpose() * *w).sum();
        let eigen = SymmetricEigen::new(spread);
        for (value, e) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value > 1e-6 * spread.trace() {
                let turned: f64 = own
                    .iter()
                    .zip(arms.iter().zip(&weights))
                    .map(|((_, n, _), (a, w))| w * a.dot(&e) * n.dot(&e))
                    .sum();
                sum += turned / value.sqrt();
                axes += 1.0;
            }
        }
    }
    if axes > 0.0 { sum / axes.sqrt() } else { 0.0 }
}

/// See [`Faces::protrusion`].
fn protrusion(felt: &[(Contact, Point, usize)], faces: &[Face]) -> f64 {
    let mut worst: f64 = 0.0;
    for (contact, _, owner) in felt {
        for (number, face) in faces.iter().enumerate() {
            if number != *owner {
                let variance = contact.point_deviation.powi(2) + face.variance(&contact.point);
                worst = worst.max(face.value(&contact.point) / variance.sqrt());
            }
        }
    }
    worst
}

#[cfg(test)]
pub(crate) mod tests;
