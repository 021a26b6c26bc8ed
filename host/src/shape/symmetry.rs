//! The turns that map a shape to itself: what no estimate of its pose can tell apart.

use nalgebra::{Matrix3, Translation3, Unit, UnitQuaternion, Vector3};

use super::{Geometry, Mesh};
use crate::space::{Point, Pose};

/// A turned shape coincides with itself when no point is farther from the surface than this share of
/// the greatest distance from the centre: what contacts known to a millimetre cannot tell apart.
const TOLERANCE: f64 = 0.01;

/// The same where only rounding is let pass, that of a circle to a polygon of a hundred sides included.
const EXACT: f64 = 5e-4;

/// Turns farther off than this share are not worth refining.
const PROMISING: f64 = 0.2;

/// Finest finite turn that is looked for: shapes with more corners are round at the tolerance.
const FINEST: usize = 24;

/// Finest finite turn about an axis in space, and the finest of what is round at the tolerance and no more: a mesh of
/// a round thing has so many sides at most, and is taken for round.
const FINEST_IN_SPACE: usize = 12;
const SIDES: usize = 128;

/// Points drawn from the surface, and vertices looked at besides.
const SAMPLES: usize = 240;
const VERTICES: usize = 400;

/// Farthest vertices whose directions, and the middles of whose pairs, may be axes.
const FARTHEST: usize = 12;

/// Turns that are a multiple of no fraction of a full one, radians.
const GENERIC: [f64; 4] = [0.37, 1.13, 1.97, 2.81];

/// Elements of the largest finite group of turns, the icosahedron's.
const LARGEST: usize = 60;

/// Two turns closer than this are one, radians.
const SAME: f64 = 0.05;

/// Turns that are free.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Free {
    /// None: the group is finite.
    None,
    /// Any turn about this axis.
    Axis(Unit<Vector3<f64>>),
    /// All of them: the shape is round.
    All,
}

/// The group of proper turns about the centroid that map a shape to itself.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tactile_host::shape::symmetry::Symmetry;
/// use tactile_host::sim::ObjectSpec;
///
/// let hexagon: ObjectSpec = "hexagon:0.045".parse()?;
/// let symmetry = Symmetry::of(&hexagon.geometry()?);
/// assert_eq!(symmetry.order(), Some(6));
/// let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * 62f64.to_radians());
/// assert!((symmetry.angle(&turn).to_degrees() - 2.0).abs() < 1e-6);
/// # Ok::<(), tactile_host::sim::objects::ObjectError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetry {
    centre: Point,
    /// The finite part, identity first; with a free axis one for each of its two directions at most.
    turns: Vec<UnitQuaternion<f64>>,
    free: Free,
}

impl Symmetry {
    /// Of something of which nothing is known: the identity alone.
    pub fn none() -> Symmetry {
        Symmetry {
            centre: Point::zeros(),
            turns: vec![UnitQuaternion::identity()],
            free: Free::None,
        }
    }

    /// Of a shape: exact in the plane; in space from the principal axes and the farthest corners,
    /// refined until the shape coincides with itself, which finds the groups of prisms, boxes,
    /// regular solids and bodies of revolution. Of nothing, only the identity.
    pub fn of(shape: &Geometry) -> Symmetry {
        match shape {
            Geometry::Mesh(mesh) => {
                let closest = |p: &Point| mesh.closest(p);
                Search { refine: true, ..Search::of_mesh(mesh, TOLERANCE, &closest) }.spatial(mesh)
            }
            Geometry::Outline(outline) => {
                let corners = outline.loops.iter().flatten();
                let vertices = corners.map(|v| Point::new(v[0], v[1], 0.0)).collect();
                let (centre, closest) = (shape.centroid(), |p: &Point| shape.closest(p));
                Search::new(centre, vertices, shape.samples(SAMPLES), TOLERANCE, &closest).planar()
            }
        }
    }

    /// Of a mesh, its nearest points told by `closest`, but only turns that map it to itself exactly, and no
    /// search for better ones: quick, and of what was scanned the identity alone.
    pub fn exact(mesh: &Mesh, closest: &dyn Fn(&Point) -> Point) -> Symmetry {
        Search::of_mesh(mesh, EXACT, closest).spatial(mesh)
    }

    /// The point that every turn leaves where it is: the centroid, object frame.
    pub fn centre(&self) -> Point {
        self.centre
    }

