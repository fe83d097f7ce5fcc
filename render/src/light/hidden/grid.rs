//! The grid of cells on which light is estimated.

use crate::light::linear::LinearPixels;
use engine::Up;
use glam::DVec3;
use scene::math::equirect::{direction, pixel_solid_angle};

/// Number of columns of the grid. A finer panorama is averaged over the cells.
pub const WIDTH: usize = 256;

/// A panorama averaged over cells.
pub struct Grid {
    /// Number of columns, at most 256.
    pub width: usize,
    /// Number of rows, at most 128.
    pub height: usize,
    /// Mean linear light of the visible pixels of each cell. A cell without a visible pixel has the mean of its
    /// filled pixels.
    pub rgb: Vec<[f64; 3]>,
    /// Mean linear light of the visible unclipped part of each cell; 0 if that part is empty.
    pub open_rgb: Vec<[f64; 3]>,
    /// Mean linear light of the visible clipped part of each cell; 0 if that part is empty.
    pub clipped_rgb: Vec<[f64; 3]>,
    /// For each cell, true if any of its pixels is clipped, so that a sun smaller than a cell is found.
    pub clipped: Vec<bool>,
    /// For each cell, the clipped fraction of its visible part, by solid angle.
    pub share: Vec<f64>,
    /// For each cell, true if any of its pixels is visible.
    pub seen: Vec<bool>,
    /// Index of the cell of each pixel.
    pub cell_of: Vec<u32>,
    /// Index of the pixel column at which the first cell begins, and the number of pixel columns of the panorama.
    pub start: (usize, usize),
}

impl Grid {
    /// Averages a panorama with its clipped pixels and its coverage `alpha` onto the grid.
    pub fn new(pixels: &LinearPixels, mask: &[bool], alpha: &[f32]) -> Self {
        let (w, h) = (pixels.width, pixels.height);
        let (width, height) = (WIDTH.min(w), (WIDTH / 2).min(h));
        let n = width * height;
        let start = if w > WIDTH { first_column(pixels, alpha) } else { 0 };
        // Light and solid angle of each cell: visible and unclipped, clipped, and filled.
        let mut sums = vec![[[0.0_f64; 4]; 3]; n];
        let mut cell_of = Vec::with_capacity(w * h);
        for y in 0..h {
            let solid_angle = pixel_solid_angle(w, h, y);
            for x in 0..w {
                let at = y * w + x;
                let from_start = (x + w - start) % w;
                // Counted from the nearer end, so that a mirrored panorama has mirrored cells.
                let from_end = from_start.min(w - 1 - from_start);
                let column = (2 * from_end + 1) * width / (2 * w);
                let column = if from_end == from_start { column } else { width - 1 - column };
                let cell = (2 * y + 1) * height / (2 * h) * width + column;
                cell_of.push(cell as u32);
                let kind = if alpha[at] < super::clip::SEEN { 2 } else { usize::from(mask[at]) };
                let sums = &mut sums[cell][kind];
                sums[3] += solid_angle;
                for (sum, value) in sums.iter_mut().zip(pixels.rgb[at]) {
                    *sum += solid_angle * f64::from(value);
                }
            }
        }
        let mean = |[r, g, b, size]: [f64; 4]| [r, g, b].map(|v| v / size.max(f64::MIN_POSITIVE));
        // Filled pixels differ when the panorama is rotated, so they count only where nothing is visible.
        let all = |[open, clipped, filled]: &[[f64; 4]; 3]| {
            let seen: [f64; 4] = std::array::from_fn(|i| open[i] + clipped[i]);
            mean(if seen[3] > 0.0 { seen } else { *filled })
        };
        let each = || sums.iter();
        Self {
            width,
            height,
            rgb: each().map(all).collect(),
            open_rgb: each().map(|[open, ..]| mean(*open)).collect(),
            clipped_rgb: each().map(|[_, clipped, _]| mean(*clipped)).collect(),
            clipped: each().map(|[_, clipped, _]| clipped[3] > 0.0).collect(),
            share: each()
                .map(|[open, clipped, _]| clipped[3] / (open[3] + clipped[3]).max(f64::MIN_POSITIVE))
                .collect(),
            seen: each().map(|[open, clipped, _]| open[3] + clipped[3] > 0.0).collect(),
            cell_of,
            start: (start, w),
        }
    }

    /// Position of the centre of the pixel (`x`, `y`) of a panorama with `height` rows, in units of cells.
    pub fn place(&self, x: usize, y: usize, height: usize) -> [f64; 2] {
        let (start, w) = self.start;
        let from_start = (x + w - start) % w;
        [(from_start, w, self.width), (y, height, self.height)]
            .map(|(i, n, cells)| (i as f64 + 0.5) * cells as f64 / n as f64)
    }

    /// True if any cell has visible unclipped light.
    pub fn anything_visible(&self) -> bool {
        self.open_rgb.iter().any(|rgb| rgb.iter().any(|v| *v > 0.0))
    }

    /// Direction of the centre of a cell.
    pub fn direction(&self, up: Up, cell: usize) -> DVec3 {
        let (x, y) = ((cell % self.width) as f64 + 0.5, (cell / self.width) as f64 + 0.5);
        let (start, w) = self.start;
        direction(up, (x / self.width as f64 + start as f64 / w as f64) % 1.0, y / self.height as f64)
    }

    /// Solid angle of a cell in steradians.
    pub fn solid_angle(&self, cell: usize) -> f64 {
        pixel_solid_angle(self.width, self.height, cell / self.width)
    }

    /// Solid angle of a cell multiplied by the clipped fraction of its visible part.
    pub fn clipped_angle(&self, cell: usize) -> f64 {
        self.share[cell] * self.solid_angle(cell)
    }

    /// Solid angle of a cell multiplied by the unclipped fraction of its visible part; 0 if no part is visible.
    pub fn open_angle(&self, cell: usize) -> f64 {
        if self.seen[cell] { (1.0 - self.share[cell]) * self.solid_angle(cell) } else { 0.0 }
    }
}

/// Index of the pixel column at which the first cell begins. It is the edge at which the sequence of column sums,
/// read in either direction, comes last in lexicographic order. So the cells lie at the same places of the scene if
/// a panorama is rotated by any number of pixels, or mirrored.
fn first_column(pixels: &LinearPixels, alpha: &[f32]) -> usize {
    let width = pixels.width;
    let mut sums = vec![0.0_f64; width];
    for (at, rgb) in pixels.rgb.iter().enumerate().filter(|(at, _)| alpha[*at] >= super::clip::SEEN) {
        sums[at % width] += rgb.iter().copied().map(f64::from).sum::<f64>();
    }
    let mut edges: Vec<(usize, bool)> =
        [true, false].into_iter().flat_map(|r| (0..width).map(move |x| (x, r))).collect();
    for step in 0..width {
        let read =
            |&(x, right): &(usize, bool)| sums[(if right { x + step } else { x + width - 1 - step }) % width];
        let most = edges.iter().map(read).fold(f64::NEG_INFINITY, f64::max);
        edges.retain(|edge| read(edge).total_cmp(&most).is_eq());
        if edges.len() == 1 {
            break;
        }
    }
    edges.first().map_or(0, |(x, _)| *x)
}
