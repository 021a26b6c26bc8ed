//! # tactile-host
//!
//! Everything around [`tactile_core`] that wants a heap: grasp logs and recordings, simulated
//! objects and hands, the dense double-precision [mod@reference] the core is held against, what an
//! object may be ([mod@model]), contours and meshes, the link to a board, pictures and reports, and the
//! command line `tactile`.
//!
//! Host types hold planar data as spatial data with z = 0 and rotations about z, so that files,
//! simulation and reports are written once for both dimensions; [`space`] converts to and from the
//! core's types. Units are SI, angles radians, frames `world` and `object`; a pose maps object to
//! world.

pub mod baseline;
pub mod cli;
pub mod data;
pub mod dense;
pub mod experiment;
pub mod experts;
pub mod explore;
pub mod graph;
pub mod link;
pub mod localize;
pub mod log;
pub mod model;
pub mod quantity;
pub mod reference;
pub mod shape;
pub mod sim;
pub mod slam;
pub mod space;
pub mod thin;
pub mod view;
