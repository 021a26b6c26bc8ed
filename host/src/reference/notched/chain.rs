//! Boxes less smaller boxes in proportion to how probable contacts make them: a Markov chain between boxes with
//! different numbers of notches (reversible jumps; Green, Biometrika 82, 1995), at several temperatures that exchange
//! what they find (Geyer, Computing Science and Statistics, 1991).

use nalgebra::Rotation3;

use super::{Felt, MOST, Notch, Notched, SQUARE, Side, Span};
use crate::reference::Contact;
use crate::sim::random::Random;
use crate::space::Point;

/// Powers of the likelihood: as many, each as much lower than the last.
const REPLICAS: usize = 8;
const COOLER: f64 = 0.6;

/// Rounds of the chains, steps of each in a round, the first rounds that do not count, and of how many others one does.
const ROUNDS: usize = 4000;
const STEPS: usize = 20;
const SETTLING: usize = 1000;
const KEPT: usize = 10;

/// What the random numbers begin with: the same contacts make the same boxes.
const SEED: u64 = 1;

/// Notches that a box has before any contact, on average.
const RATE: f64 = 2.0;

/// How often one is cut out or filled, all sides but one stay, and one goes where a contact is.
const BIRTHS: f64 = 0.25;
const SHIFTS: f64 = 0.3;
const PLACES: f64 = 0.15;

/// Nats by which points that touched nothing are less probable inside.
const FREE: f64 = 4.0;

/// Deviation of the outer box's lengths before any contact, as a logarithm, from the diameter of the contacts.
const SIZES: f64 = 0.6;

/// How often a notch is one in a side, not at a corner, and in space one of all three dimensions.
const POCKET: f64 = 0.25;
const SOLID: f64 = 0.2;

/// Small moves, in contacts' deviations and radii of what they span.
const FINE: f64 = 0.5;
const COARSE: f64 = 0.2;

/// Turns, radians.
const TURN: f64 = 0.01;

/// What every chain knows.
pub(super) struct Chains<'a> {
    contacts: &'a [Contact],
    free: &'a [Point],
    /// Half the mean diagonal of the contacts' box, its middle (in the first frame), and their usual deviation.
    radius: f64,
    middle: Point,
    deviation: f64,
    random: Random,
}

/// One chain.
struct Replica {
    power: f64,
    solid: Notched,
    felt: Vec<Felt>,
    likelihood: f64,
    prior: f64,
}

