//! The box less smaller boxes that contacts make most probable.

use nalgebra::{Matrix3, Rotation3};

use super::chain::Chains;
use super::{Notch, Notched, Side, Span};
use crate::reference::faces::{Face, Owner};
use crate::reference::{Contact, Faces, misfit};
use crate::space::Point;

/// Most contacts that it does not explain, as a share, and how improbable they are there.
const UNEXPLAINED: f64 = 0.06;
const IMPROBABLE: f64 = 4e-6;

/// Contacts whose normals the axes are begun with, and rounds of bringing them closer to all normals.
const BEGUN: usize = 12;
const ROUNDS: usize = 6;

/// Contacts of each side that was felt, on average, from which on faces say as much.
const EACH: usize = 4;

/// Where it is looked whether samples are inside, along each axis in the plane and in space.
const LOOKED: [usize; 2] = [48, 16];

/// A box less smaller boxes with what is known of its sides.
///
/// ```
/// use nalgebra::Vector3;
/// use tactile_host::reference::{Contact, notched::Found};
///
/// // An L of 90 × 90 mm with arms 35 wide, whose upper end nobody touched.
/// let at = |x, y, out: [f64; 2]| Contact {
///     point: Vector3::new(x, y, 0.0),
///     normal: Some(Vector3::new(out[0], out[1], 0.0)),
///     point_deviation: 1e-3,
///     normal_deviation: 0.09,
/// };
/// let contacts = [
///     at(0.02, 0.0, [0.0, -1.0]),
///     at(0.07, 0.0, [0.0, -1.0]),
///     at(0.09, 0.02, [1.0, 0.0]),
///     at(0.05, 0.035, [0.0, 1.0]),
///     at(0.08, 0.035, [0.0, 1.0]),
///     at(0.035, 0.05, [1.0, 0.0]),
///     at(0.035, 0.08, [1.0, 0.0]),
///     at(0.0, 0.03, [-1.0, 0.0]),
///     at(0.0, 0.07, [-1.0, 0.0]),
/// ];
/// let found = Found::of(2, &contacts, &[]).ok_or("no box less smaller ones")?;
/// assert!(found.solid.contains(&Vector3::new(0.02, 0.07, 0.0)));
/// assert!(!found.solid.contains(&Vector3::new(0.06, 0.06, 0.0)));
/// let unfelt = found.faces.faces.iter().find(|face| face.contacts == 0).ok_or("all felt")?;
/// assert!(unfelt.normal.y > 0.99 && unfelt.offset_variance.sqrt() > 2e-3);
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug)]
pub struct Found {
    /// Which points are inside.
    pub solid: Notched,
    /// Its sides, and which contact is on which.
    pub faces: Faces,
}

impl Found {
    /// Whether so few contacts (dimension 2 or 3) were felt on each side that this says more than faces do.
    pub fn says_more(dimension: usize, contacts: &[Contact]) -> bool {
        let faces = Faces::fit(dimension, contacts);
        faces.is_some_and(|faces| contacts.len() < EACH * faces.faces.len())
    }

    /// What contacts (object frame, dimension 2 or 3) make most probable, of boxes less smaller ones that are their own
    /// mirror image and of others; the same contacts make the same. Takes a
    /// few seconds.
    ///
    /// `None` where contacts contradict nothing convex, where normals are not square to each other, where a contact
    /// cannot be used, and where no box less smaller ones suits the contacts. Points `free` are probably outside.
    pub fn of(dimension: usize, contacts: &[Contact], free: &[Point]) -> Option<Found> {
        if !(2..=3).contains(&dimension) {
            return None;
        }
        let faces = Faces::fit(dimension, contacts)?;
        if faces.is_convex() {
            return None;
        }
        let start = begun(dimension, contacts)?;
        let samples = Chains::of(contacts, free, &start).samples(&start);
        let is_notched = |solid: &&Notched| !solid.notches.is_empty();
        let samples: Vec<Notched> =
            samples.iter().filter(is_notched).map(Notched::ordered).collect();
        let usual = usual(&start, &samples)?;
        let owners = usual.owners(contacts)?;
        let is_alike = |other: &&Notched| {
            other.sides() == usual.sides() && other.owners(contacts).as_ref() == Some(&owners)
        };
        let middle = Middle::of(usual, &samples.iter().filter(is_alike).collect::<Vec<_>>());
        middle.solid.facets()?;
        let faces = middle.faces(contacts, &owners);
        let unowned = owners.iter().filter(|owner| owner.is_none()).count();
        // Faces have a direction each, and here all have one together.
        let shared = (dimension - 1) * faces.faces.len();
        let degrees = faces.degrees + (shared - directions(dimension)) as f64;
        let suits = unowned as f64 <= UNEXPLAINED * contacts.len() as f64
            && misfit::is_likely(faces.chi_squared / degrees.max(1.0), degrees);
        suits.then_some(Found { solid: middle.solid, faces })
    }
}

