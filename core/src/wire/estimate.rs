//! What is believed after a grasp: the pose, other poses that may be, and the faces of the shape.

use serde::{Deserialize, Serialize};

use super::quantity::{Fraction, WireSpace, nearest};
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::track;

/// The belief after one grasp. Of the observability only the eigenvalues and the weakest direction
/// travel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct EstimateFrame<S: WireSpace> {
    /// Number of the grasp since the last reset, from 0.
    pub grasp: u32,
    /// Object to world.
    pub pose: S::Numbers,
    /// Standard deviations of the pose in tangent coordinates, metres and radians.
    pub deviations: S::Deviations,
    /// Correlations of the tangent coordinates, the lower triangle row by row.
    pub correlations: S::Correlations,
    /// Effective number of particles, to the nearest whole number.
    pub effective_particles: u16,
    /// Half the eigenvalues of the observability, ascending.
    pub eigenvalues: S::Fractions,
    /// The eigenvector of the least eigenvalue.
    pub weakest: S::Fractions,
    /// Contacts of this grasp that can be used, at most 255.
    pub contacts: u8,
    /// Contacts of this grasp with bad numbers, at most 255.
    pub rejected: u8,
    /// Contacts the bounded map let go in this update, at most 255.
    pub dropped: u8,
    /// Bit 0: the grasp corrected the pose. Bit 1: the particles were resampled. Bits 2 to 4: the
    /// [`track::Status`] in the order of its variants.
    pub flags: u8,
}

impl<S: WireSpace> EstimateFrame<S> {
    /// Packs what the tracker believes.
    pub fn new(estimate: &track::Estimate<S>) -> Self {
        let mut frame = EstimateFrame {
            grasp: estimate.grasp,
            pose: S::pack_pose(&estimate.pose),
            deviations: S::Deviations::default(),
            correlations: S::Correlations::default(),
            effective_particles: nearest(estimate.effective_particles).clamp(0, u16::MAX as i32)
                as u16,
            eigenvalues: S::Fractions::default(),
            weakest: S::Fractions::default(),
            contacts: estimate.contacts.min(255) as u8,
            rejected: estimate.rejected.min(255) as u8,
            dropped: estimate.dropped.min(255) as u8,
            flags: estimate.corrected as u8
                | (estimate.resampled as u8) << 1
                | (estimate.status as u8) << 2,
        };
        (frame.deviations, frame.correlations) = packed::<S>(&estimate.covariance);
        let seen = &estimate.observability;
        for (i, e) in AsMut::<[Fraction]>::as_mut(&mut frame.eigenvalues).iter_mut().enumerate() {
            *e = Fraction::new(0.5 * seen.eigenvalues[i]);
        }
        for (i, w) in AsMut::<[Fraction]>::as_mut(&mut frame.weakest).iter_mut().enumerate() {
            *w = Fraction::new(seen.directions.at(i, 0));
        }
        frame
    }

    /// Object to world, or `None` when a number is not finite.
    pub fn pose(&self) -> Option<S::Pose> {
        S::unpack_pose(self.pose)
    }

    /// Covariance of the pose in tangent coordinates, metres and radians.
    pub fn covariance(&self) -> S::Covariance {
        unpacked::<S>(&self.deviations, &self.correlations)
    }

    /// Eigenvalues of the observability, ascending, each in [0, 2].
    pub fn eigenvalues(&self) -> S::Tangent {
        let e = self.eigenvalues;
        S::Tangent::from_fn(|i| e.as_ref().get(i).map_or(0.0, |v| 2.0 * v.value()))
    }

    /// The direction this grasp saw least (see [`track::Observability::directions`]).
    pub fn weakest(&self) -> S::Tangent {
        let w = self.weakest;
        S::Tangent::from_fn(|i| w.as_ref().get(i).map_or(0.0, |v| v.value()))
    }

    /// Whether the grasp corrected the pose.
    pub fn corrected(&self) -> bool {
        self.flags & 1 != 0
    }

    /// Whether the particles were resampled.
    pub fn resampled(&self) -> bool {
        self.flags & 2 != 0
    }

    /// How much the estimate is worth; a status this version does not know counts as lost.
    pub fn status(&self) -> track::Status {
        match self.flags >> 2 & 7 {
            0 => track::Status::Started,
            1 => track::Status::Tracking,
            2 => track::Status::Predicted,
            3 => track::Status::Ambiguous,
            _ => track::Status::Lost,
        }
    }
}

/// One of the poses that the belief held possible after the last grasp, or was told to since.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct ModeFrame<S: WireSpace> {
    /// Its number, 0 the heaviest.
    pub number: u8,
    /// How many there are.
    pub of: u8,
    /// Its share of the belief.
    pub weight: Fraction,
    /// Object to world.
    pub pose: S::Numbers,
}

impl<S: WireSpace> ModeFrame<S> {
    /// Packs the mode of this number; `None` where there are not so many.
    pub fn new(modes: &track::Modes<S>, number: u8) -> Option<Self> {
        let all = modes.as_slice();
        let mode = all.get(usize::from(number))?;
        Some(ModeFrame {
            number,
            of: all.len() as u8,
            weight: Fraction::new(mode.weight),
            pose: S::pack_pose(&mode.pose),
        })
    }

    /// The mode, or `None` when a number is not finite.
    pub fn mode(&self) -> Option<track::Mode<S>> {
        Some(track::Mode { pose: S::unpack_pose(self.pose)?, weight: self.weight.value() })
    }
}

