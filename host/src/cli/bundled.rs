//! Recordings that come with the program, so that it has something to do where it stands.

use clap::ValueEnum;

use super::Error;
use crate::log::{GraspLog, TrueShape};
use crate::shape::Geometry;
use crate::shape::files::parse_mesh;
use crate::slam::output::true_shape;

/// Recordings on offer; `host/assets/README.md` says where each is from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Bundled {
    /// Fifty real contacts on a triangular block, in the plane
    #[default]
    Block,
    /// A simulated hand about an L-shaped prism, in space
    Prism,
}

impl Bundled {
    /// What messages call it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Bundled::Block => "bundled recording",
            Bundled::Prism => "bundled prism",
        }
    }

    fn text(self) -> &'static str {
        match self {
            Bundled::Block => include_str!("../../assets/bundled.jsonl"),
            Bundled::Prism => include_str!("../../assets/prism.jsonl"),
        }
    }

    /// The recording, and its object's true shape where that is known.
    ///
    /// # Errors
    /// None, unless the program was built with damaged files.
    pub(super) fn read(self) -> Result<(GraspLog, Option<Geometry>), Error> {
        let log = GraspLog::parse(self.text().as_bytes(), self.name().as_ref());
        let log = log.map_err(Error::input)?;
        let truth = match &log.shape {
            Some(TrueShape::Mesh { file, .. }) => {
                let mesh = parse_mesh(file, include_bytes!("../../assets/prism.ply"));
                Some(Geometry::Mesh(mesh.map_err(Error::input)?))
            }
            _ => true_shape(&log).map_err(Error::input)?,
        };
        Ok((log, truth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::deviation;
    use crate::sim::{Options, Touch, simulate};

    #[test]
    fn every_recording_is_whole_and_knows_its_shape() {
        for (bundled, dimension) in [(Bundled::Block, 2), (Bundled::Prism, 3)] {
            let (log, truth) = bundled.read().unwrap();
            assert_eq!(log.dimension, dimension);
            assert!(log.grasps.len() >= 10);
            assert!(log.grasps.iter().all(|g| g.truth.is_some()));
            assert_eq!(truth.unwrap().dimension(), dimension);
        }
    }

    #[test]
    fn the_prism_is_as_the_simulator_makes_it() {
        let (_, truth) = Bundled::Prism.read().unwrap();
        let options = Options {
            object: "lshape:0.10x0.08x0.035x0.06".parse().unwrap(),
            grasps: Some(32),
            contacts: 5,
            touch: Touch::Hand,
            contact_noise: deviation("1mm,5deg").unwrap(),
            motion_noise: deviation("3mm,5deg").unwrap(),
            carried: None,
            outliers: 0.0,
            free: true,
            seed: 4,
        };
        let made = simulate(&options).unwrap();
        let mut text = Vec::new();
        made.log.to_writer(&mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        // All but the header, where the mesh has no name yet.
        assert!(text.lines().skip(1).eq(Bundled::Prism.text().lines().skip(1)));
        let (Geometry::Mesh(made), Some(Geometry::Mesh(bundled))) = (made.geometry, truth) else {
            panic!("no meshes");
        };
        assert_eq!(made.triangles(), bundled.triangles());
        assert_eq!(made.vertices(), bundled.vertices());
    }
}
