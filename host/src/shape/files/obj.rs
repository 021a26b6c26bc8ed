//! Wavefront OBJ: `v` and `f` lines.

use std::io::{Result as IoResult, Write};

use super::{Place, Soup, Wrong, point, text};
use crate::shape::Mesh;

pub(super) fn parse(bytes: &[u8]) -> Result<Soup, Wrong> {
    let mut soup = Soup::default();
    let mut corners = Vec::new();
    for (number, line) in text(bytes).lines().enumerate() {
        let place = Place::Line(number + 1);
        let line = line.split('#').next().unwrap_or("");
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.first() {
            Some(&"v") => soup.vertices.push(point(place, &words[1..])?),
            Some(&"f") => {
                if words.len() < 4 {
                    let found = format!("{} corners", words.len() - 1);
                    return Err(Wrong::new(place, "a face of at least 3 corners", found));
                }
                corners.clear();
                for word in &words[1..] {
                    corners.push(index(place, word, soup.vertices.len())?);
                }
                soup.polygon(&corners);
            }
            // Normals, texture, groups, materials.
            _ => {}
        }
    }
    Ok(soup)
}

/// Vertices with as many digits as it takes, then triangles.
pub(super) fn write(writer: &mut dyn Write, mesh: &Mesh) -> IoResult<()> {
    for v in mesh.vertices() {
        writeln!(writer, "v {} {} {}", v.x, v.y, v.z)?;
    }
    for [a, b, c] in mesh.triangles() {
        writeln!(writer, "f {} {} {}", u64::from(*a) + 1, u64::from(*b) + 1, u64::from(*c) + 1)?;
    }
    Ok(())
}

/// The vertex of a corner `v`, `v/t`, `v//n` or `v/t/n`: from 1, or back from the newest.
fn index(place: Place, word: &str, vertices: usize) -> Result<u32, Wrong> {
    let number: Option<i64> = word.split('/').next().and_then(|v| v.parse().ok());
    let index = match number {
        Some(n) if n > 0 => Some(n - 1),
        Some(n) if n < 0 => Some(vertices as i64 + n),
        _ => None,
    };
    index
        .and_then(|i| u32::try_from(i).ok())
        .ok_or_else(|| Wrong::new(place, "the number of a vertex, from 1", format!("{word:?}")))
}
