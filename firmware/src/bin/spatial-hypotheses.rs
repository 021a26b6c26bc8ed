//! A board that tracks in space with hypotheses over pose and faces: frames in, frames out, for ever.
#![cfg_attr(target_os = "none", no_std, no_main)]

tactile_firmware::image!(SpatialHypothesesDevice);
