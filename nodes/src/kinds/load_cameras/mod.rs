//! `load-cameras`: the cameras of a capture or of another program.

mod count;
mod dataparser;
mod files;
mod gltf;
mod interface;
mod json;
mod lens;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use engine::{
    Context, ContextField, InputFile, Keep, Kind, NodeError, Notes, Scene, SourceFile, SourceRoot, Up,
    ViewCount,
};
use glam::{DMat3, DMat4};
use scene::error::Error;
use scene::io::capture::colmap;
use scene::io::capture::distortion::INVISIBLE_PX;
use scene::io::capture::raw::Raw;
use scene::io::foreign::refuse_placeholder;
use scene::io::gltf::animation::{AfterEnd, check_clip};
use scene::io::gltf::{Want, json_of, parse};
use scene::types::frame::Similarity;
use scene::types::pick::{chosen, count_of, stem};
use scene::types::{Camera, Lens, Rig};

use count::CAMERA_LIMIT;
use dataparser::Dataparser;
use files::{existing, files, is_gltf, json_file, size_of, with_pictures};
pub use interface::{Distortion, LoadCameras};
use json::Origin;

pub use scene::types::pick::Pick;

engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadCameras`].
    pub struct Out {
        /// The cameras in the order of the file, or in the order of `pick`.
        rig: Arc<Rig>,
    }
}

impl LoadCameras {
    /// A file, and the default of every other parameter.
    pub fn of(path: InputFile) -> Self {
        Self {
            path,
            pick: Vec::new(),
            list: "views".to_owned(),
            resolution: 1.0,
            distortion: Distortion::Refuse,
            dataparser: None,
            matrix: None,
            clip: None,
            time_s: 0.0,
            after_end: AfterEnd::Refuse,
        }
    }
}

impl Kind for LoadCameras {
    const NAME: &'static str = "load-cameras";
    const VERSION: u32 = 8;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    const FOLDERS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        check_clip(p.clip.as_deref(), p.time_s)?;
        if p.clip.is_some() && !is_gltf(&p.path) {
            return Err(NodeError::new("only the cameras of a glTF file are animated").at("clip"));
        }
        Similarity::of_parameter(p.matrix.as_ref()).map(|_| ())
    }

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let mut sources = if let Some(json) = json_file(&p.path, root) {
            with_pictures(root.file(&json), root)
        } else if is_gltf(&p.path) {
            gltf_sources(p, root)?
        } else {
            files(&p.path, root)?.iter().map(|file| root.file(file)).collect()
        };
        sources.extend(p.dataparser.iter().map(|file| root.file(file)));
        sources.extend(unused_dataparser(p, root));
        Ok(sources)
    }

    fn views(p: &Self, root: &SourceRoot) -> ViewCount {
        if let Some(count) = count_of(&p.pick) {
            return ViewCount::Known(count);
        }
        // The list of images of a binary model may fill gigabytes, but begins with their number.
        if p.pick.is_empty()
            && let Some(count) = count::images_of(&p.path, root)
        {
            return ViewCount::Known(count);
        }
        let uncounted =
            |why: String, hint: Option<&str>| ViewCount::Uncounted { why, hint: hint.map(str::to_owned) };
        let bytes = match count::read_bytes(&p.path, p.dataparser.as_ref(), root) {
            Ok(bytes) => bytes,
            Err(error) => return uncounted(error.to_string(), error.advice()),
        };
        // The images of a large text are only counted.
        if bytes > count::READ_WHOLE
            && p.pick.is_empty()
            && let Some(count) = count::lines_of_images(&p.path, root)
        {
            return ViewCount::Known(count);
        }
        if bytes > files::READ_MOST {
            let why = format!(
                "the files of this node have more than {} MiB, too much to read before the node runs",
                files::READ_MOST >> 20
            );
            return uncounted(why, Some("write the number instead: `Range(0, 300)`"));
        }
        let scene = Scene { up: Up::PlusY, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        match Self::run(p, In {}, &Context::detached(scene, root.folder())) {
            Ok((Out { rig }, _)) => ViewCount::Known(rig.cameras.len()),
            Err(error) => uncounted(error.to_string(), error.advice()),
        }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let raw = read(p, cx, &mut notes).map_err(|e| e.at("path"))?;
        if unused_dataparser(p, cx.root()).is_some() {
            let text = format!(
                "`{}` is in the folder of the cameras: it defines the coordinates of splats exported by \
                 nerfstudio; for such splats, set `dataparser` to this file",
                dataparser::NAME
            );
            notes.warning("dataparser-unused", text);
        }
        if raw.is_empty() {
            return Err(NodeError::from(Error::format(&p.path.0, "holds no camera")).at("path"));
        }
        if raw.len() > CAMERA_LIMIT {
            return Err(NodeError::from(Error::format(
                &p.path.0,
                format!("holds more than {CAMERA_LIMIT} cameras"),
            )));
        }
        let pictures: Vec<&str> = raw.iter().map(|camera| camera.picture.as_str()).collect();
        let names = view_names(&pictures);
        let chosen = chosen(&p.pick, &names, &pictures).map_err(|e| e.at("pick"))?;
        let cameras = chosen
            .iter()
            .map(|&index| finish(p, &raw[index], names[index].clone(), &mut notes))
            .collect::<Result<Vec<_>, _>>()?;
        let tiny: Vec<f64> = chosen
            .iter()
            .filter_map(|index| raw[*index].distortion.as_ref())
            .map(|bend| bend.pixels)
            .filter(|pixels| *pixels <= INVISIBLE_PX)
            .collect();
        if !tiny.is_empty() {
            let text = format!(
                "lens distortion that moves no point by more than {:.1e} px is ignored (cameras: {})",
                tiny.iter().copied().fold(0.0, f64::max),
                tiny.len()
            );
            notes.decision("distortion-invisible", text);
        }
        let mut seen = BTreeSet::new();
        if let Some(twice) = cameras.iter().find(|camera| !seen.insert(&camera.name)) {
            let what = format!("two cameras are named `{}`", twice.name);
            let hint = "pick one of them by its index from 0: `pick: [\"3..4\"]` is the fourth camera";
            return Err(NodeError::from(Error::format(&p.path.0, what)).at("path").hint(hint));
        }
        Ok((Out { rig: Arc::new(Rig { cameras }) }, notes))
    }
}

