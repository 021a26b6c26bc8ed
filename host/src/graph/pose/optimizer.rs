//! Least squares over a pose graph: Gauss–Newton, Levenberg–Marquardt and dogleg.

use nalgebra::SVector;

use super::error::Error;
use super::kernel::Kernel;
use super::normal::{Cost, Layout, Limit, Normal};
use super::sparse::{Factor, NotPositive, Reached, conjugate_gradients};
use super::{Group, PoseGraph};

/// How to step from one estimate to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Method {
    /// The minimum of the linearised cost; half of the way, a quarter and so on where that costs more.
    /// The fastest from a good start.
    #[default]
    GaussNewton,
    /// Gauss–Newton with the diagonal enlarged as long as steps disappoint (Marquardt 1963, damping
    /// after Nielsen 1999). For bad starts and for graphs that leave something undetermined.
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
    /// Steps tried at most, accepted or not.
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
        (self.final_chi2, self.final_cost, self.stop) = (next.final_chi2, next.final_cost, next.stop);
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
        let mut search = Search {
            graph: &*graph,
            cost,
            options,
            watch,
            solver: self,
            measured: graph.edges.iter().map(|e| e.measured.frame()).collect(),
            frames: Vec::with_capacity(poses.len()),
            trial: poses.clone(),
            steps: Vec::new(),
            factorisations: 0,
            damping: 0.0,
            accurate: true,
        };
        let (initial_cost, final_cost, stop) = match options.method {
            Method::GaussNewton => search.gauss_newton(&mut poses)?,
            Method::LevenbergMarquardt => search.levenberg_marquardt(&mut poses)?,
            Method::Dogleg => search.dogleg(&mut poses)?,
        };
        let (steps, factorisations) = (search.steps, search.factorisations);
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
        if !graph.fixed.iter().all(|&pose| self.held.get(pose) == Some(&true)) {
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

/// One optimisation under way.
struct Search<'a, G: Group<D>, const D: usize> {
    graph: &'a PoseGraph<G, D>,
    cost: Cost<'a>,
    options: &'a Options,
    watch: &'a mut dyn FnMut(&Iteration),
    solver: &'a mut Optimizer<D>,
    measured: Vec<G::Frame>,
    frames: Vec<G::Frame>,
    trial: Vec<G>,
    steps: Vec<Iteration>,
    factorisations: usize,
    /// Of the factor.
    damping: f64,
    /// Whether the last solution is one.
    accurate: bool,
}

/// Initial cost, final cost and why it ended.
type Outcome = Result<(f64, f64, Stop), Error>;

/// A step that makes the cost rise by no more than rounding does not count as rising.
const ROUNDING: f64 = 1e-13;

/// Residual, as a share of the gradient, to which steps are computed where they cannot be exact (inexact
/// Newton method: Dembo, Eisenstat and Steihaug 1982).
const INEXACT: f64 = 1e-3;

/// A factor is kept for the next step where this one promises to lower the cost by no more than this
/// share,
const SETTLED: f64 = 0.03;

/// what it lowers differs from its promise by no more than this share of it,
const KEPT: f64 = 0.1;

/// and the next step promises no more than this share of what this one did.
const CONTRACTION: f64 = 0.1;

