//! Tests of the formula and of the layers as they are used.

use super::*;
use scene::types::Srgb;
use testing::{context, row};

fn one(picture: impl Into<Picture>) -> Arc<Images> {
    Arc::new(Images::single("v", picture))
}

fn run(backdrop: Option<[f64; 3]>, b: Picture, o: [f32; 4], s: [f32; 3]) -> Vec<f32> {
    let inputs = In {
        background: one(b),
        object: one(Image::<Linear>::from_samples(1, 1, 4, o.to_vec())),
        shadow: Some(one(Image::<Data>::from_samples(1, 1, 3, s.to_vec()))),
        added: None,
        front: None,
        variance: None,
    };
    let (out, _) =
        Composite::run(&Composite { backdrop, ..Composite::default() }, inputs, &context()).expect("runs");
    out.image.0[0].picture.samples().to_vec()
}

fn rgb(c: [f32; 3]) -> Picture {
    Image::<Linear>::from_samples(1, 1, 3, c.to_vec()).into()
}

/// The background stays the same bit for bit if there is no shadow.
#[test]
fn full_and_empty_masks_are_exact() {
    let (b, s) = ([0.1, 0.7, 3.3], [0.25, 0.5, 1.0]);
    assert_eq!(run(Some([0.0; 3]), rgb(b), [0.0; 4], s), [0.1 * 0.25, 0.7 * 0.5, 3.3]);
    assert_eq!(run(Some([0.0; 3]), rgb(b), [0.0; 4], [1.0; 3]), b);
    assert_eq!(run(Some([0.0; 3]), rgb(b), [0.2, 0.3, 0.001, 1.0], s), [0.2, 0.3, 0.001]);
}

/// An object pixel whose alpha is 0 adds its light to the background, as a glow does.
#[test]
fn glow_is_added() {
    assert_eq!(run(None, rgb([0.5; 3]), [0.25, 0.0, 0.0, 0.0], [1.0; 3]), [0.75, 0.5, 0.5]);
}

/// A premultiplied object gives the same result as the formula for straight alpha.
#[test]
fn premultiplied_is_straight_times_alpha() {
    let (b, colour) = (0.4_f32, 0.7_f32);
    let error = (0..=20).map(|k| {
        let alpha = k as f32 / 20.0;
        let ours = run(None, rgb([b; 3]), [colour * alpha, 0.0, 0.0, alpha], [0.5; 3])[0];
        f64::from((ours - (b * 0.5 * (1.0 - alpha) + colour * alpha)).abs())
    });
    row(58, "difference of premultiplied and straight", error.fold(0.0, f64::max), 1e-6);
}

/// Holes show the backdrop or stay transparent, and the alpha of the result is given by the "over" operator.
#[test]
fn holes_show_the_backdrop_or_stay_open() {
    let half: Picture = Image::<Linear>::from_samples(1, 1, 4, vec![0.2, 0.2, 0.2, 0.5]).into();
    let over = run(Some([1.0, 0.0, 0.0]), half.clone(), [0.0; 4], [0.5; 3]);
    assert_eq!(over, [0.6, 0.1, 0.1]);
    let open = run(None, half, [0.1, 0.1, 0.1, 0.5], [1.0; 3]);
    assert_eq!(open, [0.2, 0.2, 0.2, 0.75]);
}

// Half-covered display-encoded pixels are decoded at their own colour, not at the colour darkened by alpha.
#[test]
fn encoded_colour_is_unpremultiplied_before_decoding() {
    let b: Picture = Image::<Srgb>::from_samples(1, 1, 4, vec![0.25, 0.25, 0.25, 0.5]).into();
    let out = run(Some([0.0; 3]), b, [0.0; 4], [1.0; 3]);
    assert!((out[0] - 0.5 * scene::math::color::linear_from_srgb(0.5)).abs() < 1e-7);
}

// Added light falls behind the object, and the result never goes below 0.
#[test]
fn light_is_added_under_the_object() {
    let data = |v: [f32; 3]| Some(one(Image::<Data>::from_samples(1, 1, 3, v.to_vec())));
    let inputs = In {
        background: one(rgb([0.5; 3])),
        object: one(Image::<Linear>::from_samples(1, 1, 4, vec![0.1, 0.1, 0.1, 0.5])),
        shadow: data([0.5; 3]),
        added: data([0.25, 0.0, -9.0]),
        front: None,
        variance: None,
    };
    let (out, _) = Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
        .expect("runs");
    let expected = [0.5 * 0.5 + 0.1, 0.25 * 0.5 + 0.1, 0.1];
    assert_eq!(out.image.0[0].picture.samples(), expected);
}

