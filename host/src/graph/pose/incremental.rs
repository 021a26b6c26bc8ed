//! Graphs that grow: every grasp brings a pose and some edges.

use std::collections::HashMap;

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::error::Error;
use super::optimizer::{Optimizer, Options, Summary};
use super::{Edge, Group, PoseGraph};

/// A pose graph that grows and is optimised from where it was.
///
/// Every [`update`](Self::update) solves the whole graph, so its result is that of a batch. What makes
/// it quick is the start: mostly one step suffices. The structure is found anew only after something
/// was added, and as a whole: from 16 to 3 500 poses that takes a fifth to two fifths of an update, so that
/// keeping parts of it could save no more.
///
/// ```
/// use tactile_host::graph::pose::{Incremental, Options, Se2};
///
/// let mut graph = Incremental::new(Options::default());
/// graph.add_pose(0, Se2::new(0.0, 0.0, 0.0))?;
/// for id in 1..10 {
///     graph.add_pose(id, Se2::new(id as f64, 0.1, 0.0))?;
///     graph.add_edge(id - 1, id, Se2::new(1.0, 0.0, 0.0), nalgebra::Matrix3::identity())?;
///     assert!(graph.update()?.converged());
/// }
/// assert!((graph.graph().poses[9].translation.x - 9.0).abs() < 1e-9);
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Incremental<G, const D: usize> {
    graph: PoseGraph<G, D>,
    index: HashMap<u64, usize>,
    options: Options,
    optimizer: Option<Optimizer<D>>,
}

impl<G: Group<D>, const D: usize> Incremental<G, D> {
    /// An empty graph.
    pub fn new(options: Options) -> Self {
        let (graph, index) = (PoseGraph::default(), HashMap::new());
        Self { graph, index, options, optimizer: None }
    }

    /// The graph as it is.
    pub fn graph(&self) -> &PoseGraph<G, D> {
        &self.graph
    }

    /// Adds a pose near `estimate`.
    ///
    /// # Errors
    /// An id that is taken, a pose that is not finite.
    pub fn add_pose(&mut self, id: u64, estimate: G) -> Result<(), Error> {
        if !estimate.is_finite() {
            return Err(Error::PoseNotFinite { id });
        }
        if self.index.contains_key(&id) {
            return Err(Error::Repeated { id });
        }
        self.index.insert(id, self.graph.poses.len());
        self.graph.ids.push(id);
        self.graph.poses.push(estimate);
        self.optimizer = None;
        Ok(())
    }

    /// Adds a measurement between two poses, called by their ids; see [`Edge`].
    ///
    /// # Errors
    /// An id that is not there; numbers that are not finite, information that is not symmetric and positive
    /// semidefinite.
    pub fn add_edge(
        &mut self,
        from: u64,
        to: u64,
        measured: G,
        information: SMatrix<f64, D, D>,
    ) -> Result<(), Error> {
        let at = |id: u64| self.index.get(&id).copied().ok_or(Error::Unknown { id });
        let edge = Edge { from: at(from)?, to: at(to)?, measured, information };
        if from == to {
            return Err(Error::Loop { edge: self.graph.edges.len(), id: from });
        }
        edge.check(self.graph.edges.len(), from, to)?;
        self.graph.edges.push(edge);
        self.optimizer = None;
        Ok(())
    }

    /// Moves all poses to the minimum near where they are.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn update(&mut self) -> Result<Summary, Error> {
        let optimizer = match &mut self.optimizer {
            Some(optimizer) => optimizer,
            none => none.insert(Optimizer::new(&self.graph)?),
        };
        optimizer.optimize(&mut self.graph, &self.options)
    }
}

/// The last poses of a trajectory; what older ones had to say about them is kept as a Gaussian.
///
/// A pose that leaves is marginalised: with H and g of the edges that touch it, and of the Gaussian so
/// far, linearised where the poses are at that moment, H_bb − H_ba H_aa⁻¹ H_ab and
/// g_b − H_ba H_aa⁻¹ g_a remain on its neighbours (Sibley, Matthies and Sukhatme 2010). Nothing is
/// counted twice and nothing is lost but what linearisation loses: where errors are linear in the
/// poses the window's estimates are those of the batch. The first pose is held until it leaves.
///
/// The window is solved densely by Gauss–Newton steps, halved where they do not lower the cost; a
/// window of 50 poses takes milliseconds.
#[derive(Clone, Debug)]
pub struct FixedLag<G, const D: usize> {
    lag: usize,
    options: Options,
    poses: Vec<(u64, G)>,
    edges: Vec<Edge<G, D>>,
    prior: Option<Gaussian<G>>,
}

