//! Shapes with flat faces and sharp edges, convex or not: which cells between the fitted planes are
//! inside.
//!
//! The planes cut a box around the contacts into convex cells ([`Arrangement`]). Each contact says that
//! the cell just below it is inside and the one just above it outside; free points are outside; surface
//! far from all contacts of its plane is unlikely in proportion to its area. The labelling of least cost
//! is a minimum cut (Chauve, Labatut and Pons, CVPR 2010; Nan and Wonka's PolyFit, ICCV 2017, solves a
//! harder form by integer programming). Its boundary is closed by construction and its vertices are
//! exactly where the planes meet. Planar objects are prisms between z = ±reach.

use super::arrangement::{Arrangement, Facet};
use super::boundary::{self, Side};
use super::min_cut::Graph;
use super::{Field, Geometry};
use crate::model::faces::{Face, Faces, Owner};
use crate::model::{Doubt, Open};
use crate::reference::Contact;
use crate::space::{Point, centroid};

/// A closed shape of flat faces.
#[derive(Clone, Debug)]
pub struct Polytope {
    /// Outline, or watertight mesh with outward triangles.
    pub geometry: Geometry,
    /// Standard deviation of each vertex along the mean of the normals that meet there, metres.
    pub deviations: Vec<f64>,
    /// The planes: the fitted faces in their order, then those that close untouched sides (of no
    /// contacts).
    pub planes: Vec<Face>,
    /// Triangles (in the plane: edges, as a, b, b) with the plane each lies in.
    pub pieces: Vec<(usize, [Point; 3])>,
    /// Where it was touched.
    touched: Vec<Point>,
    /// What else the surface may be.
    doubt: Option<Doubt>,
}

/// What a contact weighs that the shape contradicts: −ln of the share of wild contacts, 2 %.
const EVIDENCE: f64 = 4.0;

/// What as much surface without contacts costs as is expected to have one: 1 if touches were spread
/// evenly, less because hands do not reach everywhere.
const GHOST: f64 = 0.3;

/// How far beyond a plane rounding may put its own corners, as a share of the object's size.
const LEVEL: f64 = 1e-6;

/// Deviations from the border of its facet from which on a contact counts in full.
const CLEAR: f64 = 2.0;

/// Cosine between one normal and the reverse of another from which their faces are counterparts: 50°.
pub const COUNTERPART: f64 = 0.64;

/// The same from which one lies opposite to the other: 20°.
pub const OPPOSITE: f64 = 0.94;

/// A face reaches the outermost contacts when it passes this close, as a share of the contacts' extent
/// across it.
const FAR_SIDE: f64 = 0.05;

/// Deviations from its own face, where that is part of the surface, at which a contact is unexplained.
pub const FAR: f64 = 4.0;

/// Cosine of the angle to its face's normal up to which a contact may lie on it.
const FACING: f64 = 0.5;

/// How uncertain a closing plane is, as a share of the contacts' extent across it.
const CLOSED: f64 = 0.2;

/// How far a face may bend or end between the contacts and a point, as a share of their distance.
const UNSURE: f64 = 0.03;

/// Most planes: cells grow with the cube.
pub const MOST_PLANES: usize = 28;

/// Samples of a facet that decide how much of it is near contacts.
const SAMPLES: usize = 12;

/// How far the box reaches, in distances from the contacts' centre to the farthest of them.
const REACH: f64 = 2.0;

/// The shape that suits the contacts that `faces` was fitted to (`contacts` in the same order) and the
/// points known to be outside, cut by the planes `closing` too (see [`closures`]).
///
/// `None` when planes are too many, when nothing is inside, when its edges touch each other, and when it
/// reaches the box: it is open.
pub fn assemble(
    faces: &Faces,
    contacts: &[Contact],
    free: &[Point],
    closing: &[Face],
) -> Option<Polytope> {
    built(faces, contacts, closing, |scene| Some(scene.inside(free)))
}

/// What lies behind all `faces`, felt by a contact or not: a convex shape that is known to have these sides and
/// no others. `contacts` are those that `faces` was fitted to, in the same order.
///
/// `None` as for [`assemble`], and where the middle of the contacts does not lie behind all faces.
pub fn intersection(faces: &Faces, contacts: &[Contact]) -> Option<Polytope> {
    built(faces, contacts, &[], |scene| scene.behind_all())
}

