//! Mesh and contour files.
//!
//! Meshes are read from PLY (ascii and binary little-endian), STL (ascii and binary), OBJ and OFF:
//! positions and faces, everything else is skipped; polygons with more than three corners are cut
//! into a fan. The readers are our own: four small formats over one way of saying which line or byte
//! is wrong and what was expected, and nothing allocated on a header's word, for three dependencies
//! less.

mod ears;
mod obj;
mod off;
mod ply;
mod stl;

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::{Mesh, Outline, ShapeError};
use crate::log::read::unmarked;
use crate::log::write::write_atomically;
use crate::space::Point;

/// Endings of the mesh files we read.
pub const MESH_ENDINGS: [&str; 4] = ["ply", "stl", "obj", "off"];

/// Why a shape cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The system says no.
    #[error("{}: cannot {action}: {source}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// `read` or `write`.
        action: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// The ending names no format we read.
    #[error("{}: expected a mesh file ending in .ply, .stl, .obj or .off", file.display())]
    Ending {
        /// Which file.
        file: PathBuf,
    },
    /// The content is not what the format asks for.
    #[error("{}, {place}: expected {expected}, found {found}", file.display())]
    Content {
        /// Which file.
        file: PathBuf,
        /// Where in it.
        place: Place,
        /// What would have been right.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The vertices make no shape.
    #[error("{}: {source}", file.display())]
    Shape {
        /// Which file.
        file: PathBuf,
        /// What is wrong with them.
        source: ShapeError,
    },
}

/// A place in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// From 1.
    Line(usize),
    /// From 0.
    Byte(usize),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Place::Line(n) => write!(f, "line {n}"),
            Place::Byte(n) => write!(f, "byte {n}"),
        }
    }
}

/// Something wrong in a file whose name the parser does not know.
#[derive(Debug)]
struct Wrong {
    place: Place,
    expected: String,
    found: String,
}

impl Wrong {
    fn new(place: Place, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Wrong { place, expected: expected.into(), found: found.into() }
    }
}

/// Vertices and triangles as a file gives them, not yet checked.
#[derive(Default)]
struct Soup {
    vertices: Vec<Point>,
    triangles: Vec<[u32; 3]>,
    /// The first triangle of each face with more than three corners, and those.
    polygons: Vec<(usize, Vec<u32>)>,
}

impl Soup {
    /// Adds a polygon as a fan of triangles: until all vertices are there nobody knows whether it is convex.
    fn polygon(&mut self, corners: &[u32]) {
        if corners.len() > 3 {
            self.polygons.push((self.triangles.len(), corners.to_vec()));
        }
        for i in 1..corners.len().saturating_sub(1) {
            self.triangles.push([corners[0], corners[i], corners[i + 1]]);
        }
    }

    /// The same with polygons that are not convex cut into triangles that do not overlap.
    fn cut(mut self) -> Soup {
        for (first, corners) in std::mem::take(&mut self.polygons) {
            let points: Option<Vec<Point>> =
                corners.iter().map(|&v| self.vertices.get(v as usize).copied()).collect();
            let triangles = points.and_then(|points| ears::cut(&points)).unwrap_or_default();
            for (triangle, cut) in self.triangles[first..].iter_mut().zip(triangles) {
                *triangle = cut.map(|corner| corners[corner]);
            }
        }
        self
    }
}

/// Triangles whose equal corners are one vertex.
#[derive(Default)]
struct Merged {
    soup: Soup,
    known: HashMap<[u64; 3], u32>,
}

impl Merged {
    fn of(mesh: &Mesh) -> Merged {
        let mut merged = Merged::default();
        let corner = |i: u32| mesh.vertices()[i as usize];
        mesh.triangles().iter().for_each(|t| merged.triangle(t.map(corner)));
        merged
    }

    fn triangle(&mut self, corners: [Point; 3]) {
        let indices = corners.map(|p| {
            // Adding zero makes −0 and +0 one.
            let key = [p.x, p.y, p.z].map(|x| (x + 0.0).to_bits());
            *self.known.entry(key).or_insert_with(|| {
                self.soup.vertices.push(p);
                self.soup.vertices.len() as u32 - 1
            })
        });
        let [a, b, c] = indices;
        // A triangle that merging has collapsed has no area, and would leave a seam open.
        if a != b && b != c && c != a {
            self.soup.triangles.push(indices);
        }
    }
}

/// Reads a mesh; the ending of the name tells the format.
///
/// # Errors
/// When the file cannot be read, is of no known format, is malformed, or holds no triangles.
pub fn read_mesh(path: &Path) -> Result<Mesh, FileError> {
    let parse = parser(path)?;
    mesh(path, &read(path)?, parse)
}

