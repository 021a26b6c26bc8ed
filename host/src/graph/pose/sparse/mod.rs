//! Sparse symmetric systems made of square blocks: one block row and column for every pose.
//!
//! [`Structure`] is what depends on the graph alone: the order of elimination and the supernodes of
//! the factor. It counts in blocks, so one structure serves systems of any block size over the same
//! graph (poses, rotations, translations). [`BlockMatrix`] holds the numbers and [`Factor`] their
//! Cholesky factorisation by the multifrontal method (Duff and Reid 1983; Liu 1992): every supernode
//! gathers what its children leave in one small dense matrix and eliminates its own columns there.
//! Where the factor would be too large, that of a part of the matrix preconditions
//! [`conjugate_gradients`].

mod conjugate;
mod factor;
mod front;
mod inverse;
mod matrix;
mod path;
mod structure;

pub use conjugate::{Reached, conjugate_gradients};
pub use factor::{Factor, NotPositive, numbers};
pub use inverse::SelectedInverse;
pub use matrix::BlockMatrix;
pub use path::Paths;
pub use structure::{Structure, TooDense};

#[cfg(test)]
mod tests;
