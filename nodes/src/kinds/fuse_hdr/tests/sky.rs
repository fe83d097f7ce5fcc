//! Tests of an unseen sky: when it is reported as missing, and how bright it becomes.

use std::f64::consts::PI;

use render::light::energy::Energy;
use scene::math::equirect::pixel_solid_angle;

use super::*;

/// Radiance of the true sky. The upper rows of half of the columns are unseen.
const SKY: f64 = 0.6;
/// Albedo of the ground under the sky.
const ALBEDO: f64 = 0.3;

fn hole(at: usize) -> bool {
    at / W < 9 && at % W < 32
}

/// Irradiance on the ground from a uniform sky of radiance 1, computed as for the report.
fn whole_sky() -> f64 {
    Energy::of(Up::PlusZ, W, &[1.0; W * H]).ground
}

/// Outdoor capture in which the upper sky is unseen and filled with the radiance `filled`. Below it is a thin strip
/// of visible sky. An unseen part of the ground is filled with white.
fn capture(filled: f64, alpha: impl Fn(usize) -> f32) -> (Arc<Panorama>, Arc<Brackets>) {
    let ground = ALBEDO * SKY * whole_sky() / PI;
    let light = |at: usize| {
        let unseen_ground = at / W >= H / 2 && alpha(at) < 0.5;
        let value = if hole(at) {
            filled
        } else if at / W < H / 2 {
            SKY
        } else {
            ground
        };
        [if unseen_ground { 0.85 } else { value } as f32; 3]
    };
    let (base, brackets) = photograph(&light, &[], Transfer::Srgb, None);
    let mut pano = (*base).clone();
    pano.alpha.samples = (0..W * H).map(&alpha).collect();
    (Arc::new(pano), brackets)
}

/// Alpha of a pixel of the capture. It is below 1 in the hole, at thin leaves next to it, and in a part of the
/// ground.
fn outdoors(at: usize) -> f32 {
    match at / W {
        _ if hole(at) => 0.0,
        0..9 if at % W < 40 => 0.7,
        24.. if at % W < 20 => 0.3,
        _ => 1.0,
    }
}

fn with(ground_albedo: f64) -> FuseHdr {
    FuseHdr { ground_albedo: Some(ground_albedo), ..params() }
}

fn reported(notes: &Notes, id: &str) -> Option<String> {
    notes.iter().find(|note| note.id == id).map(|note| note.text.clone())
}

// The true sky is recovered where it was not seen, whatever the hole was filled with, and is in the report. This
// test fails if `self.seen` is replaced by `self.light` in `sky`, if `GROUND_ALPHA` is 0, or if `energy` leaves out
// the pixels of the sky.
#[test]
fn a_sky_that_was_not_seen_is_as_bright_as_the_ground_needs() {
    for filled in [0.02, 0.3] {
        let (base, brackets) = capture(filled, outdoors);
        let own = linear_pixels(&base.image, Transfer::Srgb).rgb;
        let (out, notes) = run(&with(ALBEDO), (base, brackets));
        for (at, own) in own.iter().enumerate() {
            let found = out.env.image.rgb(at % W, at / W);
            if at / W >= H / 2 || outdoors(at) == 1.0 {
                assert_eq!(found, *own, "what was seen is kept to the bit");
            } else {
                assert!(found.iter().all(|v| (f64::from(*v) / SKY - 1.0).abs() < 1e-4), "{at}: {found:?}");
                assert!(found[0] == found[1] && found[1] == found[2], "white");
            }
        }
        let text = reported(&notes, "sky-added").unwrap_or_default();
        assert!(text.contains("radiance 0.6000") && text.contains("albedo of 0.3"), "{text}");
        let Cell::Number(ground) = out.report.tables[1].rows[1][2] else { panic!("a number") };
        assert!((ground / (SKY * whole_sky()) - 1.0).abs() < 1e-4, "{ground}");
        assert!(out.report.tables[2].columns.iter().any(|step| step == "sky"));
        assert_eq!(reported(&notes, "sky-missing"), None);
    }
}