/// What of the cells between all `faces` has its middle inside a shape that is known to have these sides and no others.
/// `contacts` are those that `faces` was fitted to, in the same order.
///
/// `None` as for [`assemble`].
pub fn solid(
    faces: &Faces,
    contacts: &[Contact],
    is_inside: impl Fn(&Point) -> bool,
) -> Option<Polytope> {
    built(faces, contacts, &[], |scene| {
        let cells = 0..scene.arrangement.cells.len();
        Some(cells.map(|cell| is_inside(&scene.arrangement.middle(cell))).collect())
    })
}

/// The shape of the cells that are `inside`.
fn built(
    faces: &Faces,
    contacts: &[Contact],
    closing: &[Face],
    inside: impl Fn(&Scene<'_>) -> Option<Vec<bool>>,
) -> Option<Polytope> {
    let touched: Vec<Point> = contacts.iter().map(|c| c.point).collect();
    let centre = centroid(touched.iter().copied());
    let reach = REACH * touched.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max);
    if !(reach > 0.0 && reach.is_finite() && contacts.len() == faces.owners.len()) {
        return None;
    }
    let mut planes = faces.faces.clone();
    planes.extend_from_slice(closing);
    let open = Open::of(contacts);
    for plane in &mut planes {
        let open = open.deviation(&plane.centroid, &plane.normal);
        plane.offset_variance = plane.offset_variance.max(open * open);
    }
    if planes.len() > MOST_PLANES {
        return None;
    }
    let cuts: Vec<(Point, f64)> = planes.iter().map(|plane| (plane.normal, plane.offset)).collect();
    let arrangement = Arrangement::of(&centre, reach, &cuts)?;
    let scene = Scene { faces, planes: &planes, contacts, arrangement: &arrangement };
    let inside = inside(&scene)?;
    let mut sides: Vec<Side> = Vec::new();
    for facet in &arrangement.facets {
        let front = facet.front.is_some_and(|c| inside[c]);
        if inside[facet.back] == front || scene.is_cap(facet) {
            continue;
        }
        let mut ring = facet.ring.clone();
        if front {
            ring.reverse();
        }
        sides.push(Side { plane: facet.plane?, flipped: front, ring });
    }
    let shape = if faces.dimension == 2 {
        boundary::outline(&arrangement.vertices, &sides)?
    } else {
        boundary::mesh(&arrangement.vertices, &sides)?
    };
    let mut polytope = Polytope {
        geometry: shape.geometry,
        deviations: vec![],
        planes,
        pieces: shape.pieces,
        touched,
        doubt: None,
    };
    let deviation = |(vertex, meeting): (&Point, &Vec<(usize, bool)>)| {
        // A vertex moves by e_j along the normal of each plane j that meets there, so along their
        // sum m by Σe_j/|m|.
        let normal = |(j, flipped): &(usize, bool)| {
            polytope.planes[*j].normal * if *flipped { -1.0 } else { 1.0 }
        };
        let sum: Point = meeting.iter().map(normal).sum();
        let variance: f64 = meeting.iter().map(|(j, _)| polytope.variance(*j, vertex)).sum();
        variance.sqrt() / sum.norm().max(0.1)
    };
    polytope.deviations = shape.vertices.iter().zip(&shape.meeting).map(deviation).collect();
    Some(polytope)
}

