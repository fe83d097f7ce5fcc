//! Compares the two ways to render a panorama with a reference. The reference is a panorama in float64, made of
//! views from cameras with a narrow angle of view, with three samples per pixel along each axis.

use std::f64::consts::PI;
use std::sync::Arc;

use engine::{Kind, Up};
use glam::{DMat4, DVec3};
use nodes::kinds::cube_rig::{self, CubeRig, Turn};
use nodes::kinds::splat_panorama::{self, SplatPanorama};
use nodes::kinds::splat_render::{self, SplatRender};
use nodes::kinds::stitch::{self, Holes, Stitch};
use render::splat::{Drawing, Precision, Sort};
use scene::math::equirect;
use scene::math::num;
use scene::types::{Camera, Panorama, Pose, Rig, Splats};

use crate::{Bench, EYE, look, timed};

const WIDTH: usize = 512;

fn faces(sort: Sort, precision: Precision) -> (SplatRender, Drawing) {
    (SplatRender { sort, limit_sigmas: 1.0 }, Drawing { precision, ..Drawing::default() })
}

fn stitched(
    scene: &Arc<Splats>,
    rig: Arc<Rig>,
    render: &(SplatRender, Drawing),
    bench: &Bench,
) -> Arc<Panorama> {
    let input = splat_render::In { splats: scene.clone(), rig, limit: None };
    let views = SplatRender::run(render, input, &bench.cx).unwrap().0.views;
    let params = Stitch { width_px: WIDTH as u32, holes: Holes::PushPull, hole_alpha: 0.25, as_views: false };
    Stitch::run(&params, stitch::In { views }, &bench.cx).unwrap().0.pano
}

fn pose() -> Arc<Pose> {
    Arc::new(Pose { world_from_local: DMat4::from_translation(EYE) })
}

fn cube(size_px: u32, turn: Turn, bench: &Bench) -> Arc<Rig> {
    let params = CubeRig { height_metres: 0.0, size_px, guard_deg: 3.0, turn };
    CubeRig::run(&params, cube_rig::In { at: pose() }, &bench.cx).unwrap().0.rig
}

fn direct(scene: &Arc<Splats>, supersample: u32, precision: Precision, bench: &Bench) -> Arc<Panorama> {
    let own = SplatPanorama {
        height_metres: 0.0,
        width_px: WIDTH as u32,
        supersample,
        holes: Holes::PushPull,
        hole_alpha: 0.25,
    };
    let params = (own, Drawing { precision, ..Drawing::default() });
    let input = splat_panorama::In { splats: scene.clone(), at: pose(), limit: None };
    SplatPanorama::run(&params, input, &bench.cx).unwrap().0.pano
}

/// Rig of 16 by 8 cameras. Each camera covers an angle of 22.5 degrees in both directions, plus a margin.
fn narrow() -> Arc<Rig> {
    let focal = 3.0 * WIDTH as f64 / (2.0 * PI);
    let size = (2.0 * focal * num::f64::tan(18.5_f64.to_radians())).ceil();
    let cameras = (0..128).map(|i| {
        let (u, v) = ((f64::from(i % 16) + 0.5) / 16.0, (f64::from(i / 16) + 0.5) / 8.0);
        let forward = equirect::direction(Up::PlusZ, u, v);
        let right = forward.cross(DVec3::Z).normalize();
        Camera {
            name: format!("{i}"),
            width_px: size as u32,
            height_px: size as u32,
            fx: focal,
            fy: focal,
            cx: 0.5 * size,
            cy: 0.5 * size,
            lens: Default::default(),
            world_from_camera: look(right, forward.cross(right), forward, EYE),
        }
    });
    Arc::new(Rig { cameras: cameras.collect() })
}

/// PSNR in dB, weighted by solid angle, over the rows whose angle from the horizon is at least `from_deg` and less
/// than `to_deg`.
fn psnr(seen: &[f32], truth: &[f32], from_deg: f64, to_deg: f64) -> f64 {
    let (mut squares, mut weights) = (0.0, 0.0);
    for y in 0..WIDTH / 2 {
        let latitude = (90.0 - 180.0 * (y as f64 + 0.5) / (WIDTH / 2) as f64).abs();
        if latitude < from_deg || latitude >= to_deg {
            continue;
        }
        let weight = equirect::pixel_solid_angle(WIDTH, WIDTH / 2, y);
        for i in y * WIDTH * 3..(y + 1) * WIDTH * 3 {
            let off = f64::from(seen[i].clamp(0.0, 1.0)) - f64::from(truth[i].clamp(0.0, 1.0));
            squares += weight * off * off;
            weights += weight;
        }
    }
    -10.0 * num::f64::log10(squares / weights)
}

fn square(x: f64) -> f64 {
    x * x
}