/// δᵀ Λ δ + 2 γᵀ δ, where δ are the tangents at `at` that lead to the window's first poses.
#[derive(Clone, Debug)]
struct Gaussian<G> {
    at: Vec<G>,
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl<G: Group<D>, const D: usize> FixedLag<G, D> {
    /// An empty window that keeps `lag` poses, at least one. Of `options`, the method is always
    /// Gauss–Newton.
    pub fn new(lag: usize, options: Options) -> Self {
        let (poses, edges) = (Vec::new(), Vec::new());
        Self { lag: lag.max(1), options, poses, edges, prior: None }
    }

    /// Ids and estimates of the poses in the window, oldest first.
    pub fn poses(&self) -> &[(u64, G)] {
        &self.poses
    }

    /// Adds a pose near `estimate`; [`update`](Self::update) makes the oldest leave.
    ///
    /// # Errors
    /// An id that is taken, a pose that is not finite.
    pub fn add_pose(&mut self, id: u64, estimate: G) -> Result<(), Error> {
        if !estimate.is_finite() {
            return Err(Error::PoseNotFinite { id });
        }
        if self.poses.iter().any(|(other, _)| *other == id) {
            return Err(Error::Repeated { id });
        }
        self.poses.push((id, estimate));
        Ok(())
    }

    /// Adds a measurement between two poses in the window, called by their ids; see [`Edge`].
    ///
    /// # Errors
    /// An id that is not, or no longer, in the window; numbers that are not finite, information that is not
    /// symmetric and positive semidefinite.
    pub fn add_edge(
        &mut self,
        from: u64,
        to: u64,
        measured: G,
        information: SMatrix<f64, D, D>,
    ) -> Result<(), Error> {
        let at = |id: u64| {
            self.poses.iter().position(|(other, _)| *other == id).ok_or(Error::Unknown { id })
        };
        let edge = Edge { from: at(from)?, to: at(to)?, measured, information };
        let number = self.edges.len();
        if from == to {
            return Err(Error::Loop { edge: number, id: from });
        }
        edge.check(number, from, to)?;
        self.edges.push(edge);
        Ok(())
    }

    /// Moves the poses of the window to the minimum near where they are, then lets the oldest leave
    /// until `lag` are left. Returns the cost and how many steps were taken.
    ///
    /// # Errors
    /// A pose that is not determined by its measurements.
    pub fn update(&mut self) -> Result<(f64, usize), Error> {
        let mut poses: Vec<G> = self.poses.iter().map(|(_, pose)| *pose).collect();
        // Without a Gaussian nothing says where the window is: its first pose stays.
        let held = if self.prior.is_none() { D } else { 0 };
        let (mut h, mut g, mut cost) = self.linearised(&poses);
        let mut steps = 0;
        while steps < self.options.max_iterations && poses.len() * D > held {
            let moving = poses.len() * D - held;
            let matrix = h.view((held, held), (moving, moving)).into_owned();
            let right = g.rows(held, moving).into_owned();
            let step = self.solved(matrix, &right, held / D)?;
            let promised = step.dot(&right);
            let close = promised <= self.options.tolerance * cost.abs() + 1e-14;
            let mut share = 1.0;
            let reached = loop {
                let trial: Vec<G> = (0..poses.len())
                    .map(|i| match (i * D).checked_sub(held) {
                        None => poses[i],
                        Some(at) => {
                            let own = SVector::<f64, D>::from_fn(|r, _| -share * step[at + r]);
                            poses[i].retract(&own)
                        }
                    })
                    .collect();
                let (h, g, reached) = self.linearised(&trial);
                if reached <= cost + 1e-12 * cost.abs() {
                    break Some((trial, h, g, reached));
                }
                share *= 0.5;
                if close || share < 1e-6 {
                    break None;
                }
            };
            let Some((trial, more, gradient, reached)) = reached else { break };
            (poses, h, g, cost) = (trial, more, gradient, reached);
            steps += 1;
            if close {
                break;
            }
        }
        for (own, pose) in self.poses.iter_mut().zip(&poses) {
            own.1 = *pose;
        }
        while self.poses.len() > self.lag {
            self.marginalise()?;
        }
        Ok((cost, steps))
    }

    /// Covariance of the newest pose's tangent, about its estimate.
    ///
    /// # Errors
    /// A pose that is not determined by its measurements.
    pub fn newest_covariance(&self) -> Result<Option<SMatrix<f64, D, D>>, Error> {
        let poses: Vec<G> = self.poses.iter().map(|(_, pose)| *pose).collect();
        let held = if self.prior.is_none() { D } else { 0 };
        if poses.len() * D <= held {
            return Ok((!poses.is_empty()).then(SMatrix::zeros));
        }
        let (h, _, _) = self.linearised(&poses);
        let moving = poses.len() * D - held;
        let matrix = h.view((held, held), (moving, moving)).into_owned();
        let mut covariance = SMatrix::<f64, D, D>::zeros();
        for i in 0..D {
            let mut unit = DVector::zeros(moving);
            unit[moving - D + i] = 1.0;
            let column = self.solved(matrix.clone(), &unit, held / D)?;
            covariance.set_column(i, &column.fixed_rows::<D>(moving - D).into_owned());
        }
        Ok(Some((covariance + covariance.transpose()) * 0.5))
    }

    fn solved(
        &self,
        matrix: DMatrix<f64>,
        right: &DVector<f64>,
        first: usize,
    ) -> Result<DVector<f64>, Error> {
        let size = matrix.nrows();
        let diagonal = matrix.diagonal();
        let unconstrained = |row: usize| {
            let id = self.poses[(first + row / D).min(self.poses.len() - 1)].0;
            Error::Unconstrained { id, component: row % D }
        };
        let Some(cholesky) = matrix.cholesky() else {
            let row = (0..size).find(|&i| !(diagonal[i] > 0.0)).unwrap_or(size - 1);
            return Err(unconstrained(row));
        };
        let l = cholesky.l_dirty();
        let small = |i: &usize| !(l[(*i, *i)].powi(2) > 1e-14 * diagonal[*i]);
        match (0..size).find(small) {
            Some(row) => Err(unconstrained(row)),
            None => Ok(cholesky.solve(right)),
        }
    }

    /// H, g and the cost of the window.
    fn linearised(&self, poses: &[G]) -> (DMatrix<f64>, DVector<f64>, f64) {
        let size = poses.len() * D;
        let (mut h, mut g) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut cost = self.edges.iter().map(|e| self.add(e, poses, &mut h, &mut g)).sum::<f64>();
        if let Some(prior) = &self.prior {
            cost += prior.add(poses, &mut h, &mut g);
        }
        (h, g, cost)
    }

    /// Adds an edge to H and g; returns its cost.
    fn add(&self, e: &Edge<G, D>, poses: &[G], h: &mut DMatrix<f64>, g: &mut DVector<f64>) -> f64 {
        let at = G::linearise(&poses[e.from], &poses[e.to], &e.measured);
        let squared = at.error.dot(&(e.information * at.error));
        let (cost, weight) = self.options.kernel.cost_and_weight(squared);
        let sides = [(e.from, at.from), (e.to, at.to)];
        for (a, ja) in &sides {
            let pull = ja.tr_mul(&e.information) * weight;
            let mut own = g.fixed_rows_mut::<D>(a * D);
            own += pull * at.error;
            for (b, jb) in &sides {
                let mut block = h.fixed_view_mut::<D, D>(a * D, b * D);
                block += pull * jb;
            }
        }
        cost
    }

    /// Turns what the oldest pose and its edges say into a Gaussian over the others.
    fn marginalise(&mut self) -> Result<(), Error> {
        let poses: Vec<G> = self.poses.iter().map(|(_, pose)| *pose).collect();
        let size = poses.len() * D;
        let (mut h, mut g) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let leaves = |e: &Edge<G, D>| e.from == 0 || e.to == 0;
        for edge in self.edges.iter().filter(|e| leaves(e)) {
            self.add(edge, &poses, &mut h, &mut g);
        }
        let rest = size - D;
        let mut information = h.view((D, D), (rest, rest)).into_owned();
        let mut gradient = g.rows(D, rest).into_owned();
        if let Some(prior) = &self.prior {
            prior.add(&poses, &mut h, &mut g);
            let own = h.view((0, 0), (D, D)).into_owned();
            let across = h.view((D, 0), (rest, D)).into_owned();
            let id = self.poses[0].0;
            let own = own.cholesky().ok_or(Error::Unconstrained { id, component: 0 })?;
            let solved = own.solve(&across.transpose());
            information = h.view((D, D), (rest, rest)) - &across * solved;
            gradient = g.rows(D, rest) - &across * own.solve(&g.rows(0, D).into_owned());
            information = (&information + information.transpose()) * 0.5;
        }
        // Nothing fails from here on.
        self.edges.retain(|e| !leaves(e));
        for edge in &mut self.edges {
            edge.from -= 1;
            edge.to -= 1;
        }
        self.poses.remove(0);
        let at = poses[1..].to_vec();
        self.prior = Some(Gaussian { at, information, gradient });
        Ok(())
    }
}

impl<G> Gaussian<G> {
    /// Adds this to H and g at `poses`, the first of which it is about; returns its cost, which is
    /// negative where it is less than at the point of linearisation.
    fn add<const D: usize>(&self, poses: &[G], h: &mut DMatrix<f64>, g: &mut DVector<f64>) -> f64
    where
        G: Group<D>,
    {
        let size = self.at.len() * D;
        let mut tangent = DVector::zeros(size);
        let mut derivative = DMatrix::zeros(size, size);
        for (i, (at, pose)) in self.at.iter().zip(poses).enumerate() {
            let own = at.local(pose);
            tangent.fixed_rows_mut::<D>(i * D).copy_from(&own);
            derivative.fixed_view_mut::<D, D>(i * D, i * D).copy_from(&G::local_derivative(&own));
        }
        let pull = &self.information * &tangent;
        let mut block = h.view_mut((0, 0), (size, size));
        block += derivative.tr_mul(&self.information) * &derivative;
        let mut own = g.rows_mut(0, size);
        own += derivative.tr_mul(&(&pull + &self.gradient));
        tangent.dot(&(pull + 2.0 * &self.gradient))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::walk;
    use super::super::{Se2, Se3, optimize};
    use super::*;

    const TIGHT: Options = Options {
        method: super::super::Method::GaussNewton,
        kernel: super::super::Kernel::Identity,
        max_iterations: 100,
        tolerance: 1e-15,
    };

    fn grown<G: Group<D>, const D: usize>(seed: u64) {
        let (mut batch, _) = walk::<G, D>(20, 20, 0.05, 0.05, seed);
        let mut ours = Incremental::new(TIGHT);
        for at in 0..batch.poses.len() {
            ours.add_pose(batch.ids[at], batch.poses[at]).unwrap();
            for e in batch.edges.iter().filter(|e| e.from.max(e.to) == at) {
                let (from, to) = (batch.ids[e.from], batch.ids[e.to]);
                ours.add_edge(from, to, e.measured, e.information).unwrap();
            }
            ours.update().unwrap();
        }
        optimize(&mut batch, &TIGHT).unwrap();
        for (a, b) in ours.graph().poses.iter().zip(&batch.poses) {
            assert!(G::error(a, b, &G::identity()).norm() < 1e-6);
        }
        assert_eq!(ours.update().unwrap().factorisations, 1);
    }

    #[test]
    fn growing_ends_where_the_batch_does() {
        for seed in 0..4 {
            grown::<Se2, 3>(seed);
            grown::<Se3, 6>(seed);
        }
    }

    /// A walk whose edges reach back three poses at most.
    fn band<G: Group<D>, const D: usize>(noise: f64, straight: bool) -> PoseGraph<G, D> {
        let (mut graph, truth) = walk::<G, D>(30, 0, noise, noise, 11);
        let turned = |pose: &G| {
            // Without rotation errors are linear.
            let mut tangent = G::identity().local(pose);
            if straight {
                (G::DIMENSION..D).for_each(|i| tangent[i] = 0.0);
            }
            G::identity().retract(&tangent)
        };
        let truth: Vec<G> = truth.iter().map(turned).collect();
        let mut edges = Vec::new();
        for reach in 1..4 {
            for from in 0..30 - reach {
                let mut edge = graph.edges[(from * 7 + reach) % graph.edges.len()].clone();
                let wave = |r: usize| ((from * 13 + r * 5 + reach) as f64).sin();
                let noise = G::identity().retract(&SVector::from_fn(|r, _| noise * wave(r)));
                (edge.from, edge.to) = (from, from + reach);
                edge.measured = truth[from].between(&truth[from + reach]).compose(&turned(&noise));
                if straight {
                    // Translation and rotation apart: no turn follows from a shift.
                    for i in 0..G::DIMENSION {
                        for j in G::DIMENSION..D {
                            edge.information[(i, j)] = 0.0;
                            edge.information[(j, i)] = 0.0;
                        }
                    }
                }
                edges.push(edge);
            }
        }
        graph.edges = edges;
        graph.poses = truth;
        graph
    }

    /// The window's newest estimates against batches of all that was known then.
    fn lagged<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>, lag: usize) -> f64 {
        let mut window = FixedLag::new(lag, TIGHT);
        let mut known = PoseGraph::<G, D>::default();
        let mut worst: f64 = 0.0;
        for at in 0..graph.poses.len() {
            window.add_pose(graph.ids[at], graph.poses[at]).unwrap();
            known.ids.push(graph.ids[at]);
            known.poses.push(graph.poses[at]);
            for e in graph.edges.iter().filter(|e| e.from.max(e.to) == at) {
                let (from, to) = (graph.ids[e.from], graph.ids[e.to]);
                window.add_edge(from, to, e.measured, e.information).unwrap();
                known.edges.push(e.clone());
            }
            window.update().unwrap();
            optimize(&mut known, &TIGHT).unwrap();
            assert!(window.poses().len() <= lag);
            for (id, pose) in window.poses() {
                let index = known.ids.iter().position(|other| other == id).unwrap();
                worst = worst.max(G::error(pose, &known.poses[index], &G::identity()).norm());
            }
        }
        let marginals = super::super::marginals(&known).unwrap();
        let exact = marginals.pose(known.poses.len() - 1);
        let ours = window.newest_covariance().unwrap().unwrap();
        let off = (ours - exact).norm() / exact.norm();
        assert!(off < 0.05, "covariance off by {off}");
        worst
    }

