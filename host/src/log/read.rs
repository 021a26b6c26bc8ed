//! Reading grasp logs, strictly: what is accepted is sound, what is refused is named by file, line
//! and field with what was expected there.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use item::{Fields, Item, Line, MAX_LINE};

use super::{
    FORMAT, GraspLog, LoggedContact, LoggedFree, LoggedGrasp, MAX_CONTACTS, MAX_FINGERS, Noise,
    TrueShape, VERSION,
};

mod item;
mod single;

/// Why a log cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file system refused.
    #[error("{}: cannot {action}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What was tried: "read" or "write".
        action: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The file as a whole is not a grasp log.
    #[error("{}: {problem}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// What is wrong and what was expected.
        problem: String,
    },
    /// A line is not one JSON object.
    #[error("{}, line {line}: {problem}", file.display())]
    Line {
        /// The file.
        file: PathBuf,
        /// Counted from one.
        line: usize,
        /// What is wrong and what was expected.
        problem: String,
    },
    /// A field is missing or has a value it cannot have.
    #[error("{}, line {line}, field `{field}`: expected {expected}, found {found}", file.display())]
    Field {
        /// The file.
        file: PathBuf,
        /// Counted from one.
        line: usize,
        /// Where in the line, such as `contacts[2].normal`.
        field: String,
        /// What would have been right.
        expected: String,
        /// What is there.
        found: String,
    },
}

impl GraspLog {
    /// Reads a log.
    ///
    /// Checked: every line is one JSON object of at most 16 MiB in which no name stands twice; the
    /// first is a header of this format and version; dimension 2 or 3 and every vector and rotation of
    /// that dimension; all numbers finite and coordinates within [`super::MAX_COORDINATE`]; normals and
    /// quaternions of length one within 10⁻³ (then normalised); standard deviations positive; fingers
    /// named in the header; grasp numbers ascending, times neither negative nor running backwards; at
    /// most [`MAX_CONTACTS`] contacts and free points in a grasp; at least one grasp. A grasp without
    /// contacts is fine, as are blank lines. `null` means the same as a missing field. Whether a mesh
    /// named as the true shape exists is not checked here.
    ///
    /// # Errors
    /// [`LogError`] naming file, line, field and what was expected.
    pub fn read(path: &Path) -> Result<GraspLog, LogError> {
        let io = |source| LogError::Io { file: path.into(), action: "read", source };
        let file = File::open(path).map_err(io)?;
        if file.metadata().map_err(io)?.is_dir() {
            return Err(LogError::Content {
                file: path.into(),
                problem: "is a folder; expected a grasp log (JSON lines)".into(),
            });
        }
        let is_recording = path.extension().is_some_and(|ending| ending == "tac");
        GraspLog::parse(BufReader::new(file), path).map_err(|error| match error {
            // Not even its header is text.
            LogError::Line { line: 1, .. } if is_recording => LogError::Content {
                file: path.into(),
                problem:
                    "is a recording (.tac); expected a grasp log, as `tactile replay` makes of it"
                        .into(),
            },
            other => other,
        })
    }

    /// Reads a log from anything; `name` is what errors call it, and the true shape's mesh is
    /// looked for beside it.
    ///
    /// # Errors
    /// As [`GraspLog::read`].
    pub fn parse(reader: impl BufRead, name: &Path) -> Result<GraspLog, LogError> {
        let log = GraspLog::lines(reader, name, &mut Err)?;
        if log.grasps.is_empty() {
            let problem = "has a header but no grasp; expected at least one".into();
            return Err(LogError::Content { file: name.into(), problem });
        }
        Ok(log)
    }

    /// Reads what can be read of a damaged or unfinished log: lines that are not sound are left out,
    /// and said. There may be no grasp left.
    ///
    /// # Errors
    /// When the file cannot be read, or its header is not sound.
    pub fn salvage(path: &Path) -> Result<(GraspLog, Vec<LogError>), LogError> {
        let file = File::open(path).map_err(|source| LogError::Io {
            file: path.into(),
            action: "read",
            source,
        })?;
        let mut left_out = Vec::new();
        let log = GraspLog::lines(BufReader::new(file), path, &mut |error| {
            left_out.push(error);
            Ok(())
        })?;
        Ok((log, left_out))
    }

