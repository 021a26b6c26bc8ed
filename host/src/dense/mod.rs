//! Dense double-precision linear algebra and kernel sums at the speed of the machine: what the
//! host's Gaussian process spends its time in.
//!
//! The same algorithms run with vectors of 512 or 256 bits where the processor has them, and in
//! plain arithmetic elsewhere; which, is decided when the program runs. Paths differ by rounding
//! alone. [`reference`](mod@crate::reference) keeps plain versions of everything here, and the
//! tests hold the two together.

pub mod cholesky;
pub mod expansion;
mod exponential;
mod panel;
mod radial;
pub(crate) mod simd;

pub use cholesky::{Cholesky, Lower};
pub use expansion::{Functional, Sites};
