//! Files of Gaussian splats, read and written: INRIA PLY, PlayCanvas compressed PLY, SOG, SPZ, `.splat`, `.ksplat`
//! and glTF with `KHR_gaussian_splatting`.

mod accessor;
mod bytes;
mod files;
mod fixed_rows;
mod frame;
mod gltf;
mod inflate;
mod ksplat;
mod loaded;
mod parts;
mod ply;
mod ply_packed;
mod reader;
mod reading;
mod rows;
pub mod save;
mod sh_turn;
pub mod size;
mod sog;
mod source;
mod splat;
mod spz;
mod stated_up;
pub(crate) mod streamed;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests;
mod training;
mod usda;
mod zip;

pub use files::SplatFiles;
pub use frame::{Frame, Turn, from_y_up, quaternion};
pub use reader::from_bytes;
pub(crate) use rows::unit;
pub use rows::{Row, RowFault, SH_C0, sh_rest};
pub use sh_turn::ShTurn;
pub use source::Format;
pub(crate) use spz::{COLOUR_SCALE as SPZ_COLOUR_SCALE, rotation_10 as spz_rotation};
pub use stated_up::StatedUp;
