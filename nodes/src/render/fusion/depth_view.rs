//! A camera's view of a scene, packed for fusion: per pixel the inverse depth, its confidence, the slant of the
//! surface, and its colour.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};

use crate::render::splat::{Blocks, DepthMode, Rendered, Settings, render_with};
use crate::types::{Camera, SplatEncoding, Splats};

/// The share of the depth that the mean of what was blended may lie off for a pixel to count a quarter. Pixels that see
/// two surfaces at once lie farther off.
const TRUSTED_SPREAD: f32 = 0.03;

/// Inverse depths of neighbours that differ by more than this share belong to two surfaces. A plane seen at 7 degrees with
/// pixels of 0.0116 rad, those of a face of 192 pixels, differs by so much.
pub const EDGE: f32 = 0.1;

/// Side of a square of [`DepthView::hides`], in pixels.
const SQUARE: usize = 8;

/// A camera's view. Positions are relative to an origin in the scene, in world units.
pub struct DepthView {
    /// Where it stands.
    pub eye: Vec3,
    /// Its axes in the world.
    pub right: Vec3,
    pub down: Vec3,
    pub forward: Vec3,
    /// Focal lengths and principal point, in pixels.
    pub focal: [f32; 2],
    pub middle: [f32; 2],
    /// Columns and rows.
    pub width: usize,
    pub height: usize,
    /// One over the planar depth of each pixel; 0 where nothing hides what lies behind.
    pub inverse: Vec<f32>,
    /// Trust, and the cosine of the angle between the ray and the normal of the surface; 255 is 1.
    pub marks: Vec<[u8; 2]>,
    /// Colour of each pixel in the display encoding.
    pub colours: Vec<[u8; 3]>,
    /// Minimum inverse depth of each square of [`SQUARE`] by [`SQUARE`] pixels, row by row.
    farthest: Vec<f32>,
}

/// A point on a picture.
#[derive(Debug, Clone, Copy)]
pub struct OnPicture {
    /// Planar depth, in world units.
    pub depth: f32,
    /// Distance from the eye over depth.
    pub stretch: f32,
    /// Column and row, counted from the centre of the first pixel.
    pub at: [f32; 2],
}

impl DepthView {
    /// Renders what a camera sees.
    pub fn of(
        splats: &Splats,
        blocks: &Blocks,
        camera: &Camera,
        origin: DVec3,
        settings: &Settings,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let settings = Settings { depth: DepthMode::RayMedian, ..*settings };
        let seen = render_with(splats, Some(blocks), camera, None, &settings, cx)?;
        Ok(Self::packed(&seen, camera, origin, splats.encoding))
    }

    fn packed(seen: &Rendered, camera: &Camera, origin: DVec3, encoding: SplatEncoding) -> Self {
        let m = camera.world_from_camera();
        let (width, height) = (camera.width_px as usize, camera.height_px as usize);
        let mut view = Self {
            eye: (camera.eye() - origin).as_vec3(),
            right: m.x_axis.truncate().as_vec3(),
            down: m.y_axis.truncate().as_vec3(),
            forward: m.z_axis.truncate().as_vec3(),
            focal: [camera.fx as f32, camera.fy as f32],
            middle: [camera.cx as f32, camera.cy as f32],
            width,
            height,
            inverse: seen.front.iter().map(|depth| 1.0 / depth).collect(),
            marks: Vec::with_capacity(width * height),
            colours: Vec::with_capacity(width * height),
            farthest: vec![f32::INFINITY; width.div_ceil(SQUARE) * height.div_ceil(SQUARE)],
        };
        for (i, inverse) in view.inverse.iter().enumerate() {
            let square = &mut view.farthest[i / width / SQUARE * width.div_ceil(SQUARE) + i % width / SQUARE];
            *square = square.min(*inverse);
        }
        for (i, pixel) in seen.rgba.as_chunks::<4>().0.iter().enumerate() {
            let alpha = pixel[3];
            let trust = if view.inverse[i] > 0.0 {
                let off = seen.spread[i] / TRUSTED_SPREAD;
                let once = 1.0 / (1.0 + off * off);
                once * once
            } else {
                (1.0 - 2.0 * alpha).max(0.0)
            };
            let cosine = view.cosine(i % width, i / width);
            view.marks.push([trust, cosine].map(byte));
            let shown = |c: f32| {
                let c = c / alpha.max(1e-6);
                byte(if encoding == SplatEncoding::Linear {
                    crate::math::color::srgb_from_linear(c)
                } else {
                    c
                })
            };
            view.colours.push([shown(pixel[0]), shown(pixel[1]), shown(pixel[2])]);
        }
        view
    }

    /// The direction through the centre of a pixel, of planar depth 1.
    pub fn ray(&self, x: usize, y: usize) -> Vec3 {
        let slope_x = (x as f32 + 0.5 - self.middle[0]) / self.focal[0];
        let slope_y = (y as f32 + 0.5 - self.middle[1]) / self.focal[1];
        self.forward + self.right * slope_x + self.down * slope_y
    }

