//! Images: samples of pixels in tiles and chunks, cropping, sample plans, and stored parts.
//!
//! R0 is the light of the receiver without objects, R1 the light of the receiver with objects, O the light of the
//! objects themselves, and S the ratio R1 / R0. A chunk is a range of samples. A part is a result that is stored
//! and reused by later runs, such as the sums over a chunk for an area of the image.

pub mod accumulator;
pub(crate) mod bounds;
pub mod camera_rays;
pub(crate) mod crop;
pub mod film;
pub mod first_hit;
pub mod holes;
pub(crate) mod near_crop;
pub mod pair;
pub mod prepared;
pub mod r0;
pub(crate) mod sample_plan;
pub mod shown_objects;
pub(crate) mod silhouette;
pub mod splat_rays;
pub(crate) mod sums;
pub mod tile;
pub(crate) mod tile_bounds;
pub mod tracing;
pub(crate) mod window;
