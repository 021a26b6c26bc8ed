//! Symmetric systems with the sparsity of a pose graph: one square block per pose and per edge.
//!
//! The rotations of the chordal relaxation (blocks N × N), its translations (1 × 1) and the
//! certificate ((N + 1) × (N + 1)) share one graph, hence one order of elimination: [`Pattern`].

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::supernodal::{
    SupernodalLltRef, SymbolicSupernodalCholesky, factorize_supernodal_numeric_llt,
    factorize_supernodal_numeric_llt_scratch,
};
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
use nalgebra::SMatrix;

/// The computer has too little memory for a factorisation of this size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not enough memory to factor a system of {unknowns} unknowns")]
pub struct TooLarge {
    /// Rows of the system.
    pub unknowns: usize,
}

/// Which poses are coupled, in an order of elimination that leaves the factor sparse.
#[derive(Clone, Debug)]
pub struct Pattern {
    /// Of every pose its row of blocks, in order of elimination; `None` of poses that are held.
    position: Vec<Option<usize>>,
    /// Where the blocks of each column begin in `rows`, and where the last one ends.
    starts: Vec<usize>,
    /// Rows of the blocks on and below the diagonal, ascending in each column.
    rows: Vec<usize>,
    /// Of every edge its block below the diagonal; `None` where it touches a held pose.
    slots: Vec<Option<Slot>>,
}

/// Where an edge's block is.
#[derive(Clone, Copy, Debug)]
struct Slot {
    column: usize,
    entry: usize,
    /// Whether the edge's first pose is the row.
    transposed: bool,
}

impl Pattern {
    /// Of so many poses, less those that are `held`, and `edges` between two different ones each.
    ///
    /// The order is AMD's (Amestoy, Davis & Duff 1996) on the graph of blocks.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn new(held: &[bool], edges: &[(usize, usize)]) -> Result<Pattern, TooLarge> {
        let mut number = vec![None; held.len()];
        let mut count = 0;
        for (number, _) in number.iter_mut().zip(held).filter(|(_, held)| !**held) {
            *number = Some(count);
            count += 1;
        }
        let free = |&(a, b): &(usize, usize)| number[a].zip(number[b]);
        let order = elimination(count, edges.iter().filter_map(free))
            .ok_or(TooLarge { unknowns: count })?;
        let position: Vec<Option<usize>> =
            number.into_iter().map(|number: Option<usize>| number.map(|n| order[n])).collect();

        let below = |&(a, b): &(usize, usize)| {
            let (a, b) = position[a].zip(position[b])?;
            Some((a.min(b), a.max(b)))
        };
        let mut columns: Vec<Vec<usize>> = (0..count).map(|c| vec![c]).collect();
        for (column, row) in edges.iter().filter_map(below) {
            columns[column].push(row);
        }
        let mut starts = Vec::with_capacity(count + 1);
        let mut rows = Vec::with_capacity(count + edges.len());
        starts.push(0);
        for mut column in columns {
            column.sort_unstable();
            column.dedup();
            rows.extend(column);
            starts.push(rows.len());
        }
        let slots = edges.iter().map(|edge| {
            let (column, row) = below(edge)?;
            let found = rows[starts[column]..starts[column + 1]].binary_search(&row).ok()?;
            let transposed = position[edge.0] == Some(row);
            Some(Slot { column, entry: starts[column] + found, transposed })
        });
        let slots = slots.collect();
        Ok(Pattern { position, starts, rows, slots })
    }

    /// The row of blocks of a pose; `None` where it is held.
    pub fn position(&self, pose: usize) -> Option<usize> {
        self.position[pose]
    }

    /// How many poses are not held.
    pub fn free(&self) -> usize {
        self.starts.len() - 1
    }
}

/// The position of each of so many nodes in AMD's order of elimination.
fn elimination(count: usize, edges: impl Iterator<Item = (usize, usize)>) -> Option<Vec<usize>> {
    let mut columns = vec![vec![]; count];
    for (a, b) in edges {
        columns[a.max(b)].push(a.min(b));
    }
    let mut starts = vec![0];
    let mut rows = vec![];
    for column in columns {
        rows.extend(column);
        starts.push(rows.len());
    }
    let upper = SymbolicSparseColMatRef::new_unsorted_checked(count, count, &starts, None, &rows);
    let (mut order, mut position) = (vec![0usize; count], vec![0usize; count]);
    let scratch = amd::order_maybe_unsorted_scratch::<usize>(count, rows.len());
    let mut memory = MemBuffer::try_new(scratch).ok()?;
    let stack = MemStack::new(&mut memory);
    amd::order_maybe_unsorted(&mut order, &mut position, upper, amd::Control::default(), stack)
        .ok()?;
    Some(position)
}