/// The same of a file's bytes, which `path` only names.
///
/// # Errors
/// Those of [`read_mesh`] but for reading.
pub fn parse_mesh(path: &Path, bytes: &[u8]) -> Result<Mesh, FileError> {
    mesh(path, bytes, parser(path)?)
}

type Parser = fn(&[u8]) -> Result<Soup, Wrong>;

/// By the ending of the name.
fn parser(path: &Path) -> Result<Parser, FileError> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    match ending.as_str() {
        "ply" => Ok(ply::parse),
        "stl" => Ok(stl::parse),
        "obj" => Ok(obj::parse),
        "off" => Ok(off::parse),
        _ => Err(FileError::Ending { file: path.into() }),
    }
}

fn mesh(path: &Path, bytes: &[u8], parse: Parser) -> Result<Mesh, FileError> {
    let content = |wrong| content(path, wrong);
    let soup = parse(bytes).map_err(content)?.cut();
    if soup.triangles.is_empty() {
        let end = Place::Byte(bytes.len());
        return Err(content(Wrong::new(end, "at least one triangle", "none")));
    }
    let shape = |soup: Soup| {
        Mesh::new(soup.vertices, soup.triangles)
            .map_err(|source| FileError::Shape { file: path.into(), source })
    };
    let mesh = shape(soup)?;
    // Files may give every face corners of its own, or say a corner twice.
    let flaws = mesh.flaws().count();
    if flaws > 0
        && let Ok(merged) = shape(Merged::of(&mesh).soup)
        && merged.vertices().len() < mesh.vertices().len()
        && merged.flaws().count() < flaws
    {
        return Ok(merged);
    }
    Ok(mesh)
}

/// Writes a mesh as binary little-endian PLY, fully or not at all: positions in double precision,
/// and per vertex the normals and the surface's standard deviations (metres; property
/// `uncertainty`) where given.
///
/// # Errors
/// When the file cannot be written, or (`InvalidInput`) there are not as many normals or
/// deviations as vertices.
pub fn write_ply(
    path: &Path,
    mesh: &Mesh,
    normals: Option<&[Point]>,
    deviations: Option<&[f64]>,
) -> Result<(), FileError> {
    write_atomically(path, |writer| ply_to_writer(writer, mesh, normals, deviations))
        .map_err(|source| FileError::Io { file: path.into(), action: "write", source })
}

/// Formats of meshes that hold nothing but the shape; PLY ([`write_ply`]) holds its uncertainty too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Plain {
    /// Binary STL, single precision
    Stl,
    /// Wavefront OBJ
    Obj,
}

impl Plain {
    /// The ending of its files.
    pub fn ending(self) -> &'static str {
        match self {
            Plain::Stl => "stl",
            Plain::Obj => "obj",
        }
    }
}

/// Writes a mesh, fully or not at all. Neither format knows units: the numbers are metres.
///
/// # Errors
/// When the file cannot be written, or (`InvalidInput`) holds more triangles than STL can count.
pub fn write_plain(path: &Path, mesh: &Mesh, format: Plain) -> Result<(), FileError> {
    write_atomically(path, |writer| match format {
        Plain::Stl => stl::write(writer, mesh),
        Plain::Obj => obj::write(writer, mesh),
    })
    .map_err(|source| FileError::Io { file: path.into(), action: "write", source })
}

/// As [`write_ply`], to anything that can be written to.
///
/// # Errors
/// When the writer fails, or (`InvalidInput`) there are not as many normals or deviations as
/// vertices.
pub fn ply_to_writer(
    writer: &mut dyn Write,
    mesh: &Mesh,
    normals: Option<&[Point]>,
    deviations: Option<&[f64]>,
) -> std::io::Result<()> {
    ply::write(writer, mesh, normals, deviations)
}

/// Writes an outline as CSV, `loop,x,y,deviation`, metres, fully or not at all. `deviations` holds
/// one standard deviation per vertex, loop after loop; without them the column is empty.
///
/// # Errors
/// When the file cannot be written, or (`InvalidInput`) there are not as many deviations as
/// vertices.
pub fn write_contour(
    path: &Path,
    outline: &Outline,
    deviations: Option<&[f64]>,
) -> Result<(), FileError> {
    let vertices: usize = outline.loops.iter().map(Vec::len).sum();
    write_atomically(path, |writer| {
        check_length("deviations", deviations.map(<[f64]>::len), vertices)?;
        writeln!(writer, "loop,x,y,deviation")?;
        let mut index = 0;
        for (number, vertices) in outline.loops.iter().enumerate() {
            for [x, y] in vertices {
                write!(writer, "{number},{x},{y},")?;
                match deviations {
                    Some(deviations) => writeln!(writer, "{}", deviations[index])?,
                    None => writeln!(writer)?,
                }
                index += 1;
            }
        }
        Ok(())
    })
    .map_err(|source| FileError::Io { file: path.into(), action: "write", source })
}

