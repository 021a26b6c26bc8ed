//! Which blocks of the factor are not zero, and in which order they are computed.

use std::ops::Range;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

/// No index.
const NONE: u32 = u32::MAX;

/// The factor would need more than memory allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the factor of this graph would have more than {limit} blocks: it is too densely connected"
)]
pub struct TooDense {
    /// Blocks the factor may have.
    pub limit: usize,
}

/// Neighbouring columns of the factor with the same rows below them.
#[derive(Clone, Debug)]
pub(super) struct Supernode {
    /// Position of the first column.
    pub first: usize,
    /// Number of columns.
    pub columns: usize,
    /// Rows below the columns: where in `Structure::rows`.
    pub rows: Range<usize>,
    /// The supernode of the first row.
    pub parent: Option<usize>,
    /// Whether other supernodes have this one for a parent.
    pub children: Range<usize>,
}

/// The symbolic factorisation of a symmetric matrix of blocks.
#[derive(Clone, Debug)]
pub struct Structure {
    /// Position in the order of elimination, of every block.
    position: Vec<u32>,
    /// Blocks below the diagonal, by column: `below[starts[c]..starts[c + 1]]` are its row positions.
    pub(super) starts: Vec<usize>,
    pub(super) below: Vec<u32>,
    pub(super) nodes: Vec<Supernode>,
    /// Row positions of all supernodes, and where each stands in the parent: first the parent's
    /// columns are counted, then its rows.
    pub(super) rows: Vec<u32>,
    pub(super) relative: Vec<u32>,
    /// Children of all supernodes, ascending.
    pub(super) children: Vec<u32>,
    /// Where in its supernode each block below the diagonal stands: row, counted as in `relative`.
    pub(super) local: Vec<u32>,
    /// Column and row positions of blocks that the factor leaves out, ascending.
    pub(super) outside: Vec<(u32, u32)>,
}

impl Structure {
    /// The structure of `blocks` × `blocks` blocks in which the `pairs` (any order, repeated or not,
    /// all below `blocks`) are not zero, nor is the diagonal. The order of elimination is by
    /// approximate minimum degree (Amestoy, Davis and Duff 1996) on the graph of blocks.
    ///
    /// # Errors
    /// A factor of more than `limit` blocks.
    pub fn new(
        blocks: usize,
        pairs: impl Iterator<Item = (usize, usize)> + Clone,
        limit: usize,
    ) -> Result<Self, TooDense> {
        let neighbours = Neighbours::new(blocks, pairs);
        let position = minimum_degree(&neighbours);
        let neighbours = neighbours.renumbered(&position);
        let parent = elimination_tree(&neighbours);
        let (postorder, parent) = postordered(&parent);
        let neighbours = neighbours.renumbered(&postorder);
        let position: Vec<u32> = position.iter().map(|&p| postorder[p as usize]).collect();
        let columns = Columns::new(&neighbours, &parent, limit)?.amalgamated();
        Ok(columns.structure(&neighbours, position))
    }

    /// A structure whose factor is that of the `inside` pairs alone, which should be few, such as a
    /// tree; matrices have the `outside` pairs, too, and are solved with iteratively
    /// ([`conjugate_gradients`](super::conjugate_gradients)).
    ///
    /// # Errors
    /// A factor of more than `limit` blocks.
    pub fn partial(
        blocks: usize,
        inside: impl Iterator<Item = (usize, usize)> + Clone,
        outside: impl Iterator<Item = (usize, usize)>,
        limit: usize,
    ) -> Result<Self, TooDense> {
        let mut structure = Self::new(blocks, inside, limit)?;
        let position = |block: usize| structure.position[block];
        let mut pairs: Vec<(u32, u32)> = outside
            .map(|(a, b)| (position(a), position(b)))
            .map(|(a, b)| (a.min(b), a.max(b)))
            .filter(|&(column, row)| {
                row != column && structure.slot(row as usize, column as usize).is_none()
            })
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        structure.outside = pairs;
        Ok(structure)
    }

    /// Whether the factor of a matrix with this structure is that of the whole matrix.
    pub fn is_complete(&self) -> bool {
        self.outside.is_empty()
    }

    /// Number of block rows.
    pub fn blocks(&self) -> usize {
        self.position.len()
    }

    /// Number of pairs of blocks that are not zero, below the diagonal.
    pub fn pairs(&self) -> usize {
        self.below.len() + self.outside.len()
    }

