//! Tests of the energy report: how much light each step adds, and to which lights.

use super::*;

// Lights without a row of their own are summed in the report. This test fails if `LISTED..` is changed to
// `..LISTED` in `table`.
#[test]
fn lights_that_are_not_listed_are_in_the_books() {
    let even = |at: usize| at.is_multiple_of(2) && (at / W).is_multiple_of(2);
    let lamps = |at: usize| even(at) && at % W < 40 && (8..16).contains(&(at / W));
    let lit = |at: usize| if lamps(at) { [30.0; 3] } else { [0.2; 3] };
    let (base, brackets) = photograph(&lit, &[], Transfer::Srgb, None);
    let (out, notes) = run(&params(), (base, brackets));
    let all = (0..W * H).filter(|&at| lamps(at)).count();
    assert_eq!(out.report.tables[0].rows.len(), ledger::LISTED);
    let reported = notes.iter().find(|note| note.id == "lights-not-listed").map(|note| note.text.clone());
    assert!(reported.is_some_and(|text| text.starts_with(&format!("{} ", all - ledger::LISTED))), "{all}");
    let last = steps(&out.report, out.report.tables[2].rows.len() - 1);
    let (before, after) = (last[0].1, last[last.len() - 1].1);
    assert!((after / before / 30.0 - 1.0).abs() < 1e-3, "{last:?}");
    assert_eq!(out.report.tables[1].rows[2][1], Cell::Number(after));
}

// Each step adds the same to the lights as to the total, and the steps that redistribute light keep the predicted
// total. This test fails if `feather` does not scale by `before / after`, or if a step is recorded before it is
// done.
#[test]
fn every_step_is_in_the_books() {
    let light = |at: usize| if (at / W == 9 || at / W == 10) && at % W < 9 { [30.0; 3] } else { [0.1; 3] };
    let (base, brackets) = photograph(&light, &[-6.0, -3.0], Transfer::Srgb, None);
    let (out, _) = run(&FuseHdr { feather_deg: 8.0, ..params() }, (base, brackets));
    let steps = &out.report.tables[2];
    assert_eq!(
        steps.columns,
        ["quantity", "panorama", "predicted", "blended", "flux kept", "feathered", "environment"]
    );
    let row = |i: usize| -> Vec<f64> {
        let number = |cell: &Cell| if let Cell::Number(v) = cell { *v } else { panic!("a number") };
        steps.rows[i][1..].iter().map(number).collect()
    };
    let (power, facing) = (row(0), row(3));
    let near = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-5;
    assert!(power[1..].iter().all(|p| near(*p, power[1])) && power[1] > 1.2 * power[0], "{power:?}");
    // The light is small, so a plane that faces it has about its power; feathering moves it inwards.
    assert!(near(facing[1], facing[2]) && near(facing[2], facing[3]) && facing[4] > facing[3], "{facing:?}");
    assert!((facing[1] - facing[0]) / (power[1] - power[0]) > 0.8);
    assert!(near(facing[4], facing[5]));
    assert_eq!(out.report.tables[0].rows[0][3], steps.rows[3][1]);
    assert_eq!(out.report.tables[0].rows[0][4], steps.rows[3][6]);
}

/// Numbers in a row of the table `steps`, each with the name of the step.
fn steps(report: &Report, row: usize) -> Vec<(&str, f64)> {
    let table = &report.tables[2];
    let number = |cell: &Cell| if let Cell::Number(v) = cell { *v } else { panic!("a number") };
    table.columns[1..].iter().map(String::as_str).zip(table.rows[row][1..].iter().map(number)).collect()
}

// Pixels that the paper's equation makes darker are in the report, with a warning. This test fails without
// `&self.darker` in `groups`.
#[test]
fn what_gets_darker_is_in_the_books() {
    let lit = |at: usize| if at == 500 { [40.0; 3] } else { [0.95; 3] };
    let (base, brackets) = photograph(&lit, &[-3.0], Transfer::Srgb, None);
    let mut brackets = (*brackets).clone();
    brackets.exposures[0].samples[3000..3900].fill(0.0);
    for (blend, fell) in [(Blend::Hard, true), (Blend::Ramp, false)] {
        let params = FuseHdr { blend, gain: Gain::Brackets, ..params() };
        let (out, notes) = run(&params, (base.clone(), Arc::new(brackets.clone())));
        let light: Vec<f64> =
            (0..W * H).map(|at| luminance(out.env.image.rgb(at % W, at / W)).into()).collect();
        let stored = render::light::energy::Energy::of(Up::PlusZ, W, &light).power;
        let reported = steps(&out.report, 0).last().map_or(0.0, |step| step.1);
        assert!((reported / stored - 1.0).abs() < 1e-6, "{reported} {stored}");
        assert_eq!(notes.iter().any(|note| note.id == "made-darker"), fell);
    }
}

