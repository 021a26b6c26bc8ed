//! Simulated objects, hands and noise: grasp logs whose truth is known.
//!
//! A simulation speaks to an estimator only through its log.

pub mod bench;
pub mod hand;
pub mod objects;
pub(crate) mod random;
pub mod sensed;
pub mod sensors;
pub mod touch;
pub mod world;

pub use bench::Bench;
pub use hand::Hand;
pub use objects::{Arms, ObjectError, ObjectSpec};
pub use touch::Touch;
pub use world::{Options, SimError, Simulation, simulate};
