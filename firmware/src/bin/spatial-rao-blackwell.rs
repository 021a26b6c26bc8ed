//! A board that tracks in space with particles that own their faces: frames in, frames out, for ever.
#![cfg_attr(target_os = "none", no_std, no_main)]

tactile_firmware::image!(SpatialRaoBlackwellDevice);
