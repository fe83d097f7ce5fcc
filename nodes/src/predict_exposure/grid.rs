//! The panorama on the grid that light is judged on.

use engine::Up;
use glam::DVec3;

use crate::equirect::{direction, pixel_solid_angle};
use crate::light::linear::LinearPixels;

/// Columns of the grid; a finer panorama is averaged over its cells.
const WIDTH: usize = 256;

/// A panorama averaged over cells.
pub(super) struct Grid {
    /// Columns, at most 256.
    pub width: usize,
    /// Rows, at most 128.
    pub height: usize,
    /// Mean linear light of each cell.
    pub rgb: Vec<[f64; 3]>,
    /// Whether any pixel of the cell is clipped, so that a sun smaller than a cell is found.
    pub clipped: Vec<bool>,
    /// Whether any pixel of the cell was seen.
    pub seen: Vec<bool>,
    /// The cell of each pixel.
    pub cell_of: Vec<u32>,
}

impl Grid {
    pub fn new(pixels: &LinearPixels, mask: &[bool], alpha: &[f32]) -> Self {
        let (w, h) = (pixels.width, pixels.height);
        let (width, height) = (WIDTH.min(w), (WIDTH / 2).min(h));
        let n = width * height;
        let (mut sums, mut rgb) = (vec![0.0; n], vec![[0.0; 3]; n]);
        let (mut clipped, mut seen) = (vec![false; n], vec![false; n]);
        let mut cell_of = Vec::with_capacity(w * h);
        for y in 0..h {
            let solid_angle = pixel_solid_angle(w, h, y);
            for x in 0..w {
                let at = y * w + x;
                let cell = (2 * y + 1) * height / (2 * h) * width + (2 * x + 1) * width / (2 * w);
                cell_of.push(cell as u32);
                sums[cell] += solid_angle;
                for (sum, value) in rgb[cell].iter_mut().zip(pixels.rgb[at]) {
                    *sum += solid_angle * f64::from(value);
                }
                clipped[cell] |= mask[at];
                seen[cell] |= alpha[at] >= super::SEEN;
            }
        }
        for (rgb, sum) in rgb.iter_mut().zip(&sums) {
            *rgb = rgb.map(|v| v / sum.max(f64::MIN_POSITIVE));
        }
        Self { width, height, rgb, clipped, seen, cell_of }
    }

    pub fn direction(&self, up: Up, cell: usize) -> DVec3 {
        let (x, y) = ((cell % self.width) as f64 + 0.5, (cell / self.width) as f64 + 0.5);
        direction(up, x / self.width as f64, y / self.height as f64)
    }

    pub fn solid_angle(&self, cell: usize) -> f64 {
        pixel_solid_angle(self.width, self.height, cell / self.width)
    }
}
