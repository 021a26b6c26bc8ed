//! Active exploration: the hand decides where to touch next (thesis chapter 4).
//!
//! [`episode`] is the closed loop: belief → candidates → gain of each → the best is touched → tracker
//! and surface take what was felt → belief. [`placement`] has the candidates, [`belief`] what is known
//! of the object, [`prediction`] the contacts that a candidate would give, [`criterion`] what they are
//! worth and [`coverage`] when enough is known. An [`adviser`] may choose instead: a board. Where the hand
//! is articulated, [`approach`] has the candidates and [`swept`] what its fingertips would meet.

pub mod adviser;
pub mod approach;
pub mod belief;
pub mod coverage;
pub mod criterion;
pub mod episode;
pub mod localization;
pub mod placement;
pub mod pose_gain;
pub mod prediction;
pub mod swept;

pub use adviser::{Adviser, Board};
pub use belief::Belief;
pub use coverage::Until;
pub use criterion::Criterion;
pub use episode::{
    Candidates, End, Episode, Settings, explore, explore_advised, explore_until,
};
pub use placement::Placement;

#[cfg(test)]
mod articulated_tests;
