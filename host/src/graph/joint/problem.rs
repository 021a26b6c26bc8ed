//! What was measured, and what is to be found.

use crate::log::GraspLog;
use crate::model::faces::Owner;
use crate::reference::Contact;
use crate::slam::{deviations, track, usual_deviations};
use crate::space::{Point, Pose, centroid};

use super::factors::Kernel;
use super::relation::Relation;
use super::tangent::Face;

/// Deviations of a motion that nobody measured (metres, radians): weak, but it keeps a grasp that sees
/// few faces from drifting off.
const UNKNOWN: [f64; 2] = [0.1, 1.0];

/// Least range of a face's offset, metres, where no two contacts of a grasp are so many deviations apart.
const LEAST_EXTENT: f64 = 0.02;
const APART: f64 = 20.0;

/// A contact is astray that is so many times as far from the other contacts of its grasp as is usual: a thumb
/// is up to three times.
const ASTRAY: f64 = 5.0;

/// What a face costs before it has explained anything, −ln of how readily a new one is believed.
const NEW: f64 = 1.5;

/// Nats by which a wild contact is rarer than a face that one contact feels: a single one is reason for a
/// flat end.
const RARE: f64 = 5.0;

/// A contact in the world frame, and who felt it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Felt {
    /// Position of the grasp in the log.
    pub grasp: usize,
    /// World frame.
    pub contact: Contact,
    /// Whether it lies so far from the others of its grasp that it says nothing of how large the object is.
    pub astray: bool,
}

impl Felt {
    /// A contact like any other.
    pub fn new(grasp: usize, contact: Contact) -> Felt {
        Felt { grasp, contact, astray: false }
    }
}

/// How the object was moved before a grasp, world to world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Predicted pose = motion ∘ previous pose.
    pub pose: Pose,
    /// Of translation (metres) and rotation (radians), per object axis.
    pub deviations: [f64; 2],
    /// Whether somebody measured it; else it only says that objects mostly stay near.
    pub measured: bool,
}

/// Everything measured.
#[derive(Clone, Debug)]
pub struct Problem {
    /// 2 or 3.
    pub dimension: usize,
    /// All usable contacts, by grasp.
    pub felt: Vec<Felt>,
    /// Where in [`Problem::felt`] each grasp begins, and the end.
    pub starts: Vec<usize>,
    /// Fingertips that touched nothing, as contacts without normals.
    pub free: Vec<Felt>,
    /// Before each grasp; the first is not used.
    pub motions: Vec<Motion>,
    /// The range in which a face's offset may lie, metres.
    pub extent: f64,
    /// How far a contact's place on the surface is a draw of its own.
    pub weight: f64,
    /// Whether fingers are round and feel edges: then contacts may lie there ([`super::ridge`]).
    pub edges: bool,
    /// Robustness of contacts.
    pub kernel: Kernel,
}

/// Which face, edge or corner each contact lies on; `None` where none explains it.
pub type Labels = Vec<Option<Owner>>;

/// What is to be found.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Object to world, one per grasp. The first stays as it is: it defines the object frame.
    pub poses: Vec<Pose>,
    /// Object frame.
    pub faces: Vec<Face>,
    /// Which of them are parallel or square.
    pub relations: Vec<Relation>,
}

impl State {
    /// Makes the object frame the one in which the first pose (object to world) is `first`, and leaves the
    /// grasps and faces where they are to each other. Without poses there is nothing to do.
    pub fn begin_at(&mut self, first: &Pose) {
        let Some(now) = self.poses.first().filter(|now| *now != first) else { return };
        let frame = now.inverse() * first;
        for (k, pose) in self.poses.iter_mut().enumerate() {
            // The first exactly: the product rounds.
            *pose = if k == 0 { *first } else { *pose * frame };
        }
        let back = frame.inverse();
        for face in &mut self.faces {
            face.normal = back.rotation * face.normal;
            face.offset += face.normal.dot(&back.translation.vector);
        }
    }
}

