//! A superquadric from contacts: robust Levenberg–Marquardt on points and normals from many starts.
//!
//! Each contact (p, N) costs (f(p)/σ_p)² + |N − ∇f(p)|²/σ_θ², both under Huber's loss so that a
//! wild contact, or a part of the object that is no superquadric, pulls but does not decide. Solina
//! and Bajcsy (1990) weigh in the volume to keep sizes finite; here weak normal beliefs about
//! sizes and exponents do that, and keep five contacts from fitting anything.

use std::f64::consts::FRAC_PI_4;

use nalgebra::{Matrix3, Point3, Rotation3, SymmetricEigen, Translation3, UnitQuaternion, Vector3};

use super::{
    Covariance, EXPONENTS, Error, Form, Misfit, NUDGE, NUMBERS, PLANAR, Step, Superquadric,
};
use crate::reference::Contact;
use crate::space::{Point, Pose, centroid};
use crate::thin::evenly;

/// Deviations beyond which a contact pulls with constant force only (Huber).
const HUBER: f64 = 2.0;

/// Weak beliefs: half lengths are this part of the distance to the farthest contact, give or take a
/// factor of e; exponents are those of an ellipsoid, give or take one.
const LIKELY_SIZE: f64 = 0.6;
const LIKELY_EXPONENT: f64 = 1.0;

/// Half lengths in distances from the contacts' centre to the farthest of them.
const SIZES: (f64, f64) = (0.02, 3.0);

/// First climbs use this many contacts and steps; the best few of them all contacts and more steps.
const SCOUTS: usize = 48;
const SCOUTING: usize = 8;
const CHOSEN: usize = 3;
const STEPS: usize = 60;

/// No number moves further in one step: exponents, logarithms, radians; metres in farthest contacts.
const STRIDE: f64 = 0.5;

/// A step that gains less than this part of the cost ends a climb.
const SETTLED: f64 = 1e-7;

/// Exponents to start from: ε₁ and ε₂.
const ROUNDNESS: [[f64; 2]; 3] = [[1.0, 1.0], [0.3, 0.3], [0.3, 1.0]];
const PLANAR_ROUNDNESS: [f64; 3] = [0.3, 1.0, 1.7];

/// Contacts to be explained, and how large they say the object is.
struct Problem<'a> {
    contacts: &'a [Contact],
    /// From the contacts' centre to the farthest, metres.
    reach: f64,
}

impl Superquadric {
    /// Fits sizes, exponents within [`EXPONENTS`] and pose to contacts, of which normals are used
    /// where there are any. Starts with several orientations and roundnesses; the same contacts give
    /// the same answer.
    ///
    /// # Errors
    /// When a number is unusable, there are fewer than [`Superquadric::LEAST_CONTACTS`] contacts or
    /// observations than numbers sought (6 in the plane, 11 in space), or all lie at one place.
    pub fn fit(dimension: usize, contacts: &[Contact]) -> Result<Superquadric, Error> {
        if !(2..=3).contains(&dimension) {
            return Err(Error::Dimension(dimension));
        }
        for (index, contact) in contacts.iter().enumerate() {
            contact.check(dimension).map_err(|what| Error::Contact { index, what })?;
        }
        let felt = contacts.iter().filter(|c| c.normal.is_some()).count();
        let observed = contacts.len() + felt * (dimension - 1);
        let sought = if dimension == 2 { PLANAR.len() } else { NUMBERS };
        if contacts.len() < Superquadric::LEAST_CONTACTS || observed < sought {
            return Err(Error::Few { contacts: contacts.len(), observed, sought });
        }
        let centre = centroid(contacts.iter().map(|c| c.point));
        let reach = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
        if !(reach > 1e-6) {
            return Err(Error::NoExtent(reach));
        }

        let scouts = evenly(contacts, SCOUTS);
        let scouting = Problem { contacts: &scouts, reach };
        let mut found: Vec<(f64, Form)> = starts(dimension, contacts)
            .into_iter()
            .map(|start| scouting.climb(start, SCOUTING))
            .filter(|(cost, _)| cost.is_finite())
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let whole = Problem { contacts, reach };
        let refined = found.into_iter().take(CHOSEN).map(|(_, form)| whole.climb(form, STEPS));
        let best = refined.filter(|(cost, _)| cost.is_finite()).min_by(|a, b| a.0.total_cmp(&b.0));
        let (cost, form) = best.ok_or(Error::NoFit)?;
        let excess = (cost / (observed - sought).max(1) as f64).max(1.0);
        let covariance = whole.covariance(&form) * excess;
        let misfit = whole.misfit(&form, observed - sought);
        Ok(Superquadric { dimension, form, covariance, misfit })
    }

    /// 2 or 3.
    pub fn dimension(&self) -> usize {
        self.dimension
    }
}

