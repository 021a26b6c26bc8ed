//! Whether an optimum is the global one: a lower bound of χ² over all poses from Lagrangian duality.
//!
//! Rotations are quadratic constraints, Rᵀ R = I. Where a cost is quadratic in rotation matrices and
//! translations Y, q(Y) = tr(Yᵀ M Y) + c, multipliers Λ of the constraints give
//! q(Y) = tr(Yᵀ S Y) + tr Λ + c with S = M − Λ: where S ≥ 0 and S Y = 0 no other poses cost less
//! (Carlone, Rosen, Calafiore, Leonard & Dellaert 2015; Rosen, Carlone, Bandeira & Leonard 2019,
//! SE-Sync). Two things are different here.
//!
//! **χ² itself is certified**, with full information as it is minimised, not SE-Sync's cost with one
//! weight for rotation and one for translation. For that, χ² is replaced by a quadratic lower bound that is
//! equal to it, with equal gradient, at the poses in question: in space rotation errors are such
//! a form already; the plane's θ² is convex in cos θ and above its tangent there; translation
//! information is split into its least eigenvalue, which is quadratic for any rotation, and a convex
//! rest, which is above its tangent; information that couples translation and rotation, likewise.
//!
//! **One sparse Cholesky factorisation decides.** With Z any other poses less these,
//! zero at held poses, and G = S Y the gradient that rounding leaves,
//! q(Y + Z) − q(Y) = 2 tr(Zᵀ G) + tr(Zᵀ S′ Z) ≥ −tr(Gᵀ S′⁻¹ G), where S′, without the held poses, is
//! positive definite. So the bound is exact for poses that are not quite optimal, too.
//!
//! **Where S′ is not**, its least eigenvalue is found (see `curvature`): it is SE-Sync's measure of
//! how far the poses are from being certified. As the inequality holds for any symmetric multipliers, those
//! lowered until S′ is positive definite still bound χ² from below, if not tightly.
//!
//! A certificate can be missing for the global optimum: when noise is large the relaxation may not be
//! tight. It is never given to another one, up to rounding.

use nalgebra::{SMatrix, SVector, SymmetricEigen};

use super::blocks::{Blocks, Places, Singular};
use super::curvature::least;
use super::normal::{Layout, Limit};
use super::rigid::Rigid;
use super::{Edge, Error, PoseGraph};

/// What is known about the global minimum of χ².
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Certificate {
    /// No poses have a χ² below this one's less `gap`, which is at most [`TOLERANCE`] of it.
    Certified {
        /// The poses' own χ².
        chi2: f64,
        /// How far below it the global minimum can be at most.
        gap: f64,
    },
    /// The certificate matrix is positive definite, but these poses are too far from its
    /// minimum, or coupled information makes the bound too loose: the global minimum is between
    /// `chi2` − `gap` and `chi2`.
    Bounded {
        /// The poses' own χ².
        chi2: f64,
        /// How far below it the global minimum can be at most.
        gap: f64,
    },
    /// The certificate matrix has a direction of negative curvature: these poses are no global minimum
    /// or noise is too large to tell.
    NotCertified {
        /// The poses' own χ².
        chi2: f64,
        /// How far below it the global minimum can be at most.
        gap: f64,
        /// Least eigenvalue of the certificate matrix, as a share of its diagonal: below 0.
        eigenvalue: f64,
        /// Id of the pose at which the curvature shows.
        pose: u64,
    },
    /// An edge has an error at which χ² has no quadratic bound: near half a turn, where nobody can say which
    /// way round is meant.
    Unbounded {
        /// The poses' own χ².
        chi2: f64,
        /// The edge's index.
        edge: usize,
    },
    /// The graph is too densely connected for a factorisation, without which nothing can be said.
    Undecided {
        /// The poses' own χ².
        chi2: f64,
    },
}

/// Part of χ² that a certified global minimum can be below.
pub const TOLERANCE: f64 = 1e-6;

/// χ² below this is rounding, in what an edge costs on average that is one radian off about an axis.
const ROUNDING: f64 = 1e-9;

impl Certificate {
    /// Whether the poses are a global minimum, to [`TOLERANCE`].
    pub fn is_certified(&self) -> bool {
        matches!(self, Certificate::Certified { .. })
    }

    /// What χ² cannot be below, whatever the poses; zero where nothing better is known.
    pub fn lower_bound(&self) -> f64 {
        match *self {
            Certificate::Certified { chi2, gap }
            | Certificate::Bounded { chi2, gap }
            | Certificate::NotCertified { chi2, gap, .. } => (chi2 - gap).max(0.0),
            Certificate::Unbounded { .. } | Certificate::Undecided { .. } => 0.0,
        }
    }

