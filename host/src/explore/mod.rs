//! Active exploration: the hand decides where to touch next (thesis chapter 4).
//!
//! [`episode`] is the closed loop: belief → candidates → gain of each → the best is touched → tracker
//! and surface take what was felt → belief. [`placement`] has the candidates, [`belief`] what is known
//! of the object, [`prediction`] the contacts that a candidate would give, [`criterion`] what they are
//! worth and [`coverage`] when enough is known. [`planning`] goes from worth to choice: several grasps
//! at once ([`batch`]), a step ahead ([`lookahead`]), by gain for its [`cost`]; [`foresight`] is what
//! it imagines. [`areas`] divides the surface into contact areas ([`clustering`]) for candidates to face.

pub mod areas;
pub mod batch;
pub mod belief;
pub mod clustering;
pub mod cost;
pub mod coverage;
pub mod criterion;
pub mod entropy;
pub mod episode;
pub mod foresight;
pub mod geodesic;
pub mod lookahead;
pub mod placement;
pub mod planning;
pub mod pose_gain;
pub mod prediction;

pub use areas::NextArea;
pub use belief::Belief;
pub use cost::Cost;
pub use coverage::Until;
pub use criterion::Criterion;
pub use episode::{Candidates, Episode, Settings, explore};
pub use placement::Placement;
pub use planning::Planning;
