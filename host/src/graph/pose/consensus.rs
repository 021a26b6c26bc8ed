//! The largest set of closures that agree, grown from those that are certain.
//!
//! Each round solves the graph with the closures accepted so far, asks of each of them whether it
//! agrees with the *others* (its error as if it had taken no part), leaves out what does not, and
//! takes in what agrees with the optimum given how uncertain that is. Where it is hardly
//! uncertain all that agree are taken at once; where it is, those that are certain first, since each of them
//! changes what is known of the others. Chain rule: the evidence of a set is the product of the evidence of
//! its members, each given those before. Closures of one look agree whether they are right or not:
//! such a group is one hypothesis (the clusters of Latif, Cadena & Neira 2013) and has the evidence of its
//! middle member, once. How probable a closure was before its evidence is learned with
//! them: where most of those that cycles did not support are random, weak evidence is not enough.

use std::collections::HashMap;

use nalgebra::{SMatrix, SVector};

use super::chordal::chordal_in;
use super::cycles::Support;
use super::evidence::{Chance, Verdict};
use super::gnc::{Annealing, Gnc};
use super::optimizer::{Optimizer, Options};
use super::part::{Part, pieces};
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
    /// Which edges had support from the start, and which others every edge would be wrong with.
    supported: Vec<bool>,
    mates: Vec<Vec<usize>>,
    /// Log odds that an edge and its mates are right, when they were last judged from outside.
    evidence: Vec<f64>,
    /// The covariance of the error of edges that were not accepted, when it was last asked for, if no
    /// edge was left out since.
    known: HashMap<usize, SMatrix<f64, D, D>>,
    /// Log odds that an edge without mates, and one with them, is right before anything is known of it.
    prior: [f64; 2],
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
        support: Support,
        chance: Chance,
    ) -> Self {
        let Support { edges: supported, mates, .. } = support;
        let accepted = supported.iter().zip(trusted).map(|(first, trusted)| *first || *trusted);
        Search {
            accepted: accepted.collect(),
            odds: trusted.iter().map(|&t| if t { f64::INFINITY } else { 0.0 }).collect(),
            left_out: vec![0; trusted.len()],
            evidence: vec![0.0; mates.len()],
            supported,
            mates,
            known: HashMap::new(),
            prior: [0.0; 2],
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
        let mut forgiven = false;
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
                    let mut entrants = self.entrants::<N>(&part, &mut spread);
                    if entrants.is_empty() && round + 1 < ROUNDS {
                        // Nothing is left to be learned: what is more probably random goes.
                        failing = members.iter().filter(|m| self.is_doubtful(&part, m)).collect();
                        if failing.is_empty() && !std::mem::replace(&mut forgiven, true) {
                            entrants = self.forgive::<N>(&part, &mut spread);
                        }
                    }
                    if failing.is_empty() || round + 1 == ROUNDS {
                        if entrants.is_empty() || round + 1 == ROUNDS {
                            self.judge_all::<N>(&part, members);
                        }
                        break entrants;
                    }
                    annealed = true;
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
        self.known.clear();
        self.accepted[edge] = false;
        self.left_out[edge] = self.left_out[edge].saturating_add(1);
    }

    /// Whether an accepted edge may remain one: unless it is certain to be wrong. Nothing can contradict what
    /// alone says where its poses are.
    fn stays(&self, edge: usize, verdict: &Verdict) -> bool {
        if !verdict.doubt.is_finite() {
            return true;
        }
        let prior = if self.supported[edge] { 0.0 } else { self.prior_of(edge) };
        match self.options.barrier {
            Some(barrier) => verdict.chi2 < barrier,
            None => verdict.odds + prior > -CERTAIN,
        }
    }

    /// Whether others may enter.
    fn enters(&self, edge: usize, verdict: &Verdict) -> bool {
        self.options.barrier.is_none_or(|barrier| verdict.chi2 < barrier)
            && verdict.odds + self.prior_of(edge) > 0.0
    }

    /// Log odds that an edge without support is right before its own evidence.
    fn prior_of(&self, edge: usize) -> f64 {
        self.prior[usize::from(!self.mates[edge].is_empty())]
    }

    /// Log odds that an edge without support from the start is right, before its own evidence:
    /// of the share under which the evidence of all of these is most probable. Where hundreds of
    /// random closures are left, some are near the truth by chance.
    fn learn_prior(&mut self) {
        for several in [false, true] {
            let like = |edge: &usize| self.mates[*edge].is_empty() != several;
            let unsupported = |edge: &usize| !self.trusted[*edge] && !self.supported[*edge];
            let edges = (0..self.odds.len()).filter(like).filter(unsupported);
            let odds: Vec<f64> = edges
                .map(|edge| if several { self.evidence[edge] } else { self.odds[edge] })
                .collect();
            let mut prior = 0.0;
            for _ in 0..30 {
                let right: f64 = odds.iter().map(|odds| 1.0 / (1.0 + (-odds - prior).exp())).sum();
                // Before any, both are as probable.
                prior = ((1.0 + right) / (1.0 + odds.len() as f64 - right)).ln();
            }
            self.prior[usize::from(several)] = prior;
        }
    }

    /// The accepted edges that are not trusted, judged by the variance that they show together. Of
    /// what had support and agrees well, odds are left open.
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
                let verdict = self.chance.fit::<D, N>(&error, &edge.information, &spread);
                Member { at, error, spread, verdict }
            })
            .collect();
        let redundant = members.iter().filter(|member| member.verdict.doubt.is_finite());
        let before = self.chance.variance;
        let squared: Vec<f64> = redundant.map(|member| member.verdict.chi2 * before).collect();
        self.chance.learn::<D>(&squared, claimed);
        for member in &mut members {
            let index = part.edges[member.at];
            member.verdict.chi2 *= before / self.chance.variance;
            // Odds are at least −χ²/2.
            if self.supported[index] && member.verdict.chi2 < 2.0 * CERTAIN {
                self.odds[index] = f64::NAN;
            } else {
                self.judge::<N>(part, member);
            }
        }
        members
    }

    /// Which edges may come back after all: some may have been left out because of others that are gone.
    fn forgive<const N: usize>(&mut self, part: &Part<G, D>, spread: &mut Spread<D>) -> Vec<usize>
    where
        G: Rigid<D, N>,
    {
        if self.left_out.iter().all(|&times| times < PATIENCE) {
            return Vec::new();
        }
        self.left_out.iter_mut().for_each(|times| *times = (*times).min(PATIENCE - 1));
        self.entrants::<N>(part, spread)
    }

    /// Whether an accepted edge without support is more probably random.
    fn is_doubtful(&self, part: &Part<G, D>, member: &Member<D>) -> bool {
        let edge = part.edges[member.at];
        let contradicted = member.verdict.doubt.is_finite();
        contradicted && !self.supported[edge] && !self.enters(edge, &member.verdict)
    }

    /// The odds that were left open.
    fn judge_all<const N: usize>(&mut self, part: &Part<G, D>, mut members: Vec<Member<D>>)
    where
        G: Rigid<D, N>,
    {
        for member in &mut members {
            if self.odds[part.edges[member.at]].is_nan() {
                self.judge::<N>(part, member);
            }
        }
    }

    /// An accepted edge judged as if it were not.
    fn judge<const N: usize>(&mut self, part: &Part<G, D>, member: &mut Member<D>)
    where
        G: Rigid<D, N>,
    {
        let information = &part.graph.edges[member.at].information;
        member.verdict = self.chance.inside::<D, N>(&member.error, information, &member.spread);
        self.odds[part.edges[member.at]] = member.verdict.odds;
    }

    /// Which other edges are to be accepted next.
    fn entrants<const N: usize>(&mut self, part: &Part<G, D>, spread: &mut Spread<D>) -> Vec<usize>
    where
        G: Rigid<D, N>,
    {
        let poses = &part.graph.poses;
        let mut pieces = part.pieces();
        let mut candidates = Vec::new();
        let mut judged = vec![f64::NAN; self.odds.len()];
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
            let chance = self.chance;
            let judge = |spread: SMatrix<f64, D, D>| {
                chance.outside::<D, N>(&slope.error, &edge.information, &spread)
            };
            // With every edge that entered since, it has become less.
            let known = self.known.get(&index).copied();
            let bound = judge(known.unwrap_or_else(|| spread.bound(edge.from, edge.to, &slope)));
            // As if the error were as large as the poses' doubt allows, and surprising all the same.
            let most = bound.odds + 0.5 * D as f64 * bound.doubt.ln();
            let hopeless = most + self.prior_of(index).max(0.0) < 0.0;
            let verdict = if hopeless {
                Verdict { odds: most, ..bound }
            } else {
                let own = spread.of(edge.from, edge.to, &slope);
                self.known.insert(index, own);
                judge(own)
            };
            self.odds[index] = verdict.odds;
            judged[index] = verdict.odds;
            candidates.push((index, verdict));
        }
        // What would agree anyway says nothing by its agreement: mates count as one, the middle one.
        for &(index, _) in &candidates {
            let mates = self.mates[index].iter().map(|&mate| judged[mate]);
            self.evidence[index] = middle(judged[index], mates);
        }
        self.learn_prior();
        let (mut entrants, mut open) = (Vec::new(), Vec::new());
        for (index, verdict) in candidates {
            let evidence = self.evidence[index];
            let odds = evidence.min(verdict.odds);
            if !self.enters(index, &Verdict { odds, ..verdict }) {
                continue;
            }
            if verdict.doubt < DECIDED {
                entrants.push(index);
            } else {
                open.push((evidence, index));
            }
        }
        open.sort_by(|a, b| b.0.total_cmp(&a.0));
        let certain = open.iter().take_while(|(odds, _)| *odds > CERTAIN);
        entrants.extend(certain.map(|&(_, index)| index));
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
                self.known.clear();
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

/// The middle of an edge's log odds and of those of its mates that have any (are not NaN); of two the lower.
fn middle(own: f64, mates: impl Iterator<Item = f64>) -> f64 {
    let mut odds: Vec<f64> = mates.filter(|odds| !odds.is_nan()).collect();
    odds.push(own);
    odds.sort_by(f64::total_cmp);
    odds[(odds.len() - 1) / 2]
}

#[cfg(test)]
mod tests {
    use super::middle;

    #[test]
    fn one_lucky_mate_does_not_speak_for_all() {
        assert_eq!(middle(9.0, [-3.0, -1.0, -2.0, f64::NAN].into_iter()), -2.0);
        assert_eq!(middle(-9.0, [3.0, 1.0].into_iter()), 1.0);
        assert_eq!(middle(5.0, [-5.0].into_iter()), -5.0);
        assert_eq!(middle(5.0, std::iter::empty()), 5.0);
    }
}