    /// The least eigenvalue of the certificate matrix, a share of its diagonal, where it is known: where
    /// it is below 0.
    pub fn eigenvalue(&self) -> Option<f64> {
        match *self {
            Certificate::NotCertified { eigenvalue, .. } => Some(eigenvalue),
            _ => None,
        }
    }
}

/// Whether the poses of `graph`, a minimum of χ² that some optimiser found, are the global one.
///
/// Edges that a robust method rejects must be left out before, weights be part of the information. Costs about
/// as much as one iteration of Gauss–Newton where the answer is yes, some more where it is no.
///
/// ```
/// use tactile_host::graph::pose::certificate::certify;
/// use tactile_host::graph::pose::{Edge, Group, Options, PoseGraph2, Se2, optimize};
///
/// // A ring of eight poses that turns by 45° each.
/// let step = Se2::new(1.0, 0.0, std::f64::consts::FRAC_PI_4);
/// let edges = (0..8).map(|k| Edge {
///     from: k,
///     to: (k + 1) % 8,
///     measured: step,
///     information: nalgebra::Matrix3::identity(),
/// });
/// let poses = vec![Se2::new(0.0, 0.0, 0.0); 8];
/// let mut ring = PoseGraph2 { ids: (0..8).collect(), poses, edges: edges.collect(), fixed: vec![] };
///
/// // Unrolled in the wrong direction, it is stuck in a ring that winds twice ...
/// for k in 1..8 {
///     ring.poses[k] = ring.poses[k - 1].compose(&Se2::new(1.0, 0.0, std::f64::consts::FRAC_PI_2));
/// }
/// optimize(&mut ring, &Options::default())?;
/// assert!(!certify(&ring)?.is_certified());
///
/// // ... and not when it is unrolled as measured.
/// for k in 1..8 {
///     ring.poses[k] = ring.poses[k - 1].compose(&step);
/// }
/// assert!(certify(&ring)?.is_certified());
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
///
/// # Errors
/// See [`Error`]: numbers out of range.
pub fn certify<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
) -> Result<Certificate, Error> {
    graph.check()?;
    G::certify(graph, &Layout::new(graph, &graph.held(), Limit::default())?)
}

/// A quadratic lower bound of one edge's χ² in the blocks Y of its poses: a translation above the
/// transpose of a rotation. tr(Yᵢᵀ A Yᵢ) + tr(Yⱼᵀ B Yⱼ) + 2 tr(Yⱼᵀ C Yᵢ) + constant.
struct Bound<const H: usize> {
    from: SMatrix<f64, H, H>,
    to: SMatrix<f64, H, H>,
    coupling: SMatrix<f64, H, H>,
    constant: f64,
}

impl<const H: usize> Bound<H> {
    /// Of an edge with error `error`; `None` where there is none.
    fn new<G: Rigid<D, N>, const D: usize, const N: usize>(
        edge: &Edge<G, D>,
        error: &SVector<f64, D>,
    ) -> Option<Self> {
        let Split { least, share, rest } = Split::<D>::of::<N>(&edge.information);
        let turned = edge.measured.rotation_matrix();
        let step = edge.measured.translation_vector();

        // The rest's tangent: 2 gᵀe − gᵀe₀ with g = rest · e₀.
        let pull: SVector<f64, D> = rest * error;
        let force = turned * SVector::<f64, N>::from_fn(|r, _| pull[r]);
        let mut bound = Bound {
            from: SMatrix::zeros(),
            to: SMatrix::zeros(),
            coupling: SMatrix::zeros(),
            constant: -pull.dot(error) - 2.0 * force.dot(&step),
        };

        // least · ‖tⱼ − tᵢ − Rᵢ tz‖² and 2 ⟨Rᵢ force, tⱼ − tᵢ⟩.
        let seen = SVector::<f64, H>::from_fn(|r, _| if r == 0 { 1.0 } else { step[r - 1] });
        bound.from += seen * seen.transpose() * least;
        bound.to[(0, 0)] += least;
        for r in 0..H {
            let pull = if r == 0 { 0.0 } else { force[r - 1] };
            bound.coupling[(0, r)] += pull - seen[r] * least;
            bound.from[(0, r)] -= pull;
            bound.from[(r, 0)] -= pull;
        }

        let information = edge.information * share;
        let rotation = G::linear_rotation_cost(&information, &pull, error)?;
        let slope = turned * rotation.slope;
        for r in 0..N {
            for c in 0..N {
                bound.coupling[(1 + r, 1 + c)] -= 0.5 * slope[(c, r)];
            }
        }
        bound.constant += rotation.constant;
        Some(bound)
    }
}

