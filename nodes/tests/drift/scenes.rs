//! Reference implementations in float64 for pictures of splats and of triangles. For each pixel, they visit all
//! splats or all triangles.

use std::f64::consts::PI;

use engine::Up;
use glam::{DMat3, DQuat, DVec3};
use scene::math::{equirect, num};
use scene::types::{Camera, Mesh, Placed, Splats};

use super::references::{encoded, light};

/// Values of the real spherical harmonics in a unit direction, sorted by degree l and within a degree by order m,
/// from -l to l. Uses the recurrence of the associated Legendre functions, with the Condon-Shortley phase (-1)^m.
fn harmonics(degree: u32, d: DVec3) -> Vec<f64> {
    let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
    // sin(theta)^m cos(m phi) and sin(theta)^m sin(m phi).
    let turns: Vec<(f64, f64)> =
        std::iter::successors(Some((1.0, 0.0)), |(c, s)| Some((c * d.x - s * d.y, c * d.y + s * d.x)))
            .take(degree as usize + 1)
            .collect();
    let legendre = |l: i32, m: i32| {
        let first = (1..=m).map(|k| f64::from(2 * k - 1)).product::<f64>();
        let (mut before, mut last) = (0.0, first);
        for k in m + 1..=l {
            let next = (f64::from(2 * k - 1) * d.z * last - f64::from(k + m - 1) * before) / f64::from(k - m);
            (before, last) = (last, next);
        }
        last
    };
    let value = |l: i32, m: i32| {
        let n = m.abs();
        let scale = (f64::from(2 * l + 1) / (4.0 * PI) * factorial(l - n) / factorial(l + n)).sqrt();
        let (cosine, sine) = turns[n as usize];
        let turned = if m < 0 { sine } else { cosine } * if n % 2 == 1 { -1.0 } else { 1.0 };
        scale * legendre(l, n) * if m == 0 { 1.0 } else { 2.0_f64.sqrt() * turned }
    };
    (0..=degree as i32).flat_map(|l| (-l..=l).map(move |m| (l, m))).map(|(l, m)| value(l, m)).collect()
}

/// Splat projected to the picture.
struct Footprint {
    depth: f64,
    centre: [f64; 2],
    /// Inverse of the covariance: xx, xy, yy.
    shape: [f64; 3],
    opacity: f64,
    rgb: [f64; 3],
}

impl Footprint {
    /// Footprint of a splat. `centre` is its projected centre, and `rows` are the derivatives of the projection
    /// with respect to the position. The low-pass filter adds a variance of 0.3.
    fn new(splats: &Splats, i: usize, eye: DVec3, depth: f64, centre: [f64; 2], rows: [DVec3; 2]) -> Self {
        let [xx, xy, yy] = [rows[0].dot(rows[0]) + 0.3, rows[0].dot(rows[1]), rows[1].dot(rows[1]) + 0.3];
        let determinant = xx * yy - xy * xy;
        let basis = harmonics(splats.sh_degree, (splats.mean(i) - eye).normalize());
        let triples = &splats.sh[i * basis.len()..][..basis.len()];
        let channel = |c: usize| basis.iter().zip(triples).map(|(b, sh)| b * f64::from(sh[c])).sum::<f64>();
        Self {
            depth,
            centre,
            shape: [yy / determinant, -xy / determinant, xx / determinant],
            opacity: f64::from(splats.opacities[i]),
            rgb: [0, 1, 2].map(|c| (channel(c) + 0.5).max(0.0)),
        }
    }
}

/// Axes of a splat in the world. Their lengths are the standard deviations.
fn axes(splats: &Splats, i: usize) -> DMat3 {
    let [w, x, y, z] = splats.quats[i].map(f64::from);
    let turn = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    turn * DMat3::from_diagonal(DVec3::from(splats.scales[i].map(f64::from)))
}

/// Premultiplied colour and alpha of splats at a position of the picture. The splats must be sorted, nearest first.
/// If `period` is given, the picture wraps around horizontally with this period.
fn blended(footprints: &[Footprint], at: [f64; 2], period: Option<f64>) -> [f64; 4] {
    let (mut rgb, mut clear) = ([0.0; 3], 1.0);
    for Footprint { centre, shape: [xx, xy, yy], opacity, rgb: colour, .. } in footprints {
        let [dx, dy] = [at[0] - centre[0], at[1] - centre[1]];
        let dx = period.map_or(dx, |period| dx - period * (dx / period).round());
        let power = -0.5 * (xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy);
        // Splats far below the alpha cutoff need no exponential.
        let alpha = if power < -6.0 { 0.0 } else { (opacity * num::f64::exp(power)).min(0.99) };
        if alpha < 1.0 / 255.0 {
            continue;
        }
        if clear * (1.0 - alpha) < 1e-4 {
            break;
        }
        rgb.iter_mut().zip(colour).for_each(|(sum, c)| *sum += clear * alpha * c);
        clear *= 1.0 - alpha;
    }
    let [r, g, b] = rgb;
    [r, g, b, 1.0 - clear]
}

