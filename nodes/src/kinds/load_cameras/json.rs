//! Cameras in JSON: lightharmony's own format, nerfstudio's `transforms.json` and `camera_path.json`, and INRIA's
//! `cameras.json`.

use engine::Notes;
use glam::{DMat4, DVec4};
use scene::error::Error;
use scene::io::capture::raw::Raw;
use scene::io::foreign::{json_text, parse_json, portable_path, refuse_foreign};
use serde_json::Value;

use super::lens::{bend, by_angle, focal, level, optional};

/// Function that returns the width and height of a picture, given its path as written in the file. If the picture
/// cannot be read, the error is the end of a sentence that begins with the picture.
pub type Sizes<'a> = &'a dyn Fn(&str) -> Result<[u64; 2], String>;

/// Files for which [`dataparser`](super::dataparser) is not made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// `camera_path.json` of nerfstudio's viewer, in the coordinates of the splats.
    Viewer,
    /// `cameras.json` of INRIA, in the coordinates of the splats of this training.
    Inria,
    /// Cameras of a glTF scene.
    Scene,
}

impl Origin {
    /// The file in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Viewer => "a path of nerfstudio's viewer",
            Self::Inria => "the cameras of a training with the INRIA code",
            Self::Scene => "the cameras of a glTF scene",
        }
    }
}

/// The origin of a JSON file of cameras; `None` for `transforms.json`, for lightharmony's own format, and for files
/// that are invalid.
pub fn origin(bytes: &[u8]) -> Option<Origin> {
    let json: Value = serde_json::from_slice(json_text(bytes)).ok()?;
    if json.is_array() {
        return Some(Origin::Inria);
    }
    (!json["frames"].is_array() && json["camera_path"].is_array()).then_some(Origin::Viewer)
}

/// Paths of the pictures of those frames of a `transforms.json` that have no size. Empty for any other file.
pub fn pictures_without_size(bytes: &[u8]) -> Vec<String> {
    let Ok(json) = serde_json::from_slice::<Value>(json_text(bytes)) else { return Vec::new() };
    let sized = |frame: &Value| {
        ["w", "h"].iter().all(|key| matches!(optional(level(&json, frame, &[*key]), key), Ok(Some(_))))
    };
    let frames = json["frames"].as_array().into_iter().flatten();
    frames.filter(|f| !sized(f)).filter_map(|f| f["file_path"].as_str()).map(portable_path).collect()
}

/// Reads the cameras of a file in any of the formats. The format is detected by content.
pub fn read(
    file: &str,
    bytes: &[u8],
    list: &str,
    sizes: Sizes<'_>,
    notes: &mut Notes,
) -> Result<Vec<Raw>, Error> {
    refuse_foreign(file, bytes)?;
    let json = parse_json(file, bytes)?;
    let all = |list: &[Value], read: &dyn Fn(&Value) -> Result<Raw, String>| {
        let each = list.iter().enumerate();
        each.map(|(index, v)| read(v).map_err(|what| Error::format(file, format!("camera {index} {what}"))))
            .collect()
    };
    if let Some(cameras) = json.as_array() {
        if cameras.iter().any(|v| v["transform"].is_array() && v["rotation"].is_null()) {
            let what = "a list of poses without lenses, as `ns-export cameras` of nerfstudio writes it; use the \
                        `transforms.json` of the capture, with `dataparser` for splats that nerfstudio exported";
            return Err(Error::unsupported(file, what));
        }
        return all(cameras, &inria);
    }
    if let Some(frames) = json["frames"].as_array() {
        if json.get("applied_transform").is_some() {
            notes.decision(
                "applied-transform",
                "poses are used as stored, including nerfstudio's `applied_transform`",
            );
        }
        return all(frames, &|frame| nerfstudio(&json, frame, sizes));
    }
    if let Some(path) = json["camera_path"].as_array() {
        let each = path.iter().enumerate();
        return each
            .map(|(i, v)| {
                path_camera(&json, v, i).map_err(|what| Error::format(file, format!("camera {i} {what}")))
            })
            .collect();
    }
    match json[list].as_array() {
        Some(views) => all(views, &own),
        None => {
            let lists: Vec<&str> = json
                .as_object()
                .into_iter()
                .flatten()
                .filter(|(_, v)| v[0].get("c2w_opencv").or(v[0].get("c2w_opengl")).is_some())
                .map(|(name, _)| name.as_str())
                .collect();
            if json.get("t_00").is_some() {
                let what =
                    "one camera of a raw Polycam capture; convert the capture with `ns-process-data polycam`";
                return Err(Error::unsupported(file, what));
            }
            let others = match lists.as_slice() {
                [] => "no list of the file holds cameras of lightharmony's own format".to_owned(),
                lists => format!("lists of cameras in the file: {}", lists.join(", ")),
            };
            Err(Error::format(file, format!("has no list `{list}` of cameras; {others}")))
        }
    }
}