impl<G: Group<D>, const D: usize> Search<'_, G, D> {
    /// H, g and the cost at `poses`.
    fn linearise(&mut self, poses: &[G], gradient_only: bool) -> f64 {
        self.frames.clear();
        self.frames.extend(poses.iter().map(G::frame));
        let Optimizer { layout, normal, .. } = &mut *self.solver;
        let (measured, frames) = (&self.measured, &self.frames);
        normal.linearise(layout, self.graph, measured, frames, self.cost, gradient_only)
    }

    fn factorise(&mut self, damping: f64) -> Result<(), NotPositive> {
        self.factorisations += 1;
        self.damping = damping;
        let Optimizer { layout, normal, factor, .. } = &mut *self.solver;
        factor.factorise(&layout.structure, &normal.matrix, damping)
    }

    /// H⁻¹ g, with gᵀ H⁻¹ g.
    fn solve(&mut self) -> (Vec<f64>, f64) {
        let Optimizer { layout, normal, factor, .. } = &*self.solver;
        let mut step = normal.gradient.clone();
        let (structure, matrix) = (&layout.structure, &normal.matrix);
        let Reached { accurate, .. } =
            conjugate_gradients(structure, factor, matrix, self.damping, &mut step, INEXACT);
        let promised = dot(&step, &normal.gradient);
        self.accurate = accurate;
        (step, promised)
    }

    /// Why it ends when a step promises next to nothing: an inexact one says little.
    fn settled(&self) -> Stop {
        if self.accurate { Stop::Converged } else { Stop::Stalled }
    }

    /// `trial` becomes `poses` ⊕ −share·step.
    fn displace(&mut self, poses: &[G], step: &[f64], share: f64) {
        for (position, &pose) in self.solver.layout.pose.iter().enumerate() {
            let own = SVector::<f64, D>::from_column_slice(&step[position * D..(position + 1) * D]);
            self.trial[pose as usize] = poses[pose as usize].retract(&(own * -share));
        }
    }

    /// Whether a step is not worth taking for what it promises: little of the cost, or no more than
    /// rounding the poses to double precision costs.
    fn negligible(&self, promised: f64, cost: f64, poses: &[G]) -> bool {
        if promised <= self.options.tolerance * cost {
            return true;
        }
        // Rounding costs less than this in any graph that is solved at all.
        if promised > 1e-6 {
            return false;
        }
        let size = |pose: &G| G::identity().local(pose).norm();
        let rounding = poses.iter().map(size).fold(1.0, f64::max) * 8.0 * f64::EPSILON;
        let information = self.graph.edges.iter().map(|e| e.information.trace()).sum::<f64>();
        promised <= information * rounding * rounding
    }

    fn unconstrained(&self, at: NotPositive) -> Error {
        unconstrained(&self.solver.layout, self.graph, at)
    }

    /// The cost at the start, which must be finite.
    fn start(&mut self, poses: &[G]) -> Result<f64, Error> {
        let cost = self.linearise(poses, false);
        if cost.is_finite() && self.solver.normal.gradient.iter().all(|g| g.is_finite()) {
            return Ok(cost);
        }
        let edges = self.graph.edges.iter();
        let bad = edges.enumerate().find(|(_, e)| !e.chi2(poses).is_finite());
        Err(Error::Overflow { edge: bad.map_or(0, |(edge, _)| edge) })
    }

    fn report(&mut self, cost: f64, promised: f64, fell: f64, control: f64) {
        let step = Iteration { number: self.steps.len(), cost, promised, fell, control };
        (self.watch)(&step);
        self.steps.push(step);
    }

    /// The factor of a matrix serves as long as its steps do what they promise: from there on the
    /// matrix hardly changes, and a step with the old factor costs a fraction of a new one.
    fn gauss_newton(&mut self, poses: &mut Vec<G>) -> Outcome {
        let initial = self.start(poses)?;
        let mut cost = initial;
        // Whether the matrix is that of `poses`; and where the factor is that of an earlier one, what
        // a step must promise not to exceed.
        let mut current = true;
        let mut reuse: Option<f64> = None;
        while self.steps.len() < self.options.max_iterations {
            if reuse.is_none() {
                if !std::mem::replace(&mut current, true) {
                    self.linearise(poses, false);
                }
                self.factorise(0.0).map_err(|at| self.unconstrained(at))?;
            }
            let (step, promised) = self.solve();
            if reuse.is_some_and(|most| promised > most) {
                reuse = None;
                continue;
            }
            if self.negligible(promised, cost, poses) {
                // Nearly there: the last step is taken if it keeps its promise.
                self.displace(poses, &step, 1.0);
                let reached = self.cost.total(self.graph, &self.trial);
                if reached < cost {
                    std::mem::swap(poses, &mut self.trial);
                    self.report(reached, promised, cost - reached, 1.0);
                    cost = reached;
                }
                return Ok((initial, cost, self.settled()));
            }
            // Where little is left to be gained, the next step is likely to do without the matrix.
            let settled = reuse.is_some() || promised < SETTLED * cost;
            let mut share = 1.0;
            loop {
                self.displace(poses, &step, share);
                let trial = std::mem::take(&mut self.trial);
                let reached = self.linearise(&trial, settled);
                self.trial = trial;
                if reached <= cost * (1.0 + ROUNDING) {
                    std::mem::swap(poses, &mut self.trial);
                    self.report(reached, promised, cost - reached, share);
                    let kept = (cost - reached) / promised;
                    let served = settled && share == 1.0 && (kept - 1.0).abs() < KEPT;
                    reuse = served.then_some(CONTRACTION * promised);
                    current = !settled;
                    cost = reached;
                    break;
                }
                self.report(cost, promised, cost - reached, share);
                current = false;
                if self.steps.len() >= self.options.max_iterations {
                    return Ok((initial, cost, Stop::Iterations));
                }
                if reuse.take().is_some() {
                    break;
                }
                share *= 0.5;
                if share < 1e-6 {
                    return Ok((initial, cost, Stop::Stalled));
                }
            }
        }
        Ok((initial, cost, Stop::Iterations))
    }

    fn levenberg_marquardt(&mut self, poses: &mut Vec<G>) -> Outcome {
        let initial = self.start(poses)?;
        let mut cost = initial;
        let (mut damping, mut growth) = (1e-5, 2.0);
        while self.steps.len() < self.options.max_iterations {
            if let Err(at) = self.factorise(damping) {
                if damping > 1e6 {
                    return Err(self.unconstrained(at));
                }
                damping *= growth;
                growth *= 2.0;
                continue;
            }
            // cost − 2 gᵀh + hᵀHh with (H + λ diag H) h = g.
            let (step, whole) = self.solve();
            let extra: f64 = damping * self.diagonal(&step);
            let promised = whole + extra;
            self.displace(poses, &step, 1.0);
            let trial = std::mem::take(&mut self.trial);
            let reached = self.cost.total(self.graph, &trial);
            self.trial = trial;
            let close = self.negligible(promised, cost, poses);
            if reached <= cost * (1.0 + if close { 0.0 } else { ROUNDING }) {
                std::mem::swap(poses, &mut self.trial);
                self.report(reached, promised, cost - reached, damping);
                let gain = (cost - reached) / promised.max(f64::MIN_POSITIVE);
                damping *= (1.0f64 / 3.0).max(1.0 - (2.0 * gain - 1.0).powi(3));
                damping = damping.max(1e-15);
                growth = 2.0;
                cost = reached;
                if close {
                    return Ok((initial, cost, self.settled()));
                }
                self.linearise(poses, false);
            } else {
                self.report(cost, promised, cost - reached, damping);
                if close {
                    let stop = if damping < 1e3 { Stop::Converged } else { Stop::Stalled };
                    return Ok((initial, cost, stop));
                }
                damping *= growth;
                growth *= 2.0;
                if damping > 1e16 {
                    return Ok((initial, cost, Stop::Stalled));
                }
            }
        }
        Ok((initial, cost, Stop::Iterations))
    }

    /// hᵀ diag(H) h.
    fn diagonal(&self, step: &[f64]) -> f64 {
        let blocks = self.solver.normal.matrix.diagonal.iter().zip(step.chunks_exact(D));
        blocks.map(|(block, h)| (0..D).map(|i| block[(i, i)] * h[i] * h[i]).sum::<f64>()).sum()
    }

    fn dogleg(&mut self, poses: &mut Vec<G>) -> Outcome {
        let initial = self.start(poses)?;
        let mut cost = initial;
        let mut radius = f64::INFINITY;
        // Lengths are measured in standard deviations of single components: |√diag(H) h|.
        while self.steps.len() < self.options.max_iterations {
            self.factorise(0.0).map_err(|at| self.unconstrained(at))?;
            let (newton, promise) = self.solve();
            let close = self.negligible(promise, cost, poses);
            let newton_length = self.diagonal(&newton).sqrt();
            // Steepest descent in that measure: h = diag(H)⁻¹ g, as far as the linearised cost falls.
            let mut descent = self.solver.normal.gradient.clone();
            for (block, h) in
                self.solver.normal.matrix.diagonal.iter().zip(descent.chunks_exact_mut(D))
            {
                for i in 0..D {
                    h[i] /= block[(i, i)];
                }
            }
            let slope = dot(&descent, &self.solver.normal.gradient);
            let bend = self.solver.normal.matrix.quadratic(&self.solver.layout.structure, &descent);
            descent.iter_mut().for_each(|h| *h *= slope / bend);
            let descent_length = self.diagonal(&descent).sqrt();
            loop {
                let step = if newton_length <= radius {
                    newton.clone()
                } else if descent_length >= radius {
                    descent.iter().map(|h| h * radius / descent_length).collect()
                } else {
                    self.between(&descent, &newton, radius)
                };
                let bend =
                    self.solver.normal.matrix.quadratic(&self.solver.layout.structure, &step);
                let promised = 2.0 * dot(&step, &self.solver.normal.gradient) - bend;
                self.displace(poses, &step, 1.0);
                let trial = std::mem::take(&mut self.trial);
                let reached = self.cost.total(self.graph, &trial);
                self.trial = trial;
                let gain = (cost - reached) / promised.max(f64::MIN_POSITIVE);
                let accept = reached <= cost * (1.0 + if close { 0.0 } else { ROUNDING });
                let length = newton_length.min(radius);
                let kept = if accept { reached } else { cost };
                self.report(kept, promised, cost - reached, radius);
                if accept {
                    std::mem::swap(poses, &mut self.trial);
                    cost = reached;
                }
                if close {
                    return Ok((initial, cost, Stop::Converged));
                }
                if gain > 0.75 {
                    radius = radius.max(3.0 * length);
                } else if !(gain > 0.25) {
                    radius = 0.5 * length;
                }
                if accept {
                    self.linearise(poses, false);
                    break;
                }
                if self.steps.len() >= self.options.max_iterations {
                    return Ok((initial, cost, Stop::Iterations));
                }
                if radius < 1e-12 * newton_length {
                    return Ok((initial, cost, Stop::Stalled));
                }
            }
        }
        Ok((initial, cost, Stop::Iterations))
    }

    /// Where the way from one step to another leaves the radius.
    fn between(&self, inner: &[f64], outer: &[f64], radius: f64) -> Vec<f64> {
        let way: Vec<f64> = inner.iter().zip(outer).map(|(a, b)| b - a).collect();
        let sum: Vec<f64> = inner.iter().zip(&way).map(|(a, b)| a + b).collect();
        let (aa, ww) = (self.diagonal(inner), self.diagonal(&way));
        let aw = 0.5 * (self.diagonal(&sum) - aa - ww);
        let rest = radius * radius - aa;
        let root = (aw * aw + ww * rest).max(0.0).sqrt();
        // The positive root of ww·t² + 2 aw·t = rest, without cancellation.
        let share = if aw > 0.0 { rest / (aw + root) } else { (root - aw) / ww };
        inner.iter().zip(&way).map(|(a, w)| a + share * w).collect()
    }
}

fn unconstrained<G, const D: usize>(
    layout: &Layout,
    graph: &PoseGraph<G, D>,
    NotPositive { position, row }: NotPositive,
) -> Error {
    Error::Unconstrained { id: graph.ids[layout.pose[position] as usize], component: row }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
