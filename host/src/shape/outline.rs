//! Closed polygons in the plane (being written).
use crate::space::{Point, Pose};
/// Simple closed polygons, outer boundaries counter-clockwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Each a closed polygon without repeating its first vertex, metres.
    pub loops: Vec<Vec<[f64; 2]>>,
}