/// Ω split into a part without coupling, least · I for translations and share · Ω for rotations, and
/// a positive semidefinite rest.
struct Split<const D: usize> {
    least: f64,
    share: f64,
    rest: SMatrix<f64, D, D>,
}

impl<const D: usize> Split<D> {
    fn of<const N: usize>(information: &SMatrix<f64, D, D>) -> Self {
        let translation = SMatrix::<f64, N, N>::from_fn(|r, c| information[(r, c)]);
        let least = least_eigenvalue(translation).max(0.0);
        let coupled = (0..N).any(|r| (N..D).any(|c| information[(r, c)] != 0.0));
        let plain = |share: f64| {
            SMatrix::<f64, D, D>::from_fn(|r, c| match (r < N, c < N) {
                (true, true) if r == c => least * share,
                (false, false) => information[(r, c)] * share,
                _ => 0.0,
            })
        };
        let share = if coupled { largest_share(information, &plain(1.0)) } else { 1.0 };
        Split { least: least * share, share, rest: information - plain(share) }
    }
}

/// The largest s ≤ 1 with `whole` − s · `part` ≥ 0.
fn largest_share<const D: usize>(whole: &SMatrix<f64, D, D>, part: &SMatrix<f64, D, D>) -> f64 {
    let Some(factor) = part.cholesky() else {
        return 0.0;
    };
    // s is the least eigenvalue of L⁻¹ whole L⁻ᵀ.
    let lower = factor.l();
    let scaled = lower
        .solve_lower_triangular(whole)
        .and_then(|half| lower.solve_lower_triangular(&half.transpose()));
    scaled.map_or(0.0, |scaled| least_eigenvalue(scaled).clamp(0.0, 1.0))
}

fn least_eigenvalue<const K: usize>(matrix: SMatrix<f64, K, K>) -> f64 {
    let rows: Vec<f64> = matrix.iter().copied().collect();
    let matrix = nalgebra::DMatrix::from_vec(K, K, rows);
    SymmetricEigen::new(matrix).eigenvalues.min()
}

/// [`certify`] with blocks of H = N + 1 numbers, of a graph that is checked, in a layout that is known.
pub(super) fn in_blocks<G: Rigid<D, N>, const D: usize, const N: usize, const H: usize>(
    graph: &PoseGraph<G, D>,
    layout: &Layout,
) -> Result<Certificate, Error> {
    if !layout.structure.is_complete() {
        return Ok(Certificate::Undecided { chi2: graph.chi2() });
    }
    let places = Places::new(graph, layout);
    Ok(match Dual::<H, N>::new(graph, &places) {
        Ok(dual) => dual.certificate(&graph.ids),
        Err(edge) => Certificate::Unbounded { chi2: graph.chi2(), edge },
    })
}

/// The certificate matrix S′ at some poses.
struct Dual<'p, const H: usize, const N: usize> {
    places: &'p Places<'p>,
    matrix: Blocks<'p, H>,
    /// Y, by pose.
    lifted: Vec<SMatrix<f64, H, N>>,
    /// S Y of the free poses: columns one after the other, each by position.
    gradient: Vec<f64>,
    chi2: f64,
    /// What χ² is above its bound at these poses.
    slack: f64,
    /// χ² that is rounding.
    rounding: f64,
}

