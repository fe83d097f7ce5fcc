//! Samples: how many are taken, shared and traced, and what they claim of themselves.

use super::*;

// Work is counted, and guarded: objects that are not there cost nothing, and for those that are only the
// samples that they touch are traced again.
#[test]
fn rays_are_only_cast_where_they_may_matter() {
    let (plane, objects, rig) = shadowed();
    let rays = |objects: &[Arc<Placed>], block| {
        let cx = context();
        render_in(&cx, &params(16, block), &plane, objects, &rig, &sunny());
        let counts = cx.counts();
        let kinds = ["camera_rays", "shadow_rays", "scattered_rays"].map(|kind| counts[kind]);
        assert_eq!(kinds.iter().sum::<u64>(), counts["rays"]);
        kinds
    };
    // Beside the samples two rays a pixel look for what is in front.
    let (samples, front) = (16 * 32 * 32, 2 * 32 * 32);
    // A camera ray; where it lands up to four to the sky and, where the plane is solid, one scattered.
    let (solid, pass) = (rays(&[], EnvBlock::Solid), rays(&[], EnvBlock::Pass));
    assert_eq!(pass, [samples + front, 0, 0]);
    assert_eq!(solid[0], pass[0]);
    assert!(solid[1] <= samples * 4 && solid[2] <= samples, "{solid:?} for {samples} samples");
    // Again a camera ray, and another to the object; up to four to the sky, and two scattered that ask the receiver
    // and the object.
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    let more = |with: [u64; 3]| std::array::from_fn::<u64, 3, _>(|k| with[k] - solid[k]);
    let there = more(rays(&far, EnvBlock::Solid));
    assert_eq!(there[0], 2 * samples);
    assert!(there[1] <= samples * 4 && there[2] <= samples * 4, "{there:?} over {solid:?}");
    let near = more(rays(&objects, EnvBlock::Solid));
    assert!(near.iter().sum::<u64>() < samples * 11, "{near:?} over {solid:?}");
}

// 64 then 256 equals 256 at once, in small: chunks are the same whatever the number of samples is.
#[test]
fn more_samples_only_add_chunks() {
    let (plane, objects, rig) = shadowed();
    let sums = |n| {
        let (out, _) = render(&params(n, EnvBlock::Solid), &plane, &objects, &rig, &sunny());
        samples(&out.without).iter().map(|v| f64::from(*v) * f64::from(n)).collect::<Vec<_>>()
    };
    let (four, sixteen) = (sums(4), sums(16));
    assert!(four.iter().zip(&sixteen).all(|(a, b)| *b >= a - 1e-4));
}

// Same bytes with one thread and with several.
#[test]
fn threads_do_not_change_a_bit() {
    let (plane, objects, rig) = shadowed();
    let go = |threads: usize| {
        let pool = rayon_pool(threads);
        pool.install(|| {
            let (out, _) = render(&params(8, EnvBlock::Auto), &plane, &objects, &rig, &sunny());
            [samples(&out.with).to_vec(), samples(&out.object).to_vec(), samples(&out.depth).to_vec()]
        })
    };
    assert_eq!(go(1), go(3));
}
