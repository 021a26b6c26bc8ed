//! Reading: lines into poses and edges, then ids into indices.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use nalgebra::SMatrix;

use super::entry::{Entry, LONGEST, Repair};
use super::{G2o, G2oError, Graph, Skipped, Wrong, number};
use crate::graph::pose::{Edge, Group, PoseGraph, Se2, Se3};
use crate::log::read::unmarked;

/// No line of a pose graph is nearly as long, in bytes: what is longer is another kind of file.
const LONGEST_LINE: u64 = 1 << 16;

/// Kinds of skipped lines that are told apart; all others count as one.
const KINDS: usize = 16;

/// Bounds that keep every cost and every sum in a solver finite: metres, radians, 1/m² or 1/rad².
const FARTHEST: f64 = 1e12;
const WIDEST: f64 = 1e6;
const HEAVIEST: f64 = 1e100;

/// Reads a file; nothing of it is held but the graph and the lines that are not understood.
///
/// # Errors
/// When it cannot be read or is no pose graph; see [`parse`].
pub fn read(path: &Path) -> Result<G2o, G2oError> {
    let unreadable = |source| G2oError::Io { file: path.into(), action: "read", source };
    let file = std::fs::File::open(path).map_err(unreadable)?;
    parse(BufReader::with_capacity(1 << 18, file), path)
}

/// Reads what `name` is said to hold.
///
/// Edges may come before their poses and poses in any order; a file of edges alone has the poses that
/// they name, by id. Several edges between the same poses are several measurements. An information
/// matrix may be anything finite: whether it makes sense is for the diagnosis to say.
///
/// # Errors
/// Names line and field of the first thing that is wrong: too few or too many words, what is no finite
/// number of sensible size, no id, or a zero quaternion; a pose given twice; an edge from a pose to
/// itself or to one that is not there; planar and spatial lines in one file; no pose at all.
pub fn parse(mut input: impl BufRead, name: &Path) -> Result<G2o, G2oError> {
    let mut content = Content::default();
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let read = (&mut input).take(LONGEST_LINE).read_until(b'\n', &mut line);
        match read {
            Ok(0) => break,
            Ok(n) if n as u64 == LONGEST_LINE && line.last() != Some(&b'\n') => {
                let expected = format!("at most {LONGEST_LINE} bytes");
                return Err(Wrong::at(number, "length", expected, "more").of(name));
            }
            Ok(_) => content.line(number, &line).map_err(|wrong| wrong.of(name))?,
            Err(source) => {
                return Err(G2oError::Io { file: name.into(), action: "read", source });
            }
        }
    }
    content.finish().map_err(|wrong| wrong.of(name))
}

/// The words of a line, up to a comment, and where it is.
struct Words<'a> {
    rest: &'a [u8],
    line: usize,
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let word = &self.rest[start..];
        if word[0] == b'#' {
            self.rest = &[];
            return None;
        }
        let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
        self.rest = &word[end..];
        Some(&word[..end])
    }
}

/// A word as it is shown in a message.
fn shown(word: Option<&[u8]>) -> String {
    match word {
        None => "the end of the line".into(),
        Some(word) if word.len() > 40 => format!("{:?}…", String::from_utf8_lossy(&word[..40])),
        Some(word) => format!("{:?}", String::from_utf8_lossy(word)),
    }
}

impl Words<'_> {
    fn wrong(&self, field: &str, expected: impl Into<String>, word: Option<&[u8]>) -> Wrong {
        Wrong::at(self.line, field, expected, shown(word))
    }

    fn id(&mut self, field: &str) -> Result<u64, Wrong> {
        let word = self.next();
        self.id_in(field, word)
    }

    fn id_in(&self, field: &str, word: Option<&[u8]>) -> Result<u64, Wrong> {
        let id = word.and_then(|w| std::str::from_utf8(w).ok()?.parse().ok());
        id.ok_or_else(|| self.wrong(field, "the id of a pose (a whole number from 0)", word))
    }

    fn number(&mut self, field: &str, bound: f64) -> Result<f64, Wrong> {
        let word = self.next();
        let value = word.and_then(number::parse).filter(|v| v.abs() <= bound);
        value.ok_or_else(|| self.wrong(field, format!("a finite number within ±{bound:e}"), word))
    }

    fn pose<G: Entry<D>, const D: usize>(&mut self) -> Result<(G, Repair), Wrong> {
        let mut numbers = [0.0; LONGEST];
        for (i, field) in G::FIELDS.iter().enumerate() {
            let bound = if i < G::ROTATION { FARTHEST } else { WIDEST };
            numbers[i] = self.number(field, bound)?;
        }
        G::from_numbers(&numbers[..G::FIELDS.len()])
            .ok_or_else(|| Wrong::at(self.line, "qx to qw", "a unit quaternion", "one of length 0"))
    }

    fn information<const D: usize>(&mut self) -> Result<SMatrix<f64, D, D>, Wrong> {
        let mut matrix = SMatrix::zeros();
        for row in 0..D {
            for column in row..D {
                let value = match self.number("", HEAVIEST) {
                    Ok(value) => value,
                    Err(wrong) => {
                        let field = format!("information I{}{}", row + 1, column + 1);
                        return Err(Wrong { field, ..wrong });
                    }
                };
                matrix[(row, column)] = value;
                matrix[(column, row)] = value;
            }
        }
        Ok(matrix)
    }

    fn end(&mut self) -> Result<(), Wrong> {
        match self.next() {
            None => Ok(()),
            word => Err(self.wrong("after the last number", "the end of the line", word)),
        }
    }
}