    /// Where `block` stands in the order of elimination, in which vectors and matrices are held.
    pub fn position(&self, block: usize) -> usize {
        self.position[block] as usize
    }

    /// Where the block of row position `row` and column position `column` < `row` is held in a
    /// `BlockMatrix`, if it is.
    pub fn slot(&self, row: usize, column: usize) -> Option<usize> {
        let range = self.starts[column]..self.starts[column + 1];
        match self.below[range.clone()].binary_search(&(row as u32)) {
            Ok(at) => Some(range.start + at),
            Err(_) if self.outside.is_empty() => None,
            Err(_) => {
                let at = self.outside.binary_search(&(column as u32, row as u32)).ok()?;
                Some(self.below.len() + at)
            }
        }
    }

    /// Blocks of the factor, on and below the diagonal.
    pub fn factor_blocks(&self) -> usize {
        let of = |n: &Supernode| n.columns * (n.columns + 1) / 2 + n.columns * n.rows.len();
        self.nodes.iter().map(of).sum()
    }

    /// Multiplications a factorisation takes, in blocks.
    pub fn products(&self) -> f64 {
        let of = |n: &Supernode| {
            let last = n.rows.len() as f64;
            (0..n.columns).map(|c| (last + c as f64 + 1.0).powi(2) / 2.0).sum::<f64>()
        };
        self.nodes.iter().map(of).sum()
    }
}

/// Neighbours of every block, ascending and without itself.
struct Neighbours {
    starts: Vec<usize>,
    list: Vec<u32>,
}

impl Neighbours {
    fn new(blocks: usize, pairs: impl Iterator<Item = (usize, usize)> + Clone) -> Self {
        let mut starts = vec![0; blocks + 1];
        let pairs = pairs.filter(|(a, b)| a != b);
        for (a, b) in pairs.clone() {
            starts[a + 1] += 1;
            starts[b + 1] += 1;
        }
        for i in 0..blocks {
            starts[i + 1] += starts[i];
        }
        let (mut next, mut list) = (starts.clone(), vec![0; starts[blocks]]);
        for (a, b) in pairs {
            list[next[a]] = b as u32;
            list[next[b]] = a as u32;
            next[a] += 1;
            next[b] += 1;
        }
        let mut to = 0;
        for i in 0..blocks {
            let range = starts[i]..starts[i + 1];
            list[range.clone()].sort_unstable();
            starts[i] = to;
            for at in range {
                if to == starts[i] || list[to - 1] != list[at] {
                    list[to] = list[at];
                    to += 1;
                }
            }
        }
        starts[blocks] = to;
        list.truncate(to);
        Self { starts, list }
    }

    fn blocks(&self) -> usize {
        self.starts.len() - 1
    }

    fn of(&self, block: usize) -> &[u32] {
        &self.list[self.starts[block]..self.starts[block + 1]]
    }

    /// The same graph, block i under the name `name[i]`. Neighbours ascend again: each block is put
    /// on its neighbours' lists in the order of its new name.
    fn renumbered(&self, name: &[u32]) -> Self {
        let blocks = self.blocks();
        let mut old = vec![0; blocks];
        let mut starts = vec![0; blocks + 1];
        for i in 0..blocks {
            old[name[i] as usize] = i;
            starts[name[i] as usize + 1] = self.of(i).len();
        }
        for i in 0..blocks {
            starts[i + 1] += starts[i];
        }
        let (mut next, mut list) = (starts.clone(), vec![0; self.list.len()]);
        for new in 0..blocks {
            for &neighbour in self.of(old[new]) {
                let at = &mut next[name[neighbour as usize] as usize];
                list[*at] = new as u32;
                *at += 1;
            }
        }
        Self { starts, list }
    }
}

/// The position of every block in an order of little fill.
fn minimum_degree(graph: &Neighbours) -> Vec<u32> {
    let blocks = graph.blocks();
    let natural = (0..blocks as u32).collect();
    let Ok(starts) = graph.starts.iter().map(|&s| u32::try_from(s)).collect::<Result<Vec<_>, _>>()
    else {
        return natural;
    };
    let (mut order, mut position) = (vec![0u32; blocks], vec![0u32; blocks]);
    let pattern =
        SymbolicSparseColMatRef::<u32>::new_checked(blocks, blocks, &starts, None, &graph.list);
    let scratch = amd::order_maybe_unsorted_scratch::<u32>(blocks, graph.list.len());
    let Ok(mut memory) = MemBuffer::try_new(scratch) else { return natural };
    let stack = MemStack::new(&mut memory);
    match amd::order_maybe_unsorted(&mut order, &mut position, pattern, Default::default(), stack) {
        Ok(_) => position,
        Err(_) => natural,
    }
}