    /// `refuse` decides about lines after the header that are not sound.
    pub(super) fn lines(
        mut reader: impl BufRead,
        name: &Path,
        refuse: &mut dyn FnMut(LogError) -> Result<(), LogError>,
    ) -> Result<GraspLog, LogError> {
        let mut log: Option<GraspLog> = None;
        let mut bytes = Vec::new();
        let mut number = 0;
        let unread = |source| LogError::Io { file: name.into(), action: "read", source };
        loop {
            bytes.clear();
            number += 1;
            let read = reader
                .by_ref()
                .take(MAX_LINE as u64 + 1)
                .read_until(b'\n', &mut bytes)
                .map_err(unread)?;
            if read == 0 {
                break;
            }
            let line = Line { file: name, number };
            let text = if number == 1 { unmarked(&bytes) } else { &bytes };
            match (line.object(text), &mut log) {
                (Ok(None), _) => {}
                (Ok(Some(object)), None) => log = Some(header(line, object)?),
                (Ok(Some(object)), Some(log)) => match grasp(line, object, log) {
                    Ok(grasp) => log.grasps.push(grasp),
                    Err(error) => refuse(error)?,
                },
                (Err(error), None) => return Err(error),
                (Err(error), Some(_)) => refuse(error)?,
            }
            if read > MAX_LINE && !bytes.ends_with(b"\n") {
                // The rest of a line that is too long is no line.
                reader.skip_until(b'\n').map_err(unread)?;
            }
        }
        log.ok_or_else(|| LogError::Content {
            file: name.into(),
            problem: "is empty; expected a header line and one line per grasp".into(),
        })
    }
}

/// A text without the mark of its encoding, which some programs put before it.
pub(crate) fn unmarked(text: &[u8]) -> &[u8] {
    text.strip_prefix("\u{feff}".as_bytes()).unwrap_or(text)
}

fn header(line: Line<'_>, mut fields: Fields<'_>) -> Result<GraspLog, LogError> {
    let expected = format!("{FORMAT:?} in the header, the first line");
    let format = fields.required("format", &expected)?;
    if format.value != FORMAT {
        return Err(format.wrong(expected));
    }
    let expected = format!("{VERSION}, the version this program reads");
    let version = fields.required("version", &expected)?;
    if version.value != VERSION {
        return Err(version.wrong(expected));
    }
    let dimension = fields.required("dimension", "2 or 3")?;
    let dimension = match dimension.value.as_u64() {
        Some(2) => 2,
        Some(3) => 3,
        _ => return Err(dimension.wrong("2 or 3")),
    };
    if let Some(frame) = fields.optional("frame")
        && frame.value != "world"
    {
        return Err(frame.wrong("\"world\", the only frame a log may use"));
    }
    let description = match fields.optional("description") {
        Some(item) => item.text("a text")?,
        None => String::new(),
    };
    let mut fingers: Vec<String> = Vec::new();
    if let Some(item) = fields.optional("fingers") {
        if item.value.as_array().is_some_and(|a| a.len() > MAX_FINGERS) {
            return Err(item.wrong(format!("at most {MAX_FINGERS} names")));
        }
        for item in item.items("an array of names")? {
            if fingers.iter().any(|f| item.value == **f) {
                return Err(item.wrong("a name not used before"));
            }
            fingers.push(item.text("a name")?);
        }
    }
    let mut noise = Noise::default();
    let mut nested = Map::new();
    if let Some(item) = fields.optional("noise") {
        let mut inner = item.fields("an object of standard deviations")?;
        for (name, deviation) in [
            ("point", &mut noise.point),
            ("normal", &mut noise.normal),
            ("translation", &mut noise.translation),
            ("rotation", &mut noise.rotation),
        ] {
            *deviation = inner.optional(name).map(|item| item.positive()).transpose()?;
        }
        keep(&mut nested, "noise", inner);
    }
    let mut shape = None;
    if let Some(item) = fields.optional("truth") {
        let mut inner = item.fields("an object {\"shape\"}")?;
        if let Some(item) = inner.optional("shape") {
            let (known, rest) = true_shape(item, dimension, line.file)?;
            shape = Some(known);
            keep(&mut inner.map, "shape", rest);
        }
        keep(&mut nested, "truth", inner);
    }
    let mut unknown = fields.map;
    unknown.extend(nested);
    Ok(GraspLog { dimension, description, fingers, noise, shape, grasps: Vec::new(), unknown })
}

/// Puts what is left of a known object beside the unknown fields of its parent.
fn keep(unknown: &mut Map<String, Value>, name: &str, rest: Fields<'_>) {
    if !rest.map.is_empty() {
        unknown.insert(name.into(), Value::Object(rest.map));
    }
}

