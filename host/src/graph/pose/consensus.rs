//! The largest set of closures that agree, grown from those that are certain.
//!
//! Each round solves the graph with the closures accepted so far, asks of each of them whether it
//! agrees with the *others* (its error as if it had taken no part), leaves out what does not, and
//! takes in what agrees with the optimum given how uncertain that is. Where it is hardly
//! uncertain all that agree are taken at once; where it is, the most certain first, since each of them
//! changes what is known of the others. Chain rule: the evidence of a set is the product of the evidence of
//! its members, each given those before. How probable a closure was before its evidence is learned with
//! them: where most of those that cycles did not support are random, weak evidence is not enough.

use std::collections::HashMap;

use nalgebra::{SMatrix, SVector};

use super::chordal::chordal_in;
use super::evidence::{Chance, Verdict, scale};
use super::gnc::{Annealing, Gnc};
use super::odometry::Sets;
use super::optimizer::{Optimizer, Options};
use super::rigid::Rigid;
use super::spread::Spread;
use super::{Error, Group, PoseGraph};

/// Steps towards the optimum of one set of edges.
const STEPS: usize = 3;

/// Rounds of growth, and of annealing, at most.
const ROUNDS: usize = 50;

/// How often the same edge may be left out before it stays out.
const PATIENCE: u8 = 2;

/// Log odds of what is as good as certain: 100 to 1.
const CERTAIN: f64 = 4.6;

/// An error is judged by itself, not by what is unknown of the poses, where its standard deviation is
/// no more than twice that of its measurement.
const DECIDED: f64 = 4.0;

/// A search under way.
pub(super) struct Search<'a, G, const D: usize> {
    /// At the poses of the last round.
    pub graph: PoseGraph<G, D>,
    /// What is random, and how large errors are.
    pub chance: Chance,
    /// Which edges count.
    pub accepted: Vec<bool>,
    /// Log odds that an edge is right, as last judged.
    pub odds: Vec<f64>,
    /// Least-squares problems solved.
    pub rounds: usize,
    trusted: &'a [bool],
    options: &'a Gnc,
    left_out: Vec<u8>,
    /// Which edges had support from the start, and the log odds that another one is right before
    /// anything is known of it.
    supported: Vec<bool>,
    prior: f64,
}

/// An edge of the optimum and how it agrees with the others.
struct Member<const D: usize> {
    /// In the part.
    at: usize,
    error: SVector<f64, D>,
    spread: SMatrix<f64, D, D>,
    verdict: Verdict,
}

impl<'a, G: Group<D>, const D: usize> Search<'a, G, D> {
    /// From `first` edges and those that are trusted, which stay.
    pub fn new(
        graph: &PoseGraph<G, D>,
        options: &'a Gnc,
        trusted: &'a [bool],
        first: &[bool],
        chance: Chance,
    ) -> Self {
        let accepted = first.iter().zip(trusted).map(|(first, trusted)| *first || *trusted);
        Search {
            accepted: accepted.collect(),
            odds: trusted.iter().map(|&t| if t { f64::INFINITY } else { 0.0 }).collect(),
            left_out: vec![0; trusted.len()],
            supported: first.to_vec(),
            prior: 0.0,
            graph: graph.clone(),
            rounds: 0,
            chance,
            trusted,
            options,
        }
    }

