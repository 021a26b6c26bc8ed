//! In/out-sphere training with normalisation: thesis 2.2.4.

use super::{Gpis, Site, Training};
use crate::accurate::Sum;
use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::Insertion;
use crate::surface::kernel::Kernel;
use crate::surface::prior::Prior;

/// Points known to lie outside and inside, on two spheres (circles) about the contacts.
///
/// The thesis moves the contacts' mean to the origin and divides by the distance of the farthest
/// contact from it, the *extent*; adds points on an enclosing sphere with value +1 and on a sphere
/// within the object with value −1; and gives the contacts the value 0. Here no point moves:
/// instead the kernel's lengths and amplitude, and everything below, are multiples of the extent,
/// which is the same, and f comes out in metres. f is near a signed distance when `outside` is 2,
/// the enclosing sphere then being one extent away from the farthest contact; the surface f = 0
/// needs no scale.
///
/// A thin plate's range must be at least three times `outside`. These kernels span several extents, so
/// that large weights cancel: sums are taken as if in twice the precision ([`Sum`]), and rounding moves
/// the surface by a few hundredths of a millimetre at contact noise of 1 mm.
///
/// The extent is at least three times the largest point deviation, so that a single contact has one
/// too. Points of the spheres have the largest point deviation of the contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spheres {
    /// Radius of the enclosing sphere, in extents.
    pub outside: f32,
    /// Radius of the sphere within, in extents: it must lie inside the object.
    pub inside: f32,
    /// Points on the enclosing sphere.
    pub outside_points: u8,
    /// Points on the sphere within.
    pub inside_points: u8,
    /// Where given, contacts with normals also teach the values ±offset at p ± offset·n (thesis
    /// 2.2.2), in extents.
    pub offset: Option<f32>,
}

impl Spheres {
    /// Twenty points outside and eight inside, for an object up to four times as long as thick.
    pub const FEW: Self = Spheres {
        outside: 1.5,
        inside: 0.2,
        outside_points: 20,
        inside_points: 8,
        offset: Some(0.1),
    };

    /// Sites the two spheres take.
    pub(super) fn points(&self) -> usize {
        usize::from(self.outside_points) + usize::from(self.inside_points)
    }

    /// Point `index` of [`points`](Self::points) as a multiple of the extent, and its value
    /// likewise: evenly spread, the enclosing sphere first.
    fn point<S: Space>(&self, index: usize) -> (S::Vector, f32) {
        let outside = usize::from(self.outside_points);
        if index < outside {
            (spread::<S>(index, outside) * self.outside, 1.0)
        } else {
            let inside = usize::from(self.inside_points);
            (spread::<S>(index - outside, inside) * self.inside, -1.0)
        }
    }
}

