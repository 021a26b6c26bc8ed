//! Boards and main loop of the tactile firmware; empty on a host.
#![cfg_attr(target_os = "none", no_std)]
