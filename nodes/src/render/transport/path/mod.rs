//! Paths: the light that one sample of one pixel finds, and what the objects change of it.

pub(crate) mod change;
pub(crate) mod direct_light;
pub(crate) mod double_count;
pub mod integrator;
pub(crate) mod lamp_light;
pub(crate) mod light_points;
pub mod near_field;
pub(crate) mod path;
pub(crate) mod rays;
pub(crate) mod scattering;
pub(crate) mod transmittance;
pub mod visibility;