/// The first row below the diagonal of every column of the factor (Liu 1990).
fn elimination_tree(graph: &Neighbours) -> Vec<u32> {
    let blocks = graph.blocks();
    let (mut parent, mut ancestor) = (vec![NONE; blocks], vec![NONE; blocks]);
    for row in 0..blocks {
        for &column in graph.of(row).iter().take_while(|&&c| (c as usize) < row) {
            let mut at = column as usize;
            while ancestor[at] != NONE && ancestor[at] as usize != row {
                let next = ancestor[at] as usize;
                ancestor[at] = row as u32;
                at = next;
            }
            if ancestor[at] == NONE {
                ancestor[at] = row as u32;
                parent[at] = row as u32;
            }
        }
    }
    parent
}

/// The position of every column when each comes after its subtree, and the tree in these positions.
fn postordered(parent: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let blocks = parent.len();
    let (mut child, mut sibling) = (vec![NONE; blocks], vec![NONE; blocks]);
    for at in (0..blocks).rev().filter(|&at| parent[at] != NONE) {
        sibling[at] = child[parent[at] as usize];
        child[parent[at] as usize] = at as u32;
    }
    let (mut position, mut next, mut path) = (vec![0; blocks], 0, Vec::new());
    for root in (0..blocks).filter(|&at| parent[at] == NONE) {
        path.push(root);
        while let Some(&at) = path.last() {
            if child[at] == NONE {
                position[at] = next;
                next += 1;
                path.pop();
            } else {
                path.push(child[at] as usize);
                child[at] = sibling[child[at] as usize];
            }
        }
    }
    let mut renamed = vec![NONE; blocks];
    for at in (0..blocks).filter(|&at| parent[at] != NONE) {
        renamed[position[at] as usize] = position[parent[at] as usize];
    }
    (position, renamed)
}

/// The factor's columns gathered in supernodes.
struct Columns {
    /// First column, number of columns, and rows below in `rows`.
    nodes: Vec<(usize, usize, Range<usize>)>,
    rows: Vec<u32>,
}

impl Columns {
    /// Fundamental supernodes: columns whose structure is that of the next one and no other child's.
    fn new(graph: &Neighbours, parent: &[u32], limit: usize) -> Result<Self, TooDense> {
        let blocks = graph.blocks();
        let mut nodes: Vec<(usize, usize, Range<usize>)> = Vec::new();
        let mut rows: Vec<u32> = Vec::with_capacity(4 * blocks);
        let mut seen = vec![NONE; blocks];
        // Supernodes whose first row is a column: a list for every column.
        let (mut child, mut sibling) = (vec![NONE; blocks], Vec::<u32>::new());
        let (mut of_column, mut total) = (Vec::new(), 0);
        for column in 0..blocks {
            of_column.clear();
            let mut add = |row: u32| {
                if row as usize > column && seen[row as usize] != column as u32 {
                    seen[row as usize] = column as u32;
                    of_column.push(row);
                }
            };
            graph
                .of(column)
                .iter()
                .rev()
                .take_while(|&&r| r as usize > column)
                .for_each(|&r| add(r));
            let only = child[column];
            let mut at = only;
            while at != NONE {
                rows[nodes[at as usize].2.clone()].iter().for_each(|&r| add(r));
                at = sibling[at as usize];
            }
            of_column.sort_unstable();
            total += of_column.len() + 1;
            if total > limit {
                return Err(TooDense { limit });
            }
            let extends = only != NONE
                && sibling[only as usize] == NONE
                && only as usize == nodes.len() - 1
                && nodes[only as usize].2.len() == of_column.len() + 1;
            let node = if extends {
                // Its rows are those of the child less this column.
                let (_, columns, range) = &mut nodes[only as usize];
                *columns += 1;
                range.start += 1;
                only
            } else {
                let start = rows.len();
                rows.extend(&of_column);
                nodes.push((column, 1, start..rows.len()));
                sibling.push(NONE);
                nodes.len() as u32 - 1
            };
            if parent[column] != NONE {
                let above = parent[column] as usize;
                sibling[node as usize] = child[above];
                child[above] = node;
            }
        }
        Ok(Self { nodes, rows })
    }