/// The file `dataparser_transforms.json` in the folder of a `transforms.json`, which `path` names directly or by
/// its folder. `None` if there is no such file, if the parameter `dataparser` is set, or for any other cameras
/// file. Nerfstudio's `camera_path.json` is already in the coordinates of the splats.
fn unused_dataparser(p: &LoadCameras, root: &SourceRoot) -> Option<SourceFile> {
    let json = json_file(&p.path, root).filter(|_| p.dataparser.is_none())?;
    let needs = json.0.to_lowercase().ends_with("transforms.json") && !json.0.ends_with(dataparser::NAME);
    let unused = needs.then(|| root.sibling(&root.file(&json), dataparser::NAME))?;
    unused.path.is_file().then_some(unused)
}

fn read(p: &LoadCameras, cx: &Context, notes: &mut Notes) -> Result<Vec<Raw>, NodeError> {
    cx.check_listed(&LoadCameras::sources(p, cx.root())?)?;
    let (mut cameras, json) = read_file(p, cx, notes)?;
    let Some(file) = &p.dataparser else { return Ok(cameras) };
    let mut dataparser =
        Dataparser::read(&file.0, &cx.read(file)?).map_err(|e| NodeError::from(e).at("dataparser"))?;
    let origin = if is_gltf(&p.path) { Some(Origin::Scene) } else { json.as_deref().and_then(json::origin) };
    match origin {
        Some(Origin::Viewer) => {
            let what = format!(
                "`{}` is a path of nerfstudio's viewer, whose cameras are already in the coordinates of the splats",
                p.path.0
            );
            return Err(NodeError::new(what)
                .at("dataparser")
                .hint("remove `dataparser`: only COLMAP models and `transforms.json` need it"));
        }
        Some(other) => {
            let text = format!(
                "`dataparser` moves the cameras of `{}`, {}: this is right only if they are in the coordinates of \
                 the capture from which nerfstudio trained; otherwise remove `dataparser`",
                p.path.0,
                other.words()
            );
            notes.warning("dataparser-doubtful", text);
        }
        None => {}
    }
    if let Some(json) = json {
        dataparser = dataparser.after_applied(&p.path.0, &json)?;
    }
    cameras.iter_mut().for_each(|camera| dataparser.apply(camera));
    notes.decision("dataparser", format!("the cameras are transformed by `{}`", file.0));
    Ok(cameras)
}