/// A symmetric matrix of `B` × `B` blocks in a [`Pattern`].
#[derive(Debug)]
pub struct Blocks<'p, const B: usize> {
    pattern: &'p Pattern,
    /// Compressed columns; of the blocks on the diagonal the whole, though only the lower half is read.
    columns: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
    symbolic: SymbolicCholesky<usize>,
}

impl<'p, const B: usize> Blocks<'p, B> {
    /// All zero.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn new(pattern: &'p Pattern) -> Result<Self, TooLarge> {
        let size = pattern.free() * B;
        let too_large = TooLarge { unknowns: size };
        let mut columns = Vec::with_capacity(size + 1);
        let mut rows = Vec::with_capacity(pattern.rows.len() * B * B);
        columns.push(0);
        for bounds in pattern.starts.windows(2) {
            for _ in 0..B {
                for &row in &pattern.rows[bounds[0]..bounds[1]] {
                    rows.extend(row * B..(row + 1) * B);
                }
                columns.push(rows.len());
            }
        }
        let matrix = SymbolicSparseColMatRef::new_checked(size, size, &columns, None, &rows);
        // The blocks are in order already. (faer's own `Identity` ignores which half is given.)
        let same: Vec<usize> = (0..size).collect();
        let order = SymmetricOrdering::Custom(PermRef::new_checked(&same, &same, size));
        let parameters = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let symbolic = factorize_symbolic_cholesky(matrix, Side::Lower, order, parameters)
            .map_err(|_| too_large)?;
        let values = vec![0.0; rows.len()];
        Ok(Blocks { pattern, columns, rows, values, symbolic })
    }

    /// Sets every block to zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    fn add(&mut self, column: usize, entry: usize, get: impl Fn(usize, usize) -> f64) {
        let (start, end) = (self.pattern.starts[column], self.pattern.starts[column + 1]);
        let height = B * (end - start);
        let first = B * B * start + B * (entry - start);
        for c in 0..B {
            let from = first + c * height;
            for (r, value) in self.values[from..from + B].iter_mut().enumerate() {
                *value += get(r, c);
            }
        }
    }

    /// Adds to the diagonal block of a pose; nothing where it is held.
    pub fn add_pose(&mut self, pose: usize, block: &SMatrix<f64, B, B>) {
        if let Some(at) = self.pattern.position[pose] {
            self.add(at, self.pattern.starts[at], |r, c| block[(r, c)]);
        }
    }

    /// Adds to the block in the row of an edge's second pose and the column of its first (and to its
    /// mirror image); nothing where one of them is held.
    pub fn add_edge(&mut self, edge: usize, block: &SMatrix<f64, B, B>) {
        match self.pattern.slots[edge] {
            Some(Slot { column, entry, transposed: true }) => {
                self.add(column, entry, |r, c| block[(c, r)]);
            }
            Some(Slot { column, entry, transposed: false }) => {
                self.add(column, entry, |r, c| block[(r, c)]);
            }
            None => (),
        }
    }

    /// The Cholesky factor; `None` where the matrix is not numerically positive definite.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn factor(&self) -> Result<Option<Factor<'_>>, TooLarge> {
        let size = self.columns.len() - 1;
        let too_large = TooLarge { unknowns: size };
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.symbolic.raw() else {
            return Err(too_large);
        };
        let parameters = Default::default();
        let scratch =
            factorize_supernodal_numeric_llt_scratch::<usize, f64>(symbolic, Par::Seq, parameters);
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| too_large)?;
        let mut lower = vec![0.0; symbolic.len_val()];
        let shape =
            SymbolicSparseColMatRef::new_checked(size, size, &self.columns, None, &self.rows);
        let factored = factorize_supernodal_numeric_llt(
            &mut lower,
            SparseColMatRef::new(shape, &self.values[..]),
            Default::default(),
            symbolic,
            Par::Seq,
            MemStack::new(&mut memory),
            parameters,
        );
        Ok(factored.is_ok().then_some(Factor { symbolic, lower }))
    }
}

/// A Cholesky factor.
#[derive(Debug)]
pub struct Factor<'b> {
    symbolic: &'b SymbolicSupernodalCholesky<usize>,
    lower: Vec<f64>,
}

impl Factor<'_> {
    /// Solves for `columns` right-hand sides, one after the other in `right`, in place.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn solve(&self, right: &mut [f64], columns: usize) -> Result<(), TooLarge> {
        let size = self.symbolic.nrows();
        let scratch = self.symbolic.solve_in_place_scratch::<f64>(columns, Par::Seq);
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| TooLarge { unknowns: size })?;
        let right = MatMut::from_column_major_slice_mut(right, size, columns);
        let factor = SupernodalLltRef::new(self.symbolic, &self.lower);
        factor.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut memory));
        Ok(())
    }
}