/// Planes for sides that were not touched, at the outermost contacts: opposite to those faces on whose
/// other side no face reaches out as far as contacts do and is turned about the same way, by the cosine of
/// what makes a `counterpart`. A contact that shares its face with no other may be wild, and is outermost
/// only where it looks that way.
pub fn closures(faces: &Faces, contacts: &[Contact], counterpart: f64) -> Vec<Face> {
    let closure = |face: &Face| {
        let normal = -face.normal;
        let along = |c: &&Contact| normal.dot(&c.point);
        let looks = |c: &Contact| c.normal.is_none_or(|felt| felt.dot(&normal) > FACING);
        let agree =
            |owner: &Owner| owner.faces().iter().any(|face| faces.faces[*face].contacts > 1);
        let felt = contacts.iter().zip(&faces.owners);
        let felt = felt.filter(|(c, o)| o.as_ref().is_some_and(agree) || looks(c)).map(|(c, _)| c);
        let outermost = felt.clone().max_by(|a, b| along(a).total_cmp(&along(b)))?;
        let innermost = felt.map(|c| along(&c)).fold(f64::INFINITY, f64::min);
        let offset = along(&outermost);
        let reached = FAR_SIDE * (offset - innermost) + 4.0 * outermost.point_deviation;
        let opposite =
            |f: &Face| f.normal.dot(&normal) > counterpart && f.value(&outermost.point) < reached;
        (!faces.faces.iter().any(opposite)).then(|| Face {
            normal,
            offset,
            centroid: outermost.point,
            offset_variance: (CLOSED * (offset - innermost)).powi(2),
            contacts: 0,
            ..*face
        })
    };
    faces.faces.iter().filter_map(closure).collect()
}

/// What decides which cells are inside.
struct Scene<'a> {
    faces: &'a Faces,
    planes: &'a [Face],
    contacts: &'a [Contact],
    arrangement: &'a Arrangement,
}

