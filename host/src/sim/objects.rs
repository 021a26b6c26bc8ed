//! Objects as the command line describes them.

use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::quantity;
use crate::shape::files::{FileError, MESH_ENDINGS, read_mesh, read_outline};
use crate::shape::{Geometry, Mesh, Outline, ShapeError};
use crate::space::Point;

/// What exists, for help and error messages.
pub const KINDS: &str = "rectangle:WxH, triangle:R, hexagon:R, ngon:N,R (R the circumradius), \
    ellipse:AxB, lshape:WxHxT or tshape:WxHxT (arms T wide; WxHxTxZ a prism), polygon:FILE, \
    corners:XxY,XxY,… (convex, counter-clockwise), prism:Z,OBJECT (a convex planar object Z tall), \
    box:XxYxZ, cylinder:DxH, sphere:D, ellipsoid:AxBxC, or a mesh file (.ply, .stl, .obj, .off)";

/// The greatest number of corners of a polygon.
const MOST_CORNERS: usize = 1000;

/// Smallest and greatest length that is taken for an object's, metres. Beyond them a unit was
/// forgotten: `120x60mm` is 120 metres long.
const SIZES: std::ops::RangeInclusive<f64> = 1e-4..=10.0;

/// Vertices of an ellipse: 2 µm inside the true curve at 120 mm.
const ELLIPSE: usize = 360;

/// Sides of a cylinder: 8 µm inside at a diameter of 100 mm.
const SIDES: usize = 180;

/// Slices around a sphere and stacks from pole to pole: 30 µm inside at a diameter of 100 mm.
const SLICES: usize = 128;
const STACKS: usize = 64;

/// An object of the simulator; all lengths in metres.
#[derive(Clone, Debug, PartialEq)]
pub enum ObjectSpec {
    /// `rectangle:WxH`.
    Rectangle([f64; 2]),
    /// `triangle:R`, `hexagon:R`, `ngon:N,R`: a regular polygon with a corner on +x (+y when the
    /// number of corners is odd).
    Ngon {
        /// At least 3.
        corners: usize,
        /// From the centre to a corner.
        radius: f64,
    },
    /// `ellipse:AxB`, full lengths of the axes.
    Ellipse([f64; 2]),
    /// `lshape:WxHxT`, `tshape:WxHxT` in the plane, with a fourth length Z a prism that tall.
    Arms(Arms),
    /// `polygon:FILE`, see [`read_outline`]; moved to its centroid.
    Polygon(PathBuf),
    /// `corners:XxY,XxY,…`, a convex polygon counter-clockwise; moved to its centroid.
    Corners(Vec<[f64; 2]>),
    /// `prism:Z,OBJECT`: a convex planar object swept along z.
    Prism {
        /// Rectangle, regular polygon, ellipse or corners.
        base: Box<ObjectSpec>,
        /// Along z.
        height: f64,
    },
    /// `box:XxYxZ`.
    Cuboid([f64; 3]),
    /// `cylinder:DxH`, standing on z.
    Cylinder {
        /// Across.
        diameter: f64,
        /// Along z.
        height: f64,
    },
    /// `sphere:D`, the diameter.
    Sphere(f64),
    /// `ellipsoid:AxBxC`, full lengths of the axes.
    Ellipsoid([f64; 3]),
    /// A mesh file, in its own frame.
    Mesh(PathBuf),
}

/// Two arms of one width in an L or a T: concave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arms {
    /// One arm in the middle of the other (T), not at its end (L).
    pub tee: bool,
    /// Over all, along x and y.
    pub size: [f64; 2],
    /// Of both arms; below either size.
    pub width: f64,
    /// Along z; `None` in the plane.
    pub height: Option<f64>,
}

