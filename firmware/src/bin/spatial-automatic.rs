//! A board that tracks in space by faces, or by a curved surface where faces fail to foretell what is felt: frames
//! in, frames out, for ever.
#![cfg_attr(target_os = "none", no_std, no_main)]

tactile_firmware::image!(SpatialAutomaticDevice);
