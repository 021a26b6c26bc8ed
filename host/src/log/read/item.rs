//! Values of a log with their place, so that whatever is wrong with one can be named.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde_json::{Map, Value};

use super::super::MAX_COORDINATE;
use super::LogError;
use super::single::{Single, TWICE};
use crate::space::{self, Point, Pose};

/// Unit vectors and quaternions may be this far off length one; they are then normalised.
const UNIT_TOLERANCE: f64 = 1e-3;

/// Below this, a length differs from one by rounding alone and the numbers are kept as they are,
/// so that a written log reads back bit for bit.
const UNIT_ROUNDING: f64 = 1e-12;

/// Longest line accepted, bytes: the most contacts a grasp may have with room for unknown fields.
pub(super) const MAX_LINE: usize = 16 << 20;

/// Where errors are.
#[derive(Clone, Copy)]
pub(super) struct Line<'a> {
    pub(super) file: &'a Path,
    pub(super) number: usize,
}

impl<'a> Line<'a> {
    pub(super) fn problem(self, problem: impl Into<String>) -> LogError {
        LogError::Line { file: self.file.into(), line: self.number, problem: problem.into() }
    }

    /// The line's object; `None` for a blank line.
    pub(super) fn object(self, bytes: &[u8]) -> Result<Option<Fields<'a>>, LogError> {
        if bytes.len() > MAX_LINE {
            return Err(self.problem(format!("is longer than {MAX_LINE} bytes")));
        }
        let text = std::str::from_utf8(bytes).map_err(|e| {
            self.problem(format!("is not UTF-8 text (byte {} of the line)", e.valid_up_to() + 1))
        })?;
        if text.trim().is_empty() {
            return Ok(None);
        }
        // Without its end, so that a line cut off inside a name or text is known as such.
        let Single(value) = serde_json::from_str(text.trim_end()).map_err(|e| {
            self.problem(if e.is_eof() {
                "is cut off in the middle of its JSON object (is the file truncated?)".to_string()
            } else {
                malformed(text, &e)
            })
        })?;
        match value {
            Value::Object(map) => Ok(Some(Fields { line: self, path: String::new(), map })),
            other => {
                Err(self.problem(format!("expected one JSON object, found {}", describe(&other))))
            }
        }
    }
}

/// A value with its place.
pub(super) struct Item<'a> {
    pub(super) line: Line<'a>,
    pub(super) path: String,
    pub(super) value: Value,
}

/// An object with its place; fields are taken out one by one and what is left is unknown.
pub(super) struct Fields<'a> {
    pub(super) line: Line<'a>,
    pub(super) path: String,
    pub(super) map: Map<String, Value>,
}

impl<'a> Fields<'a> {
    pub(super) fn place(&self, name: &str) -> String {
        if self.path.is_empty() { name.to_string() } else { format!("{}.{name}", self.path) }
    }

    pub(super) fn optional(&mut self, name: &str) -> Option<Item<'a>> {
        // Not `remove`: that would reorder the unknown fields.
        match self.map.shift_remove(name) {
            None | Some(Value::Null) => None,
            Some(value) => Some(Item { line: self.line, path: self.place(name), value }),
        }
    }

    pub(super) fn required(&mut self, name: &str, expected: &str) -> Result<Item<'a>, LogError> {
        self.optional(name).ok_or_else(|| LogError::Field {
            file: self.line.file.into(),
            line: self.line.number,
            field: self.place(name),
            expected: expected.into(),
            found: "nothing".into(),
        })
    }
}

impl<'a> Item<'a> {
    pub(super) fn wrong(&self, expected: impl Into<String>) -> LogError {
        self.wrong_as(expected, describe(&self.value))
    }

    pub(super) fn wrong_as(
        &self,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> LogError {
        LogError::Field {
            file: self.line.file.into(),
            line: self.line.number,
            field: self.path.clone(),
            expected: expected.into(),
            found: found.into(),
        }
    }

    pub(super) fn number(&self) -> Result<f64, LogError> {
        match self.value.as_f64() {
            Some(x) if x.is_finite() => Ok(x),
            _ => Err(self.wrong("a finite number")),
        }
    }

    pub(super) fn positive(&self) -> Result<f64, LogError> {
        let x = self.number()?;
        let fine = x > 0.0 && x <= MAX_COORDINATE;
        if fine {
            Ok(x)
        } else {
            Err(self.wrong(format!("a positive number up to {MAX_COORDINATE}")))
        }
    }

    pub(super) fn count(&self, expected: &str) -> Result<u64, LogError> {
        self.value.as_u64().ok_or_else(|| self.wrong(expected))
    }

    pub(super) fn text(self, expected: &str) -> Result<String, LogError> {
        match self.value {
            Value::String(text) => Ok(text),
            _ => Err(self.wrong(expected)),
        }
    }

    pub(super) fn fields(self, expected: &str) -> Result<Fields<'a>, LogError> {
        match self.value {
            Value::Object(map) => Ok(Fields { line: self.line, path: self.path, map }),
            _ => Err(self.wrong(expected)),
        }
    }

    pub(super) fn items(
        self,
        expected: &str,
    ) -> Result<impl ExactSizeIterator<Item = Item<'a>> + use<'a>, LogError> {
        match self.value {
            Value::Array(values) => {
                let (line, path) = (self.line, self.path);
                Ok(values.into_iter().enumerate().map(move |(i, value)| Item {
                    line,
                    path: format!("{path}[{i}]"),
                    value,
                }))
            }
            _ => Err(self.wrong(expected)),
        }
    }