/// Why a text describes no object, or an object has no geometry.
#[derive(Debug, thiserror::Error)]
pub enum ObjectError {
    /// No such kind.
    #[error("unknown object {text:?}: expected {KINDS}")]
    Unknown {
        /// What was asked for.
        text: String,
    },
    /// The kind exists, its sizes are wrong.
    #[error("object {text:?}: expected {expected}, found {found}")]
    Size {
        /// What was asked for.
        text: String,
        /// How the kind is written.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The file cannot be used.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file holds something else than one polygon.
    #[error("{}: expected one polygon, found {found}", file.display())]
    OnePolygon {
        /// Which file.
        file: PathBuf,
        /// How many there are.
        found: usize,
    },
    /// The mesh cannot be touched everywhere from outside.
    #[error("{}: expected triangles that face outwards, found a volume of {litres} l", file.display())]
    InsideOut {
        /// Which file.
        file: PathBuf,
        /// Negative.
        litres: f64,
    },
    /// The vertices make no shape.
    #[error("object: {0}")]
    Shape(#[from] ShapeError),
}

impl FromStr for ObjectSpec {
    type Err = ObjectError;

    fn from_str(text: &str) -> Result<Self, ObjectError> {
        let (kind, size) = text.split_once(':').unwrap_or((text, ""));
        let one = || Ok::<_, ObjectError>(lengths::<1>(text, kind, size, "R")?[0]);
        let file = |expected: &str| match size {
            "" => Err(malformed(text, expected, "no file")),
            _ => Ok(PathBuf::from(size)),
        };
        Ok(match kind {
            "rectangle" => ObjectSpec::Rectangle(lengths(text, kind, size, "WxH")?),
            "triangle" => ObjectSpec::Ngon { corners: 3, radius: one()? },
            "hexagon" => ObjectSpec::Ngon { corners: 6, radius: one()? },
            "ngon" => {
                let expected = "ngon:N,R with 3 to 1000 corners N and the circumradius R";
                let (n, radius) = size.split_once(',').unwrap_or((size, ""));
                let corners: usize = n.trim().parse().unwrap_or(0);
                if !(3..=MOST_CORNERS).contains(&corners) {
                    return Err(malformed(text, expected, format!("{n:?} corners")));
                }
                let [radius] = lengths(text, "ngon:N,", radius, "R")?;
                ObjectSpec::Ngon { corners, radius }
            }
            "ellipse" => ObjectSpec::Ellipse(lengths(text, kind, size, "AxB")?),
            "lshape" | "tshape" => ObjectSpec::Arms(arms(text, kind, size)?),
            "polygon" => ObjectSpec::Polygon(file("polygon:FILE")?),
            "corners" => ObjectSpec::Corners(corners(text, size)?),
            "prism" => {
                let (height, base) = size.split_once(',').unwrap_or((size, ""));
                let [height] = lengths(text, "prism:OBJECT,", height, "Z")?;
                let base: ObjectSpec = base.parse()?;
                if !base.is_convex_outline() {
                    return Err(malformed(
                        text,
                        "prism:Z,OBJECT with a convex planar object",
                        base,
                    ));
                }
                ObjectSpec::Prism { base: Box::new(base), height }
            }
            "box" => ObjectSpec::Cuboid(lengths(text, kind, size, "XxYxZ")?),
            "cylinder" => {
                let [diameter, height] = lengths(text, kind, size, "DxH")?;
                ObjectSpec::Cylinder { diameter, height }
            }
            "sphere" => ObjectSpec::Sphere(lengths::<1>(text, kind, size, "D")?[0]),
            "ellipsoid" => ObjectSpec::Ellipsoid(lengths(text, kind, size, "AxBxC")?),
            _ => {
                let path = Path::new(text);
                let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
                match ending {
                    Some(ending) if MESH_ENDINGS.contains(&ending.as_str()) => {
                        ObjectSpec::Mesh(path.into())
                    }
                    _ => return Err(ObjectError::Unknown { text: text.into() }),
                }
            }
        })
    }
}

fn malformed(text: &str, expected: impl Into<String>, found: impl ToString) -> ObjectError {
    ObjectError::Size { text: text.into(), expected: expected.into(), found: found.to_string() }
}

/// `N` lengths separated by `x`.
fn lengths<const N: usize>(
    text: &str,
    kind: &str,
    size: &str,
    form: &str,
) -> Result<[f64; N], ObjectError> {
    let colon = if kind.ends_with(',') { "" } else { ":" };
    let expected = || format!("{kind}{colon}{form}");
    let parts: Vec<&str> = if size.is_empty() { vec![] } else { size.split('x').collect() };
    if parts.len() != N {
        let found = format!("{} length{}", parts.len(), if parts.len() == 1 { "" } else { "s" });
        return Err(malformed(text, expected(), found));
    }
    let mut values = [0.0; N];
    for (value, part) in values.iter_mut().zip(parts) {
        *value = quantity::positive_length(part)
            .map_err(|e| malformed(text, format!("{} with {}", expected(), e.expected), e.found))?;
        if !SIZES.contains(value) {
            let found = format!("{} m; does a unit such as mm lack?", *value);
            return Err(malformed(text, "lengths from 0.1 mm to 10 m", found));
        }
    }
    Ok(values)
}

/// `XxY,XxY,…`: at least three, convex, counter-clockwise.
fn corners(text: &str, size: &str) -> Result<Vec<[f64; 2]>, ObjectError> {
    let expected =
        "corners:XxY,XxY,… with at least 3 corners of a convex polygon, counter-clockwise";
    let one = |pair: &str| {
        let (x, y) = pair.split_once('x')?;
        let read = |part: &str| quantity::coordinate(part).ok().filter(|v| v.abs() <= *SIZES.end());
        Some([read(x)?, read(y)?])
    };
    let mut corners = Vec::new();
    for pair in size.split(',') {
        corners.push(one(pair.trim()).ok_or_else(|| malformed(text, expected, pair))?);
    }
    let count = corners.len();
    let turns_left = |i: usize| {
        let [a, b, c] = [i, i + 1, i + 2].map(|k| corners[k % count]);
        (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) > 0.0
    };
    let area = Outline { loops: vec![corners.clone()] }.area();
    if !(3..=MOST_CORNERS).contains(&count)
        || !(0..count).all(turns_left)
        || area < SIZES.start().powi(2)
    {
        return Err(malformed(text, expected, size));
    }
    Ok(corners)
}

/// `WxHxT` or `WxHxTxZ`.
fn arms(text: &str, kind: &str, size: &str) -> Result<Arms, ObjectError> {
    let (sizes, height) = match size.split('x').count() {
        4 => {
            let [w, h, t, z] = lengths(text, kind, size, "WxHxTxZ")?;
            ([w, h, t], Some(z))
        }
        _ => (lengths(text, kind, size, "WxHxT or WxHxTxZ")?, None),
    };
    let [w, h, width] = sizes;
    if !(width < w && width < h) {
        let found = format!("arms {width} m wide in {w} m by {h} m");
        return Err(malformed(text, "arms T narrower than W and H", found));
    }
    Ok(Arms { tee: kind == "tshape", size: [w, h], width, height })
}

impl std::fmt::Display for ObjectSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ObjectSpec::Rectangle([w, h]) => write!(f, "rectangle:{w}x{h}"),
            ObjectSpec::Ngon { corners: 3, radius } => write!(f, "triangle:{radius}"),
            ObjectSpec::Ngon { corners: 6, radius } => write!(f, "hexagon:{radius}"),
            ObjectSpec::Ngon { corners, radius } => write!(f, "ngon:{corners},{radius}"),
            ObjectSpec::Ellipse([a, b]) => write!(f, "ellipse:{a}x{b}"),
            ObjectSpec::Arms(Arms { tee, size: [w, h], width, height }) => {
                write!(f, "{}shape:{w}x{h}x{width}", if *tee { "t" } else { "l" })?;
                height.map_or(Ok(()), |z| write!(f, "x{z}"))
            }
            ObjectSpec::Polygon(file) => write!(f, "polygon:{}", file.display()),
            ObjectSpec::Corners(corners) => {
                let each: Vec<String> = corners.iter().map(|[x, y]| format!("{x}x{y}")).collect();
                write!(f, "corners:{}", each.join(","))
            }
            ObjectSpec::Prism { base, height } => write!(f, "prism:{height},{base}"),
            ObjectSpec::Cuboid([x, y, z]) => write!(f, "box:{x}x{y}x{z}"),
            ObjectSpec::Cylinder { diameter, height } => write!(f, "cylinder:{diameter}x{height}"),
            ObjectSpec::Sphere(d) => write!(f, "sphere:{d}"),
            ObjectSpec::Ellipsoid([a, b, c]) => write!(f, "ellipsoid:{a}x{b}x{c}"),
            ObjectSpec::Mesh(file) => write!(f, "{}", file.display()),
        }
    }
}