impl Problem<'_> {
    fn cost(&self, form: &Form) -> f64 {
        let contacts = self.contacts.iter().map(|contact| {
            let (value, turned) = residuals(form, contact);
            loss(value * value) + loss(turned.norm_squared())
        });
        contacts.sum::<f64>() + self.beliefs(form).iter().map(|(_, r)| r * r).sum::<f64>()
    }

    fn misfit(&self, form: &Form, degrees: usize) -> Misfit {
        let square = |contact: &Contact| {
            let (value, turned) = residuals(form, contact);
            value * value + turned.norm_squared()
        };
        Misfit {
            chi_squared: self.contacts.iter().map(square).sum(),
            degrees: degrees as f64,
            oddity: 0.5 * self.beliefs(form).iter().map(|(_, r)| r * r).sum::<f64>(),
        }
    }

    /// Which number each belief is about, and its deviations from it.
    fn beliefs(&self, form: &Form) -> Vec<(usize, f64)> {
        let size = |i: usize| (i, (form.half[i] / (LIKELY_SIZE * self.reach)).ln());
        let round = |i: usize| (3 + i, form.exponents[i] - LIKELY_EXPONENT);
        if form.planar {
            vec![size(0), size(1), round(1)]
        } else {
            vec![size(0), size(1), size(2), round(0), round(1)]
        }
    }

    /// Half the second derivatives of the cost by Gauss and Newton, and half its slope.
    fn expand(&self, form: &Form) -> (Covariance, Step) {
        let (mut bend, mut slope) = (Covariance::zeros(), Step::zeros());
        let free: Vec<usize> = if form.planar { PLANAR.to_vec() } else { (0..NUMBERS).collect() };
        let around: Vec<(usize, Form, Form)> =
            free.iter().map(|i| (*i, form.nudged(*i, NUDGE), form.nudged(*i, -NUDGE))).collect();
        for contact in self.contacts {
            let (value, turned) = residuals(form, contact);
            let mut by_value = Step::zeros();
            let mut by_turn = nalgebra::SMatrix::<f64, 3, NUMBERS>::zeros();
            for (i, ahead, behind) in &around {
                let (a, b) = (residuals(ahead, contact), residuals(behind, contact));
                by_value[*i] = (a.0 - b.0) / (2.0 * NUDGE);
                by_turn.set_column(*i, &((a.1 - b.1) / (2.0 * NUDGE)));
            }
            let weight = pull(value * value);
            bend.ger(weight, &by_value, &by_value, 1.0);
            slope.axpy(weight * value, &by_value, 1.0);
            let weight = pull(turned.norm_squared());
            bend += by_turn.transpose() * by_turn * weight;
            slope += by_turn.transpose() * turned * weight;
        }
        for (i, deviation) in self.beliefs(form) {
            bend[(i, i)] += 1.0;
            slope[i] += deviation;
        }
        (bend, slope)
    }

    /// Levenberg–Marquardt within the bounds: the cost reached and where.
    fn climb(&self, start: Form, steps: usize) -> (f64, Form) {
        let mut form = self.bounded(start);
        let mut cost = self.cost(&form);
        let mut damping = 1e-2;
        for _ in 0..steps {
            let (mut bend, mut slope) = self.expand(&form);
            // An exponent at its bound that the slope pushes beyond stays there.
            for i in 0..2 {
                let (low, high) = EXPONENTS;
                let (at, down) = (form.exponents[i], slope[3 + i]);
                if (at <= low && down > 0.0) || (at >= high && down < 0.0) {
                    slope[3 + i] = 0.0;
                    bend.row_mut(3 + i).fill(0.0);
                    bend.column_mut(3 + i).fill(0.0);
                }
            }
            let mut gained = 0.0;
            while damping < 1e8 {
                let mut damped = bend;
                for i in 0..NUMBERS {
                    // Numbers nothing depends on stay where they are.
                    damped[(i, i)] = (bend[(i, i)] * (1.0 + damping)).max(1e-12);
                }
                let Some(factor) = damped.cholesky() else { return (cost, form) };
                let mut step = -factor.solve(&slope);
                let mut scaled = step;
                scaled.fixed_rows_mut::<3>(8).unscale_mut(self.reach);
                step *= (STRIDE / scaled.amax().max(1e-300)).min(1.0);
                let tried = self.bounded(form.moved(&step));
                let tried_cost = self.cost(&tried);
                if tried_cost < cost {
                    gained = cost - tried_cost;
                    (form, cost) = (tried, tried_cost);
                    damping = (damping * 0.2).max(1e-9);
                    break;
                }
                damping *= 6.0;
            }
            if !(gained > SETTLED * cost) {
                break;
            }
        }
        (cost, form)
    }

    fn bounded(&self, mut form: Form) -> Form {
        for half in &mut form.half {
            *half = half.clamp(SIZES.0 * self.reach, SIZES.1 * self.reach);
        }
        for exponent in &mut form.exponents {
            *exponent = exponent.clamp(EXPONENTS.0, EXPONENTS.1);
        }
        form.pose.rotation.renormalize();
        form
    }

    /// Inverse of the information; a turn that nothing shows is open by a radian, a shift by the
    /// object's size.
    fn covariance(&self, form: &Form) -> Covariance {
        let (mut information, _) = self.expand(form);
        for i in 5..8 {
            information[(i, i)] += 1.0;
            information[(i + 3, i + 3)] += self.reach.powi(-2);
        }
        for i in (0..NUMBERS).filter(|i| form.planar && !PLANAR.contains(i)) {
            information[(i, i)] = 1.0;
        }
        information.cholesky().map_or_else(Covariance::zeros, |c| c.inverse())
    }
}

