//! `load-photos`: posed photographs of a place.

use std::sync::Arc;

use engine::{Context, Cost, FileHead, InputFile, Kind, NodeError, Notes, SourceFile, SourceRoot, Wired};
use scene::io::capture::codes::{codes, masked, of_size};
use scene::io::capture::pictures::{Listing, file_of, listing};
use scene::io::capture::points;
use scene::io::foreign::refuse_placeholder;
use scene::io::picture::{FileEncoding, decode, floats_of};
use scene::io::progress::Progress;
use scene::types::layers::matching;
use scene::types::{Camera, Images, Photo, Photos, Picture, Rig};

engine::params! {
    /// Joins cameras and their photographs, for training splats.
    ///
    /// The cameras come from `load-cameras`, which reads COLMAP, nerfstudio and other formats. The photograph of a
    /// camera is the file of the folder `path` whose name without extension is the name of the camera; or, if the
    /// graph has pictures of the cameras already, the view of the input `image` with that name. Photographs that
    /// are larger than the picture of their camera are scaled down to its size, so `resolution` of `load-cameras`
    /// sets the size of training. Linear pictures are converted to display values, since splats are trained on
    /// these. Values are rounded to 8 bits per channel.
    pub struct LoadPhotos {
        /// Folder of the photographs: PNG, JPEG, OpenEXR or Radiance HDR.
        path: Option<InputFile> = None, other("Some(\"photos_b\")");
        /// Folder of masks. The mask of a photograph has the same name, with any extension. Pixels whose first
        /// channel is below 0.5 are ignored in training. Photographs without a mask are used in full. The
        /// transparent part of a photograph with an alpha channel is ignored as well.
        masks: Option<InputFile> = None, other("Some(\"masks\")");
        /// Points on the surfaces of the place, in the coordinates of the cameras: `points3D.bin` or `points3D.txt`
        /// of COLMAP. Training begins with splats at these points.
        points: Option<InputFile> = None, other("Some(\"points3D.txt\")");
    }
}
engine::inputs! {
    /// Inputs of [`LoadPhotos`].
    pub struct In {
        /// The cameras.
        rig: Arc<Rig>,
        /// Pictures of the cameras, if they are not in a folder.
        image: Option<Arc<Images>>,
    }
}
engine::outputs! {
    /// Outputs of [`LoadPhotos`].
    pub struct Out {
        /// The photographs with their cameras, and the points.
        photos: Arc<Photos>,
    }
}