/// What has been read so far.
#[derive(Default)]
struct Content {
    planar: Parts<Se2, 3>,
    spatial: Parts<Se3, 6>,
    /// Ids and lines of the poses that stay.
    fixed: Vec<(u64, usize)>,
    skipped: Vec<Skipped>,
    unknown: Vec<String>,
}

/// The lines of one dimension; those of poses and edges count from 1.
struct Parts<G, const D: usize> {
    ids: Vec<u64>,
    poses: Vec<G>,
    pose_lines: Vec<usize>,
    /// Ids of the poses of each edge.
    ends: Vec<[u64; 2]>,
    /// With indices to be filled in.
    edges: Vec<Edge<G, D>>,
    edge_lines: Vec<usize>,
    normalised: usize,
    wide_angles: usize,
}

impl<G, const D: usize> Default for Parts<G, D> {
    fn default() -> Self {
        Parts {
            ids: Vec::new(),
            poses: Vec::new(),
            pose_lines: Vec::new(),
            ends: Vec::new(),
            edges: Vec::new(),
            edge_lines: Vec::new(),
            normalised: 0,
            wide_angles: 0,
        }
    }
}

impl Content {
    fn line(&mut self, line: usize, text: &[u8]) -> Result<(), Wrong> {
        let text = if line == 1 { unmarked(text) } else { text };
        let mut words = Words { rest: text, line };
        let Some(kind) = words.next() else { return Ok(()) };
        let known = self.planar.line(kind, &mut words)? || self.spatial.line(kind, &mut words)?;
        if known {
            if !self.planar.is_empty() && !self.spatial.is_empty() {
                let expected = "lines of the plane (SE2) or of space (SE3), not both";
                return Err(words.wrong("kind", expected, Some(kind)));
            }
            return Ok(());
        }
        if kind == b"FIX" {
            self.fixed.push((words.id("id")?, line));
            while let Some(word) = words.next() {
                self.fixed.push((words.id_in("id", Some(word))?, line));
            }
            return Ok(());
        }
        self.skip(line, kind);
        self.unknown.push(String::from_utf8_lossy(text.trim_ascii_end()).into_owned());
        Ok(())
    }

    fn skip(&mut self, line: usize, kind: &[u8]) {
        let mut kind = String::from_utf8_lossy(&kind[..kind.len().min(40)]).into_owned();
        if let Some(skipped) = self.skipped.iter_mut().find(|s| s.kind == kind) {
            skipped.count += 1;
            return;
        }
        if self.skipped.len() >= KINDS {
            kind = "others".into();
            if let Some(others) = self.skipped.get_mut(KINDS) {
                others.count += 1;
                return;
            }
        }
        self.skipped.push(Skipped { kind, count: 1, line });
    }

    fn finish(self) -> Result<G2o, Wrong> {
        let Content { planar, spatial, fixed, skipped, unknown } = self;
        if planar.is_empty() && spatial.is_empty() {
            let found = match skipped.first() {
                Some(first) => format!("none, but {} in line {}", first.kind, first.line),
                None => "none".into(),
            };
            let expected = "lines VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT or EDGE_SE3:QUAT";
            return Err(Wrong::whole(expected, found));
        }
        let file = if spatial.is_empty() {
            planar.finish(&fixed, Graph::Planar)
        } else {
            spatial.finish(&fixed, Graph::Spatial)
        }?;
        Ok(G2o { skipped, unknown, ..file })
    }
}