/// How many numbers turn a box.
fn directions(dimension: usize) -> usize {
    if dimension == 2 { 1 } else { 3 }
}

/// The box about the contacts along the axes that their normals lie on, if they do.
pub(super) fn begun(dimension: usize, contacts: &[Contact]) -> Option<Notched> {
    let weighted = |c: &Contact| Some((c.checked()?.normal?, c.normal_deviation.powi(-2)));
    let felt: Vec<(Point, f64)> = contacts.iter().map(weighted).collect::<Option<_>>()?;
    let firsts = felt.iter().take(BEGUN).map(|(normal, _)| *normal);
    let frames = firsts.flat_map(|first| {
        let seconds: Vec<Point> = match dimension {
            2 => vec![Point::new(-first.y, first.x, 0.0)],
            _ => felt.iter().map(|(normal, _)| normal - first * first.dot(normal)).collect(),
        };
        seconds.into_iter().filter_map(move |second| {
            let second = second.try_normalize(0.5)?;
            let rows = [first, second, first.cross(&second)].map(|row| row.transpose());
            Some(Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows)))
        })
    });
    let (cost, frame) =
        frames.map(|frame| aligned(dimension, frame, &felt)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let degrees = ((dimension - 1) * felt.len()) as f64 - directions(dimension) as f64;
    if !misfit::is_likely(cost / degrees.max(1.0), degrees) {
        return None;
    }
    let middle = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len() as f64;
    let points = || contacts.iter().map(|c| frame * (c.point - middle));
    let low = points().fold(Point::repeat(f64::INFINITY), |low, p| low.inf(&p));
    let high = points().fold(Point::repeat(f64::NEG_INFINITY), |high, p| high.sup(&p));
    let margin = 0.05 * (high - low).norm();
    let outer = [0, 1, 2].map(|axis| [low[axis] - margin, high[axis] + margin]);
    Some(Notched { dimension, frame, middle, outer, notches: vec![] })
}

/// The frame near this one whose axes are nearest to all normals (the orthogonal Procrustes problem; Schönemann,
/// Psychometrika 31, 1966), and χ² of the normals.
fn aligned(
    dimension: usize,
    mut frame: Rotation3<f64>,
    felt: &[(Point, f64)],
) -> (f64, Rotation3<f64>) {
    let axis = |frame: &Rotation3<f64>, normal: &Point| {
        let seen = frame * normal;
        let most = seen.iamax();
        Point::ith(most, seen[most].signum())
    };
    for _ in 0..ROUNDS {
        let mut sum = Matrix3::zeros();
        for (normal, weight) in felt {
            sum += axis(&frame, normal) * normal.transpose() * *weight;
        }
        if dimension == 2 {
            sum[(2, 2)] += sum.norm();
        }
        let svd = sum.svd(true, true);
        let (Some(u), Some(v)) = (svd.u, svd.v_t) else { break };
        let flip = Matrix3::from_diagonal(&Point::new(1.0, 1.0, (u * v).determinant().signum()));
        frame = Rotation3::from_matrix_unchecked(u * flip * v);
    }
    let cost = felt.iter().map(|(n, weight)| (frame * n - axis(&frame, n)).norm_squared() * weight);
    (cost.sum(), frame)
}

/// The sample that is inside most where most are.
fn usual<'a>(start: &Notched, samples: &'a [Notched]) -> Option<&'a Notched> {
    let count = LOOKED[start.dimension - 2];
    let around = |axis: usize| {
        let spans = samples.iter().map(|solid| solid.outer[axis]);
        spans
            .fold([f64::INFINITY, f64::NEG_INFINITY], |all, s| [all[0].min(s[0]), all[1].max(s[1])])
    };
    let spans: Vec<Span> = (0..start.dimension).map(around).collect();
    let points: Vec<Point> = (0..count.pow(start.dimension as u32))
        .map(|number| {
            let mut left = number;
            let mut place = Point::zeros();
            for (axis, [low, high]) in spans.iter().enumerate() {
                place[axis] = low + (high - low) * ((left % count) as f64 + 0.5) / count as f64;
                left /= count;
            }
            start.middle + start.frame.inverse() * place
        })
        .collect();
    let inside: Vec<Vec<bool>> =
        samples.iter().map(|solid| points.iter().map(|p| solid.contains(p)).collect()).collect();
    let share: Vec<f64> = (0..points.len())
        .map(|i| inside.iter().filter(|one| one[i]).count() as f64 / samples.len() as f64)
        .collect();
    let off = |one: &Vec<bool>| -> f64 {
        one.iter()
            .zip(&share)
            .map(|(inside, share)| if *inside { 1.0 - share } else { *share })
            .sum()
    };
    let offs = samples.iter().zip(inside.iter().map(off));
    offs.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(sample, _)| sample)
}

