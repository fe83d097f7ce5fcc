//! Environment as a light source: importance sampling, cones of directions, bounds.

pub(crate) mod cell_grid;
pub mod cone;
pub mod defensive;
pub mod environment;
pub(crate) mod irradiance_bound;
pub(crate) mod light_cells;
pub(crate) mod light_distribution;
pub mod light_draws;
pub(crate) mod texel_grid;
