//! Light transport: path tracing of a place, given by a mesh and a panorama, with objects inserted into it.
//!
//! It has six modules. Each uses only the modules below it in this table:
//!
//! | module | contents |
//! |---|---|
//! | [`picture`] | the images of a camera, traced in tiles and chunks of samples, and stored in parts |
//! | [`path`] | paths: the light of one sample of one pixel |
//! | [`ground`] | the surfaces that objects rest on, and the point of capture |
//! | [`scene`] | the receiver and the objects: geometry, materials, media |
//! | [`sky`] | the environment as a light, and cones of directions |
//! | [`bsdf`] | scattering at surfaces |

pub mod bsdf;
pub mod ground;
pub mod path;
pub mod picture;
pub mod scene;
pub mod sky;
