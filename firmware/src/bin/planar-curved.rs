//! A board that tracks curved objects in the plane by trajectories over one surface: frames in, frames out, for ever.
#![cfg_attr(target_os = "none", no_std, no_main)]

tactile_firmware::image!(PlanarCurvedDevice);