    /// To the end, where nothing changes.
    pub fn run<const N: usize>(&mut self) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        let claimed = self.chance.variance;
        let mut expected = 0.0;
        for round in 0..ROUNDS {
            let mut part = Part::new(&self.graph, &self.accepted);
            let mut optimizer = Optimizer::new(&part.graph)?;
            let begun = part.graph.chi2();
            if round == 0 || begun > 4.0 * expected {
                part.relax::<N>(&optimizer)?;
            }
            let steps = if round == 0 { Options::default().max_iterations } else { STEPS };
            part.solve(&mut optimizer, steps)?;
            self.rounds += 1;
            let mut annealed = round > 0;
            let entrants = loop {
                let mut spread = Spread::new(&mut optimizer, &part.graph, &part.weights)?;
                let members = self.members::<N>(&part, &mut spread, claimed);
                let mut failing: Vec<&Member<D>> = members
                    .iter()
                    .filter(|member| !self.stays(part.edges[member.at], &member.verdict))
                    .collect();
                if failing.is_empty() || round + 1 == ROUNDS {
                    break self.entrants::<N>(&part, &mut spread);
                }
                if !annealed && 20 * failing.len() > members.len() && failing.len() > 4 {
                    // Too many to tell who spoils whom.
                    annealed = true;
                    let open = members.iter().map(|member| member.at).collect();
                    drop(spread);
                    self.anneal::<N>(&mut part, &mut optimizer, open)?;
                    continue;
                }
                // The worst spoil their neighbours: a part of them first.
                failing.sort_by(|a, b| b.verdict.chi2.total_cmp(&a.verdict.chi2));
                let count = failing.len().div_ceil(4);
                let out: Vec<usize> = failing[..count].iter().map(|member| member.at).collect();
                drop(spread);
                for at in out {
                    part.weights[at] = 0.0;
                    self.leave_out(part.edges[at]);
                }
                part.solve(&mut optimizer, STEPS)?;
                self.rounds += 1;
            };
            let last = entrants.is_empty() || round + 1 == ROUNDS;
            if last {
                part.solve(&mut optimizer, Options::default().max_iterations)?;
            }
            let weighted = part.graph.edges.iter().zip(&part.weights);
            let chi2: f64 =
                weighted.map(|(edge, weight)| weight * edge.chi2(&part.graph.poses)).sum();
            expected = chi2 + (entrants.len() * D) as f64 * self.chance.variance;
            self.graph.poses = part.graph.poses;
            if last {
                break;
            }
            entrants.iter().for_each(|&edge| self.accepted[edge] = true);
        }
        Ok(())
    }

    fn leave_out(&mut self, edge: usize) {
        self.accepted[edge] = false;
        self.left_out[edge] = self.left_out[edge].saturating_add(1);
    }

    /// Whether an accepted edge may remain one: unless it is certain to be wrong.
    fn stays(&self, edge: usize, verdict: &Verdict) -> bool {
        let prior = if self.supported[edge] { 0.0 } else { self.prior };
        match self.options.barrier {
            Some(barrier) => verdict.chi2 < barrier,
            None => verdict.odds + prior > -CERTAIN,
        }
    }

    /// Whether others may enter.
    fn enters(&self, verdict: &Verdict) -> bool {
        self.options.barrier.is_none_or(|barrier| verdict.chi2 < barrier)
            && verdict.odds + self.prior > 0.0
    }

    /// Log odds that an edge without support from the start is right, before its own evidence: of the share
    /// under which the evidence of all of these is most probable. Where hundreds of random
    /// closures are left, some are near the truth by chance.
    fn learn_prior(&mut self) {
        let edges = 0..self.odds.len();
        let unsupported = edges.filter(|&edge| !self.trusted[edge] && !self.supported[edge]);
        let odds: Vec<f64> = unsupported.map(|edge| self.odds[edge]).collect();
        self.prior = 0.0;
        for _ in 0..30 {
            let right: f64 = odds.iter().map(|odds| 1.0 / (1.0 + (-odds - self.prior).exp())).sum();
            // Before any, both are as probable.
            self.prior = ((1.0 + right) / (1.0 + odds.len() as f64 - right)).ln();
        }
    }

    /// The accepted edges that are not trusted, judged by the variance that they show together.
    fn members<const N: usize>(
        &mut self,
        part: &Part<G, D>,
        spread: &mut Spread<D>,
        claimed: f64,
    ) -> Vec<Member<D>>
    where
        G: Rigid<D, N>,
    {
        let edges = part.graph.edges.iter().enumerate();
        let judged = |at: usize| part.weights[at] > 0.0 && !self.trusted[part.edges[at]];
        let mut members: Vec<Member<D>> = edges
            .filter(|(at, _)| judged(*at))
            .map(|(at, edge)| {
                let poses = &part.graph.poses;
                let slope = G::linearise(&poses[edge.from], &poses[edge.to], &edge.measured);
                let (error, spread) = (slope.error, spread.of(edge.from, edge.to, &slope));
                let verdict = self.chance.inside::<D, N>(&error, &edge.information, &spread);
                Member { at, error, spread, verdict }
            })
            .collect();
        let redundant = members.iter().filter(|member| member.verdict.doubt.is_finite());
        let variance = self.chance.variance;
        let squared: Vec<f64> = redundant.map(|member| member.verdict.chi2 * variance).collect();
        self.chance.variance = scale::<D>(&squared, claimed);
        for member in &mut members {
            let information = &part.graph.edges[member.at].information;
            member.verdict = self.chance.inside::<D, N>(&member.error, information, &member.spread);
            self.odds[part.edges[member.at]] = member.verdict.odds;
        }
        members
    }

    /// Which other edges are to be accepted next.
    fn entrants<const N: usize>(&mut self, part: &Part<G, D>, spread: &mut Spread<D>) -> Vec<usize>
    where
        G: Rigid<D, N>,
    {
        let poses = &part.graph.poses;
        let mut pieces = part.pieces();
        let mut candidates = Vec::new();
        let mut joining: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
        for (index, edge) in self.graph.edges.iter().enumerate() {
            if self.accepted[index] || self.left_out[index] >= PATIENCE {
                continue;
            }
            let (a, b) = (pieces.root(edge.from), pieces.root(edge.to));
            if a != b {
                joining.entry((a.min(b), a.max(b))).or_default().push(index);
                continue;
            }
            let slope = G::linearise(&poses[edge.from], &poses[edge.to], &edge.measured);
            let judge = |spread: SMatrix<f64, D, D>| {
                self.chance.outside::<D, N>(&slope.error, &edge.information, &spread)
            };
            let bound = judge(spread.bound(edge.from, edge.to, &slope));
            // As if the error were as large as the poses' doubt allows, and surprising all the same.
            let most = bound.odds + 0.5 * D as f64 * bound.doubt.ln();
            let hopeless = most + self.prior.max(0.0) < 0.0;
            let verdict = match hopeless {
                true => Verdict { odds: most, ..bound },
                false => judge(spread.of(edge.from, edge.to, &slope)),
            };
            self.odds[index] = verdict.odds;
            if !hopeless {
                candidates.push((index, verdict));
            }
        }
        self.learn_prior();
        let (mut decided, mut open) = (Vec::new(), Vec::new());
        for (index, verdict) in candidates.into_iter().filter(|(_, v)| self.enters(v)) {
            let list = if verdict.doubt < DECIDED { &mut decided } else { &mut open };
            list.push((verdict.odds, index));
        }
        open.sort_by(|a, b| b.0.total_cmp(&a.0));
        let certain = open.iter().take_while(|(odds, _)| *odds > CERTAIN).count();
        let mut entrants: Vec<usize> = decided.into_iter().map(|(_, index)| index).collect();
        entrants.extend(open[..certain.div_ceil(2)].iter().map(|&(_, index)| index));
        if entrants.is_empty() {
            entrants.extend(open.first().map(|&(_, index)| index));
        }
        if entrants.is_empty() {
            // Nothing can contradict the only edge between two pieces.
            let only = joining.values().filter(|between| between.len() == 1);
            entrants.extend(only.flatten().copied().min());
        }
        entrants
    }

    /// Graduated non-convexity over the `open` edges of a part: μ runs from convex to robust, each
    /// round from the relaxed optimum with its weights, and what has lost its weight is left out.
    fn anneal<const N: usize>(
        &mut self,
        part: &mut Part<G, D>,
        optimizer: &mut Optimizer<D>,
        open: Vec<usize>,
    ) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        let barrier = self.options.barrier(D) * self.chance.variance;
        let squared = |part: &Part<G, D>, at: usize| part.graph.edges[at].chi2(&part.graph.poses);
        let worst = open.iter().map(|&at| squared(part, at)).fold(0.0, f64::max);
        let mut annealing = Annealing::new(self.options, barrier, worst);
        for _ in 0..ROUNDS {
            let mut settled = true;
            for &at in &open {
                let weight = annealing.weight(squared(part, at));
                settled &= weight == 0.0 || weight == 1.0 || annealing.is_last();
                part.weights[at] = weight;
            }
            if settled {
                break;
            }
            part.graph.poses = chordal_in(&part.graph, &optimizer.layout, Some(&part.weights))?;
            part.solve(optimizer, 1)?;
            self.rounds += 1;
            annealing.proceed(self.options.growth);
        }
        for at in open {
            let inlier = part.weights[at] > 0.5;
            part.weights[at] = f64::from(inlier);
            if !inlier {
                // No verdict: it may come back as often as any other.
                self.accepted[part.edges[at]] = false;
            }
        }
        part.solve(optimizer, Options::default().max_iterations)
    }

    /// A pose that the accepted edges leave in another piece than all edges do.
    pub fn undecided(&self) -> Option<u64> {
        let whole = vec![true; self.accepted.len()];
        let mut own = pieces(&self.graph, &self.accepted);
        let mut connected = pieces(&self.graph, &whole);
        let apart = (0..self.graph.poses.len()).find(|&pose| {
            let first = connected.root(pose);
            own.root(first) != own.root(pose)
        });
        apart.map(|pose| self.graph.ids[pose])
    }
}

