//! Measures how well a mesh fits the splats, as seen by cameras.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use scene::types::{Camera, Splats};

use crate::geometry::bvh::{Bvh, Ray};
use crate::splat::{Blocks, DepthMode, Settings, render_with};

/// Longest side of the picture that is compared, in pixels.
const SIDE_PX: u32 = 256;

/// Differences between a mesh and splats in a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Median of the absolute difference between the distances to the mesh and to the splats, in world units.
    /// `None` if no pixel shows both in the compared region.
    pub median: Option<f64>,
    /// 95th percentile of the absolute difference between the distances to the mesh and to the splats, in world
    /// units.
    pub most: Option<f64>,
    /// Pixels that show splats in the compared region but no mesh, as a share of all pixels.
    pub holes: f64,
    /// Pixels that show the mesh but no splats in the compared region, as a share of all pixels.
    pub extra: f64,
    /// Pixels that show the back of the mesh, as a share of all pixels.
    pub backs: f64,
    /// Share of the silhouettes of the splats at which the mesh has a silhouette, and share of the silhouettes of
    /// the mesh at which the splats have one. `None` for a view without such silhouettes.
    pub silhouettes: [Option<f64>; 2],
}

/// Ratio of the distances of two adjacent pixels above which the nearer one is on a silhouette.
const STEP: f32 = 1.1;
/// Maximum distance between two silhouettes that agree, in pixels in each direction.
const APART: usize = 2;

/// Pixels on the silhouettes of a picture of distances: those in front of an adjacent pixel by the ratio [`STEP`].
/// Pixels without a surface are infinitely far.
fn silhouettes(distances: &[f32], (width, height): (usize, usize)) -> Vec<bool> {
    let is_edge = |i: usize| {
        let (x, y) = (i % width, i / width);
        let behind = |other: usize| distances[other] > STEP * distances[i];
        (x > 0 && behind(i - 1))
            || (x + 1 < width && behind(i + 1))
            || (y > 0 && behind(i - width))
            || (y + 1 < height && behind(i + width))
    };
    (0..distances.len()).map(|i| distances[i].is_finite() && is_edge(i)).collect()
}

/// Share of the silhouettes `of` with a silhouette of `other` nearby. Only pixels for which `counts` is true are
/// examined. `None` if `of` has no silhouette there.
fn shared(
    of: &[bool],
    other: &[bool],
    (width, height): (usize, usize),
    counts: impl Fn(usize) -> bool,
) -> Option<f64> {
    let near = |i: usize| {
        let (x, y) = (i % width, i / width);
        let [columns, rows] =
            [(x, width), (y, height)].map(|(at, size)| at.saturating_sub(APART)..(at + APART + 1).min(size));
        rows.flat_map(|row| columns.clone().map(move |column| row * width + column)).any(|i| other[i])
    };
    let edges: Vec<usize> = (0..of.len()).filter(|i| of[*i] && counts(*i)).collect();
    let found = edges.iter().filter(|i| near(**i)).count();
    (!edges.is_empty()).then(|| found as f64 / edges.len() as f64)
}

/// The same camera, with a picture of at most [`SIDE_PX`] pixels per side.
fn small(camera: &Camera) -> Camera {
    let scale = (f64::from(SIDE_PX) / f64::from(camera.width_px.max(camera.height_px))).min(1.0);
    let pixels = |px: u32| ((f64::from(px) * scale).round() as u32).max(1);
    let (width_px, height_px) = (pixels(camera.width_px), pixels(camera.height_px));
    let (x, y) = (
        f64::from(width_px) / f64::from(camera.width_px),
        f64::from(height_px) / f64::from(camera.height_px),
    );
    Camera {
        width_px,
        height_px,
        fx: camera.fx * x,
        cx: camera.cx * x,
        fy: camera.fy * y,
        cy: camera.cy * y,
        ..camera.clone()
    }
}

