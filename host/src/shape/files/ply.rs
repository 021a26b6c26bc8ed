//! PLY: a header that says what each element has, then the elements.

use std::io::Write;

use super::{Place, Soup, Wrong, check_length};
use crate::log::read::unmarked;
use crate::shape::Mesh;
use crate::space::Point;

#[derive(Clone, Copy)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn of(name: &str) -> Option<Number> {
        Some(match name {
            "char" | "int8" => Number::I8,
            "uchar" | "uint8" => Number::U8,
            "short" | "int16" => Number::I16,
            "ushort" | "uint16" => Number::U16,
            "int" | "int32" => Number::I32,
            "uint" | "uint32" => Number::U32,
            "float" | "float32" => Number::F32,
            "double" | "float64" => Number::F64,
            _ => return None,
        })
    }
}

struct Property {
    name: String,
    /// The type of a list's length, for a list.
    length: Option<Number>,
    number: Number,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Soup, Wrong> {
    let (elements, ascii, mut values) = header(bytes)?;
    values.ascii = ascii;
    let mut soup = Soup::default();
    let mut list = Vec::new();
    for element in &elements {
        let find = |names: &[&str]| {
            element.properties.iter().position(|p| names.contains(&p.name.as_str()))
        };
        let (x, y, z) = (find(&["x"]), find(&["y"]), find(&["z"]));
        let is_vertex = element.name == "vertex";
        let corners = find(&["vertex_indices", "vertex_index"]).filter(|_| element.name == "face");
        if is_vertex && [x, y, z].contains(&None) {
            let expected = "properties x, y and z of element vertex";
            return Err(Wrong::new(values.place(), expected, "a header without"));
        }
        if element.properties.is_empty() {
            continue;
        }
        for _ in 0..element.count {
            let mut position = Point::zeros();
            for (i, property) in element.properties.iter().enumerate() {
                let Some(length) = property.length else {
                    let value = values.next(property.number)?;
                    for (axis, index) in [x, y, z].into_iter().enumerate() {
                        if index == Some(i) {
                            position[axis] = value;
                        }
                    }
                    continue;
                };
                let length = values.integer(length)?;
                list.clear();
                for _ in 0..length {
                    if corners == Some(i) {
                        list.push(values.integer(property.number)?);
                    } else {
                        values.next(property.number)?;
                    }
                }
                if corners == Some(i) {
                    if length < 3 {
                        let found = length.to_string();
                        return Err(Wrong::new(values.place(), "at least 3 corners", found));
                    }
                    soup.polygon(&list);
                }
            }
            if is_vertex {
                soup.vertices.push(position);
            }
        }
    }
    Ok(soup)
}

/// Reads up to `end_header`: the elements, whether they are ascii, and where they start.
fn header(bytes: &[u8]) -> Result<(Vec<Element>, bool, Values<'_>), Wrong> {
    let mut elements: Vec<Element> = Vec::new();
    let mut ascii = None;
    let mut position = bytes.len() - unmarked(bytes).len();
    for number in 1.. {
        let place = Place::Line(number);
        let rest = &bytes[position..];
        let Some(length) = rest.iter().position(|b| *b == b'\n') else {
            let expected = if number == 1 { "ply" } else { "end_header" };
            return Err(Wrong::new(place, expected, "the end of the file"));
        };
        position += length + 1;
        let line = String::from_utf8_lossy(&rest[..length]);
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let wrong = |expected: &str| Err(Wrong::new(place, expected, format!("{:?}", line.trim())));
        if number == 1 {
            if words != ["ply"] {
                return wrong("ply");
            }
            continue;
        }
        match words[..] {
            ["format", "ascii", _] => ascii = Some(true),
            ["format", "binary_little_endian", _] => ascii = Some(false),
            ["format", ..] => return wrong("format ascii 1.0 or binary_little_endian 1.0"),
            [] | ["comment" | "obj_info", ..] => {}
            ["element", name, count] => {
                let Ok(count) = count.parse() else { return wrong("element NAME COUNT") };
                elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ref words @ ..] => {
                let (length, kind, name) = match words {
                    ["list", length, kind, name] => (Some(*length), *kind, *name),
                    [kind, name] => (None, *kind, *name),
                    _ => return wrong("property TYPE NAME or property list TYPE TYPE NAME"),
                };
                let types = (length.map(Number::of), Number::of(kind), elements.last_mut());
                match types {
                    (Some(None), ..) | (_, None, _) => return wrong("a number type"),
                    (_, _, None) => return wrong("an element before its properties"),
                    (length, Some(number), Some(element)) => {
                        let length = length.flatten();
                        element.properties.push(Property { name: name.into(), length, number });
                    }
                }
            }
            ["end_header"] => {
                let Some(ascii) = ascii else { return wrong("a format line before end_header") };
                return Ok((elements, ascii, Values { bytes, position, line: number + 1, ascii }));
            }
            _ => return wrong("element, property, comment or end_header"),
        }
    }
    Err(Wrong::new(Place::Byte(position), "end_header", "the end of the file"))
}

/// The numbers after the header, one after the other.
struct Values<'a> {
    bytes: &'a [u8],
    position: usize,
    /// The line of `position`, in an ascii file.
    line: usize,
    ascii: bool,
}