impl ObjectSpec {
    /// 2 or 3.
    pub fn dimension(&self) -> usize {
        match self {
            ObjectSpec::Rectangle(_)
            | ObjectSpec::Ngon { .. }
            | ObjectSpec::Ellipse(_)
            | ObjectSpec::Arms(Arms { height: None, .. })
            | ObjectSpec::Polygon(_)
            | ObjectSpec::Corners(_) => 2,
            _ => 3,
        }
    }

    /// Whether it is planar and convex by its kind.
    fn is_convex_outline(&self) -> bool {
        matches!(
            self,
            ObjectSpec::Rectangle(_)
                | ObjectSpec::Ngon { .. }
                | ObjectSpec::Ellipse(_)
                | ObjectSpec::Corners(_)
        )
    }

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
                    Some(height) => prism(&vertices, hub, height)?,
                }
            }
            ObjectSpec::Polygon(file) => {
                let read = read_outline(file)?;
                let [vertices] = &read.loops[..] else {
                    let found = read.loops.len();
                    return Err(ObjectError::OnePolygon { file: file.clone(), found });
                };
                centred(vertices)?
            }
            ObjectSpec::Corners(corners) => centred(corners)?,
            ObjectSpec::Prism { base, height } => match base.geometry()? {
                Geometry::Outline(Outline { loops }) => {
                    prism(loops.first().map_or(&[], Vec::as_slice), [0.0; 2], *height)?
                }
                solid => solid,
            },
            ObjectSpec::Cuboid([x, y, z]) => {
                let corners = [[-x, -y], [*x, -y], [*x, *y], [-x, *y]];
                prism(&corners.map(|[x, y]| [x / 2.0, y / 2.0]), [0.0; 2], *z)?
            }
            ObjectSpec::Cylinder { diameter, height } => {
                prism(&around(SIDES, 0.0, [diameter / 2.0; 2]), [0.0; 2], *height)?
            }
            ObjectSpec::Sphere(d) => ellipsoid([d / 2.0; 3])?,
            ObjectSpec::Ellipsoid(axes) => ellipsoid(axes.map(|a| a / 2.0))?,
            ObjectSpec::Mesh(file) => {
                let mesh = read_mesh(file)?;
                let litres = 1e3 * mesh.volume();
                if mesh.is_watertight() && litres < 0.0 {
                    return Err(ObjectError::InsideOut { file: file.clone(), litres });
                }
                Geometry::Mesh(mesh)
            }
        })
    }
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

