//! Views of a scene, either from positions where a person would stand or from positions around the scene.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::math::num;
use scene::types::{Rig, Splats};

use crate::geometry::level::LevelEstimate;
use crate::layout::{Grid, Viewpoint, Wish, surfaces};
use crate::splat::{Settings, render};

/// Number of horizontal directions that are tried from a place.
const AROUND: usize = 8;
/// Number of places that are tried.
const PLACES: usize = 4;
/// Vertical field of view, in degrees.
const FOV_Y_DEG: f64 = 60.0;
/// Minimum score of the best view from the floor. If no view reaches it, the scene counts as a single object and is
/// viewed from around it.
const INSIDE: f64 = 0.6;
/// Width and height of the small pictures, in pixels.
const SMALL: [u32; 2] = [80, 60];

/// Rates how much of the scene a view shows, from 0 to 1.
fn judge(splats: &Splats, view: &Viewpoint, up: DVec3, radius: f64, cx: &Context) -> Result<f64, NodeError> {
    let settings = Settings { near: 1e-3 * radius, ..Settings::default() };
    let seen = render(splats, &view.camera("try", SMALL, up), None, &settings, cx)?;
    let pixels = f64::from(SMALL[0] * SMALL[1]);
    let luma = |p: &[f32]| {
        (0.2126 * f64::from(p[0]) + 0.7152 * f64::from(p[1]) + 0.0722 * f64::from(p[2])).clamp(0.0, 1.0)
    };
    let lumas: Vec<f64> = seen.rgba.chunks_exact(4).map(luma).collect();
    let alpha = seen.rgba.chunks_exact(4).map(|p| f64::from(p[3].min(1.0))).sum::<f64>() / pixels;
    let close = seen.depth.iter().filter(|d| f64::from(**d) < 0.06 * radius).count() as f64 / pixels;
    let mean = lumas.iter().sum::<f64>() / pixels;
    let detail: f64 = lumas.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>() / pixels;
    let exposed = (mean / 0.2).min(1.0) * ((1.0 - mean) / 0.1).min(1.0);
    Ok(alpha * (1.0 - close) * (1.0 - close) * (0.3 + 0.3 * exposed + 0.4 * (detail / 0.04).min(1.0)))
}

/// Views that show most of the scene, best first, without similar views. Candidates are at eye height above free
/// places of the floor (or around the scene if it is a single object), and at the cameras of the capture.
pub fn views(
    splats: &Splats,
    stand: &LevelEstimate,
    eye_height: f64,
    cameras: Option<&Rig>,
    count: usize,
    cx: &Context,
) -> Result<Vec<Viewpoint>, NodeError> {
    let grid = Grid::new(splats, stand);
    let (up, centre) = (grid.axes.z_axis, DVec3::from_array(stand.centre));
    let mut tried: Vec<Viewpoint> = Vec::new();
    let mut add = |eye: DVec3, target: DVec3| {
        tried.push(Viewpoint { eye, target, fov_y_deg: FOV_Y_DEG, score: 0.0 });
    };
    // Places of the floor, apart from each other.
    let mut places: Vec<DVec3> = Vec::new();
    for ring in [0.0, 0.35, 0.6] {
        for k in 0..if ring == 0.0 { 1 } else { 4 } {
            let (s, c) = num::sin_cos(std::f64::consts::TAU * (k as f64 + 0.5) / 4.0);
            let near = centre + grid.axes * DVec3::new(c, s, 0.0) * (ring * stand.radius);
            let heights = [-0.06 * stand.radius, 0.5 * eye_height];
            let wish = Wish { heights, enough: 0.3 * eye_height, near: (near, 0.2 * stand.radius) };
            for surface in surfaces(&grid, stand.floor, &wish).into_iter().take(3) {
                let free = surface.clearance > 1.15 * eye_height;
                let apart = places.iter().all(|p| (*p - surface.place).length() > 0.25 * stand.radius);
                if free && apart && places.len() < PLACES {
                    places.push(surface.place);
                }
            }
        }
    }
    for place in &places {
        let eye = *place + up * eye_height;
        for k in 0..AROUND {
            let (s, c) = num::sin_cos(std::f64::consts::TAU * k as f64 / AROUND as f64);
            add(eye, eye + grid.axes * DVec3::new(c, s, -0.12) * (0.3 * stand.radius));
        }
    }
    for camera in cameras
        .into_iter()
        .flat_map(|rig| &rig.cameras)
        .step_by(cameras.map_or(1, |rig| (rig.cameras.len() / 6).max(1)))
    {
        let ahead = camera.direction(camera.cx, camera.cy);
        add(camera.eye(), camera.eye() + ahead * (0.3 * stand.radius));
    }
    for view in &mut tried {
        view.score = judge(splats, view, up, stand.radius, cx)?;
    }
    if tried.iter().all(|view| view.score < INSIDE) {
        tried.clear();
        for k in 0..6 {
            let (s, c) = num::sin_cos(std::f64::consts::TAU * f64::from(k) / 6.0);
            let eye = centre + grid.axes * DVec3::new(c, s, 0.35) * (1.6 * stand.radius);
            let view = Viewpoint { eye, target: centre, fov_y_deg: FOV_Y_DEG, score: 0.0 };
            tried.push(Viewpoint { score: judge(splats, &view, up, stand.radius, cx)?, ..view });
        }
    }
    tried.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut chosen: Vec<Viewpoint> = Vec::new();
    for view in tried {
        let ahead = |view: &Viewpoint| (view.target - view.eye).normalize();
        let other = |known: &Viewpoint| {
            (known.eye - view.eye).length() > 0.3 * stand.radius || ahead(known).dot(ahead(&view)) < 0.3
        };
        if chosen.len() < count && chosen.iter().all(other) {
            chosen.push(view);
        }
    }
    Ok(chosen)
}
