//! A board that tracks in space with hypotheses over pose and faces, and whose five fingertips have
//! sensors that show what the host scripts: the whole way from words to a pose without hardware.
#![cfg_attr(target_os = "none", no_std, no_main)]

tactile_firmware::image!(SpatialSensingDevice, tactile_core::device::Scripted::<_, 5>::new);
