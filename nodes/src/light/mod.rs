//! What the kinds about recovered light share: connected regions of a panorama, distances in them, and
//! the measures light is judged by.

pub mod books;
pub mod energy;
pub(crate) mod env_resolution;
pub mod exposure;
pub mod holes;
pub mod level;
pub mod linear;
pub mod measure;
pub mod panorama;
pub mod regions;
pub mod spheres;
pub(crate) mod whole_sphere;
