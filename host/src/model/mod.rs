//! What an object may be: bodies of few numbers that a surface is about, fitted faces, boxes less smaller
//! boxes, and mirror images.
//!
//! Each is fitted to contacts and says how well it explains them ([`misfit`]); which of them the contacts
//! make most probable is chosen in [`slam`](crate::slam). The surfaces themselves are those of
//! [`reference`](mod@crate::reference), with the same conventions: metres, the object frame, normals out
//! of the object, the dimension 2 or 3.

pub mod bare;
pub mod body;
pub mod doubt;
pub mod faces;
pub mod mirror;
pub mod misfit;
pub mod notched;
pub mod open;
pub mod places;

pub use body::Body;
pub use doubt::Doubt;
pub use faces::Faces;
pub use mirror::Mirror;
pub use open::Open;