impl Notched {
    /// The same with its notches in an order that depends on nothing but them.
    fn ordered(&self) -> Notched {
        let mut solid = self.clone();
        let key = |notch: &Notch| notch.spans.map(|span| span.map(f64::is_finite));
        let places = |notch: &Notch| notch.spans.into_iter().flatten().collect::<Vec<f64>>();
        solid.notches.sort_by(|a, b| {
            let order = places(a).partial_cmp(&places(b)).unwrap_or(std::cmp::Ordering::Equal);
            key(a).cmp(&key(b)).then(order)
        });
        solid
    }

    /// The side each contact is on, if any; `None` where it is not what it says.
    fn owners(&self, contacts: &[Contact]) -> Option<Vec<Option<Side>>> {
        let facets = self.facets()?;
        let one = |felt| {
            let on = facets.iter().map(|facet| (self.touched(facet, felt), facet.side));
            on.filter(|(share, _)| *share > IMPROBABLE)
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .map(|on| on.1)
        };
        Some(self.felt(contacts).iter().map(one).collect())
    }
}

/// The middle of samples that have the same sides for the same contacts.
struct Middle {
    solid: Notched,
    sides: Vec<Side>,
    /// Of each side's place, square metres, and of the directions, square radians.
    variances: Vec<f64>,
    turning: Point,
}

impl Middle {
    /// Each side at the median: one that nobody felt is as likely before as beyond.
    fn of(usual: &Notched, alike: &[&Notched]) -> Middle {
        let count = alike.len().max(1) as f64;
        let sides = usual.sides();
        let mut solid = usual.clone();
        let mut variances = Vec::new();
        for side in &sides {
            let mut all: Vec<f64> = alike.iter().map(|one| one.at(*side)).collect();
            all.sort_by(f64::total_cmp);
            let place = all.get(all.len() / 2).copied().unwrap_or(usual.at(*side));
            solid = solid.moved(*side, place);
            variances.push(all.iter().map(|one| (one - place).powi(2)).sum::<f64>() / count);
        }
        let turns: Vec<Point> =
            alike.iter().map(|one| (one.frame * usual.frame.inverse()).scaled_axis()).collect();
        let turn = turns.iter().sum::<Point>() / count;
        let turning =
            turns.iter().map(|t| (t - turn).component_mul(&(t - turn))).sum::<Point>() / count;
        solid.frame = Rotation3::new(turn) * usual.frame;
        Middle { solid, sides, variances, turning }
    }

    /// As faces, with the contacts that lie on each.
    fn faces(&self, contacts: &[Contact], owners: &[Option<Side>]) -> Faces {
        let face = |(side, variance): (&Side, &f64)| {
            let own = contacts.iter().zip(owners).filter(|(_, owner)| **owner == Some(*side));
            let own: Vec<Point> = own.map(|(c, _)| c.point).collect();
            let out = Point::ith(side.axis, side.sign());
            let inward = self.solid.frame.inverse();
            let normal = inward * out;
            let offset = side.sign() * self.solid.at(*side) + normal.dot(&self.solid.middle);
            let all = if own.is_empty() { &[self.solid.middle] } else { &own[..] };
            let centroid = all.iter().sum::<Point>() / all.len() as f64;
            let centroid = centroid - normal * (normal.dot(&centroid) - offset);
            // A turn t moves the normal by t × n.
            let moves = out.cross_matrix()
                * Matrix3::from_diagonal(&self.turning)
                * out.cross_matrix().transpose();
            let normal_covariance = inward.matrix() * moves * inward.matrix().transpose();
            Face {
                normal,
                offset,
                centroid,
                offset_variance: *variance,
                normal_covariance,
                contacts: own.len(),
            }
        };
        let faces = self.sides.iter().zip(&self.variances).map(face).collect();
        let number = |side: &Side| self.sides.iter().position(|own| own == side).map(Owner::Face);
        let owners = owners.iter().map(|owner| owner.as_ref().and_then(number)).collect();
        Faces::explaining(self.solid.dimension, contacts, faces, owners)
    }
}
