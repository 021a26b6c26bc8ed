//! A board that tracks in space with a bootstrap filter: frames in, frames out, for ever.
#![cfg_attr(target_os = "none", no_std, no_main)]

tactile_firmware::image!(SpatialDevice);
