//! The steps from one estimate to the next.

use nalgebra::SVector;

use super::error::Error;
use super::normal::{Cost, Layout};
use super::optimizer::{Iteration, Method, Optimizer, Options, Stop};
use super::sparse::{NotPositive, Reached, conjugate_gradients};
use super::{Group, PoseGraph};

/// What a descent did.
pub(super) struct Descent {
    pub initial_cost: f64,
    pub final_cost: f64,
    pub steps: Vec<Iteration>,
    pub factorisations: usize,
    pub stop: Stop,
}

/// Moves `poses`, the poses of `graph`, to a minimum.
pub(super) fn descend<G: Group<D>, const D: usize>(
    solver: &mut Optimizer<D>,
    graph: &PoseGraph<G, D>,
    poses: &mut Vec<G>,
    cost: Cost<'_>,
    options: &Options,
    watch: &mut dyn FnMut(&Iteration),
) -> Result<Descent, Error> {
    let mut search = Search {
        graph,
        cost,
        options,
        watch,
        solver,
        measured: graph.edges.iter().map(|e| e.measured.frame()).collect(),
        frames: Vec::with_capacity(poses.len()),
        trial: poses.clone(),
        steps: Vec::new(),
        factorisations: 0,
        damping: 0.0,
        accurate: true,
    };
    let (initial_cost, final_cost, stop) = match options.method {
        Method::GaussNewton => search.gauss_newton(poses)?,
        Method::LevenbergMarquardt => search.levenberg_marquardt(poses)?,
        Method::Dogleg => search.dogleg(poses)?,
    };
    let Search { steps, factorisations, .. } = search;
    Ok(Descent { initial_cost, final_cost, steps, factorisations, stop })
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

/// Damping of Levenberg and Marquardt from which on steps are short whatever the cost could fall.
const HELD: f64 = 1e3;

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
                // A step held so short promises little wherever it is.
                let free = damping < HELD;
                damping *= (1.0f64 / 3.0).max(1.0 - (2.0 * gain - 1.0).powi(3));
                damping = damping.max(1e-15);
                growth = 2.0;
                cost = reached;
                if close && free {
                    return Ok((initial, cost, self.settled()));
                }
                self.linearise(poses, false);
            } else {
                self.report(cost, promised, cost - reached, damping);
                if close {
                    let stop = if damping < HELD { Stop::Converged } else { Stop::Stalled };
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
                    return Ok((initial, cost, self.settled()));
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

/// The pose that a factorisation shows to be free.
pub(super) fn unconstrained<G, const D: usize>(
    layout: &Layout,
    graph: &PoseGraph<G, D>,
    NotPositive { position, row }: NotPositive,
) -> Error {
    Error::Unconstrained { id: graph.ids[layout.pose[position] as usize], component: row }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
