//! Compares the direct light of `path-trace` with the sum over all directions in float64. The scene is a matte
//! floor under a sky with few texels, with a box on the floor. The floor and the top of the box are compared.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use engine::{Context, Kind, Scene, Up};
use glam::{DMat4, DVec3};
use nodes::kinds::path_trace::surroundings::Surroundings;
use nodes::kinds::path_trace::{self, PathTrace};
use scene::math::{equirect, num};
use scene::types::{Camera, Environment, Image, Images, Material, Mesh, Object, Placed, Primitive, Rig};

const WIDTH: u32 = 16;
const HEIGHT: u32 = 12;
const FLOOR: [f32; 3] = [0.5, 0.3, 0.7];
const BOX: f32 = 0.6;
/// Lower corner of the box, which stands on the floor.
const LOW: DVec3 = DVec3::new(-0.3, -0.3, 0.0);
/// Upper corner of the box.
const HIGH: DVec3 = DVec3::new(0.3, 0.3, 0.6);

/// For each layer, two lists of its values at all pixels: the values that the node traced, and the values summed
/// over all directions.
pub struct Direct {
    pub without: [Vec<f64>; 2],
    pub with: [Vec<f64>; 2],
    pub object: [Vec<f64>; 2],
    /// The reported variance of the luminance at each pixel, for `without` and for `with`.
    pub variance: [Vec<f64>; 2],
}

impl Direct {
    pub fn new(samples: u32) -> Self {
        let (camera, sky) = (camera(), sky());
        let params = PathTrace {
            samples,
            max_bounces: 0,
            surroundings: Surroundings::OPEN,
            contact_metres: Some(0.0),
            crop: 0.0,
            ..PathTrace::default()
        };
        let inputs = path_trace::In {
            receiver: Arc::new(floor()),
            objects: vec![Arc::new(block())],
            rig: Arc::new(Rig { cameras: vec![camera.clone()] }),
            env: Arc::new(sky.clone()),
            points: None,
        };
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 5, exhaustive: false }, ".");
        let out = PathTrace::run(&params, inputs, &cx).unwrap().0;
        let picture = |images: &Images, channels: &[usize]| -> Vec<f64> {
            let picture = &images.0[0].picture;
            let pixels = picture.samples().chunks_exact(picture.size().2);
            pixels.flat_map(|p| channels.iter().map(|c| f64::from(p[*c]))).collect()
        };
        let directions = directions(&sky);
        let floor = |objects: bool| summed(&camera, &directions, FLOOR, 0.0, objects);
        Self {
            without: [picture(&out.without, &[0, 1, 2]), floor(false)],
            with: [picture(&out.with, &[0, 1, 2]), floor(true)],
            object: on_top(&camera, &picture(&out.object, &[0, 1, 2]), &directions),
            variance: [picture(&out.variance, &[0]), picture(&out.variance, &[1])],
        }
    }
}

/// Camera that looks straight down.
fn camera() -> Camera {
    let down = DMat4::from_cols(
        DVec3::X.extend(0.0),
        -DVec3::Y.extend(0.0),
        -DVec3::Z.extend(0.0),
        DVec3::new(0.05, 0.02, 3.0).extend(1.0),
    );
    let [cx, cy] = [WIDTH, HEIGHT].map(|n| f64::from(n) / 2.0);
    let f = 20.0;
    let name = "down".to_owned();
    let world_from_camera = down.to_cols_array();
    Camera {
        name,
        width_px: WIDTH,
        height_px: HEIGHT,
        fx: f,
        fy: f,
        cx,
        cy,
        lens: Default::default(),
        world_from_camera,
    }
}

/// A coloured sky with a bright patch. Its texels are so large that no lobe is narrower than a texel.
fn sky() -> Environment {
    let texel = |i: usize| {
        let bright = if i % 16 == 5 && (1..3).contains(&(i / 16)) { 8.0 } else { 0.4 };
        [1.0, 0.7 + 0.3 * ((i % 5) as f32), 0.5 + 0.2 * ((i % 3) as f32)].map(|v| v * bright)
    };
    let image = Image::from_samples(16, 8, 3, (0..128).flat_map(texel).collect());
    Environment { image: image.into(), up: Up::PlusZ, origin: None }
}

