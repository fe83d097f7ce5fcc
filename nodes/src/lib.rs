//! The kinds of lightharmony.
//!
//! One kind is one file (a folder when large) with its doc, parameters, ports, code and unit tests, and
//! one line in [`registry`]. `types` holds what travels along wires, `io` the file formats; `num`,
//! `color`, `equirect`, `sampling` and `bvh` are what several kinds share.

use engine::{KindEntry, Registry};

pub mod alpha_shadow;
pub mod bvh;
pub mod camera;
pub mod color;
pub mod compare;
pub mod composite;
pub mod contact_sheet;
pub mod crop_mesh;
pub mod cube_rig;
pub mod demo_scene;
pub mod denoise;
pub mod equirect;
pub mod error;
pub mod fit_probe;
pub mod fuse_hdr;
pub mod inspect;
pub mod io;
pub mod join_reports;
pub mod layers;
pub mod light;
pub mod load_cameras;
pub mod load_environment;
pub mod load_image;
pub mod load_mesh;
pub mod load_object;
pub mod load_panorama;
pub mod load_splats;
pub mod metrics;
pub mod nn;
pub mod num;
pub mod override_material;
pub mod path_trace;
pub mod place;
pub mod pose;
pub mod predict_exposure;
pub mod region_masks;
pub mod render;
pub mod resting;
pub mod sampling;
pub mod save_splats;
pub mod score_env;
pub mod shadow_ratio;
pub mod snap;
pub mod splat;
pub mod splat_panorama;
pub mod splat_render;
pub mod stitch;
pub mod support;
pub mod types;
mod whole_sphere;
pub mod write_animation;
pub mod write_exr;
pub mod write_image;
pub mod write_report;

#[cfg(test)]
mod testing;

pub use error::Error;

/// Every kind, by name.
pub fn registry() -> Registry {
    Registry::new(vec![
        KindEntry::of::<alpha_shadow::AlphaShadow>(),
        KindEntry::of::<camera::Camera>(),
        KindEntry::of::<compare::Compare>(),
        KindEntry::of::<composite::Composite>(),
        KindEntry::of::<contact_sheet::ContactSheet>(),
        KindEntry::of::<crop_mesh::CropMesh>(),
        KindEntry::of::<cube_rig::CubeRig>(),
        KindEntry::of::<demo_scene::DemoScene>(),
        KindEntry::of::<denoise::Denoise>(),
        KindEntry::of::<fit_probe::FitProbe>(),
        KindEntry::of::<fuse_hdr::FuseHdr>(),
        KindEntry::of::<join_reports::JoinReports>(),
        KindEntry::of::<load_cameras::LoadCameras>(),
        KindEntry::of::<load_environment::LoadEnvironment>(),
        KindEntry::of::<load_image::LoadImage>(),
        KindEntry::of::<load_mesh::LoadMesh>(),
        KindEntry::of::<load_object::LoadObject>(),
        KindEntry::of::<load_panorama::LoadPanorama>(),
        KindEntry::of::<load_splats::LoadSplats>(),
        KindEntry::of::<override_material::OverrideMaterial>(),
        KindEntry::of::<path_trace::PathTrace>(),
        KindEntry::of::<place::Place>(),
        KindEntry::of::<pose::PoseNode>(),
        KindEntry::of::<predict_exposure::PredictExposure>(),
        KindEntry::of::<region_masks::RegionMasks>(),
        KindEntry::of::<score_env::ScoreEnv>(),
        KindEntry::of::<shadow_ratio::ShadowRatio>(),
        KindEntry::of::<snap::Snap>(),
        KindEntry::of::<splat_panorama::SplatPanorama>(),
        KindEntry::of::<splat_render::SplatRender>(),
        KindEntry::of::<stitch::Stitch>(),
        KindEntry::of::<write_animation::WriteAnimation>(),
        KindEntry::of::<write_exr::WriteExr>(),
        KindEntry::of::<write_image::WriteImage>(),
        KindEntry::of::<write_report::WriteReport>(),
    ])
}
