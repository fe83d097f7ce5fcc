//! The kinds of nodes. Each kind is one file, or a folder if it is large.
//!
//! A kind holds its documentation, parameters, ports, code and unit tests. No kind imports another. Code that
//! several kinds need is in the crates `render` and `scene`.

pub mod adjust_light;
pub mod alpha_shadow;
pub mod bake_shadow;
pub mod camera;
pub mod compare;
pub mod composite;
pub mod contact_sheet;
pub mod crop_mesh;
pub mod cube_rig;
pub mod demo_scene;
pub mod denoise;
pub mod extract_mesh;
pub mod fit_lights;
pub mod fit_probe;
pub mod fuse_hdr;
pub mod join_reports;
pub mod lamp;
pub mod load_cameras;
pub mod load_environment;
pub mod load_image;
pub mod load_mesh;
pub mod load_object;
pub mod load_panorama;
pub mod load_photos;
pub mod load_splats;
pub mod override_material;
pub mod path_trace;
pub mod pick_cameras;
pub mod place;
pub mod plane;
pub mod pose;
pub mod predict_exposure;
pub mod region_masks;
pub mod run_colmap;
pub mod run_program;
pub mod score_env;
pub mod set_gloss;
pub mod shadow_ratio;
pub mod snap;
pub mod splat_panorama;
pub mod splat_render;
pub mod stitch;
pub mod train_splats;
pub mod write_animation;
pub mod write_exr;
pub mod write_image;
pub mod write_lut;
pub mod write_mesh;
pub mod write_object;
pub mod write_report;
pub mod write_splats;
