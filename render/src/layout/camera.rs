//! Camera with a good view of a place.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::math::num;
use scene::types::{Camera, Splats};

use super::grid::Grid;
use crate::splat::{Settings, render};

/// Number of horizontal directions around the place that are tried.
const AROUND: usize = 24;
/// Elevations of the camera above the place that are tried, in degrees.
const RISES: [f64; 4] = [9.0, 15.0, 23.0, 35.0];
/// Distances from the camera to the place that are tried, as multiples of the size of the object.
const AWAY: [f64; 3] = [2.5, 3.3, 4.6];
/// Number of candidate cameras for which a small picture is rendered.
const TRIED: usize = 28;
/// Width and height of the small pictures, in pixels.
const SMALL: [u32; 2] = [96, 72];

/// Position and target of the camera, in world units, and its field of view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    /// Position of the camera, in world units.
    pub eye: DVec3,
    /// Point in the middle of the picture, in world units.
    pub target: DVec3,
    /// Vertical field of view, in degrees.
    pub fov_y_deg: f64,
    /// Quality of the view of the place, 0 to 1.
    pub score: f64,
}

impl Viewpoint {
    /// Converts the view to a camera that is upright with respect to `up`.
    pub fn camera(&self, name: &str, size: [u32; 2], up: DVec3) -> Camera {
        let forward = (self.target - self.eye).normalize();
        let right = forward.cross(up).normalize();
        let focal = 0.5 * f64::from(size[1]) / num::f64::tan((0.5 * self.fov_y_deg).to_radians());
        Camera::centred(name, size, focal, [right, forward.cross(right), forward], self.eye)
    }
}

/// Object that the camera should show.
#[derive(Debug, Clone, Copy)]
pub struct Subject {
    /// Point that the object stands on, in world units.
    pub place: DVec3,
    /// Height of the object, in world units.
    pub height: f64,
    /// Largest extent of the object, in world units.
    pub extent: f64,
}

/// Rates how well a small picture shows the subject, from 0 to 1.
fn judge(
    splats: &Splats,
    view: &Viewpoint,
    subject: &Subject,
    up: DVec3,
    near: f64,
    cx: &Context,
) -> Result<f64, NodeError> {
    let camera = view.camera("try", SMALL, up);
    let settings = Settings { near, ..Settings::default() };
    let seen = render(splats, &camera, None, &settings, cx)?;
    let [w, h] = SMALL.map(|v| v as usize);
    let m = camera.camera_from_world();
    let foot = m.transform_point3(subject.place);
    let at = |p: DVec3| [p.x / p.z * camera.fx + camera.cx, p.y / p.z * camera.fy + camera.cy];
    let [fx, fy] = at(foot);
    // Share of the pixels around the foot whose depth is that of the ground there.
    let (mut right, mut asked) = (0.0, 0.0);
    for dy in -2..=2_i32 {
        for dx in -3..=3_i32 {
            let (x, y) = (fx + f64::from(dx * 2), fy + f64::from(dy));
            if x >= 0.0 && y >= 0.0 && (x as usize) < w && (y as usize) < h {
                let depth = f64::from(seen.depth[y as usize * w + x as usize]);
                asked += 1.0;
                right += f64::from(u8::from((depth - foot.z).abs() < 0.15 * foot.z));
            }
        }
    }
    let ground = if asked > 0.0 { right / asked } else { 0.0 };
    let pixels = (w * h) as f64;
    let alpha = seen.rgba.chunks_exact(4).map(|p| f64::from(p[3].min(1.0))).sum::<f64>() / pixels;
    // The score is lower if something is close to the lens, or if the picture is dark, white or without detail.
    let close = seen.depth.iter().filter(|d| f64::from(**d) < 0.3 * foot.z).count() as f64 / pixels;
    let luma = |p: &[f32]| 0.2126 * f64::from(p[0]) + 0.7152 * f64::from(p[1]) + 0.0722 * f64::from(p[2]);
    let lumas: Vec<f64> = seen.rgba.chunks_exact(4).map(|p| luma(p).clamp(0.0, 1.0)).collect();
    let mean = lumas.iter().sum::<f64>() / pixels;
    let steps: f64 = lumas.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>() / pixels;
    let exposed = (mean / 0.25).min(1.0) * ((1.0 - mean) / 0.15).min(1.0);
    let detail = (steps / 0.03).min(1.0);
    Ok(ground * alpha * alpha * (1.0 - close) * (1.0 - close) * (0.4 + 0.3 * exposed + 0.3 * detail))
}