/// Compares triangles with the splats in the view of a camera. The coordinates of the triangles, and the argument
/// of `within`, are relative to `origin`. Only splat surface points for which `within` is true are compared.
pub fn fit(
    (splats, blocks): (&Splats, &Blocks),
    (triangles, origin): (&Bvh, DVec3),
    camera: &Camera,
    within: &(dyn Fn(Vec3) -> bool + Sync),
    settings: &Settings,
    cx: &Context,
) -> Result<Fit, NodeError> {
    let camera = small(camera);
    let settings = Settings { depth: DepthMode::RayMedian, ..*settings };
    let seen = render_with(splats, Some(blocks), &camera, None, &settings, cx)?;
    let eye = (camera.eye() - origin).as_vec3();
    let forward = camera.world_from_camera().z_axis.truncate();
    let (width, height) = (camera.width_px as usize, camera.height_px as usize);
    let rows = cx.for_each_tile(height, |y| {
        let (mut off, mut counts) = (Vec::new(), [0_usize; 3]);
        let mut distances = Vec::with_capacity(width);
        for x in 0..width {
            let direction = camera.direction(x as f64 + 0.5, y as f64 + 0.5);
            let hit = triangles.closest(Ray::new(eye, direction.as_vec3()), |_| true);
            let distance = f64::from(seen.depth[y * width + x]) / direction.dot(forward);
            let near = distance.is_finite() && within(eye + (direction * distance).as_vec3());
            distances.push((distance as f32, hit.map_or(f32::INFINITY, |hit| hit.t), near));
            match hit {
                Some(hit) => {
                    counts[2] += usize::from(hit.back);
                    if near {
                        off.push((f64::from(hit.t) - distance).abs());
                    } else {
                        counts[1] += 1;
                    }
                }
                None => counts[0] += usize::from(near),
            }
        }
        (off, counts, distances)
    })?;
    let (mut off, mut counts, mut distances) = (Vec::new(), [0_usize; 3], Vec::new());
    for (row, more, of_row) in rows {
        off.extend(row);
        distances.extend(of_row);
        counts = std::array::from_fn(|i| counts[i] + more[i]);
    }
    off.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| off.get((off.len() as f64 * share) as usize).copied();
    let [holes, extra, backs] = counts.map(|count| count as f64 / (width * height) as f64);
    let size = (width, height);
    let [of_splats, of_mesh] = [|d: &(f32, f32, bool)| d.0, |d: &(f32, f32, bool)| d.1]
        .map(|of| silhouettes(&distances.iter().map(of).collect::<Vec<f32>>(), size));
    let silhouettes = [
        shared(&of_splats, &of_mesh, size, |i| distances[i].2),
        shared(&of_mesh, &of_splats, size, |_| true),
    ];
    Ok(Fit { median: at(0.5), most: at(0.95), holes, extra, backs, silhouettes })
}

#[cfg(test)]
mod tests {
    use super::*;

    // A post in front of a wall has two silhouettes. A post that is displaced by three pixels has others.
    #[test]
    fn silhouettes_agree_within_two_pixels() {
        let size = (20, 3);
        let post = |left: usize| {
            let distances: Vec<f32> =
                (0..60).map(|i| if (left..left + 4).contains(&(i % 20)) { 2.0 } else { 5.0 }).collect();
            silhouettes(&distances, size)
        };
        let edges: Vec<usize> = (0..20).filter(|x| post(6)[*x]).collect();
        assert_eq!(edges, [6, 9]);
        let with = |left: usize| shared(&post(6), &post(left), size, |_| true);
        assert_eq!([6, 8, 14].map(with), [Some(1.0), Some(1.0), Some(0.0)]);
        assert_eq!(with(9), Some(0.5));
        let wall = silhouettes(&[5.0; 60], size);
        assert_eq!(shared(&wall, &post(6), size, |_| true), None);
        // A surface that ends is in front of nothing.
        let open: Vec<f32> = (0..60).map(|i| if i % 20 < 10 { 3.0 } else { f32::INFINITY }).collect();
        assert_eq!(silhouettes(&open, size).iter().filter(|edge| **edge).count(), 3);
    }
}