/// With the fields of it that nobody knows.
fn true_shape<'a>(
    item: Item<'a>,
    dimension: usize,
    log: &Path,
) -> Result<(TrueShape, Fields<'a>), LogError> {
    let expected = if dimension == 2 {
        "an object {\"polygon\": [[x, y], …]}"
    } else {
        "an object {\"mesh\": \"file\"}"
    };
    let mut fields = item.fields(expected)?;
    if dimension == 2 {
        let item = fields.required("polygon", "at least 3 vertices [x, y] in metres")?;
        if item.value.as_array().is_none_or(|a| a.len() < 3) {
            return Err(item.wrong("at least 3 vertices [x, y] in metres"));
        }
        let vertices = item.items("vertices")?.map(|v| v.position(2).map(|p| [p.x, p.y]));
        Ok((TrueShape::Polygon(vertices.collect::<Result<_, _>>()?), fields))
    } else {
        let item = fields.required("mesh", "the name of a mesh file")?;
        if item.value == "" {
            return Err(item.wrong("the name of a mesh file"));
        }
        let path = item.text("the name of a mesh file")?;
        let file = log.parent().unwrap_or(Path::new("")).join(&path);
        Ok((TrueShape::Mesh { path, file }, fields))
    }
}

fn grasp(line: Line<'_>, mut fields: Fields<'_>, log: &GraspLog) -> Result<LoggedGrasp, LogError> {
    let dimension = log.dimension;
    if fields.map.contains_key("format") {
        return Err(line.problem("is a second header; expected a grasp"));
    }
    let what = "the grasp's number, 0, 1, …";
    let number = fields.required("grasp", what)?;
    let index = number.count(what)?;
    let previous = log.grasps.last().map(|g| g.index);
    if previous.is_some_and(|p| index <= p) {
        let expected = format!("a number above {}, the grasp before", previous.unwrap_or(0));
        return Err(number.wrong(expected));
    }
    let mut time = None;
    if let Some(item) = fields.optional("time") {
        let seconds = item.number()?;
        let before = log.grasps.iter().rev().find_map(|g| g.time).unwrap_or(0.0);
        if seconds < before {
            return Err(item.wrong(if before == 0.0 {
                "seconds since the start, not negative".to_string()
            } else {
                format!("at least {before} s, the time of the grasp before")
            }));
        }
        time = Some(seconds);
    }
    let mut nested = Map::new();
    let mut motion = None;
    if let Some(item) = fields.optional("motion") {
        let (known, rest) = item.motion(dimension)?;
        motion = Some(known);
        keep(&mut nested, "motion", rest);
    }
    let contacts = fields.required("contacts", "an array of contacts, possibly empty")?;
    let contacts = several(contacts, "contacts")?
        .map(|item| contact(item, dimension, &log.fingers))
        .collect::<Result<_, _>>()?;
    let mut free = Vec::new();
    if let Some(item) = fields.optional("free") {
        for item in several(item, "free points")? {
            let mut inner = item.fields("an object {\"point\"}")?;
            free.push(LoggedFree {
                finger: inner.optional("finger").map(|i| i.finger(&log.fingers)).transpose()?,
                point: inner.required("point", "a position in metres")?.position(dimension)?,
                unknown: inner.map,
            });
        }
    }
    let mut truth = None;
    if let Some(item) = fields.optional("truth") {
        let mut inner = item.fields("an object {\"pose\"}")?;
        if let Some(item) = inner.optional("pose") {
            let (known, rest) = item.pose(dimension)?;
            truth = Some(known);
            keep(&mut inner.map, "pose", rest);
        }
        keep(&mut nested, "truth", inner);
    }
    let mut unknown = fields.map;
    unknown.extend(nested);
    Ok(LoggedGrasp { index, time, motion, contacts, free, truth, unknown })
}

/// The elements of an array that may not be longer than [`MAX_CONTACTS`].
fn several<'a>(
    item: Item<'a>,
    what: &str,
) -> Result<impl ExactSizeIterator<Item = Item<'a>> + use<'a>, LogError> {
    if let Some(n) = item.value.as_array().map(Vec::len).filter(|n| *n > MAX_CONTACTS) {
        let expected = format!("at most {MAX_CONTACTS} {what} in one grasp");
        return Err(item.wrong_as(expected, n.to_string()));
    }
    item.items(&format!("an array of {what}"))
}

fn contact(
    item: Item<'_>,
    dimension: usize,
    fingers: &[String],
) -> Result<LoggedContact, LogError> {
    let mut fields = item.fields("an object {\"point\", \"normal\", …}")?;
    Ok(LoggedContact {
        finger: fields.optional("finger").map(|i| i.finger(fingers)).transpose()?,
        point: fields.required("point", "a position in metres")?.position(dimension)?,
        normal: fields.optional("normal").map(|i| i.normal(dimension)).transpose()?,
        normal_noise: fields.optional("normal_noise").map(|i| i.positive()).transpose()?,
        force: fields.optional("force").map(|i| i.number()).transpose()?,
        unknown: fields.map,
    })
}
