//! White level of a panorama.

use render::light::linear::{LinearPixels, max3};
use scene::math::equirect::pixel_solid_angle;

use render::light::hidden::clip::CLIPPED;

/// White level of the panorama, in linear light. It is 1 in the training data and for a `white` of at least
/// [`CLIPPED`]. For a lower `white` it is the median of the brightest channel of the clipped pixels, weighted
/// by solid angle.
pub(super) fn ceiling(pixels: &LinearPixels, mask: &[bool], white: f32) -> f64 {
    if white >= CLIPPED {
        return 1.0;
    }
    let mut clipped: Vec<(f32, usize)> = (0..mask.len())
        .filter(|&at| mask[at])
        .map(|at| (max3(pixels.rgb[at]).min(1.0), at / pixels.width))
        .collect();
    clipped.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let size = |row: usize| pixel_solid_angle(pixels.width, pixels.height, row);
    let total: f64 = clipped.iter().map(|(_, row)| size(*row)).sum();
    let mut sum = 0.0;
    let median = clipped.iter().find(|(_, row)| {
        sum += size(*row);
        2.0 * sum >= total
    });
    median.map_or(1.0, |(brightest, _)| f64::from(*brightest))
}

#[cfg(test)]
mod tests {
    use super::super::{In, Method, PredictExposure};
    use super::*;
    use engine::{Kind, Up};
    use scene::types::{Image, Linear, Panorama};
    use std::sync::Arc;

    const WIDTH: usize = 256;

    /// Sky over ground with a white window, and a yellow lamp whose blue channel does not clip, all multiplied by
    /// `scale`.
    fn room(scale: f32) -> Arc<Panorama> {
        let pixel = |at: usize| match (at % WIDTH, at / WIDTH) {
            (100..104, 30..34) => [1.0; 3],
            (180..200, 50..60) => [1.0, 0.98, 0.4],
            (x, y) if y < 64 => [0.3 + x as f32 / 2048.0, 0.35, 0.45],
            (_, y) => [0.1 + y as f32 / 1024.0, 0.12, 0.1],
        };
        let samples = (0..WIDTH * WIDTH / 2).flat_map(pixel).map(|v| v * scale).collect();
        Arc::new(Panorama {
            image: Image::<Linear>::from_samples(WIDTH, WIDTH / 2, 3, samples).into(),
            alpha: Image::from_samples(WIDTH, WIDTH / 2, 1, vec![1.0; WIDTH * WIDTH / 2]),
            up: Up::PlusZ,
            origin: None,
            turned_deg: 0.0,
        })
    }

    fn gains(pano: Arc<Panorama>, method: &Method, white: f32) -> Vec<f32> {
        let cx = testing::context();
        let params = PredictExposure { evs: vec![-3.0], method: method.clone(), white, weights: None };
        let (out, _) = PredictExposure::run(&params, In { pano }, &cx).expect("runs");
        out.brackets.log2_gain.samples.clone()
    }

    // The same picture with a white level of 0.75 hides the same light, if `white` is set accordingly: every gain
    // is equal within single precision. This test fails if `ceiling` is always 1 in `Scene::new` of the networks,
    // or in `features` of the regions.
    #[test]
    fn whites_that_end_early_hide_the_same_light() {
        for method in [Method::Learned, Method::Region] {
            let (whole, early) = (gains(room(1.0), &method, 0.95), gains(room(0.75), &method, 0.7125));
            assert!(whole.iter().any(|gain| *gain > 0.1), "{method:?}");
            for (at, (a, b)) in whole.iter().zip(&early).enumerate() {
                assert!((a - b).abs() < 1e-4, "{method:?} {at}: {a} {b}");
            }
        }
    }

    // Noise above the white level does not raise it. This test fails if the maximum is taken in place of the
    // median.
    #[test]
    fn whites_end_where_most_of_them_do() {
        let pixels = |bright: usize| LinearPixels {
            width: 16,
            height: 8,
            rgb: (0..128).map(|at| if at < bright { [1.0; 3] } else { [0.2, 0.8, 0.8] }).collect(),
            broken: 0,
            negative: 0,
            ceiling: true,
        };
        let mask = vec![true; 128];
        assert!((ceiling(&pixels(20), &mask, 0.75) - 0.8).abs() < 1e-6);
        assert_eq!(ceiling(&pixels(100), &mask, 0.75), 1.0);
        assert_eq!(ceiling(&pixels(20), &mask, 0.95), 1.0);
        assert_eq!(ceiling(&pixels(20), &[false; 128], 0.75), 1.0, "nothing is clipped");
    }
}