fn number(v: &Value, key: &str) -> Result<f64, String> {
    v[key].as_f64().ok_or_else(|| format!("has no number `{key}`"))
}

fn pixels(v: &Value, key: &str) -> Result<u64, String> {
    // Some writers print whole numbers as `800.0` or as text.
    let whole = |f: f64| if f.trunc() == f && (0.0..1e9).contains(&f) { Some(f as u64) } else { None };
    optional(v, key)?.and_then(whole).ok_or_else(|| format!("has no valid size `{key}`"))
}

/// Reads a matrix of 3 or 4 rows of 4 numbers, or of 3 rows of 3 if `columns` is 3. A list of 16 numbers has the rows one
/// after the other.
fn matrix(v: &Value, key: &str, columns: usize) -> Result<[[f64; 4]; 3], String> {
    if let Some(flat) =
        v[key].as_array().filter(|list| list.len() == 16 && columns == 4 && list[0].is_number())
    {
        let nested: Vec<Value> = flat.chunks(4).map(|row| row.to_vec().into()).collect();
        return matrix(&serde_json::json!({ key: nested }), key, columns);
    }
    let mut rows = [[0.0; 4]; 3];
    for (r, row) in rows.iter_mut().enumerate() {
        for (c, slot) in row.iter_mut().enumerate().take(columns) {
            *slot = v[key][r][c].as_f64().ok_or_else(|| format!("has no matrix `{key}`"))?;
        }
    }
    if v[key]
        .get(3)
        .is_some_and(|last| (0..4).any(|c| last[c].as_f64() != Some(if c == 3 { 1.0 } else { 0.0 })))
    {
        return Err(format!("has a matrix `{key}` whose last row is not 0, 0, 0, 1"));
    }
    Ok(rows)
}

/// Converts the rows of a pose to a matrix. `flip` converts an OpenGL camera (y up, z backward) to an OpenCV
/// camera.
fn pose(rows: [[f64; 4]; 3], flip: bool) -> DMat4 {
    let s = if flip { -1.0 } else { 1.0 };
    let column = |c: usize, s: f64, w: f64| DVec4::new(rows[0][c] * s, rows[1][c] * s, rows[2][c] * s, w);
    DMat4::from_cols(column(0, 1.0, 0.0), column(1, s, 0.0), column(2, s, 0.0), column(3, 1.0, 1.0))
}

fn own(v: &Value) -> Result<Raw, String> {
    let world_from_camera = if v.get("c2w_opencv").is_some() {
        pose(matrix(v, "c2w_opencv", 4)?, false)
    } else {
        pose(matrix(v, "c2w_opengl", 4)?, true)
    };
    let (width, height) = (pixels(v, "w")?, pixels(v, "h")?);
    let lens = [number(v, "fx")?, number(v, "fy")?, number(v, "cx")?, number(v, "cy")?];
    Ok(Raw {
        picture: v["name"].as_str().ok_or("has no `name`")?.to_owned(),
        width,
        height,
        lens,
        distortion: bend(v, v, [width, height], lens)?,
        world_from_camera,
    })
}

/// Focal lengths of a frame in pixels, along x and y; the same for both if only one is given. If a frame defines a
/// focal length or a field of view along one axis, in any form, and the top level of the file along the other axis only,
/// both count. Otherwise a frame that defines one uses only its own.
fn focals(top: &Value, frame: &Value, [width, height]: [u64; 2]) -> Result<[f64; 2], String> {
    const X: [&str; 3] = ["fl_x", "camera_angle_x", "x_fov"];
    const Y: [&str; 3] = ["fl_y", "camera_angle_y", "y_fov"];
    let both = |holder: &Value| Ok::<_, String>([focal(holder, X, width)?, focal(holder, Y, height)?]);
    let (of_frame, of_file) = (both(frame)?, both(top)?);
    match (of_frame, of_file) {
        ([Some(x), Some(y)], _) | ([None, None], [Some(x), Some(y)]) => Ok([x, y]),
        ([Some(x), None], [None, Some(y)]) | ([None, Some(y)], [Some(x), None]) => Ok([x, y]),
        ([Some(one), None] | [None, Some(one)], _) => Ok([one; 2]),
        ([None, None], [Some(one), None] | [None, Some(one)]) => Ok([one; 2]),
        ([None, None], [None, None]) => Err("has neither `fl_x` nor `camera_angle_x`".to_owned()),
    }
}