/// Measures the seams between the faces of a rig. Returns the root-mean-square change of the error between
/// neighbouring pixels of a row that lie on different faces, divided by the same quantity for neighbours on the
/// same face. A result of 1 means that there is no seam.
fn seam(seen: &[f32], truth: &[f32], rig: &Rig) -> f64 {
    let face = |x: usize, y: usize| {
        let d = equirect::direction(
            Up::PlusZ,
            (x as f64 + 0.5) / WIDTH as f64,
            (y as f64 + 0.5) / (WIDTH / 2) as f64,
        );
        let along = |camera: &Camera| camera.world_from_camera().z_axis.truncate().dot(d);
        (0..rig.cameras.len()).max_by(|a, b| along(&rig.cameras[*a]).total_cmp(&along(&rig.cameras[*b])))
    };
    let mut sums = [[0.0_f64; 2]; 2];
    // Far from the poles, where the distances of both kinds of neighbours are equal.
    for y in WIDTH / 8..WIDTH * 3 / 8 {
        for x in 0..WIDTH {
            let next = (x + 1) % WIDTH;
            let error = |x: usize, c: usize| {
                f64::from(seen[(y * WIDTH + x) * 3 + c]) - f64::from(truth[(y * WIDTH + x) * 3 + c])
            };
            let at_seam = usize::from(face(x, y) != face(next, y));
            sums[at_seam][0] += (0..3).map(|c| square(error(x, c) - error(next, c))).sum::<f64>();
            sums[at_seam][1] += 1.0;
        }
    }
    (sums[1][0] / sums[1][1] / (sums[0][0] / sums[0][1])).sqrt()
}

/// Same as [`seam`], but for the seam between columns `WIDTH - 1` and 0, where the panorama wraps around.
fn wrap(seen: &[f32], truth: &[f32]) -> f64 {
    let mut sums = [[0.0_f64; 2]; 2];
    for y in 0..WIDTH / 2 {
        for x in 0..WIDTH {
            for c in 0..3 {
                let error =
                    |x: usize| f64::from(seen[(y * WIDTH + x) * 3 + c] - truth[(y * WIDTH + x) * 3 + c]);
                let to = &mut sums[usize::from(x + 1 == WIDTH)];
                to[0] += square(error(x) - error((x + 1) % WIDTH));
                to[1] += 1.0;
            }
        }
    }
    (sums[1][0] / sums[1][1] / (sums[0][0] / sums[0][1])).sqrt()
}

pub fn table(bench: &Bench) {
    let garden = bench.garden();
    let truth = stitched(&garden, narrow(), &faces(Sort::Distance, Precision::F64), bench);
    let truth = truth.image.samples().to_vec();
    save("truth", &truth);
    let aligned = cube(128, Turn::Aligned, bench);
    let turned = cube(128, Turn::OffAxis, bench);
    println!(
        "\n| {WIDTH} px panorama of garden_sog | dB | within 45 deg of the horizon | within 15 deg of a pole | face seams | wrap | CPU s |"
    );
    println!("|---|---|---|---|---|---|---|");
    let line = |name: &str, seen: &[f32], cpu: f64, rig: &Rig| {
        save(name, seen);
        println!(
            "| {name} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {cpu:.2} |",
            psnr(seen, &truth, 0.0, 90.0),
            psnr(seen, &truth, 0.0, 45.0),
            psnr(seen, &truth, 75.0, 90.0),
            seam(seen, &truth, rig),
            wrap(seen, &truth),
        );
    };
    for (turn, sort, sizes) in [
        (Turn::OffAxis, Sort::Depth, &[128, 256, 512][..]),
        (Turn::OffAxis, Sort::Distance, &[128, 256][..]),
        (Turn::Aligned, Sort::Depth, &[128][..]),
    ] {
        for size in sizes {
            let render = faces(sort, Precision::F32);
            let (pano, cpu) = timed(1, || stitched(&garden, cube(*size, turn, bench), &render, bench));
            let rig = if turn == Turn::OffAxis { &turned } else { &aligned };
            line(&format!("faces of {size} px, {turn:?}, {sort:?}"), pano.image.samples(), cpu, rig);
        }
    }
    for (samples, precision) in
        [(1, Precision::F32), (2, Precision::F32), (4, Precision::F32), (2, Precision::F64)]
    {
        let (pano, cpu) = timed(2, || direct(&garden, samples, precision, bench));
        let name = format!("direct, {samples}x{samples} samples, {precision:?}");
        line(&name, pano.image.samples(), cpu, &turned);
    }
}

/// Writes a picture as PNG to the folder `SPLAT_TABLES_OUT`, for inspection. Does nothing if this variable is not
/// set.
fn save(name: &str, samples: &[f32]) {
    let Some(folder) = std::env::var_os("SPLAT_TABLES_OUT") else { return };
    let name = name.replace([' ', ','], "_");
    let file = std::fs::File::create(std::path::Path::new(&folder).join(format!("{name}.png"))).unwrap();
    let mut encoder = png::Encoder::new(file, WIDTH as u32, WIDTH as u32 / 2);
    encoder.set_color(png::ColorType::Rgb);
    let bytes: Vec<u8> = samples.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
}
