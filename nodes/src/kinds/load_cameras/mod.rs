//! `load-cameras`: the cameras of a capture or of another program.

mod colmap;
mod json;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use engine::{
    Context, InputFile, Keep, Kind, NodeError, Notes, Scene, SourceFile, SourceRoot, Up, ViewCount,
};
use glam::{DMat3, DMat4, DVec3};

use crate::error::Error;
use crate::types::{Camera, Rig};

engine::choices! {
    /// Treatment of lens distortion, which a pinhole camera cannot represent.
    pub enum Distortion {
        /// A camera with distortion is an error.
        Refuse,
        /// Distortion is ignored, and the result is marked as degraded.
        Ignore,
    }
}
engine::params! {
    /// Loads cameras: our own JSON, COLMAP, nerfstudio or INRIA files.
    ///
    /// The format is detected by content: (1) our own JSON, `{"views": [{"name": "view_0", "w": 512, "h": 384,
    /// "fx": 491.8, "fy": 491.8, "cx": 256.0, "cy": 192.0, "c2w_opencv": [[..4], [..4], [..4], [..4]]}]}` with the
    /// rows of the matrix from camera to world, camera x right, y down, z forward; or `c2w_opengl`, y up and z
    /// backward. (2) A COLMAP model, text or binary: its folder, or a folder that holds `sparse/0`. (3)
    /// nerfstudio's `transforms.json`. (4) INRIA's `cameras.json`. Pixel centres lie at +0.5 in all of them. A view
    /// is named after its picture, without folder and extension, but with as many folders as needed to distinguish
    /// pictures of the same name: `day1_IMG_0001`.
    pub struct LoadCameras {
        /// The file, or the folder of a COLMAP model.
        path: InputFile, other("\"b.json\"");
        /// Cameras to load, in this order: names or paths of pictures, with wildcards `*` and `?`, or ranges of
        /// indices from 0 such as `2..5`, or `0..400..8` for every eighth. The default is all cameras.
        pick: Vec<String> = Vec::new(), other("[\"0..1\"]");
        /// Name of the list in our own JSON format.
        list: String = "views".to_owned(), other("\"cube_faces\""), inert("only our own JSON has lists");
        /// Factor applied to width and height of the pictures.
        resolution: f64 = 1.0, range(0.001, 64), other("0.5");
        /// Treatment of lens distortion.
        distortion: Distortion = Distortion::Refuse, other("Ignore"), inert("most files have none");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadCameras`].
    pub struct Out {
        /// The cameras in the order of the file, or of `pick`.
        rig: Arc<Rig>,
    }
}

/// A camera as stored in a file.
#[derive(Debug, Clone)]
struct Raw {
    /// Name of its picture, possibly with folder and extension.
    picture: String,
    width: u64,
    height: u64,
    /// fx, fy, cx, cy in pixels.
    lens: [f64; 4],
    /// The distortion model and its nonzero parameters.
    distortion: Option<String>,
    /// Camera x right, y down, z forward.
    world_from_camera: DMat4,
}

/// Largest number of cameras in a file.
const CAMERA_LIMIT: usize = 1_000_000;

impl Kind for LoadCameras {
    const NAME: &'static str = "load-cameras";
    const VERSION: u32 = 3;
    const STORE: Keep = Keep::Cheap;
    const FOLDERS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        if is_json(&p.path) {
            return Ok(vec![root.file(&p.path)]);
        }
        Ok(files(&p.path, root)?.iter().map(|file| root.file(file)).collect())
    }

    fn views(p: &Self, root: &SourceRoot) -> ViewCount {
        // Reading a large model would take too long for a check of the graph.
        const MOST_BYTES: u64 = 4 << 20;
        let size = |file: &SourceFile| std::fs::metadata(&file.path).map_or(u64::MAX, |data| data.len());
        let small =
            Self::sources(p, root).is_ok_and(|files| files.iter().all(|file| size(file) <= MOST_BYTES));
        let scene = Scene { up: Up::PlusY, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        let read = || Self::run(p, In {}, &Context::detached(scene, root.folder())).ok();
        match small.then(read).flatten() {
            Some((Out { rig }, _)) => ViewCount::Known(rig.cameras.len()),
            None => ViewCount::Unknown,
        }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let raw = read(p, cx, &mut notes).map_err(|e| e.at("path"))?;
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
        let chosen = pick(&p.pick, &names, &pictures).map_err(|e| e.at("pick"))?;
        let cameras = chosen
            .into_iter()
            .map(|index| finish(p, &raw[index], names[index].clone(), &mut notes))
            .collect::<Result<Vec<_>, _>>()?;
        let mut seen = BTreeSet::new();
        if let Some(twice) = cameras.iter().find(|camera| !seen.insert(&camera.name)) {
            let what = format!("two cameras are named `{}`", twice.name);
            let hint = "take one of them by its number from 0: `pick: [\"3..4\"]` is the fourth camera";
            return Err(NodeError::from(Error::format(&p.path.0, what)).at("path").hint(hint));
        }
        Ok((Out { rig: Arc::new(Rig { cameras }) }, notes))
    }
}

