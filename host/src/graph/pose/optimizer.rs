//! Least squares over a pose graph: Gauss–Newton, Levenberg–Marquardt and dogleg.

use super::descent::{Descent, descend, unconstrained};
use super::error::Error;
use super::kernel::Kernel;
use super::normal::{Cost, Layout, Limit, Normal};
use super::sparse::Factor;
use super::{Group, PoseGraph};

/// How to step from one estimate to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Method {
    /// The minimum of the linearised cost; half of the way, a quarter and so on where that costs more.
    /// The fastest from a good start.
    #[default]
    GaussNewton,
    /// Gauss–Newton with the diagonal enlarged as long as steps disappoint (Marquardt 1963, damping
    /// after Nielsen 1999). For bad starts, and for graphs that leave something undetermined which involves
    /// several numbers of poses: a single one that nothing measures, with a zero on the diagonal, stays so.
    LevenbergMarquardt,
    /// Between Gauss–Newton and steepest descent, within a radius of trust (Powell 1970).
    Dogleg,
}

/// How an optimisation is carried out and when it ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How to step.
    pub method: Method,
    /// What edges cost.
    pub kernel: Kernel,
    /// Steps tried at most in one descent, accepted or not.
    pub max_iterations: usize,
    /// Converged when the linearised cost promises to fall by no more than this share of the cost,
    /// gᵀ H⁻¹ g ≤ tolerance · cost, and that last step is taken too: what is left then is smaller by
    /// some orders of magnitude again. A promise that rounding could make counts as none.
    pub tolerance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::default(),
            kernel: Kernel::default(),
            max_iterations: 100,
            tolerance: 1e-8,
        }
    }
}

/// Why an optimisation ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The promise of a further step is below the tolerance.
    Converged,
    /// No step that could be computed lowers the cost, although the promise is above the tolerance.
    Stalled,
    /// All iterations are used.
    Iterations,
}

/// One step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Steps tried before this one.
    pub number: usize,
    /// Cost after it, at the poses kept.
    pub cost: f64,
    /// By how much the linearised cost promised to fall.
    pub promised: f64,
    /// By how much the cost fell; not positive for a step that was refused.
    pub fell: f64,
    /// λ of Levenberg–Marquardt, radius of dogleg, share of the whole step of Gauss–Newton.
    pub control: f64,
}

/// What an optimisation did.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Σ eᵀ Ω e before, whatever the kernel and weights.
    pub initial_chi2: f64,
    /// Σ eᵀ Ω e after.
    pub final_chi2: f64,
    /// Σ w ρ(eᵀ Ω e) before; never less than after.
    pub initial_cost: f64,
    /// Σ w ρ(eᵀ Ω e) after.
    pub final_cost: f64,
    /// Every step tried.
    pub steps: Vec<Iteration>,
    /// Factorisations of the normal equations.
    pub factorisations: usize,
    /// Why it ended.
    pub stop: Stop,
}

impl Summary {
    /// Whether the end is a minimum to the tolerance asked for.
    pub fn converged(&self) -> bool {
        self.stop == Stop::Converged
    }

    /// This and a descent that went on where it ended.
    pub(super) fn followed_by(mut self, next: Summary) -> Summary {
        let before = self.steps.len();
        let renumbered = |step: Iteration| Iteration { number: before + step.number, ..step };
        self.steps.extend(next.steps.into_iter().map(renumbered));
        self.factorisations += next.factorisations;
        (self.final_chi2, self.final_cost, self.stop) =
            (next.final_chi2, next.final_cost, next.stop);
        self
    }

    /// Number of steps tried.
    pub fn iterations(&self) -> usize {
        self.steps.len()
    }
}

/// Moves the poses of `graph` to a minimum of Σ ρ(eᵀ Ω e) near where they are.
///
/// The poses listed in [`PoseGraph::fixed`] stay; where a connected part has none, its first pose
/// stays. Whatever happens, the cost is never higher afterwards than before, and on error the poses
/// are as they were.
///
/// ```
/// use tactile_host::graph::pose::{Edge, Options, PoseGraph2, Se2, optimize};
///
/// // Three steps around a triangle of side 1, each turning by 120°; the start is off.
/// let turn = 2.0 * std::f64::consts::PI / 3.0;
/// let step = Se2::new(1.0, 0.0, turn);
/// let edge = |from, to| Edge { from, to, measured: step, information: nalgebra::Matrix3::identity() };
/// let mut graph = PoseGraph2 {
///     ids: vec![0, 1, 2],
///     poses: vec![Se2::new(0.0, 0.0, 0.0), Se2::new(1.2, 0.1, 2.0), Se2::new(0.3, 0.8, -2.0)],
///     edges: vec![edge(0, 1), edge(1, 2), edge(2, 0)],
///     fixed: vec![],
/// };
/// let summary = optimize(&mut graph, &Options::default())?;
/// assert!(summary.converged() && summary.final_chi2 < 1e-20);
/// assert!((graph.poses[2].angle - (2.0 * turn - std::f64::consts::TAU)).abs() < 1e-9);
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
///
/// # Errors
/// See [`Error`]: numbers out of range, or measurements that leave a pose undetermined.
pub fn optimize<G: Group<D>, const D: usize>(
    graph: &mut PoseGraph<G, D>,
    options: &Options,
) -> Result<Summary, Error> {
    Optimizer::new(graph)?.optimize(graph, options)
}

