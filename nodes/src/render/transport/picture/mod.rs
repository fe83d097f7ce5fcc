//! Images: samples of pixels in tiles and chunks, cropping, sample plans, and stored parts.

pub(crate) mod accumulator;
pub(crate) mod bounds;
pub(crate) mod camera_rays;
pub(crate) mod crop;
pub mod film;
pub(crate) mod first_hit;
pub(crate) mod holes;
pub(crate) mod near_crop;
pub(crate) mod pair;
pub(crate) mod prepared;
pub(crate) mod sample_plan;
pub(crate) mod silhouette;
pub(crate) mod tile;
pub(crate) mod tile_bounds;
pub(crate) mod tracing;
pub(crate) mod window;
