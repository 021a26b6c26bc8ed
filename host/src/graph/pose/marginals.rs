//! Covariances of poses, given all measurements.

use nalgebra::{DMatrix, SMatrix, SVector};

use super::error::Error;
use super::kernel::Kernel;
use super::normal::Cost;
use super::optimizer::{Optimizer, Options};
use super::sparse::{BlockMatrix, Factor, SelectedInverse, Structure};
use super::{Group, PoseGraph};

/// The covariance H⁻¹ of all poses about their estimates, of which single blocks are asked for.
///
/// Covariances are of tangents (see [`Group`]): metres and radians in each pose's own axes, relative
/// to the poses that are held, whose own are zero. Ω is taken at its word: covariances are not scaled
/// by the χ² that is left.
///
/// ```
/// use nalgebra::Matrix3;
/// use tactile_host::graph::pose::{Edge, Optimizer, Options, PoseGraph2, Se2};
///
/// // Three steps of 1 m in a line, each known to 0.1 m and 0.01 rad.
/// let information = Matrix3::from_diagonal(&[1e2, 1e2, 1e4].into());
/// let edge = |from, to| Edge { from, to, measured: Se2::new(1.0, 0.0, 0.0), information };
/// let graph = PoseGraph2 {
///     ids: (0..4).collect(),
///     poses: (0..4).map(|i| Se2::new(i as f64, 0.0, 0.0)).collect(),
///     edges: (1..4).map(|i| edge(i - 1, i)).collect(),
///     fixed: vec![],
/// };
/// let marginals = Optimizer::new(&graph)?.marginals(&graph, None, &Options::default())?;
/// assert!((marginals.pose(3)[(0, 0)] - 0.03).abs() < 1e-12);
/// // Across, the turns of the first two steps act over 2 m and 1 m.
/// assert!((marginals.pose(3)[(1, 1)] - (0.03 + 5e-4)).abs() < 1e-12);
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Marginals<const D: usize> {
    structure: Structure,
    matrix: BlockMatrix<D>,
    factor: Factor<D>,
    selected: SelectedInverse<D>,
    positions: Vec<Option<usize>>,
}

impl<const D: usize> Optimizer<D> {
    /// Covariances about the poses of `graph`, which should be a minimum, with a weight for every edge
    /// (none: all 1) and the kernel of `options`, whose weights count too.
    ///
    /// # Errors
    /// See [`Error`]: above all a pose that the measurements do not determine.
    pub fn marginals<G: Group<D>>(
        &mut self,
        graph: &PoseGraph<G, D>,
        weights: Option<&[f64]>,
        options: &Options,
    ) -> Result<Marginals<D>, Error> {
        self.check(graph, weights, options)?;
        if !self.layout.structure.is_complete() {
            return Err(Error::TooDense);
        }
        let cost = Cost { kernel: options.kernel, weights };
        self.factorise_at(graph, cost)?;
        let structure = self.layout.structure.clone();
        let selected = SelectedInverse::new(&structure, &self.factor);
        let positions = (0..graph.poses.len()).map(|pose| self.layout.position(pose)).collect();
        let (matrix, factor) = (self.normal.matrix.clone(), self.factor.clone());
        Ok(Marginals { structure, matrix, factor, selected, positions })
    }
}

impl<const D: usize> Marginals<D> {
    /// Covariance of a pose's tangent.
    ///
    /// # Panics
    /// Where there is no such pose, as indexing does.
    pub fn pose(&self, pose: usize) -> SMatrix<f64, D, D> {
        self.pair(pose, pose)
    }

    /// Covariance between the tangents of two poses: rows are the first's. Those of poses that share
    /// an edge are at hand; others take a solution of D right-hand sides.
    ///
    /// # Panics
    /// Where there is no such pose, as indexing does.
    pub fn pair(&self, first: usize, second: usize) -> SMatrix<f64, D, D> {
        let (Some(row), Some(column)) = (self.positions[first], self.positions[second]) else {
            return SMatrix::zeros();
        };
        if let Some(block) = self.selected.block(&self.structure, row, column) {
            return block;
        }
        let mut block = SMatrix::<f64, D, D>::zeros();
        for inner in 0..D {
            let x = self.column(column, inner);
            block.set_column(inner, &SVector::<f64, D>::from_fn(|r, _| x[row * D + r]));
        }
        block
    }

    /// Covariance of the tangents of several poses together, in the order given.
    ///
    /// # Panics
    /// Where there is no such pose, as indexing does.
    pub fn joint(&self, poses: &[usize]) -> DMatrix<f64> {
        let mut joint = DMatrix::zeros(poses.len() * D, poses.len() * D);
        for (c, &pose) in poses.iter().enumerate() {
            let Some(column) = self.positions[pose] else { continue };
            for inner in 0..D {
                let x = self.column(column, inner);
                for (r, &other) in poses.iter().enumerate() {
                    let Some(row) = self.positions[other] else { continue };
                    for i in 0..D {
                        joint[(r * D + i, c * D + inner)] = x[row * D + i];
                    }
                }
            }
        }
        (&joint + joint.transpose()) * 0.5
    }

    /// Covariance of the motion from one pose to another: of the tangent of x⁻¹ y at y.
    ///
    /// # Panics
    /// Where there is no such pose, as indexing does.
    pub fn between<G: Group<D>>(&self, from: (usize, &G), to: (usize, &G)) -> SMatrix<f64, D, D> {
        // With the measurement that is exact, the error is that tangent but for the halves of
        // quaternions, which the derivative by `to` holds as well.
        let at = G::linearise(from.1, to.1, &from.1.between(to.1));
        let Some(back) = at.to.try_inverse() else { return SMatrix::zeros() };
        let a = back * at.from;
        let cross = a * self.pair(from.0, to.0);
        a * self.pose(from.0) * a.transpose() + cross + cross.transpose() + self.pose(to.0)
    }

    /// A column of H⁻¹, refined once.
    fn column(&self, position: usize, inner: usize) -> Vec<f64> {
        let mut unit = vec![0.0; self.structure.blocks() * D];
        unit[position * D + inner] = 1.0;
        let mut x = unit.clone();
        self.factor.solve(&self.structure, &mut x);
        let product = self.matrix.times(&self.structure, &x);
        let mut rest: Vec<f64> = unit.iter().zip(&product).map(|(a, b)| a - b).collect();
        self.factor.solve(&self.structure, &mut rest);
        x.iter_mut().zip(&rest).for_each(|(x, r)| *x += r);
        x
    }
}

/// The same with the default options and no weights.
///
/// # Errors
/// See [`Error`].
pub fn marginals<G: Group<D>, const D: usize>(
    graph: &PoseGraph<G, D>,
) -> Result<Marginals<D>, Error> {
    let options = Options { kernel: Kernel::Identity, ..Options::default() };
    Optimizer::new(graph)?.marginals(graph, None, &options)
}
