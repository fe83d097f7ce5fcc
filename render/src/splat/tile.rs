//! Input and output of the blending of one tile.

use std::sync::{Mutex, PoisonError};

use engine::Context;
use scene::types::{Data, Image};

use super::project::Projected;
use super::settings::{DepthMode, Settings, TILE};

/// The rows of a picture that one row of tiles covers. Each tile writes its pixels to the strip when it is
/// finished.
pub(super) struct Strip<'a> {
    /// Number of columns of the picture.
    width: usize,
    rgba: &'a mut [[f32; 4]],
    depth: &'a mut [f32],
    /// Number of blends of each pixel; empty unless they are counted.
    blends: &'a mut [f32],
    /// Mean depth of the front surface of each pixel (see `Rendered`); empty unless the depth mode is `RayMedian`.
    front: &'a mut [f32],
    /// Spread of the depth of each pixel (see `Rendered`); empty unless the depth mode has a spread.
    spread: &'a mut [f32],
}

impl<'a> Strip<'a> {
    /// Divides a picture into strips, one for each row of tiles.
    pub(super) fn of(
        width: usize,
        rgba: &'a mut [[f32; 4]],
        depth: &'a mut [f32],
        [blends, front, spread]: [&'a mut [f32]; 3],
    ) -> Vec<Mutex<Self>> {
        let pixels = (width * TILE).max(1);
        let mut more = [blends, front, spread].map(|values| values.chunks_mut(pixels));
        let both = rgba.chunks_mut(pixels).zip(depth.chunks_mut(pixels));
        let strip = |(rgba, depth)| {
            let [blends, front, spread] = more.each_mut().map(|chunks| chunks.next().unwrap_or_default());
            Self { width, rgba, depth, blends, front, spread }
        };
        both.map(strip).map(Mutex::new).collect()
    }
}

/// Input for blending one tile.
pub(super) struct Task<'a, 'p> {
    pub projected: &'a Projected,
    pub list: &'a [u32],
    /// First column and row, width and height, in pixels.
    pub area: [usize; 4],
    pub limit: Option<&'a Image<Data>>,
    pub settings: &'a Settings,
    pub cx: &'a Context,
    /// Output of the tile.
    pub strip: &'a Mutex<Strip<'p>>,
}

/// Result of blending the splats at one pixel.
pub(super) struct Pixel {
    pub rgba: [f32; 4],
    pub depth: f32,
    pub blends: f32,
    pub front: f32,
    pub spread: f32,
}

impl Task<'_, '_> {
    /// Writes the pixels of the tile to the strip. `pixel` returns the pixel at a row and a column.
    #[inline(always)]
    pub(super) fn show(&self, pixel: impl Fn(usize, usize) -> Pixel) {
        let [x0, _, width, height] = self.area;
        let mut strip = self.strip.lock().unwrap_or_else(PoisonError::into_inner);
        for row in 0..height {
            let at = row * strip.width + x0;
            for column in 0..width {
                let Pixel { rgba, depth, blends, front, spread } = pixel(row, column);
                strip.rgba[at + column] = rgba;
                strip.depth[at + column] = depth;
                if self.settings.count_blends {
                    strip.blends[at + column] = blends;
                }
                if self.settings.depth == DepthMode::RayMedian {
                    strip.front[at + column] = front;
                    strip.spread[at + column] = spread;
                }
            }
        }
    }

    /// Depth at which blending ends for each pixel of the tile, in rows of [`TILE`] values; +inf outside the
    /// picture. `None` if there is no limit.
    pub(super) fn limits(&self) -> Option<Vec<f32>> {
        let image = self.limit?;
        let [x0, y0, width, height] = self.area;
        let mut limits = vec![f32::INFINITY; TILE * TILE];
        for row in 0..height {
            for column in 0..width {
                // Some files store 0 where there is no surface.
                let depth = image.pixel(x0 + column, y0 + row)[0];
                limits[row * TILE + column] = if depth > 0.0 { depth } else { f32::INFINITY };
            }
        }
        Some(limits)
    }
}

/// Work counts of a tile, complete unless the run was cancelled.
pub(super) struct Blended {
    pub evaluations: u64,
    pub blends: u64,
}
