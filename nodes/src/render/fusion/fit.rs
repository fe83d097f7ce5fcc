//! Measures how well a mesh fits the splats, as seen by cameras.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};

use crate::geometry::bvh::{Bvh, Ray};
use crate::render::splat::{Blocks, DepthMode, Settings, render_with};
use crate::types::{Camera, Splats};

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
        for x in 0..width {
            let direction = camera.direction(x as f64 + 0.5, y as f64 + 0.5);
            let hit = triangles.closest(Ray::new(eye, direction.as_vec3()), |_| true);
            let distance = f64::from(seen.depth[y * width + x]) / direction.dot(forward);
            let near = distance.is_finite() && within(eye + (direction * distance).as_vec3());
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
        (off, counts)
    })?;
    let (mut off, mut counts) = (Vec::new(), [0_usize; 3]);
    for (row, more) in rows {
        off.extend(row);
        counts = std::array::from_fn(|i| counts[i] + more[i]);
    }
    off.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| off.get((off.len() as f64 * share) as usize).copied();
    let [holes, extra, backs] = counts.map(|count| count as f64 / (width * height) as f64);
    Ok(Fit { median: at(0.5), most: at(0.95), holes, extra, backs })
}
