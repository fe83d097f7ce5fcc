//! Tests of tracing one pixel per block, as previews do.

use super::*;

// Each block of a coarse picture equals the pixel of the full picture that represents it, bit for bit in all values
// without random numbers. A block of n by n pixels costs as much as one pixel.
#[test]
fn a_block_is_the_pixel_that_stands_for_it() {
    let (plane, objects, rig) = shadowed();
    // The size is not a multiple of the block size.
    let mut rig = Rig::clone(&rig);
    (rig.cameras[0].width_px, rig.cameras[0].height_px) = (30, 21);
    let rig = Arc::new(rig);
    let trace = |coarse_px: u32| {
        let cx = context();
        let params = PathTrace { coarse_px, ..params(16, Surroundings::OPEN) };
        let (out, _) = render_in(&cx, &params, &plane, &objects, &rig, &white());
        (out, cx.counts()["camera_rays"])
    };
    let ((whole, rays), (coarse, fewer)) = (trace(1), trace(4));
    assert!(fewer * 13 < rays, "8 by 6 blocks for 30 by 21 pixels: {fewer} of {rays} rays");
    let middle = |v: usize, size: usize| (v / 4 * 4 + 2).min(size - 1);
    let pixels = || (0..21).flat_map(|y| (0..30).map(move |x| (x, y)));
    // The values of a picture at the pixels that represent the blocks.
    let looked_at = |images: &Images| -> Vec<f32> {
        let channels = images.0[0].picture.size().2;
        let pixel = |(x, y)| &samples(images)[(middle(y, 21) * 30 + middle(x, 30)) * channels..][..channels];
        pixels().flat_map(pixel).copied().collect()
    };
    for (a, b) in [(&whole.depth, &coarse.depth), (&whole.normal, &coarse.normal)] {
        assert_eq!(a.0[0].picture.size(), b.0[0].picture.size());
        assert_eq!(looked_at(a), samples(b));
    }
    for (a, b) in [(&whole.without, &coarse.without), (&whole.with, &coarse.with)] {
        let a = scene::math::num::ordered_sum(looked_at(a)) / samples(b).len() as f64;
        assert!((mean(b) / a - 1.0).abs() < 0.05, "{} for {a}", mean(b));
    }
    let alpha = |o: Vec<f32>| o.chunks(4).map(|o| o[3]).collect::<Vec<_>>();
    assert_eq!(alpha(looked_at(&whole.object)), alpha(samples(&coarse.object).to_vec()));
}

/// A coarse picture does not sample to a target error, which would take at least four samples: it equals the picture
/// without a target, and casts as many rays. This test fails if `target_error` returns `max_error` for every picture.
#[test]
fn a_coarse_picture_takes_the_samples_that_it_is_given() {
    let (plane, objects, rig) = shadowed();
    let trace = |max_error: Option<f64>| {
        let cx = context();
        let params = PathTrace { coarse_px: 4, max_error, ..params(1, Surroundings::OPEN) };
        let (out, _) = render_in(&cx, &params, &plane, &objects, &rig, &white());
        (samples(&out.with).to_vec(), samples(&out.object).to_vec(), cx.counts()["rays"])
    };
    assert_eq!(trace(Some(0.001)), trace(None));
}