impl Problem {
    /// The measurements of a log. Contacts with numbers that are not finite are left out, a motion
    /// with such numbers counts as unknown.
    pub fn new(log: &GraspLog) -> Problem {
        let noise = track::settings(log, 0).motion;
        let usual = [f64::from(noise.translation), f64::from(noise.rotation)];
        let unknown = [0, 1].map(|i| usual[i].max(UNKNOWN[i]));
        let (point_deviation, normal_deviation) = usual_deviations(&log.noise);
        let (mut felt, mut free, mut starts) = (Vec::new(), Vec::new(), vec![0]);
        for (grasp, logged) in log.grasps.iter().enumerate() {
            for point in logged.free.iter().map(|f| f.point) {
                let contact = Contact { point, normal: None, point_deviation, normal_deviation };
                free.extend(contact.checked().map(|contact| Felt::new(grasp, contact)));
            }
            for c in &logged.contacts {
                let (point_deviation, normal_deviation) = deviations(c, &log.noise);
                let contact =
                    Contact { point: c.point, normal: c.normal, point_deviation, normal_deviation };
                felt.extend(contact.checked().map(|contact| Felt::new(grasp, contact)));
            }
            starts.push(felt.len());
        }
        let motion = |logged: Option<Pose>| match logged {
            Some(pose) if finite(&pose) => Motion { pose, deviations: usual, measured: true },
            // At least as uncertain as one that was measured.
            _ => Motion { pose: Pose::identity(), deviations: unknown, measured: false },
        };
        let motions = log.grasps.iter().map(|g| motion(g.motion)).collect();
        Problem::of_all(log.dimension, felt, starts, free, motions)
    }

    /// Contacts in the object frame whose places are known, as if one grasp had felt them all. Those with numbers that
    /// are not usable are left out.
    pub fn held(dimension: usize, contacts: &[Contact]) -> Problem {
        let usable = contacts.iter().filter_map(Contact::checked);
        let felt: Vec<Felt> = usable.map(|contact| Felt::new(0, contact)).collect();
        let starts = vec![0, felt.len()];
        let still = Motion { pose: Pose::identity(), deviations: UNKNOWN, measured: false };
        Problem::of_all(dimension, felt, starts, vec![], vec![still])
    }

    fn of_all(
        dimension: usize,
        felt: Vec<Felt>,
        starts: Vec<usize>,
        free: Vec<Felt>,
        motions: Vec<Motion>,
    ) -> Problem {
        let mut problem = Problem {
            dimension,
            felt,
            starts,
            free,
            motions,
            extent: LEAST_EXTENT,
            weight: 1.0,
            edges: false,
            kernel: Kernel::USUAL,
        };
        let astray = problem.astray();
        for (felt, astray) in problem.felt.iter_mut().zip(astray) {
            felt.astray = astray;
        }
        let exact = problem.felt.iter().map(|f| f.contact.point_deviation);
        let reach = problem.reach();
        let says_size = reach > APART * exact.fold(f64::INFINITY, f64::min);
        problem.extent = if says_size { reach } else { reach.max(LEAST_EXTENT) };
        problem
    }

    /// Which contacts are far from more than half of the others of their grasp.
    fn astray(&self) -> Vec<bool> {
        let point = |i: usize| self.felt[i].contact.point;
        let distance = |i: usize| {
            let others = self.of(self.felt[i].grasp).filter(|j| *j != i);
            median(others.map(|j| (point(i) - point(j)).norm()).collect())
        };
        let distances: Vec<Option<f64>> = (0..self.felt.len()).map(distance).collect();
        // One alone in its grasp says nothing of what is usual.
        let usual = median(distances.iter().flatten().copied().collect()).unwrap_or(0.0);
        let is_far = |distance: Option<f64>| distance.is_some_and(|d| d > ASTRAY * usual);
        distances.into_iter().map(is_far).collect()
    }

    /// The same measurements with the last grasp first.
    pub fn reversed(&self) -> Problem {
        let (mut felt, mut starts) = (Vec::with_capacity(self.felt.len()), vec![0]);
        for (grasp, own) in (0..self.grasps()).rev().map(|k| self.of(k)).enumerate() {
            felt.extend(self.felt[own].iter().map(|f| Felt { grasp, ..*f }));
            starts.push(felt.len());
        }
        // Before the first grasp of all there is no motion, nor is there one after the last.
        let mut motions: Vec<Motion> = self.motions.iter().rev().copied().collect();
        for motion in &mut motions {
            motion.pose = motion.pose.inverse();
        }
        motions.rotate_right(1);
        let last = self.grasps().saturating_sub(1);
        let free = self.free.iter().map(|f| Felt { grasp: last - f.grasp, ..*f }).collect();
        Problem { felt, starts, free, motions, ..self.clone() }
    }

    /// How many grasps.
    pub fn grasps(&self) -> usize {
        self.motions.len()
    }

    /// The contacts of a grasp, by their number.
    pub fn of(&self, grasp: usize) -> std::ops::Range<usize> {
        self.starts[grasp]..self.starts[grasp + 1]
    }

    /// How many contacts belong to the grasps of a state, which may be the first few only.
    pub fn until(&self, state: &State) -> usize {
        self.starts[state.poses.len().min(self.grasps())]
    }

