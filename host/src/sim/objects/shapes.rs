//! The shapes of the simulator's objects.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};

use super::{Arms, ObjectError, ObjectSpec, SIZES, malformed};
use crate::shape::files::{read_mesh, read_outline};
use crate::shape::{Geometry, Mesh, Outline};
use crate::space::Point;

/// Vertices of an ellipse: 2 µm inside the true curve at 120 mm.
const ELLIPSE: usize = 360;

/// Sides of a cylinder: 8 µm inside at a diameter of 100 mm.
const SIDES: usize = 180;

/// Slices around a sphere and stacks from pole to pole: 30 µm inside at a diameter of 100 mm.
const SLICES: usize = 128;
const STACKS: usize = 64;

impl ObjectSpec {
    /// The shape in the object frame: its centroid at the origin, but a mesh file as it is. Curved
    /// objects are polygons or meshes within 0.1 mm of the true curve at 100 mm.
    ///
    /// # Errors
    /// When a file cannot be read or does not hold one simple polygon or an outward mesh.
    pub fn geometry(&self) -> Result<Geometry, ObjectError> {
        Ok(match self {
            ObjectSpec::Rectangle([w, h]) => {
                let (x, y) = (w / 2.0, h / 2.0);
                outline(vec![[-x, -y], [x, -y], [x, y], [-x, y]])?
            }
            ObjectSpec::Ngon { corners, radius } => {
                let first = if corners % 2 == 1 { PI / 2.0 } else { 0.0 };
                outline(around(*corners, first, [*radius; 2]))?
            }
            ObjectSpec::Ellipse([a, b]) => outline(around(ELLIPSE, 0.0, [a / 2.0, b / 2.0]))?,
            ObjectSpec::Arms(arms) => {
                let (vertices, hub) = arms.polygon();
                match arms.height {
                    None => outline(vertices)?,
                    Some(height) => prism(&vertices, hub, height, 1.0)?,
                }
            }
            ObjectSpec::Polygon(file) => {
                let read = read_outline(file)?;
                let [vertices] = &read.loops[..] else {
                    let found = read.loops.len();
                    return Err(ObjectError::OnePolygon { file: file.clone(), found });
                };
                sized(file, centred(vertices)?)?
            }
            ObjectSpec::Corners(corners) => centred(corners)?,
            ObjectSpec::Prism { base, height } => standing(base, *height, 1.0)?,
            ObjectSpec::Pyramid { base, height, top } => standing(base, *height, *top)?,
            ObjectSpec::Cuboid([x, y, z]) => {
                let corners = [[-x, -y], [*x, -y], [*x, *y], [-x, *y]];
                prism(&corners.map(|[x, y]| [x / 2.0, y / 2.0]), [0.0; 2], *z, 1.0)?
            }
            ObjectSpec::Cylinder { diameter, height } => {
                prism(&around(SIDES, 0.0, [diameter / 2.0; 2]), [0.0; 2], *height, 1.0)?
            }
            ObjectSpec::Sphere(d) => ellipsoid([d / 2.0; 3])?,
            ObjectSpec::Ellipsoid(axes) => ellipsoid(axes.map(|a| a / 2.0))?,
            ObjectSpec::Mesh(file) => {
                let mesh = read_mesh(file)?;
                let litres = 1e3 * mesh.volume();
                if mesh.is_watertight() && litres < 0.0 {
                    return Err(ObjectError::InsideOut { file: file.clone(), litres });
                }
                sized(file, Geometry::Mesh(mesh))?
            }
        })
    }
}

/// What a file holds, which says nothing of its unit.
fn sized(file: &Path, geometry: Geometry) -> Result<Geometry, ObjectError> {
    let (low, high) = geometry.bounds();
    let size = (high - low).amax();
    if SIZES.contains(&size) {
        return Ok(geometry);
    }
    Err(malformed(
        &file.display().to_string(),
        "lengths in metres, and an object from 0.1 mm to 10 m across",
        format!("{size:.4} m across"),
    ))
}

fn outline(vertices: Vec<[f64; 2]>) -> Result<Geometry, ObjectError> {
    Ok(Geometry::Outline(Outline::new(vec![vertices])?))
}

