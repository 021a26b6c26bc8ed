//! The workbench: an object that a hand touches wherever it is told to, one grasp at a time.

use std::path::Path;

use nalgebra::{Point3, Translation3};
use serde_json::Value;

use super::hand::closing::{Closed, Unreachable};
use super::hand::probing::{Plate, Probe, probe};
use super::hand::{Hand, Surroundings};
use super::random::Random;
use super::touch::{Felt, Stroke, feel, strokes};
use super::world::{
    EXPLORED, FIRST_OFFSET, FIRST_TURN, about, check, normal, normal_turn, sensed, stated, turn,
    uniform3, write,
};
use super::{Options, SimError};
use crate::log::{GraspLog, LoggedContact, LoggedFree, LoggedGrasp, TrueShape};
use crate::shape::Geometry;
use crate::space::{Point, Pose};

/// How far a finger goes on after it has touched, metres, where the object can move at all.
const REACTION: f64 = 1e-3;

/// What a log's grasp says where the hand could not get to, and why.
const UNREACHABLE: &str = "unreachable";

/// Deviation of the normal that a flat hand has of what it met: it touched an edge or a corner as well as
/// a face, radians.
const FLAT_HAND: f64 = 0.5;

/// Deviation of the normal of what stands on a table from straight down, at a place that is not quite where
/// it stands, radians.
const STANDING: f64 = 0.2;

/// An object on a bench. Who explores it sees the [`log`](Bench::log) alone, whose truth reaches no
/// estimator.
#[derive(Clone, Debug)]
pub struct Bench {
    options: Options,
    hand: Hand,
    /// Height of the table, world frame, where there is one.
    table: Option<f64>,
    geometry: Geometry,
    pose: Pose,
    slips: Random,
    noise: Random,
    wild: Random,
    log: GraspLog,
}

impl Bench {
    /// An object somewhere near the world's origin, as in [`super::simulate`]; `options.grasps`,
    /// `contacts` and `touch` are not used. Where the motion noise is zero it stays where it is.
    ///
    /// # Errors
    /// When an option is out of range or the object has no geometry.
    pub fn new(options: Options) -> Result<Bench, SimError> {
        Bench::with_hand(options, Hand::Idealised, false)
    }

    /// The same with a hand of one's own, and where `table` is set the object standing on a table at
    /// height 0, where it slips and turns on the table only.
    ///
    /// # Errors
    /// When an option is out of range, the object has no geometry, a planar object is to be touched by an
    /// articulated hand, or the idealised hand, which nothing can be in the way of, is to mind a table.
    pub fn with_hand(options: Options, hand: Hand, table: bool) -> Result<Bench, SimError> {
        check(&options)?;
        let geometry = options.object.geometry()?;
        let dimension = geometry.dimension();
        let articulated = matches!(hand, Hand::Articulated(_));
        if dimension == 2 && articulated {
            return Err(SimError::Planar { object: options.object.to_string() });
        }
        if table && !articulated {
            return Err(SimError::Option {
                option: "--table",
                expected: "an articulated hand, with --hand",
                found: "the idealised one, which nothing is in the way of".into(),
            });
        }
        let [mut slips, noise, wild] = Random::streams(options.seed);
        let centre = geometry.centroid();
        let shift = uniform3(dimension, FIRST_OFFSET, &mut slips);
        let turned = turn(dimension, FIRST_TURN, &mut slips);
        let mut pose = Translation3::from(-centre) * about(&centre, shift, turned);
        if table {
            let upright = Point::new(0.0, 0.0, turned.z);
            let lowest = geometry.bounds().0.z;
            pose = Translation3::new(-centre.x, -centre.y, -lowest)
                * about(&centre, Point::new(shift.x, shift.y, 0.0), upright);
        }
        let log = GraspLog {
            dimension,
            description: format!(
                "{EXPLORED}{}, seed {}",
                options.object.without_folders(),
                options.seed
            ),
            fingers: hand.fingers(),
            noise: stated(&options),
            shape: match &geometry {
                Geometry::Outline(o) => o.loops.first().map(|l| TrueShape::Polygon(l.clone())),
                Geometry::Mesh(_) => None,
            },
            grasps: Vec::new(),
            unknown: Default::default(),
        };
        let table = table.then_some(0.0);
        Ok(Bench { options, hand, table, geometry, pose, slips, noise, wild, log })
    }

