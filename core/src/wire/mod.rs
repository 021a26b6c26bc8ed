//! Frames between board and host.
