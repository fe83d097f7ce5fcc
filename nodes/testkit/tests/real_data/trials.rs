//! Tests with small files of other tools. The expected values are described in the README of
//! `../shared/data/trials`.

use std::sync::Arc;

use engine::{Context, InputFile, Kind, NodeError, Notes, Scene, SourceRoot, Up};
use nodes::kinds::camera;
use nodes::kinds::load_cameras::{self, LoadCameras};
use nodes::kinds::load_environment::{self, FileEncoding, LoadEnvironment};
use nodes::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
use nodes::kinds::load_object::{self, LoadObject};
use nodes::kinds::load_splats::{self, LoadSplats};
use nodes::kinds::splat_render::{self, SplatRender};
use render::splat::{Compensation, Drawing, Sort};
use scene::types::{Mesh, Object, Rig, Splats};

use super::data;

fn cx(metres_per_unit: f64) -> Context {
    let scene = Scene { up: Up::PlusZ, metres_per_unit, seed: 1, exhaustive: false };
    Context::detached(scene, data().path("trials"))
}

fn splats(path: &str) -> Result<(Arc<Splats>, Notes), NodeError> {
    let params = LoadSplats {
        path: InputFile(path.to_owned()),
        more: Vec::new(),
        strict: false,
        max_extent: 1e6,
        level: 0,
        matrix: None,
        frame: load_splats::Frame::ByFormat,
    };
    LoadSplats::sources(&params, &SourceRoot::new(data().path("trials")))?;
    LoadSplats::run(&params, load_splats::In {}, &cx(1.0)).map(|(out, notes)| (out.splats, notes))
}

fn mesh(path: &str) -> Result<(Arc<Mesh>, Notes), NodeError> {
    let path = InputFile(path.to_owned());
    let p = LoadMesh { path, colours: ColourEncoding::Auto, frame: MeshFrame::World, matrix: None };
    LoadMesh::run(&p, load_mesh::In {}, &cx(1.0)).map(|(out, notes)| (out.mesh, notes))
}

fn object(path: &str) -> Result<(Arc<Object>, Notes), NodeError> {
    let p = LoadObject::of(InputFile(path.to_owned()));
    LoadObject::run(&p, load_object::In {}, &cx(1.0)).map(|(out, notes)| (out.object, notes))
}

/// Rig with one camera, for example the camera in `view.ron` or `insert.ron`.
fn rig(eye: [f64; 3], target: [f64; 3], size: [u32; 2], fov_y_deg: f64) -> Arc<Rig> {
    let [width_px, height_px] = size;
    let name = "camera".to_owned();
    let p = camera::Camera { eye, target, width_px, height_px, fov_y_deg, roll_deg: 0.0, name };
    camera::Camera::run(&p, camera::In {}, &cx(1.0)).unwrap().0.rig
}

/// Renders splats. Returns the mean colour of the picture, and the notes.
fn mean(splats: &Arc<Splats>, rig: &Arc<Rig>, drawing: Drawing, metres: f64) -> ([f64; 3], Notes) {
    let params = (SplatRender { sort: Sort::Depth, limit_sigmas: 5.0 }, drawing);
    let inputs = splat_render::In { splats: splats.clone(), rig: rig.clone(), limit: None };
    let (out, notes) = SplatRender::run(&params, inputs, &cx(metres)).unwrap();
    let picture = &out.colour.0[0].picture;
    let (width, height, channels) = picture.size();
    let sum = |c: usize| picture.samples().iter().skip(c).step_by(channels).map(|v| f64::from(v.min(1.0)));
    ([0, 1, 2].map(|c| sum(c).sum::<f64>() / (width * height) as f64), notes)
}

fn view(path: &str) -> [f64; 3] {
    let chart = rig([0.0, -4.0, 0.0], [0.0; 3], [200, 200], 36.0);
    mean(&splats(path).unwrap().0, &chart, Drawing::default(), 1.0).0
}

fn near(a: [f64; 3], b: [f64; 3], bar: f64) {
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= bar), "{a:?} {b:?}");
}

#[test]
fn splats_of_other_tools_give_their_picture() {
    near(view("opacity_40.ply"), [0.236, 0.236, 0.142], 6e-4);
    near(view("opacity_inf.ply"), view("opacity_40.ply"), 1e-6);
    near(view("mip_brush.ply"), [0.0107, 0.0107, 0.0064], 1e-4);
    let on = Drawing { compensation: Compensation::On, ..Drawing::default() };
    let front = rig([0.0, -4.0, 0.0], [0.0; 3], [200, 200], 36.0);
    near(view("mip_brush.ply"), mean(&splats("mip_plain.ply").unwrap().0, &front, on, 1.0).0, 1e-6);
    near(view("streamed_sog"), [0.137, 0.137, 0.082], 6e-4);
    near(view("streamed_sog/lod-meta.json"), view("streamed_sog/0_0"), 1e-6);
    near(view("streamed_sog"), view("streamed_sog/0_0"), 1e-6);
    // Flat across their third axis, by the definition of 2DGS: here they are seen from the side.
    let (flat, chart) = (splats("two_scales.ply").unwrap().0, splats("chart.ply").unwrap().0);
    assert!(
        (flat.means == chart.means) && flat.scales.iter().all(|s| s[0] == chart.scales[0][0] && s[2] == 0.0)
    );
    near(view("rgb_mode.ply"), view("chart.ply"), 1.0 / 255.0);
    assert_eq!(splats("ascii.ply").unwrap().0.len(), 64);
}

