//! Objects as the command line describes them.

mod drawn;
mod shapes;

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::quantity;
use crate::shape::files::{FileError, MESH_ENDINGS};
use crate::shape::{Outline, ShapeError};

/// What exists, for help and error messages.
pub const KINDS: &str = "rectangle:WxH, triangle:R, hexagon:R, ngon:N,R (R the circumradius), \
    ellipse:AxB, lshape:WxHxT or tshape:WxHxT (arms T wide; WxHxTxZ a prism), polygon:FILE, \
    corners:XxY,XxY,… (counter-clockwise), prism:Z,OBJECT (a planar object Z tall), \
    pyramid:Z,OBJECT (to a tip Z above it), frustum:Z,T,OBJECT (to a top T times as wide), \
    box:XxYxZ, cylinder:DxH, sphere:D, ellipsoid:AxBxC, random:D,SEED (any of these, of D \
    dimensions and 30 to 150 mm), or a mesh file (.ply, .stl, .obj, .off)";

/// The greatest number of corners of a polygon.
const MOST_CORNERS: usize = 1000;

/// Smallest and greatest length that is taken for an object's, metres. Beyond them a unit was
/// forgotten: `120x60mm` is 120 metres long.
const SIZES: std::ops::RangeInclusive<f64> = 1e-4..=10.0;

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
    /// `polygon:FILE`, see [`read_outline`](crate::shape::files::read_outline); moved to its centroid.
    Polygon(PathBuf),
    /// `corners:XxY,XxY,…`, a simple polygon counter-clockwise; moved to its centroid.
    Corners(Vec<[f64; 2]>),
    /// `prism:Z,OBJECT`: a planar object swept along z.
    Prism {
        /// Of two dimensions.
        base: Box<ObjectSpec>,
        /// Along z.
        height: f64,
    },
    /// `pyramid:Z,OBJECT`, a planar object drawn to a tip along z above its centroid, and `frustum:Z,T,OBJECT`, to a
    /// smaller one.
    Pyramid {
        /// Of two dimensions.
        base: Box<ObjectSpec>,
        /// Along z.
        height: f64,
        /// How many times as wide as the base the top is: below one, zero for a tip.
        top: f64,
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
                let (height, base) = standing(text, kind, size, "Z,OBJECT")?;
                ObjectSpec::Prism { base, height }
            }
            "pyramid" => {
                let (height, base) = standing(text, kind, size, "Z,OBJECT")?;
                ObjectSpec::Pyramid { base, height, top: 0.0 }
            }
            "frustum" => {
                let (height, rest) = size.split_once(',').unwrap_or((size, ""));
                let (top, base) = rest.split_once(',').unwrap_or((rest, ""));
                let (height, base) =
                    standing(text, kind, &format!("{height},{base}"), "Z,T,OBJECT")?;
                let top = match top.trim().parse() {
                    Ok(share) if 0.0 < share && share < 1.0 => share,
                    _ => {
                        let expected = "frustum:Z,T,OBJECT with T between 0 and 1";
                        return Err(malformed(text, expected, format!("{top:?}")));
                    }
                };
                ObjectSpec::Pyramid { base, height, top }
            }
            "box" => ObjectSpec::Cuboid(lengths(text, kind, size, "XxYxZ")?),
            "cylinder" => {
                let [diameter, height] = lengths(text, kind, size, "DxH")?;
                ObjectSpec::Cylinder { diameter, height }
            }
            "sphere" => ObjectSpec::Sphere(lengths::<1>(text, kind, size, "D")?[0]),
            "ellipsoid" => ObjectSpec::Ellipsoid(lengths(text, kind, size, "AxBxC")?),
            "random" => {
                let (dimension, seed) = size.split_once(',').unwrap_or((size, ""));
                match (dimension.trim().parse(), seed.trim().parse()) {
                    (Ok(dimension @ 2..=3), Ok(seed)) => drawn::draw(dimension, seed),
                    _ => {
                        let expected = "random:D,SEED with 2 or 3 dimensions and a whole number";
                        return Err(malformed(text, expected, format!("{size:?}")));
                    }
                }
            }
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

/// A height and the planar object that stands there.
fn standing(
    text: &str,
    kind: &str,
    size: &str,
    form: &str,
) -> Result<(f64, Box<ObjectSpec>), ObjectError> {
    let expected = || format!("{kind}:{form} with a planar object");
    let (height, base) = size
        .split_once(',')
        .filter(|(_, base)| !base.is_empty())
        .ok_or_else(|| malformed(text, expected(), "no object after a comma"))?;
    let [height] = lengths(text, kind, height, form)?;
    // Before it is read: objects within objects would be read to any depth.
    let below = base.split(':').next().unwrap_or(base);
    if ["prism", "pyramid", "frustum"].contains(&below) {
        return Err(malformed(text, expected(), format!("a {below}")));
    }
    let base: ObjectSpec = base.parse()?;
    if base.dimension() != 2 {
        return Err(malformed(text, expected(), base));
    }
    Ok((height, Box::new(base)))
}

