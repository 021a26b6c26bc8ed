//! The surface models of the core.
