//! Finds places for the views in empty space. The search starts at the position of the object and at the cameras,
//! and adds places in space that earlier views have seen to be empty.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use scene::math::num;
use scene::types::{Camera, Splats};

use super::depth_view::DepthView;
use crate::splat::{Blocks, Settings};

/// Angle by which a face extends beyond 45 degrees, so that no direction falls into a gap between the pixels of two
/// adjacent faces.
const GUARD_DEG: f64 = 3.0;
/// Maximum number of consecutive candidates that are too near to a surface. When it is reached, the search ends.
const FAILURES: usize = 8;
/// Minimum distance between two places, as a multiple of [`Places::clearance`].
const APART: f32 = 1.8;
/// Distances that are tried from a place to the next place, as multiples of [`Places::clearance`].
const STEPS: [f32; 3] = [2.0, 4.0, 7.0];
/// Number of horizontal directions around a place that are tried.
const AZIMUTHS: usize = 12;
/// Differences in height that are tried between a place and the next place, as multiples of [`Places::clearance`].
const RISES: [f32; 3] = [-1.2, 0.0, 1.6];
/// Maximum share of the pixels seen from a place that may show surfaces nearer than the clearance.
const NEARER: f64 = 0.02;
/// Minimum distance from a given place to the nearest surface, in metres. A place that is nearer counts as inside a
/// surface.
const BLOCKED_METRES: f64 = 0.02;
/// Field of view of the views from above, in degrees.
const STEEP_DEG: f64 = 70.0;
/// Positions of the views from above, relative to the focus: height and horizontal distance, in metres. They are
/// tried in this order.
const STEEP: [[f64; 2]; 4] = [[1.8, 0.7], [1.2, 0.5], [0.7, 0.35], [0.35, 0.2]];

/// Inputs of the search for places.
pub struct Ground<'a> {
    /// The scene.
    pub splats: &'a Splats,
    /// The blocks of the splats of the scene.
    pub blocks: &'a Blocks,
    /// Settings of the splat renderer.
    pub settings: &'a Settings,
    /// World position to which the positions of the places are relative.
    pub origin: DVec3,
    /// Unit vectors to the right, forward and up.
    pub axes: [DVec3; 3],
    /// World units per metre.
    pub metre: f64,
    /// Side of a face, in pixels.
    pub size_px: u32,
}

/// Views from the places that were found.
pub struct Places {
    /// Depths seen from the places.
    pub views: Vec<DepthView>,
    /// Positions of the places, relative to the origin, in world units.
    pub eyes: Vec<Vec3>,
    /// Number of given places, which come first in the list.
    pub given: usize,
    /// Number of given places that are inside a surface and were left out.
    pub blocked: usize,
    /// Minimum distance between a place and a surface, in world units.
    pub clearance: f32,
    /// Number of candidates that were discarded because they are too near to a surface.
    pub failed: usize,
    /// Number of views of the focus from above.
    pub steep: usize,
    /// Median distance from the given places to the surfaces that are visible from them, in world units.
    pub median: f32,
}

impl Ground<'_> {
    fn view(&self, camera: &Camera, cx: &Context) -> Result<DepthView, NodeError> {
        DepthView::of(self.splats, self.blocks, camera, self.origin, self.settings, cx)
    }

    /// Renders the six faces around a place. They are rotated by an angle that depends on the number of the place,
    /// so that no two places have pixels in the same directions.
    fn around(&self, eye: Vec3, number: usize, cx: &Context) -> Result<Vec<DepthView>, NodeError> {
        let eye = self.origin + eye.as_dvec3();
        let (sin, cos) = num::sin_cos(0.47 + 2.399_963 * number as f64);
        let [right, forward, up] = self.axes;
        let (right, forward) = (right * cos + forward * sin, forward * cos - right * sin);
        // Off the axes, since captures are quantised along them.
        let (sin, cos) = num::sin_cos(0.33);
        let (forward, up) = (forward * cos + up * sin, up * cos - forward * sin);
        let half = 0.5 * f64::from(self.size_px);
        let focal = half / num::f64::tan((45.0 + GUARD_DEG).to_radians());
        let faces = Camera::cube("face", self.size_px, focal, [right, forward, up], eye);
        faces.iter().map(|face| self.view(face, cx)).collect()
    }
}