/// Of the point and of the normal, in deviations; zero for a normal that was not felt.
fn residuals(form: &Form, contact: &Contact) -> (f64, Vector3<f64>) {
    let (value, direction) = form.distance(&contact.point);
    let turned =
        contact.normal.map_or(Vector3::zeros(), |n| (direction - n) / contact.normal_deviation);
    (value / contact.point_deviation, turned)
}

/// Huber's loss of a squared deviation.
fn loss(square: f64) -> f64 {
    if square <= HUBER * HUBER { square } else { 2.0 * HUBER * square.sqrt() - HUBER * HUBER }
}

/// What a contact weighs there.
fn pull(square: f64) -> f64 {
    if square <= HUBER * HUBER { 1.0 } else { HUBER / square.sqrt() }
}

/// Boxes about the contacts in several orientations, with several roundnesses.
fn starts(dimension: usize, contacts: &[Contact]) -> Vec<Form> {
    let mut starts = Vec::new();
    if dimension == 2 {
        for turn in planar_turns(contacts) {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
            for round in PLANAR_ROUNDNESS {
                starts.push(about(contacts, rotation, [1.0, round], true));
            }
        }
        return starts;
    }
    for axes in frames(contacts) {
        // The axis that ε₁ belongs to is any of the three.
        for first in 0..3 {
            let column = |i: usize| axes.column((first + i) % 3).into_owned();
            let turned = Matrix3::from_columns(&[column(0), column(1), column(2)]);
            let rotation =
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turned));
            for round in ROUNDNESS {
                starts.push(about(contacts, rotation, round, false));
            }
        }
    }
    starts
}

/// Along the points' principal axis and along the normals as a rectangle's would turn, and between.
fn planar_turns(contacts: &[Contact]) -> Vec<f64> {
    let centre = centroid(contacts.iter().map(|c| c.point));
    let (mut cos2, mut sin2, mut cos4, mut sin4) = (0.0, 0.0, 0.0, 0.0);
    for contact in contacts {
        let d = contact.point - centre;
        cos2 += d.x * d.x - d.y * d.y;
        sin2 += 2.0 * d.x * d.y;
        if let Some(n) = contact.normal {
            let turn = n.y.atan2(n.x);
            cos4 += (4.0 * turn).cos();
            sin4 += (4.0 * turn).sin();
        }
    }
    let (points, normals) = (0.5 * f64::atan2(sin2, cos2), 0.25 * f64::atan2(sin4, cos4));
    vec![points, points + FRAC_PI_4, normals, normals + FRAC_PI_4]
}

/// Right-handed axes: of the points' scatter, of the normals' scatter, and of the two normals that
/// are nearest to perpendicular.
fn frames(contacts: &[Contact]) -> Vec<Matrix3<f64>> {
    let centre = centroid(contacts.iter().map(|c| c.point));
    let scatter = |vectors: &mut dyn Iterator<Item = Point>| {
        let sum = vectors.fold(Matrix3::zeros(), |sum, v| sum + v * v.transpose());
        right_handed(SymmetricEigen::new(sum).eigenvectors)
    };
    let mut frames = vec![scatter(&mut contacts.iter().map(|c| c.point - centre))];
    let normals: Vec<Point> = contacts.iter().filter_map(|c| c.normal).collect();
    if let Some(first) = normals.first() {
        frames.push(scatter(&mut normals.iter().copied()));
        let across = |n: &&Point| n.dot(first).abs();
        let second = normals.iter().min_by(|a, b| across(a).total_cmp(&across(b)));
        let second = second.and_then(|n| (n - first * n.dot(first)).try_normalize(0.1));
        if let Some(second) = second {
            let first = first.normalize();
            frames.push(Matrix3::from_columns(&[first, second, first.cross(&second)]));
        }
    }
    frames
}

fn right_handed(mut axes: Matrix3<f64>) -> Matrix3<f64> {
    if axes.determinant() < 0.0 {
        axes.column_mut(2).neg_mut();
    }
    axes
}

/// The contacts' bounding box in this orientation.
fn about(
    contacts: &[Contact],
    rotation: UnitQuaternion<f64>,
    exponents: [f64; 2],
    planar: bool,
) -> Form {
    let local = |c: &Contact| rotation.inverse() * c.point;
    let least = |low: Point, c: &Contact| low.inf(&local(c));
    let greatest = |high: Point, c: &Contact| high.sup(&local(c));
    let low = contacts.iter().fold(Point::repeat(f64::INFINITY), least);
    let high = contacts.iter().fold(Point::repeat(f64::NEG_INFINITY), greatest);
    let centre = (rotation * Point3::from((low + high) / 2.0)).coords;
    let size = (high - low) / 2.0;
    // A side that was not felt is not flat for that.
    let half = [size.x, size.y, size.z].map(|s| s.max(0.2 * size.amax()));
    let pose = Pose::from_parts(Translation3::from(centre), rotation);
    Form { half, exponents, pose, planar }
}
