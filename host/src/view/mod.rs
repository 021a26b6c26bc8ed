//! Pictures and reports: what a run is judged by, for people and for programs.

mod canvas;
mod chart;
mod colour;
mod model;
mod plane;
mod raster;
pub mod report;
pub mod summary;
pub mod trajectory;
