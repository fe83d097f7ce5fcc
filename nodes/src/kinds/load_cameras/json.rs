//! Cameras in JSON: our own lists, nerfstudio's `transforms.json`, INRIA's `cameras.json`.

use engine::Notes;
use glam::{DMat4, DVec4};
use serde_json::Value;

use super::Raw;
use crate::error::Error;
use crate::math::num;

/// Reads any of the three formats, detected by content.
pub fn read(file: &str, bytes: &[u8], list: &str, notes: &mut Notes) -> Result<Vec<Raw>, Error> {
    let json: Value = serde_json::from_slice(bytes)
        .map_err(|e| Error::format(file, format!("its JSON does not parse: {e}")))?;
    let all = |list: &[Value], read: &dyn Fn(&Value) -> Result<Raw, String>| {
        let each = list.iter().enumerate();
        each.map(|(index, v)| read(v).map_err(|what| Error::format(file, format!("camera {index} {what}"))))
            .collect()
    };
    if let Some(cameras) = json.as_array() {
        return all(cameras, &inria);
    }
    if let Some(frames) = json["frames"].as_array() {
        if json.get("applied_transform").is_some() {
            notes.decision(
                "applied-transform",
                "poses are used as stored, including nerfstudio's applied_transform",
            );
        }
        return all(frames, &|frame| nerfstudio(&json, frame));
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
            Err(Error::format(
                file,
                format!("has no list `{list}` of cameras; its lists are [{}]", lists.join(", ")),
            ))
        }
    }
}

fn number(v: &Value, key: &str) -> Result<f64, String> {
    v[key].as_f64().ok_or_else(|| format!("has no number `{key}`"))
}

fn pixels(v: &Value, key: &str) -> Result<u64, String> {
    // Some writers print whole numbers as `800.0`.
    let whole = |f: f64| if f.trunc() == f && (0.0..1e9).contains(&f) { Some(f as u64) } else { None };
    v[key].as_u64().or_else(|| v[key].as_f64().and_then(whole)).ok_or_else(|| format!("has no size `{key}`"))
}

/// A matrix of 3 or 4 rows of 4, or of 3 rows of 3 where `columns` is 3.
fn matrix(v: &Value, key: &str, columns: usize) -> Result<[[f64; 4]; 3], String> {
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

/// Rows to a matrix; `flip` turns an OpenGL camera (y up, z backward) into an OpenCV one.
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
    Ok(Raw {
        picture: v["name"].as_str().ok_or("has no `name`")?.to_owned(),
        width: pixels(v, "w")?,
        height: pixels(v, "h")?,
        lens: [number(v, "fx")?, number(v, "fy")?, number(v, "cx")?, number(v, "cy")?],
        distortion: None,
        world_from_camera,
    })
}

/// See nerfstudio's page on its data format: values missing in a frame are taken from the top level of the file.
fn nerfstudio(top: &Value, frame: &Value) -> Result<Raw, String> {
    let holder = |key: &str| if frame.get(key).is_some() { frame } else { top };
    let (width, height) = (pixels(holder("w"), "w")?, pixels(holder("h"), "h")?);
    let focal = |key: &str, angle: &str, size: u64| -> Option<f64> {
        let holder = holder(key);
        holder[key].as_f64().or_else(|| {
            let angle = number(top, angle).ok()?;
            Some(size as f64 / 2.0 / num::f64::tan(angle / 2.0))
        })
    };
    let fx = focal("fl_x", "camera_angle_x", width).ok_or("has neither `fl_x` nor `camera_angle_x`")?;
    let fy = focal("fl_y", "camera_angle_y", height).unwrap_or(fx);
    let middle = |key: &str, size: u64| holder(key)[key].as_f64().unwrap_or(size as f64 / 2.0);
    let model = holder("camera_model")["camera_model"].as_str().unwrap_or("OPENCV");
    let bends: Vec<String> = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"]
        .into_iter()
        .filter_map(|key| holder(key)[key].as_f64().filter(|k| *k != 0.0).map(|k| format!("{key} {k}")))
        .collect();
    // Fisheye models distort even when all their coefficients are 0.
    let bent = match model {
        "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "perspective" => !bends.is_empty(),
        "SIMPLE_RADIAL" | "RADIAL" | "FULL_OPENCV" => true,
        model if model.contains("FISHEYE") => true,
        other => {
            return Err(format!("has the camera model `{other}`, which is not a pinhole camera"));
        }
    };
    let picture = frame["file_path"].as_str().ok_or("has no `file_path`")?.to_owned();
    Ok(Raw {
        picture,
        width,
        height,
        lens: [fx, fy, middle("cx", width), middle("cy", height)],
        distortion: bent.then(|| [vec![model.to_owned()], bends].concat().join(" ")),
        world_from_camera: pose(matrix(frame, "transform_matrix", 4)?, true),
    })
}

/// As written by `camera_to_JSON` of the INRIA code: position and rotation of world from camera.
fn inria(v: &Value) -> Result<Raw, String> {
    let mut rows = matrix(v, "rotation", 3)?;
    for (axis, row) in rows.iter_mut().enumerate() {
        row[3] = v["position"][axis].as_f64().ok_or("has no `position`")?;
    }
    let (width, height) = (pixels(v, "width")?, pixels(v, "height")?);
    let picture =
        v["img_name"].as_str().map(str::to_owned).or_else(|| v["id"].as_u64().map(|id| id.to_string()));
    Ok(Raw {
        picture: picture.ok_or("has neither `img_name` nor `id`")?,
        width,
        height,
        lens: [number(v, "fx")?, number(v, "fy")?, width as f64 / 2.0, height as f64 / 2.0],
        distortion: None,
        world_from_camera: pose(rows, false),
    })
}
