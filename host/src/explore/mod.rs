//! Active exploration: the hand decides where to touch next (thesis chapter 4).
//!
//! [`episode`] is the closed loop: belief → candidates → gain of each → the best is touched → tracker
//! and surface take what was felt → belief. [`placement`] has the candidates, [`belief`] what is known
//! of the object, [`prediction`] the contacts that a candidate would give, [`criterion`] what they are
//! worth and [`coverage`] when enough is known. An [`adviser`] may choose instead: a board. Where the hand
//! is articulated, [`approach`] has the candidates and [`swept`] what its fingertips would meet.
//! [`planning`] goes from worth to choice: several grasps at once ([`batch`]), a step ahead
//! ([`lookahead`]), by gain for its [`cost`], or such that the last pose is known ([`localization`]);
//! [`foresight`] is what it imagines. [`areas`] divides the surface into contact areas ([`clustering`])
//! for candidates to face.

pub mod adviser;
pub mod approach;
pub mod areas;
pub mod batch;
pub mod belief;
mod choice;
pub mod clustering;
pub mod cost;
pub mod coverage;
pub mod criterion;
pub mod entropy;
pub mod episode;
pub mod foresight;
pub mod geodesic;
pub mod localization;
pub mod lookahead;
pub mod placement;
pub mod planning;
pub mod pose_gain;
mod poses;
pub mod prediction;
pub mod swept;
mod turning;

pub use adviser::{Adviser, Board};
pub use areas::NextArea;
pub use belief::Belief;
pub use cost::Cost;
pub use coverage::Until;
pub use criterion::Criterion;
pub use episode::{Candidates, End, Episode, Settings, explore, explore_advised, explore_until};
pub use placement::Placement;
pub use planning::Planning;

#[cfg(test)]
mod articulated_tests;
