//! Delimiting an object: the flat hand moves from every side until it touches (thesis figure 4.2).

use parry3d_f64::shape::SharedShape;

use super::articulated::Articulated;
use super::urdf::cuboid;
use crate::shape::{Geometry, Mesh};
use crate::space::{Point, Pose};

/// How far from the middle of the workspace a move starts at least, and in front of the object, metres.
const START: f64 = 0.4;
const BEFORE: f64 = 0.1;

/// A flat hand nearer than this touches, metres.
const TOUCHING: f64 = 4e-5;

/// Between a flat hand on edge and the table, metres.
const GAP: f64 = 1e-3;

/// How far in front of what a flat hand touched, and how far beside the box it found, the places are that
/// are known to be clear, metres; and how many of them there are along each side.
const IN_FRONT: f64 = 3e-3;
const BESIDE: f64 = 5e-3;
const LATTICE: usize = 5;

/// Half the thickness of a flat hand, metres: only its front touches.
const HALF_THICKNESS: f64 = 1e-3;

/// A hand held flat: a rectangular plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plate {
    /// The shorter side, metres, which stands upright in moves from the side.
    pub width: f64,
    /// The longer side, metres.
    pub length: f64,
}

impl Plate {
    /// One larger than any object on the bench: that of the idealised hand.
    pub const LARGE: Plate = Plate { width: 40.0, length: 40.0 };

    /// The open hand's: its two greatest extents.
    pub fn of(hand: &Articulated) -> Plate {
        let (low, high) = hand.extents();
        let mut sides: [f64; 3] = (high - low).into();
        sides.sort_by(f64::total_cmp);
        Plate { width: sides[1], length: sides[2] }
    }
}

/// What probing found, world frame, metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Per axis, the touches of the moves along it: the one that came from the low side, and the one
    /// from the high side; `None` where a move met nothing, or was not made because of the table.
    pub sides: [[Option<Point>; 2]; 3],
    /// Corners of the box around the object, as far as it was swept; the table's height where nothing
    /// can come from below.
    pub low: Point,
    /// See `low`.
    pub high: Point,
    /// Guarded moves made.
    pub moves: usize,
    /// Corners of the flat hand, likewise, where it touched.
    plates: Plates,
}

/// Per axis and side, least and greatest corner of a flat hand.
type Plates = [[Option<(Point, Point)>; 2]; 3];

impl Probe {
    /// The box that the touches of `sides` delimit.
    fn new(
        sides: [[Option<Point>; 2]; 3],
        plates: Plates,
        table: Option<f64>,
        moves: usize,
    ) -> Probe {
        let touched = || sides.iter().flatten().flatten();
        // A side that no move met ends where the other touches end.
        let end = |axis: usize, side: usize| {
            let along = touched().map(|p| p[axis]);
            match (sides[axis][side], table) {
                (Some(point), _) => point[axis],
                (None, Some(height)) if axis == 2 && side == 0 => height,
                _ if side == 0 => along.fold(f64::INFINITY, f64::min),
                _ => along.fold(f64::NEG_INFINITY, f64::max),
            }
        };
        let corner = |side: usize| Point::from_fn(|axis, _| end(axis, side));
        Probe { sides, low: corner(0), high: corner(1), moves, plates }
    }

    /// The same probing with its touches, in the order of [`Probe::touches`], as a sensor gives them.
    pub(in crate::sim) fn sensed(
        &self,
        mut points: impl Iterator<Item = Point>,
        table: Option<f64>,
    ) -> Probe {
        let mut sides = self.sides;
        for touch in sides.iter_mut().flatten().flatten() {
            *touch = points.next().unwrap_or(*touch);
        }
        Probe::new(sides, self.plates, table, self.moves)
    }

    /// The touches, each with the outward direction of its side.
    pub fn touches(&self) -> impl Iterator<Item = (Point, Point)> + '_ {
        let of = |axis: usize, side: usize| {
            let outward = Point::ith(axis, if side == 0 { -1.0 } else { 1.0 });
            self.sides[axis][side].map(|point| (point, outward))
        };
        (0..6).filter_map(move |k| of(k / 2, k % 2))
    }

    /// Places where the flat hand was and met nothing, 3 mm in front of each touch: 25 for every touch of a
    /// spatial object.
    pub fn clear(&self) -> Vec<Point> {
        let mut clear = Vec::new();
        for (axis, side) in (0..6).map(|k| (k / 2, k % 2)) {
            let (Some(touch), Some(plate)) = (self.sides[axis][side], self.plates[axis][side])
            else {
                continue;
            };
            let front = touch[axis] + if side == 0 { -IN_FRONT } else { IN_FRONT };
            let across = |a: usize, k: usize| {
                let low = (self.low[a] - BESIDE).max(plate.0[a]);
                let high = (self.high[a] + BESIDE).min(plate.1[a]);
                low + (high - low) * (k as f64 + 0.5) / LATTICE as f64
            };
            clear.extend((0..LATTICE * LATTICE).map(|k| {
                let mut place = Point::repeat(front);
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                (place[u], place[v]) = (across(u, k % LATTICE), across(v, k / LATTICE));
                place
            }));
        }
        clear
    }

    /// Where the object may be taken to stand on a table of this height: half-way between the middle of its
    /// box and what was touched from above.
    pub fn foot(&self, table: f64) -> Point {
        let middle = (self.low + self.high) / 2.0;
        let top = self.sides[2][1].unwrap_or(middle);
        let foot = (middle + top) / 2.0;
        Point::new(foot.x, foot.y, table)
    }
}

