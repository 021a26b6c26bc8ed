//! The command line `tactile`.
fn main() {}