/// The glTF file, and the files of its buffers if the cameras are animated.
fn gltf_sources(p: &LoadCameras, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
    let file = root.file(&p.path);
    let mut sources = vec![file.clone()];
    // A GLB file seldom refers to others; what is wrong with its JSON is reported when the node runs.
    if p.clip.is_some()
        && let Ok(Some((json, _))) = json_of(&file.path)
        && let Ok(names) = parse(&p.path.0, &json).and_then(|parsed| parsed.other_files(Want::Geometry))
    {
        sources.extend(names.iter().map(|name| root.sibling(&file, name)));
    }
    Ok(sources)
}

/// Reads the cameras of the file. Also returns the bytes of the file if it is JSON.
fn read_file(
    p: &LoadCameras,
    cx: &Context,
    notes: &mut Notes,
) -> Result<(Vec<Raw>, Option<Vec<u8>>), NodeError> {
    let name = &p.path.0;
    if is_gltf(&p.path) {
        return Ok((gltf::read(p, &cx.read(&p.path)?, cx, notes)?, None));
    }
    if let Some(file) = json_file(&p.path, cx.root()) {
        let source = cx.source(&file);
        let sizes = |picture: &str| size_of(existing(&source, picture, cx.root()));
        let bytes = cx.read(&file)?;
        let cameras = json::read(&file.0, &bytes, &p.list, &sizes, notes)?;
        return Ok((cameras, Some(bytes)));
    }
    let files = files(&p.path, cx.root())?;
    let first = cx.read(&files[0])?;
    let Some(second) = files.get(1) else {
        return Err(NodeError::from(Error::format(name, "is not the folder of a COLMAP model")));
    };
    // The formats of pictures are not refused here: the number of cameras at the start of a binary file may be equal
    // to the first bytes of a picture.
    refuse_placeholder(&files[0].0, &first)?;
    let (name_of_second, second) = (&second.0, cx.read(second)?);
    refuse_placeholder(name_of_second, &second)?;
    cx.check()?;
    let binary = files[0].0.ends_with(".bin");
    let cameras =
        if binary { colmap::binary(name, &first, &second)? } else { colmap::text(name, &first, &second)? };
    Ok((cameras, None))
}

/// Returns the names of pictures without folder and extension. Pictures with the same name keep as many of their
/// folders as are needed to distinguish them.
fn view_names(pictures: &[&str]) -> Vec<String> {
    let mut names: Vec<String> = pictures.iter().map(|picture| view_name(picture, 0)).collect();
    let deepest = pictures.iter().map(|picture| picture.matches(['/', '\\']).count()).max().unwrap_or(0);
    for folders in 1..=deepest {
        let mut times = BTreeMap::<String, usize>::new();
        names.iter().for_each(|name| *times.entry(name.clone()).or_default() += 1);
        let same = (0..names.len()).filter(|&at| times[&names[at]] > 1).collect::<Vec<_>>();
        if same.is_empty() {
            break;
        }
        same.into_iter().for_each(|at| names[at] = view_name(pictures[at], folders));
    }
    names
}

/// Name of a picture without its extension, preceded by the names of the `folders` innermost folders of its path.
/// Characters that are not allowed in a view name are replaced.
fn view_name(picture: &str, folders: usize) -> String {
    let mut parts: Vec<&str> = stem(picture).rsplit(['/', '\\']).take(folders + 1).collect();
    parts.reverse();
    let safe = |c: char| if c.is_control() || matches!(c, '{' | '}' | ':') { '_' } else { c };
    let name: String = parts.join("_").chars().map(safe).collect();
    if name.is_empty() || name == ".." { "camera".to_owned() } else { name }
}

/// Number of intervals on each side of a picture at whose ends a lens must show a direction.
const BORDER: u32 = 64;