/// Distance from the eye to the surface for each pixel of the views, in ascending order; infinite for pixels that
/// show no surface.
fn distances(views: &[DepthView]) -> Vec<f32> {
    let mut all = Vec::new();
    for view in views {
        for y in (0..view.height).step_by(2) {
            for x in (0..view.width).step_by(2) {
                all.push(view.point(x, y).map_or(f32::INFINITY, Vec3::length));
            }
        }
    }
    all.sort_unstable_by(f32::total_cmp);
    all
}

/// Distance that one can move from a place towards the point `ahead` while the space within the clearance on all
/// sides is empty. It is determined by the face that shows the point.
fn room(faces: &[DepthView], ahead: Vec3, clearance: f32) -> f32 {
    let length = ahead.length();
    for view in faces {
        let Some(on) = view.project(view.eye + ahead) else { continue };
        let reach = (view.focal[0] * clearance / on.depth).min(0.25 * view.width as f32) as i32;
        let [x, y] = on.at.map(|v| v as i32);
        let mut least = f32::INFINITY;
        for row in (y - reach).max(0)..=(y + reach).min(view.height as i32 - 1) {
            for column in (x - reach).max(0)..=(x + reach).min(view.width as i32 - 1) {
                let distance = view.point(column as usize, row as usize).map_or(f32::INFINITY, Vec3::length);
                least = least.min(distance);
            }
        }
        return least - clearance;
    }
    -length
}

impl Places {
    /// Finds up to `most` places, starting from the given places `seeds`. If there is a focus, views of it from
    /// above are added.
    pub fn grown(
        ground: &Ground<'_>,
        seeds: &[Vec3],
        focus: Option<Vec3>,
        most: usize,
        progress: &dyn Fn(f32),
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let up = ground.axes[2].as_vec3();
        let mut places = Self {
            views: Vec::new(),
            eyes: Vec::new(),
            given: 0,
            blocked: 0,
            clearance: 0.0,
            failed: 0,
            steep: 0,
            median: 0.0,
        };
        let mut nearest = Vec::new();
        let mut all = Vec::new();
        for seed in farthest_first(seeds, most) {
            cx.check()?;
            let faces = ground.around(seed, places.eyes.len(), cx)?;
            let distances = distances(&faces);
            let room = distances[(NEARER * distances.len() as f64) as usize];
            if f64::from(room) < BLOCKED_METRES * ground.metre {
                places.blocked += 1;
                continue;
            }
            nearest.push(room);
            all.extend(distances.iter().filter(|d| d.is_finite()));
            places.eyes.push(seed);
            places.views.extend(faces);
            progress(places.eyes.len() as f32 / most as f32);
        }
        places.given = places.eyes.len();
        all.sort_unstable_by(f32::total_cmp);
        places.median = all.get(all.len() / 2).copied().unwrap_or(f32::INFINITY);
        nearest.sort_unstable_by(f32::total_cmp);
        // The median of the distances from the given places to their nearest surfaces.
        let roomy = nearest.get(nearest.len() / 2).copied().unwrap_or(f32::INFINITY);
        places.clearance = ((0.35 * ground.metre) as f32).min(0.5 * roomy);
        if places.given == 0 {
            return Ok(places);
        }
        if places.clearance.is_finite() && places.clearance > 0.0 {
            places.grow(ground, focus, most, up, progress, cx)?;
        }
        if let Some(focus) = focus {
            places.look_down(ground, focus, up, cx)?;
        }
        Ok(places)
    }

    fn faces(&self, place: usize) -> &[DepthView] {
        &self.views[6 * place..6 * place + 6]
    }