/// A polygon, counter-clockwise and all of it seen from `hub`, swept along z.
fn prism(polygon: &[[f64; 2]], [x, y]: [f64; 2], height: f64) -> Result<Geometry, ObjectError> {
    let n = polygon.len() as u32;
    let at = |z: f64| polygon.iter().map(move |v| Point::new(v[0], v[1], z));
    let mut vertices: Vec<Point> = at(-height / 2.0).chain(at(height / 2.0)).collect();
    vertices.extend([Point::new(x, y, -height / 2.0), Point::new(x, y, height / 2.0)]);
    let (bottom, top) = (2 * n, 2 * n + 1);
    let triangles = (0..n).flat_map(|i| {
        let j = (i + 1) % n;
        [[i, j, n + j], [i, n + j, n + i], [bottom, j, i], [top, n + i, n + j]]
    });
    Ok(Geometry::Mesh(Mesh::new(vertices, triangles.collect())?))
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
    fn units_and_plain_metres_mean_the_same() {
        assert_eq!(spec("rectangle:0.12x0.06"), spec("rectangle:120mmx6cm"));
        assert_eq!(spec("hexagon:45mm"), spec("ngon:6,0.045"));
        assert_eq!(spec("sphere:0.1m"), ObjectSpec::Sphere(0.1));
        assert_eq!(spec("some/mug.STL"), ObjectSpec::Mesh("some/mug.STL".into()));
        let all = [
            "rectangle:0.12x0.06",
            "triangle:0.05",
            "hexagon:0.045",
            "ngon:5,0.05",
            "ellipse:0.12x0.06",
            "lshape:0.09x0.08x0.03",
            "tshape:0.09x0.08x0.03",
            "lshape:0.09x0.08x0.03x0.05",
            "polygon:a.csv",
            "corners:-0.05x-0.03,0.045x-0.035,0.055x0.02,-0.03x0.04",
            "prism:0.06,hexagon:0.045",
            "box:0.12x0.06x0.05",
            "cylinder:0.06x0.1",
            "sphere:0.08",
            "ellipsoid:0.12x0.08x0.06",
            "mug.ply",
        ];
        for text in all {
            assert_eq!(spec(text).to_string(), text);
        }
    }

    #[test]
    fn what_is_no_object_is_refused() {
        for (text, expected) in [
            ("cube:0.1", "unknown object \"cube:0.1\": expected rectangle:WxH"),
            ("", "unknown object"),
            ("mug.glb", ".ply, .stl, .obj, .off"),
            ("rectangle:0.12", "expected rectangle:WxH, found 1 length"),
            ("rectangle", "expected rectangle:WxH, found 0 lengths"),
            ("box:0.1x0.1x0.1x0.1", "expected box:XxYxZ, found 4 lengths"),
            ("sphere:0", "above zero"),
            ("sphere:-1mm", "not negative"),
            ("sphere:nan", "found \"nan\""),
            ("sphere:5deg", "an angle"),
            ("rectangle:120x60mm", "from 0.1 mm to 10 m, found 120 m"),
            ("ngon:2,0.1", "3 to 1000 corners"),
            ("ngon:7", "expected ngon:N,R, found 0 lengths"),
            ("lshape:0.1x0.1", "expected lshape:WxHxT or WxHxTxZ, found 2 lengths"),
            ("tshape:0.1x0.1x0.1", "expected arms T narrower than W and H"),
            ("polygon:", "expected polygon:FILE, found no file"),
            ("corners:0x0,1x0", "at least 3 corners"),
            ("corners:0x0,0x0.1,0.1x0", "counter-clockwise"),
            ("corners:0x0,0.1x0,0.01x0.01,0x0.1", "convex"),
            ("corners:0x0,0.1x0,nanx0.1", "found nanx0.1"),
            ("prism:0.06,lshape:0.1x0.1x0.03", "with a convex planar object"),
            ("prism:0.06,prism:0.06,hexagon:0.045", "with a convex planar object"),
            ("prism:0.06", "unknown object"),
        ] {
            let error = text.parse::<ObjectSpec>().unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
        let error = spec("no/such.ply").geometry().unwrap_err().to_string();
        assert!(error.starts_with("no/such.ply: cannot read"), "{error}");
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
