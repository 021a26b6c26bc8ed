//! The workbench: an object that a hand touches wherever it is told to, one grasp at a time.

use std::path::Path;

use nalgebra::Translation3;

use super::random::Random;
use super::touch::{FINGERS, Stroke, feel};
use super::world::{
    FIRST_OFFSET, FIRST_TURN, about, check, normal, normal_turn, sensed, stated, turn, uniform3,
    write,
};
use super::{Options, SimError};
use crate::log::{GraspLog, LoggedGrasp, TrueShape};
use crate::shape::Geometry;
use crate::space::{Point, Pose};

/// An object on a bench. Who explores it sees the [`log`](Bench::log) alone, whose truth reaches no
/// estimator.
#[derive(Clone, Debug)]
pub struct Bench {
    options: Options,
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
        check(&options)?;
        let geometry = options.object.geometry()?;
        let dimension = geometry.dimension();
        let [mut slips, noise, wild] = Random::streams(options.seed);
        let centre = geometry.centroid();
        let shift = uniform3(dimension, FIRST_OFFSET, &mut slips);
        let turned = turn(dimension, FIRST_TURN, &mut slips);
        let pose = Translation3::from(-centre) * about(&centre, shift, turned);
        let log = GraspLog {
            dimension,
            description: format!("explored {}, seed {}", options.object, options.seed),
            fingers: FINGERS.map(String::from).to_vec(),
            noise: stated(&options),
            shape: match &geometry {
                Geometry::Outline(o) => o.loops.first().map(|l| TrueShape::Polygon(l.clone())),
                Geometry::Mesh(_) => None,
            },
            grasps: Vec::new(),
            unknown: Default::default(),
        };
        Ok(Bench { options, geometry, pose, slips, noise, wild, log })
    }

    /// Closes the hand at `hand` (hand to world) along `strokes`, after the object has slipped by the
    /// motion noise; the grasp is the log's last one then. How many contacts it felt: none where the
    /// hand closed on nothing.
    pub fn close(&mut self, hand: &Pose, strokes: &[Stroke]) -> usize {
        let dimension = self.log.dimension;
        let first = self.log.grasps.is_empty();
        if !first {
            let Options { motion_noise, .. } = &self.options;
            let slip = about(
                &self.geometry.centroid(),
                motion_noise.length * normal(dimension, &mut self.slips),
                motion_noise.angle * normal_turn(dimension, &mut self.slips),
            );
            self.pose *= slip;
            self.pose.rotation.renormalize();
        }
        let (felt, free) = feel(&self.geometry, &self.pose, hand, strokes);
        let sensor = |felt| {
            let Bench { pose, options, noise, wild, .. } = self;
            sensed(pose, felt, dimension, options, noise, wild)
        };
        let contacts: Vec<_> = felt.into_iter().map(sensor).collect();
        let count = contacts.len();
        self.log.grasps.push(LoggedGrasp {
            index: self.log.grasps.len() as u64,
            time: None,
            motion: (!first).then(Pose::identity),
            contacts,
            free,
            truth: Some(self.pose),
            unknown: Default::default(),
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

    /// How far the object reaches from its middle at most, metres: what probing its bounding box with
    /// an open hand would give (thesis figure 4.2).
    pub fn radius(&self) -> f64 {
        let (low, high) = self.geometry.bounds();
        let centre: Point = self.geometry.centroid();
        (low - centre).abs().sup(&(high - centre).abs()).norm()
    }
}