/// What a board says of a face, in the object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaceSummary<S: WireSpace> {
    /// Unit, out of the object.
    pub normal: S::Vector,
    /// A point on the face, near the middle of its contacts, metres.
    pub centroid: S::Vector,
    /// Standard deviation along the normal there, metres.
    pub deviation: f32,
    /// Standard deviation of the normal, radians per axis.
    pub tilt: f32,
    /// Contacts it was fitted to.
    pub contacts: u16,
}

/// One face of the object, in the object frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct FaceFrame<S: WireSpace> {
    /// Its number, from 0.
    pub number: u8,
    /// How many there are.
    pub of: u8,
    /// Contacts it was fitted to, at most 65 535.
    pub contacts: u16,
    /// Unit, out of the object.
    pub normal: S::Normal,
    /// A point on the face, near the middle of its contacts, micrometres.
    pub centroid: S::Point,
    /// Standard deviation along the normal there, micrometres, at most 65 535.
    pub deviation: u16,
    /// Standard deviation of the normal, 10⁻⁴ radians per axis, at most 65 535.
    pub tilt: u16,
}

impl<S: WireSpace> FaceFrame<S> {
    /// Packs face `number` of so many.
    pub fn new(face: &FaceSummary<S>, number: u8, of: u8) -> Self {
        let counted = |v: f32| match v {
            v if v.is_nan() => u16::MAX,
            v => nearest(v).clamp(0, u16::MAX.into()) as u16,
        };
        FaceFrame {
            number,
            of,
            contacts: face.contacts,
            normal: S::pack_normal(face.normal),
            centroid: S::pack_point(face.centroid),
            deviation: counted(face.deviation * 1e6),
            tilt: counted(face.tilt * 1e4),
        }
    }

    /// The face.
    pub fn face(&self) -> FaceSummary<S> {
        FaceSummary {
            normal: S::unpack_normal(self.normal),
            centroid: S::unpack_point(self.centroid),
            deviation: f32::from(self.deviation) * 1e-6,
            tilt: f32::from(self.tilt) * 1e-4,
            contacts: self.contacts,
        }
    }
}

/// Where the object is, as somebody else believes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct BeliefFrame<S: WireSpace> {
    /// Object to world.
    pub pose: S::Numbers,
    /// Standard deviations of the pose in tangent coordinates, metres and radians.
    pub deviations: S::Deviations,
    /// Correlations of the tangent coordinates, the lower triangle row by row.
    pub correlations: S::Correlations,
}

impl<S: WireSpace> BeliefFrame<S> {
    /// Packs a pose and its covariance.
    pub fn new(pose: &S::Pose, covariance: &S::Covariance) -> Self {
        let (deviations, correlations) = packed::<S>(covariance);
        BeliefFrame { pose: S::pack_pose(pose), deviations, correlations }
    }

    /// The pose and its covariance, or `None` when a number is not finite or the object further away
    /// than 10 km.
    pub fn belief(&self) -> Option<(S::Pose, S::Covariance)> {
        let finite = self.deviations.as_ref().iter().all(|d| d.is_finite());
        let near = |pose: &S::Pose| finite && track::is_plausible::<S>(pose);
        let pose = S::unpack_pose(self.pose).filter(near)?;
        Some((pose, unpacked::<S>(&self.deviations, &self.correlations)))
    }
}

/// Standard deviations and correlations of a covariance. What is not a number stays none: zero would be
/// certainty.
fn packed<S: WireSpace>(covariance: &S::Covariance) -> (S::Deviations, S::Correlations) {
    let deviation = |i| match covariance.at(i, i) {
        variance if variance < 0.0 => 0.0,
        variance => math::sqrt(variance),
    };
    let (mut deviations, mut correlations) = (S::Deviations::default(), S::Correlations::default());
    for (i, d) in AsMut::<[f32]>::as_mut(&mut deviations).iter_mut().enumerate() {
        *d = deviation(i);
    }
    let pairs = (0..S::FREEDOM).flat_map(|i| (0..i).map(move |j| (i, j)));
    for ((i, j), c) in pairs.zip(AsMut::<[Fraction]>::as_mut(&mut correlations)) {
        let scale = deviation(i) * deviation(j);
        *c = Fraction::new(if scale > 0.0 { covariance.at(i, j) / scale } else { 0.0 });
    }
    (deviations, correlations)
}

/// The covariance of standard deviations and correlations.
fn unpacked<S: WireSpace>(
    deviations: &S::Deviations,
    correlations: &S::Correlations,
) -> S::Covariance {
    let d = deviations.as_ref();
    let mut covariance = S::Covariance::ZERO;
    for (i, &deviation) in d.iter().enumerate() {
        *covariance.at_mut(i, i) = deviation * deviation;
    }
    let pairs = (0..S::FREEDOM).flat_map(|i| (0..i).map(move |j| (i, j)));
    for ((i, j), c) in pairs.zip(correlations.as_ref()) {
        let entry = c.value() * covariance_scale(d, i, j);
        *covariance.at_mut(i, j) = entry;
        *covariance.at_mut(j, i) = entry;
    }
    covariance
}

fn covariance_scale(deviations: &[f32], i: usize, j: usize) -> f32 {
    deviations.get(i).zip(deviations.get(j)).map_or(0.0, |(a, b)| a * b)
}