/// Premultiplied colour and alpha of each pixel: EWA splatting (Zwicker et al. 2001) with the constants of Kerbl et
/// al. 2023.
pub fn splatted(splats: &Splats, camera: &Camera) -> Vec<f64> {
    let world = camera.world_from_camera();
    let turn = DMat3::from_mat4(world).transpose();
    let eye = world.w_axis.truncate();
    let size = [camera.width_px, camera.height_px].map(f64::from);
    let focal = [camera.fx, camera.fy];
    let footprint = |i: usize| {
        let p = turn * (splats.mean(i) - eye);
        if p.z <= 0.2 {
            return None;
        }
        let axes = turn * axes(splats, i);
        // Far outside the picture, the slope of the projection is clamped.
        let held = |k: usize| (p[k] / p.z).clamp(-0.65 * size[k] / focal[k], 0.65 * size[k] / focal[k]);
        let rows = [0, 1].map(|k| {
            let mut row = DVec3::ZERO;
            row[k] = focal[k] / p.z;
            row.z = -focal[k] * held(k) / p.z;
            axes.transpose() * row
        });
        let centre = [focal[0] * p.x / p.z + camera.cx, focal[1] * p.y / p.z + camera.cy];
        Some(Footprint::new(splats, i, eye, p.z, centre, rows))
    };
    let mut footprints: Vec<Footprint> = (0..splats.len()).filter_map(footprint).collect();
    footprints.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    let places = (0..camera.width_px * camera.height_px)
        .map(|pixel| [pixel % camera.width_px, pixel / camera.width_px].map(|k| f64::from(k) + 0.5));
    places.flat_map(|at| blended(&footprints, at, None)).collect()
}

/// Display values and the visible share of each pixel in the belt of a panorama with z up. The belt consists of the
/// rows more than 30 degrees from both poles. A pixel is the mean light of 2 by 2 samples. Each sample is blended
/// by [`blended`] in the plane of the two angles, nearest splats first. The derivatives of the angles are finite
/// differences.
pub fn belt(splats: &Splats, eye: DVec3, width: usize) -> (Vec<f64>, Vec<f64>) {
    let fine = 2.0 * width as f64;
    let angles = |p: DVec3| {
        let (u, v) = equirect::uv(Up::PlusZ, p);
        [u * fine, v * 0.5 * fine]
    };
    let footprint = |i: usize| {
        let p = splats.mean(i) - eye;
        let (rho, distance) = (p.truncate().length(), p.length());
        // Splats stretched along a whole row are drawn by a cap.
        if distance <= 0.2 || rho < 0.005 * distance {
            return None;
        }
        let h = 1e-6 * rho;
        let axes = axes(splats, i).transpose();
        let wrapped = |d: f64| d - fine * (d / fine).round();
        let by = |axis: DVec3| {
            let (a, b) = (angles(p + axis * h), angles(p - axis * h));
            [wrapped(a[0] - b[0]) / (2.0 * h), (a[1] - b[1]) / (2.0 * h)]
        };
        let columns = DVec3::AXES.map(by);
        let rows = [0, 1].map(|k| axes * DVec3::from(columns.map(|column| column[k])));
        Some(Footprint::new(splats, i, eye, distance, angles(p), rows))
    };
    let mut footprints: Vec<Footprint> = (0..splats.len()).filter_map(footprint).collect();
    footprints.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    let (mut colours, mut seen) = (Vec::new(), Vec::new());
    for pixel in width * (width / 12)..width * (width / 2 - width / 12) {
        let (mut sum, mut area) = ([0.0; 4], 0.0);
        for sample in 0..4 {
            let at = [2 * (pixel % width) + sample % 2, 2 * (pixel / width) + sample / 2].map(|k| k as f64);
            let edge = |row: f64| num::f64::cos(2.0 * PI * row / fine);
            let solid = edge(at[1]) - edge(at[1] + 1.0);
            let shown = light(&blended(&footprints, at.map(|k| k + 0.5), Some(fine)));
            sum.iter_mut().zip(shown).for_each(|(sum, v)| *sum += solid * v);
            area += solid;
        }
        seen.push(sum[3] / area);
        colours.extend([0, 1, 2].map(|c| encoded(sum[c] / sum[3])));
    }
    (colours, seen)
}

/// Planar depth of the nearest triangle at the centre of each pixel; +inf where there is no triangle.
pub fn nearest(mesh: &Mesh, placed: &Placed, camera: &Camera) -> Vec<f64> {
    let of_mesh = mesh.triangles.iter().map(|t| t.map(|i| mesh.position(i)));
    let of_object = placed.object.primitives.iter().flat_map(|primitive| {
        let place = |i: u32| {
            let corner = DVec3::from(primitive.positions[i as usize].map(f64::from));
            placed.world_from_object.transform_point3(corner)
        };
        primitive.triangles.iter().map(move |t| t.map(place))
    });
    let triangles: Vec<[DVec3; 3]> = of_mesh.chain(of_object).collect();
    let world = camera.world_from_camera();
    let (eye, forward) = (world.w_axis.truncate(), world.z_axis.truncate());
    let mut depths = Vec::new();
    for pixel in 0..camera.width_px * camera.height_px {
        let [x, y] = [pixel % camera.width_px, pixel / camera.width_px].map(|k| f64::from(k) + 0.5);
        let ray = camera.direction(x, y);
        let mut best = f64::INFINITY;
        for [a, b, c] in &triangles {
            // Moeller and Trumbore 1997.
            let (ab, ac) = (*b - *a, *c - *a);
            let across = ray.cross(ac);
            let volume = ab.dot(across);
            let from = eye - *a;
            let (u, v) = (from.dot(across) / volume, ray.dot(from.cross(ab)) / volume);
            let t = ac.dot(from.cross(ab)) / volume;
            if volume != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < best {
                best = t;
            }
        }
        depths.push(best * ray.dot(forward));
    }
    depths
}