impl Values<'_> {
    fn place(&self) -> Place {
        if self.ascii { Place::Line(self.line) } else { Place::Byte(self.position) }
    }

    fn next(&mut self, kind: Number) -> Result<f64, Wrong> {
        if self.ascii {
            return self.word();
        }
        Ok(match kind {
            Number::I8 => i8::from_le_bytes(self.take()?) as f64,
            Number::U8 => u8::from_le_bytes(self.take()?) as f64,
            Number::I16 => i16::from_le_bytes(self.take()?) as f64,
            Number::U16 => u16::from_le_bytes(self.take()?) as f64,
            Number::I32 => i32::from_le_bytes(self.take()?) as f64,
            Number::U32 => u32::from_le_bytes(self.take()?) as f64,
            Number::F32 => f32::from_le_bytes(self.take()?) as f64,
            Number::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    /// A length or an index.
    fn integer(&mut self, kind: Number) -> Result<u32, Wrong> {
        let place = self.place();
        let value = self.next(kind)?;
        if value.fract() == 0.0 && (0.0..=u32::MAX as f64).contains(&value) {
            return Ok(value as u32);
        }
        Err(Wrong::new(place, "a whole number from 0", value.to_string()))
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], Wrong> {
        let taken = self.bytes[self.position..].first_chunk::<N>().ok_or_else(|| {
            Wrong::new(self.place(), "more elements, as the header says", "the end of the file")
        })?;
        self.position += N;
        Ok(*taken)
    }

    fn word(&mut self) -> Result<f64, Wrong> {
        while let Some(byte) = self.bytes.get(self.position).filter(|b| b.is_ascii_whitespace()) {
            self.line += usize::from(*byte == b'\n');
            self.position += 1;
        }
        let rest = &self.bytes[self.position..];
        let length = rest.iter().position(|b| b.is_ascii_whitespace()).unwrap_or(rest.len());
        if length == 0 {
            let expected = "more elements, as the header says";
            return Err(Wrong::new(self.place(), expected, "the end of the file"));
        }
        self.position += length;
        let word = String::from_utf8_lossy(&rest[..length]);
        word.parse().map_err(|_| Wrong::new(self.place(), "a number", format!("{word:?}")))
    }
}

pub(super) fn write(
    writer: &mut dyn Write,
    mesh: &Mesh,
    normals: Option<&[Point]>,
    deviations: Option<&[f64]>,
) -> std::io::Result<()> {
    let vertices = mesh.vertices();
    check_length("normals", normals.map(<[Point]>::len), vertices.len())?;
    check_length("deviations", deviations.map(<[f64]>::len), vertices.len())?;
    writeln!(writer, "ply\nformat binary_little_endian 1.0\ncomment metres, outward triangles")?;
    writeln!(writer, "element vertex {}", vertices.len())?;
    writeln!(writer, "property double x\nproperty double y\nproperty double z")?;
    if normals.is_some() {
        writeln!(writer, "property float nx\nproperty float ny\nproperty float nz")?;
    }
    if deviations.is_some() {
        writeln!(writer, "property float uncertainty")?;
    }
    writeln!(writer, "element face {}", mesh.triangles().len())?;
    writeln!(writer, "property list uchar int vertex_indices\nend_header")?;
    for (i, vertex) in vertices.iter().enumerate() {
        for x in vertex.iter() {
            writer.write_all(&x.to_le_bytes())?;
        }
        for x in normals.iter().flat_map(|n| n[i].iter()) {
            writer.write_all(&(*x as f32).to_le_bytes())?;
        }
        for deviation in deviations.iter().map(|d| d[i] as f32) {
            writer.write_all(&deviation.to_le_bytes())?;
        }
    }
    for triangle in mesh.triangles() {
        writer.write_all(&[3])?;
        for corner in triangle {
            writer.write_all(&(*corner as i32).to_le_bytes())?;
        }
    }
    Ok(())
}