    /// Merges a supernode into its parent where the zeros that are then computed with cost less than
    /// keeping the two apart (Ashcraft and Grimes 1989).
    fn amalgamated(self) -> Self {
        /// First column, columns and rows of a node.
        type Node = (usize, usize, Range<usize>);
        // Merged nodes, and how many of their blocks are zero.
        let mut merged: Vec<(Node, usize)> = Vec::new();
        for (first, columns, rows) in self.nodes {
            let mut node = (first, columns, rows);
            let mut zeros = 0;
            while let Some(((first, columns, rows), before)) = merged.last() {
                let parent = self.rows.get(rows.start).filter(|_| !rows.is_empty());
                let is_child = parent
                    .is_some_and(|&p| (p as usize) >= node.0 && (p as usize) < node.0 + node.1);
                if !is_child {
                    break;
                }
                let (c, r) = (*columns, rows.len());
                let (pc, pr) = (node.1, node.2.len());
                let more = before + zeros + c * (pc + pr - r);
                let total = (c + pc) * (c + pc + 1) / 2 + (c + pc) * pr;
                let share = more as f64 / total as f64;
                let worth = match c + pc {
                    0..=2 => share < 0.5,
                    3..=6 => share < 0.35,
                    7..=16 => share < 0.15,
                    _ => share < 0.06,
                };
                if !worth {
                    break;
                }
                node = (*first, c + pc, node.2);
                zeros = more;
                merged.pop();
            }
            merged.push((node, zeros));
        }
        Self { nodes: merged.into_iter().map(|(node, _)| node).collect(), rows: self.rows }
    }

    fn structure(self, graph: &Neighbours, position: Vec<u32>) -> Structure {
        let blocks = graph.blocks();
        let mut node_of = vec![0u32; blocks];
        for (at, (first, columns, _)) in self.nodes.iter().enumerate() {
            node_of[*first..first + columns].fill(at as u32);
        }
        let mut rows = Vec::with_capacity(self.rows.len());
        let mut nodes: Vec<Supernode> = Vec::with_capacity(self.nodes.len());
        for (first, columns, range) in &self.nodes {
            let start = rows.len();
            rows.extend_from_slice(&self.rows[range.clone()]);
            let parent = rows.get(start).map(|&row| node_of[row as usize] as usize);
            let (first, columns, rows) = (*first, *columns, start..rows.len());
            nodes.push(Supernode { first, columns, rows, parent, children: 0..0 });
        }
        let mut children = Vec::with_capacity(nodes.len());
        {
            let mut counts = vec![0usize; nodes.len() + 1];
            for parent in nodes.iter().filter_map(|n| n.parent) {
                counts[parent + 1] += 1;
            }
            for i in 0..nodes.len() {
                counts[i + 1] += counts[i];
                nodes[i].children = counts[i]..counts[i + 1];
            }
            children.resize(counts[nodes.len()], 0);
            for at in 0..nodes.len() {
                if let Some(parent) = nodes[at].parent {
                    children[counts[parent]] = at as u32;
                    counts[parent] += 1;
                }
            }
        }
        // Where positions stand in the supernode at hand.
        let mut local = vec![0u32; blocks];
        let mut relative = vec![0u32; rows.len()];
        let mut below = Vec::with_capacity(graph.list.len() / 2);
        let mut locals = Vec::with_capacity(graph.list.len() / 2);
        let mut starts = Vec::with_capacity(blocks + 1);
        for node in &nodes {
            let columns = node.first..node.first + node.columns;
            let all = columns.clone().chain(rows[node.rows.clone()].iter().map(|&r| r as usize));
            for (at, row) in all.enumerate() {
                local[row] = at as u32;
            }
            for &child in &children[node.children.clone()] {
                for at in nodes[child as usize].rows.clone() {
                    relative[at] = local[rows[at] as usize];
                }
            }
            for column in columns {
                starts.push(below.len());
                for &row in graph.of(column).iter().filter(|&&row| row as usize > column) {
                    below.push(row);
                    locals.push(local[row as usize]);
                }
            }
        }
        starts.push(below.len());
        Structure {
            position,
            starts,
            below,
            nodes,
            rows,
            relative,
            children,
            local: locals,
            outside: Vec::new(),
        }
    }
}
