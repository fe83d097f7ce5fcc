//! File formats: bytes to values and back. Nothing here reads a file or knows of nodes; every size is
//! checked against the bytes at hand before memory is taken, and hostile bytes give a typed error.

pub(crate) mod base64;
pub mod exr;
pub mod gltf;
pub mod gpano;
pub mod hdr;
pub mod head;
pub mod icc;
pub mod jpeg;
pub mod mesh;
pub mod picture;
pub mod ply;
pub mod png;
mod png_pack;
pub mod quantise;
pub mod recipe;
pub mod splats;
pub mod stretch;
pub mod webp;
