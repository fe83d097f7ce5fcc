//! Surface point that a pixel of a view shows: its position in the world and its normal.

use engine::{Context, NodeError};
use glam::{DVec2, DVec3};
use scene::types::{Camera, Mesh, Splats};

use super::splat::{DepthMode, Settings, render};
use crate::geometry::support::median;

/// Number of rendered pixels per pixel of the view, along each axis, in the window that is rendered around a pixel
/// to find the surface of splats. It is high because the depth of ground seen at a grazing angle is too small by
/// about the extent of one rendered pixel.
const ZOOM: usize = 8;
/// Half the side of the square window over which normals are averaged, in rendered pixels.
const WINDOW: usize = 3 * ZOOM;
/// Half the side of the square over which the median depth is computed, in rendered pixels.
const SQUARE: usize = 3;
/// Minimum mean coverage at which a pixel counts as showing a surface.
const COVERED: f64 = 0.5;
/// Distance from the camera below which splats are left out, as a fraction of the median distance from the camera
/// to the splats.
const NEAR: f64 = 1e-3;

/// Surface point that a pixel shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Picked {
    /// Position in the world.
    pub position: DVec3,
    /// Unit normal of the surface at the point, on the side of the camera.
    pub normal: DVec3,
}

fn nothing(camera: &Camera, [x, y]: [f64; 2], what: &str) -> NodeError {
    NodeError::new(format!("pixel ({x}, {y}) of `{}` shows {what}", camera.name))
}

/// Checks that a pixel lies inside the picture.
fn check(camera: &Camera, pixel: [f64; 2]) -> Result<(), NodeError> {
    let [w, h] = [camera.width_px, camera.height_px].map(f64::from);
    let inside = (0.0..w).contains(&pixel[0]) && (0.0..h).contains(&pixel[1]);
    let outside = || {
        NodeError::new(format!(
            "pixel ({}, {}) lies outside the picture of `{}`, which is {w} by {h} pixels",
            pixel[0], pixel[1], camera.name
        ))
    };
    inside.then_some(()).ok_or_else(outside)
}

/// Finds the point of a mesh that a pixel shows. This is the nearest point at which the ray through the pixel hits
/// a triangle, from either side. If two triangles are hit at the same distance, the first one is used. `pixel` is a
/// position in the picture, in pixels from the upper left corner, and may be fractional.
pub fn on_mesh(mesh: &Mesh, camera: &Camera, pixel: [f64; 2]) -> Result<Picked, NodeError> {
    check(camera, pixel)?;
    let (eye, way) = (camera.eye(), camera.direction(pixel[0], pixel[1]));
    let mut best: Option<(f64, DVec3)> = None;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.position(v) - eye);
        let (e, f) = (b - a, c - a);
        let cross = way.cross(f);
        let determinant = e.dot(cross);
        if determinant == 0.0 {
            continue;
        }
        let u = -a.dot(cross) / determinant;
        let q = (-a).cross(e);
        let (v, t) = (way.dot(q) / determinant, f.dot(q) / determinant);
        let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0;
        if inside && best.is_none_or(|(known, _)| t < known) {
            best = Some((t, e.cross(f)));
        }
    }
    let Some((distance, cross)) = best else {
        return Err(
            nothing(camera, pixel, "no part of the mesh").hint("choose a pixel that shows the ground")
        );
    };
    let normal = cross.normalize();
    let normal = if normal.dot(way) > 0.0 { -normal } else { normal };
    Ok(Picked { position: eye + way * distance, normal })
}

/// Finds the surface point of splats that a pixel shows. The position is computed from the median depth around the
/// pixel, and the normal from the surface around the point.
pub fn on_splats(
    splats: &Splats,
    camera: &Camera,
    pixel: [f64; 2],
    cx: &Context,
) -> Result<Picked, NodeError> {
    check(camera, pixel)?;
    let eye = camera.eye();
    let distances =
        (0..splats.len()).step_by((splats.len() / 1000).max(1)).map(|i| (splats.mean(i) - eye).length());
    let near = NEAR * median(distances.collect()).unwrap_or_default();
    let zoom = ZOOM as f64;
    let side = 2 * WINDOW + 1;
    let focal = [camera.fx * zoom, camera.fy * zoom];
    // The pixel lies in the centre of the middle pixel of the window.
    let centre =
        [(camera.cx - pixel[0]) * zoom, (camera.cy - pixel[1]) * zoom].map(|c| c + 0.5 * side as f64);
    let window = Camera {
        width_px: side as u32,
        height_px: side as u32,
        fx: focal[0],
        fy: focal[1],
        cx: centre[0],
        cy: centre[1],
        ..camera.clone()
    };
    let settings = Settings { near, depth: DepthMode::RayMedian, ..Settings::default() };
    let seen = render(splats, &window, None, &settings, cx)?;
    // The pixel of the view.
    let own = WINDOW - ZOOM / 2..=WINDOW + ZOOM / 2;
    let alpha = |x: usize, y: usize| f64::from(seen.rgba[(y * side + x) * 4 + 3]);
    let covered: f64 =
        own.clone().flat_map(|y| own.clone().map(move |x| (x, y))).map(|(x, y)| alpha(x, y)).sum();
    if covered < COVERED * (own.clone().count() * own.count()) as f64 {
        let what = "the background, since splats cover less than half of the pixel";
        return Err(nothing(camera, pixel, what).hint("choose a pixel that shows the ground"));
    }
    let world = camera.world_from_camera();
    let point = |x: usize, y: usize| {
        let depth = f64::from(seen.depth[y * side + x]);
        let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        depth.is_finite().then(|| world.transform_point3(window.ray(at.x, at.y) * depth))
    };
    let square = WINDOW - SQUARE..=WINDOW + SQUARE;
    let depths = square.clone().flat_map(|y| square.clone().map(move |x| y * side + x));
    let depth = median(depths.map(|i| f64::from(seen.depth[i])).filter(|d| d.is_finite()).collect());
    let Some(depth) = depth else {
        return Err(nothing(camera, pixel, "no surface").hint("choose a pixel that shows the ground"));
    };
    let ray = camera.ray(pixel[0], pixel[1]);
    let position = world.transform_point3(ray * depth);
    // The mean of the normals given by steps of two pixels of the view to the right and down.
    let step = 2 * ZOOM;
    let mut sum = DVec3::ZERO;
    for y in 0..side - step {
        for x in 0..side - step {
            if let (Some(a), Some(b), Some(c)) = (point(x, y), point(x + step, y), point(x, y + step)) {
                sum += (c - a).cross(b - a).normalize_or_zero();
            }
        }
    }
    let towards = (eye - position).normalize();
    let normal = if sum.length() > 1e-9 { sum.normalize() } else { towards };
    Ok(Picked { position, normal: if normal.dot(towards) < 0.0 { -normal } else { normal } })
}