// A darker ground needs more light; visible pixels stay the same bit for bit. This test fails if `/ albedo` is
// changed to `* albedo`.
#[test]
fn the_darker_the_ground_the_brighter_the_sky() {
    let at_hole = |albedo: f64| run(&with(albedo), capture(0.3, outdoors)).0.env.image.samples[0];
    let skies = [0.02, 0.1, 0.2, 0.3, 0.4, 0.5].map(at_hole);
    assert!(skies.is_sorted_by(|a, b| a > b), "{skies:?}");
    let (out, notes) = run(&with(1.0), capture(0.3, outdoors));
    assert_eq!(out.env.image.samples[0], 0.0, "what was seen is light enough");
    assert!(reported(&notes, "sky-black").is_some());
}

// Without the parameter `ground_albedo`, alpha changes nothing. This test fails if `run` treats `None` as
// `Some(0.3)`.
#[test]
fn without_an_albedo_holes_stay_as_they_were_filled() {
    let (base, brackets) = capture(0.02, outdoors);
    let own = linear_pixels(&base.image, Transfer::Srgb).rgb;
    let (out, _) = run(&params(), (base, brackets));
    assert_eq!(out.env.image.samples.as_chunks::<3>().0, own);
}

// A sky counts as missing if the ground is too bright for the light and a part of the upper half was not seen. This
// test fails if `MOST_ALBEDO` is 3, or if either condition of `tell` is always true.
#[test]
fn a_missing_sky_is_reported_where_the_ground_needs_it() {
    let dim = |sky: f32, alpha: &dyn Fn(usize) -> f32| {
        let light = |at: usize| if at / W < H / 2 { [sky; 3] } else { [0.4; 3] };
        let (base, brackets) = photograph(&light, &[], Transfer::Srgb, None);
        let mut pano = (*base).clone();
        pano.alpha.samples = (0..W * H).map(alpha).collect();
        run(&params(), (Arc::new(pano), brackets)).1
    };
    let text = reported(&dim(0.25, &outdoors), "sky-missing").unwrap_or_default();
    assert!(text.contains("would be 1.60") && text.contains("`ground_albedo`"), "{text}");
    let weight = |y: usize| num::f64::cos(PI * (y as f64 + 0.5) / H as f64) * pixel_solid_angle(W, H, y);
    let unseen: f64 = (0..W * H / 2).map(|at| weight(at / W) * f64::from(1.0 - outdoors(at))).sum();
    let share = 100.0 * unseen / whole_sky();
    assert!(text.contains(&format!("{share:.1} % of the upper half")), "{text}");
    let few = |at: usize| if at / W < 9 && at % W < 1 { 0.0 } else { 1.0 };
    let no_ground = |at: usize| if at / W < H / 2 { outdoors(at) } else { 0.0 };
    let cases: [(f32, &dyn Fn(usize) -> f32); 4] =
        [(0.25, &|_| 1.0), (0.25, &few), (0.25, &no_ground), (0.5, &outdoors)];
    for (i, (sky, alpha)) in cases.into_iter().enumerate() {
        assert_eq!(reported(&dim(sky, alpha), "sky-missing"), None, "case {i}");
    }
}

// Without a place for a sky, or without ground to measure, the panorama is kept, and that is reported. This test
// fails if either early return of `sky` is left out.
#[test]
fn an_albedo_that_has_nothing_to_act_on_is_reported() {
    let no_ground = |at: usize| if at / W < H / 2 { outdoors(at) } else { 0.0 };
    for (base, brackets) in [capture(0.3, |_| 1.0), capture(0.3, no_ground)] {
        let own = linear_pixels(&base.image, Transfer::Srgb).rgb;
        let (out, notes) = run(&with(ALBEDO), (base, brackets));
        assert!(reported(&notes, "ground-albedo-unused").is_some());
        assert_eq!(out.env.image.samples.as_chunks::<3>().0, own);
    }
}