/// The polygon moved to its centroid.
fn centred(vertices: &[[f64; 2]]) -> Result<Geometry, ObjectError> {
    let c = Outline { loops: vec![vertices.to_vec()] }.centroid();
    outline(vertices.iter().map(|v| [v[0] - c.x, v[1] - c.y]).collect())
}

/// `count` points counter-clockwise around an ellipse of these half axes.
fn around(count: usize, first: f64, [a, b]: [f64; 2]) -> Vec<[f64; 2]> {
    let at = |i: usize| {
        let (sin, cos) = (first + TAU * i as f64 / count as f64).sin_cos();
        [a * cos, b * sin]
    };
    (0..count).map(at).collect()
}

impl Arms {
    /// Corners counter-clockwise about the centroid, and the middle of where the arms meet, which
    /// sees all of them.
    fn polygon(&self) -> (Vec<[f64; 2]>, [f64; 2]) {
        let ([w, h], t) = (self.size, self.width);
        let (corners, hub) = if self.tee {
            let (left, right) = ((w - t) / 2.0, (w + t) / 2.0);
            let stem = [[left, h - t], [left, 0.0], [right, 0.0], [right, h - t]];
            let bar = [[w, h - t], [w, h], [0.0, h], [0.0, h - t]];
            ([stem, bar].concat(), [w / 2.0, h - t / 2.0])
        } else {
            let corners = [[0.0, 0.0], [w, 0.0], [w, t], [t, t], [t, h], [0.0, h]];
            (corners.to_vec(), [t / 2.0, t / 2.0])
        };
        let c = Outline { loops: vec![corners.clone()] }.centroid();
        let centred = |[x, y]: [f64; 2]| [x - c.x, y - c.y];
        (corners.into_iter().map(centred).collect(), centred(hub))
    }
}

/// A planar object about its centroid, swept along z; see [`prism`].
fn standing(base: &ObjectSpec, height: f64, top: f64) -> Result<Geometry, ObjectError> {
    match base.geometry()? {
        Geometry::Outline(Outline { loops }) => {
            prism(loops.first().map_or(&[], Vec::as_slice), [0.0; 2], height, top)
        }
        solid => Ok(solid),
    }
}

/// A polygon, counter-clockwise, swept along z to one that is `top` times as wide, about the centroid of the two and
/// all between. Its ends are fans about `hub` where that sees all of the polygon.
fn prism(
    polygon: &[[f64; 2]],
    hub: [f64; 2],
    height: f64,
    top: f64,
) -> Result<Geometry, ObjectError> {
    let low = -0.5 * height * ((0.5 + top + 1.5 * top * top) / (1.0 + top + top * top));
    let high = low + height;
    let at = |v: &[f64; 2], scale: f64, z: f64| Point::new(scale * v[0], scale * v[1], z);
    let n = polygon.len() as u32;
    let mut vertices: Vec<Point> = polygon.iter().map(|v| at(v, 1.0, low)).collect();
    let has_top = top > 0.0;
    if has_top {
        vertices.extend(polygon.iter().map(|v| at(v, top, high)));
    }
    let is_fan = sees(hub, polygon);
    // The middles of both ends; the upper one is the tip where there is one.
    let bottom = vertices.len() as u32;
    if is_fan {
        vertices.push(at(&hub, 1.0, low));
    }
    let upper = vertices.len() as u32;
    if is_fan || !has_top {
        vertices.push(at(&hub, top, high));
    }
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for i in 0..n {
        let j = (i + 1) % n;
        if has_top {
            triangles.extend([[i, j, n + j], [i, n + j, n + i]]);
        } else {
            triangles.push([i, j, upper]);
        }
        if is_fan {
            triangles.push([bottom, j, i]);
        }
        if is_fan && has_top {
            triangles.push([upper, n + i, n + j]);
        }
    }
    if !is_fan {
        // The ends of a ring cut open have no corners of their own.
        if let Some((_, [x, y])) =
            polygon.iter().enumerate().find(|(i, v)| polygon[..*i].contains(v))
        {
            let expected = "a base whose corners all differ";
            return Err(malformed("prism", expected, format!("({x}, {y}) m twice")));
        }
        for [a, b, c] in triangulated(polygon) {
            triangles.push([c, b, a]);
            if has_top {
                triangles.push([n + a, n + b, n + c]);
            }
        }
    }
    Ok(Geometry::Mesh(Mesh::new(vertices, triangles)?))
}

