//! STL, ascii and binary: triangles without shared vertices, which are merged where equal.

use std::io::{Error, ErrorKind, Result as IoResult, Write};

use super::{Merged, Place, Soup, Wrong, point, text};
use crate::log::read::unmarked;
use crate::shape::Mesh;
use crate::space::Point;

/// Bytes before the triangles, and of each.
const HEADER: usize = 84;
const TRIANGLE: usize = 50;

pub(super) fn parse(bytes: &[u8]) -> Result<Soup, Wrong> {
    // Many binary files begin with the word `solid` too. Only they have zero bytes, and some of them
    // something behind the triangles.
    let count =
        bytes.get(80..HEADER).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]]) as usize);
    let expected = count.and_then(|n| n.checked_mul(TRIANGLE)?.checked_add(HEADER));
    let solid = unmarked(bytes)
        .trim_ascii_start()
        .get(..5)
        .is_some_and(|w| w.eq_ignore_ascii_case(b"solid"));
    if solid && !bytes.contains(&0) {
        return ascii(&text(bytes));
    }
    let found = format!("{} bytes", bytes.len());
    match expected {
        // Whole triangles behind are some that the header does not count.
        Some(length) if bytes.len() > length && (bytes.len() - length).is_multiple_of(TRIANGLE) => {
            let [told, found] = [length, bytes.len()].map(|end| (end - HEADER) / TRIANGLE);
            let expected = format!("{told} triangles, as the header says");
            Err(Wrong::new(Place::Byte(length), expected, found.to_string()))
        }
        Some(length) if length <= bytes.len() => Ok(binary(&bytes[HEADER..length])),
        Some(length) => {
            let expected = format!("{length} bytes, as the header says");
            Err(Wrong::new(Place::Byte(bytes.len()), expected, found))
        }
        None => Err(Wrong::new(Place::Byte(0), "an STL file", found)),
    }
}

fn binary(bytes: &[u8]) -> Soup {
    let mut merged = Merged::default();
    for triangle in bytes.chunks_exact(TRIANGLE) {
        let number = |i: usize| {
            let b = &triangle[4 * i..4 * i + 4];
            f32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64
        };
        // The first three numbers are the normal, which the corners' order tells as well.
        let corner = |c: usize| Point::new(number(3 * c), number(3 * c + 1), number(3 * c + 2));
        merged.triangle([corner(1), corner(2), corner(3)]);
    }
    merged.soup
}

fn ascii(text: &str) -> Result<Soup, Wrong> {
    let mut merged = Merged::default();
    let mut corners: Vec<Point> = Vec::new();
    let mut last = 0;
    let mut open = false;
    for (number, line) in text.lines().enumerate() {
        last = number + 1;
        let place = Place::Line(last);
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let keyword = words.first().map(|word| word.to_ascii_lowercase());
        match keyword.as_deref() {
            Some("vertex") => corners.push(point(place, &words[1..])?),
            Some("endloop") => {
                let &[a, b, c] = &corners[..] else {
                    let found = corners.len().to_string();
                    return Err(Wrong::new(place, "3 vertices in a loop", found));
                };
                merged.triangle([a, b, c]);
                corners.clear();
            }
            Some("solid") => open = true,
            Some("endsolid") => open = false,
            None | Some("facet" | "outer" | "endfacet") => {}
            Some(word) => {
                let expected = "solid, facet, outer loop, vertex, endloop, endfacet or endsolid";
                return Err(Wrong::new(place, expected, format!("{word:?}")));
            }
        }
    }
    if open || !corners.is_empty() {
        return Err(Wrong::new(Place::Line(last + 1), "endsolid", "the end of the file"));
    }
    Ok(merged.soup)
}

/// Binary, single precision, each triangle with its normal (zero where it has no area).
pub(super) fn write(writer: &mut dyn Write, mesh: &Mesh) -> IoResult<()> {
    let triangles = mesh.triangles();
    let count = u32::try_from(triangles.len()).map_err(|_| {
        Error::new(ErrorKind::InvalidInput, format!("{} triangles: too many", triangles.len()))
    })?;
    let mut header = [b' '; HEADER - 4];
    // It must not begin like an ascii file.
    header[..7].copy_from_slice(b"tactile");
    writer.write_all(&header)?;
    writer.write_all(&count.to_le_bytes())?;
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| mesh.vertices()[v as usize]);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
        for point in [normal, a, b, c] {
            for number in point.iter() {
                writer.write_all(&(*number as f32).to_le_bytes())?;
            }
        }
        writer.write_all(&[0; 2])?;
    }
    Ok(())
}
