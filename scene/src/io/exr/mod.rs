//! OpenEXR: reading one flat part as named f32 channels, and writing one part of named channels, with reproducible
//! bytes.

mod camera;
mod compression;
pub mod cryptomatte;
mod part;
mod planes;
mod read;
mod sorted;
#[cfg(test)]
mod tests;
mod write;

pub use camera::CameraMatrices;
pub use part::choose_part;
pub use planes::{Channel, Planes, differ_from_srgb};
pub use read::{Opened, open, read, read_for, read_layer};
pub use write::{Attributes, Depth, write, write_for};
