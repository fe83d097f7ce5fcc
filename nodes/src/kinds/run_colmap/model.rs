//! The result of COLMAP: undistorted photographs, cameras and points.

use std::collections::BTreeSet;

use engine::{Context, NodeError, Notes};
use scene::error::Error;
use scene::io::capture::codes::{codes, of_size};
use scene::io::capture::colmap;
use scene::io::capture::distortion::INVISIBLE_PX;
use scene::io::capture::points::{self, ScoredPoint};
use scene::io::picture::{FileEncoding, decode};
use scene::io::progress::Progress;
use scene::types::pick::stem;
use scene::types::{Camera, Cell, Lens, Photo, Report, Table};

use crate::program::WorkFolder;

/// A reconstruction.
pub struct Reconstruction {
    /// The undistorted photographs with a pose, in the order of their names.
    pub photos: Vec<Photo>,
    /// The points.
    pub points: Vec<ScoredPoint>,
}

impl Reconstruction {
    /// Mean reprojection error of the points in pixels, as COLMAP states it; 0 without points.
    pub fn error_px(&self) -> f64 {
        let sum: f64 = self.points.iter().map(|scored| scored.error_px).sum();
        if self.points.is_empty() { 0.0 } else { sum / self.points.len() as f64 }
    }

    /// The photographs without a pose.
    pub fn missing<'n>(&self, names: &'n [String]) -> Vec<&'n str> {
        let with: BTreeSet<&str> = self.photos.iter().map(|photo| photo.camera.name.as_str()).collect();
        names.iter().map(String::as_str).filter(|name| !with.contains(stem(name))).collect()
    }
}

/// Reads the undistorted photographs and their model from the folder of outputs.
///
/// # Errors
/// If a file is missing or damaged.
pub fn read(folder: &WorkFolder, cx: &Context) -> Result<Reconstruction, NodeError> {
    let program = "COLMAP (undistortion)";
    let output = |file: &str| folder.output(file, program, "its other steps succeeded");
    let [cameras, images, found] =
        ["cameras", "images", "points3D"].map(|name| output(&format!("sparse/{name}.bin")));
    let raw = colmap::binary("COLMAP", &cameras?, &images?)?;
    let mut scored = points::binary("COLMAP", &found?)?;
    scored.retain(|one| one.point.position.iter().all(|v| v.is_finite()) && one.error_px.is_finite());
    let mut photos = Vec::with_capacity(raw.len());
    // Notes on the metadata of the pictures were already reported for the input photographs.
    let mut ignored = Notes::none();
    let count = raw.len();
    for (index, raw) in raw.iter().enumerate() {
        cx.progress(0.97 + 0.03 * index as f32 / count as f32);
        cx.check()?;
        if raw.distortion.as_ref().is_some_and(|bend| bend.pixels.is_nan() || bend.pixels > INVISIBLE_PX) {
            return Err(
                Error::format("COLMAP", format!("left the photograph `{}` distorted", raw.picture)).into()
            );
        }
        let size = |side: u64| u32::try_from(side).ok().filter(|side| (1..=65_536).contains(side));
        let (Some(width_px), Some(height_px)) = (size(raw.width), size(raw.height)) else {
            return Err(Error::format("COLMAP", format!("gave `{}` no valid size", raw.picture)).into());
        };
        let [fx, fy, cx_px, cy_px] = raw.lens;
        let camera = Camera {
            name: stem(&raw.picture).to_owned(),
            width_px,
            height_px,
            fx,
            fy,
            cx: cx_px,
            cy: cy_px,
            lens: Lens::PINHOLE,
            world_from_camera: raw.world_from_camera.to_cols_array(),
        };
        if !raw.lens.iter().chain(&camera.world_from_camera).all(|v| v.is_finite()) || fx <= 0.0 || fy <= 0.0
        {
            return Err(Error::format(
                "COLMAP",
                format!("gave `{}` a camera that is not valid", raw.picture),
            )
            .into());
        }
        let bytes = output(&format!("images/{}", raw.picture))?;
        let picture =
            decode(FileEncoding::Auto, "", &raw.picture, &bytes, &mut ignored, Progress::of(cx, 0.97, 1.0))?;
        let pixels = codes(&of_size(picture, &camera).map_err(|e| NodeError::new(e.to_string()).at("path"))?);
        photos.push(Photo { camera, pixels });
    }
    Ok(Reconstruction { photos, points: scored })
}

/// The report of a reconstruction.
pub fn report(found: &Reconstruction, names: &[String], version: &str) -> Report {
    let observations: u64 = found.points.iter().map(|scored| scored.observations).sum();
    let per = |count: usize| {
        if count == 0 { Cell::Missing } else { Cell::Number(observations as f64 / count as f64) }
    };
    let rows = vec![
        vec![Cell::Text("program".to_owned()), Cell::Text(version.to_owned())],
        vec![Cell::Text("photographs".to_owned()), Cell::Count(names.len() as u64)],
        vec![Cell::Text("photographs with a pose".to_owned()), Cell::Count(found.photos.len() as u64)],
        vec![Cell::Text("points".to_owned()), Cell::Count(found.points.len() as u64)],
        vec![Cell::Text("mean reprojection error (px)".to_owned()), Cell::Number(found.error_px())],
        vec![Cell::Text("mean observations per point".to_owned()), per(found.points.len())],
        vec![Cell::Text("mean observations per photograph".to_owned()), per(found.photos.len())],
    ];
    let with = found.photos.iter().map(|photo| (photo.camera.name.as_str(), "yes"));
    let missing = found.missing(names);
    let all = with.chain(missing.into_iter().map(|name| (stem(name), "no")));
    let cameras =
        all.map(|(name, pose)| vec![Cell::Text(name.to_owned()), Cell::Text(pose.to_owned())]).collect();
    Report {
        title: "Poses of photographs".to_owned(),
        tables: vec![
            Table::new("reconstruction", ["quantity", "value"], rows),
            Table::new("cameras", ["photograph", "pose found"], cameras),
        ],
    }
}
