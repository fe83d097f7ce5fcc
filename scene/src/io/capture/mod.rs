//! Captures: the cameras and points of COLMAP models, and the photographs of a folder.

pub mod codes;
pub mod colmap;
pub mod distortion;
pub mod pictures;
pub mod points;
pub mod raw;
pub mod write;