/// Finds the camera that sees a subject best. Candidates are in free space, and are compared by rendering small
/// pictures. `hint` lists the positions of the cameras of the capture, in world units, since a captured scene looks
/// best from these positions.
pub fn best_view(
    splats: &Splats,
    grid: &Grid,
    subject: &Subject,
    hint: &[DVec3],
    cx: &Context,
) -> Result<Option<Viewpoint>, NodeError> {
    let up = grid.axes.z_axis;
    let target = subject.place + up * (0.45 * subject.height);
    let local = |p: DVec3| grid.axes.transpose() * p;
    let mut list: Vec<(f64, Viewpoint)> = Vec::new();
    let mut add = |eye: DVec3, bonus: f64| {
        let way = target - eye;
        let distance = way.length();
        let free = grid.free(local(eye), local(way / distance), distance);
        // Free space behind the subject is better, because a picture of a wall at arm's length shows little.
        let behind = grid.free(local(target), local(way / distance), 3.0 * distance) / distance;
        let clear = grid.is_clear(local(eye), (0.12 * distance).max(2.0 * grid.cell).min(0.5 * distance));
        if free + 2.0 * subject.extent.max(grid.cell) < distance || !clear {
            return;
        }
        let score = bonus + 0.2 * behind.min(2.0);
        list.push((score, Viewpoint { eye, target, fov_y_deg: 45.0, score: 0.0 }));
    };
    for (a, away) in AWAY.into_iter().enumerate() {
        for (r, rise) in RISES.into_iter().enumerate() {
            for k in 0..AROUND {
                let (s, c) = num::sin_cos(std::f64::consts::TAU * k as f64 / AROUND as f64);
                let (rs, rc) = num::sin_cos(rise.to_radians());
                let way = grid.axes * DVec3::new(c * rc, s * rc, rs);
                let bonus = [0.0, 0.25, 0.1][a] + [0.0, 0.25, 0.2, 0.0][r];
                add(target + way * (away * subject.extent), bonus);
            }
        }
    }
    for eye in hint {
        let way = *eye - target;
        let distance = way.length();
        let slant = way.dot(up) / distance;
        if distance > 1.5 * subject.extent && distance < 12.0 * subject.extent && (0.02..0.9).contains(&slant)
        {
            add(*eye, 1.0);
        }
    }
    // The best camera of each eighth of the circle comes first, so that not all are on one side.
    list.sort_by(|a, b| b.0.total_cmp(&a.0));
    let sector = |view: &Viewpoint| {
        let way = local(view.eye - target);
        ((num::atan2(way.y, way.x) + std::f64::consts::PI) / std::f64::consts::TAU * 8.0) as usize % 8
    };
    let mut counts = [0_usize; 8];
    let mut ranked: Vec<(usize, Viewpoint)> = Vec::new();
    for (_, view) in &list {
        let own = &mut counts[sector(view)];
        ranked.push((*own, *view));
        *own += 1;
    }
    ranked.sort_by_key(|(rank, _)| *rank);
    let near = 0.02 * subject.extent;
    let mut best: Option<Viewpoint> = None;
    for (_, view) in ranked.into_iter().take(TRIED) {
        let score = judge(splats, &view, subject, up, near, cx)?;
        if best.is_none_or(|best| score > best.score) {
            best = Some(Viewpoint { score, ..view });
        }
    }
    Ok(best)
}