    /// How many turns there are, the identity included; `None` when some are free.
    pub fn order(&self) -> Option<usize> {
        matches!(self.free, Free::None).then_some(self.turns.len())
    }

    /// The direction about which every turn is one of the group; `None` where there is none, or any will do.
    pub fn axis(&self) -> Option<Unit<Vector3<f64>>> {
        match self.free {
            Free::Axis(axis) => Some(axis),
            Free::None | Free::All => None,
        }
    }

    /// The finite part as motions of the shape, identity first.
    pub fn motions(&self) -> impl Iterator<Item = Pose> {
        self.turns.iter().map(|turn| self.motion(turn))
    }

    /// A turn about the centre.
    pub fn motion(&self, turn: &UnitQuaternion<f64>) -> Pose {
        let about = Translation3::from(self.centre);
        about * *turn * about.inverse()
    }

    /// The turn of the group that is nearest to `turn`.
    pub fn nearest(&self, turn: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        if self.free == Free::All {
            return *turn;
        }
        let candidates = self.turns.iter().map(|element| match self.free {
            Free::Axis(axis) => twist(&(turn * element.inverse()), &axis) * element,
            _ => *element,
        });
        let off = |element: &UnitQuaternion<f64>| element.angle_to(turn);
        candidates.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or_default()
    }

    /// What is left of a displacement (object frame) when the turn of the group nearest to it is taken back.
    pub fn rest(&self, displacement: &Pose) -> Pose {
        displacement * self.motion(&self.nearest(&displacement.rotation).inverse())
    }

    /// How far `turn` is from mapping the shape to itself, radians.
    pub fn angle(&self, turn: &UnitQuaternion<f64>) -> f64 {
        self.nearest(turn).angle_to(turn)
    }
}

/// The part of a turn that is about `axis`: what is left of it is as small as can be.
fn twist(turn: &UnitQuaternion<f64>, axis: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    let (along, w) = (turn.imag().dot(axis), turn.w);
    if along.hypot(w) < 1e-12 {
        return UnitQuaternion::identity();
    }
    UnitQuaternion::from_axis_angle(axis, 2.0 * along.atan2(w))
}

struct Search<'a> {
    /// On the surface, nearest to a point.
    closest: &'a dyn Fn(&Point) -> Point,
    centre: Point,
    /// On the surface, about the centre.
    points: Vec<Point>,
    /// Vertices of the shape about the centre.
    vertices: Vec<Point>,
    /// From the centre to the farthest vertex.
    reach: f64,
    /// Share of the reach that a turned surface may be off itself.
    tolerance: f64,
    /// Whether turns that are not quite right are refined.
    refine: bool,
}

impl<'a> Search<'a> {
    fn new(
        centre: Point,
        mut vertices: Vec<Point>,
        samples: Vec<(Point, Point)>,
        tolerance: f64,
        closest: &'a dyn Fn(&Point) -> Point,
    ) -> Self {
        vertices.iter_mut().for_each(|v| *v -= centre);
        let stride = vertices.len().div_ceil(VERTICES).max(1);
        let mut points: Vec<Point> = samples.into_iter().map(|(p, _)| p - centre).collect();
        points.extend(vertices.iter().step_by(stride));
        let reach = vertices.iter().map(Vector3::norm).fold(0.0, f64::max);
        // What is not a point is symmetric to nothing.
        if !(reach.is_finite() && reach > 0.0) {
            points.clear();
        }
        Search { closest, centre, points, vertices, reach, tolerance, refine: false }
    }

    fn of_mesh(mesh: &Mesh, tolerance: f64, closest: &'a dyn Fn(&Point) -> Point) -> Self {
        // Triangle by triangle, so that the few that are looked at lie all over it.
        let used = mesh.triangles().iter().flatten();
        let vertices = used.filter_map(|v| mesh.vertices().get(*v as usize)).copied().collect();
        Search::new(mesh.centroid(), vertices, mesh.samples(SAMPLES), tolerance, closest)
    }

    fn found(self, turns: Vec<UnitQuaternion<f64>>, free: Free) -> Symmetry {
        Symmetry { centre: self.centre, turns, free }
    }

    /// From the surface to a point about the centre.
    fn gap(&self, p: &Point) -> Vector3<f64> {
        let p = self.centre + p;
        p - (self.closest)(&p)
    }