    /// Exactly `N` finite numbers.
    pub(super) fn numbers<const N: usize>(&self, expected: &str) -> Result<[f64; N], LogError> {
        let wrong = || self.wrong(expected);
        let values = self.value.as_array().filter(|v| v.len() == N).ok_or_else(wrong)?;
        let mut numbers = [0.0; N];
        for (i, (number, value)) in numbers.iter_mut().zip(values).enumerate() {
            *number = value.as_f64().filter(|x| x.is_finite()).ok_or_else(|| LogError::Field {
                file: self.line.file.into(),
                line: self.line.number,
                field: format!("{}[{i}]", self.path),
                expected: "a finite number".into(),
                found: describe(value),
            })?;
        }
        Ok(numbers)
    }

    pub(super) fn vector(&self, dimension: usize, what: &str) -> Result<Point, LogError> {
        if dimension == 2 {
            let [x, y] = self.numbers(&format!("{what} [x, y]"))?;
            Ok(Point::new(x, y, 0.0))
        } else {
            let [x, y, z] = self.numbers(&format!("{what} [x, y, z]"))?;
            Ok(Point::new(x, y, z))
        }
    }

    pub(super) fn position(&self, dimension: usize) -> Result<Point, LogError> {
        let p = self.vector(dimension, "a position in metres")?;
        if p.amax() > MAX_COORDINATE {
            let expected = format!("coordinates in metres, within ±{MAX_COORDINATE}");
            return Err(self.wrong_as(expected, format!("{:e}", p.amax())));
        }
        Ok(p)
    }

    pub(super) fn normal(&self, dimension: usize) -> Result<Point, LogError> {
        let n = self.vector(dimension, "a unit vector")?;
        let length = n.norm();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            let expected = format!("a vector of length 1 within {UNIT_TOLERANCE}");
            return Err(self.wrong_as(expected, format!("length {length}")));
        }
        Ok(if (length - 1.0).abs() > UNIT_ROUNDING { n / length } else { n })
    }

    /// With the fields of it that nobody knows.
    pub(super) fn pose(self, dimension: usize) -> Result<(Pose, Fields<'a>), LogError> {
        let mut fields = self.fields("an object {\"translation\", \"rotation\"}")?;
        let translation =
            fields.required("translation", "a position in metres")?.position(dimension)?;
        if dimension == 2 {
            let angle = fields.required("rotation", "an angle in radians")?.number()?;
            // Left alone when already in range, so that it is written as it was read.
            let angle = if angle.abs() <= PI { angle } else { angle.sin().atan2(angle.cos()) };
            return Ok((space::planar(translation.x, translation.y, angle), fields));
        }
        let what = "a unit quaternion [x, y, z, w]";
        let rotation = fields.required("rotation", what)?;
        let [x, y, z, w] = rotation.numbers(what)?;
        let q = Quaternion::new(w, x, y, z);
        let length = q.norm();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            let expected = format!("{what} of length 1 within {UNIT_TOLERANCE}");
            return Err(rotation.wrong_as(expected, format!("length {length}")));
        }
        let q = if (length - 1.0).abs() > UNIT_ROUNDING {
            UnitQuaternion::new_normalize(q)
        } else {
            UnitQuaternion::new_unchecked(q)
        };
        Ok((Pose::from_parts(Translation3::from(translation), q), fields))
    }

    /// How the hand moved the object between two grasps: in the plane by a full turn at most. Of motions in degrees
    /// hardly any is less.
    pub(super) fn motion(self, dimension: usize) -> Result<(Pose, Fields<'a>), LogError> {
        let turn = self.value.get("rotation").and_then(Value::as_f64);
        if let Some(turn) = turn.filter(|turn| dimension == 2 && turn.abs() > TAU) {
            let path = format!("{}.rotation", self.path);
            let item = Item { line: self.line, path, value: turn.into() };
            return Err(item.wrong("an angle in radians, of a full turn at most"));
        }
        self.pose(dimension)
    }

    pub(super) fn finger(self, fingers: &[String]) -> Result<usize, LogError> {
        let found = self.value.as_str().and_then(|name| fingers.iter().position(|f| f == name));
        found.ok_or_else(|| {
            self.wrong(if fingers.is_empty() {
                "no finger, as the header names none in `fingers`".to_string()
            } else {
                format!("one of the header's fingers ({})", fingers.join(", "))
            })
        })
    }
}

/// What serde_json says of text that is no JSON, with the last field before it and in our words.
fn malformed(text: &str, error: &serde_json::Error) -> String {
    let column = error.column();
    // serde_json counts lines inside the text it was given: only the column is ours.
    let message = error.to_string();
    let message = message.rsplit_once(" at line ").map_or(&*message, |(m, _)| m);
    let before = text.get(..column.saturating_sub(1)).unwrap_or("");
    let message = match message {
        "expected value" if before.trim().is_empty() => "expected one JSON object",
        "expected value" => "expected a finite number, a text, an array or an object",
        "number out of range" => "expected a finite number, found one out of range",
        other => other,
    };
    // A name that stands twice is named already, and what is before it is another.
    let before = if message.ends_with(TWICE) { "" } else { before };
    let field = before.rsplit_once("\":").and_then(|(head, _)| head.rsplit_once('"'));
    let field = field.map_or(String::new(), |(_, name)| {
        format!(", field `{}`", name.chars().take(40).collect::<String>())
    });
    format!("malformed JSON at column {column}{field}: {message}")
}

/// A value in a few words.
fn describe(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Bool(b) => b.to_string(),
        Value::Number(n) => n.to_string(),
        Value::String(s) if s.chars().count() > 40 => {
            format!("{:?}…", s.chars().take(40).collect::<String>())
        }
        Value::String(s) => format!("{s:?}"),
        Value::Array(a) => format!("an array of {}", a.len()),
        Value::Object(_) => "an object".into(),
    }
}
