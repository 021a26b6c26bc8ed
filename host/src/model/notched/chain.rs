//! Boxes less smaller boxes in proportion to how probable contacts make them: a Markov chain between boxes with
//! different numbers of notches (reversible jumps; Green, Biometrika 82, 1995), at several temperatures that exchange
//! what they find (Geyer, Computing Science and Statistics, 1991).

use super::folded::Folded;
use super::wild::median;
use super::{Felt, Notched, Wild};
use crate::reference::Contact;
use crate::sim::random::Random;
use crate::space::Point;
use crate::thin::evenly;

/// Powers of the likelihood: as many, each as much lower than the last.
const REPLICAS: usize = 8;
const COOLER: f64 = 0.6;

/// Rounds of the chains, steps of each in a round, the first rounds that do not count, and of how many others one does.
const ROUNDS: usize = 6000;
const STEPS: usize = 20;
const SETTLING: usize = 1500;
const KEPT: usize = 15;

/// What the random numbers begin with: the same contacts make the same boxes.
const SEED: u64 = 1;

/// Nats by which points that touched nothing are less probable inside.
const FREE: f64 = 4.0;

/// Those that are asked at most, for each step that contacts allow asks them all; and how far from the box
/// about the contacts, in parts of its length, for hardly a box that contacts make probable reaches farther.
const ASKED: usize = 300;
const ABOUT: f64 = 0.25;

/// Deviation of the outer box's lengths before any contact, as a logarithm, from the diameter of the contacts.
const SIZES: f64 = 0.6;

/// Odds before any contact that there is a mirror in the middle of an axis. With even ones a T is known better, and an F
/// taken for an E.
pub(super) const MIRRORED: f64 = 0.2;

/// What every chain knows.
pub(super) struct Chains<'a> {
    contacts: &'a [Contact],
    /// At most [`ASKED`] of those about the contacts.
    free: Vec<Point>,
    wild: Wild,
    /// Half the mean diagonal of the contacts' box, its middle (in the first frame), and their usual deviation.
    pub(super) radius: f64,
    pub(super) middle: Point,
    pub(super) deviation: f64,
    pub(super) random: Random,
}

/// One chain.
pub(super) struct Replica {
    power: f64,
    pub(super) solid: Folded,
    pub(super) felt: Vec<Felt>,
    likelihood: f64,
    prior: f64,
}