fn is_json(path: &InputFile) -> bool {
    path.0.to_lowercase().ends_with(".json")
}

/// The files that a path other than `.json` may refer to, in order of preference.
fn candidates(path: &InputFile) -> Vec<Vec<InputFile>> {
    let folder = match path.0.rsplit_once('/') {
        Some((folder, file)) if is_part(file) => folder,
        None if is_part(&path.0) => ".",
        _ => path.0.trim_end_matches('/'),
    };
    let file = |name: String| InputFile(format!("{folder}/{name}"));
    let mut candidates = Vec::new();
    for inner in ["", "sparse/0/", "sparse/"] {
        for ending in ["bin", "txt"] {
            candidates.push(vec![
                file(format!("{inner}cameras.{ending}")),
                file(format!("{inner}images.{ending}")),
            ]);
        }
    }
    candidates.extend(["transforms.json", "cameras.json"].map(|name| vec![file(name.to_owned())]));
    candidates
}

/// The files of the first candidate whose files all exist.
fn files(path: &InputFile, root: &SourceRoot) -> Result<Vec<InputFile>, NodeError> {
    let there = |files: &Vec<InputFile>| files.iter().all(|file| root.file(file).path.is_file());
    candidates(path).into_iter().find(there).ok_or_else(|| unknown(path))
}

fn is_part(file: &str) -> bool {
    matches!(file, "cameras.bin" | "images.bin" | "cameras.txt" | "images.txt")
}

fn unknown(path: &InputFile) -> NodeError {
    NodeError::new(format!("`{}` is neither a JSON file nor the folder of a COLMAP model", path.0))
        .at("path")
        .hint("a COLMAP model has `cameras.bin` and `images.bin`, or both as `.txt`")
}

fn read(p: &LoadCameras, cx: &Context, notes: &mut Notes) -> Result<Vec<Raw>, NodeError> {
    let name = &p.path.0;
    if is_json(&p.path) {
        return Ok(json::read(name, &cx.read(&p.path)?, &p.list, notes)?);
    }
    let files = files(&p.path, cx.root())?;
    cx.check_listed(&files.iter().map(|file| cx.source(file)).collect::<Vec<_>>())?;
    let first = cx.read(&files[0])?;
    let Some(second) = files.get(1) else {
        return Ok(json::read(&files[0].0, &first, &p.list, notes)?);
    };
    let second = cx.read(second)?;
    cx.check()?;
    let binary = files[0].0.ends_with(".bin");
    Ok(if binary { colmap::binary(name, &first, &second)? } else { colmap::text(name, &first, &second)? })
}

/// Names of pictures without folder and ending; equal names keep as many of their folders as needed to distinguish
/// them.
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

/// The path of a picture without extension.
fn stem(picture: &str) -> &str {
    match picture.rsplit_once('.') {
        Some((stem, ending))
            if !stem.is_empty()
                && !stem.ends_with(['/', '\\'])
                && ending.len() <= 4
                && !ending.chars().all(|c| c.is_ascii_digit())
                && !ending.contains(['/', '\\']) =>
        {
            stem
        }
        _ => picture,
    }
}

/// The name of a picture without extension and with this many of its folders; characters that a path cannot contain
/// are replaced.
fn view_name(picture: &str, folders: usize) -> String {
    let mut parts: Vec<&str> = stem(picture).rsplit(['/', '\\']).take(folders + 1).collect();
    parts.reverse();
    let safe = |c: char| if c.is_control() || matches!(c, '{' | '}' | ':') { '_' } else { c };
    let name: String = parts.join("_").chars().map(safe).collect();
    if name.is_empty() || name == ".." { "camera".to_owned() } else { name }
}

/// Indices of the chosen cameras, each once, in the order of the patterns.
fn pick(wishes: &[String], names: &[String], pictures: &[&str]) -> Result<Vec<usize>, NodeError> {
    if wishes.is_empty() {
        return Ok((0..names.len()).collect());
    }
    let (mut chosen, mut taken) = (Vec::new(), vec![false; names.len()]);
    for wish in wishes {
        let found: Vec<usize> = match range(wish) {
            Some((start, end, step)) => (start..end.min(names.len())).step_by(step).collect(),
            None => {
                let fits = |i: &usize| {
                    [&names[*i], pictures[*i], stem(pictures[*i])].iter().any(|name| matches(wish, name))
                };
                (0..names.len()).filter(fits).collect()
            }
        };
        if found.is_empty() {
            let some = names.iter().take(5).map(String::as_str).collect::<Vec<_>>().join(", ");
            return Err(NodeError::new(format!("`{wish}` picks none of the {} cameras", names.len()))
                .hint(format!("the first ones are {some}")));
        }
        chosen.extend(found.into_iter().filter(|index| !std::mem::replace(&mut taken[*index], true)));
    }
    Ok(chosen)
}

