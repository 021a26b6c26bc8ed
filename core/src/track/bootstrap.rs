//! The bootstrap particle filter over the pose with one shared map: Algorithm 3.1 of the thesis, as
//! corrected (weights multiply, the likelihood has a scale, means are taken on the manifold).

use crate::contact::{Contact, GraspView};
use crate::matrix::{Coordinates, Square};
use crate::random::Random;
use crate::space::{Pose, Space};
use crate::surface::{Insertion, Map};
use crate::track::likelihood::{is_strange, log_free, log_likelihood};
use crate::track::particles::Particles;
use crate::track::{Estimate, MotionNoise, Observability, Separation, Status, Tracker};

/// The thesis' condition on a pose (3.5.1): enough contacts of the grasp must lie close to contacts
/// already in the map, or its likelihood is zero. Of a grasp with fewer contacts, all must.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// How many contacts.
    pub contacts: u16,
    /// How close, metres.
    pub distance: f32,
}

impl Gate {
    /// Four contacts within 10 mm.
    pub const THESIS: Self = Gate { contacts: 4, distance: 0.01 };
}

/// How far apart two answers are: two deviations of the thesis' motion noise, for a belief that slides
/// along a face is broad and yet one answer, to be learnt with all of its doubt.
const APART: Separation = Separation { translation: 0.02, rotation: 0.698_131_7 };

/// A second answer with this share of the belief makes it ambiguous.
const AMBIGUOUS: f32 = 0.25;

/// How a [`Bootstrap`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Motion noise of one grasp.
    pub motion: MotionNoise,
    /// The thesis' gate; `None` leaves it to the likelihood, which knows where the map is uncertain.
    pub gate: Option<Gate>,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Settings {
    /// The thesis' motion noise, no gate, seed 0.
    pub const DEFAULT: Self = Settings { motion: MotionNoise::THESIS, gate: None, seed: 0 };
}

/// A bootstrap filter of `PARTICLES` poses over the map `M`.
#[derive(Clone, Debug)]
pub struct Bootstrap<S: Space, M: Map<S>, const PARTICLES: usize> {
    map: M,
    particles: Particles<S, PARTICLES>,
    /// `None` until the first use, so that a new filter is all zero bits.
    running: Option<Running>,
    /// Grasps seen.
    grasps: u32,
    /// Grasps in a row that fitted nowhere.
    lost: u16,
    /// Whether a contact has fixed the object frame.
    started: bool,
}

#[derive(Clone, Debug)]
struct Running {
    motion: MotionNoise,
    /// No contacts: no gate. (Not an `Option`, whose unused tags would encode that nothing is
    /// running, and that encoding is not zero.)
    gate: Gate,
    random: Random,
}

impl Running {
    fn new(settings: Settings) -> Self {
        Running {
            motion: settings.motion,
            gate: settings.gate.unwrap_or(Gate { contacts: 0, distance: 0.0 }),
            random: Random::new(settings.seed),
        }
    }

    fn gate(&self) -> Option<Gate> {
        (self.gate.contacts > 0).then_some(self.gate)
    }
}

impl<S: Space, M: Map<S>, const PARTICLES: usize> Bootstrap<S, M, PARTICLES> {
    /// A filter over an empty `map`, with [`Settings::DEFAULT`].
    pub const fn new(map: M) -> Self {
        let particles = Particles::new();
        Bootstrap { map, particles, running: None, grasps: 0, lost: 0, started: false }
    }

    /// Starts anew with these settings.
    pub fn configure(&mut self, settings: Settings) {
        self.running = Some(Running::new(settings));
        self.map.clear();
        self.grasps = 0;
        self.lost = 0;
        self.started = false;
    }

    /// The shape so far.
    pub fn map(&self) -> &M {
        &self.map
    }

    /// The shape, to set its model; call [`configure`](Self::configure) afterwards.
    pub fn map_mut(&mut self) -> &mut M {
        &mut self.map
    }

    /// The belief over the pose.
    pub fn particles(&self) -> &Particles<S, PARTICLES> {
        &self.particles
    }

    /// Fixes the object frame at the centroid of the first contacts.
    fn start(&mut self, grasp: &GraspView<'_, S>) {
        let mut centroid = S::Vector::ZERO;
        let mut count = 0.0;
        for contact in good(grasp) {
            centroid += contact.point;
            count += 1.0;
        }
        if count > 0.0 {
            self.particles.place(S::Pose::from_translation(centroid * (1.0 / count)));
            self.started = true;
        }
    }