impl<'a> Chains<'a> {
    pub(super) fn of(
        contacts: &'a [Contact],
        free: &[Point],
        wild: Wild,
        start: &Notched,
    ) -> Chains<'a> {
        let [random] = Random::streams(SEED);
        let sides = (0..start.dimension).map(|axis| start.size(axis));
        let radius = 0.5 * sides.map(|side| side * side).sum::<f64>().sqrt()
            / (start.dimension as f64).sqrt();
        let middle = Point::from_fn(|axis, _| 0.5 * (start.outer[axis][0] + start.outer[axis][1]));
        let deviation = median(contacts.iter().map(|c| c.point_deviation).collect());
        let is_about = |point: &&Point| {
            let seen = start.seen(point);
            (0..start.dimension).all(|axis| {
                let ([low, high], reach) = (start.outer[axis], ABOUT * start.size(axis));
                (low - reach..high + reach).contains(&seen[axis])
            })
        };
        let about: Vec<Point> = free.iter().filter(is_about).copied().collect();
        let free = evenly(&about, ASKED);
        Chains { contacts, free, wild, radius, middle, deviation, random }
    }

    /// What the chain at the contacts' own likelihood comes by.
    pub(super) fn samples(&mut self, start: &Notched) -> Vec<Notched> {
        let powers = (0..REPLICAS).map(|replica| COOLER.powi(replica as i32));
        let replicas: Option<Vec<Replica>> =
            powers.map(|power| self.replica(start, power)).collect();
        let Some(mut replicas) = replicas else { return vec![] };
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
                kept.push(replicas[0].solid.whole());
            }
        }
        kept
    }

    /// A chain at a power of the likelihood; `None` where its start is not what it says.
    pub(super) fn replica(&self, start: &Notched, power: f64) -> Option<Replica> {
        let (solid, felt) = (Folded::of(start), start.felt(self.contacts));
        let likelihood = self.likelihood(&solid, &felt, f64::NEG_INFINITY)?;
        let prior = self.prior(&solid);
        Some(Replica { power, solid, felt, likelihood, prior })
    }

    fn accepts(&mut self, log: f64) -> bool {
        log > self.random.unit().ln()
    }

    pub(super) fn step(&mut self, replica: &mut Replica) {
        let Some((solid, odds)) = self.proposed(replica) else { return };
        let felt =
            (solid.part.frame != replica.solid.part.frame).then(|| solid.part.felt(self.contacts));
        let prior = self.prior(&solid);
        // As likely as it must be to be accepted: most are not, and are known not to be after a few contacts.
        let asked = self.random.unit().ln() + replica.prior - prior - odds;
        let least = replica.likelihood + asked / replica.power;
        let own = felt.as_ref().unwrap_or(&replica.felt);
        let Some(likelihood) = self.likelihood(&solid, own, least) else { return };
        let felt = felt.unwrap_or_else(|| std::mem::take(&mut replica.felt));
        *replica = Replica { power: replica.power, solid, felt, likelihood, prior };
    }

    /// Log probability of the contacts, and of the points that touched nothing; `None` below `least`, or where there is
    /// no such box.
    fn likelihood(&self, solid: &Folded, felt: &[Felt], least: f64) -> Option<f64> {
        // Contacts first: after a few of them most boxes are known not to be likely enough.
        let likelihood = solid.likelihood(felt, &self.wild, least)?;
        let inside = self.free.iter().filter(|point| solid.contains(point)).count();
        let likelihood = likelihood - FREE * inside as f64;
        (likelihood >= least).then_some(likelihood)
    }

    /// Log probability before any contact.
    fn prior(&self, solid: &Folded) -> f64 {
        let mut prior = solid.mirrors().count() as f64 * MIRRORED.ln();
        for axis in 0..solid.part.dimension {
            let [low, high] = solid.span(axis);
            let size = high - low;
            let usual = (size / (2.0 * self.radius)).ln() / SIZES;
            let off = (0.5 * (low + high) - self.middle[axis]) / self.radius;
            prior -= 0.5 * (usual * usual + off * off) + size.ln();
        }
        let inner = solid.part.sides().into_iter().filter(|side| side.notch.is_some());
        prior - inner.map(|side| solid.part.size(side.axis).ln()).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::super::RARE;
    use super::*;

    #[test]
    fn of_many_free_points_few_about_the_contacts_are_asked() {
        let start = Notched {
            dimension: 2,
            frame: nalgebra::Rotation3::identity(),
            middle: Point::zeros(),
            outer: [[0.0, 0.1], [0.0, 0.08], [0.0, 0.06]],
            notches: vec![],
        };
        let row = |y: f64| (0..10_000).map(move |i| Point::new(1e-5 * f64::from(i), y, 0.0));
        let [inside, beside, away] = [0.04, 0.09, 0.11].map(row);
        let free: Vec<Point> = inside.chain(beside).chain(away).collect();
        let chains = Chains::of(&[], &free, RARE, &start);
        assert_eq!(chains.free.len(), ASKED);
        assert!(chains.free.iter().all(|point| point.y < 0.1));
        // Few are all asked, and as many nats are what they cost inside.
        let [open, closed] = [&free[..0], &free[..7]].map(|free| {
            let chains = Chains::of(&[], free, RARE, &start);
            chains.likelihood(&Folded::of(&start), &[], f64::NEG_INFINITY).unwrap()
        });
        // The first lies on a side.
        assert!((open - closed - 6.0 * FREE).abs() < 1e-9, "{open} {closed}");
        let chains = Chains::of(&[], &free[..7], RARE, &start);
        assert!(chains.likelihood(&Folded::of(&start), &[], closed + 1.0).is_none());
    }
}
