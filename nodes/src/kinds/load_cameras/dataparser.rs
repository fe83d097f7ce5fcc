//! `dataparser_transforms.json` of nerfstudio: maps the coordinates of a capture to the coordinates in which
//! nerfstudio trains and exports splats.

use glam::{DMat3, DMat4, DVec3, DVec4};
use scene::error::Error;
use scene::io::capture::raw::Raw;
use scene::io::foreign::{json_text, parse_json, refuse_foreign};
use serde_json::Value;

/// Name of the file in the folder of a training run.
pub const NAME: &str = "dataparser_transforms.json";

/// A rotation and a translation, followed by a uniform scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dataparser {
    transform: DMat4,
    scale: f64,
}

/// Reads an affine transform of three rows of four numbers.
fn rows(file: &str, value: &Value, key: &str) -> Result<DMat4, Error> {
    let mut columns = [[0.0; 3]; 4];
    for (r, c) in (0..3).flat_map(|r| (0..4).map(move |c| (r, c))) {
        let number = value[key][r][c].as_f64().filter(|v| v.is_finite());
        columns[c][r] = number
            .ok_or_else(|| Error::format(file, format!("has no matrix `{key}` of 3 rows and 4 columns")))?;
    }
    let [x, y, z, w] = columns.map(DVec3::from_array);
    Ok(DMat4::from_cols(x.extend(0.0), y.extend(0.0), z.extend(0.0), DVec4::new(w.x, w.y, w.z, 1.0)))
}

impl Dataparser {
    /// Reads `transform` and `scale` from the file.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        refuse_foreign(file, bytes)?;
        let json = parse_json(file, bytes)?;
        let transform = rows(file, &json, "transform")?;
        let scale = json["scale"].as_f64().filter(|s| *s > 0.0 && s.is_finite());
        let scale = scale.ok_or_else(|| Error::format(file, "has no `scale` above 0"))?;
        let linear = DMat3::from_mat4(transform);
        let off = linear.transpose() * linear - DMat3::IDENTITY;
        if off.to_cols_array().iter().any(|v| v.abs() > 1e-3) || linear.determinant() < 0.0 {
            return Err(Error::format(file, "`transform` is not a rotation with a translation"));
        }
        Ok(Self { transform, scale })
    }

    /// Adapts the transform to the cameras of a `transforms.json` with `applied_transform`. That transform is
    /// already applied to the cameras, but the data parser expects coordinates to which it has not been applied
    /// (nerfstudio, `nerfstudio_dataparser.py`).
    pub fn after_applied(self, file: &str, cameras: &[u8]) -> Result<Self, Error> {
        let Ok(json) = serde_json::from_slice::<Value>(json_text(cameras)) else { return Ok(self) };
        let mut own = self;
        if !json["applied_transform"].is_null() {
            let applied = rows(file, &json, "applied_transform")?;
            if applied.determinant().abs() < 1e-9 {
                return Err(Error::format(file, "`applied_transform` has no inverse"));
            }
            own.transform = self.transform * applied.inverse();
        }
        if let Some(applied) = json["applied_scale"].as_f64().filter(|s| *s > 0.0 && s.is_finite()) {
            own.scale = self.scale / applied;
        }
        Ok(own)
    }

    /// Transforms the pose of a camera.
    pub fn apply(&self, camera: &mut Raw) {
        let pose = self.transform * camera.world_from_camera;
        let eye = pose.w_axis.truncate() * self.scale;
        camera.world_from_camera = DMat4::from_cols(pose.x_axis, pose.y_axis, pose.z_axis, eye.extend(1.0));
    }
}