    /// Moves every particle as the hand meant to, and then some; more when the object was lost.
    fn predict(&mut self, motion: Option<&S::Pose>) {
        let running = self.running.get_or_insert_with(|| Running::new(Settings::DEFAULT));
        let noise = running.motion.after_losing(self.lost);
        let motion = motion.filter(|m| m.is_finite());
        for pose in self.particles.poses_mut() {
            let moved = motion.map_or(*pose, |m| m.compose(pose));
            *pose = noise.disturb::<S>(&moved, &mut running.random);
        }
    }

    /// Weighs the particles by the grasp, unless it fits at none of them.
    fn weigh(&mut self, grasp: &GraspView<'_, S>) -> Fit {
        let gate = self.running.as_ref().and_then(Running::gate);
        let map = &self.map;
        let best = self.particles.compare(|pose| {
            let (mut sum, mut close, mut all) = (0.0, 0, 0);
            for contact in good(grasp) {
                let probe = map.probe(pose.untransform(contact.point));
                sum += log_likelihood(&probe, contact.normal.map(|n| pose.unrotate(n)), &contact);
                all += 1;
                close += u16::from(gate.is_some_and(|g| probe.nearest <= g.distance));
            }
            let free = grasp.free.iter().map(|f| f.point).filter(|p| p.is_finite());
            for point in free {
                sum += log_free(&map.probe(pose.untransform(point)));
            }
            gate.is_none_or(|g| close >= g.contacts.min(all)).then_some(sum)
        });
        let likeliest = best.unwrap_or_else(|| self.particles.mean().0);
        match (self.contradicts(grasp, &likeliest), best) {
            (true, _) => Fit::Nowhere,
            (false, None) => Fit::Refused,
            (false, Some(_)) if self.particles.accept() => Fit::Somewhere,
            (false, Some(_)) => Fit::Refused,
        }
    }

    /// Whether most contacts are strange to the map at this pose.
    fn contradicts(&self, grasp: &GraspView<'_, S>, pose: &S::Pose) -> bool {
        let (mut strange, mut all) = (0, 0);
        for contact in good(grasp) {
            let probe = self.map.probe(pose.untransform(contact.point));
            let normal = contact.normal.map(|n| pose.unrotate(n));
            strange += usize::from(is_strange(&probe, normal, &contact));
            all += 1;
        }
        strange >= 2 && 2 * strange >= all
    }

    /// Resamples when fewer than half of the particles count.
    fn resample_if_poor(&mut self) -> bool {
        let poor = self.particles.effective() < 0.5 * PARTICLES as f32;
        if poor && let Some(running) = &mut self.running {
            self.particles.resample(&mut running.random);
        }
        poor
    }

    /// Adds the grasp to the map at the mean pose; the number of contacts let go.
    ///
    /// The doubt about the pose along each contact's normal goes into its noise, so that a grasp
    /// placed badly does not overrule one placed well. What is still strange with it is a wild contact
    /// and not learnt.
    fn learn(
        &mut self,
        grasp: &GraspView<'_, S>,
        pose: &S::Pose,
        covariance: &S::Covariance,
    ) -> u16 {
        // The map answers only for what it was fitted to, so every contact is judged before the first
        // is inserted. (One bit each; beyond 128 in a grasp all are learnt.)
        let mut wild = 0u128;
        if self.map.contacts() > 0 {
            for (contact, bit) in good(grasp).zip(0..u128::BITS) {
                let placed = place(&contact, pose, covariance);
                let probe = self.map.probe(placed.point);
                wild |= u128::from(is_strange(&probe, placed.normal, &placed)) << bit;
            }
        }
        let mut dropped = 0u16;
        for (number, contact) in good(grasp).enumerate() {
            if number < 128 && wild >> number & 1 == 1 {
                continue;
            }
            let placed = place(&contact, pose, covariance);
            dropped = dropped.saturating_add(match self.map.insert(&placed) {
                Insertion::Stored | Insertion::Merged => 0,
                Insertion::Replaced(others) => others,
                Insertion::Dropped => 1,
            });
        }
        self.map.refit();
        dropped
    }
}