/// The structure of a graph's normal equations and the memory to solve them, to be used many times:
/// with other poses, measurements, weights or options, as long as the same pairs of poses are
/// connected in the same order and the same poses are fixed.
#[derive(Clone, Debug)]
pub struct Optimizer<const D: usize> {
    pub(super) layout: Layout,
    pub(super) normal: Normal<D>,
    pub(super) factor: Factor<D>,
    held: Vec<bool>,
    edges: Vec<(u32, u32)>,
}

impl<const D: usize> Optimizer<D> {
    /// For graphs connected like `graph`.
    ///
    /// # Errors
    /// Edges that make no sense.
    pub fn new<G: Group<D>>(graph: &PoseGraph<G, D>) -> Result<Self, Error> {
        Self::with_limit(graph, Limit::default())
    }

    /// Like [`new`](Self::new). A graph whose factor would be beyond `limit` is solved by conjugate gradients,
    /// preconditioned by a tree.
    ///
    /// # Errors
    /// Edges that make no sense.
    pub fn with_limit<G: Group<D>>(graph: &PoseGraph<G, D>, limit: Limit) -> Result<Self, Error> {
        graph.check_indices()?;
        let held = graph.held();
        let layout = Layout::new(graph, &held, limit)?;
        let normal = Normal::new(&layout);
        let factor = Factor::new(&layout.structure);
        let edges = graph.edges.iter().map(|e| (e.from as u32, e.to as u32)).collect();
        Ok(Self { layout, normal, factor, held, edges })
    }

    /// Moves the poses of `graph` to a minimum; see [`optimize()`].
    ///
    /// # Errors
    /// See [`Error`].
    pub fn optimize<G: Group<D>>(
        &mut self,
        graph: &mut PoseGraph<G, D>,
        options: &Options,
    ) -> Result<Summary, Error> {
        self.optimize_weighted(graph, None, options, &mut |_| {})
    }

    /// The minimum of Σ w ρ(eᵀ Ω e) with a weight w ≥ 0 for every edge (none: all 1), telling `watch`
    /// of every step.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn optimize_weighted<G: Group<D>>(
        &mut self,
        graph: &mut PoseGraph<G, D>,
        weights: Option<&[f64]>,
        options: &Options,
        watch: &mut dyn FnMut(&Iteration),
    ) -> Result<Summary, Error> {
        self.check(graph, weights, options)?;
        let cost = Cost { kernel: options.kernel, weights };
        let mut poses = graph.poses.clone();
        let Descent { initial_cost, final_cost, steps, factorisations, stop } =
            descend(self, graph, &mut poses, cost, options, watch)?;
        let plain = options.kernel == Kernel::Identity && weights.is_none();
        let initial_chi2 = if plain { initial_cost } else { graph.chi2() };
        graph.poses = poses;
        let final_chi2 = if plain { final_cost } else { graph.chi2() };
        Ok(Summary {
            initial_chi2,
            final_chi2,
            initial_cost,
            final_cost,
            steps,
            factorisations,
            stop,
        })
    }

    /// The factor of the matrix at the graph's poses.
    pub(super) fn factorise_at<G: Group<D>>(
        &mut self,
        graph: &PoseGraph<G, D>,
        cost: Cost,
    ) -> Result<(), Error> {
        let measured: Vec<_> = graph.edges.iter().map(|e| e.measured.frame()).collect();
        let frames: Vec<_> = graph.poses.iter().map(G::frame).collect();
        self.normal.linearise(&self.layout, graph, &measured, &frames, cost, false);
        let Self { layout, normal, factor, .. } = self;
        factor
            .factorise(&layout.structure, &normal.matrix, 0.0)
            .map_err(|at| unconstrained(layout, graph, at))
    }

    pub(super) fn check<G: Group<D>>(
        &self,
        graph: &PoseGraph<G, D>,
        weights: Option<&[f64]>,
        options: &Options,
    ) -> Result<(), Error> {
        let same = |e: (&(u32, u32), &super::Edge<G, D>)| {
            (e.0.0 as usize, e.0.1 as usize) == (e.1.from, e.1.to)
        };
        if graph.poses.len() != self.held.len() || graph.ids.len() != graph.poses.len() {
            return Err(Error::Changed { what: "poses" });
        }
        if graph.edges.len() != self.edges.len() || !self.edges.iter().zip(&graph.edges).all(same) {
            return Err(Error::Changed { what: "edges" });
        }
        if graph.held() != self.held {
            return Err(Error::Changed { what: "fixed poses" });
        }
        graph.check_values()?;
        if let Some(weights) = weights {
            let (given, edges) = (weights.len(), graph.edges.len());
            if given != edges {
                return Err(Error::Weights { weights: given, edges });
            }
            let bad = weights.iter().position(|w| !(w.is_finite() && *w >= 0.0));
            if let Some(edge) = bad {
                return Err(Error::Weight { edge, weight: weights[edge] });
            }
        }
        let width = options.kernel.width();
        if !(width > 0.0) || (options.kernel != Kernel::Identity && !width.is_finite()) {
            let expected = "a finite number above 0";
            return Err(Error::Option { option: "the kernel's width", value: width, expected });
        }
        if !(options.tolerance >= 0.0) {
            let (option, value) = ("the tolerance", options.tolerance);
            return Err(Error::Option { option, value, expected: "0 or more" });
        }
        Ok(())
    }
}