impl Scene<'_> {
    /// The one cell behind all planes.
    fn behind_all(&self) -> Option<Vec<bool>> {
        let sum: Point = self.contacts.iter().map(|c| c.point).sum();
        let middle = sum / self.contacts.len().max(1) as f64;
        let cell = self.arrangement.cell_at(&middle)?;
        let is_behind = self.planes.iter().all(|plane| plane.value(&middle) < 0.0);
        is_behind.then(|| (0..self.arrangement.cells.len()).map(|c| c == cell).collect())
    }

    fn inside(&self, free: &[Point]) -> Vec<bool> {
        let arrangement = self.arrangement;
        let mut graph = Graph::new(arrangement.cells.len());
        let mut evidence = vec![0.0; arrangement.cells.len()];
        let (spacing, unit) = self.spacing();
        for facet in arrangement.facets.iter().filter(|f| !self.is_cap(f)) {
            let area = self.area(facet) / unit * GHOST;
            match (facet.plane, facet.front) {
                (Some(plane), Some(front)) => {
                    let bare = area * (1.0 - self.covered(facet, plane, spacing));
                    // Seen from the wrong side, no contact supports it.
                    graph.connect(facet.back, front, bare, 2.0 * area);
                }
                _ => graph.to_sink(facet.back, area),
            }
        }
        for (contact, owner) in self.contacts.iter().zip(&self.faces.owners) {
            // Contacts on edges have cells on all sides.
            let Some(Owner::Face(plane)) = owner else { continue };
            let normal = self.planes[*plane].normal;
            let clear = |f: &&Facet| arrangement.clearance(f, &normal, &contact.point);
            let on = arrangement.facets.iter().filter(|f| f.plane == Some(*plane));
            let Some(facet) = on.max_by(|a, b| clear(a).total_cmp(&clear(b))) else { continue };
            let share = (clear(&facet) / (CLEAR * contact.point_deviation)).clamp(0.05, 1.0);
            graph.from_source(facet.back, EVIDENCE * share);
            evidence[facet.back] += share;
            if let Some(front) = facet.front {
                graph.to_sink(front, EVIDENCE * share);
            }
        }
        let noise = self.contacts.iter().map(|c| c.point_deviation).fold(f64::INFINITY, f64::min);
        for point in free {
            let Some(cell) = arrangement.cell_at(point) else { continue };
            let depth =
                self.planes.iter().map(|f| f.value(point).abs()).fold(f64::INFINITY, f64::min);
            graph.to_sink(cell, EVIDENCE * (depth / (2.0 * CLEAR * noise) - 0.5).clamp(0.0, 1.0));
        }
        main_part(arrangement, &graph.cut().1, &evidence)
    }

    /// Surface per contact as a length across, and as an area (in the plane: of the prism), judged by
    /// the bounding box of the contacts.
    fn spacing(&self) -> (f64, f64) {
        let first = self.contacts.first().map_or(Point::zeros(), |c| c.point);
        let (low, high) = self
            .contacts
            .iter()
            .fold((first, first), |(low, high), c| (low.inf(&c.point), high.sup(&c.point)));
        let size = high - low;
        let count = self.contacts.len().max(1) as f64;
        if self.faces.dimension == 2 {
            let each = (2.0 * (size.x + size.y) / count).max(1e-9);
            return (each, each * self.height());
        }
        let each = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x) / count;
        (each.sqrt().max(1e-9), each.max(1e-18))
    }

    /// Whether a facet only closes the prism that stands for a planar object.
    fn is_cap(&self, facet: &Facet) -> bool {
        let low = |v: &usize| self.arrangement.vertices[*v].z < 0.0;
        let all = |below: bool| facet.ring.iter().all(|v| low(v) == below);
        self.faces.dimension == 2 && (all(true) || all(false))
    }

    /// Of the prism that stands for a planar object.
    fn height(&self) -> f64 {
        self.arrangement.vertices[7].z - self.arrangement.vertices[0].z
    }

    fn area(&self, facet: &Facet) -> f64 {
        let corners: Vec<Point> = self.arrangement.corners(facet).collect();
        let fan = (2..corners.len())
            .map(|i| (corners[i - 1] - corners[0]).cross(&(corners[i] - corners[0])));
        fan.sum::<Point>().norm() / 2.0
    }

    /// The share of a facet that is within `spacing` of a contact on its plane.
    fn covered(&self, facet: &Facet, plane: usize, spacing: f64) -> f64 {
        let own: Vec<Point> = self
            .contacts
            .iter()
            .zip(&self.faces.owners)
            .filter(|(_, owner)| owner.is_some_and(|o| o.faces().contains(&plane)))
            .map(|(c, _)| c.point)
            .collect();
        if own.is_empty() {
            return 0.0;
        }
        let flat = |p: Point| if self.faces.dimension == 2 { Point::new(p.x, p.y, 0.0) } else { p };
        let corners: Vec<Point> = self.arrangement.corners(facet).map(flat).collect();
        let near = |p: &Point| own.iter().any(|c| (c - p).norm_squared() < spacing * spacing);
        let (mut total, mut covered) = (0.0, 0.0);
        for i in 2..corners.len() {
            let [a, b, c] = [corners[0], corners[i - 1], corners[i]];
            let (ab, ac) = (b - a, c - a);
            // In the plane triangles are flat: then lengths weigh as areas would.
            let weight = if self.faces.dimension == 2 {
                ab.norm().max(ac.norm())
            } else {
                ab.cross(&ac).norm()
            };
            for k in 0..SAMPLES {
                let (u, v) = super::mesh::plastic(k);
                let root = u.sqrt();
                let p = if self.faces.dimension == 2 {
                    let far = if ab.norm() > ac.norm() { b } else { c };
                    a + (far - a) * ((k as f64 + 0.5) / SAMPLES as f64)
                } else {
                    a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v)
                };
                total += weight;
                covered += if near(&p) { weight } else { 0.0 };
            }
        }
        if total > 0.0 { covered / total } else { 0.0 }
    }
}

/// What is inside, without the parts for which fewer contacts speak (`evidence` for every cell) than
/// for the best one.
fn main_part(arrangement: &Arrangement, inside: &[bool], evidence: &[f64]) -> Vec<bool> {
    let mut best = (f64::NEG_INFINITY, vec![false; inside.len()]);
    let mut seen = vec![false; inside.len()];
    for first in 0..inside.len() {
        if !inside[first] || seen[first] {
            continue;
        }
        let (mut part, mut weight) = (vec![false; inside.len()], 0.0);
        part[first] = true;
        let mut open = vec![first];
        while let Some(cell) = open.pop() {
            seen[cell] = true;
            weight += evidence[cell];
            for facet in &arrangement.cells[cell] {
                let facet = &arrangement.facets[*facet];
                for next in [Some(facet.back), facet.front].into_iter().flatten() {
                    if inside[next] && !part[next] {
                        part[next] = true;
                        open.push(next);
                    }
                }
            }
        }
        if weight > best.0 {
            best = (weight, part);
        }
    }
    best.1
}