/// Unit vector `index` of `count` spread evenly: equal angles in the plane, a golden-angle spiral in
/// space.
fn spread<S: Space>(index: usize, count: usize) -> S::Vector {
    /// 2³² over the golden ratio: multiples modulo 2³² are multiples of the golden angle.
    const GOLDEN: u32 = 2_654_435_769;
    const TURN: f32 = core::f32::consts::TAU / 4_294_967_296.0;
    let part = (2 * index + 1) as f32 / count as f32;
    if S::DIMENSION == 2 {
        let (sin, cos) = math::sin_cos(core::f32::consts::PI * part);
        return S::Vector::from_fn(|i| if i == 0 { cos } else { sin });
    }
    let (sin, cos) = math::sin_cos(GOLDEN.wrapping_mul(index as u32) as f32 * TURN);
    let height = 1.0 - part;
    let ring = math::sqrt(math::max(1.0 - height * height, 0.0));
    S::Vector::from_fn(|i| match i {
        0 => ring * cos,
        1 => ring * sin,
        _ => height,
    })
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// Takes the points of the spheres off the end, so that contacts can follow.
    pub(super) fn open(&mut self) {
        if self.enclosing > 0 {
            self.enclosing = 0;
            self.factor.truncate(self.count);
        }
    }

    /// Adds a contact's sites without their covariances, which wait for [`enclose`](Self::enclose).
    /// At capacity the contact that others explain best goes, which may be the new one: what it
    /// knew is lost, since the covariances are made anew.
    pub(super) fn defer(&mut self, contact: &Contact<S>, spheres: &Spheres) -> Insertion {
        self.open();
        let followers = if contact.normal.is_some() && spheres.offset.is_some() { 2u8 } else { 0 };
        let sites = 1 + usize::from(followers) + spheres.points();
        let mut released = 0;
        while !self.fits(sites, sites, 0) {
            let Some(leader) = self.most_redundant(contact) else { return Insertion::Dropped };
            let after = leader + 1 + usize::from(self.sites[leader].followers);
            self.sites.copy_within(after..self.count, leader);
            self.count -= after - leader;
            for (row, site) in self.sites[..self.count].iter_mut().enumerate() {
                site.row = row as u16;
            }
            released += 1;
        }
        let (own, _) = self.sites_of(contact);
        let leader = own[0].0;
        let value_precision = 1.0 / (self.kernel.variance() + leader.noise);
        for follower in 0..=followers {
            let (row, aside) = (self.count as u16, follower > 0);
            self.sites[self.count] = Site { row, aside, value_precision, ..leader };
            self.count += 1;
        }
        self.sites[self.count - 1 - usize::from(followers)].followers = followers;
        if released > 0 { Insertion::Replaced(released) } else { Insertion::Stored }
    }

    /// Normalises and factors everything anew: all contacts, then the points of the spheres. A
    /// contact whose row is not positive definite is forgotten.
    pub(super) fn enclose(&mut self, spheres: &Spheres) {
        self.open();
        self.factor.truncate(0);
        let (mut centre, mut contacts, mut noise) = (S::Vector::ZERO, 0.0, 0.0);
        for leader in self.leaders() {
            let site = &self.sites[leader];
            centre += site.point;
            contacts += 1.0;
            noise = math::max(site.noise, noise);
        }
        if contacts == 0.0 {
            return;
        }
        centre = centre * (1.0 / contacts);
        let farthest = self
            .leaders()
            .map(|leader| (self.sites[leader].point - centre).norm_squared())
            .fold(9.0 * noise, math::max);
        let extent = math::sqrt(farthest);
        self.kernel = self.given.scaled(extent);

        // Contacts move towards the front as others are forgotten: reading stays ahead of writing.
        let (end, mut from) = (self.count, 0);
        self.count = 0;
        while from < end {
            let leader = self.sites[from];
            from += 1 + usize::from(leader.followers);
            let start = self.count;
            let mut site = leader;
            let mut outcome = self.append(&mut site, leader.noise, 0.0);
            if let (Some(offset), true) = (spheres.offset, leader.followers > 0) {
                for value in [offset * extent, -offset * extent] {
                    let point = leader.point + leader.normal * value;
                    let mut site = Site { point, value, followers: 0, aside: true, ..leader };
                    outcome = outcome.and_then(|()| self.append(&mut site, leader.noise, 0.0));
                }
            }
            if outcome.is_err() {
                self.count = start;
                self.factor.truncate(start);
            }
        }
        let contacts = self.count;
        for index in 0..spheres.points() {
            let (direction, value) = spheres.point::<S>(index);
            let point = centre + direction * extent;
            let mut site = Site { point, value: value * extent, noise, aside: true, ..Site::UNSET };
            // A point that adds nothing to the others is left out.
            let _ = self.append(&mut site, noise, 0.0);
        }
        self.enclosing = self.count - contacts;
        self.count = contacts;
    }

    /// One step of iterative refinement of the weights (Wilkinson 1963): with values of ±1 beside
    /// contacts that are known to a sixtieth of that, weights are hundreds of times as large as what
    /// their sum comes to.
    pub(super) fn refine(&mut self) {
        let mut rest = [0.0; ROWS];
        for site in self.sites() {
            let explained = self.between_spheres(site.point) + site.noise * site.value_weight;
            rest[usize::from(site.row)] = site.value + site.value_offset - explained;
        }
        let rest = &mut rest[..self.factor.rows()];
        self.factor.forward(rest);
        self.factor.backward(rest);
        for site in &mut self.sites[..self.count + self.enclosing] {
            let row = usize::from(site.row);
            site.value_weight += rest[row];
            self.weights[row] = site.value_weight;
        }
    }

    /// The posterior mean at a point, metres: its terms are large and cancel.
    #[inline(never)]
    pub(super) fn between_spheres(&self, point: S::Vector) -> f32 {
        let mut sum = Sum::from(self.prior.mean(point).0);
        for site in self.sites() {
            let covariance = self.kernel.value((point - site.point).norm_squared());
            sum.add_product(site.value_weight, covariance);
        }
        sum.value()
    }

    /// Rows that contacts occupy or are going to.
    pub(super) fn taken(&self) -> usize {
        match self.training {
            Training::Spheres(_) => self.count,
            _ => self.factor.rows(),
        }
    }
}