    #[test]
    fn a_window_estimates_what_the_batch_does() {
        for lag in [4, 8] {
            let exact = lagged(&band::<Se2, 3>(1e-3, true), lag)
                .max(lagged(&band::<Se3, 6>(1e-3, true), lag));
            assert!(exact < 2e-6, "{exact}");
            let near = lagged(&band::<Se2, 3>(0.01, false), lag)
                .max(lagged(&band::<Se3, 6>(0.01, false), lag));
            assert!(near < 1e-3, "{near}");
        }
    }

    #[test]
    fn growth_is_checked() {
        let mut graph = Incremental::<Se2, 3>::new(TIGHT);
        let mut window = FixedLag::<Se2, 3>::new(1, TIGHT);
        assert!(graph.update().unwrap().converged());
        assert_eq!(window.update().unwrap(), (0.0, 0));
        let (pose, information) = (Se2::new(0.0, 0.0, 0.0), nalgebra::Matrix3::identity());
        graph.add_pose(7, pose).unwrap();
        window.add_pose(7, pose).unwrap();
        assert_eq!(graph.add_pose(7, pose), Err(Error::Repeated { id: 7 }));
        assert_eq!(window.add_pose(7, pose), Err(Error::Repeated { id: 7 }));
        assert_eq!(graph.add_edge(7, 8, pose, information), Err(Error::Unknown { id: 8 }));
        assert_eq!(window.add_edge(7, 8, pose, information), Err(Error::Unknown { id: 8 }));
        assert_eq!(graph.add_edge(7, 7, pose, information), Err(Error::Loop { edge: 0, id: 7 }));
        let nan = Se2::new(f64::NAN, 0.0, 0.0);
        graph.add_pose(8, pose).unwrap();
        let rewarded = -information;
        for error in
            [graph.add_edge(7, 8, nan, information), window.add_edge(7, 7, nan, information)]
        {
            assert!(matches!(error, Err(Error::EdgeNotFinite { .. } | Error::Loop { .. })));
        }
        let error = graph.add_edge(7, 8, pose, rewarded).unwrap_err();
        assert!(matches!(error, Error::Information { edge: 0, from: 7, to: 8, .. }), "{error}");
        assert_eq!(graph.add_pose(9, nan), Err(Error::PoseNotFinite { id: 9 }));
        // A pose without edges cannot be placed.
        window.add_pose(8, pose).unwrap();
        assert!(matches!(window.update(), Err(Error::Unconstrained { id: 8, .. })));
        window.add_edge(7, 8, pose, information).unwrap();
        window.update().unwrap();
        assert_eq!(window.poses().iter().map(|(id, _)| *id).collect::<Vec<_>>(), [8]);
        assert_eq!(window.add_edge(7, 8, pose, information), Err(Error::Unknown { id: 7 }));
    }
}
