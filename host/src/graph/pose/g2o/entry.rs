//! How the two groups are written: the words of a line.

use nalgebra::{Quaternion, UnitQuaternion};

use super::super::{Group, Se2, Se3};

/// The most numbers in a pose.
pub(super) const LONGEST: usize = 7;

/// A group as lines of a file.
pub(super) trait Entry<const D: usize>: Group<D> {
    /// First word of a pose's line.
    const VERTEX: &'static str;
    /// First word of a measurement's line.
    const EDGE: &'static str;
    /// The numbers of a pose, by name.
    const FIELDS: &'static [&'static str];
    /// The first of them that is about rotation.
    const ROTATION: usize;

    /// The motion with these numbers (one per field; finite, angles below 10⁶) and what had to be done to
    /// them; `None` for a quaternion that is zero.
    fn from_numbers(numbers: &[f64]) -> Option<(Self, Repair)>;

    /// Its numbers, the first [`Entry::FIELDS`] of them.
    fn numbers(&self) -> [f64; LONGEST];
}

/// What a rotation needed before it was one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Repair {
    /// Nothing worth a word.
    None,
    /// The quaternion's length was not 1.
    Normalised,
    /// The angle was beyond a full turn.
    Wrapped,
}

impl Entry<3> for Se2 {
    const VERTEX: &'static str = "VERTEX_SE2";
    const EDGE: &'static str = "EDGE_SE2";
    const FIELDS: &'static [&'static str] = &["x", "y", "angle"];
    const ROTATION: usize = 2;

    fn from_numbers(numbers: &[f64]) -> Option<(Self, Repair)> {
        let &[x, y, angle] = numbers else { return None };
        let wide = angle.abs() > std::f64::consts::TAU;
        Some((Se2::new(x, y, angle), if wide { Repair::Wrapped } else { Repair::None }))
    }

    fn numbers(&self) -> [f64; LONGEST] {
        let t = self.translation;
        [t.x, t.y, self.angle, 0.0, 0.0, 0.0, 0.0]
    }
}

impl Entry<6> for Se3 {
    const VERTEX: &'static str = "VERTEX_SE3:QUAT";
    const EDGE: &'static str = "EDGE_SE3:QUAT";
    const FIELDS: &'static [&'static str] = &["x", "y", "z", "qx", "qy", "qz", "qw"];
    const ROTATION: usize = 3;

    fn from_numbers(numbers: &[f64]) -> Option<(Self, Repair)> {
        let &[x, y, z, qx, qy, qz, qw] = numbers else { return None };
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        let square = quaternion.norm_squared();
        // What is as short as this is a mistake, not a direction.
        if square < 1e-12 {
            return None;
        }
        // A quaternion that was normalised once stays as it is, so that files survive unchanged.
        let rotation = if (square - 1.0).abs() <= 16.0 * f64::EPSILON {
            UnitQuaternion::new_unchecked(quaternion)
        } else {
            UnitQuaternion::new_normalize(quaternion)
        };
        let off = (square.sqrt() - 1.0).abs() > 0.01;
        let pose = Se3 { translation: [x, y, z].into(), rotation };
        Some((pose, if off { Repair::Normalised } else { Repair::None }))
    }

    fn numbers(&self) -> [f64; LONGEST] {
        let (t, q) = (self.translation, self.rotation.quaternion());
        [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
    }
}
