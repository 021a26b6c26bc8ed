//! # tactile-core
//!
//! Tactile SLAM for a microcontroller: from fingertip contacts alone, the shape of an unknown
//! object *and* its pose. No heap, no panic reachable from any input; every capacity
//! is a const generic and reaching it is an ordinary event that the [`track::Estimate`] reports.
//!
//! Data flows one way:
//!
//! ```text
//! contact::Contact → contact::Grasp → track::Tracker → track::Estimate → wire::Frame
//!                                       │ surface::Map + pose belief
//!                                       └ explore::choose: the grasp to make next
//! ```
//!
//! Everything is generic over [`space::Space`]: [`space::Planar`] (three degrees of freedom) and
//! [`space::Spatial`] (six). Units are SI; contacts arrive in the `world` frame, the surface lives
//! in the `object` frame, and a pose maps object to world.
//!
//! Arithmetic is `f32` and uses only the operations of [`math`], without fused multiply-add, so the
//! same input gives the same bits on x86-64 and on a Cortex-M4F.
#![no_std]
#![deny(unsafe_code)] // only `math` (the FPU's square root) and `surface::cholesky::products` (assembly) allow it

#[cfg(test)]
extern crate std;

pub mod accurate;
pub mod contact;
pub mod device;
pub mod driver;
pub mod explore;
pub mod math;
pub mod matrix;
pub mod random;
pub mod sensing;
pub mod space;
pub mod surface;
pub mod track;
pub mod wire;
