//! Paths: the light along the rays of one sample of one pixel, and the change that the objects make to it.

pub mod change;
pub(crate) mod direct_light;
pub mod double_count;
pub(crate) mod first_vertex;
pub mod guide;
pub(crate) mod incident;
pub mod integrator;
pub(crate) mod lamp_light;
pub mod light_points;
pub mod near_draws;
pub mod near_field;
#[expect(clippy::module_inception, reason = "the module contains the type of the same name")]
pub mod path;
pub(crate) mod places;
pub mod rays;
pub mod receiver_paths;
pub(crate) mod scattering;
pub(crate) mod transmittance;
pub mod visibility;
pub(crate) mod wide_lights;
