//! One pixel for a block: what a preview traces.

use super::*;

// Each pixel of a coarse picture is, bit for bit in what no random number decides, the one of the whole picture that
// stands for its block; and a block of n by n pixels costs one of them.
#[test]
fn a_block_is_the_pixel_that_stands_for_it() {
    let (plane, objects, rig) = shadowed();
    // No multiple of the block.
    let mut rig = Rig::clone(&rig);
    (rig.cameras[0].width_px, rig.cameras[0].height_px) = (30, 21);
    let rig = Arc::new(rig);
    let trace = |coarse_px: u32| {
        let cx = context();
        let params = PathTrace { coarse_px, ..params(4, EnvBlock::Solid) };
        let (out, _) = render_in(&cx, &params, &plane, &objects, &rig, &sunny());
        (out, cx.counts()["camera_rays"])
    };
    let ((whole, rays), (coarse, fewer)) = (trace(1), trace(4));
    assert!(fewer * 13 < rays, "8 by 6 blocks for 30 by 21 pixels: {fewer} of {rays} rays");
    for (a, b) in [(&whole.depth, &coarse.depth), (&whole.normal, &coarse.normal)] {
        let (a, b) = (&a.0[0].picture, &b.0[0].picture);
        assert_eq!(a.size(), b.size());
        let channels = a.size().2;
        for (x, y) in (0..21).flat_map(|y| (0..30).map(move |x| (x, y))) {
            let middle = |v: usize, size: usize| (v / 4 * 4 + 2).min(size - 1);
            let pixel = |p: &crate::types::Picture, x: usize, y: usize| {
                p.samples()[(y * 30 + x) * channels..][..channels].to_vec()
            };
            assert_eq!(pixel(b, x, y), pixel(a, middle(x, 30), middle(y, 21)), "at {x}, {y}");
        }
    }
    for (a, b) in [(&whole.without, &coarse.without), (&whole.with, &coarse.with)] {
        assert!((mean(b) / mean(a) - 1.0).abs() < 0.05, "{} for {}", mean(b), mean(a));
    }
}
