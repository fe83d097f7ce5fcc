//! The environment as a light: where it is bright, and directions in proportion to that.

pub(crate) mod cell_grid;
pub mod cone;
pub mod environment;
pub(crate) mod irradiance_bound;
pub(crate) mod light_cells;
pub(crate) mod light_distribution;
pub(crate) mod light_draws;
pub(crate) mod texel_grid;