// Light cut off by the white of the darkest exposure is a step of its own; without exposures the reason is
// reported. This test fails if `direct` is recorded after the exposures, or if `no-exposures` is reported for
// `Direct`.
#[test]
fn what_exposures_cut_off_is_in_the_books() {
    let lit = |at: usize| if at == 500 { [4000.0; 3] } else { [0.2; 3] };
    let params = FuseHdr { gain: Gain::Brackets, ..params() };
    let (out, _) = run(&params, photograph(&lit, &[-6.0, -3.0], Transfer::Srgb, None));
    let facing = steps(&out.report, 3);
    let of = |name: &str| facing.iter().find(|(step, _)| *step == name).map_or(0.0, |step| step.1);
    assert!((of("predicted") / of("panorama") / 4000.0 - 1.0).abs() < 1e-3, "{facing:?}");
    assert!((of("exposures") / of("panorama") / 64.0 - 1.0).abs() < 1e-3, "{facing:?}");
    for (gain, reported) in [(Gain::Brackets, true), (Gain::Direct, false)] {
        let params = FuseHdr { gain, ..params.clone() };
        let (_, notes) = run(&params, photograph(&lit, &[], Transfer::Srgb, None));
        assert_eq!(notes.iter().any(|note| note.id == "no-exposures"), reported);
        assert!(notes.iter().all(|note| note.id != "prediction-unused"));
    }
}

// A light whose pixels are barely clipped still gets all the predicted light.
#[test]
fn the_ramp_keeps_the_flux_of_a_light() {
    let (base, _) = photograph(&|at| if at == 500 { [0.96; 3] } else { [0.1; 3] }, &[], Transfer::Srgb, None);
    let mut gain = Image::<Data>::new(W, H, 1);
    gain.samples[500] = 6.0;
    let brackets = Brackets {
        log2_gain: gain,
        colour: None,
        evs: vec![],
        exposures: vec![],
        taken: Taken::Derived,
        report: Report::default(),
    };
    let (out, _) = run(&params(), (base, Arc::new(brackets)));
    assert!(
        (out.env.image.samples[1500] / (0.96 * 64.0) - 1.0).abs() < 1e-3,
        "{}",
        out.env.image.samples[1500]
    );
}

// A disc of light rises over the same angle at the horizon and near the zenith, across the seam, and at any size of
// the picture; its total is the same as without feathering, and nothing outside the disc changes. This test fails
// without `* high.min(low)` in `angle_to_edge`.
#[test]
fn a_feather_is_an_angle_and_keeps_the_light() {
    for (elevation_deg, azimuth_deg) in [(0.0_f64, 10.0_f64), (0.0, 178.0), (70.0, 0.0)] {
        let (up, out) = num::sin_cos(elevation_deg.to_radians());
        let (east, north) = num::sin_cos(azimuth_deg.to_radians());
        let centre = DVec3::new(out * east, out * north, up);
        let (width, height) = (360, 180);
        let angle = |at: usize| {
            let (u, v) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
            let d = scene::math::equirect::direction(Up::PlusZ, u / width as f64, v / height as f64);
            num::f64::acos(d.dot(centre).clamp(-1.0, 1.0)).to_degrees()
        };
        let rgb: Vec<[f32; 3]> =
            (0..width * height).map(|at| if angle(at) < 12.0 { [1.0; 3] } else { [0.2; 3] }).collect();
        let pixels = LinearPixels { width, height, rgb, broken: 0, negative: 0, ceiling: true };
        let light = |rgb: &[f32; 3]| if rgb[0] == 1.0 { 9.0 } else { f64::from(luminance(*rgb)) };
        let whole: Vec<Fused> = pixels
            .rgb
            .iter()
            .map(|rgb| Fused { luminance: light(rgb), source: 0, saturated: false })
            .collect();
        let mut soft = whole.clone();
        Lights::find(&pixels, &whole, |_| 0.0).feather(8.0, &pixels, &mut soft, &cx()).expect("runs");
        let flux = |fused: &[Fused]| -> f64 {
            let size = |at| scene::math::equirect::pixel_solid_angle(width, height, at / width);
            fused.iter().enumerate().map(|(at, f)| f.luminance * size(at)).sum()
        };
        assert!((flux(&soft) / flux(&whole) - 1.0).abs() < 1e-9);
        let top = soft.iter().map(|f| f.luminance).fold(0.0, f64::max) - 1.0;
        for (at, fused) in soft.iter().enumerate() {
            let inside = 12.0 - angle(at);
            if inside < 0.0 {
                assert_eq!(fused.luminance, whole[at].luminance);
            } else {
                // Edges of pixels are up to 0.7 degrees off the edge of the disc.
                let t = |off: f64| ((inside + off) / 8.0).clamp(0.0, 1.0);
                let part = |off: f64| t(off) * t(off) * (3.0 - 2.0 * t(off));
                let found = (fused.luminance - 1.0) / top;
                assert!(part(-0.3) - 1e-6 <= found && found <= part(1.5) + 1e-6, "{inside} {found}");
            }
        }
    }
}
