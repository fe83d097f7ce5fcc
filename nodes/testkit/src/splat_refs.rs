//! Reference renders of `splat-refs`, computed in float64.

use glam::{DMat3, DMat4, DVec3};
use scene::types::Camera;

use crate::Data;

/// A view of `splat-refs`.
pub struct Reference {
    /// Name of the view, such as `garden_A`.
    pub name: String,
    /// Camera of the view, named `view`.
    pub camera: Camera,
    /// Number of blends in the whole view. Each blend adds one splat to one pixel.
    pub blended: u64,
}

impl Reference {
    /// All views.
    pub fn all(data: &Data) -> Vec<Self> {
        let views = data.json("splat-refs/refs.json");
        views.as_array().unwrap().iter().map(Self::read).collect()
    }

    /// The view with a given name.
    pub fn named(data: &Data, name: &str) -> Self {
        Self::all(data).into_iter().find(|view| view.name == name).unwrap()
    }

    fn read(view: &serde_json::Value) -> Self {
        let camera = &view["camera"];
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let vector =
            |value: &serde_json::Value| DVec3::new(number(&value[0]), number(&value[1]), number(&value[2]));
        let [right, down, forward] = [0, 1, 2].map(|i| vector(&camera["R_w2c"][i]));
        let eye = -(DMat3::from_cols(right, down, forward) * vector(&camera["t_w2c"]));
        let pose =
            DMat4::from_cols(right.extend(0.0), down.extend(0.0), forward.extend(0.0), eye.extend(1.0));
        Self {
            name: view["name"].as_str().unwrap().to_owned(),
            camera: Camera {
                name: "view".to_owned(),
                width_px: camera["width"].as_u64().unwrap() as u32,
                height_px: camera["height"].as_u64().unwrap() as u32,
                fx: number(&camera["fx"]),
                fy: number(&camera["fy"]),
                cx: number(&camera["cx"]),
                cy: number(&camera["cy"]),
                lens: Default::default(),
                world_from_camera: pose.to_cols_array(),
            },
            blended: view["stats"]["blended"].as_u64().unwrap(),
        }
    }

    /// Samples of the layer `rgb`, `alpha` or `depth`. The layer `depth` contains the depth multiplied by alpha.
    pub fn layer(&self, data: &Data, layer: &str) -> Vec<f32> {
        // A `.npy` file of little-endian float32: its header, whose length is in bytes 8 and 9, and the samples.
        let bytes = data.bytes(&format!("splat-refs/{}.{layer}.npy", self.name));
        let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert!(std::str::from_utf8(&bytes[10..header]).unwrap().contains("'<f4'"));
        bytes[header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }
}