    fn grow(
        &mut self,
        ground: &Ground<'_>,
        focus: Option<Vec3>,
        most: usize,
        up: Vec3,
        progress: &dyn Fn(f32),
        cx: &Context,
    ) -> Result<(), NodeError> {
        let [right, forward] = [ground.axes[0].as_vec3(), ground.axes[1].as_vec3()];
        let clearance = self.clearance;
        let heights = self.eyes.iter().map(|eye| eye.dot(up));
        let low = heights.clone().fold(f32::INFINITY, f32::min) - 0.3 * clearance;
        let high = heights.fold(f32::NEG_INFINITY, f32::max) + 5.5 * clearance;
        let middle = focus.unwrap_or(self.eyes[0]);
        let mut candidates: Vec<Vec3> = Vec::new();
        let mut looked_from = 0;
        let mut in_a_row = 0;
        while self.eyes.len() < most && in_a_row < FAILURES {
            cx.check()?;
            for place in looked_from..self.eyes.len() {
                let eye = self.eyes[place];
                for (i, step) in STEPS.into_iter().enumerate() {
                    for azimuth in 0..AZIMUTHS {
                        let turns = azimuth as f32 / AZIMUTHS as f32 + 0.618_034 * (place * 3 + i) as f32;
                        let (sin, cos) = crate::geometry::sampling::circle(turns.fract());
                        for rise in RISES {
                            let ahead =
                                (right * cos + forward * sin) * (step * clearance) + up * (rise * clearance);
                            let height = (eye + ahead).dot(up);
                            if (low..=high).contains(&height)
                                && room(self.faces(place), ahead, clearance) >= ahead.length()
                            {
                                candidates.push(eye + ahead);
                            }
                        }
                    }
                }
            }
            looked_from = self.eyes.len();
            let apart = |point: Vec3| {
                self.eyes.iter().map(|eye| (*eye - point).length()).fold(f32::INFINITY, f32::min)
            };
            candidates.retain(|point| apart(*point) >= APART * clearance);
            // Far from the others, but not from the middle.
            let worth = |point: Vec3| apart(point) / (1.0 + (point - middle).length() / (12.0 * clearance));
            let best = candidates.iter().enumerate().fold(None, |best: Option<(usize, f32)>, (i, point)| {
                let worth = worth(*point);
                if best.is_some_and(|(_, most)| most >= worth) { best } else { Some((i, worth)) }
            });
            let Some((index, _)) = best else { break };
            let point = candidates.swap_remove(index);
            let faces = ground.around(point, self.eyes.len(), cx)?;
            let distances = distances(&faces);
            if distances[(NEARER * distances.len() as f64) as usize] < 0.8 * clearance {
                candidates.retain(|other| (*other - point).length() >= 0.5 * clearance);
                self.failed += 1;
                in_a_row += 1;
                continue;
            }
            in_a_row = 0;
            self.eyes.push(point);
            self.views.extend(faces);
            progress(self.eyes.len() as f32 / most as f32);
        }
        Ok(())
    }

    /// True if the views from one of the places show that the space within `clearance` around a point is empty, and
    /// that nothing hides it.
    fn is_free(&self, point: Vec3, clearance: f32) -> bool {
        (0..self.eyes.len()).any(|place| {
            let ahead = point - self.eyes[place];
            room(self.faces(place), ahead, clearance) >= ahead.length()
        })
    }

    /// Adds views of a focus from above and from all sides, because the depth of surfaces seen at grazing angles is
    /// biased.
    fn look_down(
        &mut self,
        ground: &Ground<'_>,
        focus: Vec3,
        up: Vec3,
        cx: &Context,
    ) -> Result<(), NodeError> {
        let [right, forward] = [ground.axes[0].as_vec3(), ground.axes[1].as_vec3()];
        let room = 0.3 * self.clearance;
        let size = ground.size_px * 4 / 3;
        let focal = 0.5 * f64::from(size) / num::f64::tan((0.5 * STEEP_DEG).to_radians());
        for azimuth in 0..8 {
            let (sin, cos) = crate::geometry::sampling::circle((azimuth as f32 + 0.25) / 8.0);
            let side = right * cos + forward * sin;
            let stand = STEEP.iter().map(|[height, aside]| {
                focus + up * (height * ground.metre) as f32 + side * (aside * ground.metre) as f32
            });
            let Some(eye) = stand.into_iter().find(|eye| self.is_free(*eye, room)) else { continue };
            let z = (focus - eye).normalize().as_dvec3();
            let x = z.cross(up.as_dvec3()).normalize();
            let eye = ground.origin + eye.as_dvec3();
            let camera = Camera::centred("steep", [size; 2], focal, [x, z.cross(x), z], eye);
            self.views.push(ground.view(&camera, cx)?);
            self.steep += 1;
        }
        Ok(())
    }
}

/// Selects up to `most` of the points. Each is the point farthest from those selected before it.
fn farthest_first(points: &[Vec3], most: usize) -> Vec<Vec3> {
    let mut kept: Vec<Vec3> = points.first().copied().into_iter().collect();
    let mut apart: Vec<f32> = points.iter().map(|point| (*point - kept[0]).length_squared()).collect();
    while kept.len() < most.max(1) {
        let best = apart
            .iter()
            .enumerate()
            .fold((0, 0.0), |best, (i, far)| if *far > best.1 { (i, *far) } else { best });
        if best.1 == 0.0 {
            break;
        }
        let point = points[best.0];
        kept.push(point);
        for (far, other) in apart.iter_mut().zip(points) {
            *far = far.min((*other - point).length_squared());
        }
    }
    kept
}
