//! Colours of surface points. Each is the mean of the colours that the views show at the point.

use engine::{Context, NodeError};
use glam::Vec3;
use scene::math::color::linear_from_srgb8;

use super::depth_view::DepthView;
use super::levels::Levels;
use super::surface::Surface;

/// Properties of a surface point, computed from the views that see it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Seen {
    /// Linear colour.
    pub colour: [f32; 3],
    /// Number of views that see the point.
    pub views: u16,
    /// Standard deviation of the surface positions that the views observe, perpendicular to the surface, in world
    /// units.
    pub deviation: f32,
}

/// Computes the properties of each point of a surface from the views.
pub fn seen(
    surface: &Surface,
    views: &[DepthView],
    levels: &Levels,
    cx: &Context,
) -> Result<Vec<Seen>, NodeError> {
    const GROUP: usize = 1024;
    let linear = linear_from_srgb8();
    let count = surface.points.len();
    let groups = cx.for_each_tile(count.div_ceil(GROUP), |group| {
        let points = group * GROUP..((group + 1) * GROUP).min(count);
        let one = |i: usize| {
            let near = 2.0 * levels.cell_of(surface.levels[i]);
            of_point(surface.points[i], near, views, &linear)
        };
        points.map(one).collect::<Vec<_>>()
    })?;
    Ok(groups.concat())
}

fn of_point(point: Vec3, near: f32, views: &[DepthView], linear: &[f32; 256]) -> Seen {
    let (mut sum, mut weights, mut count) = ([0.0_f32; 3], 0.0_f32, 0_u16);
    let mut squares = 0.0_f32;
    let mut mean = 0.0_f32;
    for view in views {
        let Some(on) = view.project(point) else { continue };
        let (inverse, one_surface, nearest) = view.surface(on.at);
        let [trust, cosine] = view.marks[nearest].map(|mark| f32::from(mark) * (1.0 / 255.0));
        if inverse <= 0.0 || !one_surface {
            continue;
        }
        let off = (1.0 / inverse - on.depth) * on.stretch * cosine;
        let weight = trust * cosine * cosine / (1.0 + on.depth * on.depth);
        if off.abs() > near || weight <= 0.0 {
            continue;
        }
        for (sum, code) in sum.iter_mut().zip(view.colours[nearest]) {
            *sum += weight * linear[usize::from(code)];
        }
        weights += weight;
        mean += weight * off;
        squares += weight * off * off;
        count = count.saturating_add(1);
    }
    if weights <= 0.0 {
        return Seen::default();
    }
    let mean = mean / weights;
    Seen {
        colour: sum.map(|sum| sum / weights),
        views: count,
        deviation: (squares / weights - mean * mean).max(0.0).sqrt(),
    }
}