    /// What touches.
    pub fn hand(&self) -> &Hand {
        &self.hand
    }

    /// The height of the table's top, world frame, metres; `None` without a table.
    pub fn table(&self) -> Option<f64> {
        self.table
    }

    /// Brings the hand to `placement` (grasp frame to world) with this spread, and closes it, after the
    /// object has slipped by the motion noise. The idealised hand starts `radius` metres away, as in
    /// [`Hand::paths`]. The grasp is the log's last one then; how many contacts it felt.
    ///
    /// An object with motion noise gives way to an articulated hand, as
    /// [`Articulated::close`](super::hand::Articulated::close) says; one without is held fast.
    ///
    /// # Errors
    /// When the hand cannot get there. The log then has a grasp without contacts, whose field
    /// `unreachable` says why.
    pub fn grasp(
        &mut self,
        placement: &Pose,
        spread: f64,
        radius: f64,
    ) -> Result<usize, Unreachable> {
        let Hand::Articulated(hand) = self.hand.clone() else {
            let dimension = self.log.dimension;
            return Ok(self.close(placement, &strokes(dimension, 5, radius, spread, 0.0)));
        };
        let pose = self.slipped();
        let Geometry::Mesh(mesh) = &self.geometry else { return Err(Unreachable::NothingFelt) };
        let noise = &self.options.motion_noise;
        let give = if noise.length > 0.0 || noise.angle > 0.0 { REACTION } else { 0.0 };
        let around = Surroundings::new(Some((mesh, pose)), self.table);
        let closed = hand.close(placement, spread, &around, give);
        self.pose = pose;
        match closed {
            Ok(Closed { touched, free, object, .. }) => {
                self.pose = object.unwrap_or(pose);
                let felt = touched.into_iter().map(|t| Felt {
                    finger: Some(t.finger),
                    point: t.point,
                    normal: t.normal,
                });
                let contacts = self.sense(felt.collect());
                let free = free.into_iter().map(|(finger, point)| LoggedFree {
                    finger: Some(finger),
                    point,
                    unknown: Default::default(),
                });
                let free = free.collect();
                Ok(self.record(contacts, free, None))
            }
            Err(why) => {
                self.record(Vec::new(), Vec::new(), Some(&why));
                Err(why)
            }
        }
    }

    /// Delimits the object by guarded moves with the flat hand (thesis figure 4.2): from every side, but
    /// from below where there is a table, until it touches, which moves nothing. The touches are one
    /// grasp of the log, without fingers, their normals (those of the flat hand) marked as vague; in space
    /// with places where the flat hand met nothing ([`Probe::clear`]). What stands on a table touches it,
    /// which is a contact more, marked as `from` the `table` ([`Probe::foot`]).
    ///
    /// # Errors
    /// When no move meets anything: [`Unreachable::NothingFelt`]. The log stays as it is then.
    pub fn probe(&mut self) -> Result<Probe, Unreachable> {
        let plate = match &self.hand {
            Hand::Idealised => Plate::LARGE,
            Hand::Articulated(hand) => Plate::of(hand),
        };
        let found = probe(&self.geometry, &self.pose, self.table, &plate);
        let Some(found) = found else { return Err(Unreachable::NothingFelt) };
        let back = self.pose.inverse();
        let felt = found.touches().map(|(point, normal)| Felt {
            finger: None,
            point: (back * Point3::from(point)).coords,
            normal: back.rotation * normal,
        });
        let felt = felt.collect();
        let mut contacts = self.sense(felt);
        contacts.iter_mut().for_each(|c| c.normal_noise = Some(FLAT_HAND));
        let found = found.sensed(contacts.iter().map(|c| c.point), self.table);
        let spatial = self.log.dimension == 3;
        let clear = if spatial { found.clear() } else { Vec::new() };
        let free = clear.into_iter().map(|point| LoggedFree { point, ..LoggedFree::default() });
        contacts.extend(self.table.map(|height| LoggedContact {
            point: found.foot(height),
            normal: Some(-Point::z()),
            normal_noise: Some(STANDING),
            unknown: [("from".to_owned(), Value::from("table"))].into_iter().collect(),
            ..LoggedContact::default()
        }));
        self.record(contacts, free.collect(), None);
        Ok(found)
    }