impl<'p, const H: usize, const N: usize> Dual<'p, H, N> {
    /// Of the poses of `graph`.
    ///
    /// # Errors
    /// An edge without a bound.
    fn new<G: Rigid<D, N>, const D: usize>(
        graph: &PoseGraph<G, D>,
        places: &'p Places<'p>,
    ) -> Result<Self, usize> {
        let lifted: Vec<SMatrix<f64, H, N>> = graph.poses.iter().map(lift).collect();
        let mut matrix = Blocks::<H>::new(places);
        // M Y.
        let mut forces = vec![SMatrix::<f64, H, N>::zeros(); graph.poses.len()];
        let (mut chi2, mut slack, mut turning) = (0.0, 0.0, 0.0);
        for (index, edge) in graph.edges.iter().enumerate() {
            let (from, to) = (edge.from, edge.to);
            let error = G::error(&graph.poses[from], &graph.poses[to], &edge.measured);
            let bound = Bound::<H>::new(edge, &error).ok_or(index)?;
            let by_from = bound.from * lifted[from] + bound.coupling.tr_mul(&lifted[to]);
            let by_to = bound.to * lifted[to] + bound.coupling * lifted[from];
            let value = lifted[from].dot(&by_from) + lifted[to].dot(&by_to) + bound.constant;
            let own = error.dot(&(edge.information * error));
            chi2 += own;
            turning += (N..D).map(|axis| edge.information[(axis, axis)]).sum::<f64>();
            slack += (own - value).max(0.0);
            forces[from] += by_from;
            forces[to] += by_to;
            matrix.add_pose(from, &bound.from);
            matrix.add_pose(to, &bound.to);
            matrix.add_edge(index, &bound.coupling);
        }
        // Multipliers make the forces on rotations zero, as far as symmetric ones can.
        let rows = places.free() * H;
        let mut gradient = vec![0.0; rows * N];
        for (pose, force) in forces.iter().enumerate() {
            let Some(at) = places.position(pose) else { continue };
            let rotation = SMatrix::<f64, N, N>::from_fn(|r, c| lifted[pose][(1 + r, c)]);
            let turning = SMatrix::<f64, N, N>::from_fn(|r, c| force[(1 + r, c)]);
            let multiplier = turning * rotation.transpose();
            let multiplier = (multiplier + multiplier.transpose()) * 0.5;
            let kept = multiplier * rotation;
            let mut block = SMatrix::<f64, H, H>::zeros();
            for r in 0..N {
                for c in 0..N {
                    block[(1 + r, 1 + c)] = -multiplier[(r, c)];
                }
            }
            matrix.add_pose(pose, &block);
            for c in 0..N {
                for r in 0..H {
                    let kept = if r == 0 { 0.0 } else { kept[(r - 1, c)] };
                    gradient[c * rows + at * H + r] = force[(r, c)] - kept;
                }
            }
        }
        let axes = graph.edges.len().max(1) * (D - N);
        let rounding = ROUNDING * turning / axes as f64;
        Ok(Dual { places, matrix, lifted, gradient, chi2, slack, rounding })
    }

    fn certificate(&self, ids: &[u64]) -> Certificate {
        let chi2 = self.chi2;
        let mut solved = self.gradient.clone();
        match self.matrix.clone().solve(&mut solved) {
            Ok(()) => {
                let gap = self.slack + dot(&self.gradient, &solved);
                if gap.is_finite() && gap <= TOLERANCE * chi2 + self.rounding {
                    Certificate::Certified { chi2, gap }
                } else {
                    Certificate::Bounded { chi2, gap }
                }
            }
            Err(Singular { pose, .. }) => {
                let (eigenvalue, gap) = self.lowered();
                Certificate::NotCertified { chi2, gap: gap.min(chi2), eigenvalue, pose: ids[pose] }
            }
        }
    }

    /// Where S′ is not positive definite: its least eigenvalue as a share of the diagonal of its
    /// rotations, and how far χ² can fall with multipliers lowered by as much.
    fn lowered(&self) -> (f64, f64) {
        let size = self.rotation_sizes();
        let Some(eigenvalue) = least(&self.matrix, &size) else {
            return (f64::NEG_INFINITY, f64::INFINITY);
        };
        // A little more than the eigenvalue, which is found from above.
        let mut share = -1.05 * eigenvalue;
        for _ in 0..8 {
            let mut gradient = self.gradient.clone();
            let rows = size.len();
            for (pose, own) in self.lifted.iter().enumerate() {
                let Some(at) = self.places.position(pose) else { continue };
                for (c, r) in (0..N).flat_map(|c| (1..H).map(move |r| (c, r))) {
                    let row = at * H + r;
                    gradient[c * rows + row] += share * size[row] * own[(r, c)];
                }
            }
            let mut solved = gradient.clone();
            if self.matrix.raised(share, &size).solve(&mut solved).is_ok() {
                return (eigenvalue, self.slack + dot(&gradient, &solved));
            }
            share *= 1.5;
        }
        (eigenvalue, f64::INFINITY)
    }

    /// The mean diagonal of every pose's rotation in each of its rows, none in that of its
    /// translation, by position.
    fn rotation_sizes(&self) -> Vec<f64> {
        let mut sizes = vec![0.0; self.places.free() * H];
        for (at, own) in sizes.chunks_exact_mut(H).enumerate() {
            let block = self.matrix.diagonal(at);
            let mean = (1..H).map(|r| block[(r, r)].abs()).sum::<f64>() / N as f64;
            own[1..].fill(mean);
        }
        sizes
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A pose's translation above the transpose of its rotation.
fn lift<G: Rigid<D, N>, const D: usize, const N: usize, const H: usize>(
    pose: &G,
) -> SMatrix<f64, H, N> {
    let (rotation, translation) = (pose.rotation_matrix(), pose.translation_vector());
    SMatrix::from_fn(|r, c| if r == 0 { translation[c] } else { rotation[(c, r - 1)] })
}

#[cfg(test)]
mod tests;