    /// The longest distance between two contacts of one grasp that are not astray, whatever the poses.
    fn reach(&self) -> f64 {
        let widest = |grasp: usize| {
            let own = || self.felt[self.of(grasp)].iter().filter(|felt| !felt.astray);
            let from = |a: &Felt| {
                own().map(|b| (a.contact.point - b.contact.point).norm()).fold(0.0, f64::max)
            };
            own().map(from).fold(0.0, f64::max)
        };
        (0..self.grasps()).map(widest).fold(0.0, f64::max)
    }

    /// Poses to start from: as given where they are usable, else predicted.
    pub fn poses(&self, given: &[Option<Pose>]) -> Vec<Pose> {
        let mut poses: Vec<Pose> = Vec::with_capacity(self.grasps());
        for (k, motion) in self.motions.iter().enumerate() {
            let known = given.get(k).copied().flatten().filter(finite);
            let predicted = match poses.last() {
                Some(last) => motion.pose * last,
                None => Pose::from_parts(self.centre(0).into(), Default::default()),
            };
            poses.push(known.unwrap_or(predicted));
        }
        poses
    }

    /// Centroid of a grasp's contacts, world frame; the origin without any.
    pub fn centre(&self, grasp: usize) -> Point {
        let own = &self.felt[self.of(grasp)];
        centroid(own.iter().map(|f| f.contact.point))
    }

    /// The middle of the contacts that are not astray in the object frame: what slips turn about.
    pub fn middle(&self, poses: &[Pose]) -> Point {
        let count = self.starts[poses.len().min(self.grasps())];
        let near = (0..count).filter(|i| !self.felt[*i].astray);
        centroid(near.map(|i| self.placed(poses, i).point))
    }

    /// Whether most contacts of a grasp lie where they can be of the object.
    pub fn is_found(&self, grasp: usize, is_explained: impl Fn(usize) -> bool) -> bool {
        let count = self.of(grasp).len();
        2 * self.of(grasp).filter(|i| is_explained(*i)).count() > count
    }

    /// A contact in the object frame.
    pub fn placed(&self, poses: &[Pose], contact: usize) -> Contact {
        let felt = &self.felt[contact];
        felt.contact.transformed(&poses[felt.grasp].inverse())
    }

    /// −ln of the density of a face's direction and offset before anything was felt.
    pub fn vague(&self) -> f64 {
        let directions = if self.dimension == 2 { 2.0 } else { 4.0 } * std::f64::consts::PI;
        (directions * self.extent).ln() + NEW
    }

    /// What a contact costs that no face explains: a face of its own, which it determines exactly.
    pub fn unexplained(&self, contact: &Contact) -> f64 {
        if contact.normal.is_some() { self.vague() } else { self.extent.ln() + NEW }
    }

    /// What a contact costs, nats, that is of the object, which alone costs `on` ([`Problem::exact`] among
    /// it), or wild; and the chance that it is of the object.
    pub fn or_wild(&self, contact: &Contact, on: f64) -> (f64, f64) {
        either(on, RARE + self.unexplained(contact))
    }

    /// How many numbers a contact measures: with a normal as many as a face has, else how far it is off alone.
    pub fn numbers(&self, contact: &Contact) -> usize {
        if contact.normal.is_some() { self.dimension } else { 1 }
    }

    /// How many numbers the first so many contacts measure; at least two.
    pub fn measured(&self, contacts: usize) -> usize {
        let felt = &self.felt[..contacts];
        felt.iter().map(|felt| self.numbers(&felt.contact)).sum::<usize>().max(2)
    }

    /// −ln of the density of a contact that fits its face exactly.
    pub fn exact(&self, contact: &Contact) -> f64 {
        let root = std::f64::consts::TAU.sqrt();
        let turns = if contact.normal.is_some() { self.dimension as i32 - 1 } else { 0 };
        (root * contact.point_deviation).ln()
            + f64::from(turns) * (root * contact.normal_deviation).ln()
    }

    /// What a contact (object frame) costs on a face, robustly; see [`Problem::exact`].
    pub fn on(&self, face: &Face, contact: &Contact) -> f64 {
        self.on_within(face, contact, 1.0)
    }

    /// The same where all deviations are larger by `slack`.
    pub fn on_within(&self, face: &Face, contact: &Contact, slack: f64) -> f64 {
        let square = |x: f64| x * x;
        let off = square(face.value(&contact.point) / (slack * contact.point_deviation));
        let turned = contact.normal.map_or(0.0, |m| {
            (m - face.normal).norm_squared() / square(slack * contact.normal_deviation)
        });
        self.kernel.cost(off).0 + self.kernel.cost(turned).0 + self.exact(contact)
    }
}