/// Where a grasp fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fit {
    /// At some particles.
    Somewhere,
    /// At none that the gate lets pass, though the map does not contradict it: it was felt where
    /// nothing had been touched.
    Refused,
    /// At none: most of it contradicts the map even where it fits best.
    Nowhere,
}

/// The contacts of a grasp that can be used, with unit normals.
fn good<'a, S: Space>(grasp: &GraspView<'a, S>) -> impl Iterator<Item = Contact<S>> + Clone + 'a {
    grasp.contacts.iter().filter_map(|c| c.checked().ok())
}

/// The contact in the object frame at an uncertain pose.
fn place<S: Space>(contact: &Contact<S>, pose: &S::Pose, covariance: &S::Covariance) -> Contact<S> {
    let point = pose.untransform(contact.point);
    let normal = contact.normal.map(|n| pose.unrotate(n));
    let mut placed = Contact { point, normal, ..*contact };
    if let Some(normal) = normal {
        let h = S::lever(point, normal);
        let (mut along, mut turn) = (0.0, 0.0);
        for i in 0..S::FREEDOM {
            for j in 0..S::FREEDOM {
                along += h[i] * covariance.at(i, j) * h[j];
            }
            if i >= S::DIMENSION {
                turn += covariance.at(i, i);
            }
        }
        let turn = turn / (S::FREEDOM - S::DIMENSION) as f32;
        let add = |deviation: f32, more: f32| {
            crate::math::sqrt(deviation * deviation + if more > 0.0 { more } else { 0.0 })
        };
        placed.point_deviation = add(contact.point_deviation, along);
        placed.normal_deviation = add(contact.normal_deviation, turn);
    }
    placed
}

