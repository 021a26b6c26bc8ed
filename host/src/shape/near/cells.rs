//! Boxes of a lattice, and how they are halved.

use std::ops::Range;

use crate::shape::lattice::Lattice;

/// A box of the lattice: the place of its lowest node in the samples. The rest is its [`Form`].
#[derive(Clone, Copy)]
pub(super) struct Cell {
    pub low: usize,
    /// The greatest slope the field is believed to have within, metres per spacing.
    pub steepest: f64,
}

/// What cells of one size have in common; flat along axes the lattice does not have. Nodes are
/// places relative to the lowest one.
pub(super) struct Form {
    /// Spacings along each axis.
    pub size: [usize; 3],
    /// Bit a of the number says which end of axis a; some are equal where the cell is flat.
    pub corners: [usize; 8],
    pub diagonal: f64,
    /// Those of the cell once it is halved: corners, then the middles of edges, of faces, of the
    /// cell.
    pub nodes: Vec<usize>,
    /// Which of `nodes` are of each of these four kinds.
    pub kinds: [Range<usize>; 4],
    /// For each of `nodes` those of earlier kinds no further away than its nearest corner, and how
    /// far, in spacings.
    pub witnesses: Vec<Vec<(usize, f64)>>,
    /// The lowest node and the size of each part.
    pub parts: Vec<(usize, [usize; 3])>,
}

impl Form {
    /// Of cells that are halved `half` spacings from the lower ends, where they are longer.
    fn new(lattice: &Lattice, size: [usize; 3], half: usize) -> Self {
        let stops = size.map(|size| {
            let mut stops = vec![0, half, size];
            stops.retain(|s| *s <= size);
            stops.dedup();
            stops
        });
        let mut nodes = combinations(&stops);
        let kind = |n: &[usize; 3]| (0..3).filter(|a| n[*a] != 0 && n[*a] != size[*a]).count();
        nodes.sort_by_key(kind);
        let first = |of: usize| nodes.partition_point(|n| kind(n) < of);
        let corners = std::array::from_fn(|c| {
            std::array::from_fn(|a| if c >> a & 1 == 0 { 0 } else { size[a] })
        });
        let witnesses = |n: &[usize; 3]| {
            let corner = corners.map(|c| distance(c, *n)).into_iter().fold(f64::INFINITY, f64::min);
            let earlier = nodes[..first(kind(n))].iter();
            let near = earlier.map(|w| (lattice.index(*w), distance(*w, *n)));
            near.filter(|(_, apart)| *apart <= corner).collect()
        };
        let spans = stops.each_ref().map(|stops| match stops[..] {
            [only] => vec![(only, 0)],
            _ => stops.windows(2).map(|s| (s[0], s[1] - s[0])).collect(),
        });
        let part = |p: &[(usize, usize); 3]| (lattice.index(p.map(|s| s.0)), p.map(|s| s.1));
        Form {
            size,
            corners: corners.map(|c| lattice.index(c)),
            diagonal: distance([0; 3], size),
            kinds: std::array::from_fn(|of| first(of)..first(of + 1)),
            witnesses: nodes.iter().map(witnesses).collect(),
            nodes: nodes.iter().map(|n| lattice.index(*n)).collect(),
            parts: combinations(&spans).iter().map(part).collect(),
        }
    }
}

/// One of each, in every way; the first runs fastest.
pub(super) fn combinations<T: Copy>([xs, ys, zs]: &[Vec<T>; 3]) -> Vec<[T; 3]> {
    let rows = zs.iter().flat_map(|z| ys.iter().map(move |y| (*y, *z)));
    rows.flat_map(|(y, z)| xs.iter().map(move |x| [*x, y, z])).collect()
}

/// Cells by their form, all to be halved at the same distance.
pub(super) struct Cells {
    pub half: usize,
    pub groups: Vec<(Form, Vec<Cell>)>,
}

impl Cells {
    pub fn push(&mut self, lattice: &Lattice, size: [usize; 3], cell: Cell) {
        match self.groups.iter_mut().find(|(form, _)| form.size == size) {
            Some((_, cells)) => cells.push(cell),
            None => self.groups.push((Form::new(lattice, size, self.half), vec![cell])),
        }
    }
}

/// In spacings.
fn distance(a: [usize; 3], b: [usize; 3]) -> f64 {
    let squared = |axis: usize| (a[axis].abs_diff(b[axis]) as f64).powi(2);
    (squared(0) + squared(1) + squared(2)).sqrt()
}