/// Whether every side of a polygon, counter-clockwise, is seen from there.
fn sees([x, y]: [f64; 2], polygon: &[[f64; 2]]) -> bool {
    let mut sides = polygon.iter().zip(polygon.iter().cycle().skip(1));
    sides.all(|(a, b)| (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x) > 0.0)
}

/// Triangles between the corners of a simple polygon that fill it, counter-clockwise.
fn triangulated(polygon: &[[f64; 2]]) -> Vec<[u32; 3]> {
    let corners = polygon.iter().map(|v| Point2::new(v[0], v[1])).collect();
    let n = polygon.len();
    let sides = (0..n).map(|i| [i, (i + 1) % n]).collect();
    // A simple polygon has no conflicting sides, nor coordinates that are refused.
    let Ok(all) = ConstrainedDelaunayTriangulation::<_>::try_bulk_load_cdt(corners, sides, |_| ())
    else {
        return Vec::new();
    };
    let outline = Outline { loops: vec![polygon.to_vec()] };
    let is_inside = |[a, b, c]: &[[f64; 2]; 3]| {
        let middle = [0, 1].map(|k| (a[k] + b[k] + c[k]) / 3.0);
        outline.contains(&Point::new(middle[0], middle[1], 0.0))
    };
    let corners = |i: [usize; 3]| i.map(|i| polygon[i]);
    let all = all.inner_faces().map(|face| face.vertices().map(|v| v.index()));
    all.filter(|i| is_inside(&corners(*i))).map(|i| i.map(|i| i as u32)).collect()
}