/// Moves the plate against the object from every side: from above first, then from the sides at half the
/// height found. `None` when no move meets anything.
pub(in crate::sim) fn probe(
    geometry: &Geometry,
    object: &Pose,
    table: Option<f64>,
    plate: &Plate,
) -> Option<Probe> {
    let (mut sides, mut plates) = ([[None; 2]; 3], [[None; 2]; 3]);
    let mut moves = 0;
    // What is known of the object's box, NaN where nothing is.
    let (mut low, mut high) = (Point::repeat(f64::NAN), Point::repeat(f64::NAN));
    if let Some(height) = table {
        low.z = height;
    }
    for (axis, side) in [(2, 1), (2, 0), (0, 0), (0, 1), (1, 0), (1, 1)] {
        if axis == 2 && (geometry.dimension() == 2 || side == 0 && table.is_some()) {
            continue;
        }
        moves += 1;
        let mut middle = Point::from_fn(|a, _| {
            let known = (low[a] + high[a]) / 2.0;
            if known.is_nan() { table.filter(|_| a == 2).unwrap_or(0.0) } else { known }
        });
        let mut half = Point::repeat(plate.length / 2.0);
        if axis == 2 {
            half.y = plate.width / 2.0;
        } else {
            half.z = plate.width / 2.0;
            if let Some(height) = table {
                middle.z = middle.z.max(height + half.z + GAP);
            }
        }
        half[axis] = HALF_THICKNESS;
        let sign = if side == 0 { 1.0 } else { -1.0 };
        let touch = guarded(geometry, object, &middle, &half, axis, sign, table);
        if let Some(point) = touch {
            sides[axis][side] = Some(point);
            plates[axis][side] = Some((middle - half, middle + half));
            (if side == 0 { &mut low } else { &mut high })[axis] = point[axis];
        }
    }
    sides.iter().flatten().any(Option::is_some).then(|| Probe::new(sides, plates, table, moves))
}

/// Where a plate that moves along an axis through the middle first touches the object.
fn guarded(
    geometry: &Geometry,
    object: &Pose,
    middle: &Point,
    half: &Point,
    axis: usize,
    sign: f64,
    table: Option<f64>,
) -> Option<Point> {
    let far = |p: Point| ((object * nalgebra::Point3::from(p)).coords - middle)[axis].abs();
    let extent = match geometry {
        Geometry::Mesh(mesh) => mesh.vertices().iter().copied().map(far).fold(0.0, f64::max),
        Geometry::Outline(outline) => {
            let corners = outline.loops.iter().flatten().map(|c| Point::new(c[0], c[1], 0.0));
            corners.map(far).fold(0.0, f64::max)
        }
    };
    let away = START.max(extent + BEFORE);
    let start = middle[axis] - sign * away;
    let most = match table {
        Some(height) if axis == 2 => start - height - GAP,
        _ => 2.0 * away,
    };
    match geometry {
        Geometry::Mesh(mesh) => {
            let body = cuboid(half)?;
            let mut from = *middle;
            from[axis] = start;
            sweep(mesh, object, &body, &from, &(sign * Point::ith(axis, 1.0)), most)
        }
        // In the plane: the lowest corner along the way is where a straight edge touches.
        Geometry::Outline(outline) => {
            let corners = outline.loops.iter().flatten();
            let world = corners.map(|c| (object * nalgebra::Point3::new(c[0], c[1], 0.0)).coords);
            let across = 1 - axis.min(1);
            let met = world.filter(|p| (p[across] - middle[across]).abs() <= half[across]);
            met.min_by(|a, b| (sign * a[axis]).total_cmp(&(sign * b[axis])))
                .filter(|p| (0.0..=most).contains(&(sign * (p[axis] - start))))
        }
    }
}

/// Where a plate whose front is at `from` first touches within `most` metres along a unit direction.
fn sweep(
    mesh: &Mesh,
    object: &Pose,
    body: &SharedShape,
    from: &Point,
    direction: &Point,
    most: f64,
) -> Option<Point> {
    let mut along = 0.0;
    let back = object.inverse();
    while along <= most {
        // The front of the plate, not its middle, is where it is.
        let at = from + (along - HALF_THICKNESS) * direction;
        let plate = back * nalgebra::Translation3::from(at);
        let (point, other) = mesh.nearest(&**body, &plate, most - along + TOUCHING)?;
        let distance = (other - point).norm();
        if distance <= TOUCHING {
            return Some((object * nalgebra::Point3::from(point)).coords);
        }
        along += distance - 0.25 * TOUCHING;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::mesh::tests::cuboid;

    #[test]
    fn objects_larger_than_a_hand_are_met_from_outside() {
        // Half a metre up and two across: moves from 0.4 m off the middle would begin inside.
        let mesh = cuboid([1.0, 0.05, 0.3]);
        let geometry = Geometry::Mesh(mesh);
        let object = Pose::translation(0.0, 0.0, 0.3);
        let plate = Plate { width: 0.1, length: 0.2 };
        let found = probe(&geometry, &object, Some(0.0), &plate).unwrap();
        let [x, y, z] = found.sides;
        assert!((z[1].unwrap().z - 0.6).abs() < 1e-3, "{z:?}");
        assert!((x[0].unwrap().x + 1.0).abs() < 1e-3 && (x[1].unwrap().x - 1.0).abs() < 1e-3);
        assert!((y[0].unwrap().y + 0.05).abs() < 1e-3 && (y[1].unwrap().y - 0.05).abs() < 1e-3);
        // The places called clear are.
        assert!(found.clear().iter().all(|p| geometry.distance(&(p - Point::z() * 0.3)) > 2e-3));
    }
}
