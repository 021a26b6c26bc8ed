//! Pictures and reports: what a run is judged by, for people and for programs.

pub mod bars;
mod canvas;
mod chart;
mod colour;
pub mod curves;
pub mod drawing;
pub mod field;
pub mod growth;
pub mod html;
pub mod live;
pub mod mcap;
mod model;
mod plane;
mod raster;
pub mod report;
pub mod scatter;
pub mod scene;
pub mod sheet;
pub mod summary;
pub mod timeline;
pub mod trajectory;