impl Kind for LoadPhotos {
    const NAME: &'static str = "load-photos";
    const VERSION: u32 = 2;
    const FOLDERS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check_wires(p: &Self, wired: &Wired) -> Result<(), NodeError> {
        match (&p.path, wired.of("image").is_empty()) {
            (None, true) => Err(NodeError::new("there are no photographs")
                .at("path")
                .hint("set `path` to the folder of the photographs, or connect `image`")),
            (Some(_), false) => Err(NodeError::new("`path` is set and `image` is connected")
                .at("path")
                .hint("the photographs come either from a folder or from the graph; remove one of the two")),
            _ => Ok(()),
        }
    }

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let mut sources = Vec::new();
        for (field, folder) in [("path", &p.path), ("masks", &p.masks)] {
            let Some(folder) = folder else { continue };
            let files = listing(folder, root).map_err(|e| e.at(field))?;
            sources.extend(files.values().map(|file| root.file(file)));
        }
        sources.extend(p.points.iter().map(|file| root.file(file)));
        Ok(sources)
    }

    fn estimate(_: &Self, inputs: &In) -> Cost {
        let pixels = |camera: &Camera| u64::from(camera.width_px) * u64::from(camera.height_px) * 4;
        Cost { bytes: inputs.rig.cameras.iter().map(pixels).fold(0, u64::saturating_add) }
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        // Photographs are read one after the other.
        let most = |file: &FileHead<'_>| {
            let [reading, floats] = floats_of(file);
            reading.saturating_add(floats.saturating_mul(2)).max(file.bytes.saturating_mul(2))
        };
        Cost { bytes: files.iter().map(most).max().unwrap_or(0) }
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        cx.check_listed(&Self::sources(p, cx.root())?)?;
        let mut notes = Notes::none();
        let list =
            |folder: &Option<InputFile>| folder.as_ref().map(|folder| listing(folder, cx.root())).transpose();
        let (files, masks) = (list(&p.path)?, list(&p.masks)?);
        if let Some(camera) = inputs.rig.distorted() {
            let error = NodeError::new(format!("camera `{}` has lens distortion", camera.name)).at("rig");
            return Err(error.hint("training needs undistorted photographs (`colmap image_undistorter`)"));
        }
        let cameras = &inputs.rig.cameras;
        let mut photos = Vec::with_capacity(cameras.len());
        let (mut clear, mut unmasked) = (0_u64, 0_u64);
        for (index, camera) in cameras.iter().enumerate() {
            let progress = Progress::of(cx, 0.0, 1.0).piece(index, cameras.len());
            progress.report(0.0)?;
            let size = (camera.width_px as usize, camera.height_px as usize);
            let picture = match (&files, &inputs.image) {
                (Some(files), _) => {
                    let file = file_of(files, camera).ok_or_else(|| missing(p, camera))?;
                    read(file, FileEncoding::Auto, cx, &mut notes, progress).map_err(|e| e.at("path"))?
                }
                (None, Some(images)) => matching(images, "image", &camera.name, size)?.clone(),
                (None, None) => return Err(NodeError::new("there are no photographs").at("path")),
            };
            let mut pixels = codes(&of_size(picture, camera)?);
            clear += pixels.iter().filter(|pixel| pixel[3] == 0).count() as u64;
            if let Some(masks) = &masks {
                match masks.get(&camera.name) {
                    Some(file) => {
                        let mask = read(file, FileEncoding::Data, cx, &mut notes, progress);
                        masked(&mut pixels, &of_size(mask.map_err(|e| e.at("masks"))?, camera)?);
                    }
                    None => unmasked += 1,
                }
            }
            if pixels.iter().all(|pixel| pixel[3] == 0) {
                let what = format!("the photograph `{}` has no pixel that is not masked", camera.name);
                let hint = "in a mask, pixels that are used are white, and ignored pixels are black";
                return Err(NodeError::new(what)
                    .at(if masks.is_some() { "masks" } else { "path" })
                    .hint(hint));
            }
            photos.push(Photo { camera: camera.clone(), pixels });
        }
        report(&mut notes, files.as_ref(), photos.len(), [clear, unmasked]);
        let points = match &p.points {
            Some(file) => {
                points::read(&file.0, &cx.read(file)?).map_err(|e| NodeError::from(e).at("points"))?
            }
            None => Vec::new(),
        };
        cx.count("photographs", photos.len() as u64);
        cx.count("points", points.len() as u64);
        Ok((Out { photos: Arc::new(Photos { photos, points }) }, notes))
    }
}

/// Adds notes about files that are not used and pixels that are ignored.
fn report(notes: &mut Notes, files: Option<&Listing>, used: usize, [clear, unmasked]: [u64; 2]) {
    let unused = files.map_or(0, |files| files.len().saturating_sub(used)) as u64;
    notes.count("photos-unused", unused, "of the pictures in the folder have no camera and are not used");
    notes.count("photos-unmasked", unmasked, "of the photographs have no mask and are used in full");
    notes.count("pixels-clear", clear, "of the pixels are transparent and are ignored in training");
}

/// Decodes a picture.
fn read(
    file: &InputFile,
    encoding: FileEncoding,
    cx: &Context,
    notes: &mut Notes,
    progress: Progress<'_>,
) -> Result<Picture, NodeError> {
    let bytes = cx.read(file)?;
    refuse_placeholder(&file.0, &bytes)?;
    Ok(decode(encoding, "", &file.0, &bytes, notes, progress)?)
}

fn missing(p: &LoadPhotos, camera: &Camera) -> NodeError {
    let folder = p.path.as_ref().map_or("", |path| path.0.as_str());
    NodeError::new(format!("the folder `{folder}` has no picture of the camera `{}`", camera.name))
        .at("path")
        .hint("the name of a photograph, without its extension, must be the name of its camera; `pick` of `load-cameras` leaves cameras out")
}

#[cfg(test)]
mod tests;