/// Parses `2..5`, `2..` and `0..400..8`.
fn range(wish: &str) -> Option<(usize, usize, usize)> {
    let parts: Vec<&str> = wish.split("..").collect();
    let (start, end, step) = match parts[..] {
        [start, end] => (start, end, "1"),
        [start, end, step] => (start, end, step),
        _ => return None,
    };
    let end = if end.is_empty() { usize::MAX } else { end.parse().ok()? };
    Some((start.parse().ok()?, end, step.parse().ok().filter(|step| *step > 0)?))
}

/// True if a name matches a pattern with the wildcards `*` and `?`.
fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let (mut p, mut n, mut retry) = (0, 0, None);
    while n < name.len() {
        match pattern.get(p) {
            Some('*') => {
                retry = Some((p, n));
                p += 1;
            }
            Some(&c) if c == '?' || c == name[n] => (p, n) = (p + 1, n + 1),
            _ => {
                let Some((star, from)) = retry else { return false };
                retry = Some((star, from + 1));
                (p, n) = (star + 1, from + 1);
            }
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

/// Checks a camera, and scales it to the requested resolution.
fn finish(p: &LoadCameras, raw: &Raw, name: String, notes: &mut Notes) -> Result<Camera, NodeError> {
    let bad = |what: String| NodeError::from(Error::format(&p.path.0, format!("camera `{name}`: {what}")));
    if let Some(distortion) = &raw.distortion {
        match p.distortion {
            Distortion::Refuse => {
                return Err(bad(format!("has lens distortion ({distortion})")).at("path").hint(
                    "undistort the pictures first (`colmap image_undistorter`), or set `distortion: Ignore`",
                ));
            }
            Distortion::Ignore => {
                notes.degraded(
                    "distortion-ignored",
                    format!("lens distortion of `{name}` ({distortion}) is left out"),
                );
            }
        }
    }
    let [fx, fy, cx, cy] = raw.lens;
    if !raw.lens.iter().all(|v| v.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return Err(bad(format!(
            "focal lengths {fx}, {fy} and principal point {cx}, {cy} are not valid for a camera"
        )));
    }
    let size = |pixels: u64| {
        let scaled = (pixels as f64 * p.resolution).round();
        if pixels > 0 && (1.0..=65_536.0).contains(&scaled) {
            Ok(scaled as u32)
        } else {
            Err(bad(format!("{pixels} pixels at this `resolution`")))
        }
    };
    let (width_px, height_px) = (size(raw.width)?, size(raw.height)?);
    // Each side by its own factor after rounding, so that the field of view stays the same.
    let (sx, sy) = (f64::from(width_px) / raw.width as f64, f64::from(height_px) / raw.height as f64);
    let eye = raw.world_from_camera.w_axis.truncate();
    let turn = orthonormal(DMat3::from_mat4(raw.world_from_camera)).ok_or_else(|| {
        bad("its matrix is not a rotation".to_owned()).hint("a scaled or mirrored pose cannot be used")
    })?;
    if !eye.is_finite() {
        return Err(bad("its position is not finite".to_owned()));
    }
    let world_from_camera = DMat4::from_cols(
        turn.x_axis.extend(0.0),
        turn.y_axis.extend(0.0),
        turn.z_axis.extend(0.0),
        eye.extend(1.0),
    );
    Ok(Camera {
        name,
        width_px,
        height_px,
        fx: fx * sx,
        fy: fy * sy,
        cx: cx * sx,
        cy: cy * sy,
        world_from_camera: world_from_camera.to_cols_array(),
    })
}

/// The rotation nearest to a matrix that is a rotation except for rounding: Newton's iteration for the polar
/// factor, which squares the error each time.
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

/// The camera pose from rotation and translation of camera from world, as in COLMAP.
fn from_colmap(q: [f64; 4], t: [f64; 3]) -> Option<DMat4> {
    let [w, x, y, z] = q;
    let length = (w * w + x * x + y * y + z * z).sqrt();
    if !(length > 0.0 && length.is_finite()) {
        return None;
    }
    let world_from_camera =
        DMat3::from_quat(glam::DQuat::from_xyzw(x / length, y / length, z / length, w / length)).transpose();
    let eye = -(world_from_camera * DVec3::from_array(t));
    Some(DMat4::from_cols(
        world_from_camera.x_axis.extend(0.0),
        world_from_camera.y_axis.extend(0.0),
        world_from_camera.z_axis.extend(0.0),
        eye.extend(1.0),
    ))
}
