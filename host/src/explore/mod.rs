//! Active exploration: the hand decides where to touch next (thesis chapter 4).
//!
//! [`episode`] is the closed loop: belief → candidates → gain of each → the best is touched → tracker
//! and surface take what was felt → belief. [`placement`] has the candidates, [`belief`] what is known
//! of the object, [`prediction`] the contacts that a candidate would give, [`criterion`] what they are
//! worth and [`coverage`] when enough is known.

pub mod belief;
pub mod coverage;
pub mod criterion;
pub mod episode;
pub mod localization;
pub mod placement;
pub mod pose_gain;
pub mod prediction;

pub use belief::Belief;
pub use coverage::Until;
pub use criterion::Criterion;
pub use episode::{Candidates, End, Episode, Settings, explore};
pub use placement::Placement;
