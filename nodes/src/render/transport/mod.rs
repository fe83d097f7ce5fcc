//! Light transport: path tracing of a place, a mesh and a panorama, with objects inserted into it.
//!
//! Six rooms. Each uses only the rooms below it:
//!
//! | room | what |
//! |---|---|
//! | [`picture`] | the pictures of a camera, in tiles, chunks of samples and stored parts |
//! | [`path`] | paths: what one sample of one pixel finds |
//! | [`ground`] | what objects rest on, and where the panorama was captured |
//! | [`scene`] | the receiver and the objects: geometry, materials, media |
//! | [`sky`] | the environment as a light, and cones of directions |
//! | [`bsdf`] | how surfaces scatter light |

pub mod bsdf;
pub mod ground;
pub mod path;
pub mod picture;
pub mod scene;
pub mod sky;
