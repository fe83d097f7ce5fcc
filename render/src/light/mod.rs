//! Light of panoramas: measures of recovered light, connected regions, exposure, filling of holes, and files that
//! show a whole sphere.

pub mod balance;
pub mod emitters;
pub mod energy;
pub mod energy_table;
pub mod env_resolution;
pub mod exposure;
pub mod hidden;
pub mod holes;
pub mod level;
pub mod linear;
pub mod measure;
pub mod panorama;
pub mod regions;
pub mod spheres;
pub mod whole_sphere;