/// A place that is reduced to a twentieth of its size gives the same picture if `metres_per_unit` is set
/// accordingly. Otherwise a warning reports that the near plane cuts away splats.
#[test]
fn a_place_in_a_unit_cube_is_whole_or_reported() {
    let eye = |s: f64| rig([0.6 * s, -3.2 * s, 1.6 * s], [0.0, 0.0, 0.45 * s], [160, 120], 40.0);
    let (small, large) = (splats("place_unit_cube.ply").unwrap().0, splats("place.ply").unwrap().0);
    let (wanted, notes) = mean(&large, &eye(1.0), Drawing::default(), 1.0);
    assert!(notes.iter().all(|note| note.id != "near-cuts"));
    let (found, notes) = mean(&small, &eye(0.05), Drawing::default(), 20.0);
    near(found, wanted, 2e-3);
    assert!(notes.iter().all(|note| note.id != "near-cuts"));
    let (_, notes) = mean(&small, &eye(0.05), Drawing::default(), 1.0);
    assert!(notes.iter().any(|note| note.id == "near-cuts"));
}

fn cameras(path: &str) -> Result<Arc<Rig>, NodeError> {
    let p = LoadCameras::of(InputFile(format!("cameras/{path}")));
    LoadCameras::run(&p, load_cameras::In {}, &cx(1.0)).map(|(out, _)| out.rig)
}

#[test]
fn cameras_of_other_tools_give_their_picture() {
    let chart = splats("chart.ply").unwrap().0;
    for path in ["plain.json", "bom.json", "angle_over_top.json", "colmap_tabs"] {
        let rig = cameras(path).unwrap_or_else(|e| panic!("{path}: {e}"));
        near(mean(&chart, &rig, Drawing::default(), 1.0).0, [0.2685, 0.2699, 0.1617], 1e-3);
    }
    let p = LoadCameras {
        dataparser: Some(InputFile("cameras/nerfstudio/dataparser_transforms.json".to_owned())),
        ..LoadCameras::of(InputFile("cameras/nerfstudio/transforms.json".to_owned()))
    };
    let rig = LoadCameras::run(&p, load_cameras::In {}, &cx(1.0)).unwrap().0.rig;
    let exported = splats("cameras/nerfstudio/splat.ply").unwrap().0;
    let close = Drawing { near: 0.05, ..Drawing::default() };
    near(mean(&exported, &rig, close, 1.0).0, [0.2685, 0.2699, 0.1617], 1e-3);
    let error = cameras("fisheye_flag.json").err().unwrap().to_string();
    assert!(error.contains("distortion") && error.contains("fisheye"), "{error}");
    assert_eq!(cameras("ring.json").unwrap().cameras.len(), 4);
}

#[test]
fn objects_of_other_tools_look_as_they_should() {
    let (right, _) = object("object.glb").unwrap();
    let (turned, notes) = object("inside_out.glb").unwrap();
    assert!(notes.iter().any(|note| note.id == "faces-turned"));
    let volume = |object: &Object| -> f64 {
        let of = |p: &scene::types::Primitive| -> f64 {
            p.triangles
                .iter()
                .map(|t| {
                    let [a, b, c] = t.map(|v| glam::DVec3::from(p.positions[v as usize].map(f64::from)));
                    a.dot(b.cross(c)) / 6.0
                })
                .sum()
        };
        object.primitives.iter().map(of).sum()
    };
    assert!(volume(&right) > 0.0 && (volume(&turned) - volume(&right)).abs() < 1e-6);
    let (glossy, notes) = object("spec_gloss.glb").unwrap();
    let [r, g, b, _] = glossy.materials[0].base_colour;
    near([r, g, b].map(f64::from), [0.8, 0.2, 0.1], 1e-6);
    assert!(!notes.is_degraded());
    let (slashes, _) = object("backslash/object.gltf").unwrap();
    assert_eq!(slashes.textures.len(), 1);
    assert!(object("lfs_pointer.glb").err().unwrap().message().contains("Git LFS"));
}

#[test]
fn meshes_and_lights_of_other_tools_are_read() {
    let (of_obj, _) = mesh("mesh.obj").unwrap();
    assert!(!of_obj.triangles.is_empty());
    let (bytes, notes) = mesh("mesh_colours_to_255.ply").unwrap();
    assert!(notes.iter().any(|note| note.id == "colour-range"));
    assert!(bytes.colours.as_flattened().iter().any(|c| *c < 0.99));
    let light = |path: &str| {
        let path = InputFile(path.to_owned());
        let p = LoadEnvironment {
            path,
            encoding: FileEncoding::Auto,
            layer: String::new(),
            rotation_deg: 0.0,
            scale: 1.0,
            origin: None,
        };
        LoadEnvironment::run(&p, load_environment::In {}, &cx(1.0)).map(|(out, _)| out.env)
    };
    let env = light("exposure_0.hdr").unwrap();
    // The largest mantissa, 255 of 256, stands for 1: one step of 8 bits.
    near(env.image.rgb(0, 0).map(f64::from), [0.25, 0.5, 1.0], 1.0 / 256.0);
}