    /// Whether the turned surface stays within so many reaches of itself.
    fn maps(&self, turn: &UnitQuaternion<f64>, tolerance: f64) -> bool {
        let most = tolerance * self.reach;
        self.points.iter().all(|p| self.gap(&(turn * p)).norm() <= most)
    }

    fn planar(self) -> Symmetry {
        if self.points.is_empty() {
            return self.found(vec![UnitQuaternion::identity()], Free::None);
        }
        let about = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        if self.is_free(&Vector3::z_axis()) {
            return self.found(vec![UnitQuaternion::identity()], Free::Axis(Vector3::z_axis()));
        }
        let part = |n: usize| std::f64::consts::TAU / n as f64;
        // All turns of it: those of one that is nearly round are near for small angles alone.
        let is_order =
            |n: &usize| (1..=n / 2).all(|k| self.maps(&about(k as f64 * part(*n)), self.tolerance));
        let order = (2..=FINEST).rev().find(is_order).unwrap_or(1);
        self.found((0..order).map(|k| about(k as f64 * part(order))).collect(), Free::None)
    }

    fn is_free(&self, axis: &Unit<Vector3<f64>>) -> bool {
        let maps = |angle: f64, tolerance: f64| {
            self.maps(&UnitQuaternion::from_axis_angle(axis, angle), tolerance)
        };
        let is_round = |tolerance: f64| GENERIC.iter().all(|angle| maps(*angle, tolerance));
        let mut sides = FINEST_IN_SPACE + 1..=SIDES;
        // What is nearly round maps to itself by small turns alone.
        let is_side = |n: usize| {
            let part = std::f64::consts::TAU / n as f64;
            (1..=n / 2).all(|k| maps(k as f64 * part, self.tolerance))
        };
        is_round(self.tolerance) || is_round(TOLERANCE) && sides.any(is_side)
    }

    fn spatial(self, mesh: &Mesh) -> Symmetry {
        let identity = UnitQuaternion::identity();
        if self.points.is_empty() {
            return self.found(vec![identity], Free::None);
        }
        let principal = principal_axes(mesh, &self.centre);
        let free: Vec<_> = principal.into_iter().filter(|axis| self.is_free(axis)).collect();
        match free[..] {
            [] => (),
            [axis] => {
                let across = Unit::new_normalize(axis.cross(&Vector3::ith(axis.iamin(), 1.0)));
                let flip = UnitQuaternion::from_axis_angle(&across, std::f64::consts::PI);
                let both = self.maps(&flip, self.tolerance);
                let turns = if both { vec![identity, flip] } else { vec![identity] };
                return self.found(turns, Free::Axis(axis));
            }
            _ => return self.found(vec![identity], Free::All),
        }
        let mut group = vec![identity];
        for axis in principal.into_iter().chain(self.corner_axes()) {
            for n in 2..=FINEST_IN_SPACE {
                let turn = UnitQuaternion::from_axis_angle(&axis, std::f64::consts::TAU / n as f64);
                let first = if self.refine { PROMISING } else { self.tolerance };
                if is_new(&group, &turn) && self.maps(&turn, first) {
                    let turn = if self.refine { self.refined(turn) } else { turn };
                    if is_new(&group, &turn) && self.maps(&turn, self.tolerance) {
                        group.push(turn);
                    }
                }
            }
        }
        self.found(closed(group), Free::None)
    }

    /// Directions of the farthest corners and of the middles between two of them; none where many
    /// are equally far.
    fn corner_axes(&self) -> Vec<Unit<Vector3<f64>>> {
        let mut farthest: Vec<Point> = Vec::new();
        for v in &self.vertices {
            let far = v.norm() > (1.0 - 1e-3) * self.reach;
            if far && !farthest.iter().any(|f| (f - v).norm() < TOLERANCE * self.reach) {
                farthest.push(*v);
            }
            if farthest.len() > FARTHEST {
                return Vec::new();
            }
        }
        let mut axes: Vec<Unit<Vector3<f64>>> = Vec::new();
        for (i, a) in farthest.iter().enumerate() {
            for b in &farthest[i..] {
                if let Some(axis) = Unit::try_new(a + b, 0.1 * self.reach)
                    && !axes.iter().any(|known| known.dot(&axis).abs() > 1.0 - 1e-4)
                {
                    axes.push(axis);
                }
            }
        }
        axes
    }