/// Reads a frame as described on nerfstudio's page on its data format. Values missing in a frame are taken from the
/// top level of the file.
fn nerfstudio(top: &Value, frame: &Value, sizes: Sizes<'_>) -> Result<Raw, String> {
    let holder = |key: &str| level(top, frame, &[key]);
    let picture = portable_path(frame["file_path"].as_str().ok_or("has no `file_path`")?);
    let (width, height) = match (pixels(holder("w"), "w"), pixels(holder("h"), "h")) {
        (Ok(width), Ok(height)) => (width, height),
        (width, height) => {
            let [w, h] = sizes(&picture)
                .map_err(|what| format!("has no size `w`, `h`, and its picture `{picture}` {what}"))?;
            (width.unwrap_or(w), height.unwrap_or(h))
        }
    };
    let [fx, fy] = focals(top, frame, [width, height])?;
    let middle =
        |key: &str, size: u64| Ok::<_, String>(optional(holder(key), key)?.unwrap_or(size as f64 / 2.0));
    let lens = [fx, fy, middle("cx", width)?, middle("cy", height)?];
    Ok(Raw {
        picture,
        width,
        height,
        lens,
        distortion: bend(top, frame, [width, height], lens)?,
        world_from_camera: pose(matrix(frame, "transform_matrix", 4)?, true),
    })
}

/// Reads a camera of `camera_path.json` of nerfstudio's viewer: a matrix of 16 numbers in row-major order, or
/// of rows, y up and z backward, and the vertical field of view in degrees (nerfstudio, `get_path_from_json`).
fn path_camera(top: &Value, camera: &Value, index: usize) -> Result<Raw, String> {
    let model = level(top, camera, &["camera_type"])["camera_type"].as_str().unwrap_or("perspective");
    if !model.eq_ignore_ascii_case("perspective") {
        return Err(format!("has the camera type `{model}`, which is not a pinhole camera"));
    }
    let (width, height) = (pixels(top, "render_width")?, pixels(top, "render_height")?);
    let rows = matrix(camera, "camera_to_world", 4)?;
    let angle = number(camera, "fov")?;
    let focal = by_angle(angle.to_radians(), height)
        .ok_or_else(|| format!("has the angle `fov` {angle}, which is not between 0 and 180 degrees"))?;
    Ok(Raw {
        picture: format!("{index:05}"),
        width,
        height,
        lens: [focal, focal, width as f64 / 2.0, height as f64 / 2.0],
        distortion: None,
        world_from_camera: pose(rows, true),
    })
}

/// Reads a camera written by `camera_to_JSON` of the INRIA code: position and rotation from camera to world. Some
/// programs add the principal point `cx`, `cy` in pixels; otherwise it is the middle of the picture.
fn inria(v: &Value) -> Result<Raw, String> {
    let mut rows = matrix(v, "rotation", 3)?;
    for (axis, row) in rows.iter_mut().enumerate() {
        row[3] = v["position"][axis].as_f64().ok_or("has no `position`")?;
    }
    let (width, height) = (pixels(v, "width")?, pixels(v, "height")?);
    let middle = |key: &str, size: u64| Ok::<_, String>(optional(v, key)?.unwrap_or(size as f64 / 2.0));
    let lens = [number(v, "fx")?, number(v, "fy")?, middle("cx", width)?, middle("cy", height)?];
    let picture =
        v["img_name"].as_str().map(str::to_owned).or_else(|| v["id"].as_u64().map(|id| id.to_string()));
    Ok(Raw {
        picture: picture.ok_or("has neither `img_name` nor `id`")?,
        width,
        height,
        lens,
        distortion: bend(v, v, [width, height], lens)?,
        world_from_camera: pose(rows, false),
    })
}