impl<S: Space, M: Map<S>, const PARTICLES: usize> Tracker<S> for Bootstrap<S, M, PARTICLES> {
    fn update(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S> {
        let contacts = good(&grasp).count();
        let mut resampled = false;
        let mut status = Status::Started;
        if !self.started {
            self.particles.place(S::Pose::IDENTITY);
            self.start(&grasp);
        } else {
            self.predict(motion);
            status = match if contacts > 0 { self.weigh(&grasp) } else { Fit::Refused } {
                Fit::Somewhere => Status::Tracking,
                Fit::Refused => Status::Predicted,
                Fit::Nowhere => Status::Lost,
            };
            let lost = self.lost.saturating_add(u16::from(status == Status::Lost));
            self.lost = if status == Status::Tracking { 0 } else { lost };
        }
        let modes = self.particles.modes(&APART);
        let (mut pose, mut covariance) = self.particles.mean();
        if status == Status::Tracking
            && modes.disagree(AMBIGUOUS)
            && let Some(heaviest) = modes.as_slice().first()
        {
            status = Status::Ambiguous;
            (pose, covariance) = self.particles.mean_near(heaviest.pose, &APART);
        }
        let corrected = matches!(status, Status::Tracking | Status::Ambiguous);
        let effective_particles = self.particles.effective();
        if corrected {
            resampled = self.resample_if_poor();
        }
        let mut dropped = 0;
        if status != Status::Lost {
            dropped = self.learn(&grasp, &pose, &covariance);
        }
        let felt = good(&grasp)
            .filter_map(|c| Some((pose.untransform(c.point), pose.unrotate(c.normal?))));
        let estimate = Estimate {
            grasp: self.grasps,
            pose,
            covariance,
            status,
            modes,
            effective_particles,
            observability: Observability::of(felt),
            contacts: contacts.min(usize::from(u16::MAX)) as u16,
            rejected: (grasp.contacts.len() - contacts).min(usize::from(u16::MAX)) as u16,
            dropped,
            corrected,
            resampled,
        };
        self.grasps = self.grasps.saturating_add(1);
        estimate
    }

    fn reset(&mut self, seed: u64) {
        let settings = self.running.as_ref().map_or(Settings::DEFAULT, |r| Settings {
            motion: r.motion,
            gate: r.gate(),
            seed,
        });
        self.configure(Settings { seed, ..settings });
    }

    fn set_motion_noise(&mut self, noise: MotionNoise) {
        let running = self.running.get_or_insert_with(|| Running::new(Settings::DEFAULT));
        running.motion = noise;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::FreePoint;
    use crate::matrix::Vector;
    use crate::space::{Planar, PlanarPose};
    use crate::surface::cholesky::packed;
    use crate::surface::{Ball, Gpis, Matern32, Prior, Training};
    use std::boxed::Box;
    use std::vec::Vec;

    type Shape = Gpis<Planar, Matern32, Ball<Planar>, 40, 120, { packed(120) }>;
    type Filter = Bootstrap<Planar, Shape, 2000>;

    fn filter(settings: Settings) -> Box<Filter> {
        let mut filter = Box::new(Filter::new(Shape::new()));
        filter.map_mut().configure(
            Matern32 { amplitude: 0.03, lengthscale: 0.1 },
            Ball::UNSET,
            Training::Normals,
        );
        filter.configure(settings);
        filter
    }

    /// Contacts on a 100 × 60 mm rectangle at `pose`, two on every face, at parameters from `shift`.
    fn touch(pose: &PlanarPose, shift: f32) -> Vec<Contact<Planar>> {
        [(0.05, [1.0, 0.0]), (0.03, [0.0, 1.0]), (0.05, [-1.0, 0.0]), (0.03, [0.0, -1.0])]
            .into_iter()
            .flat_map(|(half, n)| {
                let n = Vector(n);
                let along = Vector([-n[1], n[0]]);
                [-0.02, 0.015].map(|s| {
                    let point = pose.transform(n * half + along * (s + shift));
                    Contact {
                        point,
                        normal: Some(pose.rotate(n)),
                        point_deviation: 1e-3,
                        normal_deviation: 0.0873,
                        finger: 0,
                    }
                })
            })
            .collect()
    }

    fn view(contacts: &[Contact<Planar>]) -> GraspView<'_, Planar> {
        GraspView { contacts, free: &[] }
    }

    #[test]
    fn follows_a_rectangle() {
        let mut filter = filter(Settings { seed: 3, ..Settings::DEFAULT });
        let mut truth = PlanarPose::new(Vector([0.3, 0.1]), 0.2);
        let first = filter.update(None, view(&touch(&truth, 0.0)));
        assert!(!first.corrected && first.grasp == 0);
        let gauge = truth.inverse().compose(&first.pose);
        for k in 1..5 {
            // The hand meant to turn the object by 20°; it slipped 8 mm and 8°.
            let meant = PlanarPose::new(Vector([0.3, 0.1]), 0.35)
                .compose(&PlanarPose::new(Vector([0.3, 0.1]), 0.0).inverse());
            truth = meant.compose(&truth).retract(Vector([0.006, -0.005, 0.14]));
            let estimate = filter.update(Some(&meant), view(&touch(&truth, 0.003 * k as f32)));
            assert!(estimate.corrected && estimate.observability.is_full());
            let error = truth.compose(&gauge).local(&estimate.pose);
            assert!(error[0].hypot(error[1]) < 0.003, "{k}: {error:?}");
            assert!(error[2].abs() < 0.09, "{k}: {error:?}");
        }
        assert!(filter.map().contacts() == 40);
    }

    #[test]
    fn a_seed_repeats_to_the_bit() {
        let run = |seed| {
            let mut filter = filter(Settings { seed, ..Settings::DEFAULT });
            let pose = PlanarPose::IDENTITY;
            filter.update(None, view(&touch(&pose, 0.0)));
            filter.update(None, view(&touch(&pose, 0.004)))
        };
        assert_eq!(run(5), run(5));
        assert_ne!(run(5).pose, run(6).pose);
    }

    #[test]
    fn the_gate_refuses_strange_grasps() {
        let gate = Some(Gate::THESIS);
        let mut filter = filter(Settings { gate, ..Settings::DEFAULT });
        filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0)));
        let near = filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.001)));
        assert!(near.corrected);
        let far = touch(&PlanarPose::new(Vector([0.5, 0.0]), 0.0), 0.0);
        let strange = filter.update(None, view(&far));
        assert!(!strange.corrected && !strange.resampled);
    }

    #[test]
    fn a_grasp_that_fits_nowhere_is_lost_and_the_object_found_again() {
        let mut filter = filter(Settings { seed: 2, ..Settings::DEFAULT });
        for k in 0..3 {
            filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.002 * k as f32)));
        }
        let known = filter.map().contacts();
        // Something hollow, felt from inside.
        let strange: Vec<_> = touch(&PlanarPose::IDENTITY, 0.0)
            .into_iter()
            .map(|c| Contact { normal: c.normal.map(|n| -n), ..c })
            .collect();
        for _ in 0..2 {
            let lost = filter.update(None, view(&strange));
            assert_eq!((lost.status, lost.corrected, lost.resampled), (Status::Lost, false, false));
            assert_eq!(filter.map().contacts(), known);
        }
        let truth = PlanarPose::new(Vector([0.04, -0.03]), 0.6);
        let found = (0..6).any(|k| {
            let estimate = filter.update(None, view(&touch(&truth, 0.001 * k as f32)));
            let error = truth.local(&estimate.pose);
            estimate.corrected && error[0].hypot(error[1]) < 0.006 && error[2].abs() < 0.1
        });
        assert!(found);
    }

    #[test]
    fn wild_contacts_are_not_learnt() {
        let mut filter = filter(Settings { seed: 4, ..Settings::DEFAULT });
        for k in 0..3 {
            filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.002 * k as f32)));
        }
        let known = filter.map().contacts();
        let mut grasp = touch(&PlanarPose::IDENTITY, 0.001);
        grasp[2].point = Vector([0.015, 0.045]);
        let estimate = filter.update(None, view(&grasp));
        assert!(estimate.corrected && filter.map().contacts() == known + 7);
    }

    #[test]
    fn a_square_turned_by_half_of_its_symmetry_is_ambiguous() {
        let square = |angle: f32| -> Vec<Contact<Planar>> {
            let pose = PlanarPose::new(Vector::ZERO, angle);
            let round = |c: Contact<Planar>| {
                let n = c.normal.unwrap();
                let along = c.point - n * c.point.dot(n);
                Contact {
                    point: pose.transform(n * 0.03 + along),
                    normal: Some(pose.rotate(n)),
                    ..c
                }
            };
            touch(&PlanarPose::IDENTITY, 0.0).into_iter().map(round).collect()
        };
        let motion = MotionNoise { translation: 0.002, rotation: 0.6 };
        let mut filter = filter(Settings { motion, seed: 1, ..Settings::DEFAULT });
        filter.update(None, view(&square(0.0)));
        let estimate = filter.update(None, view(&square(core::f32::consts::FRAC_PI_4)));
        assert_eq!(estimate.status, Status::Ambiguous, "{:?}", estimate.modes);
        assert!((estimate.pose.angle().abs() - core::f32::consts::FRAC_PI_4).abs() < 0.1);
    }

    #[test]
    fn fingers_that_met_nothing_tell_where_the_object_is_not() {
        let mean = |free: &[FreePoint<Planar>]| {
            let mut filter = filter(Settings { seed: 5, ..Settings::DEFAULT });
            filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0)));
            filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.002)));
            // The long sides alone do not see a slide.
            let sides: Vec<_> = touch(&PlanarPose::IDENTITY, 0.0)
                .into_iter()
                .filter(|c| c.normal.is_some_and(|n| n[1].abs() > 0.5))
                .collect();
            filter.update(None, GraspView { contacts: &sides, free }).pose.translation[0]
        };
        let free = [-0.01, 0.0, 0.01].map(|y| FreePoint { point: Vector([0.04, y]), finger: 1 });
        assert!(mean(&free) < mean(&[]) - 0.004, "{} {}", mean(&free), mean(&[]));
    }

    #[test]
    fn bad_contacts_are_counted_and_empty_grasps_only_predict() {
        let mut filter = filter(Settings::DEFAULT);
        let empty = filter.update(None, view(&[]));
        assert!(!empty.corrected && empty.pose == PlanarPose::IDENTITY);
        let mut contacts = touch(&PlanarPose::IDENTITY, 0.0);
        contacts[0].point[1] = f32::NAN;
        contacts[1].normal = Some(Vector([2.0, 0.0]));
        contacts[2].point_deviation = 0.0;
        let estimate = filter.update(None, view(&contacts));
        assert_eq!((estimate.contacts, estimate.rejected), (5, 3));
        assert_eq!(filter.map().contacts(), 5);
        let spread = filter.update(None, view(&[])).covariance;
        assert!(spread.0[0][0] > 0.5e-4, "{spread:?}");
    }

    #[test]
    fn a_new_filter_is_zero_and_works_unconfigured() {
        let mut filter = Box::new(Filter::new(Shape::new()));
        let estimate = filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0)));
        assert!(estimate.pose.is_finite());
        let estimate = filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0)));
        assert!(estimate.pose.is_finite());
    }
}
