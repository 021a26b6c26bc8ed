//! Whole runs of `tactile`, one by one: every file they leave and every input they refuse.
//! `tests/cli.rs` beside this folder has the short tour.

mod bad_input;
mod binary;
mod optimize;
mod results;
mod safe;
