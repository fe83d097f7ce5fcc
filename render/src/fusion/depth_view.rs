//! A camera's view of a scene, packed for fusion. For each pixel it holds the inverse depth, the confidence in this
//! depth, the slant of the surface, and the colour.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use scene::types::{Camera, SplatEncoding, Splats};

use crate::splat::{Blocks, DepthMode, Rendered, Settings, render_with};

/// Spread of the blended depths, as a share of the depth, at which a pixel has a confidence of 1/4. Pixels that see
/// two surfaces at once have a larger spread.
const TRUSTED_SPREAD: f32 = 0.03;

/// Maximum relative difference between the inverse depths of adjacent pixels that show the same surface. A plane
/// seen at 7 degrees in a face of 192 pixels, whose pixels are 0.0116 rad wide, has this difference.
pub const EDGE: f32 = 0.1;

/// Side, in pixels, of the squares of pixels that [`DepthView::hides`] tests.
const SQUARE: usize = 8;

/// A camera's view. Positions are relative to an origin in the scene, in world units.
pub struct DepthView {
    /// Position of the camera.
    pub eye: Vec3,
    /// Unit vector to the right, in the world.
    pub right: Vec3,
    /// Unit vector down, in the world.
    pub down: Vec3,
    /// Unit vector along the optical axis, in the world.
    pub forward: Vec3,
    /// Horizontal and vertical focal lengths, in pixels.
    pub focal: [f32; 2],
    /// Principal point, in pixels.
    pub middle: [f32; 2],
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Reciprocal of the planar depth of each pixel; 0 where the pixel shows no surface.
    pub inverse: Vec<f32>,
    /// For each pixel, the confidence, and the cosine of the angle between the ray and the normal of the surface.
    /// Both are scaled so that 255 is 1.
    pub marks: Vec<[u8; 2]>,
    /// Colour of each pixel in the display encoding.
    pub colours: Vec<[u8; 3]>,
    /// Minimum inverse depth of each square of [`SQUARE`] by [`SQUARE`] pixels, row by row.
    farthest: Vec<f32>,
}

/// A point projected into a view.
#[derive(Debug, Clone, Copy)]
pub struct OnPicture {
    /// Planar depth, in world units.
    pub depth: f32,
    /// Distance from the eye divided by the planar depth.
    pub stretch: f32,
    /// Horizontal and vertical position in the picture, in pixels from the centre of the first pixel.
    pub at: [f32; 2],
}

impl DepthView {
    /// Renders the splats in the view of a camera.
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
                    scene::math::color::srgb_from_linear(c)
                } else {
                    c
                })
            };
            view.colours.push([shown(pixel[0]), shown(pixel[1]), shown(pixel[2])]);
        }
        view
    }

    /// Vector from the eye to the point at planar depth 1 on the ray through the centre of a pixel.
    pub fn ray(&self, x: usize, y: usize) -> Vec3 {
        let slope_x = (x as f32 + 0.5 - self.middle[0]) / self.focal[0];
        let slope_y = (y as f32 + 0.5 - self.middle[1]) / self.focal[1];
        self.forward + self.right * slope_x + self.down * slope_y
    }

    /// Position of the point that a pixel shows, relative to the eye. `None` if the pixel shows no surface.
    pub fn point(&self, x: usize, y: usize) -> Option<Vec3> {
        let inverse = self.inverse[y * self.width + x];
        (inverse > 0.0).then(|| self.ray(x, y) / inverse)
    }

    /// Cosine of the angle between the ray of a pixel and the normal of the surface that it shows. The normal is
    /// estimated from the horizontal and the vertical neighbour closest in depth; the result is 0 if one of them is
    /// missing.
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

    /// Projects a point into the view. `None` if the point is behind the eye, or if its projection is outside the
    /// picture or in the outer half of a pixel on the border, where it is not surrounded by four pixel centres.
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

    /// Returns the inverse depth of the surface at a position between four pixel centres, whether these four pixels
    /// show one surface, and the index of the nearest pixel. If they show one surface, the inverse depth is
    /// interpolated linearly, which is exact for a plane. Otherwise it is the inverse depth of the nearest pixel.
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

    /// True if a ball is hidden, that is, if the ball is behind the surface by more than `behind` at every pixel
    /// that it covers. `offset` is the centre of the ball relative to the eye.
    pub fn hides(&self, offset: Vec3, radius: f32, behind: f32) -> bool {
        let depth = offset.dot(self.forward);
        let nearest = depth - radius;
        if nearest <= radius {
            return false;
        }
        // A bound of the pixels that the ball covers: a third and one pixel larger than its bounding box.
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

    /// Memory used by a view of `pixels` pixels, in bytes.
    pub const fn bytes(pixels: u64) -> u64 {
        pixels * 9
    }
}

/// Converts a value from 0 to 1 to a byte.
fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
