//! The kinds of lightharmony.
//!
//! Each kind is one file in [`kinds`] (a folder if it is large) with its documentation, parameters, ports, code and
//! unit tests, and one line in the table of this file. What kinds compute with is in the crates `render` and `scene`.
//! No kind imports another; [`program`] is for kinds that run installed programs.

use std::sync::OnceLock;

use engine::{KindEntry, Registry};
use kinds::*;

pub mod kinds;
pub mod program;

/// The kinds that [`add_kinds`] added.
static ADDED: OnceLock<Vec<fn() -> KindEntry>> = OnceLock::new();

/// Error of [`add_kinds`].
#[derive(Debug, thiserror::Error)]
pub enum AddKindsError {
    /// A kind has the name of another kind.
    #[error("two kinds are named `{0}`")]
    Name(&'static str),
    /// Kinds were added before.
    #[error("kinds were already added to this process; add all of them in one call")]
    Again,
}

/// Adds the kinds of another crate to [`registry`], for the whole process. Call it once, before the first graph is
/// parsed.
///
/// # Errors
/// If two kinds have the same name, or if kinds were added before.
pub fn add_kinds(kinds: Vec<fn() -> KindEntry>) -> Result<(), AddKindsError> {
    let mut names: Vec<&str> = built_in().iter().map(|kind| kind.name).collect();
    for kind in &kinds {
        let name = kind().name;
        if names.contains(&name) {
            return Err(AddKindsError::Name(name));
        }
        names.push(name);
    }
    ADDED.set(kinds).map_err(|_| AddKindsError::Again)
}

/// The table of all kinds: those of this crate, and those that [`add_kinds`] added.
pub fn registry() -> Registry {
    let registry = ADDED.get().into_iter().flatten().fold(built_in(), |registry, kind| registry.with(kind()));
    registry.lacking(
        "write-video",
        "build the program with `--features video`, or use `WriteAnimation` for an animated PNG",
    )
}

/// The table of the kinds of this crate.
fn built_in() -> Registry {
    Registry::new(vec![
        KindEntry::of::<adjust_light::AdjustLight>(),
        KindEntry::of::<alpha_shadow::AlphaShadow>(),
        KindEntry::of::<average_images::AverageImages>(),
        KindEntry::of::<bake_shadow::BakeShadow>(),
        KindEntry::of::<camera::Camera>(),
        KindEntry::of::<compare::Compare>(),
        KindEntry::of::<composite::Composite>(),
        KindEntry::of::<contact_sheet::ContactSheet>(),
        KindEntry::of::<crop_mesh::CropMesh>(),
        KindEntry::of::<cube_rig::CubeRig>(),
        KindEntry::of::<demo_scene::DemoScene>(),
        KindEntry::of::<denoise::Denoise>(),
        KindEntry::of::<extract_mesh::ExtractMesh>(),
        KindEntry::of::<fit_lights::FitLights>(),
        KindEntry::of::<fit_probe::FitProbe>(),
        KindEntry::of::<fuse_hdr::FuseHdr>(),
        KindEntry::of::<join_reports::JoinReports>(),
        KindEntry::of::<lamp::Lamp>(),
        KindEntry::of::<load_cameras::LoadCameras>(),
        KindEntry::of::<load_environment::LoadEnvironment>(),
        KindEntry::of::<load_image::LoadImage>(),
        KindEntry::of::<load_mesh::LoadMesh>(),
        KindEntry::of::<load_object::LoadObject>(),
        KindEntry::of::<load_panorama::LoadPanorama>(),
        KindEntry::of::<load_photos::LoadPhotos>(),
        KindEntry::of::<load_splats::LoadSplats>(),
        KindEntry::of::<object_mattes::ObjectMattes>(),
        KindEntry::of::<override_material::OverrideMaterial>(),
        KindEntry::of::<path_trace::PathTrace>(),
        KindEntry::of::<pick_cameras::PickCameras>(),
        KindEntry::of::<place::Place>(),
        KindEntry::of::<plane::Plane>(),
        KindEntry::of::<pose::PoseNode>(),
        KindEntry::of::<predict_exposure::PredictExposure>(),
        KindEntry::of::<region_masks::RegionMasks>(),
        KindEntry::of::<run_colmap::RunColmap>(),
        KindEntry::of::<run_ocio::RunOcio>(),
        KindEntry::of::<run_program::RunProgram>(),
        KindEntry::of::<score_env::ScoreEnv>(),
        KindEntry::of::<set_gloss::SetGloss>(),
        KindEntry::of::<shadow_ratio::ShadowRatio>(),
        KindEntry::of::<snap::Snap>(),
        KindEntry::of::<splat_panorama::SplatPanorama>(),
        KindEntry::of::<splat_render::SplatRender>(),
        KindEntry::of::<stitch::Stitch>(),
        KindEntry::of::<train_splats::TrainSplats>(),
        KindEntry::of::<write_animation::WriteAnimation>(),
        KindEntry::of::<write_exr::WriteExr>(),
        KindEntry::of::<write_image::WriteImage>(),
        KindEntry::of::<write_lut::WriteLut>(),
        KindEntry::of::<write_mesh::WriteMesh>(),
        KindEntry::of::<write_object::WriteObject>(),
        KindEntry::of::<write_report::WriteReport>(),
        KindEntry::of::<write_splats::WriteSplats>(),
    ])
}
