//! Dense double-precision linear algebra and kernel sums at the speed of the machine: what the
//! host's Gaussian process spends its time in.
//!
//! The same algorithms run with vectors of 512 or 256 bits where the processor has them, and in
//! plain arithmetic elsewhere; which, is decided when the program runs. Paths differ by rounding
//! alone. [`reference`](mod@crate::reference) keeps plain versions of everything here, and the
//! tests hold the two together.

mod aligned;
pub mod cholesky;
pub mod expansion;
mod explained;
mod exponential;
mod lower;
mod panel;
mod radial;
mod sides;
pub(crate) mod simd;
mod substitute;
mod sum;

pub use cholesky::Cholesky;
pub use expansion::{Functional, Sites};
pub use lower::Lower;
pub use sum::Weighted;
