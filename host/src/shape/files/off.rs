//! OFF: counts, vertices, faces.

use super::{Place, Soup, Wrong, point, text};

pub(super) fn parse(bytes: &[u8]) -> Result<Soup, Wrong> {
    let text = text(bytes);
    let end = Place::Line(text.lines().count() + 1);
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(number, line)| {
            let line = line.split('#').next().unwrap_or("");
            (Place::Line(number + 1), line.split_ascii_whitespace().collect::<Vec<_>>())
        })
        .filter(|(_, words)| !words.is_empty());
    let mut next = |expected: &str| {
        lines.next().ok_or_else(|| Wrong::new(end, expected, "the end of the file"))
    };
    let (place, mut words) = next("OFF")?;
    if words[0] != "OFF" {
        return Err(Wrong::new(place, "OFF", format!("{:?}", words[0])));
    }
    words.remove(0);
    let counts = "the numbers of vertices and faces";
    let (place, words) = if words.is_empty() { next(counts)? } else { (place, words) };
    let count = |i: usize| words.get(i).and_then(|w| w.parse::<usize>().ok());
    let (Some(vertices), Some(faces)) = (count(0), count(1)) else {
        return Err(Wrong::new(place, counts, format!("{:?}", words.join(" "))));
    };
    let mut soup = Soup::default();
    for _ in 0..vertices {
        let (place, words) = next("a vertex")?;
        soup.vertices.push(point(place, &words)?);
    }
    for _ in 0..faces {
        let (place, words) = next("a face")?;
        // What follows the corners is a colour.
        let corners: Option<Vec<u32>> =
            words.iter().map(|w| w.parse().ok()).take_while(Option::is_some).collect();
        let corners = corners.unwrap_or_default();
        match corners.split_first() {
            Some((&n, rest)) if n >= 3 && rest.len() >= n as usize => {
                soup.polygon(&rest[..n as usize]);
            }
            _ => {
                let expected = "a face: the number of its corners (at least 3) and their vertices";
                return Err(Wrong::new(place, expected, format!("{:?}", words.join(" "))));
            }
        }
    }
    Ok(soup)
}