    /// The point that a pixel shows, from the eye.
    pub fn point(&self, x: usize, y: usize) -> Option<Vec3> {
        let inverse = self.inverse[y * self.width + x];
        (inverse > 0.0).then(|| self.ray(x, y) / inverse)
    }

    /// The cosine between the ray of a pixel and the normal of what it shows, by the neighbours that lie nearest to it in
    /// depth; 0 where it has none.
    fn cosine(&self, x: usize, y: usize) -> f32 {
        let Some(here) = self.point(x, y) else { return 0.0 };
        let inverse = |x: usize, y: usize| self.inverse[y * self.width + x];
        let own = inverse(x, y);
        let step = |back: Option<(usize, usize)>, on: Option<(usize, usize)>| {
            let off = |at: Option<(usize, usize)>| {
                at.map(|(x, y)| (inverse(x, y) - own).abs()).filter(|off| *off < 2.0 * EDGE * own)
            };
            let (at, sign) = match (off(back), off(on)) {
                (Some(a), Some(b)) if b < a => (on, 1.0),
                (Some(_), _) => (back, -1.0),
                (None, Some(_)) => (on, 1.0),
                (None, None) => return None,
            };
            let (x, y) = at?;
            Some((self.point(x, y)? - here) * sign)
        };
        let across = step(x.checked_sub(1).map(|x| (x, y)), (x + 1 < self.width).then_some((x + 1, y)));
        let along = step(y.checked_sub(1).map(|y| (x, y)), (y + 1 < self.height).then_some((x, y + 1)));
        let (Some(across), Some(along)) = (across, along) else { return 0.0 };
        let normal = across.cross(along);
        let lengths = normal.length() * here.length();
        if lengths > 0.0 { (normal.dot(here) / lengths).abs().min(1.0) } else { 0.0 }
    }

    /// Where a point lies on the picture; `None` where it is behind, or not between the centres of four pixels.
    #[inline]
    pub fn project(&self, point: Vec3) -> Option<OnPicture> {
        let offset = point - self.eye;
        let depth = offset.dot(self.forward);
        if depth <= 1e-6 {
            return None;
        }
        let inverse = 1.0 / depth;
        let x = self.focal[0] * (offset.dot(self.right) * inverse) + self.middle[0] - 0.5;
        let y = self.focal[1] * (offset.dot(self.down) * inverse) + self.middle[1] - 0.5;
        let inside = x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32;
        inside.then(|| OnPicture { depth, stretch: offset.length() * inverse, at: [x, y] })
    }

    /// One over the depth of the surface at a place between four pixels, linear where they show one surface (which is exact
    /// for a plane) and that of the nearest otherwise; whether they show one; and the nearest pixel.
    #[inline]
    pub fn surface(&self, [x, y]: [f32; 2]) -> (f32, bool, usize) {
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let first = row * self.width + column;
        let nearest = first + usize::from(fx >= 0.5) + usize::from(fy >= 0.5) * self.width;
        let [a, b] = [self.inverse[first], self.inverse[first + 1]];
        let [c, d] = [self.inverse[first + self.width], self.inverse[first + self.width + 1]];
        let (most, least) = (a.max(b).max(c.max(d)), a.min(b).min(c.min(d)));
        if most - least > EDGE * most {
            return (self.inverse[nearest], false, nearest);
        }
        let (top, bottom) = (a + (b - a) * fx, c + (d - c) * fx);
        (top + (bottom - top) * fy, true, nearest)
    }

    /// True if a ball, at an offset from the eye, is more than `behind` behind the surface in every pixel that it covers.
    pub fn hides(&self, offset: Vec3, radius: f32, behind: f32) -> bool {
        let depth = offset.dot(self.forward);
        let nearest = depth - radius;
        if nearest <= radius {
            return false;
        }
        // A bound of the pixels that the ball covers: a third and one pixel more than its box.
        let span = |side: Vec3, k: usize, pixels: usize| {
            let at = self.focal[k] * offset.dot(side) / depth + self.middle[k];
            let half = 1.34 * self.focal[k] * radius * (offset.length() / depth) / nearest + 1.5;
            let last = (pixels - 1) as f32;
            ((at - half).clamp(0.0, last) as usize / SQUARE, (at + half).clamp(0.0, last) as usize / SQUARE)
        };
        let ((left, right), (top, bottom)) =
            (span(self.right, 0, self.width), span(self.down, 1, self.height));
        // In depth; for rays at the edge of a face, which are longer, the bound is looser than necessary.
        let least = 1.0 / (nearest - behind).max(1e-6);
        let columns = self.width.div_ceil(SQUARE);
        nearest > behind
            && (top..=bottom).all(|y| (left..=right).all(|x| self.farthest[y * columns + x] > least))
    }

    /// Memory of a view of `pixels` pixels, in bytes.
    pub const fn bytes(pixels: u64) -> u64 {
        pixels * 9
    }
}

/// 0 to 1 as a byte.
fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