/// The edges of a graph that count.
struct Part<G, const D: usize> {
    graph: PoseGraph<G, D>,
    /// Their indices in the whole graph.
    edges: Vec<usize>,
    weights: Vec<f64>,
}

impl<G: Group<D>, const D: usize> Part<G, D> {
    fn new(whole: &PoseGraph<G, D>, accepted: &[bool]) -> Self {
        let edges: Vec<usize> = (0..accepted.len()).filter(|&edge| accepted[edge]).collect();
        let graph = PoseGraph {
            ids: whole.ids.clone(),
            poses: whole.poses.clone(),
            edges: edges.iter().map(|&edge| whole.edges[edge].clone()).collect(),
            fixed: whole.fixed.clone(),
        };
        Part { weights: vec![1.0; edges.len()], graph, edges }
    }

    /// Poses to the chordal relaxation where that costs less.
    fn relax<const N: usize>(&mut self, optimizer: &Optimizer<D>) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        let Ok(poses) = chordal_in(&self.graph, &optimizer.layout, None) else {
            return Ok(());
        };
        let before = self.graph.chi2();
        let old = std::mem::replace(&mut self.graph.poses, poses);
        if !(self.graph.chi2() < before) {
            self.graph.poses = old;
        }
        Ok(())
    }

    /// Poses towards the optimum of the weighted edges.
    fn solve(&mut self, optimizer: &mut Optimizer<D>, iterations: usize) -> Result<(), Error> {
        let options = Options { max_iterations: iterations, ..Options::default() };
        let weights = Some(&self.weights[..]);
        optimizer.optimize_weighted(&mut self.graph, weights, &options, &mut |_| ())?;
        Ok(())
    }

    /// Poses whose places are known relative to each other.
    fn pieces(&self) -> Sets {
        let counts: Vec<bool> = self.weights.iter().map(|&weight| weight > 0.0).collect();
        pieces(&self.graph, &counts)
    }
}

/// Poses that `counting` edges connect, and those that are fixed.
fn pieces<G, const D: usize>(graph: &PoseGraph<G, D>, counting: &[bool]) -> Sets {
    let mut sets = Sets::new(graph.poses.len());
    for pair in graph.fixed.windows(2) {
        sets.join(pair[0], pair[1]);
    }
    for (edge, _) in graph.edges.iter().zip(counting).filter(|(_, counts)| **counts) {
        sets.join(edge.from, edge.to);
    }
    sets
}
