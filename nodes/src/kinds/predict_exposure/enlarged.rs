//! Enlarges panoramas that have fewer columns than the grid, by repeating each pixel.
//!
//! The networks were trained on cells of one size, so a coarser grid cannot be used for a coarser panorama.

use render::light::linear::LinearPixels;
use scene::math::equirect::pixel_solid_angle;
use scene::math::num;
use scene::types::{Data, Image};

use render::light::hidden::grid::WIDTH;

/// A panorama of at least [`WIDTH`] columns in which each pixel of a smaller panorama is repeated along rows and
/// columns.
pub(super) struct Enlarged {
    pub pixels: LinearPixels,
    pub mask: Vec<bool>,
    pub alpha: Vec<f32>,
    times: usize,
}

impl Enlarged {
    /// Enlarges a panorama. `None` if it has at least as many columns as the grid, or is higher than wide.
    pub fn new(pixels: &LinearPixels, mask: &[bool], alpha: &[f32]) -> Option<Self> {
        let times = WIDTH.div_ceil(pixels.width);
        let (width, height) = (pixels.width * times, pixels.height * times);
        let from = |at: usize| at / width / times * pixels.width + at % width / times;
        let all = 0..width * height;
        (times > 1 && pixels.height <= pixels.width).then(|| Self {
            pixels: LinearPixels {
                width,
                height,
                rgb: all.clone().map(|at| pixels.rgb[from(at)]).collect(),
                ..*pixels
            },
            mask: all.clone().map(|at| mask[from(at)]).collect(),
            alpha: all.map(|at| alpha[from(at)]).collect(),
            times,
        })
    }

    /// log2 gain of each original pixel, given the log2 gain of each enlarged pixel. It is chosen so that an
    /// original pixel has the same light as all of its copies together.
    pub fn gathered(&self, log2_gain: &[f32]) -> Vec<f32> {
        let (width, height) = (self.pixels.width / self.times, self.pixels.height / self.times);
        let mut sums = vec![[0.0; 2]; width * height];
        for (at, gain) in log2_gain.iter().enumerate() {
            let (x, y) = (at % self.pixels.width, at / self.pixels.width);
            let size = pixel_solid_angle(self.pixels.width, self.pixels.height, y);
            let [after, before] = &mut sums[y / self.times * width + x / self.times];
            (*after, *before) = (*after + size * num::f64::exp2(f64::from(*gain)), *before + size);
        }
        sums.into_iter().map(|[after, before]| num::f64::log2(after / before).max(0.0) as f32).collect()
    }

    /// Colour of each original pixel, given the colour of each enlarged pixel. All copies of a pixel are in the same
    /// region, and so have the same colour.
    pub fn gathered_colour(&self, colour: &Image<Data>) -> Image<Data> {
        let (width, height) = (self.pixels.width / self.times, self.pixels.height / self.times);
        let first = |at: usize| colour.rgb(at % width * self.times, at / width * self.times);
        Image::from_samples(width, height, 3, (0..width * height).flat_map(first).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // The gain of a pixel gives the light of its parts, weighted by their solid angles. This test fails if `size`
    // is always 1.
    #[test]
    fn light_of_parts_is_light_of_the_pixel() {
        let pixels = LinearPixels {
            width: 128,
            height: 64,
            rgb: (0..128 * 64).map(|at| [at as f32; 3]).collect(),
            broken: 0,
            negative: 0,
            ceiling: true,
        };
        let (mask, alpha) = (vec![true; 128 * 64], vec![1.0; 128 * 64]);
        let large = Enlarged::new(&pixels, &mask, &alpha).expect("is coarse");
        assert_eq!((large.pixels.width, large.pixels.height), (256, 128));
        assert_eq!(large.pixels.rgb[3 * 256 + 5], pixels.rgb[128 + 2]);
        let gain: Vec<f32> = (0..256 * 128).map(|at| (at / 256 % 5) as f32).collect();
        let found = large.gathered(&gain);
        for y in 0..64 {
            let size = |row: usize| pixel_solid_angle(256, 128, row);
            let light = |row: usize| size(row) * num::f64::exp2((row % 5) as f64);
            let (a, b) = (2 * y, 2 * y + 1);
            let wanted = num::f64::log2((light(a) + light(b)) / (size(a) + size(b)));
            assert!((f64::from(found[y * 128 + 9]) - wanted).abs() < 1e-6, "{y}");
        }
        assert!(Enlarged::new(&large.pixels, &large.mask, &large.alpha).is_none());
    }
}