/// Checks a camera, and scales it to the requested resolution.
fn finish(p: &LoadCameras, raw: &Raw, name: String, notes: &mut Notes) -> Result<Camera, NodeError> {
    let bad = |what: String| NodeError::from(Error::format(&p.path.0, format!("camera `{name}` {what}")));
    let [fx, fy, cx, cy] = raw.lens;
    if !raw.lens.iter().all(|v| v.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return Err(bad(format!(
            "has focal lengths {fx}, {fy} and principal point {cx}, {cy}, which are not valid"
        )));
    }
    let size = |pixels: u64| {
        let scaled = (pixels as f64 * p.resolution).round();
        if pixels > 0 && (1.0..=65_536.0).contains(&scaled) {
            Ok(scaled as u32)
        } else {
            Err(bad(format!(
                "has a side of {pixels} pixels, which `resolution` scales to less than 1 or more than 65536"
            )))
        }
    };
    let (width_px, height_px) = (size(raw.width)?, size(raw.height)?);
    // Each side by its own factor after rounding, so that the field of view stays the same.
    let (sx, sy) = (f64::from(width_px) / raw.width as f64, f64::from(height_px) / raw.height as f64);
    let eye = raw.world_from_camera.w_axis.truncate();
    let turn = orthonormal(DMat3::from_mat4(raw.world_from_camera)).ok_or_else(|| {
        bad("has a matrix that is not a rotation".to_owned()).hint("a scaled or mirrored pose cannot be used")
    })?;
    let matrix = Similarity::of_parameter(p.matrix.as_ref())?;
    let (eye, turn) = (matrix.point(eye), matrix.rotation * turn);
    if !eye.is_finite() {
        return Err(bad("has a position that is not finite".to_owned()));
    }
    let world_from_camera = DMat4::from_cols(
        turn.x_axis.extend(0.0),
        turn.y_axis.extend(0.0),
        turn.z_axis.extend(0.0),
        eye.extend(1.0),
    );
    let camera = Camera {
        name,
        width_px,
        height_px,
        fx: fx * sx,
        fy: fy * sy,
        cx: cx * sx,
        cy: cy * sy,
        lens: Lens::PINHOLE,
        world_from_camera: world_from_camera.to_cols_array(),
    };
    distorted(p, raw, camera, notes)
}

/// The camera with the distortion of its lens, if that is visible.
fn distorted(p: &LoadCameras, raw: &Raw, camera: Camera, notes: &mut Notes) -> Result<Camera, NodeError> {
    let Some(bend) =
        raw.distortion.as_ref().filter(|bend| bend.pixels.is_nan() || bend.pixels > INVISIBLE_PX)
    else {
        return Ok(camera);
    };
    let (name, distortion) = (&camera.name, &bend.text);
    if p.distortion == Distortion::Ignore {
        notes
            .degraded("distortion-ignored", format!("lens distortion of `{name}` ({distortion}) is ignored"));
        return Ok(camera);
    }
    let bad = |what: String| {
        NodeError::from(Error::format(&p.path.0, format!("camera `{name}` {what}"))).at("path")
    };
    const UNDISTORT: &str = "undistort the photographs first (`colmap image_undistorter`)";
    if p.distortion == Distortion::Refuse {
        let hint = format!("set `distortion: Apply` to render what this lens shows, or {UNDISTORT}");
        return Err(bad(format!("has lens distortion ({distortion})")).hint(hint));
    }
    let bad = |what: String| bad(what).hint(UNDISTORT);
    let Some(model) = bend.model else {
        return Err(bad(format!("has lens distortion of a model that is not supported ({distortion})")));
    };
    let lens = Lens::from(model);
    let (width, height) = (f64::from(camera.width_px), f64::from(camera.height_px));
    let border = (0..=BORDER).flat_map(|step| {
        let (x, y) =
            (width * f64::from(step) / f64::from(BORDER), height * f64::from(step) / f64::from(BORDER));
        [[x, 0.0], [x, height], [0.0, y], [width, y]]
    });
    let shows =
        |[x, y]: &[f64; 2]| lens.shows([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy].into());
    if let Some([x, y]) = border.into_iter().find(|at| !shows(at)) {
        return Err(bad(format!(
            "has lens distortion ({distortion}) that shows no direction below 85 degrees at ({x:.0}, {y:.0}) of its \
             picture of {width}x{height} pixels"
        )));
    }
    Ok(Camera { lens, ..camera })
}

/// The rotation nearest to a matrix; `None` if the matrix differs from a rotation by more than rounding. Newton's
/// iteration for the polar factor squares the error in each step.
fn orthonormal(mut m: DMat3) -> Option<DMat3> {
    let off = m.transpose() * m - DMat3::IDENTITY;
    // Files have at least 5 digits; a scale or a mirror image is far beyond this.
    let near = off.to_cols_array().iter().all(|v| v.abs() < 1e-3);
    if !near || m.determinant() <= 0.0 {
        return None;
    }
    for _ in 0..3 {
        m = (m * 3.0 - m * (m.transpose() * m)) * 0.5;
    }
    Some(m)
}
