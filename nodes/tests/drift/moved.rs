//! Tests that a whole insertion gives the same pictures if the world is moved, enlarged or reduced.

use std::sync::Arc;

use engine::{Context, Kind, Scene, Up};
use glam::{DMat4, DVec3};
use nodes::kinds::composite::{self, Composite};
use nodes::kinds::crop_mesh::{self, CropMesh};
use nodes::kinds::cube_rig::{self, CubeRig};
use nodes::kinds::fuse_hdr::{self, FuseHdr};
use nodes::kinds::path_trace::{self, PathTrace};
use nodes::kinds::place::{self, Place};
use nodes::kinds::predict_exposure::{self, Method, PredictExposure};
use nodes::kinds::shadow_ratio::{self, ShadowRatio};
use nodes::kinds::snap::{self, Snap};
use nodes::kinds::splat_render::{self, SplatRender};
use nodes::kinds::stitch::{self, Stitch};
use render::splat::Drawing;
use scene::types::{Images, Mesh, Object, Pose, Rig, Splats};

use super::Run;

#[path = "../../../tests/extremes/row.rs"]
mod row;

/// Name of a step, and the samples of its picture.
type Step = (&'static str, Vec<f32>);

/// Inputs of an insertion.
struct World {
    splats: Splats,
    mesh: Mesh,
    object: Arc<Object>,
    pose: Pose,
    rig: Rig,
    /// Height at which the mesh is cropped. The part of the mesh below this height is the receiver.
    below: f64,
    metres_per_unit: f64,
    origin: DVec3,
}

/// Splits each coordinate into an f32 and the remainder that f32 cannot hold.
fn halves(place: DVec3) -> [[f32; 3]; 2] {
    let high = place.to_array().map(|v| v as f32);
    let low = place - DVec3::from(high.map(f64::from));
    [high, low.to_array().map(|v| v as f32)]
}

impl World {
    /// Returns the world after scaling it about the origin by `scale` and then moving it by `by`.
    fn moved(&self, scale: f64, by: DVec3) -> Self {
        let to = |place: DVec3| place * scale + by;
        let (mut splats, mut mesh, mut rig) = (self.splats.clone(), self.mesh.clone(), self.rig.clone());
        let places: Vec<_> = (0..splats.means.len()).map(|i| halves(to(self.splats.mean(i)))).collect();
        (splats.means, splats.means_low) = places.into_iter().map(<[_; 2]>::into).unzip();
        splats.scales.iter_mut().for_each(|sizes| *sizes = sizes.map(|v| (f64::from(v) * scale) as f32));
        let places: Vec<_> =
            (0..mesh.positions.len() as u32).map(|i| halves(to(self.mesh.position(i)))).collect();
        (mesh.positions, mesh.positions_low) = places.into_iter().map(<[_; 2]>::into).unzip();
        for camera in &mut rig.cameras {
            let mut matrix = DMat4::from_cols_array(&camera.world_from_camera);
            matrix.w_axis = to(matrix.w_axis.truncate()).extend(1.0);
            camera.world_from_camera = matrix.to_cols_array();
        }
        let mut pose = self.pose.clone();
        pose.world_from_local.w_axis = to(pose.world_from_local.w_axis.truncate()).extend(1.0);
        Self {
            splats,
            mesh,
            object: self.object.clone(),
            pose,
            rig,
            below: self.below * scale + by.z,
            metres_per_unit: self.metres_per_unit / scale,
            origin: by,
        }
    }

    /// Runs the insertion, and returns the result of every step.
    fn inserted(&self) -> Vec<Step> {
        let cx = Context::detached(
            Scene { up: Up::PlusZ, metres_per_unit: self.metres_per_unit, seed: 3, exhaustive: false },
            ".",
        );
        let samples = |images: &Images| images.0[0].picture.samples().to_vec();
        let (splats, rig, pose) =
            (Arc::new(self.splats.clone()), Arc::new(self.rig.clone()), Arc::new(self.pose.clone()));
        let draw = |rig: &Arc<Rig>| {
            let inputs = splat_render::In { splats: splats.clone(), rig: rig.clone(), limit: None };
            SplatRender::run(&(SplatRender::default(), Drawing::default()), inputs, &cx).unwrap().0
        };
        let probe = CubeRig { height_metres: 0.3, size_px: 32, ..CubeRig::default() };
        let probe = CubeRig::run(&probe, cube_rig::In { at: pose.clone() }, &cx).unwrap().0.rig;
        let joined = Stitch { width_px: 64, ..Stitch::default() };
        let joined = Stitch::run(&joined, stitch::In { views: draw(&probe).views }, &cx).unwrap().0;
        let dark = PredictExposure { method: Method::Region, ..PredictExposure::default() };
        let clipped = predict_exposure::In { pano: joined.pano.clone() };
        let dark = PredictExposure::run(&dark, clipped, &cx).unwrap().0.brackets;
        let light = fuse_hdr::In { base: joined.pano, brackets: dark };
        let light = FuseHdr::run(&FuseHdr::default(), light, &cx).unwrap().0;
        let cropped = CropMesh { below_height: Some(self.below), ..CropMesh::default() };
        let receiver = crop_mesh::In { mesh: Arc::new(self.mesh.clone()) };
        let receiver = CropMesh::run(&cropped, receiver, &cx).unwrap().0.mesh;
        let object = self.object.clone();
        let ground = snap::In {
            object: object.clone(),
            pose: pose.clone(),
            mesh: Some(receiver.clone()),
            splats: None,
        };
        let ground = Snap::run(&Snap::default(), ground, &cx).unwrap().0.pose;
        let ground = (ground.world_from_local.w_axis.truncate() - self.origin) * self.metres_per_unit;
        let placed = place::In { object, pose };
        let placed = Place::run(&Place {}, placed, &cx).unwrap().0.placed;
        let background = draw(&rig).colour;
        let trace = PathTrace { samples: 4, ..PathTrace::default() };
        let inputs = path_trace::In { receiver, objects: vec![placed], rig, env: light.env, points: None };
        let trace = PathTrace::run(&trace, inputs, &cx).unwrap().0;
        let pair = shadow_ratio::In { without: trace.without.clone(), with: trace.with.clone() };
        let shadow = ShadowRatio::run(&ShadowRatio::default(), pair, &cx).unwrap().0.shadow;
        let layers = composite::In {
            background: background.clone(),
            object: trace.object.clone(),
            shadow: Some(shadow.clone()),
            added: None,
            front: None,
            variance: None,
        };
        let picture = Composite::run(&Composite::default(), layers, &cx).unwrap().0.image;
        vec![
            ("background", samples(&background)),
            ("environment", samples(&light.image)),
            ("ground", ground.as_vec3().to_array().to_vec()),
            ("R0", samples(&trace.without)),
            ("R1", samples(&trace.with)),
            ("object", samples(&trace.object)),
            ("ratio", samples(&shadow)),
            ("picture", samples(&picture)),
        ]
    }
}

/// Runs the insertion in `world`, and returns the largest difference from `here` for each step. Where a sample of
/// `here` is above 1, the difference is divided by that sample.
fn off(world: &World, here: &[Step]) -> Vec<(&'static str, f64)> {
    let worst = |((step, a), (_, b)): (&Step, &Step)| {
        assert_eq!(a.len(), b.len());
        let pairs = a.iter().zip(b).filter(|(a, b)| a.is_finite() || b.is_finite());
        (*step, pairs.map(|(a, b)| f64::from((a - b).abs() / b.abs().max(1.0))).fold(0.0, f64::max))
    };
    world.inserted().iter().zip(here).map(worst).collect()
}

/// No step gives a different picture if splats, mesh, cameras, probe, object and all parameters in world units are
/// moved by a million units, or scaled up or down by a factor of a million. This test fails if the mesh is rounded
/// to f32.
#[test]
fn the_whole_insertion_does_not_depend_on_where_or_how_large_the_world_is() {
    let run = Run::new();
    let world = World {
        splats: run.value("demo.splats"),
        mesh: run.value("demo.proxy"),
        object: Arc::new(run.value("demo.object")),
        pose: run.value("pose.pose"),
        rig: run.value("demo.rig"),
        below: 2.037,
        metres_per_unit: 1.0,
        origin: DVec3::ZERO,
    };
    let here = world.inserted();
    let million = 1_048_576.0;
    for (name, scale, by) in [
        ("moved by 1e6", 1.0, DVec3::new(million, -0.5 * million, 0.25 * million)),
        ("scaled by 1e6", million, DVec3::ZERO),
        ("scaled by 1e-6", 1.0 / million, DVec3::ZERO),
    ] {
        for (step, off) in off(&world.moved(scale, by), &here) {
            row::row(13, &format!("whole insertion {name}, {step}"), off, 1e-5);
        }
    }
    let mut rounded = world.moved(1.0, DVec3::new(million, -0.5 * million, 0.25 * million));
    rounded.mesh.positions_low.clear();
    let lost = off(&rounded, &here);
    assert!(lost.iter().any(|(step, off)| *step == "R0" && *off > 1e-3), "{lost:?}");
}