// The front layer covers the object by its alpha; elsewhere the background already contains it.
#[test]
fn the_front_is_laid_over_the_object_only() {
    let over = |alpha: f32, f: f32| {
        let inputs = In {
            background: one(rgb([0.5; 3])),
            object: one(Image::<Linear>::from_samples(1, 1, 4, vec![0.8 * alpha, 0.0, 0.0, alpha])),
            shadow: None,
            added: None,
            front: Some(one(Image::<Linear>::from_samples(1, 1, 4, vec![0.0, 0.3 * f, 0.0, f]))),
            variance: None,
        };
        let (out, _) =
            Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
                .expect("runs");
        out.image.0[0].picture.samples().to_vec()
    };
    assert_eq!(over(1.0, 0.0), [0.8, 0.0, 0.0]);
    assert_eq!(over(1.0, 1.0), [0.0, 0.3, 0.0]);
    assert_eq!(over(0.0, 1.0), [0.5; 3]);
    assert_eq!(over(1.0, 0.5), [0.4, 0.15, 0.0]);
    assert_eq!(over(0.5, 1.0), [0.25, 0.25 + 0.15, 0.25]);
}

// The shadow and the light of objects fall on the background behind a railing, not on the railing, and the
// front layer is limited to what the background contains.
#[test]
fn what_is_in_front_stands_in_no_shadow() {
    let data = |v: f32| Some(one(Image::<Data>::from_samples(1, 1, 3, vec![v; 3])));
    let railing = |f: [f32; 4], shadow: f32, added: f32| {
        let inputs = In {
            background: one(rgb([0.5; 3])),
            object: one(Image::<Linear>::new(1, 1, 4)),
            shadow: data(shadow),
            added: data(added),
            front: Some(one(Image::<Linear>::from_samples(1, 1, 4, f.to_vec()))),
            variance: None,
        };
        let (out, _) =
            Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
                .expect("runs");
        out.image.0[0].picture.samples()[0]
    };
    assert_eq!(railing([0.125, 0.125, 0.125, 0.5], 0.5, 0.0), 0.375 * 0.5 + 0.125);
    assert_eq!(railing([0.5, 0.5, 0.5, 1.0], 0.0, 9.0), 0.5);
    assert_eq!(railing([0.7, 0.7, 0.7, 0.9], 0.1, 0.0), 0.5);
    assert_eq!(railing([0.1, 0.1, 0.1, 0.3], 1.0, 0.0), 0.5);
    assert_eq!(railing([0.25, 0.25, 0.25, 0.5], 1.0, -9.0), 0.25);
}

// The object covers half of the pixel, so half of the error of the background's ratio remains. The error of the
// object is added, reduced by a quarter because of the front layer.
#[test]
fn the_error_is_that_of_the_ratio_and_of_the_object() {
    let data = |v: Vec<f32>| one(Image::<Data>::from_samples(1, 1, v.len(), v));
    let inputs = |variance| In {
        background: one(rgb([0.8; 3])),
        object: one(Image::<Linear>::from_samples(1, 1, 4, vec![0.1, 0.1, 0.1, 0.5])),
        shadow: Some(data(vec![0.5; 3])),
        added: None,
        front: Some(one(Image::<Linear>::from_samples(1, 1, 4, vec![0.0, 0.0, 0.0, 0.25]))),
        variance,
    };
    let run = |variance| {
        Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs(variance), &context())
    };
    let error = |variance| run(variance).expect("runs").0.error.0[0].picture.samples()[0];
    let reported = data(vec![9.0, 9.0, 0.04, 0.09]);
    let expected = (0.12_f32 * 0.12 + 0.15 * 0.15).sqrt();
    assert!((error(Some(reported)) - expected).abs() < 1e-6);
    assert_eq!(error(None), 0.0);
    let wrong = run(Some(data(vec![0.0; 3]))).err().expect("channels");
    assert!(wrong.message().contains("but has 3"), "{wrong}");
}

#[test]
fn views_of_another_size_are_refused() {
    let inputs = In {
        background: one(Image::<Linear>::new(2, 1, 3)),
        object: one(Image::<Linear>::new(1, 1, 4)),
        shadow: None,
        added: None,
        front: None,
        variance: None,
    };
    let error = Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
        .err()
        .expect("sizes");
    assert!(error.message().contains("1x1"), "{error}");
}

/// A background of stripes with soft edges and grain, and an object on it, of 160 x 64 pixels.
fn plate() -> In {
    let (width, height) = (160, 64);
    let mut background = Image::<Linear>::new(width, height, 3);
    let mut object = Image::<Linear>::new(width, height, 4);
    let mut shadow = Image::<Data>::new(width, height, 3);
    shadow.samples.fill(1.0);
    for y in 0..height {
        for x in 0..width {
            let away = (x % 40) as f32 - 20.0;
            let slope = 0.5 * away * if x % 80 < 40 { 1.0 } else { -1.0 };
            let soft = 0.5 + 0.2 * slope / (1.0 + slope * slope).sqrt();
            let noise = ((x * 7919 + y * 104_729) % 101) as f32 / 101.0 - 0.5;
            background.pixel_mut(x, y).fill(soft * soft + 0.01 * noise);
            if (60..100).contains(&x) && (20..44).contains(&y) {
                object.pixel_mut(x, y).copy_from_slice(&[0.4, 0.3, 0.2, 1.0]);
            }
            if (50..110).contains(&x) && y > 40 {
                shadow.pixel_mut(x, y).copy_from_slice(&[0.4, 0.5, 0.6]);
            }
        }
    }
    In {
        background: one(background),
        object: one(object),
        shadow: Some(one(shadow)),
        added: None,
        front: None,
        variance: None,
    }
}