    /// Gauss–Newton on the distances of the turned points to the surface.
    fn refined(&self, mut turn: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        const ITERATIONS: usize = 12;
        for _ in 0..ITERATIONS {
            let (mut square, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for p in &self.points {
                let moved = turn * p;
                let gap = self.gap(&moved);
                let distance = gap.norm();
                if distance > 1e-12 {
                    let row = moved.cross(&(gap / distance));
                    square += row * row.transpose();
                    right -= row * distance;
                }
            }
            let damped = square + Matrix3::identity() * (1e-9 + 1e-6 * square.trace());
            let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else { break };
            turn = UnitQuaternion::from_scaled_axis(step) * turn;
            if step.norm() < 1e-9 {
                break;
            }
        }
        turn
    }
}

fn is_new(group: &[UnitQuaternion<f64>], turn: &UnitQuaternion<f64>) -> bool {
    !group.iter().any(|known| known.angle_to(turn) < SAME)
}

/// All products of the elements.
fn closed(mut group: Vec<UnitQuaternion<f64>>) -> Vec<UnitQuaternion<f64>> {
    let mut next = 0;
    while next < group.len() && group.len() < LARGEST {
        for k in 0..=next {
            for product in [group[next] * group[k], group[k] * group[next]] {
                if is_new(&group, &product) {
                    group.push(product);
                }
            }
        }
        next += 1;
    }
    group.truncate(LARGEST);
    group
}

/// Principal axes of the surface about `centre`, from its exact second moments.
fn principal_axes(mesh: &Mesh, centre: &Point) -> [Unit<Vector3<f64>>; 3] {
    let mut moments = Matrix3::zeros();
    for t in mesh.triangles() {
        let corners = t.map(|v| mesh.vertices()[v as usize] - centre);
        let [a, b, c] = corners;
        let area = (b - a).cross(&(c - a)).norm() / 2.0;
        let sum = a + b + c;
        let own: Matrix3<f64> = corners.iter().map(|p| p * p.transpose()).sum();
        moments += (own + sum * sum.transpose()) * (area / 12.0);
    }
    let axes = moments.symmetric_eigen().eigenvectors;
    [0, 1, 2].map(|i| Unit::new_normalize(axes.column(i).into_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Mesh, Outline};
    use crate::sim::ObjectSpec;
    use crate::space::Pose;
    use proptest::prelude::*;
    use std::f64::consts::{PI, TAU};

    fn geometry(text: &str) -> Geometry {
        text.parse::<ObjectSpec>().unwrap().geometry().unwrap()
    }

    fn about(axis: Vector3<f64>, angle: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(axis.normalize() * angle)
    }

    #[test]
    fn planar_shapes_have_their_orders() {
        for (text, order) in [
            ("rectangle:0.12x0.06", Some(2)),
            ("rectangle:0.06x0.06", Some(4)),
            ("triangle:0.06", Some(3)),
            ("hexagon:0.045", Some(6)),
            ("ngon:7,0.05", Some(7)),
            ("ellipse:0.1x0.06", Some(2)),
            ("ellipse:0.1x0.097", Some(2)),
            ("ellipse:0.06x0.06", None),
            ("lshape:0.09x0.09x0.035", Some(1)),
            ("tshape:0.09x0.09x0.03", Some(1)),
        ] {
            assert_eq!(Symmetry::of(&geometry(text)).order(), order, "{text}");
        }
    }

    #[test]
    fn spatial_shapes_have_their_orders() {
        for (text, order) in [
            ("box:0.12x0.06x0.05", Some(4)),
            ("box:0.12x0.06x0.06", Some(8)),
            ("box:0.06x0.06x0.06", Some(24)),
            ("lshape:0.09x0.09x0.035x0.05", Some(2)),
            ("lshape:0.1x0.08x0.035x0.05", Some(1)),
            ("tshape:0.09x0.09x0.03x0.05", Some(2)),
            ("ellipsoid:0.12x0.08x0.06", Some(4)),
            ("ellipsoid:0.12x0.08x0.08", None),
            ("cylinder:0.06x0.1", None),
            ("sphere:0.08", None),
        ] {
            assert_eq!(Symmetry::of(&geometry(text)).order(), order, "{text}");
        }
    }

    #[test]
    fn what_is_nearly_symmetric_is_not_exactly() {
        let order = |mesh: &Mesh| Symmetry::exact(mesh, &|p| mesh.closest(p)).order();
        for (text, expected) in [
            ("box:0.12x0.06x0.05", Some(4)),
            ("box:0.06x0.06x0.06", Some(24)),
            ("lshape:0.09x0.09x0.035x0.05", Some(2)),
            ("ellipsoid:0.12x0.08x0.06", Some(4)),
            ("cylinder:0.06x0.1", None),
        ] {
            let Geometry::Mesh(mesh) = geometry(text) else { panic!("{text}") };
            assert_eq!(order(&mesh), expected, "{text}");
            // Wider at one end, by some tenths of a millimetre.
            let wider = |v: &Point| Point::new(v.x, v.y * (1.0 + 0.1 * v.x), v.z);
            let vertices = mesh.vertices().iter().map(wider).collect();
            let mesh = Mesh::new(vertices, mesh.triangles().to_vec()).unwrap();
            assert!(order(&mesh) != expected, "{text}");
        }
    }

    #[test]
    fn bodies_of_revolution_turn_freely_about_their_axis_only() {
        let cylinder = Symmetry::of(&geometry("cylinder:0.06x0.1"));
        assert!(cylinder.angle(&about(Point::z(), 1.234)) < 1e-6);
        assert!(cylinder.angle(&about(Point::new(0.3, 0.7, 0.0), PI)) < 1e-6);
        let both = about(Point::x(), 0.2) * about(Point::z(), -2.0);
        assert!((cylinder.angle(&both) - 0.2).abs() < 1e-6);
        let sphere = Symmetry::of(&geometry("sphere:0.08"));
        assert!(sphere.angle(&both) < 1e-9);
        // A cone has a tip and a base.
        let n = 63;
        let rim = |i: u32| about(Point::z(), TAU * f64::from(i) / f64::from(n)) * Point::x() * 0.03;
        let mut vertices: Vec<Point> = (0..n).map(rim).collect();
        vertices.extend([Point::zeros(), Point::new(0.0, 0.0, 0.09)]);
        let triangles = (0..n).flat_map(|i| [[i, (i + 1) % n, n + 1], [(i + 1) % n, i, n]]);
        let cone = Geometry::Mesh(Mesh::new(vertices, triangles.collect()).unwrap());
        let cone = Symmetry::of(&cone);
        assert!(cone.angle(&about(Point::z(), 1.0)) < 1e-6);
        assert!((cone.angle(&about(Point::x(), PI)) - PI).abs() < 1e-6);
    }

    #[test]
    fn nothing_is_symmetric_to_itself_alone() {
        let nothing = Symmetry::of(&Geometry::Outline(Outline { loops: vec![] }));
        assert_eq!(nothing.order(), Some(1));
        assert_eq!(Symmetry::of(&Geometry::Mesh(Mesh::default())).order(), Some(1));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(6))]

        /// Wherever the shape lies, every turn of its group maps it to itself.
        #[test]
        fn groups_move_with_their_shape(
            shift in proptest::array::uniform3(-0.2f64..0.2),
            turn in proptest::array::uniform3(-2.0f64..2.0),
        ) {
            let pose = Pose::new(shift.into(), turn.into());
            for (text, order) in [("box:0.12x0.06x0.06", 8), ("tshape:0.09x0.09x0.03x0.05", 2)] {
                let shape = geometry(text);
                let moved = shape.transformed(&pose);
                let symmetry = Symmetry::of(&moved);
                prop_assert_eq!(symmetry.order(), Some(order));
                let at_home = Symmetry::of(&shape);
                for element in &at_home.turns {
                    let there = pose.rotation * element * pose.rotation.inverse();
                    prop_assert!(symmetry.angle(&there) < 2e-3, "{}", symmetry.angle(&there));
                }
            }
        }

        /// The nearest element leaves no more than any other.
        #[test]
        fn nothing_is_nearer_than_the_nearest(turn in proptest::array::uniform3(-2.0f64..2.0)) {
            let symmetry = Symmetry::of(&geometry("hexagon:0.05"));
            let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * turn[0]);
            let least = (0..6).map(|k| about(Point::z(), f64::from(k) * TAU / 6.0).angle_to(&turn));
            prop_assert!((symmetry.angle(&turn) - least.fold(9.0, f64::min)).abs() < 1e-7);
        }
    }
}