impl Polytope {
    /// The same shape, less certain: the faces may hold only where they were touched.
    pub fn doubted(self, doubt: Option<Doubt>) -> Polytope {
        let deviations = match &doubt {
            Some(doubt) => doubt.widened(&self.geometry.vertices(), &self.deviations),
            None => self.deviations,
        };
        Polytope { deviations, doubt, ..self }
    }

    /// Whether no part of the surface lies beyond a plane of another.
    pub fn is_convex(&self) -> bool {
        let corners = || self.pieces.iter().flat_map(|(_, corners)| corners);
        let size = corners().map(|corner| corner.amax()).fold(0.0, f64::max);
        let seen = self.pieces.iter().map(|(plane, _)| &self.planes[*plane]);
        seen.into_iter().all(|face| corners().all(|corner| face.value(corner) < LEVEL * size))
    }

    /// How many planes with contacts the surface has.
    pub fn touched_planes(&self) -> usize {
        let seen = |j: usize| self.pieces.iter().any(|(plane, _)| *plane == j);
        (0..self.planes.len()).filter(|j| self.planes[*j].contacts > 0 && seen(*j)).count()
    }

    /// Variance of plane `j` at a point, square metres, with the doubt that grows away from the
    /// contacts.
    fn variance(&self, j: usize, point: &Point) -> f64 {
        let gap = self.touched.iter().map(|t| (t - point).norm()).fold(f64::INFINITY, f64::min);
        self.planes[j].variance(point) + (UNSURE * gap).powi(2)
    }

    /// How far a contact is from the sides that face about as was felt, in deviations of both; infinite without any.
    pub fn off(&self, contact: &Contact) -> f64 {
        let is_felt = |plane: &usize| {
            contact.normal.is_none_or(|normal| self.planes[*plane].normal.dot(&normal) > FACING)
        };
        let off = |plane: usize| {
            let variance = contact.point_deviation.powi(2) + self.variance(plane, &contact.point);
            Some(self.nearest(&contact.point, Some(plane))?.2 / variance.sqrt())
        };
        let all = (0..self.planes.len()).filter(is_felt).filter_map(off);
        all.fold(f64::INFINITY, f64::min)
    }

    /// The point of the surface nearest to `point`, its plane and the distance, metres; of the plane
    /// `on` alone where one is given.
    pub fn nearest(&self, point: &Point, on: Option<usize>) -> Option<(usize, Point, f64)> {
        let flat = match self.geometry {
            Geometry::Outline(_) => Point::new(point.x, point.y, 0.0),
            Geometry::Mesh(_) => *point,
        };
        self.pieces
            .iter()
            .filter(|(plane, _)| on.is_none_or(|j| j == *plane))
            .map(|(plane, corners)| {
                let closest = boundary::closest(&flat, corners);
                (*plane, closest, (closest - flat).norm())
            })
            .min_by(|a, b| a.2.total_cmp(&b.2))
    }
}

impl Field for Polytope {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        let signed = |p: &Point| match &self.geometry {
            Geometry::Outline(o) => o.signed_distance(p),
            Geometry::Mesh(m) => m.signed_distance(p).unwrap_or(f64::INFINITY),
        };
        points.iter().map(signed).collect()
    }

    /// Of the face that the nearest point of the surface lies on; near an edge, of the less certain one.
    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        let deviation = |p: &Point| {
            let Some((plane, closest, distance)) = self.nearest(p, None) else {
                return (*p, f64::INFINITY);
            };
            let own = self.variance(plane, &closest);
            let reach = distance + own.sqrt();
            let near = |(_, corners): &&(usize, [Point; 3])| {
                (boundary::closest(&closest, corners) - closest).norm() < reach
            };
            let others = self.pieces.iter().filter(near).map(|(j, _)| self.variance(*j, &closest));
            (closest, others.fold(own, f64::max).sqrt())
        };
        let (closest, own): (Vec<Point>, Vec<f64>) = points.iter().map(deviation).unzip();
        match &self.doubt {
            Some(doubt) => doubt.widened(&closest, &own),
            None => own,
        }
    }
}

#[cfg(test)]
mod tests;
