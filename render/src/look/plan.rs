//! Picture of a scene from above, with a grid in metres or world units.

use engine::{Context, NodeError};
use glam::{DVec2, DVec3};
use scene::types::{Camera, Splats};

use super::canvas::Canvas;
use crate::geometry::level::LevelEstimate;
use crate::splat::{Settings, render};

/// Height of the camera above the floor, as a multiple of half the side of the plan. It is large, so that the rays
/// are nearly parallel.
const HIGH: f64 = 40.0;
/// Approximate number of lines of the grid.
const LINES: f64 = 12.0;

/// Picture of the plan, and the mapping from the world to the picture.
#[derive(Debug)]
pub struct Plan {
    /// Picture of the plan, with `forward` pointing up.
    pub canvas: Canvas,
    /// Distance between two neighbouring lines of the grid, in world units.
    pub step: f64,
    right: DVec3,
    forward: DVec3,
    centre: DVec3,
    half: f64,
}

/// Splats below a height along `up`; all splats if the height is +inf.
pub fn below(splats: &Splats, up: DVec3, height: f64) -> Splats {
    let mut kept = Splats {
        means: Vec::new(),
        means_low: Vec::new(),
        quats: Vec::new(),
        scales: Vec::new(),
        opacities: Vec::new(),
        sh: Vec::new(),
        ..*splats
    };
    let n = splats.sh_len();
    for i in 0..splats.len() {
        if splats.mean(i).dot(up) < height {
            kept.means.push(splats.means[i]);
            kept.quats.push(splats.quats[i]);
            kept.scales.push(splats.scales[i]);
            kept.opacities.push(splats.opacities[i]);
            kept.sh.extend_from_slice(&splats.sh[i * n..(i + 1) * n]);
        }
    }
    kept
}

/// Distance between grid lines for a plan of side `span`: 1, 2 or 5 times a power of ten.
fn round_step(span: f64) -> f64 {
    let mut unit = 1e-9;
    while unit * 10.0 <= span / LINES {
        unit *= 10.0;
    }
    [1.0, 2.0, 5.0, 10.0].map(|k| k * unit).into_iter().find(|s| *s >= span / LINES).unwrap_or(unit)
}

impl Plan {
    /// Renders the part of the scene up to `cut` above the floor, as seen from above. `axes` are the right, forward
    /// and up directions in the world.
    pub fn new(
        splats: &Splats,
        stand: &LevelEstimate,
        axes: [DVec3; 3],
        cut: f64,
        side_px: usize,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let [right, forward, up] = axes;
        let half = 1.02 * stand.radius;
        let centre = DVec3::from_array(stand.centre);
        let shown = below(splats, up, stand.floor + cut);
        let floor = centre + up * (stand.floor - centre.dot(up));
        let eye = floor + up * (HIGH * half);
        let focal = 0.5 * side_px as f64 * HIGH;
        let camera = Camera::centred("plan", [side_px as u32; 2], focal, [right, -forward, -up], eye);
        let seen = render(&shown, &camera, None, &Settings { near: 0.5 * half, ..Settings::default() }, cx)?;
        let canvas = Canvas::of(&seen, side_px, side_px);
        let mut plan = Self { canvas, step: round_step(2.0 * half), right, forward, centre, half };
        plan.grid();
        Ok(plan)
    }

    /// Pixel that shows a point.
    pub fn at(&self, p: DVec3) -> [f64; 2] {
        let v = p - self.centre;
        let side = self.canvas.width as f64;
        [
            (v.dot(self.right) / self.half * 0.5 + 0.5) * side,
            (0.5 - v.dot(self.forward) / self.half * 0.5) * side,
        ]
    }

    fn grid(&mut self) {
        let side = self.canvas.width as f64;
        let middle = DVec2::new(self.centre.dot(self.right), self.centre.dot(self.forward));
        let (first, last) =
            (-(self.half / self.step).ceil() as i64 - 1, (self.half / self.step).ceil() as i64 + 1);
        for (axis, origin) in [(0, middle.x), (1, middle.y)] {
            let base = (origin / self.step).round() as i64;
            for k in first + base..=last + base {
                let offset = (k as f64 * self.step - origin) / self.half * 0.5;
                if offset.abs() > 0.5 {
                    continue;
                }
                let place = if axis == 0 { (0.5 + offset) * side } else { (0.5 - offset) * side };
                let (from, to) = if axis == 0 {
                    ([place, 0.0], [place, side - 1.0])
                } else {
                    ([0.0, place], [side - 1.0, place])
                };
                let share = if k == 0 { 0.6 } else { 0.28 };
                self.canvas.line(from, to, [1.0, 1.0, 1.0], share);
                let value = k as f64 * self.step;
                // Labels show the world coordinate, which decreases to the right or upwards if the axis points the
                // other way.
                let sign = if axis == 0 { self.right } else { self.forward };
                let value = value * (sign.x + sign.y + sign.z).signum() + 0.0;
                let (mut digits, mut step) = (0, self.step);
                while step < 0.999 && digits < 9 {
                    (digits, step) = (digits + 1, step * 10.0);
                }
                let text = format!("{value:.digits$}");
                let at = if axis == 0 { [place as i64 + 3, side as i64 - 14] } else { [3, place as i64 + 3] };
                self.canvas.text(at, &text, 2, [1.0, 0.9, 0.5]);
            }
        }
        let name = |v: DVec3| {
            if v.x != 0.0 {
                "x"
            } else if v.y != 0.0 {
                "y"
            } else {
                "z"
            }
        };
        self.canvas.text([side as i64 - 14, side as i64 - 30], name(self.right), 3, [1.0, 0.5, 0.4]);
        self.canvas.text([18, 6], name(self.forward), 3, [0.5, 1.0, 0.5]);
    }

    /// Draws an arrow with a number from one point towards another.
    pub fn mark(&mut self, from: DVec3, to: DVec3, number: usize) {
        let (a, b) = (self.at(from), self.at(to));
        let way = DVec2::new(b[0] - a[0], b[1] - a[1]).normalize_or_zero() * 34.0;
        let colour = [1.0, 0.2, 0.2];
        for width in -1..=1 {
            let shift = f64::from(width);
            let tip = [a[0] + way.x + shift, a[1] + way.y];
            self.canvas.line([a[0] + shift, a[1]], tip, colour, 1.0);
            for side in [-1.0, 1.0] {
                let back = way * -0.3 + way.perp() * (0.2 * side);
                self.canvas.line(tip, [tip[0] + back.x, tip[1] + back.y], colour, 1.0);
            }
        }
        self.canvas.text([a[0] as i64 - 6, a[1] as i64 - 6], &number.to_string(), 3, [1.0; 3]);
    }
}
