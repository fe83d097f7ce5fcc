//! The scenes of `render-refs`.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use engine::{Context, InputFile, Kind, Scene, Up};
use glam::DMat4;
use nodes::io::exr;
use nodes::kinds::load_environment::{self, LoadEnvironment};
use nodes::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
use nodes::kinds::load_object::{self, LoadObject};
use nodes::kinds::override_material::{self, OverrideMaterial, Surface};
use nodes::kinds::path_trace::surroundings::Surroundings;
use nodes::kinds::path_trace::{self, PathTrace};
use nodes::types::{Camera, Environment, Images, Mesh, Placed, Rig};

/// A scene, ready to trace.
pub struct Case {
    folder: std::path::PathBuf,
    pub receiver: Arc<Mesh>,
    pub object: Arc<Placed>,
    pub env: Arc<Environment>,
    pub rig: Arc<Rig>,
}

/// A context of a seed.
pub fn context(folder: &Path, seed: u64) -> Context {
    Context::detached(Scene { up: Up::PlusY, metres_per_unit: 1.0, seed, exhaustive: false }, folder)
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
    pub fn load(data: &Path, name: &str) -> Self {
        let folder = data.join("render-refs").join(name);
        let scene: serde_json::Value =
            serde_json::from_slice(&std::fs::read(folder.join("scene.json")).unwrap()).unwrap();
        let file = |name: &str| InputFile(name.to_owned());
        let cx = context(&folder, 1);
        let mesh =
            LoadMesh { path: file("receiver.ply"), frame: MeshFrame::World, colours: ColourEncoding::Srgb };
        let receiver = LoadMesh::run(&mesh, load_mesh::In {}, &cx).unwrap().0.mesh;
        let object = LoadObject { path: file("object.glb"), scene: None };
        let object = LoadObject::run(&object, load_object::In {}, &cx).unwrap().0.object;
        let albedo = &scene["object_material"]["albedo"];
        let material = OverrideMaterial {
            surface: Surface::Diffuse,
            colour: std::array::from_fn(|k| albedo[k].as_f64().unwrap()),
            metallic: 0.0,
            roughness: 1.0,
        };
        let object =
            OverrideMaterial::run(&material, override_material::In { object }, &cx).unwrap().0.object;
        let env = LoadEnvironment {
            path: file("env.exr"),
            layer: String::new(),
            rotation_deg: 0.0,
            scale: 1.0,
            origin: None,
        };
        let env = LoadEnvironment::run(&env, load_environment::In {}, &cx).unwrap().0.env;
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
            world_from_camera: matrix(&camera["c2w"]).to_cols_array(),
        };
        let world_from_object = matrix(&scene["object_transform"]);
        let object = Arc::new(Placed { object, world_from_object });
        Self { folder, receiver, object, env, rig: Arc::new(Rig { cameras: vec![camera] }) }
    }

    /// The same with the camera `times` as far away, and a receiver larger by as much.
    pub fn with_camera_at(&self, times: f32) -> Self {
        let mut receiver = Mesh::clone(&self.receiver);
        receiver.positions.iter_mut().flatten().for_each(|v| *v *= times);
        let mut camera = self.rig.cameras[0].clone();
        // The last column is where it stands.
        camera.world_from_camera[12..15].iter_mut().for_each(|v| *v *= f64::from(times));
        Self {
            folder: self.folder.clone(),
            receiver: Arc::new(receiver),
            object: self.object.clone(),
            env: self.env.clone(),
            rig: Arc::new(Rig { cameras: vec![camera] }),
        }
    }

    /// Traces with or without the object; gives the CPU seconds too.
    pub fn trace(&self, seed: u64, samples: u32, with: bool, surroundings: Surroundings) -> Traced {
        self.cropped(seed, samples, with, surroundings, 0.001)
    }

    /// Traces only what the object changes.
    pub fn shadow(&self, seed: u64, samples: u32, surroundings: Surroundings) -> Traced {
        let params = PathTrace { shadow_only: true, ..params(samples, surroundings, 0.001) };
        self.traced(&params, seed, true)
    }

    /// The same with another `crop`.
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
            };
            let cx = context(&self.folder, seed);
            let start = super::cpu_seconds();
            let out = PathTrace::run(params, inputs, &cx).unwrap().0;
            (super::cpu_seconds() - start, cx.counts(), out)
        };
        // A picture of one pixel costs what stands before the rays: trees and the table of the sky.
        let mut dot = self.rig.cameras[0].clone();
        (dot.width_px, dot.height_px) = (1, 1);
        let (setup, ..) = run(Arc::new(Rig { cameras: vec![dot] }));
        let (seconds, counts, out) = run(self.rig.clone());
        Traced { seconds: seconds - setup, setup, counts, out }
    }

    /// The RGB of a reference render.
    pub fn reference(&self, file: &str) -> Vec<f32> {
        let planes = exr::read(file, &std::fs::read(self.folder.join(file)).unwrap()).unwrap();
        let [r, g, b] = ["R", "G", "B"].map(|name| planes.find(name).unwrap());
        (0..r.len()).flat_map(|i| [r[i], g[i], b[i]]).collect()
    }
}

/// Result and cost of a trace.
pub struct Traced {
    pub seconds: f64,
    pub setup: f64,
    pub counts: BTreeMap<&'static str, u64>,
    pub out: path_trace::Out,
}

/// RGB of the first picture.
pub fn rgb(images: &Images) -> Vec<f32> {
    let picture = &images.0[0].picture;
    picture.samples().chunks(picture.size().2).flat_map(|p| [p[0], p[1], p[2]]).collect()
}

/// Mean of the squared error over (reference squared + 0.01), as the notes define it.
pub fn relative_mse(ours: &[f32], reference: &[f32]) -> f64 {
    let pairs = ours.iter().zip(reference).map(|(a, r)| (f64::from(*a), f64::from(*r)));
    pairs.map(|(a, r)| (a - r) * (a - r) / (r * r + 0.01)).sum::<f64>() / ours.len() as f64
}