/// Of several numbers the middle one, or the lesser of two.
fn median(mut all: Vec<f64>) -> Option<f64> {
    let middle = all.len().saturating_sub(1) / 2;
    (!all.is_empty()).then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1)
}

fn finite(pose: &Pose) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
}

/// What costs either this or that, nats, and the chance of the first.
pub(super) fn either(first: f64, second: f64) -> (f64, f64) {
    let least = if first < second { first } else { second };
    (least - (-(first - second).abs()).exp().ln_1p(), 1.0 / (1.0 + (first - second).exp()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::Deviation;
    use crate::sim::{Options, Touch, simulate};

    #[test]
    fn a_contact_costs_what_the_likelier_of_two_things_costs() {
        let log = simulate(&Options::new("box:0.1x0.06x0.05".parse().unwrap())).unwrap().log;
        let problem = Problem::new(&log);
        let contact = problem.felt[0].contact;
        let [exact, wild] = [problem.exact(&contact), RARE + problem.unexplained(&contact)];
        assert!(wild > exact + 5.0);
        let mut before = (f64::NEG_INFINITY, 1.0);
        for more in 0..400 {
            let on = exact + 0.1 * f64::from(more);
            let (cost, chance) = problem.or_wild(&contact, on);
            assert!(cost > before.0 && chance < before.1);
            assert!(cost <= on.min(wild) && cost >= on.min(wild) - 2.0f64.ln());
            before = (cost, chance);
        }
        let (cost, chance) = problem.or_wild(&contact, f64::INFINITY);
        assert!(cost == wild && chance == 0.0);
        assert!(problem.or_wild(&contact, f64::NAN).0.is_nan());
    }

    #[test]
    fn the_extent_is_that_of_contacts_which_are_not_astray() {
        for object in ["lshape:0.09x0.09x0.03", "box:0.2x0.02x0.02", "sphere:0.08", "random:3,4"] {
            for touch in [Touch::Hand, Touch::Uniform] {
                let options = Options { touch, ..Options::new(object.parse().unwrap()) };
                let mut log = simulate(&options).unwrap().log;
                let clean = Problem::new(&log);
                assert!(clean.felt.iter().all(|felt| !felt.astray), "{object}");
                // A metre away from all others, and all of them as if one grasp had felt them.
                let grasp = log.grasps.iter().position(|g| g.contacts.len() > 2).unwrap();
                log.grasps[grasp].contacts[1].point.x += 1.0;
                let far = Problem::new(&log);
                let astray = clean.starts[grasp] + 1;
                let found: Vec<usize> =
                    (0..far.felt.len()).filter(|i| far.felt[*i].astray).collect();
                assert!(found == [astray] && far.extent <= clean.extent, "{object} {found:?}");
                assert!(far.extent > 0.5 * clean.extent, "{} {}", far.extent, clean.extent);
                let held = |problem: &Problem| {
                    let all: Vec<Contact> = problem.felt.iter().map(|f| f.contact).collect();
                    Problem::held(log.dimension, &all).extent
                };
                assert!(held(&far) < 1.1 * held(&clean), "{} {}", held(&far), held(&clean));
            }
        }
    }

    #[test]
    fn small_objects_are_as_large_as_exact_contacts_say() {
        let extent = |length: f64| {
            let object = "box:0.005x0.005x0.005".parse().unwrap();
            let options = Options { touch: Touch::Uniform, ..Options::new(object) };
            let contact_noise = Deviation { length, angle: 0.09 };
            Problem::new(&simulate(&Options { contact_noise, ..options }).unwrap().log).extent
        };
        assert!((0.004..0.009).contains(&extent(1e-4)), "{}", extent(1e-4));
        assert_eq!(extent(1e-3), LEAST_EXTENT);
    }

    #[test]
    fn a_motion_that_nobody_measured_is_no_surer_than_others() {
        let mut log = simulate(&Options::new("box:0.1x0.06x0.05".parse().unwrap())).unwrap().log;
        log.grasps[3].motion = None;
        for (noise, expected) in [([0.3, 0.1], [0.3, 1.0]), ([0.01, 1.5], [0.1, 1.5])] {
            let [translation, rotation] = noise.map(Some);
            (log.noise.translation, log.noise.rotation) = (translation, rotation);
            let unknown = Problem::new(&log).motions[3].deviations;
            let near = |(a, b): (f64, f64)| (a - b).abs() < 1e-6;
            assert!(unknown.into_iter().zip(expected).all(near), "{unknown:?}");
        }
    }
}