/// Stacks of slices between two poles.
fn ellipsoid(half: [f64; 3]) -> Result<Geometry, ObjectError> {
    let slices = SLICES as u32;
    let mut vertices = vec![Point::new(0.0, 0.0, -half[2])];
    for stack in 1..STACKS {
        let (sin, cos) = (PI * stack as f64 / STACKS as f64).sin_cos();
        let ring = around(SLICES, 0.0, [half[0] * sin, half[1] * sin]);
        vertices.extend(ring.iter().map(|v| Point::new(v[0], v[1], -half[2] * cos)));
    }
    vertices.push(Point::new(0.0, 0.0, half[2]));
    let (north, last) = (vertices.len() as u32 - 1, 1 + (STACKS as u32 - 2) * slices);
    let mut triangles = Vec::new();
    for i in 0..slices {
        let j = (i + 1) % slices;
        triangles.push([0, 1 + j, 1 + i]);
        for ring in (1..last).step_by(SLICES) {
            let next = ring + slices;
            triangles.push([ring + i, ring + j, next + j]);
            triangles.push([ring + i, next + j, next + i]);
        }
        triangles.push([north, last + i, last + j]);
    }
    Ok(Geometry::Mesh(Mesh::new(vertices, triangles)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(text: &str) -> ObjectSpec {
        text.parse().unwrap()
    }

    fn mesh(text: &str) -> Mesh {
        match spec(text).geometry().unwrap() {
            Geometry::Mesh(mesh) => mesh,
            other => panic!("{text}: {other:?}"),
        }
    }

    fn outline_of(text: &str) -> Outline {
        match spec(text).geometry().unwrap() {
            Geometry::Outline(outline) => outline,
            other => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn planar_objects_have_their_sizes() {
        let rectangle = outline_of("rectangle:0.12x0.06");
        assert!((rectangle.area() - 0.0072).abs() < 1e-15);
        for (text, corners) in [("triangle:0.05", 3.0), ("hexagon:0.05", 6.0), ("ngon:5,0.05", 5.0)]
        {
            let outline = outline_of(text);
            let area = 0.5 * corners * 0.0025 * (TAU / corners).sin();
            assert!((outline.area() - area).abs() < 1e-12, "{text}");
            assert!(outline.centroid().norm() < 1e-12, "{text}");
        }
        for text in ["lshape:0.09x0.08x0.03", "tshape:0.09x0.08x0.03"] {
            let outline = outline_of(text);
            assert!((outline.area() - 0.03 * (0.09 + 0.05)).abs() < 1e-15, "{text}");
            assert!(outline.centroid().norm() < 1e-12, "{text}");
            let (low, high) = outline.bounds();
            assert!((high - low - Point::new(0.09, 0.08, 0.0)).norm() < 1e-12, "{text}");
        }
        let ellipse = outline_of("ellipse:0.12x0.06");
        for (p, _) in ellipse.samples(1000) {
            let level = (p.x / 0.06).hypot(p.y / 0.03);
            assert!((level - 1.0).abs() * 0.06 < 1e-5);
        }
    }

    #[test]
    fn spatial_objects_are_closed_outward_and_true_to_size() {
        let volumes = [
            ("box:0.12x0.06x0.05", 0.12 * 0.06 * 0.05),
            ("cylinder:0.1x0.12", PI * 0.0025 * 0.12),
            ("lshape:0.09x0.08x0.03x0.05", 0.03 * 0.14 * 0.05),
            ("tshape:0.09x0.08x0.03x0.05", 0.03 * 0.14 * 0.05),
            ("prism:0.05,corners:-0.03x-0.02,0.06x-0.02,-0.03x0.045", 0.09 * 0.065 / 2.0 * 0.05),
            ("pyramid:0.09,rectangle:0.09x0.08", 0.09 * 0.08 * 0.09 / 3.0),
            ("frustum:0.06,0.5,rectangle:0.09x0.08", 0.09 * 0.08 * 0.06 * 1.75 / 3.0),
            ("prism:0.05,tshape:0.09x0.08x0.03", 0.03 * 0.14 * 0.05),
            ("frustum:0.06,0.5,lshape:0.09x0.08x0.03", 0.03 * 0.14 * 0.06 * 1.75 / 3.0),
            ("pyramid:0.06,lshape:0.09x0.08x0.03", 0.03 * 0.14 * 0.06 / 3.0),
            ("pyramid:0.1,ellipse:0.08x0.06", PI * 0.04 * 0.03 * 0.1 / 3.0),
            ("sphere:0.1", PI / 6.0 * 1e-3),
            ("ellipsoid:0.12x0.08x0.06", PI / 6.0 * 0.12 * 0.08 * 0.06),
        ];
        for (text, volume) in volumes {
            let mesh = mesh(text);
            assert!(mesh.is_watertight(), "{text}");
            assert!((mesh.volume() / volume - 1.0).abs() < 2e-3, "{text}: {}", mesh.volume());
            assert!(mesh.centroid().norm() < 1e-12, "{text}");
        }
        for (p, n) in mesh("sphere:0.1").samples(5000) {
            assert!((p.norm() - 0.05).abs() < 1e-4 && n.dot(&p.normalize()) > 0.999);
        }
        for (p, _) in mesh("cylinder:0.1x0.12").samples(5000) {
            let (wall, cap) = ((p.x.hypot(p.y) - 0.05).abs(), (p.z.abs() - 0.06).abs());
            assert!(wall.min(cap) < 1e-4 && p.z.abs() < 0.06 + 1e-9);
        }
    }

    #[test]
    fn files_give_polygons_at_their_centroid_and_meshes_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("block.csv");
        std::fs::write(&path, "0,0\n0,0.15\n0.15,0\n").unwrap();
        let outline = outline_of(&format!("polygon:{}", path.display()));
        assert!(outline.centroid().norm() < 1e-15 && (outline.area() - 0.01125).abs() < 1e-12);

        std::fs::write(&path, "loop,x,y\n0,0,0\n0,1,0\n0,1,1\n1,3,3\n1,4,3\n1,4,4\n").unwrap();
        let error = spec(&format!("polygon:{}", path.display())).geometry().unwrap_err();
        assert!(error.to_string().contains("expected one polygon, found 2"), "{error}");

        let path = folder.path().join("inside-out.off");
        let faces = "3 0 1 2\n3 0 3 1\n3 0 2 3\n3 1 3 2\n";
        std::fs::write(&path, format!("OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n{faces}")).unwrap();
        let error = ObjectSpec::Mesh(path).geometry().unwrap_err().to_string();
        assert!(error.contains("expected triangles that face outwards"), "{error}");
    }
}