/// Reads polygons: what [`write_contour`] writes; or two numbers a line, x and y in metres,
/// separated by commas or blanks (`#` starts a comment, a first line of names is skipped); or JSON,
/// a list of `[x, y]`.
///
/// # Errors
/// When the file cannot be read, is malformed, or its vertices make no simple polygon.
pub fn read_outline(path: &Path) -> Result<Outline, FileError> {
    let bytes = read(path)?;
    let content = |wrong| content(path, wrong);
    let text = text(&bytes);
    let loops = if text.trim_start().starts_with('[') {
        vec![serde_json::from_str(&text).map_err(|e| {
            content(Wrong::new(Place::Line(e.line()), "a list of [x, y], metres", e.to_string()))
        })?]
    } else {
        polygons(&text).map_err(content)?
    };
    if loops.iter().all(Vec::is_empty) {
        return Err(content(Wrong::new(Place::Line(1), "at least 3 vertices x, y", "none")));
    }
    Outline::new(loops).map_err(|source| FileError::Shape { file: path.into(), source })
}

/// Polygons as CSV or blank-separated text.
fn polygons(text: &str) -> Result<Vec<Vec<[f64; 2]>>, Wrong> {
    let mut loops: Vec<Vec<[f64; 2]>> = Vec::new();
    let mut current = None;
    let mut contour = false;
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or("");
        let words: Vec<&str> = line
            .split(|c: char| c == ',' || c == ';' || c.is_whitespace())
            .filter(|w| !w.is_empty())
            .collect();
        let place = Place::Line(number + 1);
        if words.is_empty() {
            continue;
        }
        if current.is_none() && words.iter().all(|w| w.parse::<f64>().is_err()) {
            contour = words.starts_with(&["loop", "x", "y"]);
            current = Some(0);
            continue;
        }
        let (name, rest) = if contour { (Some(words[0]), &words[1..]) } else { (None, &words[..]) };
        let expected = if contour { "loop,x,y,deviation" } else { "two numbers x, y" };
        let &[x, y, ..] = rest else {
            return Err(Wrong::new(place, expected, format!("{line:?}")));
        };
        if !contour && rest.len() > 2 {
            return Err(Wrong::new(place, expected, format!("{} numbers", rest.len())));
        }
        let index = match name {
            Some(name) => name
                .parse()
                .map_err(|_| Wrong::new(place, "the number of a loop", format!("{name:?}")))?,
            None => 0usize,
        };
        if loops.is_empty() || current != Some(index) {
            loops.push(Vec::new());
        }
        current = Some(index);
        if let Some(vertices) = loops.last_mut() {
            vertices.push([coordinate(place, x)?, coordinate(place, y)?]);
        }
    }
    Ok(loops)
}

fn read(path: &Path) -> Result<Vec<u8>, FileError> {
    std::fs::read(path).map_err(|source| FileError::Io {
        file: path.into(),
        action: "read",
        source,
    })
}

fn content(path: &Path, wrong: Wrong) -> FileError {
    let Wrong { place, expected, found } = wrong;
    FileError::Content { file: path.into(), place, expected, found }
}

/// Names and comments may be in any encoding: keywords and numbers are the same in most.
fn text(bytes: &[u8]) -> Cow<'_, str> {
    String::from_utf8_lossy(unmarked(bytes))
}

fn coordinate(place: Place, word: &str) -> Result<f64, Wrong> {
    word.parse().map_err(|_| Wrong::new(place, "a number", format!("{word:?}")))
}

fn point(place: Place, words: &[&str]) -> Result<Point, Wrong> {
    let &[x, y, z, ..] = words else {
        return Err(Wrong::new(place, "three coordinates", format!("{} words", words.len())));
    };
    Ok(Point::new(coordinate(place, x)?, coordinate(place, y)?, coordinate(place, z)?))
}

fn check_length(what: &str, given: Option<usize>, vertices: usize) -> std::io::Result<()> {
    match given {
        Some(n) if n != vertices => Err(std::io::Error::new(
            std::io::ErrorKind::InvalidInput,
            format!("{n} {what} for {vertices} vertices"),
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests;
