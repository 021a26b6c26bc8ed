//! The box less smaller boxes that contacts make most probable.

use nalgebra::{Matrix3, Rotation3};

use super::axes::{Normal, along_axes, axes, directions, normal};
use super::chain::Chains;
use super::moves::notched_before;
use super::{Notch, Notched, RARE, Side, Span, Wild};
use crate::model::faces::{Face, Owner};
use crate::model::{Faces, misfit};
use crate::reference::Contact;
use crate::space::{Point, centroid};

/// Most contacts that it does not explain where hardly any is wild, as a share.
const UNEXPLAINED: f64 = 0.06;

/// Contacts of each side that was felt, on average, from which on faces say as much.
const EACH: usize = 4;

/// Part of the outer box's length by which two sides may be apart and are one all the same: images of each other are as
/// far from their mirror but for rounding.
const LEVEL: f64 = 1e-6;

/// Where it is looked whether samples are inside, along each axis in the plane and in space.
const LOOKED: [usize; 2] = [48, 16];

/// A box less smaller boxes with what is known of its sides.
///
/// ```
/// use nalgebra::Vector3;
/// use tactile_host::model::notched::Found;
/// use tactile_host::reference::Contact;
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
        if !(2..=3).contains(&dimension) || Faces::fit(dimension, contacts)?.is_convex() {
            return None;
        }
        let (start, are_square) = begun(dimension, contacts)?;
        if !are_square {
            return None;
        }
        let samples = Chains::of(contacts, free, RARE, &start).samples(&start);
        Found::likeliest(&samples, contacts, RARE, UNEXPLAINED, &start)
    }

    /// The same of contacts of which a share `most` may be wild, of something else or of a sensor that failed, and
    /// which are not: those on its sides.
    ///
    /// `None` as for [`of`](Found::of), but that wild contacts need not be square to others, where a whole box
    /// and a few more wild ones are as probable, and where faces of the others [say](Found::says_more) less and no
    /// contact is known to be wild because it is not square.
    pub fn among_wild(
        dimension: usize,
        contacts: &[Contact],
        free: &[Point],
        most: f64,
    ) -> Option<(Found, Vec<bool>)> {
        if !(2..=3).contains(&dimension) {
            return None;
        }
        let mut trusted = along_axes(dimension, contacts);
        let own = contacts.iter().zip(&trusted).filter_map(|(c, along)| along.then_some(*c));
        let own: Vec<Contact> = own.collect();
        let askew = contacts.len() - own.len();
        let left = most * contacts.len() as f64 - askew as f64;
        if left < 0.0
            || (askew == 0 && Found::says_more(dimension, &own))
            || Faces::fit(dimension, &own)?.is_convex()
        {
            return None;
        }
        let (start, _) = begun(dimension, &own)?;
        let unexplained = left / own.len() as f64;
        let wild = Wild::beside(&start, &own, askew);
        let samples = Chains::of(&own, free, wild, &start).samples(&start);
        if !are_likelier_notched(&samples) {
            return None;
        }
        let Found { solid, faces } = Found::likeliest(&samples, &own, wild, unexplained, &start)?;
        let is_on: Vec<bool> = faces.owners.iter().map(Option::is_some).collect();
        let mut each = is_on.iter();
        for trusted in trusted.iter_mut().filter(|trusted| **trusted) {
            *trusted = each.next().copied().unwrap_or_default();
        }
        let owned = own.iter().zip(faces.owners).filter(|(_, owner)| owner.is_some());
        let (own, owners): (Vec<Contact>, Vec<Option<Owner>>) = owned.unzip();
        let faces = Faces::explaining(dimension, &own, faces.faces, owners);
        Some((Found { solid, faces }, trusted))
    }

    /// Whether contacts (object frame, dimension 2 or 3) make it more probable than it was before any that something is
    /// cut out of a box (the Bayes factor; Kass and Raftery, Journal of the American Statistical Association 90, 1995),
    /// rather than that those inside it are wild, beside as many as are `known` to be. They are square to each other,
    /// nearly; in another dimension, and where one cannot be used, they do not. Points `free` are probably outside.
    /// Takes a few seconds.
    pub fn is_likelier(
        dimension: usize,
        contacts: &[Contact],
        free: &[Point],
        known: usize,
    ) -> bool {
        if !(2..=3).contains(&dimension) {
            return false;
        }
        let Some((start, _)) = begun(dimension, contacts) else { return false };
        let wild = Wild::beside(&start, contacts, known);
        let samples = Chains::of(contacts, free, wild, &start).samples(&start);
        are_likelier_notched(&samples)
    }

    /// What contacts make most probable, where it leaves a share of them unexplained at most.
    fn likeliest(
        samples: &[Notched],
        contacts: &[Contact],
        wild: Wild,
        unexplained: f64,
        start: &Notched,
    ) -> Option<Found> {
        let is_notched = |solid: &&Notched| !solid.notches.is_empty();
        let samples: Vec<Notched> =
            samples.iter().filter(is_notched).map(Notched::ordered).collect();
        let usual = usual(start, &samples)?;
        let owners = usual.owners(contacts, &wild)?;
        let is_alike = |other: &&Notched| {
            other.sides() == usual.sides()
                && other.owners(contacts, &wild).as_ref() == Some(&owners)
        };
        let middle = Middle::of(usual, &samples.iter().filter(is_alike).collect::<Vec<_>>());
        middle.solid.facets()?;
        let faces = middle.faces(contacts, &owners);
        let unowned = owners.iter().filter(|owner| owner.is_none()).count();
        let degrees = degrees(&faces);
        let suits = unowned as f64 <= unexplained * contacts.len() as f64
            && misfit::is_likely(faces.chi_squared / degrees.max(1.0), degrees);
        suits.then_some(Found { solid: middle.solid, faces })
    }
}