fn floor() -> Mesh {
    Mesh {
        positions: vec![[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        colours: vec![FLOOR; 4],
        ..Mesh::default()
    }
}

fn block() -> Placed {
    let corner = |i: usize| [0, 1, 2].map(|a| (if i >> a & 1 == 1 { HIGH[a] } else { LOW[a] }) as f32);
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let primitive = Primitive {
        positions: (0..8).map(corner).collect(),
        triangles: sides.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        ..Primitive::default()
    };
    let material = Material {
        base_colour: [BOX, BOX, BOX, 1.0],
        metallic: 0.0,
        roughness: 1.0,
        ior: 1.0,
        ..Material::default()
    };
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    Placed { object: Arc::new(object), world_from_object: DMat4::IDENTITY }
}

/// Directions above the horizon. Each is paired with the radiance from that direction, multiplied by the cosine of
/// the angle to the vertical and by the solid angle that the direction represents. There are 24 by 24 directions
/// per texel, with equal solid angles within a texel.
fn directions(sky: &Environment) -> Vec<(DVec3, [f64; 3])> {
    const ACROSS: usize = 24;
    let (width, height) = (sky.image.width, sky.image.height);
    let mut all = Vec::new();
    for y in 0..height / 2 {
        let edge = |y: usize| num::f64::cos(PI * y as f64 / height as f64);
        let step = (edge(y) - edge(y + 1)) / ACROSS as f64;
        for (x, sub) in (0..width).flat_map(|x| (0..ACROSS * ACROSS).map(move |sub| (x, sub))) {
            let z = edge(y) - (0.5 + (sub / ACROSS) as f64) * step;
            let u = (x as f64 + ((sub % ACROSS) as f64 + 0.5) / ACROSS as f64) / width as f64;
            let level = equirect::direction(Up::PlusZ, u, 0.5);
            let direction = level * (1.0 - z * z).sqrt() + DVec3::Z * z;
            let solid = TAU / (width * ACROSS) as f64 * step;
            all.push((direction, sky.image.rgb(x, y).map(|v| f64::from(v) * z * solid)));
        }
    }
    all
}

/// True if a ray hits the box. Uses the slab method.
fn meets(from: DVec3, direction: DVec3) -> bool {
    let (a, b) = ((LOW - from) / direction, (HIGH - from) / direction);
    a.max(b).min_element() > a.min(b).max_element().max(0.0)
}

/// Positions within a pixel along one axis, each with the share of the pixel that it represents. The pixel is split
/// at the edges of the base of the box, where the light changes abruptly, and there are three positions in each
/// piece.
fn places(pixel: u32, edges: [f64; 2]) -> Vec<(f64, f64)> {
    let (first, last) = (f64::from(pixel), f64::from(pixel + 1));
    let mut cuts = vec![first, last];
    cuts.extend(edges.into_iter().filter(|edge| first < *edge && *edge < last));
    cuts.sort_by(f64::total_cmp);
    let piece = |ends: &[f64]| {
        let (from, size) = (ends[0], ends[1] - ends[0]);
        [1.0, 3.0, 5.0].map(|sixths| (from + size * sixths / 6.0, size / 3.0))
    };
    cuts.windows(2).flat_map(piece).collect()
}

/// Light that a matte horizontal surface at a given height reflects to each pixel. Each pixel is
/// divided into pieces, and the result is the mean over 3 by 3 positions in every piece.
fn summed(
    camera: &Camera,
    directions: &[(DVec3, [f64; 3])],
    albedo: [f32; 3],
    height: f64,
    objects: bool,
) -> Vec<f64> {
    let mut picture = Vec::new();
    let base = [LOW, HIGH].map(|corner| {
        let local = camera.camera_from_world().transform_point3(corner.with_z(height));
        [local.x / local.z * camera.fx + camera.cx, local.y / local.z * camera.fy + camera.cy]
    });
    for pixel in 0..WIDTH * HEIGHT {
        let mut sum = [0.0; 3];
        let columns = places(pixel % WIDTH, base.map(|[x, _]| x));
        let rows = places(pixel / WIDTH, base.map(|[_, y]| y));
        for ((x, wide), (y, high)) in
            rows.into_iter().flat_map(|row| columns.iter().map(move |column| (*column, row)))
        {
            let ray = camera.direction(x, y);
            let at = camera.eye() + ray * ((height - camera.eye().z) / ray.z);
            for (direction, light) in directions {
                if !(objects && meets(at, *direction)) {
                    sum.iter_mut().zip(light).for_each(|(sum, v)| *sum += wide * high * v);
                }
            }
        }
        picture.extend((0..3).map(|c| f64::from(albedo[c]) / PI * sum[c]));
    }
    picture
}

/// Two lists of the values of the pixels that show only the top of the box: the values that the node traced, and
/// the values summed over all directions.
fn on_top(camera: &Camera, traced: &[f64], directions: &[(DVec3, [f64; 3])]) -> [Vec<f64>; 2] {
    let expected = summed(camera, directions, [BOX; 3], HIGH.z, false);
    let on_top = |pixel: u32| {
        [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().all(|[i, j]| {
            let ray = camera.direction(f64::from(pixel % WIDTH + i), f64::from(pixel / WIDTH + j));
            let at = camera.eye() + ray * ((HIGH.z - camera.eye().z) / ray.z);
            at.x.abs().max(at.y.abs()) < HIGH.x
        })
    };
    let shown: Vec<usize> = (0..WIDTH * HEIGHT)
        .filter(|p| on_top(*p))
        .flat_map(|p| (0..3).map(move |c| (3 * p + c) as usize))
        .collect();
    [traced, &expected].map(|picture| shown.iter().map(|i| picture[*i]).collect())
}