fn layers(p: &Composite) -> [Vec<f32>; 5] {
    let (out, _) = Composite::run(p, plate(), &context()).unwrap_or_else(|e| panic!("{e}"));
    [&out.image, &out.object, &out.shadow, &out.added, &out.error]
        .map(|images| images.0.first().map_or(Vec::new(), |image| image.picture.samples().to_vec()))
}

/// Without changes, the layers as used are the inputs, bit for bit, and a blur of 0 or a gain of 1 changes no bit.
#[test]
fn layers_that_are_not_changed_keep_every_bit() {
    let inputs = plate();
    let samples = |images: &Images| images.0[0].picture.samples().to_vec();
    let [image, object, shadow, added, _] = layers(&Composite::default());
    assert_eq!(object, samples(&inputs.object));
    assert_eq!(shadow, samples(inputs.shadow.as_ref().expect("has a shadow")));
    assert!(added.is_empty(), "no input, no output");
    // They are passed on, not copied.
    let (out, _) = Composite::run(
        &Composite::default(),
        In {
            added: None,
            front: None,
            variance: None,
            shadow: inputs.shadow.clone(),
            object: inputs.object.clone(),
            background: inputs.background.clone(),
        },
        &context(),
    )
    .expect("runs");
    assert!(Arc::ptr_eq(&out.object, &inputs.object));
    let off = Composite { sharpness: Sharpness::Blur, blur_px: 0.0, ..Composite::default() };
    assert_eq!(layers(&off)[..3], [image, object, shadow]);
}

/// The formula on the layers as used gives the picture, whatever the settings; with the inputs it does not. This test
/// fails if the outputs are the inputs.
#[test]
fn the_formula_on_the_layers_as_used_gives_the_picture() {
    let inputs = plate();
    let background = inputs.background.0[0].picture.samples().to_vec();
    let settings = Composite::default();
    for (changes, p) in [
        (false, settings.clone()),
        (true, Composite { sharpness: Sharpness::Match, ..settings.clone() }),
        (true, Composite { sharpness: Sharpness::Blur, blur_px: 2.5, ..settings.clone() }),
        (true, Composite { grain: Grain::Match, ..settings.clone() }),
        (true, Composite { object_stops: -1.0, object_tint: [1.0, 0.8, 0.5], ..settings.clone() }),
        (true, Composite { sharpness: Sharpness::Match, grain: Grain::Match, object_stops: 0.5, ..settings }),
    ] {
        let [image, object, shadow, ..] = layers(&p);
        let rebuilt = |object: &[f32], shadow: &[f32]| {
            let difference = |at: usize| {
                let (c, pixel) = (at % 3, at / 3);
                let alpha = object[4 * pixel + 3];
                (background[at] * shadow[at] * (1.0 - alpha) + object[4 * pixel + c] - image[at]).abs()
            };
            (0..image.len()).map(difference).fold(0.0, f32::max)
        };
        assert!(rebuilt(&object, &shadow) < 1e-6, "{p:?}");
        let inputs = plate();
        let given = inputs.shadow.as_ref().expect("has a shadow");
        let of_inputs = rebuilt(inputs.object.0[0].picture.samples(), given.0[0].picture.samples());
        assert_eq!(of_inputs > 1e-3, changes, "{p:?}: {of_inputs}");
    }
}

/// The gain of the objects multiplies their colours, and neither their alpha nor the background.
#[test]
fn objects_are_exposed_and_tinted() {
    let [_, before, ..] = layers(&Composite::default());
    let p = Composite { object_stops: 1.0, object_tint: [1.0, 0.5, 0.25], ..Composite::default() };
    let [_, after, ..] = layers(&p);
    for (after, before) in after.chunks_exact(4).zip(before.chunks_exact(4)) {
        assert_eq!(after, [2.0 * before[0], before[1], 0.5 * before[2], before[3]]);
    }
}

/// Seeds give different grain, the same seed the same, and the views of a rig differ.
#[test]
fn grain_is_seeded() {
    let with = |grain_seed| {
        layers(&Composite { grain: Grain::Match, grain_seed, ..Composite::default() })[0].clone()
    };
    assert_eq!(with(1), with(1));
    assert!(with(1) != with(2));
}