    /// Points of the true surface that a fingertip can get to, object frame, with their outward normals:
    /// all of about `count` evenly spread ones but those so near to the table that a ball of the
    /// fingertip's radius does not fit between.
    pub fn reachable(&self, count: usize) -> Vec<(Point, Point)> {
        let mut samples = self.geometry.samples(count);
        if let Some(height) = self.table {
            let radius = match &self.hand {
                Hand::Idealised => 0.0,
                Hand::Articulated(hand) => {
                    hand.fingers().iter().map(|f| f.pad.1).fold(f64::INFINITY, f64::min)
                }
            };
            samples.retain(|(point, normal)| {
                let point = (self.pose * Point3::from(*point)).coords;
                let normal = self.pose.rotation * normal;
                point.z + radius * normal.z >= height + radius - 1e-9 && normal.z > -0.99
            });
        }
        samples
    }

    /// Closes the hand at `hand` (hand to world) along `strokes`, after the object has slipped by the
    /// motion noise; the grasp is the log's last one then. How many contacts it felt: none where the
    /// hand closed on nothing. A fingertip that would start inside an object larger than the hand opens
    /// has met it on its way there.
    pub fn close(&mut self, hand: &Pose, strokes: &[Stroke]) -> usize {
        self.pose = self.slipped();
        let strokes: Vec<Stroke> = strokes.iter().map(|s| self.begun_outside(hand, s)).collect();
        let (felt, free) = feel(&self.geometry, &self.pose, hand, &strokes);
        let contacts = self.sense(felt);
        self.record(contacts, free, None)
    }

    /// The stroke, from so far out that it does not start in the object.
    fn begun_outside(&self, hand: &Pose, stroke: &Stroke) -> Stroke {
        let start = (self.pose.inverse() * hand * Point3::from(stroke.start)).coords;
        let inside = match &self.geometry {
            Geometry::Outline(outline) => outline.contains(&start),
            Geometry::Mesh(mesh) => mesh.signed_distance(&start).is_some_and(|d| d < 0.0),
        };
        if !inside {
            return stroke.clone();
        }
        let (low, high) = self.geometry.bounds();
        let back = (high - low).norm();
        let start = stroke.start - back * stroke.direction;
        Stroke { start, travel: stroke.travel + back, ..stroke.clone() }
    }

    /// Where the object is after it has slipped, which it does before every grasp but the first.
    fn slipped(&mut self) -> Pose {
        if self.log.grasps.is_empty() {
            return self.pose;
        }
        // On a table it slides and turns, upright.
        let dimension = if self.table.is_some() { 2 } else { self.log.dimension };
        let Options { motion_noise, .. } = &self.options;
        let slip = about(
            &self.geometry.centroid(),
            motion_noise.length * normal(dimension, &mut self.slips),
            motion_noise.angle * normal_turn(dimension, &mut self.slips),
        );
        let mut pose = self.pose * slip;
        pose.rotation.renormalize();
        pose
    }

    fn sense(&mut self, felt: Vec<Felt>) -> Vec<LoggedContact> {
        let dimension = self.log.dimension;
        let Bench { pose, options, noise, wild, .. } = self;
        felt.into_iter().map(|f| sensed(pose, f, dimension, options, noise, wild)).collect()
    }

    /// Appends a grasp to the log; how many contacts it has.
    fn record(
        &mut self,
        contacts: Vec<LoggedContact>,
        free: Vec<LoggedFree>,
        why: Option<&Unreachable>,
    ) -> usize {
        let count = contacts.len();
        let first = self.log.grasps.is_empty();
        let why = why.map(|why| (UNREACHABLE.to_owned(), Value::from(why.to_string())));
        self.log.grasps.push(LoggedGrasp {
            index: self.log.grasps.len() as u64,
            time: None,
            motion: (!first).then(Pose::identity),
            contacts,
            free,
            truth: Some(self.pose),
            unknown: why.into_iter().collect(),
        });
        count
    }

    /// Everything felt so far.
    pub fn log(&self) -> &GraspLog {
        &self.log
    }

    /// Writes the log to `path`, and in space the true mesh beside it as [`super::Simulation::write`]
    /// does.
    ///
    /// # Errors
    /// When one of the two cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), SimError> {
        write(&self.log, &self.geometry, &self.options.object, path)
    }

    /// The true shape in the object frame, to judge by.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }
}
