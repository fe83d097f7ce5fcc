//! Loads the scenes of `render-refs`, and traces them.

use std::collections::BTreeMap;
use std::sync::Arc;

use engine::{Kind, Notes};
use glam::DMat4;
use nodes::kinds::denoise::{self, Denoise, Method};
use nodes::kinds::load_mesh::ColourEncoding;
use nodes::kinds::override_material::{self, OverrideMaterial, Surface};
use nodes::kinds::path_trace::surroundings::Surroundings;
use nodes::kinds::path_trace::{self, PathTrace};
use scene::io::exr;
use scene::types::{Camera, Environment, Mesh, Placed, Rig};

use crate::{Data, thread_seconds};

/// A scene of `render-refs`, prepared for tracing.
pub struct Case {
    data: Data,
    /// Folder of the scene, relative to the data folder.
    folder: String,
    /// The mesh that receives shadows, with baked colours.
    pub receiver: Arc<Mesh>,
    /// The inserted object.
    pub object: Arc<Placed>,
    /// The environment that lights the scene.
    pub env: Arc<Environment>,
    /// Rig with one camera.
    pub rig: Arc<Rig>,
}

fn matrix(value: &serde_json::Value) -> DMat4 {
    let mut flat = [0.0; 16];
    for (i, out) in flat.iter_mut().enumerate() {
        *out = value[i / 4][i % 4].as_f64().unwrap();
    }
    DMat4::from_cols_array(&flat).transpose()
}

fn params(samples: u32, surroundings: Surroundings, crop: f64) -> PathTrace {
    PathTrace { samples, surroundings, contact_metres: Some(0.0), crop, ..PathTrace::default() }
}

impl Case {
    /// Loads a scene of `render-refs`.
    pub fn load(data: &Data, name: &str) -> Self {
        let folder = format!("render-refs/{name}");
        let file = |name: &str| format!("{folder}/{name}");
        let scene = data.json(&file("scene.json"));
        let receiver = data.mesh(&file("receiver.ply"), ColourEncoding::Srgb).0;
        let object = data.object(&file("object.glb")).0;
        let albedo = &scene["object_material"]["albedo"];
        let material = OverrideMaterial {
            surface: Surface::Diffuse,
            colour: std::array::from_fn(|k| albedo[k].as_f64().unwrap()),
            metallic: 0.0,
            roughness: 1.0,
        };
        let input = override_material::In { object };
        let object = OverrideMaterial::run(&material, input, &data.context()).unwrap().0.object;
        let env = data.environment(&file("env.exr")).0;
        let camera = &scene["camera"];
        let number = |key: &str| camera[key].as_f64().unwrap();
        let camera = Camera {
            name: "view".to_owned(),
            width_px: number("width") as u32,
            height_px: number("height") as u32,
            fx: number("fx"),
            fy: number("fy"),
            cx: number("cx"),
            cy: number("cy"),
            lens: Default::default(),
            world_from_camera: matrix(&camera["c2w"]).to_cols_array(),
        };
        let world_from_object = matrix(&scene["object_transform"]);
        let object = Arc::new(Placed { object, world_from_object });
        Self {
            data: data.clone(),
            folder,
            receiver,
            object,
            env,
            rig: Arc::new(Rig { cameras: vec![camera] }),
        }
    }

    /// Returns the scene with the camera distance and the size of the receiver multiplied by `times`.
    pub fn with_camera_at(&self, times: f32) -> Self {
        let mut receiver = Mesh::clone(&self.receiver);
        receiver.positions.iter_mut().flatten().for_each(|v| *v *= times);
        let mut camera = self.rig.cameras[0].clone();
        // The last column is the position of the camera.
        camera.world_from_camera[12..15].iter_mut().for_each(|v| *v *= f64::from(times));
        Self {
            data: self.data.clone(),
            folder: self.folder.clone(),
            receiver: Arc::new(receiver),
            object: self.object.clone(),
            env: self.env.clone(),
            rig: Arc::new(Rig { cameras: vec![camera] }),
        }
    }

    /// Traces the scene, with the object only if `with` is true, and measures the CPU seconds.
    pub fn trace(&self, seed: u64, samples: u32, with: bool, surroundings: Surroundings) -> Traced {
        self.cropped(seed, samples, with, surroundings, 0.001)
    }

    /// Traces with the object and with `shadow_only`, and measures the CPU seconds.
    pub fn shadow(&self, seed: u64, samples: u32, surroundings: Surroundings) -> Traced {
        let params = PathTrace { shadow_only: true, ..params(samples, surroundings, 0.001) };
        self.traced(&params, seed, true)
    }

    /// Same as [`trace`](Self::trace), but with the given `crop`.
    pub fn cropped(
        &self,
        seed: u64,
        samples: u32,
        with: bool,
        surroundings: Surroundings,
        crop: f64,
    ) -> Traced {
        self.traced(&params(samples, surroundings, crop), seed, with)
    }

    fn traced(&self, params: &PathTrace, seed: u64, with: bool) -> Traced {
        let run = |rig: Arc<Rig>| {
            let inputs = path_trace::In {
                receiver: self.receiver.clone(),
                objects: if with { vec![self.object.clone()] } else { Vec::new() },
                rig,
                env: self.env.clone(),
                points: None,
            };
            let cx = self.data.with_seed(seed).context();
            let start = thread_seconds();
            let (out, notes) = PathTrace::run(params, inputs, &cx).unwrap();
            (thread_seconds() - start, cx.counts(), out, notes)
        };
        // The cost of a picture of one pixel is that of setting up: the trees of the meshes and the table of the
        // sky.
        let mut dot = self.rig.cameras[0].clone();
        (dot.width_px, dot.height_px) = (1, 1);
        let (setup, ..) = run(Arc::new(Rig { cameras: vec![dot] }));
        let (seconds, counts, out, notes) = run(self.rig.clone());
        Traced { seconds: seconds - setup, setup, counts, out, notes }
    }

    /// The RGB samples of a reference render.
    pub fn reference(&self, file: &str) -> Vec<f32> {
        let planes = exr::read(file, &self.data.bytes(&format!("{}/{file}", self.folder))).unwrap();
        let [r, g, b] = ["R", "G", "B"].map(|name| planes.find(name).unwrap());
        (0..r.len()).flat_map(|i| [r[i], g[i], b[i]]).collect()
    }
}

/// Result and cost of a trace. Seconds are CPU time of the calling thread.
pub struct Traced {
    /// CPU seconds of the trace, without `setup`.
    pub seconds: f64,
    /// CPU seconds spent before the first pixel is traced, measured with a picture of one pixel.
    pub setup: f64,
    /// Work counts of the node, such as `rays`.
    pub counts: BTreeMap<&'static str, u64>,
    /// The layers that the node returned.
    pub out: path_trace::Out,
    /// Notes of the node.
    pub notes: Notes,
}

/// Denoises the layers of a trace with default parameters. Also returns the CPU seconds of this thread.
pub fn denoised(out: &path_trace::Out, data: &Data) -> (denoise::Out, f64) {
    let inputs = denoise::In {
        points: None,
        without: Arc::clone(&out.without),
        with: Arc::clone(&out.with),
        object: Arc::clone(&out.object),
        depth: Arc::clone(&out.depth),
        normal: Arc::clone(&out.normal),
        variance: Arc::clone(&out.variance),
    };
    let params = Denoise { strength: 1.0, radius_px: 7, method: Method::Means };
    let start = thread_seconds();
    let clean = Denoise::run(&params, inputs, &data.context()).unwrap().0;
    (clean, thread_seconds() - start)
}
