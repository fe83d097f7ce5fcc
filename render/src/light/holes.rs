//! Filling of holes: push-pull over a pyramid of halved sizes (Gortler et al. 1996, "The Lumigraph",
//! section 3.4). Columns wrap; rows end at the poles.

use engine::{Context, NodeError};

/// A level of the pyramid: for each pixel, its confidence, 0 to 1, and its colour multiplied by the confidence.
struct PyramidLevel {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 4]>,
}

impl PyramidLevel {
    /// The level at half the size. The confidence of a pixel is the sum of the confidences of the four pixels that
    /// it replaces, at most 1.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0_f32; 4];
                for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let (row, column) = (2 * y + dy, 2 * x + dx);
                    if row < self.height && column < self.width {
                        let pixel = self.pixels[row * self.width + column];
                        sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value);
                    }
                }
                let by = 1.0 / sum[3].max(1.0);
                pixels.push(sum.map(|v| v * by));
            }
        }
        Self { width, height, pixels }
    }

    /// Bilinearly interpolated colour of a level without holes, at the point (x, y) in pixels.
    fn at(colours: &[[f32; 3]], width: usize, height: usize, x: f32, y: f32) -> [f32; 3] {
        let (left, top) = ((x - 0.5).floor(), (y - 0.5).floor());
        let (fx, fy) = (x - 0.5 - left, y - 0.5 - top);
        let column = |i: isize| (left as isize + i).rem_euclid(width as isize) as usize;
        let row = |i: isize| (top as isize + i).clamp(0, height as isize - 1) as usize;
        let mut sum = [0.0; 3];
        for (dx, dy, share) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let colour = colours[row(dy) * width + column(dx)];
            sum.iter_mut().zip(colour).for_each(|(sum, value)| *sum += share * value);
        }
        sum
    }
}

/// Un-premultiplied colours with filled holes. A pixel with an alpha of at least `hole_alpha` keeps its colour. A
/// pixel with less alpha is blended with its surroundings, in proportion to the missing alpha.
pub fn fill(
    premultiplied: &[[f32; 4]],
    width: usize,
    hole_alpha: f32,
    cx: &Context,
) -> Result<Vec<[f32; 3]>, NodeError> {
    let height = premultiplied.len() / width.max(1);
    let sure = |p: &[f32; 4]| {
        let confidence = (p[3] / hole_alpha).min(1.0);
        if p[3] <= 0.0 {
            [0.0; 4]
        } else {
            [0, 1, 2, 3].map(|i| if i < 3 { p[i] / p[3] * confidence } else { confidence })
        }
    };
    let mut levels = vec![PyramidLevel { width, height, pixels: premultiplied.iter().map(sure).collect() }];
    while let Some(last) = levels.last()
        && (last.width > 1 || last.height > 1)
    {
        cx.check()?;
        let next = last.halved();
        levels.push(next);
    }
    let mut coarse: Option<(Vec<[f32; 3]>, usize, usize)> = None;
    while let Some(level) = levels.pop() {
        let rows = cx.for_each_tile(level.height, |y| {
            let mut row = Vec::with_capacity(level.width);
            for x in 0..level.width {
                let [r, g, b, confidence] = level.pixels[y * level.width + x];
                let missing = 1.0 - confidence;
                let around = match &coarse {
                    Some((colours, w, h)) if missing > 0.0 => {
                        // Scaled by the true ratio, so that odd sizes still wrap at the right position.
                        let u = (x as f32 + 0.5) * *w as f32 / level.width as f32;
                        let v = (y as f32 + 0.5) * 0.5;
                        PyramidLevel::at(colours, *w, *h, u, v)
                    }
                    // The single pixel of the coarsest level: the mean of everything that was seen.
                    None if confidence > 0.0 => [r / confidence, g / confidence, b / confidence],
                    _ => [0.0; 3],
                };
                row.push([r + missing * around[0], g + missing * around[1], b + missing * around[2]]);
            }
            row
        })?;
        coarse = Some((rows.concat(), level.width, level.height));
    }
    Ok(coarse.map_or_else(Vec::new, |(colours, _, _)| colours))
}
