//! `run-colmap`: poses and points from photographs, by an installed COLMAP.

mod align;
mod choices;
mod model;
mod steps;
#[cfg(all(test, unix))]
mod tests;
mod tool;

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Kind, NodeError, Notes, SourceFile, SourceRoot,
};
use scene::io::capture::pictures::{Listing, listing};
use scene::io::picture::floats_of;
use scene::types::{Photo, Photos, Report, Rig};

use crate::program::WorkFolder;
pub use choices::{Lens, Matching};
use steps::{Options, Steps};
use tool::Tool;

engine::choices! {
    /// The coordinates of the result.
    pub enum Alignment {
        /// The vertical of the cameras becomes the up axis of the scene, the ground below the points becomes the height 0,
        /// the middle of the points the origin, and `camera_height_metres` sets the scale.
        Upright,
        /// The coordinates of COLMAP, in which orientation, origin and scale are arbitrary.
        AsReconstructed,
    }
}
engine::params! {
    /// Finds the poses of photographs with COLMAP, which must be installed.
    ///
    /// COLMAP finds points that several photographs show, from these the lens and the position of each camera, and at
    /// last removes the distortion of the lens from the photographs. The outputs suit `train-splats` directly. All
    /// photographs should show the same unchanged place, with much overlap, from different positions.
    ///
    /// The program is `colmap` if it is in `PATH`, and otherwise the Python package `pycolmap`; `program` chooses
    /// another. It runs on the CPU, in a temporary folder of its own. The result is stored like any other, with a key
    /// that contains the photographs and the content of the program's file. But COLMAP is not expected to give the same
    /// bytes twice: the node is never computed on another machine, its result is not shared, and `verify` reports it as
    /// `external`. A graph from others cannot run programs.
    pub struct RunColmap {
        /// Folder of the photographs: PNG or JPEG.
        path: InputFile, other("\"photos_b\"");
        /// Maximum width and height of the undistorted photographs, and so the size of training. Poses are found at the
        /// full size.
        largest_side_px: u32 = 640, range(16, 65536), unit("px"), other("32"), inert("the program scales the photographs");
        /// The pairs of photographs that are compared.
        matching: Matching = Matching::Exhaustive, other("Sequential"), inert("another order may give an equal result");
        /// The lens model that is fitted.
        lens: Lens = Lens::SimpleRadial, other("Pinhole"), inert("the program fits the lens");
        /// True if one camera with one focal length took all photographs. False fits a lens for each of them.
        same_camera: bool = true, other("false"), inert("the program fits the lens");
        /// Minimum share of photographs whose pose must be found, from 0 to 1. Below it, the node fails. Below 0.9, there
        /// is a warning.
        least_share: f64 = 0.5, range(0.0, 1.0), other("0.6"), inert("the share is only compared");
        /// The coordinates of the result.
        alignment: Alignment = Alignment::Upright, other("AsReconstructed");
        /// Median height of the cameras above the ground, which sets the scale: photographs alone do not contain the size
        /// of a place. Measure a known length in the result, and correct this number in proportion.
        camera_height_metres: f64 = 1.5, range(0.001, 100000), unit("m"), other("3.0");
        /// The program instead of `colmap` or `python3`: a name or a path with a `/`, relative to the graph file. If its
        /// name begins with `python`, it is a Python with the package `pycolmap`.
        program: Option<String> = None, other("Some(\"./colmap-b.sh\")");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`RunColmap`].
    pub struct Out {
        /// The undistorted photographs with their cameras, and the points.
        photos: Arc<Photos>,
        /// The cameras of the photographs.
        rig: Arc<Rig>,
        /// Table `reconstruction` with the share of photographs, errors and counts, and `cameras` with the names of
        /// photographs whose pose was not found.
        report: Arc<Report>,
    }
}

/// Minimum number of photographs.
const FEWEST: usize = 3;
/// Share of photographs with poses below which there is a warning.
const GOOD_SHARE: f64 = 0.9;
/// Mean reprojection error in pixels above which there is a warning. COLMAP usually reaches 0.3 to 1.
const GOOD_ERROR_PX: f64 = 1.5;

impl RunColmap {
    /// The photographs in the folder.
    fn pictures(&self, root: &SourceRoot) -> Result<Listing, NodeError> {
        let mut found = listing(&self.path, root).map_err(|e| e.at("path"))?;
        found.retain(|_, file| {
            let lower = file.0.to_lowercase();
            [".png", ".jpg", ".jpeg"].iter().any(|ending| lower.ends_with(ending))
        });
        if found.len() < FEWEST {
            let what = format!(
                "`{}` contains {} PNG or JPEG files, but poses need at least {FEWEST}",
                self.path.0,
                found.len()
            );
            return Err(NodeError::new(what)
                .at("path")
                .hint("a place needs 40 photographs or more, with much overlap"));
        }
        Ok(found)
    }
}

