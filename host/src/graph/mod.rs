//! Global correction: all grasps and the object's faces estimated together, after the tracker.
//!
//! A tracker that goes forward only keeps the mistakes it made when it knew little. The thesis (3.3.3)
//! corrects them by a graph whose edges are relative poses between pairs of similar grasps; five
//! contacts then serve many edges as if they were independent. Here nothing is counted twice: every
//! contact is one measurement of one face from one pose, and poses, faces and motions are solved in one
//! least-squares problem (planar SLAM: Kaess, ICRA 2015; the sparsity is that of bundle adjustment,
//! Triggs et al. 2000).
//!
//! [`planes`](mod@planes) is the entrance. Below it, [`problem`] holds the measurements and the unknowns, [`factors`]
//! their residuals and derivatives, [`solve`](mod@solve) the Levenberg–Marquardt iteration on the structure that
//! [`arrow`] exploits, [`explain`] and [`alias`] decide which contact lies on which face and at which of several
//! look-alike poses a grasp was made, [`retrack`] builds a trajectory of its own.
//! for curved objects what faces do for flat ones.

pub mod alias;
pub mod arrow;
pub mod explain;
pub mod factors;
pub mod planes;
pub mod problem;
pub mod retrack;
pub mod size;
pub mod solve;
pub mod tangent;

pub use planes::{Corrected, Plane, planes};