/// Measured numbers less fitted ones: faces have a direction each, and here all have one together.
pub(super) fn degrees(faces: &Faces) -> f64 {
    let felt = faces.faces.iter().filter(|face| face.contacts > 0).count();
    let shared = (faces.dimension - 1) * felt;
    faces.degrees + shared as f64 - directions(faces.dimension) as f64
}

/// The box about the contacts along the axes that their normals lie on, and whether all do.
pub(super) fn begun(dimension: usize, contacts: &[Contact]) -> Option<(Notched, bool)> {
    let felt: Vec<Normal> = contacts.iter().map(normal).collect::<Option<_>>()?;
    let (frame, cost) = axes(dimension, &felt)?;
    let degrees = ((dimension - 1) * felt.len()) as f64 - directions(dimension) as f64;
    let are_square = misfit::is_likely(cost / degrees.max(1.0), degrees);
    let middle = centroid(contacts.iter().map(|c| c.point));
    let points = || contacts.iter().map(|c| frame * (c.point - middle));
    let low = points().fold(Point::repeat(f64::INFINITY), |low, p| low.inf(&p));
    let high = points().fold(Point::repeat(f64::NEG_INFINITY), |high, p| high.sup(&p));
    let margin = 0.05 * (high - low).norm();
    let outer = [0, 1, 2].map(|axis| [low[axis] - margin, high[axis] + margin]);
    Some((Notched { dimension, frame, middle, outer, notches: vec![] }, are_square))
}

/// Whether more samples have notches than boxes have before any contact.
fn are_likelier_notched(samples: &[Notched]) -> bool {
    let notched = samples.iter().filter(|solid| !solid.notches.is_empty()).count();
    notched as f64 > notched_before() * samples.len() as f64
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
    fn owners(&self, contacts: &[Contact], wild: &Wild) -> Option<Vec<Option<Side>>> {
        let facets = self.facets()?;
        let one = |felt| {
            let on = facets.iter().map(|facet| (self.touched(facet, felt), facet.side));
            on.filter(|(share, _)| *share > wild.owned)
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

    /// Whether two sides lie in one plane and face the same way.
    fn are_level(&self, one: &Side, other: &Side) -> bool {
        let apart = self.solid.at(*one) - self.solid.at(*other);
        one.axis == other.axis
            && one.sign() == other.sign()
            && apart.abs() < LEVEL * self.solid.size(one.axis)
    }

    /// As faces, with the contacts that lie on each.
    fn faces(&self, contacts: &[Contact], owners: &[Option<Side>]) -> Faces {
        let face = |(side, variance): (&Side, &f64)| {
            let is_on = |owner: &Option<Side>| owner.is_some_and(|own| self.are_level(&own, side));
            let own = contacts.iter().zip(owners).filter(|(_, owner)| is_on(owner));
            let own: Vec<Point> = own.map(|(c, _)| c.point).collect();
            let out = Point::ith(side.axis, side.sign());
            let inward = self.solid.frame.inverse();
            let normal = inward * out;
            let offset = side.sign() * self.solid.at(*side) + normal.dot(&self.solid.middle);
            let all = if own.is_empty() { &[self.solid.middle] } else { &own[..] };
            let centroid = centroid(all.iter().copied());
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
        let mut planes: Vec<(&Side, &f64)> = Vec::new();
        for (side, variance) in self.sides.iter().zip(&self.variances) {
            if !planes.iter().any(|(own, _)| self.are_level(own, side)) {
                planes.push((side, variance));
            }
        }
        let number = |side: &Side| planes.iter().position(|(own, _)| self.are_level(own, side));
        let number = |side: &Side| number(side).map(Owner::Face);
        let faces = planes.iter().copied().map(face).collect();
        let owners = owners.iter().map(|owner| owner.as_ref().and_then(number)).collect();
        Faces::explaining(self.solid.dimension, contacts, faces, owners)
    }
}