impl Kind for RunColmap {
    const NAME: &'static str = "run-colmap";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const FOLDERS: bool = true;
    const PROFILE: &'static str = "external";
    const RUNS_PROGRAMS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let mut sources =
            vec![root.program("colmap", || Tool::find(p.program.as_deref(), root).map(Tool::identity))?];
        sources.extend(p.pictures(root)?.values().map(|file| root.file(file)));
        Ok(sources)
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        // COLMAP has several photographs in memory at once, and a cache of descriptors.
        let each = files.iter().skip(1).map(|file| floats_of(file)[0].saturating_mul(4)).max().unwrap_or(0);
        Cost { bytes: each.saturating_mul(4).saturating_add(1 << 29) }
    }

    fn run(p: &Self, _: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        cx.check_listed(&Self::sources(p, cx.root())?)?;
        let files = p.pictures(cx.root())?;
        let folder = WorkFolder::new()?;
        let mut names = Vec::with_capacity(files.len());
        for file in files.values() {
            cx.check()?;
            let name = file.0.rsplit('/').next().unwrap_or(&file.0);
            folder.write(&format!("photos/{name}"), &cx.read(file).map_err(|e| e.at("path"))?)?;
            names.push(name.to_owned());
        }
        let tool = Tool::find(p.program.as_deref(), cx.root())?;
        let options = Options {
            lens: p.lens,
            matching: p.matching,
            same_camera: p.same_camera,
            largest_side_px: p.largest_side_px,
        };
        let steps = Steps { options, tool: &tool, folder: &folder, photographs: names.len(), cx };
        let version = steps.version()?;
        let chosen = steps.reconstruct()?;
        let mut found = model::read(&folder, cx)?;
        drop(folder);
        let mut notes = Notes::none();
        p.judge(&found, &names, chosen.others, &mut notes)?;
        if p.alignment == Alignment::Upright {
            align::upright(&mut found, p.camera_height_metres, cx, &mut notes);
        }
        let report = model::report(&found, &names, &version);
        cx.count("photographs", found.photos.len() as u64);
        cx.count("points", found.points.len() as u64);
        let rig = Rig { cameras: found.photos.iter().map(|photo| photo.camera.clone()).collect() };
        let points = found.points.iter().map(|scored| scored.point).collect();
        let photos: Vec<Photo> = found.photos;
        let out =
            Out { photos: Arc::new(Photos { photos, points }), rig: Arc::new(rig), report: Arc::new(report) };
        Ok((out, notes))
    }
}

impl RunColmap {
    /// Checks how many photographs have a pose, and how well they agree on the points.
    fn judge(
        &self,
        found: &model::Reconstruction,
        names: &[String],
        others: usize,
        notes: &mut Notes,
    ) -> Result<(), NodeError> {
        let (with, all) = (found.photos.len(), names.len());
        let share = with as f64 / all as f64;
        let text = format!("COLMAP found the poses of {with} of {all} photographs ({:.0} %)", share * 100.0);
        let advice = "take more photographs between those without a pose, with more overlap and sharper, or remove them; \
                      the table `cameras` of `report` lists them";
        if with < FEWEST || share < self.least_share {
            let missing = found.missing(names);
            let some = missing.iter().take(5).copied().collect::<Vec<_>>().join(", ");
            let more = if missing.len() > 5 { ", .." } else { "" };
            let what =
                format!("{text}, and `least_share` is {}; without a pose: {some}{more}", self.least_share);
            return Err(NodeError::new(what).at("path").hint(
                "take more photographs with more overlap between neighbours; a lower `least_share` accepts the result",
            ));
        }
        if share < GOOD_SHARE {
            notes.warning("few-poses", format!("{text}; {advice}"));
        }
        let error = found.error_px();
        if error > GOOD_ERROR_PX {
            let text = format!(
                "the mean reprojection error is {error:.2} pixels, and a good reconstruction has less than \
                 {GOOD_ERROR_PX}; try `lens: OpenCv`, or `same_camera: false` if the zoom changed"
            );
            notes.warning("reprojection-error", text);
        }
        if others > 0 {
            let text = format!(
                "the photographs fell into {} parts that COLMAP could not join; the largest is used",
                others + 1
            );
            notes.warning("several-models", text);
        }
        Ok(())
    }
}