/// `XxY,XxY,…`: at least three, no sides that cross, counter-clockwise.
fn corners(text: &str, size: &str) -> Result<Vec<[f64; 2]>, ObjectError> {
    let expected =
        "corners:XxY,XxY,… with at least 3 corners of a simple polygon, counter-clockwise";
    let one = |pair: &str| {
        let (x, y) = pair.split_once('x')?;
        let read = |part: &str| quantity::coordinate(part).ok().filter(|v| v.abs() <= *SIZES.end());
        Some([read(x)?, read(y)?])
    };
    let mut corners = Vec::new();
    for pair in size.split(',') {
        corners.push(one(pair.trim()).ok_or_else(|| malformed(text, expected, pair))?);
    }
    let area = Outline { loops: vec![corners.clone()] }.area();
    if corners.len() > MOST_CORNERS || area < SIZES.start().powi(2) {
        return Err(malformed(text, expected, size));
    }
    Outline::new(vec![corners.clone()]).map_err(|e| malformed(text, expected, e))?;
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
            ObjectSpec::Pyramid { base, height, top: 0.0 } => write!(f, "pyramid:{height},{base}"),
            ObjectSpec::Pyramid { base, height, top } => write!(f, "frustum:{height},{top},{base}"),
            ObjectSpec::Cuboid([x, y, z]) => write!(f, "box:{x}x{y}x{z}"),
            ObjectSpec::Cylinder { diameter, height } => write!(f, "cylinder:{diameter}x{height}"),
            ObjectSpec::Sphere(d) => write!(f, "sphere:{d}"),
            ObjectSpec::Ellipsoid([a, b, c]) => write!(f, "ellipsoid:{a}x{b}x{c}"),
            ObjectSpec::Mesh(file) => write!(f, "{}", file.display()),
        }
    }
}

impl ObjectSpec {
    /// The same with no more of a file than its name: what is told of it goes to other machines.
    pub fn without_folders(&self) -> ObjectSpec {
        let name = |file: &PathBuf| file.file_name().map_or_else(PathBuf::new, PathBuf::from);
        match self {
            ObjectSpec::Mesh(file) => ObjectSpec::Mesh(name(file)),
            ObjectSpec::Polygon(file) => ObjectSpec::Polygon(name(file)),
            ObjectSpec::Prism { base, height } => {
                ObjectSpec::Prism { base: Box::new(base.without_folders()), height: *height }
            }
            ObjectSpec::Pyramid { base, height, top } => {
                let base = Box::new(base.without_folders());
                ObjectSpec::Pyramid { base, height: *height, top: *top }
            }
            other => other.clone(),
        }
    }

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
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(text: &str) -> ObjectSpec {
        text.parse().unwrap()
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
            "corners:0x0,0.1x0,0.01x0.01,0x0.1",
            "prism:0.06,hexagon:0.045",
            "prism:0.06,polygon:a.csv",
            "pyramid:0.09,rectangle:0.09x0.09",
            "frustum:0.07,0.6,ellipse:0.1x0.08",
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
            ("corners:0x0,0.1x0.1,0.1x0,0x0.2", "edges that start at vertices 0 and 2 cross"),
            ("random:4,1", "expected random:D,SEED with 2 or 3 dimensions"),
            ("random:2", "expected random:D,SEED"),
            ("random:2,-1", "found \"2,-1\""),
            ("corners:0x0,0.1x0,nanx0.1", "found nanx0.1"),
            ("prism:0.06,lshape:0.1x0.1x0.03x0.05", "with a planar object"),
            ("prism:0.06,prism:0.06,hexagon:0.045", "with a planar object"),
            ("prism:0.06", "expected prism:Z,OBJECT with a planar object, found no object"),
            ("prism:tall,hexagon:0.045", "expected prism:Z,OBJECT with a length such as"),
            ("prism:1x2,hexagon:0.045", "expected prism:Z,OBJECT, found 2 lengths"),
            ("prism:0.06,", "expected prism:Z,OBJECT with a planar object, found no object"),
            ("pyramid:0.06", "expected pyramid:Z,OBJECT with a planar object"),
            ("pyramid:0.06,sphere:0.1", "with a planar object, found sphere:0.1"),
            ("frustum:0.06,hexagon:0.045", "frustum:Z,T,OBJECT with a planar object"),
            ("frustum:0.06,1,hexagon:0.045", "with T between 0 and 1, found \"1\""),
            ("frustum:0.06,nan,hexagon:0.045", "with T between 0 and 1, found \"nan\""),
        ] {
            let error = text.parse::<ObjectSpec>().unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
        // However deep: reading each within the other would need as deep a stack.
        for nested in ["prism:1,", "pyramid:1,", "frustum:1,0.5,"] {
            let text = nested.repeat(100_000) + "hexagon:0.045";
            let error = text.parse::<ObjectSpec>().unwrap_err().to_string();
            assert!(error.contains("with a planar object, found a "), "{nested}");
        }
        let error = spec("no/such.ply").geometry().unwrap_err().to_string();
        assert!(error.starts_with("no/such.ply: cannot read"), "{error}");
    }
}