impl<'a> Chains<'a> {
    pub(super) fn of(contacts: &'a [Contact], free: &'a [Point], start: &Notched) -> Chains<'a> {
        let [random] = Random::streams(SEED);
        let sides = (0..start.dimension).map(|axis| start.size(axis));
        let radius = 0.5 * sides.map(|side| side * side).sum::<f64>().sqrt()
            / (start.dimension as f64).sqrt();
        let middle = Point::from_fn(|axis, _| 0.5 * (start.outer[axis][0] + start.outer[axis][1]));
        let mut deviations: Vec<f64> = contacts.iter().map(|c| c.point_deviation).collect();
        deviations.sort_by(f64::total_cmp);
        let deviation = deviations.get(deviations.len() / 2).copied().unwrap_or_default();
        Chains { contacts, free, radius, middle, deviation, random }
    }

    /// What the chain at the contacts' own likelihood comes by.
    pub(super) fn samples(&mut self, start: &Notched) -> Vec<Notched> {
        let mut replicas = Vec::new();
        for replica in 0..REPLICAS {
            let felt = start.felt(self.contacts);
            let Some((likelihood, prior)) = self.probability(start, &felt) else { return vec![] };
            let power = COOLER.powi(replica as i32);
            replicas.push(Replica { power, solid: start.clone(), felt, likelihood, prior });
        }
        let mut kept = Vec::new();
        for round in 0..ROUNDS {
            for replica in &mut replicas {
                for _ in 0..STEPS {
                    self.step(replica);
                }
            }
            for hot in (1..REPLICAS).rev() {
                let [one, other] =
                    [hot - 1, hot].map(|i| (replicas[i].power, replicas[i].likelihood));
                if self.accepts((one.0 - other.0) * (other.1 - one.1)) {
                    replicas.swap(hot - 1, hot);
                    for (replica, power) in [(hot - 1, one.0), (hot, other.0)] {
                        replicas[replica].power = power;
                    }
                }
            }
            if round >= SETTLING && round % KEPT == 0 {
                kept.push(replicas[0].solid.clone());
            }
        }
        kept
    }

    fn accepts(&mut self, log: f64) -> bool {
        log.exp() > self.random.unit()
    }

    fn pick(&mut self, count: usize) -> usize {
        ((self.random.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    fn step(&mut self, replica: &mut Replica) {
        let which = self.random.unit();
        let (solid, odds) = if which < BIRTHS {
            self.born(replica)
        } else if which < 2.0 * BIRTHS {
            self.died(replica)
        } else if which < 2.0 * BIRTHS + SHIFTS {
            self.shifted(&replica.solid)
        } else if which < 2.0 * BIRTHS + SHIFTS + PLACES {
            self.placed(replica)
        } else {
            (self.turned(&replica.solid), 0.0)
        };
        if !odds.is_finite() {
            return;
        }
        let felt = (solid.frame != replica.solid.frame).then(|| solid.felt(self.contacts));
        let own = felt.as_ref().unwrap_or(&replica.felt);
        let Some((likelihood, prior)) = self.probability(&solid, own) else { return };
        let log = replica.power * (likelihood - replica.likelihood) + prior - replica.prior + odds;
        if self.accepts(log) {
            let felt = felt.unwrap_or_else(|| std::mem::take(&mut replica.felt));
            *replica = Replica { power: replica.power, solid, felt, likelihood, prior };
        }
    }

    /// Log probabilities of the contacts, and before them.
    fn probability(&self, solid: &Notched, felt: &[Felt]) -> Option<(f64, f64)> {
        let inside = self.free.iter().filter(|point| solid.contains(point)).count();
        let likelihood = solid.likelihood(felt)? - FREE * inside as f64;
        let mut prior = 0.0;
        for axis in 0..solid.dimension {
            let size = solid.size(axis);
            let [low, high] = solid.outer[axis];
            let usual = (size / (2.0 * self.radius)).ln() / SIZES;
            let off = (0.5 * (low + high) - self.middle[axis]) / self.radius;
            prior -= 0.5 * (usual * usual + off * off) + size.ln();
        }
        let inner = solid.sides().into_iter().filter(|side| side.notch.is_some());
        prior -= inner.map(|side| solid.size(side.axis).ln()).sum::<f64>();
        Some((likelihood, prior))
    }

    /// One side a little farther in or out.
    fn shifted(&mut self, solid: &Notched) -> (Notched, f64) {
        let sides = solid.sides();
        let side = sides[self.pick(sides.len())];
        let step =
            [FINE * self.deviation, 4.0 * self.deviation, COARSE * self.radius][self.pick(3)];
        (solid.moved(side, solid.at(side) + step * self.random.normal_pair()[0]), 0.0)
    }

    /// One side where a contact is, or anywhere.
    fn placed(&mut self, replica: &Replica) -> (Notched, f64) {
        let sides = replica.solid.sides();
        let side = sides[self.pick(sides.len())];
        let places = Places::of(self, replica, side);
        let to = places.drawn(self);
        let odds = places.density(replica.solid.at(side)).ln() - places.density(to).ln();
        (replica.solid.moved(side, to), odds)
    }

    fn turned(&mut self, solid: &Notched) -> Notched {
        let mut turn = self.random.normal3() * TURN;
        if solid.dimension == 2 {
            (turn.x, turn.y) = (0.0, 0.0);
        }
        Notched { frame: Rotation3::new(turn) * solid.frame, ..solid.clone() }
    }

    /// One notch more.
    fn born(&mut self, replica: &Replica) -> (Notched, f64) {
        let mut solid = replica.solid.clone();
        let number = solid.notches.len();
        if number == MOST {
            return (solid, f64::NEG_INFINITY);
        }
        solid.notches.push(Notch { spans: self.kind(solid.dimension) });
        let odds = RATE.ln() - (number as f64 + 1.0).ln();
        for side in solid.sides().into_iter().filter(|side| side.notch == Some(number)) {
            let to = Places::of(self, replica, side).drawn(self);
            solid = solid.moved(side, to);
        }
        let drawn = self.drawn(replica, &solid, number);
        (solid, odds - drawn)
    }

    /// One notch less.
    fn died(&mut self, replica: &Replica) -> (Notched, f64) {
        let count = replica.solid.notches.len();
        if count == 0 {
            return (replica.solid.clone(), f64::NEG_INFINITY);
        }
        let mut solid = replica.solid.clone();
        let notch = self.pick(count);
        let drawn = self.drawn(replica, &solid, notch);
        solid.notches.remove(notch);
        (solid, (count as f64).ln() - RATE.ln() + drawn)
    }

    /// Log density with which a notch's sides are drawn.
    fn drawn(&self, replica: &Replica, solid: &Notched, notch: usize) -> f64 {
        let own = solid.sides().into_iter().filter(|side| side.notch == Some(notch));
        own.map(|side| Places::of(self, replica, side).density(solid.at(side)).ln()).sum()
    }

    /// Where a notch has sides (at zero), and where it is open.
    fn kind(&mut self, dimension: usize) -> [Span; 3] {
        const OPEN: Span = [f64::NEG_INFINITY, f64::INFINITY];
        let mut spans = [OPEN; 3];
        let through = if dimension == 3 && self.random.unit() < SOLID {
            3
        } else if dimension == 3 {
            self.pick(3)
        } else {
            2
        };
        for axis in (0..dimension).filter(|axis| *axis != through) {
            spans[axis][self.pick(2)] = 0.0;
        }
        if through < 3 && self.random.unit() < POCKET {
            let axes: Vec<usize> = (0..dimension).filter(|axis| *axis != through).collect();
            spans[axes[self.pick(axes.len())]] = [0.0; 2];
        }
        spans
    }
}

/// Where a side may be: where contacts with its normal are, and anywhere about them.
struct Places {
    felt: Vec<f64>,
    deviation: f64,
    window: Span,
}

impl Places {
    fn of(chains: &Chains<'_>, replica: &Replica, side: Side) -> Places {
        let own = |felt: &&Felt| side.sign() * felt.normal[side.axis] > SQUARE;
        let felt = replica.felt.iter().filter(own).map(|felt| felt.point[side.axis]).collect();
        let [low, high] = [-3.0, 3.0].map(|by| chains.middle[side.axis] + by * chains.radius);
        Places { felt, deviation: chains.deviation, window: [low, high] }
    }

    fn drawn(&self, chains: &mut Chains<'_>) -> f64 {
        if self.felt.is_empty() || chains.random.unit() < 0.5 {
            let [low, high] = self.window;
            return low + (high - low) * chains.random.unit();
        }
        self.felt[chains.pick(self.felt.len())] + self.deviation * chains.random.normal_pair()[0]
    }

    fn density(&self, at: f64) -> f64 {
        let [low, high] = self.window;
        let anywhere = if (low..high).contains(&at) { 1.0 / (high - low) } else { 0.0 };
        if self.felt.is_empty() {
            return anywhere;
        }
        let near = |felt: &f64| (-0.5 * ((at - felt) / self.deviation).powi(2)).exp();
        let scale = self.deviation * std::f64::consts::TAU.sqrt() * self.felt.len() as f64;
        0.5 * anywhere + 0.5 * self.felt.iter().map(near).sum::<f64>() / scale
    }
}
