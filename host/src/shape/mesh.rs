//! Triangle meshes (being written).
use crate::space::{Point, Pose};
/// Indexed triangles, counter-clockwise seen from outside.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Metres.
    pub vertices: Vec<Point>,
    /// Indices into `vertices`.
    pub triangles: Vec<[u32; 3]>,
}