impl<G: Entry<D>, const D: usize> Parts<G, D> {
    fn is_empty(&self) -> bool {
        self.ids.is_empty() && self.edges.is_empty()
    }

    /// Takes the line in, if it is about this group.
    fn line(&mut self, kind: &[u8], words: &mut Words<'_>) -> Result<bool, Wrong> {
        if kind == G::EDGE.as_bytes() {
            let ends = [words.id("from")?, words.id("to")?];
            let (measured, repair) = words.pose()?;
            let information = words.information()?;
            if ends[0] == ends[1] {
                let found = format!("{} twice", ends[0]);
                return Err(Wrong::at(words.line, "from and to", "two different poses", found));
            }
            self.count(repair);
            self.ends.push(ends);
            self.edges.push(Edge { from: 0, to: 0, measured, information });
            self.edge_lines.push(words.line);
        } else if kind == G::VERTEX.as_bytes() {
            self.ids.push(words.id("id")?);
            let (pose, repair) = words.pose()?;
            self.count(repair);
            self.poses.push(pose);
            self.pose_lines.push(words.line);
        } else {
            return Ok(false);
        }
        words.end()?;
        Ok(true)
    }

    fn count(&mut self, repair: Repair) {
        self.normalised += usize::from(repair == Repair::Normalised);
        self.wide_angles += usize::from(repair == Repair::Wrapped);
    }

    fn finish(
        mut self,
        fixed: &[(u64, usize)],
        graph: impl FnOnce(PoseGraph<G, D>) -> Graph,
    ) -> Result<G2o, Wrong> {
        let has_poses = !self.ids.is_empty();
        if !has_poses {
            self.ids = self.ends.iter().flatten().copied().collect();
            self.ids.sort_unstable();
            self.ids.dedup();
            self.poses = vec![<G as Group<D>>::identity(); self.ids.len()];
        }
        let indices = Indices::of(&self.ids).map_err(|[first, second]| {
            let expected = format!("an id not used before (line {})", self.pose_lines[first]);
            Wrong::at(self.pose_lines[second], "id", expected, self.ids[second].to_string())
        })?;
        let index = |id: u64, line: usize, field: &str| {
            indices.get(id).ok_or_else(|| {
                let expected = format!("the id of a pose with a {} line", G::VERTEX);
                Wrong::at(line, field, expected, format!("{id}, which has none"))
            })
        };
        for ((edge, &[from, to]), &line) in
            self.edges.iter_mut().zip(&self.ends).zip(&self.edge_lines)
        {
            edge.from = index(from, line, "from")?;
            edge.to = index(to, line, "to")?;
        }
        let mut stays = vec![false; self.ids.len()];
        let mut kept = Vec::new();
        for &(id, line) in fixed {
            let pose = index(id, line, "id")?;
            if !std::mem::replace(&mut stays[pose], true) {
                kept.push(pose);
            }
        }
        drop(indices);
        let Parts { ids, poses, edges, edge_lines, normalised, wide_angles, .. } = self;
        let graph = graph(PoseGraph { ids, poses, edges, fixed: kept });
        let (skipped, unknown) = Default::default();
        Ok(G2o { graph, has_poses, edge_lines, skipped, unknown, normalised, wide_angles })
    }
}

/// Which pose has which id.
enum Indices<'a> {
    /// Ids that count up by one, as in nearly every file: no table is needed.
    Counting {
        first: u64,
        ids: &'a [u64],
    },
    Any(HashMap<u64, usize>),
}

impl Indices<'_> {
    /// Of ids in their order, or the indices of the first two that are the same.
    fn of(ids: &[u64]) -> Result<Indices<'_>, [usize; 2]> {
        let first = ids.first().copied().unwrap_or(0);
        if ids.iter().enumerate().all(|(i, id)| id.checked_sub(first) == Some(i as u64)) {
            return Ok(Indices::Counting { first, ids });
        }
        let mut indices = HashMap::with_capacity(ids.len());
        for (i, &id) in ids.iter().enumerate() {
            if let Some(before) = indices.insert(id, i) {
                return Err([before, i]);
            }
        }
        Ok(Indices::Any(indices))
    }

    fn get(&self, id: u64) -> Option<usize> {
        match self {
            Indices::Counting { first, ids } => {
                let index = usize::try_from(id.checked_sub(*first)?).ok()?;
                (index < ids.len()).then_some(index)
            }
            Indices::Any(indices) => indices.get(&id).copied(),
        }
    }
}
