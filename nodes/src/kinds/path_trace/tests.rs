//! Tests of light transport by closed forms and by relations between renders, and the scenes that the tests share.

use std::sync::Arc;

use engine::{Scene, Up};
use glam::{DMat4, DVec3, Vec3};

use super::*;
use scene::math::color::luminance;
use scene::math::equirect;
use scene::types::{Environment, Images, Material, Mesh, Object, Placed, Primitive, Rig};
use testing::context;

mod adaptive;
mod closed_room;
mod coarse;
mod crop;
mod env_resolution;
mod extremes;
mod glossy;
mod guide;
mod hanging;
mod insertion;
mod lamps;
mod lens;
mod materials;
mod media;
mod near_field;
mod points;
mod receiver_paths;
mod samplers;
mod sampling;
mod touching;
mod visibility;

/// Box with normals that point outwards, or inwards if `inward` is true.
fn box_mesh(low: [f32; 3], high: [f32; 3], inward: bool) -> Mesh {
    let corner = |i: u32| std::array::from_fn(|k| if i >> k & 1 == 1 { high[k] } else { low[k] });
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .map(|[a, b, c]| if inward { [a, c, b] } else { [a, b, c] })
        .collect();
    Mesh { positions: (0..8).map(corner).collect(), triangles, ..Mesh::default() }
}

fn merge(mut a: Mesh, b: Mesh) -> Mesh {
    let first = a.positions.len() as u32;
    a.positions.extend(b.positions);
    a.triangles.extend(b.triangles.iter().map(|t| t.map(|i| i + first)));
    a
}

/// A square plane at height 0 with normal +z.
fn plane(size: f32) -> Mesh {
    Mesh {
        positions: vec![[-size, -size, 0.0], [size, -size, 0.0], [size, size, 0.0], [-size, size, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

fn placed(mesh: &Mesh, material: Material, at: DVec3) -> Arc<Placed> {
    let primitive = Primitive {
        positions: mesh.positions.clone(),
        triangles: mesh.triangles.clone(),
        ..Primitive::default()
    };
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::from_translation(at) })
}

fn matte(albedo: f32) -> Material {
    Material {
        base_colour: [albedo, albedo, albedo, 1.0],
        metallic: 0.0,
        roughness: 1.0,
        ior: 1.0,
        double_sided: true,
        ..Material::default()
    }
}

/// A sphere of the given radius as a fine mesh with smooth normals.
fn ball(radius: f32, material: Material, at: DVec3) -> Arc<Placed> {
    fine_ball(radius, 24, material, at)
}

/// A sphere like [`ball`], with a given number of rings of facets.
fn fine_ball(radius: f32, rings: i32, material: Material, at: DVec3) -> Arc<Placed> {
    let mut primitive = Primitive::default();
    for i in 0..=rings {
        for j in 0..=2 * rings {
            let (st, ct) = scene::math::num::sin_cos(std::f64::consts::PI * f64::from(i) / f64::from(rings));
            let (sp, cp) = scene::math::num::sin_cos(std::f64::consts::PI * f64::from(j) / f64::from(rings));
            let normal = [(st * cp) as f32, (st * sp) as f32, ct as f32];
            primitive.normals.push(normal);
            primitive.positions.push(normal.map(|v| v * radius));
        }
    }
    let row = 2 * rings as u32 + 1;
    for i in 0..rings as u32 {
        for j in 0..row - 1 {
            let [a, b, c, d] = [i * row + j, (i + 1) * row + j, (i + 1) * row + j + 1, i * row + j + 1];
            primitive.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::from_translation(at) })
}

fn rig(eye: DVec3, target: DVec3, size: u32, focal: f64) -> Arc<Rig> {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let down = forward.cross(right);
    let pose = DMat4::from_cols(right.extend(0.0), down.extend(0.0), forward.extend(0.0), eye.extend(1.0));
    let half = f64::from(size) / 2.0;
    Arc::new(Rig {
        cameras: vec![Camera {
            name: "v".to_owned(),
            width_px: size,
            height_px: size,
            fx: focal * half,
            fy: focal * half,
            cx: half,
            cy: half,
            lens: Default::default(),
            world_from_camera: pose.to_cols_array(),
        }],
    })
}

fn params(samples: u32, surroundings: Surroundings) -> PathTrace {
    PathTrace { samples, surroundings, contact_metres: Some(0.0), crop: 0.0, ..PathTrace::default() }
}

fn render(
    params: &PathTrace,
    receiver: &Mesh,
    objects: &[Arc<Placed>],
    rig: &Arc<Rig>,
    env: &Environment,
) -> (Out, Notes) {
    render_in(&context(), params, receiver, objects, rig, env)
}

fn render_in(
    cx: &Context,
    params: &PathTrace,
    receiver: &Mesh,
    objects: &[Arc<Placed>],
    rig: &Arc<Rig>,
    env: &Environment,
) -> (Out, Notes) {
    let inputs = In {
        receiver: Arc::new(receiver.clone()),
        objects: objects.to_vec(),
        rig: rig.clone(),
        env: Arc::new(env.clone()),
        points: None,
    };
    PathTrace::run(params, inputs, cx).expect("renders")
}

fn samples(images: &Images) -> &[f32] {
    images.0[0].picture.samples()
}

fn mean(images: &Images) -> f64 {
    let s = samples(images);
    scene::math::num::ordered_sum(s.iter().copied()) / s.len() as f64
}

/// Mean of the colour channels of fully covered pixels.
fn covered(images: &Images) -> f64 {
    let solid = samples(images).chunks(4).filter(|p| p[3] == 1.0);
    let (sum, n) = solid.fold((0.0, 0.0), |(s, n), p| (s + f64::from(p[0] + p[1] + p[2]) / 3.0, n + 1.0));
    sum / n
}

fn white() -> Environment {
    Environment::constant(Up::PlusZ, [1.0; 3], 64)
}

/// Dim sky with a sun of 4 texels that is not at the zenith.
fn sunny() -> Environment {
    let mut env = Environment::constant(Up::PlusZ, [0.3, 0.4, 0.6], 64);
    for (x, y) in [(40, 6), (41, 6), (40, 7), (41, 7)] {
        env.image.pixel_mut(x, y).copy_from_slice(&[900.0, 850.0, 700.0]);
    }
    env
}

fn inside() -> Arc<Rig> {
    rig(DVec3::new(-1.5, -1.2, 2.0), DVec3::new(0.5, 0.5, 1.0), 24, 1.2)
}

fn room() -> Mesh {
    box_mesh([-2.0, -2.0, 0.0], [2.0, 2.0, 4.0], true)
}

fn shadowed() -> (Mesh, Vec<Arc<Placed>>, Arc<Rig>) {
    let objects = vec![ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, 0.4))];
    (plane(4.0), objects, rig(DVec3::new(0.0, -4.0, 2.5), DVec3::new(0.0, 0.0, 0.2), 32, 4.0))
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool")
}
